"""Masks of all frames and of single ones, and what is wrong with them in one line."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.masks import open_masks, with_masks
from ovmot.errors import InputError
from ovmot.geometry.arrays import Image
from ovmot.types import Event, ImuSample, StereoFrame


def write(path: Path, mask: Image) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), mask)


def lower_half(rows: int = 240) -> Image:
    mask = np.zeros((rows, 320), dtype=np.uint8)
    mask[rows // 2 :] = 255
    return mask


def test_fixed_and_single_masks_are_joined(painted_rig: StereoRig, tmp_path: Path) -> None:
    write(tmp_path / "cam0.png", lower_half())
    corner = np.zeros((240, 320), dtype=np.uint8)
    corner[:10, :10] = 1
    write(tmp_path / "cam0" / "7.png", corner)
    masks = open_masks(tmp_path, painted_rig)
    left, right = masks.of(7)
    assert left is not None and right is None
    np.testing.assert_array_equal(left > 0, (lower_half() > 0) | (corner > 0))
    fixed, _ = masks.of(8)
    assert fixed is not None
    np.testing.assert_array_equal(fixed, lower_half())


def test_frames_get_their_masks(painted_rig: StereoRig, tmp_path: Path) -> None:
    write(tmp_path / "cam1" / "5.png", lower_half())
    grey = np.zeros((240, 320), dtype=np.uint8)
    sample = ImuSample(4, np.zeros(3), np.zeros(3))
    stream: list[Event] = [sample, StereoFrame(5, grey, grey), StereoFrame(6, grey, grey)]
    out = list(with_masks((e for e in stream), open_masks(tmp_path, painted_rig)))
    assert out[0] is sample
    assert isinstance(out[1], StereoFrame) and isinstance(out[2], StereoFrame)
    assert out[1].left_mask is None
    np.testing.assert_array_equal(out[1].right_mask, lower_half())
    assert out[2].right_mask is None


def test_masks_of_two_sources_are_joined(painted_rig: StereoRig, tmp_path: Path) -> None:
    write(tmp_path / "cam0.png", lower_half())
    grey = np.zeros((240, 320), dtype=np.uint8)
    corner = grey.copy()
    corner[:10, :10] = 1
    stream: list[Event] = [StereoFrame(5, grey, grey, corner, corner)]
    (frame,) = with_masks((e for e in stream), open_masks(tmp_path, painted_rig))
    assert isinstance(frame, StereoFrame) and frame.left_mask is not None
    np.testing.assert_array_equal(frame.left_mask > 0, (lower_half() > 0) | (corner > 0))
    np.testing.assert_array_equal(frame.right_mask, corner)


def test_mistakes_are_one_line(painted_rig: StereoRig, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no masks"):
        open_masks(tmp_path, painted_rig)
    write(tmp_path / "cam0.png", lower_half(100))
    with pytest.raises(InputError, match=r"cam0\.png: is 320x100, the camera 320x240"):
        open_masks(tmp_path, painted_rig)
    (tmp_path / "cam0.png").write_text("no image")
    with pytest.raises(InputError, match=r"cam0\.png: is no image"):
        open_masks(tmp_path, painted_rig)
