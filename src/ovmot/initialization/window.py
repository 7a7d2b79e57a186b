"""The unknowns of the initializer's bundle adjustment: a window of keyframes, and its box-plus.

Error coordinates, in order: gyro bias, accelerometer bias, time offset, calibration (the common
ones, as in the filter's state); then rotation, position and velocity of each keyframe (9 each).
Rotation errors are on the right, everything else is additive. World has gravity along -z, so the
direction of gravity is in the rotations.
"""

from dataclasses import dataclass, replace

import numpy as np

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.vio.online_calibration import OnlineCalibration
from ovmot.vio.state import (
    CLONE_SIZE,
    GYRO_BIAS,
    N_BASE,
    POSITION,
    THETA,
    TIME_OFFSET,
    VELOCITY,
    Clones,
    ImuState,
    State,
)

KEYFRAME_SIZE = 9
_FIRST_COMMON = GYRO_BIAS.start  # of the filter's coordinates
BIAS_OF_GYRO = slice(0, 3)
BIAS_OF_ACCEL = slice(3, 6)
OFFSET = TIME_OFFSET - _FIRST_COMMON


@dataclass(frozen=True, slots=True)
class KeyframeWindow:
    """K keyframes: states of the rig at times `imu_ns` (K,) on the IMU's clock.

    `T_world_imu` (K, 4, 4) and `velocity` (K, 3), m/s, in world; `gyro` (K, 3): measured rates,
    rad/s; `gyro_bias`, `accel_bias` (3,), common to all. `offset_s`: by how much the images were
    exposed later than at those times, the deviation of the time offset from the one by which
    `imu_ns` was made.
    """

    imu_ns: IntArray
    T_world_imu: FloatArray
    velocity: FloatArray
    gyro: FloatArray
    gyro_bias: FloatArray
    accel_bias: FloatArray
    offset_s: float
    calibration: OnlineCalibration

    def __len__(self) -> int:
        return len(self.imu_ns)

    @property
    def n_common(self) -> int:
        """Number of error coordinates common to all keyframes."""
        return N_BASE - _FIRST_COMMON + len(self.calibration)

    @property
    def size(self) -> int:
        """Length of the error vector."""
        return self.n_common + KEYFRAME_SIZE * len(self)

    def columns(self, keyframe: int) -> slice:
        """Columns of one keyframe in the error vector."""
        start = self.n_common + KEYFRAME_SIZE * keyframe
        return slice(start, start + KEYFRAME_SIZE)


def window_plus(window: KeyframeWindow, error: FloatArray) -> KeyframeWindow:
    """The window plus an error vector (N,)."""
    n = window.n_common
    d = error[n:].reshape(len(window), KEYFRAME_SIZE)
    T = window.T_world_imu
    R = so3.project_to_rotation(T[:, :3, :3] @ so3.exp(d[:, :3]))
    return replace(
        window,
        T_world_imu=se3.make(R, T[:, :3, 3] + d[:, 3:6]),
        velocity=window.velocity + d[:, 6:],
        gyro_bias=window.gyro_bias + error[BIAS_OF_GYRO],
        accel_bias=window.accel_bias + error[BIAS_OF_ACCEL],
        offset_s=window.offset_s + float(error[OFFSET]),
        calibration=window.calibration.plus(error[OFFSET + 1 : n]),
    )


@dataclass(frozen=True, slots=True)
class ExposurePoses:
    """Poses T_world_imu (K, 4, 4) at the times of exposure, and their Jacobians.

    `by_common` (K, 6, n) by the common coordinates, `by_keyframe` (K, 6, 9) by the keyframe's own.
    """

    T_world_imu: FloatArray
    by_common: FloatArray
    by_keyframe: FloatArray


def exposure_poses(window: KeyframeWindow) -> ExposurePoses:
    """T exp((ω, v) offset): constant rates over the time offset."""
    delay, n = window.offset_s, len(window)
    rate = window.gyro - window.gyro_bias
    rotation = so3.exp(rate * delay)
    T = window.T_world_imu
    by_common = np.zeros((n, CLONE_SIZE, window.n_common))
    by_common[:, :3, BIAS_OF_GYRO] = -delay * so3.right_jacobian(rate * delay)
    by_common[:, :3, OFFSET] = rate
    by_common[:, 3:, OFFSET] = window.velocity
    by_keyframe = np.zeros((n, CLONE_SIZE, KEYFRAME_SIZE))
    by_keyframe[:, :3, :3] = np.swapaxes(rotation, -1, -2)
    by_keyframe[:, 3:, 3:6] = np.eye(3)
    by_keyframe[:, 3:, 6:] = delay * np.eye(3)
    poses = se3.make(T[:, :3, :3] @ rotation, T[:, :3, 3] + delay * window.velocity)
    return ExposurePoses(poses, by_common, by_keyframe)


def exposure_clones(window: KeyframeWindow, frame_ns: IntArray) -> Clones:
    """The window's poses at exposure as clones of frames (K,), latest and first estimates alike."""
    T = exposure_poses(window).T_world_imu
    return Clones(frame_ns, T, T)


def scale_sigma(window: KeyframeWindow, covariance: FloatArray) -> float:
    """Standard deviation of the path's scale, as a share of it; `covariance` (N, N): the window's.

    The scale by least squares of the K positions, relative to the first; infinite without motion.
    """
    path = window.T_world_imu[:, :3, 3] - window.T_world_imu[0, :3, 3]
    square = float((path**2).sum())
    if square == 0.0:
        return float("inf")
    by_window = np.zeros(window.size)
    for k, position in enumerate(path):
        by_window[window.columns(k)][POSITION] = position / square
    return float(np.sqrt(by_window @ covariance @ by_window))


def filter_state(
    window: KeyframeWindow,
    covariance: FloatArray,
    kept: IntArray,
    frame_ns: IntArray,
    time_offset_s: float,
) -> State:
    """The filter's state at the last keyframe, with the keyframes `kept` (M,) as its clones.

    `covariance` (N, N): that of the window, of which the other keyframes are marginalized;
    `frame_ns` (M,): stamps of the kept frames; `time_offset_s`: the one by which `imu_ns` was made.
    """
    poses = exposure_poses(window)
    n, first_clone = window.n_common, N_BASE + window.n_common - (N_BASE - _FIRST_COMMON)
    G = np.zeros((first_clone + CLONE_SIZE * len(kept), window.size))
    last = window.columns(len(window) - 1).start
    for block in (THETA, POSITION, VELOCITY):
        G[block, last + block.start : last + block.stop] = np.eye(3)
    G[_FIRST_COMMON:first_clone, :n] = np.eye(n)
    for row, k in enumerate(kept):
        rows = slice(first_clone + CLONE_SIZE * row, first_clone + CLONE_SIZE * (row + 1))
        G[rows, :n] = poses.by_common[k]
        G[rows, window.columns(k)] = poses.by_keyframe[k]
    imu = ImuState(
        window.T_world_imu[-1, :3, :3],
        window.T_world_imu[-1, :3, 3],
        window.velocity[-1],
        window.gyro_bias,
        window.accel_bias,
    )
    T = poses.T_world_imu[kept]
    P = G @ covariance @ G.T
    return State(
        int(window.imu_ns[-1]), imu, imu, time_offset_s + window.offset_s, Clones(frame_ns, T, T),
        0.5 * (P + P.T), window.calibration,
    )  # fmt: skip
