"""The unified model: known values, and the end of its field of view."""

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.models import CAMERA_MODELS

OMNI = CAMERA_MODELS["omni"]


def test_a_point_is_put_on_the_unit_sphere_and_seen_from_xi_behind() -> None:
    point = np.array([2.0, -1.0, 2.0])  # 3 m away
    seen = OMNI.distort(point[:2] / point[2], np.array([0.5]))
    np.testing.assert_allclose(seen, point[:2] / (2.0 + 0.5 * 3.0), rtol=1e-14)


def test_its_own_lens_comes_after_the_sphere() -> None:
    lens, xy = np.array([-0.2, 0.05, 1e-3, -2e-3]), np.array([0.4, 0.3])
    seen = OMNI.distort(xy, np.array([1.1, *lens]))
    expected = CAMERA_MODELS["radtan"].distort(OMNI.distort(xy, np.array([1.1])), lens)
    np.testing.assert_allclose(seen, expected, rtol=1e-14)


@pytest.mark.parametrize("xi", [0.4, 1.0, 1.8])
def test_no_ray_at_a_right_angle_or_past_it(xi: float) -> None:
    angle = np.radians([89.9, 90.0, 95.0])
    seen = np.sin(angle) / (np.cos(angle) + xi)  # to the side, on the unit sphere
    found = OMNI.undistort(np.column_stack([seen, np.zeros(3)]), np.array([xi]))
    assert found[0, 0] == pytest.approx(np.tan(angle[0]), rel=1e-9)
    assert np.all(np.isnan(found[1:]))


def test_no_ray_past_the_rim_of_the_sphere() -> None:
    rim = 1.0 / np.sqrt(1.8**2 - 1.0)
    assert np.all(np.isnan(OMNI.undistort(np.array([1.01 * rim, 0.0]), np.array([1.8]))))


def test_focal_lengths_are_those_on_the_axis() -> None:
    camera = Camera.make((640, 480), (1200.0, 1210.0), (320.0, 240.0), "omni", [2.0])
    aside = camera.denormalize(np.array([1e-6, 2e-6])) - (320.0, 240.0)
    np.testing.assert_allclose(aside, [1e-6 * camera.fx, 2e-6 * camera.fy], rtol=1e-6)
    assert camera.fx == pytest.approx(400.0)
    assert camera.matrix[0, 0] == 1200.0
