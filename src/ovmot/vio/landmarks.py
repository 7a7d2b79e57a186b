"""Landmarks (SLAM features) kept in the state: their representations, and values with Jacobians.

Coordinates are those of the world, or of an anchor: a clone, with axes and origin of the left
camera as the calibration file has them, so that the calibration that is estimated does not enter.
The inverse-depth forms are those of J. Montiel et al. (RSS 2006) and of A. Mourikis and
S. Roumeliotis (ICRA 2007).
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.vio.landmark_point_kernel import EUCLIDEAN, NORMALIZED, SPHERICAL

NO_ANCHOR = -1
_WORLD_AXES = np.eye(3)
_CAMERA_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


class Coordinates(Protocol):
    """A parametrization of points by three numbers, of which the last `size` are estimated.

    `form`: its code in `landmark_point_kernel`, with its `axes` (3, 3) there.
    """

    size: int
    form: int
    axes: FloatArray

    def from_point(self, point: FloatArray) -> FloatArray:
        """Values (..., 3) of points (..., 3), metres, in the frame of the representation."""
        ...

    def to_point(self, value: FloatArray) -> FloatArray:
        """Points (..., 3), metres, of values (..., 3)."""
        ...

    def jacobian(self, value: FloatArray) -> FloatArray:
        """∂point/∂value (..., 3, 3), the columns that are not estimated included."""
        ...


class Euclidean:
    """x, y, z."""

    size, form, axes = 3, EUCLIDEAN, _WORLD_AXES

    def from_point(self, point: FloatArray) -> FloatArray:
        return point.copy()

    def to_point(self, value: FloatArray) -> FloatArray:
        return value.copy()

    def jacobian(self, value: FloatArray) -> FloatArray:
        return np.broadcast_to(np.eye(3), (*value.shape, 3)).copy()


class SphericalInverseDepth:
    """Azimuth θ, elevation φ, rad, and inverse distance ρ, 1/m.

    p = R (cosφ cosθ, cosφ sinθ, sinφ) / ρ; the columns of `R` (3, 3) are the axes ahead, left and
    up. Straight up θ is not defined.
    """

    size, form = 3, SPHERICAL

    def __init__(self, R: FloatArray) -> None:
        self.axes = R

    def from_point(self, point: FloatArray) -> FloatArray:
        ray = point @ self.axes
        distance = np.linalg.norm(ray, axis=-1)
        azimuth = np.arctan2(ray[..., 1], ray[..., 0])
        return np.stack([azimuth, np.arcsin(ray[..., 2] / distance), 1.0 / distance], axis=-1)

    def to_point(self, value: FloatArray) -> FloatArray:
        return np.asarray(self._ray(value) @ self.axes.T / value[..., 2:])

    def jacobian(self, value: FloatArray) -> FloatArray:
        theta, phi, rho = value[..., 0], value[..., 1], value[..., 2:]
        zero = np.zeros_like(theta)
        by_theta = np.stack([-np.cos(phi) * np.sin(theta), np.cos(phi) * np.cos(theta), zero], -1)
        by_phi = np.stack(
            [-np.sin(phi) * np.cos(theta), -np.sin(phi) * np.sin(theta), np.cos(phi)], axis=-1
        )
        columns = [by_theta / rho, by_phi / rho, -self._ray(value) / rho**2]
        return np.asarray(self.axes @ np.stack(columns, axis=-1))

    def _ray(self, value: FloatArray) -> FloatArray:
        theta, phi = value[..., 0], value[..., 1]
        return np.stack([np.cos(phi) * np.cos(theta), np.cos(phi) * np.sin(theta), np.sin(phi)], -1)


class NormalizedInverseDepth:
    """Normalized coordinates and inverse depth (x/z, y/z, 1/z): p = (α, β, 1) / ρ."""

    size, form, axes = 3, NORMALIZED, _WORLD_AXES

    def from_point(self, point: FloatArray) -> FloatArray:
        return np.concatenate([point[..., :2], np.ones_like(point[..., 2:])], -1) / point[..., 2:]

    def to_point(self, value: FloatArray) -> FloatArray:
        return self._ray(value) / value[..., 2:]

    def jacobian(self, value: FloatArray) -> FloatArray:
        rho = value[..., 2:, None]
        J = np.broadcast_to(np.eye(3), (*value.shape, 3)) / rho
        J[..., 2] = -self._ray(value) / value[..., 2:] ** 2
        return J

    def _ray(self, value: FloatArray) -> FloatArray:
        return np.concatenate([value[..., :2], np.ones_like(value[..., 2:])], axis=-1)


class SingleInverseDepth(NormalizedInverseDepth):
    """Only 1/z is estimated; the bearing stays as first seen, its error is projected out."""

    size = 1


@dataclass(frozen=True, slots=True)
class Representation:
    """Coordinates of landmarks, and whether they are relative to an anchor clone."""

    coordinates: Coordinates
    anchored: bool


REPRESENTATIONS: dict[str, Representation] = {
    "global_xyz": Representation(Euclidean(), anchored=False),
    "global_inverse_depth": Representation(SphericalInverseDepth(_WORLD_AXES), anchored=False),
    "anchored_xyz": Representation(Euclidean(), anchored=True),
    "anchored_inverse_depth": Representation(SphericalInverseDepth(_CAMERA_AXES), anchored=True),
    "anchored_msckf_inverse_depth": Representation(NormalizedInverseDepth(), anchored=True),
    "anchored_single_inverse_depth": Representation(SingleInverseDepth(), anchored=True),
}


@dataclass(frozen=True, slots=True)
class Landmarks:
    """L landmarks (SLAM features) of the state.

    `feature_id` (L,): the front end's ids; `value` (L, 3) in the representation's coordinates and
    `first` (L, 3), the first estimates of these; `anchor_ns` (L,): stamp of the anchor clone,
    `NO_ANCHOR` for coordinates of the world; `rejections` (L,): how many updates in a row the gate
    rejected.
    """

    representation: Representation
    feature_id: IntArray
    value: FloatArray
    first: FloatArray
    anchor_ns: IntArray
    rejections: IntArray

    def __len__(self) -> int:
        return len(self.feature_id)

    @property
    def size(self) -> int:
        """Number of error coordinates of each landmark: 3, or 1."""
        return self.representation.coordinates.size

    def plus(self, error: FloatArray) -> "Landmarks":
        """With an error vector (L * size,) added to the values; first estimates stay."""
        if not len(self):
            return self
        value = self.value.copy()
        value[:, 3 - self.size :] += error.reshape(len(self), self.size)
        return Landmarks(
            self.representation, self.feature_id, value, self.first, self.anchor_ns,
            self.rejections,
        )  # fmt: skip

    def minus(self, reference: "Landmarks") -> FloatArray:
        """The error vector (L * size,) from the reference to these."""
        return np.ravel((self.value - reference.value)[:, 3 - self.size :])

    def rows(self, kept: BoolArray | IntArray) -> "Landmarks":
        """The landmarks `kept` (L,), or of indices `kept` (K,)."""
        return Landmarks(
            self.representation, self.feature_id[kept], self.value[kept], self.first[kept],
            self.anchor_ns[kept], self.rejections[kept],
        )  # fmt: skip

    def append(self, others: "Landmarks") -> "Landmarks":
        """These landmarks, and `others` after them."""
        return Landmarks(
            self.representation,
            np.concatenate([self.feature_id, others.feature_id]),
            np.concatenate([self.value, others.value]),
            np.concatenate([self.first, others.first]),
            np.concatenate([self.anchor_ns, others.anchor_ns]),
            np.concatenate([self.rejections, others.rejections]),
        )


def no_landmarks(representation: str = "global_xyz") -> Landmarks:
    """No landmarks, for those to come in the representation of this name."""
    ids = np.empty(0, dtype=np.int64)
    none = np.empty((0, 3))
    return Landmarks(REPRESENTATIONS[representation], ids, none, none, ids, ids)
