"""Smooth functions of one variable, and the road's centre line that one of them bends."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicSpline

from ovmot.geometry.arrays import FloatArray, IntArray

_ROAD_GRID_M = 0.25


@dataclass(frozen=True, slots=True)
class SmoothSteps:
    """A function that goes from value to value with zero slope and curvature at each knot.

    `knots` (N,) rise; `values` (N,); constant outside. Between two knots it is Perlin's quintic
    step 10u³ - 15u⁴ + 6u⁵ ("Improving Noise", SIGGRAPH 2002), so that a speed made of it has
    continuous jerk.
    """

    knots: FloatArray
    values: FloatArray

    @classmethod
    def make(cls, *points: tuple[float, float]) -> "SmoothSteps":
        """From (knot, value) pairs; raises `ValueError` where knots do not rise."""
        knots, values = np.array(points, dtype=np.float64).T
        if np.any(np.diff(knots) <= 0.0):
            raise ValueError("the knots of a profile must rise")
        return cls(knots, values)

    def __call__(self, x: FloatArray) -> FloatArray:
        """Values (...) at x (...)."""
        i, u = self._locate(x)
        step = u**3 * (10.0 + u * (-15.0 + 6.0 * u))
        return np.asarray(self.values[i] + self._rise()[i] * step)

    def integral(self, x: FloatArray) -> FloatArray:
        """Integral (...) from the first knot to x (...), exact."""
        i, u = self._locate(x)
        width = np.append(np.diff(self.knots), 1.0)
        rise = self._rise()
        whole = width[:-1] * (self.values[:-1] + 0.5 * rise[:-1])
        start = np.concatenate([[0.0], np.cumsum(whole)])
        part = self.values[i] * u + rise[i] * u**4 * (2.5 + u * (-3.0 + u))
        before = np.minimum(np.asarray(x) - self.knots[0], 0.0) * self.values[0]
        after = np.maximum(np.asarray(x) - self.knots[-1], 0.0) * self.values[-1]
        return np.asarray(start[i] + width[i] * part + before + after)

    def _locate(self, x: FloatArray) -> tuple[IntArray, FloatArray]:
        """Index of the knot before x, the last one included, and the share of the way on."""
        clipped = np.clip(x, self.knots[0], self.knots[-1])
        i = np.searchsorted(self.knots, clipped, side="right") - 1
        width = np.append(np.diff(self.knots), 1.0)
        return i.astype(np.int64), np.asarray((clipped - self.knots[i]) / width[i])

    def _rise(self) -> FloatArray:
        return np.append(np.diff(self.values), 0.0)


@dataclass(frozen=True)
class Road:
    """A planar centre line from the world's origin along x, of `length_m` and given curvature.

    `curvature` is in 1/m over arc length, positive to the left. Straight on outside.
    """

    curvature: SmoothSteps
    length_m: float

    def at(self, arc: FloatArray, offset: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Points (..., 2) and headings (...) rad at arc lengths (...), `offset` m to the left."""
        s = np.asarray(arc, dtype=np.float64)
        yaw = self._heading(s)
        inner = np.clip(s, 0.0, self.length_m)
        direction = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
        left = np.stack([-direction[..., 1], direction[..., 0]], axis=-1)
        return self._line(inner) + (s - inner)[..., None] * direction + offset * left, yaw

    def _heading(self, arc: FloatArray) -> FloatArray:
        return self.curvature.integral(np.clip(arc, 0.0, self.length_m))

    @cached_property
    def _line(self) -> CubicSpline:
        s = np.linspace(0.0, self.length_m, int(self.length_m / _ROAD_GRID_M) + 2)
        yaw = self._heading(s)
        xy = cumulative_simpson(np.stack([np.cos(yaw), np.sin(yaw)]), x=s, initial=0.0)
        return CubicSpline(s, xy.T)
