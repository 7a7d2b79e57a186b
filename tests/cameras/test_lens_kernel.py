"""Compiled camera models against those of `cameras.models`, all of them."""

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.lens_kernel import LENSES, packed_cameras, pixel_jacobian, to_pixel
from ovmot.cameras.models import CAMERA_MODELS
from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray

COEFFICIENTS = {
    "none": ([],),
    "radtan": ([-0.2, 0.05, 1e-3, -5e-4], [-0.2, 0.05, 1e-3, -5e-4, 0.01]),
    "equidistant": ([0.02, -0.01, 0.004, -0.001],),
    "omni": ([1.7], [0.9, -0.1, 0.02, 1e-3, -5e-4]),
    "eucm": ([0.63, 1.1],),
    "ds": ([-0.2, 0.59], [-0.9, 0.1]),
}
CAMERAS = [(name, d) for name in CAMERA_MODELS for d in COEFFICIENTS[name]]


def test_every_model_is_compiled() -> None:
    assert set(LENSES) == set(CAMERA_MODELS)


@pytest.mark.parametrize(("name", "distortion"), CAMERAS)
def test_pixels_and_jacobians(name: str, distortion: list[float]) -> None:
    camera = Camera.make((640, 480), (400.0, 405.0), (321.0, 238.0), name, distortion, skew=0.7)
    beside = se3.make(np.eye(3), np.array([0.3, 0.0, 0.0]))
    lens, packed = packed_cameras(StereoRig(camera, camera, np.eye(4), beside))
    xy: FloatArray = np.random.default_rng(1).uniform(-0.8, 0.8, (20, 2))
    xy[0] = 0.0
    for side in range(2):
        pixels = [to_pixel(lens[side], packed[side], x, y) for x, y in xy]
        np.testing.assert_allclose(pixels, camera.denormalize(xy), rtol=1e-13)
        J = [pixel_jacobian(lens[side], packed[side], x, y) for x, y in xy]
        expected = camera.denormalize_jacobian(xy).reshape(-1, 4)
        np.testing.assert_allclose(J, expected, rtol=1e-12, atol=1e-10)
    np.testing.assert_array_equal(packed[:, 10:], [[640.0, 480.0]] * 2)
