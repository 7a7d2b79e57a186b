"""The compiled FAST corners are those of OpenCV, in the order of its response."""

import cv2
import numpy as np
import pytest

from ovmot.frontend.fast_kernel import fast_corners_compiled
from ovmot.geometry.arrays import FloatArray, Image


def picture(shape: tuple[int, int], sharpness: float) -> Image:
    noise = np.random.default_rng(0).integers(0, 255, shape).astype(np.uint8)
    return np.asarray(cv2.GaussianBlur(noise, (0, 0), sharpness), dtype=np.uint8)


def by_opencv(image: Image, room: Image, threshold: int, border_px: int) -> FloatArray:
    """Corners (M, 2), the strongest first."""
    detector = cv2.FastFeatureDetector.create(threshold, nonmaxSuppression=True)
    keypoints = sorted(detector.detect(image, room), key=lambda k: -k.response)
    points = np.array([k.pt for k in keypoints]).reshape(-1, 2)
    inside = (points >= border_px) & (points < np.array(image.shape[::-1]) - border_px)
    return np.asarray(points[inside.all(axis=1)])


@pytest.mark.parametrize("shape", [(100, 160), (61, 77), (9, 11)])
@pytest.mark.parametrize(("sharpness", "threshold"), [(0.6, 40), (1.0, 10), (2.0, 1)])
@pytest.mark.parametrize("border_px", [0, 7])
def test_corners_are_those_of_opencv(
    shape: tuple[int, int], sharpness: float, threshold: int, border_px: int
) -> None:
    image, everywhere = picture(shape, sharpness), np.full(shape, 255, dtype=np.uint8)
    expected = by_opencv(image, everywhere, threshold, border_px)
    found = fast_corners_compiled(image, everywhere, threshold, border_px)
    np.testing.assert_array_equal(found, expected)
    room = (np.random.default_rng(1).random(shape) < 0.3).astype(np.uint8)
    np.testing.assert_array_equal(
        fast_corners_compiled(image, room, threshold, border_px),
        by_opencv(image, room, threshold, border_px),
    )


def test_black_and_white_differ_by_all_grey_levels() -> None:
    image = np.zeros((40, 40), dtype=np.uint8)
    image[20, 20], image[10, 10] = 255, 254
    everywhere = np.full_like(image, 1)
    found = fast_corners_compiled(image, everywhere, 253, 3)
    np.testing.assert_array_equal(found, [[20.0, 20.0], [10.0, 10.0]])


def test_a_picture_without_contrast_has_none() -> None:
    grey = np.full((40, 50), 90, dtype=np.uint8)
    assert fast_corners_compiled(grey, grey, 1, 0).shape == (0, 2)
    assert fast_corners_compiled(picture((5, 5), 0.6), grey[:5, :5].copy(), 10, 0).shape == (0, 2)
