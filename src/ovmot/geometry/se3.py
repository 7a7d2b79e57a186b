"""Rigid motions SE(3) as 4x4 matrices, batched over leading axes.

`T_a_b` maps points of frame b into frame a. A twist is (ω, v): rotation first. Perturbations
are on the right, T_true = T_est · exp(δ), unless a docstring says otherwise. Formulas: J. Solà et
al., arXiv:1812.01537, appendix D (with rotation and translation parts exchanged).
"""

import numpy as np

from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray


def make(rotation: FloatArray, translation: FloatArray) -> FloatArray:
    """Matrices (..., 4, 4) from rotations (..., 3, 3) and translations (..., 3)."""
    R, t = np.asarray(rotation, dtype=np.float64), np.asarray(translation, dtype=np.float64)
    shape, shape_t = R.shape[:-2], t.shape[:-1]
    if shape != shape_t:
        shape = np.broadcast_shapes(shape, shape_t)
    T = np.zeros((*shape, 4, 4))
    T[..., :3, :3] = R
    T[..., :3, 3] = t
    T[..., 3, 3] = 1.0
    return T


def inverse(T_a_b: FloatArray) -> FloatArray:
    """T_b_a (..., 4, 4) of T_a_b (..., 4, 4)."""
    T = np.zeros(T_a_b.shape)
    R_b_a = T_a_b[..., :3, :3].swapaxes(-1, -2)
    T[..., :3, :3] = R_b_a
    T[..., :3, 3:] = -(R_b_a @ T_a_b[..., :3, 3:])
    T[..., 3, 3] = 1.0
    return T


def apply(T_a_b: FloatArray, points_b: FloatArray) -> FloatArray:
    """Points (..., 3) of frame b in frame a; leading axes broadcast."""
    return (T_a_b[..., :3, :3] @ points_b[..., None])[..., 0] + T_a_b[..., :3, 3]


def exp(twist: FloatArray) -> FloatArray:
    """Motions (..., 4, 4) of twists (ω, v) (..., 6)."""
    xi = np.asarray(twist, dtype=np.float64)
    omega, v = xi[..., :3], xi[..., 3:]
    return make(so3.exp(omega), (so3.left_jacobian(omega) @ v[..., None])[..., 0])


def log(T: FloatArray) -> FloatArray:
    """Twists (ω, v) (..., 6) of motions (..., 4, 4)."""
    omega = so3.log(T[..., :3, :3])
    v = (so3.right_jacobian_inverse(-omega) @ T[..., :3, 3:])[..., 0]
    return np.concatenate([omega, v], axis=-1)


def adjoint(T: FloatArray) -> FloatArray:
    """Ad (..., 6, 6) with T exp(ξ) T^-1 = exp(Ad ξ), twists (ω, v)."""
    R = T[..., :3, :3]
    out = np.zeros((*T.shape[:-2], 6, 6))
    out[..., :3, :3] = R
    out[..., 3:, 3:] = R
    out[..., 3:, :3] = so3.hat(T[..., :3, 3]) @ R
    return out


def right_jacobian(twist: FloatArray) -> FloatArray:
    """J_r (..., 6, 6) with exp(ξ + dξ) ~ exp(ξ) exp(J_r dξ) (Solà 2018, eq. 179-180)."""
    xi = -np.asarray(twist, dtype=np.float64)  # J_r(ξ) = J_l(-ξ)
    out = np.zeros((*xi.shape[:-1], 6, 6))
    J = so3.left_jacobian(xi[..., :3])
    out[..., :3, :3] = J
    out[..., 3:, 3:] = J
    out[..., 3:, :3] = _q_block(xi[..., :3], xi[..., 3:])
    return out


def _q_block(omega: FloatArray, v: FloatArray) -> FloatArray:
    """Coupling of translation and rotation in the left Jacobian (Barfoot 2017, eq. 7.86)."""
    angle = np.linalg.norm(omega, axis=-1)[..., None, None]
    small = angle < 1e-2
    t = np.where(small, 1.0, angle)
    sin, cos = np.sin(t), np.cos(t)
    s = angle**2
    c1 = np.where(small, 1 / 6 - s / 120, (t - sin) / t**3)
    c2 = np.where(small, 1 / 24 - s / 720, (t**2 + 2 * cos - 2) / (2 * t**4))
    c3 = np.where(small, 1 / 120 - s / 2520, (2 * t - 3 * sin + t * cos) / (2 * t**5))
    W, V = so3.hat(omega), so3.hat(v)
    WV, VW = W @ V, V @ W
    WVW = WV @ W
    WWV, VWW = W @ WV, VW @ W
    Q: FloatArray = 0.5 * V + c1 * (WV + VW + WVW) + c2 * (WWV + VWW - 3 * WVW)
    Q += c3 * (WVW @ W + W @ WVW)
    return Q
