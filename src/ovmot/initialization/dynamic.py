"""Start in motion: stereo gives the scale, the IMU gives gravity, velocity and biases.

Stereo motion from frame to frame is chained to positions p_k and rotations R_k of the IMU in its
frame at the window's start. The gyro bias is that which turns the integrated rotations into R_k;
then p_k = v t_k + g t_k²/2 + α_k + ∂α_k/∂b_a b_a is linear in velocity, gravity and accelerometer
bias (in the manner of J. Domínguez-Conti et al., "Visual-inertial SLAM initialization: a general
linear formulation", ISMAR 2018, with the scale known), and is solved again with |g| given.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.geometry.stereo_motion import solve_stereo_motion
from ovmot.initialization.occupied_space import PIXEL_SIGMA, normalized_sigma, space_filled
from ovmot.initialization.static import MAX_GRAVITY_ERROR
from ovmot.types import FrontendFrame, ImuData, ImuNoise
from ovmot.vio.imu_buffer import integrated_rotation
from ovmot.vio.propagation import Propagation, integrate_rk4, propagate_imu
from ovmot.vio.state import ACCEL_BIAS, GYRO_BIAS, N_IMU, POSITION, THETA, ImuState

_GYRO_BIAS_SIGMA = 0.05  # rad/s, prior
_ROTATION_SIGMA = 0.01  # rad, of the gyro's rotation between two frames, bias unknown
_MIN_STEP_SIGMA = 0.003  # m, per frame
_MAX_BODIES = 3
_MAX_RMS = 2.0  # standard deviations, root mean square
_INFLATION = 2.0  # on the path's standard deviations: its errors are not independent
_NOTHING = np.empty(0, dtype=np.int64)


class CannotInitialize(Exception):  # noqa: N818 - no fault of anyone: the filter waits on
    """Which test failed, with its numbers."""


@dataclass(frozen=True, slots=True)
class InitializationPrior:
    """Gravity in m/s² and the standard deviation of the accelerometer bias in m/s²."""

    gravity: float
    accel_bias_sigma: float


@dataclass(frozen=True, slots=True)
class StereoPath:
    """IMU poses T_start_k (K, 4, 4) of the window in its first frame, and position sigmas (K,).

    `feature_id`: the features that moved along.
    """

    T_start_imu: FloatArray
    sigma: FloatArray
    feature_id: IntArray


@dataclass(frozen=True, slots=True)
class DynamicSolution:
    """The state `first` at the window's first frame, poses T_world_imu (K, 4, 4) at all, and the
    features of the world."""

    first: ImuState
    T_world_imu: FloatArray
    feature_id: IntArray


def dynamic_initialization(
    frames: Sequence[FrontendFrame],
    imu: Sequence[ImuData],
    rig: StereoRig,
    noise: ImuNoise,
    prior: InitializationPrior,
) -> DynamicSolution:
    """A start from the features of K frames and the K - 1 IMU pieces between.

    Not the majority of the points decides what the rig moves against: bodies that move alike are
    tried, the largest first, and of those whose motion the IMU has felt the one that fills most
    room is the world. Raises `CannotInitialize` when the images give no motion, or none that
    fits the IMU.
    """
    found: list[tuple[int, DynamicSolution]] = []
    reasons: list[str] = []
    others = np.empty(0, dtype=np.int64)
    for _ in range(_MAX_BODIES):
        try:
            path = stereo_path(frames, imu, rig, others)
        except CannotInitialize as error:
            reasons.append(str(error))
            break
        try:
            start = fit_path(path, imu, noise, prior)
        except CannotInitialize as error:
            reasons.append(str(error))
        else:
            found.append((_space(frames, path.feature_id, rig), start))
        others = np.union1d(others, path.feature_id)
    if not found:
        raise CannotInitialize("; another body: ".join(reasons))
    return max(found, key=lambda candidate: candidate[0])[1]


def fit_path(
    path: StereoPath, imu: Sequence[ImuData], noise: ImuNoise, prior: InitializationPrior
) -> DynamicSolution:
    """Velocity, gravity and biases by which the IMU would have felt this path.

    Raises `CannotInitialize` when gravity comes out wrong or the two do not fit together.
    """
    bias = _gyro_bias(path, imu, noise)
    pieces = _integrate_from_start(imu, bias, noise)
    t = np.array([(i.timestamp_ns[-1] - imu[0].timestamp_ns[0]) * 1e-9 for i in imu])
    alpha = np.array([x.imu.position for x in pieces])
    by_bias = np.array([x.transition[POSITION, ACCEL_BIAS] for x in pieces])
    p, sigma = path.T_start_imu[1:, :3, 3], path.sigma[1:]
    free = _solve_free(p - alpha, t, sigma)
    if abs(np.linalg.norm(free) - prior.gravity) > MAX_GRAVITY_ERROR:
        raise CannotInitialize(
            f"gravity from stereo motion and IMU is {np.linalg.norm(free):.2f} m/s²"
            f" (within {MAX_GRAVITY_ERROR:g} of {prior.gravity:g})"
        )
    fit = _solve_with_gravity(p - alpha, by_bias, t, sigma, free, prior)
    if fit.misfit > _MAX_RMS:
        raise CannotInitialize(
            f"IMU and stereo motion differ by {fit.misfit:.1f} sigma (at most {_MAX_RMS:g})"
        )
    R = _level(fit.gravity)
    zero = np.zeros(3)
    first = ImuState(R, zero, R @ fit.velocity, bias, fit.accel_bias)
    return DynamicSolution(first, se3.make(R, zero) @ path.T_start_imu, path.feature_id)


def stereo_path(
    frames: Sequence[FrontendFrame],
    imu: Sequence[ImuData],
    rig: StereoRig,
    others: IntArray = _NOTHING,
) -> StereoPath:
    """Chain the stereo motion of consecutive frames; the gyroscope proposes each rotation.

    Features (N,) of `others` are left out, and from each step on those that did not move along:
    the path stays with one body.
    """
    R_cam_imu = rig.T_imu_cam0[:3, :3].T
    sigma = normalized_sigma(rig, PIXEL_SIGMA)
    T_start_cam = [np.eye(4)]
    variance = [0.0]
    ids = np.empty(0, dtype=np.int64)
    for before, now, samples in zip(frames[:-1], frames[1:], imu, strict=True):
        seen, a, b = np.intersect1d(before.feature_id, now.feature_id, return_indices=True)
        left = ~np.isin(seen, others)
        seen, a, b = seen[left], a[left], b[left]
        R = R_cam_imu @ integrated_rotation(samples).T @ R_cam_imu.T
        motion = solve_stereo_motion(
            before.normalized[a], now.normalized[b], rig.T_cam1_cam0, R, sigma, _ROTATION_SIGMA
        )
        if motion is None:
            raise CannotInitialize(f"no common stereo motion among {len(a)} tracked points")
        in_stereo = np.isfinite(before.normalized[a] + now.normalized[b]).all(axis=1)
        others = np.union1d(others, seen[in_stereo & ~motion.inlier])
        ids = np.union1d(ids, seen[motion.inlier])
        T_start_cam.append(T_start_cam[-1] @ se3.inverse(motion.T_now_before))
        spread = float(np.trace(motion.covariance[3:, 3:])) / 3.0
        variance.append(variance[-1] + spread + _MIN_STEP_SIGMA**2)
    T = rig.T_imu_cam0 @ np.array(T_start_cam) @ se3.inverse(rig.T_imu_cam0)
    ids = np.setdiff1d(ids, others)
    return StereoPath(T, _INFLATION * np.sqrt(np.array(variance)), ids)


def _space(frames: Sequence[FrontendFrame], feature_id: IntArray, rig: StereoRig) -> int:
    """How much room these features fill in the middle frame."""
    middle = frames[len(frames) // 2]
    return space_filled(middle.normalized[np.isin(middle.feature_id, feature_id)], rig)


def _integrate_from_start(
    imu: Sequence[ImuData], gyro_bias: FloatArray, noise: ImuNoise
) -> list[Propagation]:
    """Motion without gravity from the first sample to the end of each piece, with Jacobians.

    The noise of each result is that of its last piece only.
    """
    zero = np.zeros(3)
    state = ImuState(np.eye(3), zero, zero, gyro_bias, zero)
    transition = np.eye(N_IMU)
    out: list[Propagation] = []
    for samples in imu:
        step = propagate_imu(state, state, samples, noise, 0.0, integrate_rk4)
        state, transition = step.imu, step.transition[:, :N_IMU] @ transition
        out.append(replace(step, transition=transition))
    return out


def _gyro_bias(path: StereoPath, imu: Sequence[ImuData], noise: ImuNoise) -> FloatArray:
    """Gauss-Newton on the rotations: log(ΔR_kᵀ R_k) = ∂θ_k/∂b_g δb_g, with a prior."""
    bias = np.zeros(3)
    sigma = 0.002 * np.sqrt(np.arange(1, len(path.sigma)))
    for _ in range(3):
        pieces = _integrate_from_start(imu, bias, noise)
        N, c = np.eye(3) / _GYRO_BIAS_SIGMA**2, -bias / _GYRO_BIAS_SIGMA**2
        for k, piece in enumerate(pieces):
            J = piece.transition[THETA, GYRO_BIAS]
            r = so3.log(piece.imu.R_world_imu.T @ path.T_start_imu[k + 1, :3, :3])
            N = N + J.T @ J / sigma[k] ** 2
            c = c + J.T @ r / sigma[k] ** 2
        bias = bias + np.linalg.solve(N, c)
    return bias


def _solve_free(moved: FloatArray, t: FloatArray, sigma: FloatArray) -> FloatArray:
    """Gravity (3,) in the start frame, its length free; bias taken as zero, velocity eliminated."""
    A = np.stack([t, 0.5 * t**2], axis=1) / sigma[:, None]
    solution, *_ = np.linalg.lstsq(A, moved / sigma[:, None], rcond=None)
    gravity: FloatArray = solution[1]
    return gravity


@dataclass(frozen=True, slots=True)
class _Fit:
    """Velocity, gravity, accelerometer bias in the start frame; root mean square misfit in
    sigmas."""

    velocity: FloatArray
    gravity: FloatArray
    accel_bias: FloatArray
    misfit: float


def _solve_with_gravity(
    moved: FloatArray,
    by_bias: FloatArray,
    t: FloatArray,
    sigma: FloatArray,
    gravity_start: FloatArray,
    prior: InitializationPrior,
) -> _Fit:
    """Gauss-Newton with |g| known: g = exp(B τ) g, two angles τ about axes B normal to g."""
    g = gravity_start * prior.gravity / np.linalg.norm(gravity_start)
    v, ba = np.zeros(3), np.zeros(3)
    weight = 1.0 / sigma**2
    for _ in range(5):
        B = np.linalg.svd(g[None])[2][1:].T
        J = np.zeros((len(t), 3, 8))
        J[:, :, :2] = -0.5 * (t**2)[:, None, None] * (so3.hat(g) @ B)
        J[:, :, 2:5] = t[:, None, None] * np.eye(3)
        J[:, :, 5:] = by_bias
        r = moved - t[:, None] * v - 0.5 * (t**2)[:, None] * g - by_bias @ ba
        N = np.einsum("kij,kil,k->jl", J, J, weight)
        c = np.einsum("kij,ki,k->j", J, r, weight)
        N[5:, 5:] += np.eye(3) / prior.accel_bias_sigma**2
        c[5:] -= ba / prior.accel_bias_sigma**2
        step = np.linalg.solve(N, c)
        g = so3.exp(B @ step[:2]) @ g
        v, ba = v + step[2:5], ba + step[5:]
    r = moved - t[:, None] * v - 0.5 * (t**2)[:, None] * g - by_bias @ ba
    misfit = float(np.sqrt(np.mean((r / sigma[:, None]) ** 2)))
    return _Fit(v, g, ba, misfit)


def _level(gravity: FloatArray) -> FloatArray:
    """Rotation (3, 3) that turns gravity to -z, with zero yaw of the x axis."""
    R = so3.between_vectors(gravity, np.array([0.0, 0.0, -1.0]))
    yaw = np.arctan2(R[1, 0], R[0, 0])
    return so3.exp(np.array([0.0, 0.0, -yaw])) @ R
