"""Dynamic initialization: stereo gives the scale; the IMU gives gravity, velocity and biases.

Stereo motion from frame to frame is chained to positions p_k and rotations R_k of the IMU in its
frame at the window's start. The gyro bias is the one by which the integrated rotations become R_k;
then p_k = v t_k + g t_k²/2 + α_k + ∂α_k/∂b_a b_a is linear in velocity, gravity and accelerometer
bias (in the manner of J. Domínguez-Conti et al., "Visual-inertial SLAM initialization: a general
linear formulation", ISMAR 2018, with the scale known), and is solved again with |g| given.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.errors import InitializationError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.initialization.static import gravity_aligned_rotation
from ovmot.initialization.stereo_path import StereoPath, occupied_cells, stereo_path
from ovmot.physics import GYRO_BIAS_SIGMA_RPS, MAX_ACCEL_BIAS_MPS2
from ovmot.types import FrontendFrame, ImuData, ImuNoise
from ovmot.vio.integrators import integrate_rk4
from ovmot.vio.propagation import Propagation, propagate_imu
from ovmot.vio.state import ACCEL_BIAS, GYRO_BIAS, N_IMU, POSITION, THETA, ImuState

_MAX_RMS = 2.0
"""Root mean square of whitened residuals beyond which a solution is refused."""
_PLAIN_RMS = 8.0
"""And beyond which a body is plainly not the world. A common error of the lens adds to what the
features average out: 0.25 px to 0.4 px over the root of 50, which makes 8 sigma of 2."""


class _UnsureMotionError(InitializationError):
    """A motion that the IMU does not confirm, and does not plainly refute."""


@dataclass(frozen=True, slots=True)
class InitializationPrior:
    """Magnitude of gravity, and standard deviation of the accelerometer bias, both in m/s²."""

    gravity: float
    accel_bias_sigma: float


@dataclass(frozen=True, slots=True)
class DynamicSolution:
    """The state `first` at the first of K frames, poses T_world_imu (K, 4, 4) at all of them, and
    the features (N,) of the world."""

    first: ImuState
    T_world_imu: FloatArray
    feature_id: IntArray


def dynamic_initialization(
    frames: Sequence[FrontendFrame],
    imu: Sequence[ImuData],
    rig: StereoRig,
    noise: ImuNoise,
    prior: InitializationPrior,
    *,
    path: StereoPath | None = None,
    max_bodies: int = 3,
) -> DynamicSolution:
    """The initial state by the features of K frames and the K - 1 IMU intervals between them.

    The world is not the body with most points: up to `max_bodies`, each of points that move alike,
    are tried, the one with most points first, and of those whose motion agrees with the IMU the one
    that occupies most space is the world. `path`: that of the first body, where it is known. Raises
    `InitializationError` where the images give no motion, or none that agrees, or where a body that
    occupies more space than this one may be the world too.
    """
    best: tuple[int, DynamicSolution] | None = None
    unsure = 0, ""
    reasons: list[str] = []
    left = np.unique(np.concatenate([frame.feature_id for frame in frames]))
    other_bodies = np.empty(0, dtype=np.int64)
    for _ in range(max_bodies):
        # no body occupies more than all features that are left
        if best is not None and _cells_of(left, frames, rig) <= best[0]:
            break
        try:
            path = path or stereo_path(frames, imu, rig, other_bodies)
        except InitializationError as error:
            reasons.append(str(error))
            break
        try:
            solution = align_with_imu(path, imu, noise, prior)
        except InitializationError as error:
            reasons.append(str(error))
            if isinstance(error, _UnsureMotionError):
                unsure = max(unsure, (_cells_of(path.feature_id, frames, rig), str(error)))
        else:
            cells = _cells_of(path.feature_id, frames, rig)
            if best is None or cells > best[0]:
                best = cells, solution
        other_bodies = np.union1d(other_bodies, path.feature_id)
        left, path = np.setdiff1d(left, path.feature_id), None
    if best is None:
        raise InitializationError("; another body: ".join(reasons))
    if unsure[0] > best[0]:
        raise InitializationError(f"{unsure[1]}; a smaller body agrees")
    return best[1]


def align_with_imu(
    path: StereoPath, imu: Sequence[ImuData], noise: ImuNoise, prior: InitializationPrior
) -> DynamicSolution:
    """Visual-inertial alignment: velocity, gravity and biases by which the IMU measures this path.

    Raises `InitializationError` where gravity comes out wrong or path and IMU do not agree.
    """
    gyro_bias = _gyro_bias(path, imu, noise)
    preintegrated = preintegrate_from_first(imu, gyro_bias, noise)
    t = np.array([(i.timestamp_ns[-1] - imu[0].timestamp_ns[0]) * 1e-9 for i in imu])
    alpha = np.array([x.imu.position for x in preintegrated])
    by_bias = np.array([x.transition[POSITION, ACCEL_BIAS] for x in preintegrated])
    p = path.T_first_imu[1:, :3, 3]
    sigma = _total_sigma(path.position_sigma, preintegrated, POSITION)
    gravity = _solve_gravity(p - alpha, t, sigma)
    if abs(np.linalg.norm(gravity) - prior.gravity) > MAX_ACCEL_BIAS_MPS2:
        raise InitializationError(
            f"gravity from stereo motion and IMU is {np.linalg.norm(gravity):.2f} m/s²"
            f" (within {MAX_ACCEL_BIAS_MPS2:g} of {prior.gravity:g})"
        )
    fit = _refine_with_known_gravity(p - alpha, by_bias, t, sigma, gravity, prior)
    if fit.rms > _MAX_RMS:
        kind = InitializationError if fit.rms > _PLAIN_RMS else _UnsureMotionError
        raise kind(f"IMU and stereo motion differ by {fit.rms:.1f} sigma (at most {_MAX_RMS:g})")
    R = gravity_aligned_rotation(-fit.gravity)
    zero = np.zeros(3)
    first = ImuState(R, zero, R @ fit.velocity, gyro_bias, fit.accel_bias)
    return DynamicSolution(first, se3.make(R, zero) @ path.T_first_imu, path.feature_id)


def _cells_of(feature_id: IntArray, frames: Sequence[FrontendFrame], rig: StereoRig) -> int:
    """Cells of space that these features occupy in the middle frame."""
    middle = frames[len(frames) // 2]
    return occupied_cells(middle.normalized[np.isin(middle.feature_id, feature_id)], rig)


def preintegrate_from_first(
    imu: Sequence[ImuData], gyro_bias: FloatArray, noise: ImuNoise
) -> list[Propagation]:
    """Motion without gravity from the first sample to the end of each interval, with its Jacobian
    and noise."""
    zero = np.zeros(3)
    state = ImuState(np.eye(3), zero, zero, gyro_bias, zero)
    transition, Q = np.eye(N_IMU), np.zeros((N_IMU, N_IMU))
    out: list[Propagation] = []
    for samples in imu:
        step = propagate_imu(state, state, samples, noise, 0.0, integrate_rk4)
        F = step.transition[:, :N_IMU]
        state, transition, Q = step.imu, F @ transition, F @ Q @ F.T + step.noise
        out.append(replace(step, transition=transition, noise=Q))
    return out


def _total_sigma(
    path_sigma: FloatArray, preintegrated: Sequence[Propagation], block: slice
) -> FloatArray:
    """Standard deviations (K - 1,), on each axis, between path and IMU after each interval."""
    imu_variance = [np.trace(x.noise[block, block]) / 3.0 for x in preintegrated]
    return np.asarray(np.sqrt(path_sigma[1:] ** 2 + imu_variance))


def _gyro_bias(path: StereoPath, imu: Sequence[ImuData], noise: ImuNoise) -> FloatArray:
    """Gauss-Newton on the rotations: log(ΔR_kᵀ R_k) = ∂θ_k/∂b_g δb_g, with a prior."""
    bias = np.zeros(3)
    for _ in range(3):
        preintegrated = preintegrate_from_first(imu, bias, noise)
        sigma = _total_sigma(path.rotation_sigma, preintegrated, THETA)
        N, c = np.eye(3) / GYRO_BIAS_SIGMA_RPS**2, -bias / GYRO_BIAS_SIGMA_RPS**2
        for k, motion in enumerate(preintegrated):
            J = motion.transition[THETA, GYRO_BIAS]
            r = so3.log(motion.imu.R_world_imu.T @ path.T_first_imu[k + 1, :3, :3])
            N = N + J.T @ J / sigma[k] ** 2
            c = c + J.T @ r / sigma[k] ** 2
        bias = bias + np.linalg.solve(N, c)
    return bias


def _solve_gravity(displacement: FloatArray, t: FloatArray, sigma: FloatArray) -> FloatArray:
    """Gravity (3,) in the first frame, of any magnitude, with the accelerometer bias as zero.

    Least squares in velocity and gravity of `displacement` (K, 3) = v t + g t²/2 at times t (K,).
    """
    A = np.stack([t, 0.5 * t**2], axis=1) / sigma[:, None]
    solution, *_ = np.linalg.lstsq(A, displacement / sigma[:, None], rcond=None)
    gravity: FloatArray = solution[1]
    return gravity


@dataclass(frozen=True, slots=True)
class _Fit:
    """Velocity, gravity, accelerometer bias (3,) in the first frame; RMS of whitened residuals."""

    velocity: FloatArray
    gravity: FloatArray
    accel_bias: FloatArray
    rms: float


def _refine_with_known_gravity(
    displacement: FloatArray,
    by_bias: FloatArray,
    t: FloatArray,
    sigma: FloatArray,
    gravity: FloatArray,
    prior: InitializationPrior,
) -> _Fit:
    """Gauss-Newton with |g| known: g = exp(B τ) g, two angles τ about axes B normal to g."""
    g = gravity * prior.gravity / np.linalg.norm(gravity)
    v, ba = np.zeros(3), np.zeros(3)
    weight = 1.0 / sigma**2
    for _ in range(5):
        B = np.linalg.svd(g[None])[2][1:].T
        J = np.zeros((len(t), 3, 8))
        J[:, :, :2] = -0.5 * (t**2)[:, None, None] * (so3.hat(g) @ B)
        J[:, :, 2:5] = t[:, None, None] * np.eye(3)
        J[:, :, 5:] = by_bias
        r = displacement - t[:, None] * v - 0.5 * (t**2)[:, None] * g - by_bias @ ba
        N = np.einsum("kij,kil,k->jl", J, J, weight)
        c = np.einsum("kij,ki,k->j", J, r, weight)
        N[5:, 5:] += np.eye(3) / prior.accel_bias_sigma**2
        c[5:] -= ba / prior.accel_bias_sigma**2
        step = np.linalg.solve(N, c)
        g = so3.exp(B @ step[:2]) @ g
        v, ba = v + step[2:5], ba + step[5:]
    r = displacement - t[:, None] * v - 0.5 * (t**2)[:, None] * g - by_bias @ ba
    rms = float(np.sqrt(np.mean((r / sigma[:, None]) ** 2)))
    return _Fit(v, g, ba, rms)
