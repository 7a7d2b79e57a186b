"""What images look like: dark, flat, uneven, copied."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.doctor.images import ImageStatistics, check_images, image_statistics
from ovmot.doctor.report import Severity
from ovmot.geometry.arrays import Image
from ovmot.types import StereoFrame

RNG = np.random.default_rng(3)
SCENE = RNG.integers(20, 230, (8, 64, 64)).astype(np.uint8)


def severities(change: Callable[[Image], Image], side: str = "both") -> dict[str, Severity]:
    looks: list[ImageStatistics] = []
    for i, image in enumerate(SCENE):
        left, right = image, np.roll(image, -3, axis=1)
        left = change(left) if side != "right" else left
        frame = StereoFrame(i, left, change(right))
        looks.append(image_statistics(frame, looks[-1] if looks else None))
    return {f.check: f.severity for f in check_images(looks) if f.severity is not Severity.FINE}


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda x: x, {}),
        (lambda x: x // 10 + 100, {"contrast": Severity.DOUBTFUL}),
        (lambda x: x // 64 + 100, {"contrast": Severity.WRONG}),
        (lambda x: np.where(x > 180, 255, x).astype(np.uint8), {"exposure": Severity.DOUBTFUL}),
        (lambda x: np.where(x < 180, 0, x).astype(np.uint8), {"exposure": Severity.WRONG}),
    ],
)
def test_images(change: Callable[[Image], Image], expected: dict[str, Severity]) -> None:
    assert severities(change) == expected


def test_uneven_cameras() -> None:
    assert severities(lambda x: x // 2, side="right") == {"brightness": Severity.DOUBTFUL}


def test_copied_images() -> None:
    same_sides = [image_statistics(StereoFrame(0, SCENE[0], SCENE[0]), None)]
    assert check_images(same_sides)[-1].severity is Severity.WRONG
    first = image_statistics(StereoFrame(0, SCENE[0], SCENE[1]), None)
    again = image_statistics(StereoFrame(1, SCENE[0], SCENE[2]), first)
    assert check_images([first, again])[-1].severity is Severity.WRONG
