"""One camera: image size, intrinsics and camera model; pixels to rays and back, with Jacobians."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ovmot.cameras.models import CAMERA_MODELS, CameraModel
from ovmot.errors import CalibrationError
from ovmot.geometry.arrays import BoolArray, FloatArray

_MOST_PIXELS = 65_535  # a side, as in JPEG


@dataclass(frozen=True, slots=True)
class Camera:
    """A calibrated camera.

    `intrinsics` (5,) is fx, fy, cx, cy, skew in pixels: u = fx·x + skew·y + cx, v = fy·y + cy,
    where (x, y) are distorted normalized coordinates. `distortion` (k,) belongs to `model`. `fx`
    and `fy` of the camera itself are pixels per radian on its axis, for models that scale there.
    `packed` (12,) follows, for kernels: intrinsics (5), distortion (5), width and height.
    Raises `CalibrationError` when these can not be a camera's.
    """

    width: int
    height: int
    intrinsics: FloatArray
    model: CameraModel
    distortion: FloatArray
    packed: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.intrinsics.shape != (5,) or not np.all(np.isfinite(self.intrinsics)):
            raise CalibrationError("camera intrinsics must be five finite numbers")
        sizes = self.width, self.height
        if min(sizes) <= 0 or max(sizes) > _MOST_PIXELS or self.intrinsics[:2].min() <= 0.0:
            raise CalibrationError(
                f"impossible camera: {self.width}x{self.height} pixels,"
                f" focal lengths {self.intrinsics[0]:g}, {self.intrinsics[1]:g}"
            )
        if len(self.distortion) not in self.model.n_coefficients:
            raise CalibrationError(
                f"camera model '{self.model.name}' takes"
                f" {' or '.join(map(str, self.model.n_coefficients))}"
                f" coefficients, got {len(self.distortion)}"
            )
        if not np.all(np.isfinite(self.distortion)):
            raise CalibrationError("distortion coefficients must be finite numbers")
        packed = np.zeros(12)
        packed[:5], packed[10:] = self.intrinsics, sizes
        packed[5 : 5 + len(self.distortion)] = self.distortion
        object.__setattr__(self, "packed", packed)

    @classmethod
    def make(
        cls,
        size: tuple[int, int],
        focal: tuple[float, float],
        center: tuple[float, float],
        model: str = "none",
        distortion: FloatArray | list[float] | None = None,
        skew: float = 0.0,
    ) -> "Camera":
        """Build from plain numbers; `size` is (width, height), `model` a key of `CAMERA_MODELS`."""
        if model not in CAMERA_MODELS:
            raise CalibrationError(
                f"unknown camera model '{model}'; known: {', '.join(CAMERA_MODELS)}"
            )
        coefficients = np.asarray([] if distortion is None else distortion, dtype=np.float64)
        return cls(
            int(size[0]), int(size[1]), np.array([*focal, *center, skew], dtype=np.float64),
            CAMERA_MODELS[model], coefficients,
        )  # fmt: skip

    @classmethod
    def from_matrix(
        cls,
        K: ArrayLike,
        size: tuple[int, int],
        model: str = "none",
        distortion: FloatArray | list[float] | None = None,
    ) -> "Camera":
        """Build from a camera matrix (3, 3) in pixels, as OpenCV gives it; the rest as `make`."""
        matrix = np.asarray(K, dtype=np.float64)
        if matrix.shape != (3, 3) or np.any(matrix[[1, 2, 2, 2], [0, 0, 1, 2]] != (0, 0, 0, 1)):
            raise CalibrationError("a camera matrix is [[fx, skew, cx], [0, fy, cy], [0, 0, 1]]")
        (fx, skew, cx), (_, fy, cy) = matrix[:2].tolist()
        return cls.make(size, (fx, fy), (cx, cy), model, distortion, skew)

    @property
    def fx(self) -> float:
        """Pixels per radian along u where the optical axis meets the image."""
        return float(self.intrinsics[0]) * self.model.scale(self.distortion)

    @property
    def fy(self) -> float:
        """Pixels per radian along v where the optical axis meets the image."""
        return float(self.intrinsics[1]) * self.model.scale(self.distortion)

    @property
    def matrix(self) -> FloatArray:
        """The 3x3 camera matrix K in pixels."""
        fx, fy, cx, cy, skew = self.intrinsics
        return np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])

    def normalize(self, pixels: FloatArray) -> FloatArray:
        """Undistorted normalized coordinates (..., 2) of pixels (..., 2); NaN in, NaN out."""
        fx, fy, cx, cy, skew = self.intrinsics.tolist()
        xy = np.empty(pixels.shape)
        xy[..., 1] = (pixels[..., 1] - cy) / fy
        xy[..., 0] = (pixels[..., 0] - cx - skew * xy[..., 1]) / fx
        return self.model.undistort(xy, self.distortion)

    def denormalize(self, xy: FloatArray) -> FloatArray:
        """Pixels (..., 2) of undistorted normalized coordinates (..., 2)."""
        fx, fy, cx, cy, skew = self.intrinsics
        d = self.model.distort(xy, self.distortion)
        return np.stack([fx * d[..., 0] + skew * d[..., 1] + cx, fy * d[..., 1] + cy], axis=-1)

    def denormalize_jacobian(self, xy: FloatArray) -> FloatArray:
        """∂pixel/∂xy (..., 2, 2) at undistorted normalized coordinates (..., 2)."""
        J: FloatArray = self.matrix[:2, :2] @ self.model.distort_jacobian(xy, self.distortion)[0]
        return J

    def project(self, points_cam: FloatArray) -> FloatArray:
        """Pixels (..., 2) of points (..., 3) in the camera frame, metres; NaN behind it."""
        z = points_cam[..., 2:]
        return self.denormalize(points_cam[..., :2] / np.where(z > 0.0, z, np.nan))

    def project_with_jacobian(self, points_cam: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pixels (..., 2) and their derivative by the point (..., 2, 3), pixels per metre."""
        z = np.where(points_cam[..., 2] > 0.0, points_cam[..., 2], np.nan)
        xy = points_cam[..., :2] / z[..., None]
        plane = np.zeros((*xy.shape[:-1], 2, 3))
        plane[..., 0, 0] = plane[..., 1, 1] = 1.0 / z
        plane[..., 0, 2] = -xy[..., 0] / z
        plane[..., 1, 2] = -xy[..., 1] / z
        return self.denormalize(xy), self.denormalize_jacobian(xy) @ plane

    def inside(self, pixels: FloatArray, border: float = 0.0) -> BoolArray:
        """Which pixels (..., 2) lie in the image, at least `border` pixels from its edge."""
        u, v = pixels[..., 0], pixels[..., 1]
        return (
            (u >= border) & (v >= border)
            & (u <= self.width - 1 - border) & (v <= self.height - 1 - border)
        )  # fmt: skip
