"""Images from files: grey, 8 bits."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from ovmot.datasets.bag.file import Bag
from ovmot.datasets.images import image_size, read_grey
from ovmot.errors import DatasetError


def test_images_of_16_bits_become_8(tmp_path: Path) -> None:
    grey = np.arange(0, 256, dtype=np.uint16).reshape(16, 16)
    cv2.imwrite(str(tmp_path / "16.png"), grey * 257)
    np.testing.assert_array_equal(read_grey(tmp_path / "16.png"), grey)


def test_a_pointer_of_git_lfs_is_named(tmp_path: Path) -> None:
    path = tmp_path / "1.png"
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n")
    for read in (read_grey, image_size):
        with pytest.raises(DatasetError, match=r"1\.png: is a Git LFS pointer.*git lfs pull"):
            read(path)
    bag = path.rename(tmp_path / "drive.bag")
    with pytest.raises(DatasetError, match=r"drive\.bag: is a Git LFS pointer"):
        Bag(bag)
