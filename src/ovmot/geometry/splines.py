"""A continuous trajectory on SE(3) through given poses, with exact derivatives.

Position is an interpolating B-spline (SciPy). Rotation is a cumulative B-spline on SO(3): the
product of R_0 · exp(λ_1 d_1) ··· exp(λ_k d_k) with the steps d_j between control rotations
and the cumulative basis λ_j; its derivatives follow the recursion of C. Sommer et al., "Efficient
Derivative Computation for Cumulative B-Splines on Lie Groups", CVPR 2020. Both parts share knots.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.sparse.linalg import splu

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray

_MAX_ITERATIONS = 60
_CONVERGED_RAD = 1e-13
_ACCEPTED_RAD = 1e-9


@dataclass(frozen=True, slots=True)
class PoseSpline:
    """A trajectory T_world_body(t) with degree-1 continuous derivatives (4 by default).

    Times are int64 nanoseconds, scalars or arrays of any shape (...); results lead with that
    shape. All methods raise `ValueError` for times outside `start_ns`..`end_ns`.
    """

    start_ns: int
    end_ns: int
    translation: BSpline
    control: FloatArray
    """Control rotations (N, 3, 3)."""
    step: FloatArray
    """Rotation vectors (N-1, 3) from one control rotation to the next."""

    @classmethod
    def through(
        cls, timestamp_ns: IntArray, T_world_body: FloatArray, degree: int = 5
    ) -> "PoseSpline":
        """The spline through poses (N, 4, 4) at rising times (N,), N > degree.

        Raises `ValueError` for too few poses, times that do not rise, or neighbours so far apart
        in rotation that no control rotations are found.
        """
        times = np.asarray(timestamp_ns, dtype=np.int64)
        if len(times) <= degree or len(times) != len(T_world_body):
            raise ValueError(f"a spline of degree {degree} needs more than {degree} timed poses")
        if np.any(np.diff(times) <= 0):
            raise ValueError("the poses' times must rise")
        seconds = 1e-9 * (times - times[0])
        translation = make_interp_spline(seconds, T_world_body[:, :3, 3], k=degree)
        control, step = _interpolating_rotations(seconds, T_world_body[:, :3, :3], translation)
        return cls(int(times[0]), int(times[-1]), translation, control, step)

    def pose(self, timestamp_ns: int | IntArray) -> FloatArray:
        """T_world_body (..., 4, 4)."""
        t = self._seconds(timestamp_ns)
        R = _rotation(t, self.translation, self.control, self.step)
        return se3.make(R, self.translation(t))

    def velocity(self, timestamp_ns: int | IntArray) -> FloatArray:
        """Velocity (..., 3) in the world frame, m/s."""
        return np.asarray(self.translation(self._seconds(timestamp_ns), nu=1))

    def acceleration(self, timestamp_ns: int | IntArray) -> FloatArray:
        """Acceleration (..., 3) in the world frame, m/s²."""
        return np.asarray(self.translation(self._seconds(timestamp_ns), nu=2))

    def angular_velocity(self, timestamp_ns: int | IntArray) -> FloatArray:
        """Angular velocity ω (..., 3) in the body frame, rad/s: Ṙ = R [ω]x."""
        return self._rates(timestamp_ns)[0]

    def angular_acceleration(self, timestamp_ns: int | IntArray) -> FloatArray:
        """Time derivative (..., 3) of `angular_velocity`, rad/s²."""
        return self._rates(timestamp_ns)[1]

    def _seconds(self, timestamp_ns: int | IntArray) -> FloatArray:
        times = np.asarray(timestamp_ns, dtype=np.int64)
        if np.any(times < self.start_ns) or np.any(times > self.end_ns):
            raise ValueError(f"time outside the path, {self.start_ns} to {self.end_ns} ns")
        return np.asarray(1e-9 * (times - self.start_ns))

    def _rates(self, timestamp_ns: int | IntArray) -> tuple[FloatArray, FloatArray]:
        """ω and its derivative (Sommer et al. 2020, eq. 30-33 in the form for SO(3))."""
        t = self._seconds(timestamp_ns)
        first, weight, weight_1, weight_2 = _cumulative_basis(t, self.translation)
        omega = np.zeros((*t.shape, 3))
        omega_dot = np.zeros((*t.shape, 3))
        for j in range(self.translation.k):
            d = self.step[first + j]
            back = so3.exp(-weight[..., j, None] * d)
            rate = weight_1[..., j, None] * d
            omega = (back @ omega[..., None])[..., 0] + rate
            omega_dot = (
                (back @ omega_dot[..., None])[..., 0]
                + np.cross(omega, rate)
                + weight_2[..., j, None] * d
            )
        return omega, omega_dot


def _rotation(t: FloatArray, basis: BSpline, control: FloatArray, step: FloatArray) -> FloatArray:
    """R_world_body (..., 3, 3) at seconds t (...)."""
    first, weight, _, _ = _cumulative_basis(t, basis)
    R = control[first]
    for j in range(basis.k):
        R = R @ so3.exp(weight[..., j, None] * step[first + j])
    return R


def _cumulative_basis(
    t: FloatArray, basis: BSpline
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """First control index (...) of each time's span, and λ, λ', λ'' (..., k) of its k steps.

    λ_j sums the basis functions from j on, so λ_j' is a single one of one degree less:
    k B_{j,k-1} / (t_{j+k} - t_j) (de Boor, "A Practical Guide to Splines", chapter X).
    """
    knots, k = basis.t, basis.k
    n = len(knots) - k - 1
    span = np.clip(np.searchsorted(knots, t, side="right") - 1, k, n - 1)
    full = _basis_functions(t, knots, span, k)
    lower = _basis_functions(t, knots, span, k - 1)
    lowest = _basis_functions(t, knots, span, k - 2)
    weight = np.cumsum(full[..., :0:-1], axis=-1)[..., ::-1]
    j = span[..., None] + np.arange(-k + 1, 1)
    weight_1 = k * lower / (knots[j + k] - knots[j])
    slope = (k - 1) * lowest / (knots[j[..., 1:] + k - 1] - knots[j[..., 1:]])
    padded = np.concatenate([np.zeros((*t.shape, 1)), slope, np.zeros((*t.shape, 1))], axis=-1)
    weight_2 = k * (padded[..., :-1] - padded[..., 1:]) / (knots[j + k] - knots[j])
    return span - k, weight, weight_1, weight_2


def _basis_functions(t: FloatArray, knots: FloatArray, span: IntArray, degree: int) -> FloatArray:
    """The degree+1 B-spline basis functions that do not vanish in `span` (Cox-de Boor)."""
    values = np.ones((*t.shape, 1))
    for d in range(1, degree + 1):
        j = span[..., None] + np.arange(-d + 1, 1)
        left, right = knots[j], knots[j + d]
        share = values / (right - left)
        out = np.zeros((*t.shape, d + 1))
        out[..., :-1] += share * (right - t[..., None])
        out[..., 1:] += share * (t[..., None] - left)
        values = out
    return values


def _interpolating_rotations(
    seconds: FloatArray, R_world_body: FloatArray, basis: BSpline
) -> tuple[FloatArray, FloatArray]:
    """Control rotations (N, 3, 3) and steps (N-1, 3) whose spline meets N rotations.

    Newton steps with the Jacobian of the commutative case: exact on a line, and a contraction as
    long as neighbouring rotations are near each other.
    """
    solver = splu(BSpline.design_matrix(seconds, basis.t, basis.k).tocsc())
    control = np.asarray(R_world_body, dtype=np.float64)
    miss = np.inf
    for _ in range(_MAX_ITERATIONS):
        step = so3.log(np.swapaxes(control[:-1], -1, -2) @ control[1:])
        reached = _rotation(seconds, basis, control, step)
        error = so3.log(R_world_body @ np.swapaxes(reached, -1, -2))
        previous, miss = miss, float(np.abs(error).max())
        if miss < _CONVERGED_RAD or (miss < _ACCEPTED_RAD and miss >= previous):
            break
        control = so3.exp(solver.solve(error)) @ control
    if not miss < _ACCEPTED_RAD:
        raise ValueError("neighbouring poses are too far apart in rotation for a spline")
    return control, step
