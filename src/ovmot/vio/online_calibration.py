"""The calibration that is estimated online, as deviations from that of the files.

Each part that is switched on has its coordinates in the error state, after the time offset; all
are additive. An extrinsic rotation is R_file exp(φ): its deviation by δ turns it by J_r(φ) δ.
The extrinsics are the mount, the left camera on the IMU, and the stereo pose, the right camera on
the left one: the one is glued by users, the other by who built the rig, and scale hangs on it.
The IMU's model is that of D. Tedaldi et al. (ICRA 2014) with the gyroscope's sensitivity to
acceleration: a = A (a_m - b_a), ω = W (ω_m - S a - b_g), with measured a_m and ω_m.

Where no camera is calibrated online, the image centres are considered (S. F. Schmidt, "Application
of state-space methods to navigation problems", 1966; G. Bierman, "Factorization Methods", 1977,
ch. 8): their errors are in the covariance, correlated with all else, but no update changes them.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.physics import LENS_SIGMA_PX
from ovmot.settings import CalibrationSettings
from ovmot.types import CalibrationEstimate

MOUNT, STEREO = "cam0_pose", "stereo"
CAMERA_INTRINSICS = ("cam0_lens", "cam1_lens")
CENTERS = "centers"
GYRO_MATRIX, ACCEL_MATRIX, G_SENSITIVITY = "gyro_matrix", "accel_matrix", "g_sensitivity"
_UPPER = np.triu_indices(3)
_FOCAL_AND_CENTER = 4
_VIEW = 4  # pixel coordinates of a stereo view
_LEAST_ACROSS = 1e-3
_COORDINATES = {
    "pose": ("rx", "ry", "rz", "x", "y", "z"),
    STEREO: ("rx", "ry", "rz", "length", "down", "forward"),
    "lens": ("fx", "fy", "cx", "cy", *(f"d{k}" for k in range(8))),
    GYRO_MATRIX: tuple(f"{i}{j}" for i in range(3) for j in range(3)),
    ACCEL_MATRIX: tuple(f"{i}{j}" for i, j in zip(*_UPPER, strict=True)),
    G_SENSITIVITY: tuple(f"{i}{j}" for i in range(3) for j in range(3)),
}


_PRIOR_SIGMAS = {
    "distortion": 0.005,
    GYRO_MATRIX: 0.005,
    ACCEL_MATRIX: 0.005,
    G_SENSITIVITY: 0.001,
}
"""Prior standard deviations: a distortion coefficient; half a percent of scale and misalignment, as
data sheets of MEMS units have it; g-sensitivity in rad/s per m/s²."""


@dataclass(frozen=True, slots=True)
class CalibrationPart:
    """One part: its name, and its columns among the coordinates of the whole calibration."""

    name: str
    columns: slice


@dataclass(frozen=True, slots=True)
class OnlineCalibration:
    """The parts being estimated, and their deviations (C,) from those of the files.

    The last `n_considered` coordinates are considered: their deviations stay zero. Units: rad and m
    (poses), px (focal lengths and centers), 1 (distortion, IMU matrices), rad/s per m/s²
    (g-sensitivity). `baseline_axes` (3, 3): columns are the directions of the stereo position's
    coordinates in the left camera: along the baseline, across it, and forward.
    """

    parts: tuple[CalibrationPart, ...] = ()
    deviation: FloatArray = field(default_factory=lambda: np.empty(0))
    baseline_axes: FloatArray = field(default_factory=lambda: np.eye(3))
    n_considered: int = 0

    def __len__(self) -> int:
        return len(self.deviation)

    @property
    def n_estimated(self) -> int:
        """Number of coordinates that updates change, the first ones."""
        return len(self.deviation) - self.n_considered

    def names(self) -> tuple[str, ...]:
        """A name for each coordinate that is estimated."""
        out: list[str] = []
        for part in self.parts:
            if part.columns.start >= self.n_estimated:
                break
            size = part.columns.stop - part.columns.start
            labels = _COORDINATES.get(part.name.removeprefix("cam0_").removeprefix("cam1_"))
            out += [f"{part.name}_{labels[k] if labels else k}" for k in range(size)]
        return tuple(out)

    def columns(self, name: str) -> slice | None:
        """The part's columns, None where it is not estimated."""
        return next((part.columns for part in self.parts if part.name == name), None)

    def deviation_of(self, name: str, size: int) -> FloatArray:
        """The part's deviation (size,), zeros where it is not estimated."""
        columns = self.columns(name)
        return np.zeros(size) if columns is None else self.deviation[columns]

    def plus(self, error: FloatArray) -> "OnlineCalibration":
        """With an error vector (C,) added."""
        return replace(self, deviation=self.deviation + error) if len(self) else self


@dataclass(frozen=True, slots=True)
class ImuIntrinsics:
    """W, A and S (3, 3); A is upper triangular: the accelerometer's axes define the frame."""

    gyro_matrix: FloatArray
    accel_matrix: FloatArray
    g_sensitivity: FloatArray


def make_calibration(
    rig: StereoRig, settings: CalibrationSettings
) -> tuple[OnlineCalibration, FloatArray]:
    """The parts that the settings switch on, without deviation, and their prior variances (C,).

    And the image centres of both lenses where neither these nor the cameras' poses are estimated,
    whose rotations move the picture as the centres do.
    """
    sigmas: list[tuple[str, FloatArray]] = []
    if settings.extrinsics:
        pose = np.repeat([settings.rotation_sigma_rad, settings.position_sigma_m], 3)
        sigmas += [(MOUNT, pose), (STEREO, _stereo_sigmas(rig, settings))]
    if settings.intrinsics:
        for name, camera in zip(CAMERA_INTRINSICS, rig.cameras, strict=True):
            pixels = [settings.focal_sigma_px] * _FOCAL_AND_CENTER
            distortion = [_PRIOR_SIGMAS["distortion"]] * len(camera.distortion)
            sigmas.append((name, np.array([*pixels, *distortion])))
    if settings.imu_intrinsics:
        sigmas.append((GYRO_MATRIX, np.full(9, _PRIOR_SIGMAS[GYRO_MATRIX])))
        sigmas.append((ACCEL_MATRIX, np.full(6, _PRIOR_SIGMAS[ACCEL_MATRIX])))
    if settings.g_sensitivity:
        sigmas.append((G_SENSITIVITY, np.full(9, _PRIOR_SIGMAS[G_SENSITIVITY])))
    center_px = LENS_SIGMA_PX if settings.lens_sigma_px is None else settings.lens_sigma_px
    n_considered = 0
    if not (settings.extrinsics or settings.intrinsics) and center_px > 0.0:
        n_considered = _VIEW
        sigmas.append((CENTERS, np.full(_VIEW, center_px)))
    parts, start = [], 0
    for name, sigma in sigmas:
        parts.append(CalibrationPart(name, slice(start, start + len(sigma))))
        start += len(sigma)
    variance = np.concatenate([np.empty(0), *(sigma**2 for _, sigma in sigmas)])
    axes = _baseline_axes(rig)
    return OnlineCalibration(tuple(parts), np.zeros(start), axes, n_considered), variance


def _stereo_sigmas(rig: StereoRig, settings: CalibrationSettings) -> FloatArray:
    length = settings.baseline_sigma * rig.baseline
    turn, across = settings.stereo_rotation_sigma_rad, settings.stereo_position_sigma_m
    return np.array([turn, turn, turn, length, across, across])


def _baseline_axes(rig: StereoRig) -> FloatArray:
    """Along the baseline, square to it and to the optical axis, and square to both, in `cam0`."""
    along = se3.inverse(rig.T_cam1_cam0)[:3, 3] / rig.baseline
    down = np.cross([0.0, 0.0, 1.0], along)
    if np.linalg.norm(down) < _LEAST_ACROSS:  # one camera before the other
        down = np.cross([1.0, 0.0, 0.0], along)
    down = down / np.linalg.norm(down)
    return np.stack([along, down, np.cross(along, down)], axis=1)


def calibrated_rig(rig: StereoRig, calibration: OnlineCalibration) -> StereoRig:
    """The rig of the files with the deviations applied."""
    if not calibration.n_estimated:
        return rig
    T_imu_cam0, T_imu_cam1 = rig.T_imu_cam0, rig.T_imu_cam1
    if calibration.columns(MOUNT) is not None:
        T_imu_cam0 = _calibrated_pose(T_imu_cam0, calibration.deviation_of(MOUNT, 6), np.eye(3))
        T_cam0_cam1 = _calibrated_pose(
            se3.inverse(rig.T_cam1_cam0), calibration.deviation_of(STEREO, 6),
            calibration.baseline_axes,
        )  # fmt: skip
        T_imu_cam1 = T_imu_cam0 @ T_cam0_cam1
    cameras = [
        _calibrated_camera(
            camera, calibration.deviation_of(name, _FOCAL_AND_CENTER + len(camera.distortion))
        )
        for camera, name in zip(rig.cameras, CAMERA_INTRINSICS, strict=True)
    ]
    return replace(
        rig, cam0=cameras[0], cam1=cameras[1], T_imu_cam0=T_imu_cam0, T_imu_cam1=T_imu_cam1
    )


def right_pose(
    rig: StereoRig, calibration: OnlineCalibration, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Deviation of the right camera's pose on the IMU from `rig`, and its 1-sigma, (6,) each.

    `covariance` (C, C): that of the calibration; mount and stereo pose are estimated.
    """
    T = calibrated_rig(rig, calibration).T_imu_cam1
    turn = so3.log(rig.T_imu_cam1[:3, :3].T @ T[:3, :3])
    deviation = np.concatenate([turn, T[:3, 3] - rig.T_imu_cam1[:3, 3]])
    mount, stereo = calibration.columns(MOUNT), calibration.columns(STEREO)
    if mount is None or stereo is None:
        return deviation, np.zeros(6)
    T_imu_cam0 = calibrated_rig(rig, calibration).T_imu_cam0
    R_cam1_cam0 = T[:3, :3].T @ T_imu_cam0[:3, :3]
    arm = T_imu_cam0[:3, :3].T @ (T[:3, 3] - T_imu_cam0[:3, 3])
    by_mount = so3.right_jacobian(calibration.deviation_of(MOUNT, 6)[:3])
    J = np.zeros((6, len(calibration)))
    unturned = np.linalg.inv(so3.right_jacobian(turn))
    J[:3, mount.start : mount.start + 3] = unturned @ R_cam1_cam0 @ by_mount
    J[:3, stereo.start : stereo.start + 3] = unturned @ so3.right_jacobian(
        calibration.deviation_of(STEREO, 6)[:3]
    )
    J[3:, mount.start : mount.start + 3] = -T_imu_cam0[:3, :3] @ so3.hat(arm) @ by_mount
    J[3:, mount.start + 3 : mount.stop] = np.eye(3)
    J[3:, stereo.start + 3 : stereo.stop] = T_imu_cam0[:3, :3] @ calibration.baseline_axes
    variance = np.einsum("ij,jk,ik->i", J, covariance, J)
    return deviation, np.sqrt(np.maximum(variance, 0.0))


def calibration_estimate(
    rig: StereoRig, calibration: OnlineCalibration, covariance: FloatArray
) -> CalibrationEstimate:
    """All that is estimated, with sigmas; the right camera's pose on the IMU after the left's.

    `covariance` (C, C): that of the calibration; the deviations are those from `rig`.
    """
    names, n = list(calibration.names()), calibration.n_estimated
    value = calibration.deviation[:n]
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))[:n]
    mount, stereo = calibration.columns(MOUNT), calibration.columns(STEREO)
    if mount is not None and stereo is not None:
        right, right_sigma = right_pose(rig, calibration, covariance)
        order = [*range(mount.stop), *range(stereo.stop, len(value)), *range(len(value))[stereo]]
        at, names = mount.stop, [names[i] for i in order]
        names[at:at] = [f"cam1_pose_{label}" for label in _COORDINATES["pose"]]
        value = np.concatenate([value[order[:at]], right, value[order[at:]]])
        sigma = np.concatenate([sigma[order[:at]], right_sigma, sigma[order[at:]]])
    return CalibrationEstimate(tuple(names), value, sigma)


def imu_intrinsics(calibration: OnlineCalibration) -> ImuIntrinsics | None:
    """The IMU's matrices, None where none of them is estimated: they are taken as ideal."""
    if all(calibration.columns(n) is None for n in (GYRO_MATRIX, ACCEL_MATRIX, G_SENSITIVITY)):
        return None
    A = np.eye(3)
    A[_UPPER] += calibration.deviation_of(ACCEL_MATRIX, 6)
    W = np.eye(3) + calibration.deviation_of(GYRO_MATRIX, 9).reshape(3, 3)
    return ImuIntrinsics(W, A, calibration.deviation_of(G_SENSITIVITY, 9).reshape(3, 3))


def correct_imu(
    gyro: FloatArray, accel: FloatArray, bias: tuple[FloatArray, FloatArray],
    intrinsics: ImuIntrinsics | None,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """True rates, rad/s, and specific forces, m/s² (n, 3), from measured ones (n, 3).

    `bias`: those of gyroscope and accelerometer (3,).
    """
    if intrinsics is None:
        return gyro - bias[0], accel - bias[1]
    force = (accel - bias[1]) @ intrinsics.accel_matrix.T
    rate = (gyro - force @ intrinsics.g_sensitivity.T - bias[0]) @ intrinsics.gyro_matrix.T
    return rate, force


def imu_sensitivity(
    gyro: FloatArray, accel: FloatArray, bias: tuple[FloatArray, FloatArray],
    calibration: OnlineCalibration,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """∂ω/∂x and ∂a/∂x (n, 3, 6 + C) for x = (gyro bias, accel bias, calibration).

    `gyro`, `accel` (n, 3) as measured; `bias` as in `correct_imu`.
    """
    n, intrinsics = len(gyro), imu_intrinsics(calibration)
    by_rate = np.zeros((n, 3, 6 + len(calibration)))
    by_force = np.zeros_like(by_rate)
    if intrinsics is None:
        for k in range(3):
            by_rate[:, k, k] = by_force[:, k, 3 + k] = -1.0
        return by_rate, by_force
    W, A, S = intrinsics.gyro_matrix, intrinsics.accel_matrix, intrinsics.g_sensitivity
    unbiased = accel - bias[1]
    force = unbiased @ A.T
    by_force[:, :, 3:6] = -A
    columns = calibration.columns(ACCEL_MATRIX)
    if columns is not None:
        upper = _by_matrix(unbiased)[:, :, _upper_entries()]
        by_force[:, :, 6 + columns.start : 6 + columns.stop] = upper
    by_rate[:, :, :3] = -W
    by_rate[:, :, 3:] = -(W @ S) @ by_force[:, :, 3:]
    columns = calibration.columns(GYRO_MATRIX)
    if columns is not None:
        inner = gyro - force @ S.T - bias[0]
        by_rate[:, :, 6 + columns.start : 6 + columns.stop] = _by_matrix(inner)
    columns = calibration.columns(G_SENSITIVITY)
    if columns is not None:
        by_rate[:, :, 6 + columns.start : 6 + columns.stop] = -W @ _by_matrix(force)
    return by_rate, by_force


def camera_pose_jacobian(
    calibration: OnlineCalibration, name: str, p_cam: FloatArray, by_position: FloatArray
) -> FloatArray:
    """∂p_cam/∂(deviation of a pose) (..., 3, 6) of points p_cam (..., 3), m, in the posed camera.

    `by_position` (3, 3): the camera's rotation against what it is posed on, times the directions
    of the position's coordinates there.
    """
    J = np.empty((*p_cam.shape, 6))
    J[..., :3] = so3.hat(p_cam) @ so3.right_jacobian(calibration.deviation_of(name, 6)[:3])
    J[..., 3:] = -by_position
    return J


def intrinsics_jacobian(camera: Camera, p_cam: FloatArray) -> FloatArray:
    """∂pixel/∂(fx, fy, cx, cy, distortion) (..., 2, 4 + k) at points p_cam (..., 3), metres.

    NaN for points behind the camera.
    """
    z = np.where(p_cam[..., 2:] > 0.0, p_cam[..., 2:], np.nan)
    xy = p_cam[..., :2] / z
    distorted = camera.model.distort(xy, camera.distortion)
    _, by_distortion = camera.model.distort_jacobian(xy, camera.distortion)
    J = np.zeros((*xy.shape, _FOCAL_AND_CENTER + len(camera.distortion)))
    J[..., 0, 0], J[..., 1, 1] = distorted[..., 0], distorted[..., 1]
    J[..., 0, 2] = J[..., 1, 3] = 1.0
    J[..., _FOCAL_AND_CENTER:] = camera.matrix[:2, :2] @ by_distortion
    return J


def _calibrated_pose(T: FloatArray, deviation: FloatArray, axes: FloatArray) -> FloatArray:
    """The pose, moved along the columns of `axes` (3, 3)."""
    return se3.make(T[:3, :3] @ so3.exp(deviation[:3]), T[:3, 3] + axes @ deviation[3:])


def _calibrated_camera(camera: Camera, deviation: FloatArray) -> Camera:
    intrinsics = camera.intrinsics.copy()
    intrinsics[:_FOCAL_AND_CENTER] += deviation[:_FOCAL_AND_CENTER]
    distortion = camera.distortion + deviation[_FOCAL_AND_CENTER:]
    return replace(camera, intrinsics=intrinsics, distortion=distortion)


def _by_matrix(vectors: FloatArray) -> FloatArray:
    """∂(M v)/∂M (n, 3, 9) for vectors (n, 3), M row by row."""
    columns = np.einsum("ij,nk->nijk", np.eye(3), vectors)
    return np.asarray(columns.reshape(len(vectors), 3, 9))


def _upper_entries() -> IntArray:
    """Places of the upper triangle among the nine entries of a matrix, row by row."""
    return np.asarray(3 * _UPPER[0] + _UPPER[1])
