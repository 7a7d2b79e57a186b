"""What calibration files have in common: safe YAML, checked numbers, errors that name the key."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.errors import CalibrationError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.text_files import read_yaml
from ovmot.types import ImuNoise

MODEL_NAMES = {
    "radtan": "radtan",
    "radial-tangential": "radtan",
    "plumb_bob": "radtan",
    "equidistant": "equidistant",
    "none": "none",
}
"""Names of camera models of Kalibr, EuRoC and ROS, and our names of them."""

NOISE_KEYS = {
    "gyro": "gyroscope_noise_density",
    "gyro_walk": "gyroscope_random_walk",
    "accel": "accelerometer_noise_density",
    "accel_walk": "accelerometer_random_walk",
}
"""Keys of the noise densities, the same in Kalibr and EuRoC files."""

_MOST_NOISE = {
    "gyro": (0.5, "rad/s/sqrt(Hz)"),
    "gyro_walk": (0.5, "rad/s^2/sqrt(Hz)"),
    "accel": (5.0, "m/s^2/sqrt(Hz)"),
    "accel_walk": (5.0, "m/s^3/sqrt(Hz)"),
}
"""A thousand times what common MEMS sensors have: so much is another unit, or a whole number."""
_GRID = 9  # points a side
_LEAST_SEEN = 0.25  # of the image: wrong coefficients fold the rest
_FIELD = 0.003, 1e4  # tangent of the widest ray: 0.2 and 89.99 degrees


@dataclass(frozen=True, slots=True)
class Calibration:
    """A stereo rig and, where the files say it, the noise of its IMU.

    `notes` are sentences for the user: what the files contradict or lack.
    """

    rig: StereoRig
    imu_noise: ImuNoise | None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class CalibrationNode:
    """A mapping in a calibration file that knows where it came from."""

    path: Path
    place: str
    data: Mapping[str, Any]

    def fail(self, key: str, problem: str, remedy: str = "correct the file") -> CalibrationError:
        """The error for `key`: file, full key, problem, remedy."""
        name = f"{self.place}.{key}" if self.place else key
        return CalibrationError(f"{self.path}: '{name}': {problem}; {remedy}")

    def has(self, key: str) -> bool:
        return self.data.get(key) is not None

    def value(self, key: str) -> Any:
        """What stands under `key`; raises `CalibrationError` if nothing does."""
        if not self.has(key):
            raise self.fail(key, "this key is missing", "add it")
        return self.data[key]

    def child(self, key: str) -> "CalibrationNode":
        """The mapping under `key`."""
        value = self.value(key)
        if not isinstance(value, dict):
            raise self.fail(key, f"expected keys below it, found {_short(value)}")
        return CalibrationNode(self.path, f"{self.place}.{key}".lstrip("."), value)

    def number(self, key: str) -> float:
        """One finite number."""
        return float(self.numbers(key, (1,))[0])

    def numbers(self, key: str, shape: tuple[int, ...]) -> FloatArray:
        """Finite numbers of this shape, as nested lists, a flat list or OpenCV's matrix."""
        value = self.value(key)
        wanted = f"expected {'x'.join(str(n) for n in shape)} numbers, found {_short(value)}"
        stated = None
        if isinstance(value, dict):
            stated = value.get("rows"), value.get("cols")
            value = value.get("data")
        try:  # through text, since YAML reads 2e-3 as a string
            flat = np.array(value, dtype=str).astype(np.float64).ravel()
        except (ValueError, TypeError):
            raise self.fail(key, wanted) from None
        allowed = (None, shape) if len(shape) == 2 else (None, (1, *shape), (*shape, 1))
        if flat.size != np.prod(shape) or stated not in allowed:
            raise self.fail(key, wanted)
        if not np.all(np.isfinite(flat)):
            raise self.fail(key, "holds a number that is not finite")
        return flat.reshape(shape)

    def coefficients(self, key: str) -> FloatArray:
        """Finite numbers of any count, (k,)."""
        value = self.value(key)
        inner = value.get("data") if isinstance(value, dict) else value
        if not isinstance(inner, list):
            raise self.fail(key, f"expected a list of numbers, found {_short(inner)}")
        if not inner:
            return np.empty(0)
        return CalibrationNode(self.path, self.place, {key: inner}).numbers(key, (len(inner),))

    def transform(self, key: str) -> FloatArray:
        """A rigid motion (4, 4), its rotation cleaned of rounding."""
        T = self.numbers(key, (4, 4))
        R = T[:3, :3]
        if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0.0:
            raise self.fail(key, "the upper left 3x3 part is not a rotation")
        if np.abs(T[3] - [0.0, 0.0, 0.0, 1.0]).max() > 1e-9:
            raise self.fail(key, "the last row must be 0 0 0 1")
        return se3.make(so3.project_to_rotation(R), T[:3, 3])

    def size(self, key: str) -> tuple[int, int]:
        """Width and height in whole pixels."""
        width, height = self.numbers(key, (2,))
        if width <= 0 or height <= 0 or width % 1 or height % 1:
            raise self.fail(key, f"no image is {width:g}x{height:g} pixels")
        return int(width), int(height)

    def camera_model(self, key: str) -> str:
        """Our name of the camera model."""
        name = str(self.value(key)).strip().lower()
        if name not in MODEL_NAMES:
            raise self.fail(
                key, f"unknown camera model '{name}'", f"known: {', '.join(MODEL_NAMES)}"
            )
        return MODEL_NAMES[name]


def load_calibration_yaml(path: Path) -> CalibrationNode:
    """The mapping of a YAML file, also with OpenCV's header `%YAML:1.0` and matrices.

    Raises `CalibrationError` if the file is missing, is no YAML or holds no keys.
    """
    data = read_yaml(path, CalibrationError, "no such calibration file")
    if not isinstance(data, dict):
        raise CalibrationError(f"{path}: holds no keys; is this a calibration file?")
    return CalibrationNode(path, "", data)


def read_pinhole(node: CalibrationNode, coefficients_key: str) -> Camera:
    """The camera of a Kalibr or EuRoC mapping; their keys differ in the coefficients' name only."""
    model = str(node.data.get("camera_model", "pinhole"))
    if model != "pinhole":
        raise node.fail("camera_model", f"'{model}' is not known", "calibrate with 'pinhole'")
    distortion_model = node.camera_model("distortion_model")
    distortion = node.coefficients(coefficients_key) if distortion_model != "none" else np.empty(0)
    fx, fy, cx, cy = node.numbers("intrinsics", (4,))
    size = node.size("resolution")
    if min(fx, fy) <= 0.0:
        raise node.fail("intrinsics", f"focal lengths {fx:g}, {fy:g} are not positive")
    skew = node.number("skew") if node.has("skew") else 0.0  # of ours: see `kalibr.write_chain`
    try:
        return Camera.make(size, (fx, fy), (cx, cy), distortion_model, distortion, skew=skew)
    except CalibrationError as error:
        raise node.fail(coefficients_key, str(error)) from None


def read_imu_noise(node: CalibrationNode) -> ImuNoise:
    """The four noise densities of an IMU mapping; raises `CalibrationError` unless positive."""
    values = {}
    for name, key in NOISE_KEYS.items():
        values[name] = node.number(key)
        most, unit = _MOST_NOISE[name]
        if not 0.0 < values[name] < most:
            remedy = f"it is positive and below {most:g} {unit}"
            raise node.fail(key, f"{values[name]:g} is not a noise density", remedy)
    return ImuNoise(**values)


def make_rig(
    path: Path,
    cameras: tuple[Camera, Camera],
    T_imu_cam: tuple[FloatArray, FloatArray],
    time_offset_s: float = 0.0,
) -> StereoRig:
    """The rig of two cameras and their poses; an impossible one is blamed on `path`."""
    try:
        rig = StereoRig(*cameras, *T_imu_cam, time_offset_s)
    except CalibrationError as error:
        raise CalibrationError(f"{path}: {error}; correct the file") from None
    for name, camera in zip(("cam0", "cam1"), cameras, strict=True):
        if not _makes_an_image(camera):
            size = f"{camera.width}x{camera.height} pixels"
            problem = f"{name}: no camera makes an image of {size} by these numbers"
            remedy = "correct focal lengths (in pixels) and distortion"
            raise CalibrationError.at(path, problem, remedy)
        cx, cy = camera.intrinsics[2:4].tolist()
        if not (0.0 <= cx < camera.width and 0.0 <= cy < camera.height):
            size = f"{camera.width}x{camera.height} pixels"
            problem = f"{name}: the principal point ({cx:g}, {cy:g}) is outside the image of {size}"
            remedy = "intrinsics are fx, fy, cx, cy; the width comes first"
            raise CalibrationError.at(path, problem, remedy)
    return rig.with_orthonormal_rotations()


def _makes_an_image(camera: Camera) -> bool:
    """Does a share of the image see a field of view between a fraction of a degree and 180?"""
    u, v = np.linspace(0, camera.width - 1, _GRID), np.linspace(0, camera.height - 1, _GRID)
    with np.errstate(all="ignore"):
        rays = camera.normalize(np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2))
    seen = np.isfinite(rays).all(axis=1)
    if seen.mean() < _LEAST_SEEN:
        return False
    across = np.abs(rays[seen]).max(axis=0)  # to the sides, up and down
    return bool(_FIELD[0] < across.min() and across.max() < _FIELD[1])


def _short(value: Any) -> str:
    text = " ".join(str(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
