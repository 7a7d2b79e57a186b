"""VIODE folders and what they hold beside an ASL folder."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from ovmot.datasets import open_sequence


def test_viode(viode: Path) -> None:
    for stamp in (1403636580000000555, 1403636580100000555):
        for camera in ("cam0", "cam1"):
            image = np.zeros((24, 32, 3), dtype=np.uint8)
            cv2.imwrite(str(viode / f"mav0/{camera}/segmentation/{stamp}.png"), image)
    (viode.parent / "rgb_ids.txt").write_text("id,r,g,b\n241,49,89,160\n")
    sequence = open_sequence(viode)
    assert (sequence.kind, sequence.name, len(sequence)) == ("viode", "MH_tiny", 6)
    assert sequence.rig.baseline == pytest.approx(0.05)
    assert sequence.rig.time_offset_s == 0.01
    assert sequence.imu_noise is None
    assert sequence.instances is not None
    assert dict(sequence.instances.colours) == {241: (49, 89, 160)}
    assert [len(images) for images in sequence.instances.images] == [2, 2]
