"""TUM-VI folders: both layouts, and what is refused."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from ovmot.datasets import open_sequence
from ovmot.errors import DatasetError

Edit = Callable[[Path, str, str], None]


def test_tum_vi(tum_vi: Path) -> None:
    sequence = open_sequence(tum_vi)
    assert (sequence.kind, sequence.name, len(sequence)) == ("tum_vi", "MH_tiny", 6)
    assert sequence.rig.cam0.model.name == "equidistant"
    assert sequence.imu_noise is not None
    assert sequence.imu_noise.accel == 0.0014
    (tum_vi / "dso" / "imu_config.yaml").unlink()
    assert open_sequence(tum_vi).counts == {"no_imu_noise": 1}


def dso_alone(tum_vi: Path) -> Path:
    for camera in ("cam0", "cam1"):
        (tum_vi / "dso" / camera).mkdir()
        images = tum_vi / "dso" / camera / "images"
        (tum_vi / "mav0" / camera / "data").rename(images)
        rows = (f"{p.stem} {int(p.stem) / 1e9:.9f} 5.0" for p in sorted(images.iterdir()))
        text = "\n".join(["# timestamp(ns) timestamp(s) exposure", *rows])
        (tum_vi / "dso" / camera / "times.txt").write_text(text)
    text = (tum_vi / "mav0/imu0/data.csv").read_text().replace(",", " ")
    (tum_vi / "dso" / "imu.txt").write_text(text)
    shutil.rmtree(tum_vi / "mav0")
    return tum_vi / "dso"


def test_dso_alone(tum_vi: Path, edit: Edit) -> None:
    dso = dso_alone(tum_vi)
    assert len(open_sequence(dso)) == len(open_sequence(tum_vi)) == 6
    edit(dso / "imu.txt", " 9.8\n", " 9.8 1\n")
    with pytest.raises(DatasetError, match=r"imu\.txt, row 2: 8 columns where 7"):
        open_sequence(dso)
    edit(dso / "cam1" / "times.txt", "1403636580200000555 ", "1403636580200000555.5 ")
    with pytest.raises(DatasetError, match=r"times\.txt, row 4: .* is not a stamp"):
        open_sequence(dso)
