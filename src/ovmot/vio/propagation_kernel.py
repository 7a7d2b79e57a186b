"""The compiled chain of IMU sample pairs, and the covariance of the state by blocks.

The error state's order is that of `vio.state`. tests/vio/test_propagation_kernel.py holds the plain
NumPy twins.
"""

from pathlib import Path

import numpy as np

from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.kernels.cache import code_folder, compiled, part
from ovmot.kernels.rotations import multiply, orthonormalize, right_jacobian, rotation_exp

_THETA, _POSITION, _VELOCITY, _BIAS = 0, 3, 6, 9
_N_IMU, _POSE = 15, 6


@part
def _times_hat(R: FloatArray, v: FloatArray, out: FloatArray) -> None:
    """out (3, 3) = R [v]x."""
    for i in range(3):
        out[i, 0] = R[i, 1] * v[2] - R[i, 2] * v[1]
        out[i, 1] = R[i, 2] * v[0] - R[i, 0] * v[2]
        out[i, 2] = R[i, 0] * v[1] - R[i, 1] * v[0]


@part
def _pair_matrices(
    R: FloatArray, turn: FloatArray, dv: FloatArray, dp: FloatArray, h: float, force: FloatArray,
    by_rate: FloatArray, by_force: FloatArray, Jr: FloatArray, F: FloatArray,
) -> None:  # fmt: skip
    """F (9, 15 + C): the motion's error after a pair, by that before it and by the calibration.

    `R` at the pair's start; `turn`, `dv`, `dp`: its increments; `force` (3,): mean; `by_rate`,
    `by_force` (3, 6 + C): of the mean rate and force by biases and calibration; `Jr` (3, 3): right
    Jacobian of the pair's rotation.
    """
    F[:] = 0.0
    turned, hat_p, hat_v = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    _times_hat(R, force, turned)
    for i in range(3):
        for j in range(3):
            F[_THETA + i, _THETA + j] = turn[j, i]
        F[_POSITION + i, _POSITION + i] = F[_VELOCITY + i, _VELOCITY + i] = 1.0
        F[_POSITION + i, _VELOCITY + i] = h
        for c in range(by_rate.shape[1]):
            for j in range(3):
                by_turn, by_push = h * turned[i, j] * by_rate[j, c], R[i, j] * by_force[j, c]
                F[_THETA + i, _BIAS + c] += h * Jr[i, j] * by_rate[j, c]
                F[_POSITION + i, _BIAS + c] += h * h * (0.5 * by_push - by_turn / 6.0)
                F[_VELOCITY + i, _BIAS + c] += h * (by_push - 0.5 * by_turn)
    _times_hat(R, dp, hat_p)
    _times_hat(R, dv, hat_v)
    for i in range(3):
        for j in range(3):
            F[_POSITION + i, _THETA + j] = -hat_p[i, j]
            F[_VELOCITY + i, _THETA + j] = -hat_v[i, j]


@part
def _advance(F: FloatArray, A: FloatArray, moved: FloatArray) -> None:
    """A's first nine rows become F[:, :15] A, A (15, n)."""
    for i in range(_BIAS):
        for c in range(A.shape[1]):
            moved[i, c] = 0.0
        for k in range(_N_IMU):
            for c in range(A.shape[1]):
                moved[i, c] += F[i, k] * A[k, c]
    for i in range(_BIAS):
        for c in range(A.shape[1]):
            A[i, c] = moved[i, c]


@part
def _add_noise(
    Q: FloatArray, Jr: FloatArray, h: float, gyro: float, accel: float, walk: FloatArray
) -> None:
    """Add a pair's noise to Q (15, 15). All axes have the same, so it needs no rotation."""
    for i in range(3):
        for j in range(3):
            for k in range(3):
                Q[_THETA + i, _THETA + j] += gyro * h * Jr[i, k] * Jr[j, k]
        Q[_VELOCITY + i, _VELOCITY + i] += accel * h
        Q[_POSITION + i, _POSITION + i] += accel * h * h * h / 4.0
        Q[_POSITION + i, _VELOCITY + i] += accel * h * h / 2.0
        Q[_VELOCITY + i, _POSITION + i] += accel * h * h / 2.0
        Q[_BIAS + i, _BIAS + i] += walk[0] * h
        Q[_BIAS + 3 + i, _BIAS + 3 + i] += walk[1] * h


@part
def _move(
    T: FloatArray, v: FloatArray, turn: FloatArray, dv: FloatArray, dp: FloatArray, h: float,
    gravity: float,
) -> None:  # fmt: skip
    """Pose T and velocity v (3,) after a pair, in place."""
    R = np.empty((3, 3))
    for i in range(3):
        fall = gravity * h if i == 2 else 0.0
        T[i, 3] += v[i] * h - 0.5 * fall * h
        v[i] -= fall
        for j in range(3):
            T[i, 3] += T[i, j] * dp[j]
            v[i] += T[i, j] * dv[j]
    multiply(T, turn, R)
    for i in range(3):
        for j in range(3):
            T[i, j] = R[i, j]


def chain_pairs(
    T_world_imu: FloatArray,
    velocity: FloatArray,
    gravity: float,
    turn: FloatArray,
    dv: FloatArray,
    dp: FloatArray,
    dt: FloatArray,
    rate: FloatArray,
    force: FloatArray,
    by_rate: FloatArray,
    by_force: FloatArray,
    variance: FloatArray,
    walk: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """The pose (4, 4) and velocity (3,) after n pairs, Φ (15, 16 + C) and Q (15, 15).

    From a pose and a velocity: `turn` (n, 3, 3), `dv`, `dp` (n, 3), `dt` (n,): the pairs'
    `Increments`; `rate`, `force` (n, 3): mean rates and forces; `by_rate`, `by_force` (n, 3,
    6 + C): see `imu_sensitivity`; `variance` (n, 2): of the white noise of gyroscope and
    accelerometer, squared densities; `walk` (2,): of their biases' walks. Φ's column 15, the time
    offset's, is zero.
    """
    T, v, n_calibration = T_world_imu.copy(), velocity.copy(), by_rate.shape[2] - 6
    Phi = np.zeros((_N_IMU, _N_IMU + 1 + n_calibration))
    for i in range(_N_IMU):
        Phi[i, i] = 1.0
    Q, F = np.zeros((_N_IMU, _N_IMU)), np.empty((_BIAS, _N_IMU + n_calibration))
    Jr, turned, moved = np.empty((3, 3)), np.empty(3), np.empty(Phi.shape)
    for n in range(len(dt)):
        h = dt[n]
        for i in range(3):
            turned[i] = rate[n, i] * h
        right_jacobian(turned, Jr)
        _pair_matrices(T, turn[n], dv[n], dp[n], h, force[n], by_rate[n], by_force[n], Jr, F)
        for _ in range(2):  # F Q Fᵀ, Q being symmetric
            _advance(F, Q, moved)
            for i in range(_N_IMU):
                for j in range(i):
                    below = Q[i, j]
                    Q[i, j] = Q[j, i]
                    Q[j, i] = below
        _add_noise(Q, Jr, h, variance[n, 0], variance[n, 1], walk)
        _advance(F, Phi, moved)
        for i in range(_BIAS):
            for c in range(n_calibration):
                Phi[i, _N_IMU + 1 + c] += F[i, _N_IMU + c]
        _move(T, v, turn[n], dv[n], dp[n], h, gravity)
    orthonormalize(T)
    for i in range(_N_IMU):
        for j in range(i):
            Q[i, j] = Q[j, i] = 0.5 * (Q[i, j] + Q[j, i])
    return T, v, Phi, Q


@part
def _copy(T: FloatArray, out: FloatArray) -> None:
    """out (4, 4) = T: for an assignment of slices numba compiles the text of its error message."""
    for i in range(4):
        for j in range(4):
            out[i, j] = T[i, j]


def chain_poses(
    T_world_imu: FloatArray, velocity: FloatArray, gravity: float,
    gyro: FloatArray, accel: FloatArray, dt: FloatArray,
) -> FloatArray:  # fmt: skip
    """Poses (n + 1, 4, 4) at n + 1 samples, from that at the first one; their mean alone.

    `gyro`, `accel` (n + 1, 3): rates and forces without bias, their means constant over the `dt`
    (n,) of a pair.
    """
    poses, v = np.empty((len(dt) + 1, 4, 4)), velocity.copy()
    T = T_world_imu.copy()
    _copy(T, poses[0])
    turned, turn, dv, dp = np.empty(3), np.empty((3, 3)), np.empty(3), np.empty(3)
    for n in range(len(dt)):
        h = dt[n]
        for i in range(3):
            turned[i] = 0.5 * (gyro[n, i] + gyro[n + 1, i]) * h
            dv[i] = 0.5 * (accel[n, i] + accel[n + 1, i]) * h
            dp[i] = 0.5 * dv[i] * h
        rotation_exp(turned, turn)
        _move(T, v, turn, dv, dp, h, gravity)
        _copy(T, poses[n + 1])
    return poses


def propagate_covariance(P: FloatArray, Phi: FloatArray, Q: FloatArray) -> FloatArray:
    """P (N, N) after an interval: its first 15 rows and columns through Φ (15, n), plus Q.

    Φ is over P's first n coordinates.
    """
    out, n = P.copy(), Phi.shape[1]
    for i in range(_N_IMU):
        out[i] = 0.0
        for k in range(n):
            if Phi[i, k] != 0.0:
                for j in range(len(P)):
                    out[i, j] += Phi[i, k] * P[k, j]
    block = np.empty((_N_IMU, _N_IMU))
    for i in range(_N_IMU):
        for j in range(_N_IMU):
            total = Q[i, j]
            for k in range(n):
                total += out[i, k] * Phi[j, k]
            block[i, j] = total
    for i in range(_N_IMU):
        for j in range(_N_IMU):
            out[i, j] = 0.5 * (block[i, j] + block[j, i])
        for j in range(_N_IMU, len(P)):
            out[j, i] = out[i, j]
    return out


def clone_covariance(P: FloatArray, by_offset: FloatArray, at: int, time_offset: int) -> FloatArray:
    """P (N + 6, N + 6) with a copy of the pose's coordinates (0:6) put in before coordinate `at`.

    The copy's error also is that of coordinate `time_offset` times `by_offset` (6,).
    """
    n = len(P)
    out, pose = np.empty((n + _POSE, n + _POSE)), np.empty((_POSE, n))
    for i in range(_POSE):
        for j in range(n):
            pose[i, j] = P[i, j] + by_offset[i] * P[time_offset, j]
    for i in range(n):
        row = i if i < at else i + _POSE
        for j in range(at):
            out[row, j] = P[i, j]
        for j in range(at, n):
            out[row, j + _POSE] = P[i, j]
        for k in range(_POSE):
            out[row, at + k] = out[at + k, row] = pose[k, i]
    for i in range(_POSE):
        for j in range(i + 1):  # equal on both sides, also in the last digit
            value = pose[i, j] + pose[i, time_offset] * by_offset[j]
            out[at + i, at + j] = out[at + j, at + i] = value
    return out


def covariance_of(P: FloatArray, kept: IntArray) -> FloatArray:
    """The rows and columns `kept` (n,) of P (N, N)."""
    n = len(kept)
    out = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            out[i, j] = P[kept[i], kept[j]]
    return out


_FOLDER = code_folder(Path(__file__))
chain_pairs_compiled = compiled(chain_pairs, _FOLDER)
chain_poses_compiled = compiled(chain_poses, _FOLDER)
propagate_covariance_compiled = compiled(propagate_covariance, _FOLDER)
clone_covariance_compiled = compiled(clone_covariance, _FOLDER)
covariance_of_compiled = compiled(covariance_of, _FOLDER)
