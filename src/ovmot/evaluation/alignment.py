"""Laying an estimated trajectory onto the true one, by the freedom that the estimate has.

Each function takes N poses of the truth and of the estimate, T (N, 4, 4), at the same instants,
and finds the transform of the estimate's world that fits best; `ALIGNMENTS` names them. They
raise `OvmotError` where the poses do not determine it, and never give NaN.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ovmot.errors import OvmotError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray

SHORT_PATH_M = 2.0
"""Positions within a smaller box than this (its diagonal) do not tell the heading."""

_UPRIGHT_M = 0.05  # a path this narrow goes straight up
_SAME_POINT_M = 1e-9
_COLLINEAR = 1e-12  # ratio of variances: 1 mm beside a line of 1 km


@dataclass(frozen=True, slots=True)
class Alignment:
    """p_reference = scale · R · p_estimate + t, from the estimate's world to the reference's."""

    R: FloatArray
    t: FloatArray
    scale: float = 1.0

    def positions(self, position: FloatArray) -> FloatArray:
        """Positions (..., 3) of the estimate in the reference's world."""
        return self.scale * position @ self.R.T + self.t

    def poses(self, T_world_body: FloatArray) -> FloatArray:
        """Poses (..., 4, 4) of the estimate in the reference's world; the scale moves positions."""
        return se3.make(
            self.R @ T_world_body[..., :3, :3], self.positions(T_world_body[..., :3, 3])
        )


def align_none(T_reference: FloatArray, T_estimate: FloatArray) -> Alignment:
    """Leave the estimate where it is."""
    _check(T_reference, T_estimate, 1, "none")
    return Alignment(np.eye(3), np.zeros(3))


def align_first(T_reference: FloatArray, T_estimate: FloatArray) -> Alignment:
    """Yaw and position of the first pose: the gauge in which a filter states its covariance.

    A filter starts with yaw and position known by definition, so its covariance is that of the
    error since then.
    """
    _check(T_reference, T_estimate, 1, "first")
    R = _yaw(_heading_sums(T_reference[:1, :3, :3], T_estimate[:1, :3, :3]), "first")
    return Alignment(R, T_reference[0, :3, 3] - R @ T_estimate[0, :3, 3])


def align_yaw(T_reference: FloatArray, T_estimate: FloatArray) -> Alignment:
    """Least squares over a turn about the vertical and a shift: what an IMU leaves unknown.

    Zhang and Scaramuzza, IROS 2018, section III. Where the positions do not tell the heading (see
    `SHORT_PATH_M`), it is the turn that brings the attitudes nearest to each other.
    """
    _check(T_reference, T_estimate, 1, "yaw")
    reference, estimate = T_reference[:, :3, 3], T_estimate[:, :3, 3]
    a, b = reference - reference.mean(axis=0), estimate - estimate.mean(axis=0)
    sums = (float((b[:, 0] * a[:, 1] - b[:, 1] * a[:, 0]).sum()), float((a * b)[:, :2].sum()))
    extent = np.ptp(reference, axis=0)
    upright = np.linalg.norm(extent[:2]) < _UPRIGHT_M or np.hypot(*sums) < 1e-12
    if np.linalg.norm(extent) < SHORT_PATH_M or upright:
        sums = _heading_sums(T_reference[:, :3, :3], T_estimate[:, :3, :3])
    R = _yaw(sums, "yaw")
    return Alignment(R, reference.mean(axis=0) - R @ estimate.mean(axis=0))


def align_se3(T_reference: FloatArray, T_estimate: FloatArray) -> Alignment:
    """Least squares over rotation and shift of the positions (Umeyama, PAMI 1991, eq. 40-43)."""
    _check(T_reference, T_estimate, 3, "se3")
    R, _ = _umeyama(T_reference[:, :3, 3], T_estimate[:, :3, 3], "se3")
    return _about_means(T_reference, T_estimate, R, 1.0)


def align_sim3(T_reference: FloatArray, T_estimate: FloatArray) -> Alignment:
    """Least squares over rotation, shift and scale (Umeyama, PAMI 1991, eq. 40-43)."""
    _check(T_reference, T_estimate, 3, "sim3")
    R, scale = _umeyama(T_reference[:, :3, 3], T_estimate[:, :3, 3], "sim3")
    return _about_means(T_reference, T_estimate, R, scale)


ALIGNMENTS: dict[str, Callable[[FloatArray, FloatArray], Alignment]] = {
    "none": align_none,
    "first": align_first,
    "yaw": align_yaw,
    "se3": align_se3,
    "sim3": align_sim3,
}


def _about_means(
    T_reference: FloatArray, T_estimate: FloatArray, R: FloatArray, scale: float
) -> Alignment:
    reference, estimate = (T[:, :3, 3].mean(axis=0) for T in (T_reference, T_estimate))
    return Alignment(R, reference - scale * R @ estimate, scale)


def _umeyama(reference: FloatArray, estimate: FloatArray, name: str) -> tuple[FloatArray, float]:
    """Rotation (3, 3) and scale that bring positions (N, 3) onto others, about their means."""
    a, b = reference - reference.mean(axis=0), estimate - estimate.mean(axis=0)
    if min(np.abs(a).max(), np.abs(b).max()) < _SAME_POINT_M:
        raise OvmotError(f"alignment '{name}': all positions are the same point")
    U, singular, Vt = np.linalg.svd(a.T @ b / len(a))
    if singular[1] < _COLLINEAR * singular[0]:
        raise OvmotError(
            f"alignment '{name}': all positions lie on one line, so the turn about it is not known"
        )
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))])
    scale = float(singular @ sign / np.mean(np.sum(b**2, axis=1)))
    R: FloatArray = U * sign @ Vt
    return R, scale


def _heading_sums(R_reference: FloatArray, R_estimate: FloatArray) -> tuple[float, float]:
    """Sine and cosine, up to a factor, of the yaw that maximises Σ tr(R_refᵀ R_z R_est)."""
    M = np.einsum("nij,nkj->ik", R_reference, R_estimate)
    return float(M[1, 0] - M[0, 1]), float(M[0, 0] + M[1, 1])


def _yaw(sums: tuple[float, float], name: str) -> FloatArray:
    """Rotation (3, 3) about the vertical by the angle of this sine and cosine."""
    if np.hypot(*sums) < 1e-12:
        raise OvmotError(f"alignment '{name}': the poses do not determine the heading")
    return so3.exp(np.array([0.0, 0.0, np.arctan2(*sums)]))


def _check(T_reference: FloatArray, T_estimate: FloatArray, needed: int, name: str) -> None:
    if T_reference.shape != T_estimate.shape:
        counts = f"{len(T_reference)} true and {len(T_estimate)} estimated poses"
        raise OvmotError(f"alignment '{name}': {counts} cannot be paired")
    if len(T_reference) < needed:
        has = len(T_reference)
        raise OvmotError(f"alignment '{name}' needs {needed} poses or more and has {has}")
    if not (np.isfinite(T_reference).all() and np.isfinite(T_estimate).all()):
        raise OvmotError(f"alignment '{name}': a pose is not finite")
