"""The filter's state, its error coordinates and its box-plus.

Error state, in order: IMU (rotation, position, velocity, gyro bias, accelerometer bias; 15),
calibration (time offset; 1; then the parts that are estimated, then what is only considered),
clones (rotation, position; 6 each, oldest first), landmarks (SLAM features; 3 each, or 1). Rotation
errors are on the right: R_true = R_est · exp(δθ); everything else is additive.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.geometry import so3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.vio.landmarks import Landmarks, no_landmarks
from ovmot.vio.online_calibration import OnlineCalibration
from ovmot.vio.pose_kernel import moved_poses_compiled
from ovmot.vio.propagation_kernel import covariance_of_compiled

THETA, POSITION, VELOCITY = slice(0, 3), slice(3, 6), slice(6, 9)
GYRO_BIAS, ACCEL_BIAS = slice(9, 12), slice(12, 15)
TIME_OFFSET = 15
N_IMU = 15
N_BASE = N_IMU + 1
"""Coordinates that are always there: the IMU and the time offset."""
CLONE_SIZE = 6
_NO_CALIBRATION = OnlineCalibration()
_NO_LANDMARKS = no_landmarks()


@dataclass(frozen=True, slots=True)
class ImuState:
    """Rotation (3, 3), position (3,), m, and velocity (3,), m/s, of the IMU in world; biases (3,).

    Units of the biases: rad/s and m/s².
    """

    R_world_imu: FloatArray
    position: FloatArray
    velocity: FloatArray
    gyro_bias: FloatArray
    accel_bias: FloatArray


@dataclass(frozen=True, slots=True)
class Clones:
    """K past poses: stamps (K,) of their frames, T_world_imu (K, 4, 4), and first estimates."""

    timestamp_ns: IntArray
    T_world_imu: FloatArray
    T_world_imu_first: FloatArray

    def __len__(self) -> int:
        return len(self.timestamp_ns)


@dataclass(frozen=True, slots=True)
class State:
    """The whole filter: estimate, first estimates and covariance (N, N) of the error state.

    `timestamp_ns` is the estimate's time on the IMU's clock. `imu_first` holds the values at which
    the Jacobians of the next propagation start (first-estimate Jacobians, G. Huang et al., ISER
    2008). `time_offset_s`: t_imu = t_camera + offset.
    """

    timestamp_ns: int
    imu: ImuState
    imu_first: ImuState
    time_offset_s: float
    clones: Clones
    covariance: FloatArray
    calibration: OnlineCalibration = _NO_CALIBRATION
    landmarks: Landmarks = _NO_LANDMARKS

    @property
    def first_clone(self) -> int:
        """First column of the clones in the error state."""
        return N_BASE + len(self.calibration)

    @property
    def first_landmark(self) -> int:
        """First column of the landmarks in the error state."""
        return self.first_clone + CLONE_SIZE * len(self.clones)

    @property
    def calibration_columns(self) -> slice:
        """Columns of the calibration that is estimated online, without the time offset."""
        return slice(N_BASE, self.first_clone)

    @property
    def considered(self) -> tuple[int, int]:
        """First and one past the last of the coordinates that no update changes."""
        return self.first_clone - self.calibration.n_considered, self.first_clone

    @property
    def clone_covariance(self) -> FloatArray:
        """The marginal covariance (6K, 6K) of the clones."""
        window = slice(self.first_clone, self.first_landmark)
        return self.covariance[window, window]

    def clone_columns(self, index: int) -> slice:
        """Columns of clone number `index` in the error state."""
        start = self.first_clone + CLONE_SIZE * index
        return slice(start, start + CLONE_SIZE)


def no_clones() -> Clones:
    """An empty window."""
    return Clones(np.empty(0, dtype=np.int64), np.empty((0, 4, 4)), np.empty((0, 4, 4)))


def with_landmarks(state: State, landmarks: Landmarks, covariance: FloatArray) -> State:
    """The state with other landmarks, and the covariance (N, N) with them."""
    return State(
        state.timestamp_ns, state.imu, state.imu_first, state.time_offset_s, state.clones,
        covariance, state.calibration, landmarks,
    )  # fmt: skip


def box_plus(state: State, error: FloatArray, covariance: FloatArray | None = None) -> State:
    """The state plus an error vector (N,): estimates change, first estimates stay.

    `covariance` (N, N): that of the new estimate; None: it stays.
    """
    clones, imu = state.clones, state.imu
    poses, R, position = moved_poses_compiled(
        clones.T_world_imu, imu.R_world_imu, imu.position, error, state.first_clone
    )
    moved = ImuState(
        R_world_imu=R,
        position=position,
        velocity=imu.velocity + error[VELOCITY],
        gyro_bias=imu.gyro_bias + error[GYRO_BIAS],
        accel_bias=imu.accel_bias + error[ACCEL_BIAS],
    )
    return State(
        state.timestamp_ns,
        moved,
        state.imu_first,
        state.time_offset_s + float(error[TIME_OFFSET]),
        Clones(clones.timestamp_ns, poses, clones.T_world_imu_first),
        state.covariance if covariance is None else covariance,
        state.calibration.plus(error[state.calibration_columns]),
        state.landmarks.plus(error[state.first_landmark :]),
    )


def box_minus(state: State, reference: State) -> FloatArray:
    """The error vector (N,) with box_plus(reference, error) = state; same parts in both."""

    def rotation(R: FloatArray, R_reference: FloatArray) -> FloatArray:
        return so3.log(np.swapaxes(R_reference, -1, -2) @ R)

    a, b = state.imu, reference.imu
    parts = [
        rotation(a.R_world_imu, b.R_world_imu),
        a.position - b.position,
        a.velocity - b.velocity,
        a.gyro_bias - b.gyro_bias,
        a.accel_bias - b.accel_bias,
        np.array([state.time_offset_s - reference.time_offset_s]),
        state.calibration.deviation - reference.calibration.deviation,
    ]
    A, B = state.clones.T_world_imu, reference.clones.T_world_imu
    theta = rotation(A[:, :3, :3], B[:, :3, :3])
    parts.append(np.concatenate([theta, A[:, :3, 3] - B[:, :3, 3]], axis=1).ravel())
    parts.append(state.landmarks.minus(reference.landmarks))
    return np.concatenate(parts)


def marginalize_clone(state: State, index: int) -> State:
    """The state without clone number `index`: its rows and columns of the covariance go.

    No landmark may be anchored there any more; see `slam_features.change_anchor`.
    """
    clones, columns = state.clones, state.clone_columns(index)
    kept = np.arange(len(state.covariance) - CLONE_SIZE)
    kept[columns.start :] += CLONE_SIZE
    stays = np.arange(len(clones) - 1)
    stays[index:] += 1
    others = Clones(
        clones.timestamp_ns[stays], clones.T_world_imu[stays], clones.T_world_imu_first[stays]
    )
    return State(
        state.timestamp_ns, state.imu, state.imu_first, state.time_offset_s, others,
        covariance_of_compiled(state.covariance, kept), state.calibration, state.landmarks,
    )  # fmt: skip


def marginalize_landmarks(state: State, marginalized: BoolArray) -> State:
    """The state without the `marginalized` landmarks (L,)."""
    if not marginalized.any():
        return state
    stays = np.ones(len(state.covariance), dtype=np.bool_)
    stays[state.first_landmark :] = np.repeat(~marginalized, state.landmarks.size)
    covariance = covariance_of_compiled(state.covariance, np.flatnonzero(stays))
    return with_landmarks(state, state.landmarks.rows(~marginalized), covariance)


def pose_matrix(imu: ImuState) -> FloatArray:
    """T_world_imu (4, 4) of an IMU state."""
    T = np.zeros((4, 4))
    T[:3, :3], T[:3, 3], T[3, 3] = imu.R_world_imu, imu.position, 1.0
    return T
