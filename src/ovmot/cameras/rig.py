"""The stereo rig: two cameras, their poses on the IMU, and the clock between them.

A rig with one camera is `StereoRig.monocular`.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from ovmot.cameras.camera import Camera
from ovmot.errors import CalibrationError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray

_WIDEST_M = 20.0
_ASIDE_M = 0.1  # of the place of the right camera that a monocular rig does not have
_MOST_OFFSET_S = 4e9  # stamps of this century and the offset together fit into 64 bits of ns


@dataclass(frozen=True, slots=True)
class StereoRig:
    """Left camera `cam0`, right camera `cam1`, and the IMU that carries them.

    `T_imu_cam0`, `T_imu_cam1` (4, 4) map camera points into the IMU frame, metres.
    `T_cam1_cam0` (4, 4) follows: it maps points of the left camera into the right one; and
    `T_cam_imu` (2, 4, 4): of the IMU into the left and into the right one; and `packed` (2, 12):
    both cameras, for kernels.
    `time_offset_s` is added to a camera stamp to give the IMU's time: t_imu = t_cam + offset.
    `n_cameras` is 1 for a monocular rig: `cam1` and its pose are then placeholders, which keep the
    arrays of both cameras their form; it has no images and sees nothing.
    Raises `CalibrationError` for matrices that are no rigid motions, a
    baseline that no rig has, or a time offset that no clock has.
    """

    cam0: Camera
    cam1: Camera
    T_imu_cam0: FloatArray
    T_imu_cam1: FloatArray
    time_offset_s: float = 0.0
    n_cameras: int = 2
    T_cam1_cam0: FloatArray = field(init=False, repr=False, compare=False)
    T_cam_imu: FloatArray = field(init=False, repr=False, compare=False)
    packed: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name, T in (("T_imu_cam0", self.T_imu_cam0), ("T_imu_cam1", self.T_imu_cam1)):
            if T.shape != (4, 4) or not np.all(np.isfinite(T)):
                raise CalibrationError(f"{name} must be a finite 4x4 matrix")
            R = T[:3, :3]
            if np.abs(T[3] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-9:
                raise CalibrationError(f"the last row of {name} must be 0 0 0 1")
            if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0.0:
                raise CalibrationError(f"{name} does not hold a rotation matrix")
        if self.baseline < 1e-3:
            raise CalibrationError("the two cameras of the rig stand at the same place")
        if self.baseline > _WIDEST_M:
            raise CalibrationError(
                f"the two cameras stand {self.baseline:g} m apart (translations are in metres)"
            )
        if not abs(self.time_offset_s) < _MOST_OFFSET_S:
            raise CalibrationError(
                f"no clock is {self.time_offset_s:g} s off: the time offset between camera and IMU"
            )
        T_cam1_cam0 = se3.inverse(self.T_imu_cam1) @ self.T_imu_cam0
        object.__setattr__(self, "T_cam1_cam0", T_cam1_cam0)
        both = np.stack([self.T_imu_cam0, self.T_imu_cam1])
        object.__setattr__(self, "T_cam_imu", se3.inverse(both))
        object.__setattr__(self, "packed", np.stack([self.cam0.packed, self.cam1.packed]))

    @classmethod
    def make(
        cls,
        cam0: Camera,
        cam1: Camera,
        T_imu_cam0: ArrayLike,
        T_imu_cam1: ArrayLike,
        time_offset_s: float = 0.0,
    ) -> "StereoRig":
        """Build from arrays or nested lists (4, 4); rounding is taken out of their rotations."""
        left, right = (np.array(T, dtype=np.float64) for T in (T_imu_cam0, T_imu_cam1))
        return cls(cam0, cam1, left, right, float(time_offset_s)).with_orthonormal_rotations()

    @classmethod
    def monocular(
        cls, cam0: Camera, T_imu_cam0: ArrayLike, time_offset_s: float = 0.0
    ) -> "StereoRig":
        """The rig of one camera; arguments as for `make`."""
        T = np.array(T_imu_cam0, dtype=np.float64)
        aside = se3.make(np.eye(3), np.array([_ASIDE_M, 0.0, 0.0]))
        rig = cls(cam0, cam0, T, T @ aside, float(time_offset_s), n_cameras=1)
        return rig.with_orthonormal_rotations()

    @property
    def cameras(self) -> tuple[Camera, Camera]:
        return self.cam0, self.cam1

    @property
    def baseline(self) -> float:
        """Distance of the two camera centres in metres."""
        return float(np.linalg.norm(self.T_imu_cam1[:3, 3] - self.T_imu_cam0[:3, 3]))

    @property
    def essential(self) -> FloatArray:
        """E = [t]x R of T_cam1_cam0: x1ᵀ E x0 = 0 for undistorted homogeneous x0, x1."""
        T = self.T_cam1_cam0
        return so3.hat(T[:3, 3]) @ T[:3, :3]

    def normalized_sigma(self, pixel_sigma: float) -> FloatArray:
        """Standard deviations (4,) of normalized coordinates: left x, y and right x, y.

        `pixel_sigma`: that of each pixel coordinate; divided by the focal lengths, which neglects
        distortion.
        """
        return np.asarray(
            pixel_sigma / np.array([self.cam0.fx, self.cam0.fy, self.cam1.fx, self.cam1.fy])
        )

    def normalize(self, pixels: FloatArray) -> FloatArray:
        """Normalized coordinates (..., 4) of stereo pixels (..., 4): left u, v and right u, v.

        NaN where a camera did not see the point.
        """
        return np.concatenate(
            [self.cam0.normalize(pixels[..., :2]), self.cam1.normalize(pixels[..., 2:])], axis=-1
        )

    def with_orthonormal_rotations(self) -> "StereoRig":
        """The same rig with rotations cleaned of a calibration file's rounding."""

        def clean(T: FloatArray) -> FloatArray:
            return se3.make(so3.project_to_rotation(T[:3, :3]), T[:3, 3])

        return replace(self, T_imu_cam0=clean(self.T_imu_cam0), T_imu_cam1=clean(self.T_imu_cam1))


def rectified(rig: StereoRig) -> StereoRig:
    """Pinholes where the rig's cameras stand, both turned so that image rows agree.

    x points from the left camera to the right one, z as near to the left camera's as can be.
    """
    p0, p1 = rig.T_imu_cam0[:3, 3], rig.T_imu_cam1[:3, 3]
    x = (p1 - p0) / np.linalg.norm(p1 - p0)
    y = np.cross(rig.T_imu_cam0[:3, 2], x)
    y /= np.linalg.norm(y)
    R_imu_rect = np.stack([x, y, np.cross(x, y)], axis=-1)
    cam0, (cx, cy) = rig.cam0, rig.cam0.intrinsics[2:4]
    camera = Camera.make((cam0.width, cam0.height), (cam0.fx, cam0.fx), (cx, cy))
    poses = se3.make(R_imu_rect, p0), se3.make(R_imu_rect, p1)
    return replace(rig, cam0=camera, cam1=camera, T_imu_cam0=poses[0], T_imu_cam1=poses[1])


def without_distortion(rig: StereoRig) -> StereoRig:
    """The same cameras without distortion: `radtan` with coefficients of zero."""
    cam0, cam1 = (
        Camera.make(
            (c.width, c.height), (c.fx, c.fy), tuple(c.intrinsics[2:4]), "radtan", [0.0] * 4
        )
        for c in rig.cameras
    )
    return replace(rig, cam0=cam0, cam1=cam1)
