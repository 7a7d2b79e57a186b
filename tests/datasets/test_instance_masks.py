"""Masks made of instance images."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.instance_masks import (
    InstanceImages,
    InstanceMasks,
    read_colours,
)
from ovmot.errors import DatasetError, InputError


def test_colours_and_ids_of_segmentation(painted_rig: StereoRig, tmp_path: Path) -> None:
    (tmp_path / "rgb_ids.txt").write_text("id,r,g,b\n7,10,20,30\n8,10,20,31\n")
    colours = read_colours(tmp_path / "rgb_ids.txt")
    image = np.zeros((240, 320, 3), dtype=np.uint8)
    image[:10], image[10:20] = (30, 20, 10), (31, 20, 10)  # blue first, as OpenCV writes
    cv2.imwrite(str(tmp_path / "5.png"), image)
    cv2.imwrite(str(tmp_path / "6.png"), np.full((240, 320), 7, dtype=np.uint8))
    paths = {n: tmp_path / f"{n}.png" for n in (5, 6)}
    masks = InstanceMasks.make(InstanceImages((paths, {}), colours), (7,), painted_rig)
    left, right = masks.of(5)
    assert left is not None and right is None
    np.testing.assert_array_equal(np.flatnonzero(left.any(axis=1)), np.arange(10))
    grey, _ = masks.of(6)
    assert grey is not None and grey.all()
    cv2.imwrite(str(tmp_path / "5.png"), image[:100])
    with pytest.raises(InputError, match=r"5\.png: is 320x100, the camera 320x240"):
        masks.of(5)
    for row in ("8,10,20,310", "1e19,10,20,31"):
        (tmp_path / "rgb_ids.txt").write_text(f"id,r,g,b\n7,10,20,30\n{row}\n")
        with pytest.raises(DatasetError, match=r"rgb_ids\.txt, row 3: no colour"):
            read_colours(tmp_path / "rgb_ids.txt")
