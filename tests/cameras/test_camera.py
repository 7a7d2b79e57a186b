"""A camera: pixels to rays and back, derivatives, agreement with OpenCV, impossible cameras."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.models import CAMERA_MODELS
from ovmot.errors import CalibrationError, InputError
from ovmot.geometry.arrays import FloatArray

CAMERAS = {
    "none": Camera.make((1242, 375), (721.5, 721.5), (609.6, 172.9)),
    "radtan4": Camera.make(
        (752, 480), (458.654, 457.296), (367.215, 248.375), "radtan",
        [-0.28340811, 0.07395907, 1.9359e-4, 1.76187114e-05],
    ),
    "radtan5, skew": Camera.make(
        (1280, 560), (816.9, 811.5), (608.5, 263.4), "radtan",
        [-5.6e-2, 8.7e-2, -2.1e-4, 4.5e-4, -3.2e-2], skew=0.83,
    ),
    "equidistant, skew": Camera.make(
        (512, 512), (190.97, 190.97), (254.93, 256.89), "equidistant",
        [-0.0072, 0.0065, -0.0101, 0.0032], skew=-1.5,
    ),
}  # fmt: skip
SHAPES = [(), (1,), (4,), (2, 3)]

Derivative = Callable[..., FloatArray]
cameras = pytest.mark.parametrize("name", CAMERAS)


def pixels_of(camera: Camera, shape: tuple[int, ...]) -> FloatArray:
    size = np.array([camera.width - 1.0, camera.height - 1.0])
    out: FloatArray = np.random.default_rng(1).uniform(0.05, 0.95, size=(*shape, 2)) * size
    return out


@cameras
@pytest.mark.parametrize("shape", SHAPES)
def test_pixel_to_ray_to_point_to_pixel(name: str, shape: tuple[int, ...]) -> None:
    camera = CAMERAS[name]
    pixels = pixels_of(camera, shape)
    xy = camera.normalize(pixels)
    np.testing.assert_allclose(camera.denormalize(xy), pixels, atol=1e-9)
    depth = np.random.default_rng(2).uniform(0.5, 50.0, size=(*shape, 1))
    points = depth * np.concatenate([xy, np.ones((*shape, 1))], axis=-1)
    np.testing.assert_allclose(camera.project(points), pixels, atol=1e-9)


@cameras
def test_the_optical_axis_meets_the_image_at_the_centre(name: str) -> None:
    camera = CAMERAS[name]
    np.testing.assert_allclose(
        camera.project(np.array([0.0, 0.0, 3.0])), camera.matrix[:2, 2], atol=1e-12
    )


@cameras
@pytest.mark.parametrize("point", [(0.0, 0.0, 2.0), (1.0, -0.5, 4.0), (-8.0, 3.0, 15.0)])
def test_projection_derivative_by_differences(
    name: str, point: tuple[float, ...], central_differences: Derivative
) -> None:
    camera, p = CAMERAS[name], np.array(point)
    pixels, J = camera.project_with_jacobian(p)
    np.testing.assert_allclose(pixels, camera.project(p), atol=1e-12)
    np.testing.assert_allclose(J, central_differences(camera.project, p), rtol=1e-6, atol=1e-6)


@cameras
@pytest.mark.parametrize("shape", SHAPES)
def test_projection_derivative_of_a_batch(name: str, shape: tuple[int, ...]) -> None:
    camera = CAMERAS[name]
    points = np.random.default_rng(3).uniform([-2, -1, 3], [2, 1, 9], size=(*shape, 3))
    pixels, J = camera.project_with_jacobian(points)
    assert pixels.shape == (*shape, 2)
    assert J.shape == (*shape, 2, 3)
    for index in np.ndindex(shape):
        np.testing.assert_allclose(
            J[index], camera.project_with_jacobian(points[index])[1], atol=1e-10
        )


@cameras
def test_points_behind_the_camera_have_no_image(name: str) -> None:
    camera = CAMERAS[name]
    points = np.array([[0.1, 0.2, -3.0], [0.1, 0.2, 0.0], [0.1, 0.2, 3.0]])
    seen = np.isfinite(camera.project(points)).all(axis=-1)
    assert seen.tolist() == [False, False, True]
    pixels, J = camera.project_with_jacobian(points)
    assert np.isfinite(pixels).all(axis=-1).tolist() == [False, False, True]
    assert np.isfinite(J[2]).all()
    assert np.isnan(J[:2]).any(axis=(-2, -1)).all()


def test_skew_adds_to_u_in_proportion_to_y() -> None:
    straight = Camera.make((100, 100), (50.0, 60.0), (40.0, 45.0))
    skewed = Camera.make((100, 100), (50.0, 60.0), (40.0, 45.0), skew=5.0)
    xy = np.array([0.2, 0.3])
    difference = skewed.denormalize(xy) - straight.denormalize(xy)
    np.testing.assert_allclose(difference, [1.5, 0.0], atol=1e-12)
    np.testing.assert_allclose(skewed.matrix @ [0.2, 0.3, 1.0], [51.5, 63.0, 1.0])


def scene_points(count: int = 60) -> FloatArray:
    return np.random.default_rng(4).uniform([-3, -2, 4], [3, 2, 12], size=(count, 3))


def test_radtan_camera_agrees_with_opencv() -> None:
    camera, points = CAMERAS["radtan4"], scene_points()
    theirs, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), camera.matrix, camera.distortion
    )
    np.testing.assert_allclose(camera.project(points), theirs[:, 0], atol=1e-9)


def test_skewed_fisheye_camera_agrees_with_opencv() -> None:
    camera, points = CAMERAS["equidistant, skew"], scene_points()
    alpha = float(camera.intrinsics[4]) / camera.fx  # OpenCV: u = fx (x + alpha y) + cx
    theirs, _ = cv2.fisheye.projectPoints(
        points[:, None], np.zeros(3), np.zeros(3), camera.matrix, camera.distortion, alpha=alpha
    )
    np.testing.assert_allclose(camera.project(points), theirs[:, 0], atol=1e-9)


def test_inside_counts_the_outermost_pixel_centres() -> None:
    camera = Camera.make((100, 80), (50.0, 50.0), (49.5, 39.5))
    pixels = np.array([[0, 0], [99, 79], [-0.1, 5], [99.1, 5], [5, 79.1], [np.nan, 5]])
    assert camera.inside(pixels).tolist() == [True, True, False, False, False, False]
    assert camera.inside(np.array([[4.9, 20], [5, 5], [94, 74]]), 5.0).tolist() == [
        False, True, True,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"size": (0, 480)}, "impossible"),
        ({"focal": (-400.0, 400.0)}, "impossible"),
        ({"focal": (0.0, 400.0)}, "impossible"),
        ({"focal": (np.nan, 400.0)}, "finite"),
        ({"center": (np.inf, 200.0)}, "finite"),
        ({"model": "pinhole-radtan8"}, f"known: {', '.join(CAMERA_MODELS)}"),
        ({"distortion": [0.1, 0.2, 0.3]}, "4 or 5 coefficients, got 3"),
        ({"distortion": [0.1, 0.2, 0.3, np.nan]}, "finite"),
    ],
)
def test_impossible_cameras_are_refused(change: dict[str, Any], word: str) -> None:
    good: dict[str, Any] = {
        "size": (752, 480), "focal": (458.0, 457.0), "center": (367.0, 248.0),
        "model": "radtan", "distortion": [0.0, 0.0, 0.0, 0.0],
    }  # fmt: skip
    Camera.make(**good)
    with pytest.raises(CalibrationError, match=word) as caught:
        Camera.make(**(good | change))
    assert isinstance(caught.value, InputError)


def test_a_camera_of_a_matrix_is_that_of_its_numbers() -> None:
    K = [[458.0, 0.5, 367.0], [0.0, 457.0, 248.0], [0.0, 0.0, 1.0]]
    distortion = [-0.28, 0.07, 1e-4, 2e-5]
    made = Camera.from_matrix(K, (752, 480), "radtan", distortion)
    same = Camera.make((752, 480), (458.0, 457.0), (367.0, 248.0), "radtan", distortion, 0.5)
    np.testing.assert_array_equal(made.intrinsics, same.intrinsics)
    np.testing.assert_array_equal(made.distortion, same.distortion)
    np.testing.assert_array_equal(made.matrix, K)
    assert (made.width, made.height) == (752, 480)
    assert Camera.from_matrix(np.array(K), (752, 480)).distortion.size == 0
    for wrong in (np.eye(4), np.eye(3)[:2], np.array(K).T):
        with pytest.raises(CalibrationError, match="a camera matrix is"):
            Camera.from_matrix(wrong, (752, 480))
