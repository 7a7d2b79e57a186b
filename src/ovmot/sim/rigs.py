"""The stereo rigs of the scenes, and what turns them into others: another size, another mount."""

from dataclasses import replace

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.errors import InputError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.sim.scene_file import RigName

R_AHEAD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""R_imu_cam of a level camera that looks along x of an IMU whose z axis is up."""
_MOST_PIXELS = 8192
_ASPECT_TOLERANCE = 1e-6


def street_rig() -> StereoRig:
    """A 640x280 rig on a car: 0.475 m baseline, 5-term distortion, the right camera turned."""
    tilt0 = so3.exp(np.array([0.007, -0.012, 0.005]))
    turn = so3.exp(np.array([-0.0026, 0.0045, 0.0085]))
    left = Camera.make(
        (640, 280), (408.45, 405.78), (304.0, 131.5), "radtan",
        [-0.0561, 0.1395, -0.0012, -0.00097, -0.0809],
    )  # fmt: skip
    right = Camera.make(
        (640, 280), (406.89, 404.26), (306.7, 124.5), "radtan",
        [-0.0549, 0.1424, 0.000075, -0.00068, -0.0857],
    )  # fmt: skip
    T_imu_cam0 = se3.make(R_AHEAD @ tilt0, np.array([1.71, 0.24, 0.11]))
    T_cam0_cam1 = se3.make(turn, np.array([0.475, 0.001, -0.002]))
    return StereoRig(left, right, T_imu_cam0, T_imu_cam0 @ T_cam0_cam1)


def fisheye_rig() -> StereoRig:
    """A 512x512 rig on a car: 0.3 m baseline, equidistant cameras that see 150 degrees across."""
    left = Camera.make(
        (512, 512), (191.5, 191.3), (255.2, 256.1), "equidistant", [0.0035, 0.0007, -0.002, 0.0002]
    )
    right = Camera.make(
        (512, 512), (191.2, 191.0), (256.6, 254.3), "equidistant", [0.0033, 0.001, -0.0021, 0.0002]
    )
    T_imu_cam0 = se3.make(
        R_AHEAD @ so3.exp(np.array([-0.05, 0.01, 0.004])), np.array([1.71, 0.15, 0.11])
    )
    T_cam0_cam1 = se3.make(
        so3.exp(np.array([0.003, -0.004, -0.006])), np.array([0.3, 0.0005, 0.001])
    )
    return StereoRig(left, right, T_imu_cam0, T_imu_cam0 @ T_cam0_cam1)


def named_rig(name: RigName) -> StereoRig:
    """The rig that a scene file asks for."""
    return street_rig() if name == "street" else fisheye_rig()


def resized(rig: StereoRig, size: tuple[int, int]) -> StereoRig:
    """The same cameras with sensors of other pixels: (width, height) of the same aspect ratio.

    Integer coordinates are the middles of pixels, so the scale s acts about the image's corner
    at (-0.5, -0.5): fx' = s fx, cx' = s (cx + 0.5) - 0.5. Raises `InputError` for a size of
    another aspect ratio, without pixels, or too large to be rendered.
    """
    width, height = size
    if max(size) > _MOST_PIXELS:
        raise InputError(f"size {width}x{height}: choose at most {_MOST_PIXELS} pixels a side")
    cam0 = rig.cam0
    if min(width, height) < 1 or not np.isclose(
        width * cam0.height, height * cam0.width, rtol=_ASPECT_TOLERANCE, atol=0.0
    ):
        raise InputError(
            f"size {width}x{height}: this rig's images are {cam0.width}x{cam0.height};"
            " choose a size of the same aspect ratio"
        )
    return replace(rig, cam0=_resized(rig.cam0, size), cam1=_resized(rig.cam1, size))


def _resized(camera: Camera, size: tuple[int, int]) -> Camera:
    s = size[0] / camera.width
    fx, fy, cx, cy, skew = camera.intrinsics
    K = np.array([s * fx, s * fy, s * (cx + 0.5) - 0.5, s * (cy + 0.5) - 0.5, s * skew])
    return replace(camera, width=size[0], height=size[1], intrinsics=K)


def held(rig: StereoRig, R_imu_cam0: FloatArray) -> StereoRig:
    """The rig's cameras on a small unit: the IMU in the middle between them, and `R_imu_cam0`."""
    T_cam0_cam1 = se3.inverse(rig.T_imu_cam0) @ rig.T_imu_cam1
    T_imu_cam0 = se3.make(R_imu_cam0, -0.5 * R_imu_cam0 @ T_cam0_cam1[:3, 3])
    return replace(rig, T_imu_cam0=T_imu_cam0, T_imu_cam1=T_imu_cam0 @ T_cam0_cam1)


def looking_along(ahead: FloatArray, up: FloatArray) -> FloatArray:
    """R_imu_cam (3, 3) of an upright camera by directions (3,) in the IMU's frame.

    Its optical axis is `ahead` without the part along `up`. Raises `ValueError` where none is left.
    """
    up = up / np.linalg.norm(up)
    level = ahead - (ahead @ up) * up
    norm = np.linalg.norm(level)
    if not norm > 1e-9:
        raise ValueError("a camera can not look along the vertical and stay upright")
    z, y = level / norm, -up
    return np.stack([np.cross(y, z), y, z], axis=-1)
