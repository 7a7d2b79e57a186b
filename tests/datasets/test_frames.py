"""Which stereo frames a folder holds: pairs, stamps, names."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets import events, open_recording, open_sequence
from ovmot.datasets.frames import listed_frames, match_stamps
from ovmot.errors import DatasetError
from ovmot.types import StereoFrame

FIRST_NS = 1_403_636_580_000_000_555


def test_single_images_are_frames_and_counted(euroc: Path) -> None:
    """A black image stands for the one that is missing; the others are the frame's own."""
    (euroc / "mav0" / "cam1" / "data" / f"{FIRST_NS + 100_000_000}.png").unlink()
    (euroc / "mav0" / "cam0" / "data" / f"{FIRST_NS + 300_000_000}.png").unlink()
    sequence = open_sequence(euroc)
    assert len(sequence) == 6
    assert sequence.missing == {1: 1, 3: 0}
    assert sequence.counts == {"unpaired_images": 2}
    assert len(sequence.warnings) == 1
    assert "1 left and 1 right" in sequence.warnings[0]
    for first in range(6):
        stream = events(sequence, first=first)
        seen = [event for event in stream if isinstance(event, StereoFrame)]
        stamps = [FIRST_NS + i * 100_000_000 for i in range(first, 6)]
        assert [frame.timestamp_ns for frame in seen] == stamps
        for i, frame in enumerate(seen, start=first):
            left, right = frame.pair
            assert frame.missing == {1: (1,), 3: (0,)}.get(i, ())
            assert np.all(left == (0 if i == 3 else 10 * i))
            assert np.all(right == (0 if i == 1 else 10 * (i + 10)))
            assert left.shape == right.shape


def test_the_pairs_alone(euroc: Path) -> None:
    (euroc / "mav0" / "cam1" / "data" / f"{FIRST_NS + 100_000_000}.png").unlink()
    (euroc / "mav0" / "cam0" / "data" / f"{FIRST_NS + 300_000_000}.png").unlink()
    pairs = open_sequence(euroc).of_pairs()
    stamps = [FIRST_NS + i * 100_000_000 for i in (0, 2, 4, 5)]
    assert (pairs.frame_ns.tolist(), pairs.missing) == (stamps, {})
    assert pairs.frame_number.tolist() == [0, 2, 4, 5]
    assert [int(path.stem) for path in pairs.left_paths] == stamps
    assert [int(path.stem) for path in pairs.right_paths] == stamps


def test_half_of_a_camera_missing_makes_single_frames(kaist: Path) -> None:
    for path in sorted((kaist / "image" / "stereo_right").iterdir())[:4]:
        path.unlink()
    sequence = open_sequence(kaist)
    assert (len(sequence), sequence.counts["unpaired_images"]) == (6, 4)
    assert sequence.missing == dict.fromkeys(range(4), 1)
    assert "4 left and 0 right images without a partner (of 6 and 2)" in sequence.warnings[-1]


def test_single_images_are_listed(euroc: Path) -> None:
    """What has no partner is listed among the pairs, the other side missing."""
    right, left = (euroc / "mav0" / camera / "data" for camera in ("cam1", "cam0"))
    (right / f"{FIRST_NS + 100_000_000}.png").unlink()
    (left / f"{FIRST_NS + 300_000_000}.png").unlink()
    frames = listed_frames(open_sequence(euroc).listing)
    assert [f.timestamp_ns for f in frames] == [FIRST_NS + i * 100_000_000 for i in range(6)]
    assert [f.left is None for f in frames] == [i == 3 for i in range(6)]
    assert [f.right is None for f in frames] == [i == 1 for i in range(6)]


def shift_right(folder: Path, shifts_ns: list[int]) -> None:
    """Other stamps for the right images, a shift each."""
    for path, shift in zip(sorted(folder.iterdir()), shifts_ns, strict=True):
        path.rename(folder / f"{int(path.stem) + shift}.png")


@pytest.mark.parametrize("listed", [True, False])
def test_pairs_by_the_nearest_stamp(euroc: Path, listed: bool) -> None:
    """Cameras that a computer stamps, up to 3 ms apart."""
    camera = euroc / "mav0" / "cam1"
    shifts = [3_000_000, -2_999_999, 0, 17, -1, 2_000_000]
    shift_right(camera / "data", shifts)
    stamps = [FIRST_NS + i * 100_000_000 for i in range(6)]
    (camera / "data.csv").unlink()
    if listed:
        rows = "".join(f"{t + d},{t + d}.png\n" for t, d in zip(stamps, shifts, strict=True))
        (camera / "data.csv").write_text(f"#timestamp [ns],filename\n{rows}")
    sequence = open_sequence(euroc)
    assert sequence.frame_ns.tolist() == stamps
    assert [int(p.stem) for p in sequence.right_paths] == [
        t + d for t, d in zip(stamps, shifts, strict=True)
    ]
    assert sequence.counts == {"pairs_of_unequal_stamps": 5}
    assert "differ by up to 3 ms" in sequence.warnings[0]
    with pytest.raises(DatasetError, match=r"6 left and 6 right images, only 0 pairs: .* 39503 ms"):
        move_all(camera / "data", 40_000_000_000)
        open_sequence(euroc)


def move_all(folder: Path, shift_ns: int) -> None:
    (folder.parent / "data.csv").unlink(missing_ok=True)
    # the last one first: its new name is free
    for path in sorted(folder.iterdir(), reverse=True):
        path.rename(folder / f"{int(path.stem) + shift_ns}.png")


def test_the_tolerance_is_a_setting(euroc: Path) -> None:
    camera = euroc / "mav0" / "cam1"
    (camera / "data.csv").unlink()
    shift_right(camera / "data", [8_000_000] * 6)
    with pytest.raises(DatasetError, match=r"the nearest stamps are 8 ms apart; .*0\.005 s .--set"):
        open_sequence(euroc)
    assert len(open_recording(euroc, pair_tolerance_s=0.01)) == 6


def test_one_list_of_stamps_for_both_cameras(kaist: Path) -> None:
    """KAIST lists one stamp for both: the right image may be stamped a little apart."""
    shift_right(kaist / "image" / "stereo_right", [1_000_000] * 6)
    sequence = open_sequence(kaist)
    assert len(sequence) == 6
    assert sequence.frame_ns.tolist() == [FIRST_NS + i * 100_000_000 for i in range(6)]


def test_numbers_are_paired_by_number(kitti_tracking: Path) -> None:
    """Frame numbers are no nanoseconds: 3 is not near 4."""
    left, right = (kitti_tracking / f"image_0{i}" / "0010" for i in (2, 3))
    names = sorted(path.name for path in left.iterdir())
    (left / names[0]).unlink()
    (right / names[1]).unlink()
    sequence = open_sequence(kitti_tracking)
    assert (len(sequence), sequence.counts) == (len(names), {"unpaired_images": 2})
    assert sequence.missing == {0: 0, 1: 1}
    assert sequence.frame_number.tolist() == [int(Path(name).stem) for name in names]


@pytest.mark.parametrize(
    ("left", "right", "pairs"),
    [
        ([0, 10, 20], [1, 9, 21], {0: 1, 10: 9, 20: 21}),
        ([0, 10, 20], [9, 11], {10: 11}),  # of two as near, the later one
        ([0, 10], [5], {10: 5}),
        ([0, 10], [16], {}),
        ([], [16], {}),
    ],
)
def test_match_stamps(left: list[int], right: list[int], pairs: dict[int, int]) -> None:
    assert match_stamps(left, right, 5) == pairs


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
