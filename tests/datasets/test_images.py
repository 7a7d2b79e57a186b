"""Images from files: grey, 8 bits."""

from pathlib import Path

import cv2
import numpy as np

from ovmot.datasets.images import read_grey


def test_images_of_16_bits_become_8(tmp_path: Path) -> None:
    grey = np.arange(0, 256, dtype=np.uint16).reshape(16, 16)
    cv2.imwrite(str(tmp_path / "16.png"), grey * 257)
    np.testing.assert_array_equal(read_grey(tmp_path / "16.png"), grey)
