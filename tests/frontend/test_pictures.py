"""Pictures that show nothing of now are told from those that do."""

import numpy as np
import pytest

from ovmot.errors import OvmotError
from ovmot.frontend.pictures import LastPictures, judge_pictures
from ovmot.geometry.arrays import Image
from ovmot.types import FeatureFrame, Picture, StereoFrame

SHAPE = (64, 96)
FINE = (Picture.FINE, Picture.FINE)


def noisy(seed: int) -> Image:
    """Texture with noise of its own."""
    rng = np.random.default_rng(seed)
    texture = np.add.outer(np.arange(SHAPE[0]), np.arange(SHAPE[1])) % 90 + 60
    return (texture + rng.integers(0, 5, SHAPE)).astype(np.uint8)


def frame(left: Image, right: Image, missing: tuple[int, ...] = ()) -> StereoFrame:
    return StereoFrame(0, left, right, missing=missing)


@pytest.fixture
def last() -> LastPictures:
    """After two ordinary frames."""
    _, kept = judge_pictures(frame(noisy(0), noisy(1)), LastPictures(), moving=True)
    return judge_pictures(frame(noisy(2), noisy(3)), kept, moving=True)[1]


def test_ordinary_pictures_are_fine(last: LastPictures) -> None:
    assert judge_pictures(frame(noisy(4), noisy(5)), last, moving=True)[0] == FINE
    assert judge_pictures(frame(noisy(4), noisy(5)), LastPictures(), moving=True)[0] == FINE


def test_the_same_picture_again_is_repeated_where_the_rig_moves(last: LastPictures) -> None:
    again = frame(noisy(2), noisy(5))
    assert judge_pictures(again, last, moving=True)[0] == (Picture.REPEATED, Picture.FINE)
    assert judge_pictures(again, last, moving=False)[0] == FINE
    # and each time again
    kept = judge_pictures(again, last, moving=True)[1]
    assert judge_pictures(frame(noisy(2), noisy(6)), kept, moving=True)[0][0] == Picture.REPEATED


def test_rows_of_the_last_picture_make_a_torn_one(last: LastPictures) -> None:
    torn = noisy(7)
    torn[40:] = noisy(3)[40:]
    pictures, _ = judge_pictures(frame(noisy(6), torn), last, moving=True)
    assert pictures == (Picture.FINE, Picture.TORN)


def textured(x: float, seed: int) -> Image:
    """A smooth texture shifted by x, with noise of its own."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    u += x
    waves = np.sin(0.31 * u + 0.05 * v) + np.sin(0.13 * u - 0.11 * v) + np.sin(0.71 * u + 1.0)
    noise = np.random.default_rng(seed).integers(0, 5, SHAPE)
    grey: Image = (100.0 + 25.0 * waves + noise).astype(np.uint8)
    return grey


def test_each_of_several_torn_pictures_is_told() -> None:
    """Each has the upper half of the one before, so that no row comes twice after the first."""
    whole = [textured(9.0 * k, k) for k in range(7)]
    halves = [np.concatenate([whole[k - 1][:32], whole[k][32:]]) for k in range(1, 7)]
    came = [whole[0], whole[1], *halves[1:4], whole[5], whole[6]]
    kept, said = LastPictures(), []
    for k, left in enumerate(came):
        (picture, _), kept = judge_pictures(frame(left, noisy(10 + k)), kept, moving=True)
        said.append(picture)
    torn = Picture.TORN
    assert said == [Picture.FINE, Picture.FINE, torn, torn, torn, Picture.FINE, Picture.FINE]


def test_what_is_equal_in_every_picture_tears_none() -> None:
    """A dashboard of a rendered scene: its rows never change."""
    kept = LastPictures()
    for k in range(4):
        left = noisy(k)
        left[50:] = noisy(99)[50:]
        pictures, kept = judge_pictures(frame(left, noisy(10 + k)), kept, moving=True)
        if k != 1:  # at first it is no more than rows of the picture before
            assert pictures == FINE


@pytest.mark.parametrize("grey", [0, 255, 90])
def test_a_picture_without_contrast_is_flat(last: LastPictures, grey: int) -> None:
    flat = np.full(SHAPE, grey, dtype=np.uint8)
    assert judge_pictures(frame(flat, noisy(5)), last, moving=True)[0][0] == Picture.FLAT


def test_a_missing_picture_leaves_the_one_to_compare_with(last: LastPictures) -> None:
    black = np.zeros(SHAPE, dtype=np.uint8)
    pictures, kept = judge_pictures(frame(noisy(4), black, missing=(1,)), last, moving=True)
    assert pictures == (Picture.FINE, Picture.MISSING)
    assert judge_pictures(frame(noisy(5), noisy(3)), kept, moving=True)[0][1] == Picture.REPEATED


def test_features_are_no_pictures() -> None:
    features = FeatureFrame(5, np.empty(0, dtype=np.int64), np.empty((0, 4)))
    with pytest.raises(OvmotError, match="images were expected"):
        judge_pictures(features, LastPictures(), moving=True)
