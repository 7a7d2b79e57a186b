"""Which stereo frames a folder holds: pairs, stamps, names."""

import shutil
from pathlib import Path

import pytest

from ovmot.datasets import open_sequence
from ovmot.errors import DatasetError

FIRST_NS = 1_403_636_580_000_000_555


def test_unpaired_images_are_dropped_and_counted(euroc: Path) -> None:
    (euroc / "mav0" / "cam1" / "data" / f"{FIRST_NS + 100_000_000}.png").unlink()
    (euroc / "mav0" / "cam0" / "data" / f"{FIRST_NS + 300_000_000}.png").unlink()
    sequence = open_sequence(euroc)
    assert len(sequence) == 4
    assert sequence.counts == {"unpaired_images": 2}
    assert "1 left and 1 right" in sequence.warnings[0]


def test_half_of_a_camera_missing_is_refused(kaist: Path) -> None:
    for path in sorted((kaist / "image" / "stereo_right").iterdir())[:4]:
        path.unlink()
    with pytest.raises(DatasetError, match="6 left and 2 right images, only 2 pairs"):
        open_sequence(kaist)


@pytest.mark.parametrize("keep_folder", [True, False])
def test_one_camera_missing(euroc: Path, keep_folder: bool) -> None:
    folder = euroc / "mav0" / "cam1" / "data"
    shutil.rmtree(folder)
    if keep_folder:
        folder.mkdir()
    message = "no images in this folder" if keep_folder else "no such folder"
    with pytest.raises(DatasetError, match=message) as caught:
        open_sequence(euroc)
    assert str(folder) in str(caught.value)


def test_names_that_are_no_numbers(kitti_tracking: Path) -> None:
    folder = kitti_tracking / "image_03" / "0010"
    (folder / "000002.png").rename(folder / "left-2.png")
    with pytest.raises(DatasetError, match=r"left-2\.png: the file name is not a number"):
        open_sequence(kitti_tracking)


def test_stamps_that_name_no_image_at_all(kaist: Path) -> None:
    (kaist / "sensor_data" / "stereo_stamp.csv").write_text("1\n2\n")
    with pytest.raises(DatasetError, match="none of its 2 stamps has an image"):
        open_sequence(kaist)


def test_frame_stamps_backwards_twice_or_unreadable(kaist: Path) -> None:
    listed = kaist / "sensor_data" / "stereo_stamp.csv"
    stamps = [str(FIRST_NS + i * 100_000_000) for i in range(6)]
    listed.write_text("\n".join([*stamps[:2], stamps[1], *stamps[2:]]))
    sequence = open_sequence(kaist)
    assert (len(sequence), sequence.counts) == (6, {"duplicate_frames": 1})
    listed.write_text("\n".join([stamps[0], stamps[2], stamps[1], *stamps[3:]]))
    sequence = open_sequence(kaist)
    assert (len(sequence), sequence.counts) == (5, {"frame_rows_out_of_order": 1})
    listed.write_text("\n".join(reversed(stamps)))
    with pytest.raises(DatasetError, match=r"stereo_stamp\.csv, row 2: most stamps do not follow"):
        open_sequence(kaist)
    listed.write_text("\n".join([stamps[0], "1.4e18"]))
    with pytest.raises(DatasetError, match=r"stereo_stamp\.csv, row 2: '1\.4e18' is not a stamp"):
        open_sequence(kaist)
    listed.write_text("")
    with pytest.raises(DatasetError, match=r"holds no data"):
        open_sequence(kaist)


def test_a_name_of_absurd_length_is_no_stamp(euroc: Path) -> None:
    folder = euroc / "mav0" / "cam0"
    (folder / "data.csv").unlink()
    next((folder / "data").iterdir()).rename(folder / "data" / f"{'9' * 25}.png")
    with pytest.raises(DatasetError, match=r"9{25}\.png: the file name is not a number"):
        open_sequence(euroc)
