"""A sequence put together: frames that the IMU covers."""

from dataclasses import replace
from pathlib import Path

import cv2
import pytest

from ovmot.datasets import open_sequence
from ovmot.datasets.calibration import Calibration
from ovmot.errors import DatasetError

FIRST_NS = 1_403_636_580_000_000_555


def imu_file(root: Path) -> Path:
    return root / "mav0" / "imu0" / "data.csv"


def test_opening_many_frames_decodes_none(kaist: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("an image was decoded")

    stamps = [FIRST_NS + i * 500_000 for i in range(1000)]
    for side in ("left", "right"):
        for stamp in stamps:
            (kaist / "image" / f"stereo_{side}" / f"{stamp}.png").touch()
    (kaist / "sensor_data" / "stereo_stamp.csv").write_text("\n".join(map(str, stamps)))
    monkeypatch.setattr(cv2, "imdecode", refuse)
    assert len(open_sequence(kaist)) == 1000


def test_stamps_of_another_unit(euroc: Path) -> None:
    """Microseconds in all files overlap as well as nanoseconds do."""
    rows = imu_file(euroc).read_text().splitlines()
    parts = [row.partition(",") for row in rows[1:]]
    in_us = [f"{int(stamp) // 1000},{rest}" for stamp, _, rest in parts]
    imu_file(euroc).write_text("\n".join([rows[0], *in_us]))
    with pytest.raises(DatasetError, match=r"imu0/data\.csv: 121 samples within 600000 ns; stamps"):
        open_sequence(euroc)
    imu_file(euroc).unlink()
    for camera in ("cam0", "cam1"):
        folder = euroc / "mav0" / camera
        (folder / "data.csv").unlink()
        for image in (folder / "data").iterdir():
            image.rename(image.with_name(f"{int(image.stem) // 1000}.png"))
    with pytest.raises(DatasetError, match=r"tiny: 6 stereo pairs within 500000 ns; stamps"):
        open_sequence(euroc)


def test_frames_outside_the_imu_are_dropped(euroc: Path) -> None:
    path = imu_file(euroc)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], *lines[20:100]]))
    sequence = open_sequence(euroc)
    assert sequence.counts == {"frames_outside_imu": 2}
    assert sequence.frame_ns[0] == FIRST_NS + 100_000_000


def test_imu_of_another_clock(euroc: Path) -> None:
    path = imu_file(euroc)
    lines = path.read_text().splitlines()
    path.write_text("\n".join(str(int(line[:19]) - 10**18) + line[19:] for line in lines[1:]))
    with pytest.raises(DatasetError, match="do not overlap; stamps are nanoseconds of one clock"):
        open_sequence(euroc)


def test_a_time_offset_that_leaves_no_frame_is_named(euroc: Path, tmp_path: Path) -> None:
    rig = replace(open_sequence(euroc).rig, time_offset_s=-1000.0)
    with pytest.raises(DatasetError, match=r"images .*, moved by the time offset of -1000 s"):
        open_sequence(euroc, calibration=Calibration(rig, None))
