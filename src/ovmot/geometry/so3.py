"""Rotations SO(3): hat, exponential, logarithm and their Jacobians, batched over leading axes.

Perturbations are on the right, R_true = R_est · exp(δθ). Formulas: J. Solà, J. Deray, D.
Atchuthan, "A micro Lie theory for state estimation in robotics", arXiv:1812.01537, appendix B.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from ovmot.geometry.arrays import FloatArray

_SMALL_ANGLE = 1e-5
_NEAR_PI = np.pi - 1e-4


def hat(vector: FloatArray) -> FloatArray:
    """Skew-symmetric matrix [v]x (..., 3, 3) of vectors (..., 3): hat(v) @ w = v x w."""
    v = np.asarray(vector, dtype=np.float64)
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def exp(rotation_vector: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) in rad (Rodrigues)."""
    v = np.asarray(rotation_vector, dtype=np.float64)
    a, b, _ = _coefficients(v)
    K = hat(v)
    return np.eye(3) + a * K + b * (K @ K)


def rotation_z(yaw: FloatArray | float) -> FloatArray:
    """Rotation matrices (..., 3, 3) about z by angles (...,) in rad."""
    c, s = np.cos(yaw), np.sin(yaw)
    out = np.zeros((*np.shape(yaw), 3, 3))
    out[..., 0, 0], out[..., 0, 1] = c, -s
    out[..., 1, 0], out[..., 1, 1] = s, c
    out[..., 2, 2] = 1.0
    return out


def log(rotation: FloatArray) -> FloatArray:
    """Rotation vectors (..., 3) in rad, of norm <= pi, of rotation matrices (..., 3, 3)."""
    R = np.asarray(rotation, dtype=np.float64)
    w = 0.5 * np.stack(
        [R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]],
        axis=-1,
    )
    sine = np.linalg.norm(w, axis=-1)
    cosine = 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0)
    angle = np.arctan2(sine, cosine)
    small = angle < _SMALL_ANGLE
    scale = np.where(
        small, 1.0 + angle**2 / 6.0, angle / np.where(small, 1.0, np.maximum(sine, 1e-300))
    )
    out: FloatArray = scale[..., None] * w
    near_pi = angle > _NEAR_PI
    if np.any(near_pi):  # the antisymmetric part vanishes at pi; quaternions do not
        out[near_pi] = Rotation.from_matrix(R[near_pi]).as_rotvec()
    return out


def right_jacobian(rotation_vector: FloatArray) -> FloatArray:
    """J_r (..., 3, 3) with exp(v + dv) ~ exp(v) exp(J_r(v) dv) (Solà 2018, eq. 143)."""
    v = np.asarray(rotation_vector, dtype=np.float64)
    _, b, c = _coefficients(v)
    K = hat(v)
    return np.eye(3) - b * K + c * (K @ K)


def right_jacobian_inverse(rotation_vector: FloatArray) -> FloatArray:
    """Inverse of `right_jacobian` (..., 3, 3), for angles below 2 pi (Solà 2018, eq. 144)."""
    v = np.asarray(rotation_vector, dtype=np.float64)
    angle = np.linalg.norm(v, axis=-1)
    small = angle < 1e-3
    safe = np.where(small, 1.0, angle)
    half = 0.5 * safe
    d = np.where(small, 1.0 / 12.0 + angle**2 / 720.0, (1.0 - half / np.tan(half)) / safe**2)
    K = hat(v)
    J_inverse: FloatArray = np.eye(3) + 0.5 * K + d[..., None, None] * (K @ K)
    return J_inverse


def left_jacobian(rotation_vector: FloatArray) -> FloatArray:
    """J_l (..., 3, 3) with exp(v + dv) ~ exp(J_l(v) dv) exp(v); equals J_r(-v)."""
    return right_jacobian(-np.asarray(rotation_vector, dtype=np.float64))


def second_left_jacobian(rotation_vector: FloatArray) -> FloatArray:
    """∫(1 - s) exp(s v) ds over 0..1 (..., 3, 3): what constant turning does to a second integral.

    ½ I + c K + d K², c as in `right_jacobian`, d = (t²/2 + cos t - 1) / t⁴.
    """
    v = np.asarray(rotation_vector, dtype=np.float64)
    _, b, c = _coefficients(v)
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    small = angle < 1e-2
    safe = np.where(small, 1.0, angle)
    d = np.where(small, 1.0 / 24.0 - angle**2 / 720.0, (0.5 - b) / safe**2)
    K = hat(v)
    return np.asarray(0.5 * np.eye(3) + c * K + d * (K @ K))


def from_quaternion(quaternion: FloatArray) -> FloatArray:
    """Rotation matrices (..., 3, 3) of Hamilton quaternions (..., 4), order x y z w."""
    q = np.asarray(quaternion, dtype=np.float64)
    matrices: FloatArray = Rotation.from_quat(q.reshape(-1, 4)).as_matrix()
    return matrices.reshape(*q.shape[:-1], 3, 3)


def to_quaternion(rotation: FloatArray) -> FloatArray:
    """Hamilton quaternions (..., 4), order x y z w with w >= 0, of matrices (..., 3, 3)."""
    R = np.asarray(rotation, dtype=np.float64)
    flat: FloatArray = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat(canonical=True)
    return flat.reshape(*R.shape[:-2], 4)


def project_to_rotation(matrix: FloatArray) -> FloatArray:
    """Nearest rotations (..., 3, 3) in the Frobenius norm (SVD; Umeyama 1991)."""
    U, _, Vt = np.linalg.svd(np.asarray(matrix, dtype=np.float64))
    sign = np.linalg.det(U @ Vt)
    D = np.zeros_like(U)
    D[..., 0, 0] = D[..., 1, 1] = 1.0
    D[..., 2, 2] = sign
    R: FloatArray = U @ D @ Vt
    return R


def between_vectors(source: FloatArray, target: FloatArray) -> FloatArray:
    """The smallest rotation (3, 3) that turns the direction of `source` into that of `target`.

    Both are (3,) and not zero. For opposite directions any axis square to them will do.
    """
    a = np.asarray(source, dtype=np.float64) / np.linalg.norm(source)
    b = np.asarray(target, dtype=np.float64) / np.linalg.norm(target)
    axis = np.cross(a, b)
    sine, cosine = float(np.linalg.norm(axis)), float(a @ b)
    if sine < 1e-12:
        if cosine > 0.0:
            return np.eye(3)
        axis = np.cross(a, np.eye(3)[int(np.argmin(np.abs(a)))])
    else:
        axis = axis - (a @ axis) * a  # nearly opposite: take rounding out of a short cross product
    return exp(np.arctan2(sine, cosine) * axis / np.linalg.norm(axis))


def _coefficients(v: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """sin(t)/t, (1-cos t)/t^2 and (t-sin t)/t^3 as (..., 1, 1), by series near zero."""
    angle = np.linalg.norm(v, axis=-1)[..., None, None]
    squared = angle**2
    small = angle < 1e-3
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1.0 - squared / 6.0, np.sin(safe) / safe)
    half_sine = np.sin(0.5 * safe)  # 1 - cos t = 2 sin²(t/2), which does not cancel
    b = np.where(small, 0.5 - squared / 24.0, 2.0 * (half_sine / safe) ** 2)
    c = np.where(small, 1.0 / 6.0 - squared / 120.0, (safe - np.sin(safe)) / safe**3)
    return a, b, c
