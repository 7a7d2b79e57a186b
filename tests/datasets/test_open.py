"""Opening folders: what is found, what is counted, and what is refused."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from ovmot.datasets import open_sequence
from ovmot.datasets.calibration import Calibration
from ovmot.datasets.findings import Findings
from ovmot.datasets.imu import checked_imu
from ovmot.datasets.text_tables import StampedTable
from ovmot.errors import CalibrationError, DatasetError, InputError

Edit = Callable[[Path, str, str], None]
FIRST_NS = 1_403_636_580_000_000_555


def imu_file(root: Path) -> Path:
    return root / "mav0" / "imu0" / "data.csv"


def test_euroc(euroc: Path) -> None:
    sequence = open_sequence(euroc)
    assert (sequence.kind, sequence.name, len(sequence)) == ("euroc", "MH_tiny", 6)
    assert sequence.frame_ns.tolist() == [FIRST_NS + i * 100_000_000 for i in range(6)]
    assert sequence.imu is not None
    assert len(sequence.imu) == 121
    np.testing.assert_array_equal(sequence.imu.gyro[7], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(sequence.imu.accel[7], [0.0, 0.5, 9.8])
    assert sequence.imu_noise is not None
    assert sequence.imu_noise.gyro_walk == 1.9393e-5
    assert sequence.warnings == ()
    assert open_sequence(euroc / "mav0").name == "MH_tiny"


def test_euroc_without_lists_of_images(euroc: Path) -> None:
    for camera in ("cam0", "cam1"):
        (euroc / "mav0" / camera / "data.csv").unlink()
    assert len(open_sequence(euroc)) == 6


def test_euroc_imu_off_the_body(euroc: Path, edit: Edit) -> None:
    """The rig is told in the IMU's frame, also where the body is another one."""
    edit(euroc / "mav0" / "imu0" / "sensor.yaml", "[1,0,0,0, ", "[1,0,0,0.02, ")
    rig = open_sequence(euroc).rig
    np.testing.assert_allclose(rig.T_imu_cam0[:3, 3], [0.08, 0.05, 0.0], atol=1e-12)


def test_kaist(kaist: Path) -> None:
    sequence = open_sequence(kaist)
    assert (sequence.kind, sequence.name, len(sequence)) == ("kaist", "urban_tiny", 6)
    assert sequence.imu is not None
    np.testing.assert_array_equal(sequence.imu.gyro[0], [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(sequence.imu.accel[0], [0.0, 0.5, 9.8])
    assert sequence.counts == {"stamps_without_image": 1}
    assert "1 of 7 stamps" in sequence.warnings[0]


def test_kitti_tracking_has_ten_frames_a_second(kitti_tracking: Path) -> None:
    sequence = open_sequence(kitti_tracking)
    assert (sequence.kind, sequence.name, sequence.imu) == ("kitti", "0010", None)
    assert sequence.frame_ns.tolist() == [0, 100_000_000, 200_000_000, 300_000_000]


def test_frames_keep_the_numbers_of_kitti_s_images(kitti_tracking: Path, euroc: Path) -> None:
    (kitti_tracking / "image_03" / "0010" / "000001.png").unlink()
    assert open_sequence(kitti_tracking).frame_number.tolist() == [0, 2, 3]
    others = open_sequence(euroc)
    assert others.frame_number.tolist() == list(range(len(others)))


def test_kitti_tracking_with_several_sequences(kitti_tracking: Path) -> None:
    shutil.copytree(kitti_tracking / "image_02" / "0010", kitti_tracking / "image_02" / "0011")
    with pytest.raises(InputError, match=r"choose one with --sequence; there are: 0010, 0011"):
        open_sequence(kitti_tracking)
    assert open_sequence(kitti_tracking.parent, sequence="0010").name == "0010"
    with pytest.raises(InputError, match="no sequence '0099'"):
        open_sequence(kitti_tracking, sequence="0099")


def test_kitti_odometry(kitti_odometry: Path) -> None:
    for path in (kitti_odometry, kitti_odometry / "sequences", kitti_odometry / "sequences" / "00"):
        sequence = open_sequence(path)
        assert (sequence.kind, sequence.name) == ("kitti", "00")
        assert sequence.frame_ns.tolist() == [0, 103_859_000, 207_600_000]


def test_kitti_odometry_needs_a_time_for_each_frame(kitti_odometry: Path, edit: Edit) -> None:
    times = kitti_odometry / "sequences" / "00" / "times.txt"
    edit(times, "2.076000e-01\n", "")
    with pytest.raises(DatasetError, match="2 times, but an image of number 2"):
        open_sequence(kitti_odometry)
    times.write_text("0.0\n0.2\n0.1\n")
    with pytest.raises(DatasetError, match=r"row 3: .*does not lie after"):
        open_sequence(kitti_odometry)
    times.write_text("0.0\nsoon\n0.1\n")
    with pytest.raises(DatasetError, match="row 2: 'soon' is not a time"):
        open_sequence(kitti_odometry)


def test_sequence_chosen_in_a_folder_of_folders(euroc: Path) -> None:
    assert open_sequence(euroc.parent, sequence="MH_tiny").kind == "euroc"


def test_folders_that_are_no_data_set(tmp_path: Path, euroc: Path, kaist: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        open_sequence(tmp_path / "gone")
    with pytest.raises(InputError, match="not a folder"):
        open_sequence(imu_file(euroc))
    with pytest.raises(InputError, match=r"no known kind.*euroc: .*kaist: .*kitti: "):
        open_sequence(tmp_path)
    shutil.copytree(euroc / "mav0", kaist / "mav0")
    with pytest.raises(InputError, match="looks like euroc and kaist; choose with --format"):
        open_sequence(kaist)
    assert open_sequence(kaist, format="kaist").kind == "kaist"
    with pytest.raises(InputError, match="unknown; known: euroc, kaist, kitti"):
        open_sequence(kaist, format="rosbag")
    with pytest.raises(InputError, match="not a KITTI folder"):
        open_sequence(euroc, format="kitti")


def test_calibration_given_beside_the_data(euroc: Path, tmp_path: Path) -> None:
    chain = tmp_path / "chain.yaml"
    camera = "{T_imu_cam: [1,0,0,%s, 0,1,0,0, 0,0,1,0, 0,0,0,1], intrinsics: [30,30,16,12],"
    camera += " distortion_model: none, resolution: [32, 24], timeshift_cam_imu: 0.01}"
    chain.write_text(f"cam0: {camera % 0.0}\ncam1: {camera % 0.2}\n")
    sequence = open_sequence(euroc, calibration=chain)
    assert sequence.rig.baseline == pytest.approx(0.2)
    assert sequence.rig.time_offset_s == 0.01
    assert sequence.imu_noise is None
    with pytest.raises(CalibrationError, match="no such calibration file"):
        open_sequence(euroc, calibration=tmp_path / "gone.yaml")


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


# ---- images that are missing or badly listed


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
    with pytest.raises(DatasetError, match=r"stereo_stamp\.csv, row 3: .*before that of the row"):
        open_sequence(kaist)
    listed.write_text("\n".join([stamps[0], "1.4e18"]))
    with pytest.raises(DatasetError, match=r"stereo_stamp\.csv, row 2: '1\.4e18' is not a stamp"):
        open_sequence(kaist)
    listed.write_text("")
    with pytest.raises(DatasetError, match=r"holds no data"):
        open_sequence(kaist)


# ---- the IMU


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


def test_a_name_of_absurd_length_is_no_stamp(euroc: Path) -> None:
    folder = euroc / "mav0" / "cam0"
    (folder / "data.csv").unlink()
    next((folder / "data").iterdir()).rename(folder / "data" / f"{'9' * 25}.png")
    with pytest.raises(DatasetError, match=r"9{25}\.png: the file name is not a number"):
        open_sequence(euroc)


def test_imu_values_that_no_sensor_gives(euroc: Path) -> None:
    rows = imu_file(euroc).read_text().splitlines()
    rows[50] = rows[50].rpartition(",")[0] + ",1e300"
    imu_file(euroc).write_text("\n".join(rows))
    with pytest.raises(DatasetError, match=r"data\.csv, row 51: .*no sensor measures; correct or"):
        open_sequence(euroc)


def test_a_message_without_a_number_is_refused() -> None:
    """Files are refused where they are read; messages of a bag hold any number."""
    values = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, z] for z in (9.8, np.nan, 9.8)])
    table = StampedTable("x.bag, topic /imu", np.arange(3) * 10_000_000, values, np.arange(3) + 1)
    with pytest.raises(DatasetError, match=r"x\.bag, topic /imu, row 2: .*no sensor measures"):
        checked_imu(table, 0, 3, 0.1, Findings())


def test_spikes_are_left_out_and_a_dead_gyroscope_is_said(euroc: Path) -> None:
    rows = imu_file(euroc).read_text().splitlines()
    rows[50] = rows[50].rpartition(",")[0] + ",1e4"
    imu_file(euroc).write_text("\n".join(rows))
    spiked = open_sequence(euroc)
    assert spiked.counts["imu_beyond_range"] == 1
    assert any("1 rows, the first is row 51, beyond" in text for text in spiked.warnings)
    assert spiked.imu is not None
    assert len(spiked.imu) == len(rows) - 2  # and the names of the columns
    assert np.abs(spiked.imu.accel).max() < 100.0
    for i in range(60, 70):
        rows[i] = rows[i].rpartition(",")[0] + ",1e4"
    imu_file(euroc).write_text("\n".join(rows))
    full = open_sequence(euroc)
    assert full.imu is not None
    assert len(full.imu) == len(rows) - 1
    assert any("so many are no spikes" in text for text in full.warnings)
    still = [f"{row.split(',')[0]},0,0,0,0,0,9.8" for row in rows[1:]]
    imu_file(euroc).write_text("\n".join(still))
    assert "the gyroscope is 0 throughout" in open_sequence(euroc).warnings[0]


def test_no_imu_is_said(euroc: Path) -> None:
    shutil.rmtree(euroc / "mav0" / "imu0")
    sequence = open_sequence(euroc)
    assert sequence.imu is None
    assert sequence.counts == {"no_imu": 1, "no_imu_noise": 1}


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("{stamp},0,0,0,0,0", "6 columns where 7 are expected"),
        ("{stamp},0,0,0,0,0,nan", "not finite"),
        ("{stamp},0,0,0,0,0,9.8x", "'9.8x' is not a number"),
        ("garbage", "1 columns where 7"),
    ],
)
def test_bad_imu_rows(euroc: Path, row: str, message: str) -> None:
    path = imu_file(euroc)
    lines = path.read_text().splitlines()
    lines[50] = row.format(stamp=lines[50].split(",")[0])
    path.write_text("\n".join(lines))
    with pytest.raises(DatasetError, match=message) as caught:
        open_sequence(euroc)
    assert f"{path}, row 51:" in str(caught.value)


def test_imu_stamps_twice_and_backwards(euroc: Path) -> None:
    path = imu_file(euroc)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:10], lines[9], lines[9], *lines[10:]]))
    sequence = open_sequence(euroc)
    assert sequence.imu is not None
    assert (len(sequence.imu), sequence.counts) == (121, {"imu_duplicates": 2})
    path.write_text("\n".join([*lines[:10], lines[8], *lines[10:]]))
    with pytest.raises(DatasetError, match=r"data\.csv, row 11: .*before that of the row above"):
        open_sequence(euroc)


def test_early_kaist_imu_has_no_gyro(kaist: Path) -> None:
    (kaist / "sensor_data" / "xsens_imu.csv").write_text("1,0,0,0,1,0,0,0\n" * 3)
    with pytest.raises(DatasetError, match="8 columns: this early KAIST sequence"):
        open_sequence(kaist)


def test_imu_gaps_are_counted_by_the_setting(euroc: Path) -> None:
    path = imu_file(euroc)
    lines = path.read_text().splitlines()
    del lines[40:62], lines[20:30]
    path.write_text("\n".join(lines))
    sequence = open_sequence(euroc)
    assert sequence.counts == {"imu_gaps": 1}
    assert "the largest 0.115 s at" in sequence.warnings[0]
    assert open_sequence(euroc, imu_max_gap_s=0.05).counts == {"imu_gaps": 2}


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


@pytest.mark.parametrize(("value", "hint"), [("1.0", "may be g"), ("16384", "raw counts")])
def test_imu_units_that_look_wrong(euroc: Path, edit: Edit, value: str, hint: str) -> None:
    edit(imu_file(euroc), ",0.5,9.8", f",0.0,{value}")
    sequence = open_sequence(euroc)
    assert sequence.counts == {"imu_units": 1}
    assert hint in sequence.warnings[0]


# ---- real data


@pytest.mark.parametrize(
    ("name", "kind", "frames", "samples"),
    [
        ("euroc_mh01", "euroc", 161, 3498),
        ("street_traffic", "kaist", 200, 2080),
        ("kaist_sample", "kaist", 1, None),
        ("kitti_tracking", "kitti", 21, None),
    ],
)
def test_real_folders(
    data_root: Path, name: str, kind: str, frames: int, samples: int | None
) -> None:
    if not (data_root / name).is_dir():
        pytest.skip(f"{data_root / name} is missing")
    sequence = open_sequence(data_root / name)
    assert (sequence.kind, len(sequence)) == (kind, frames)
    assert (None if sequence.imu is None else len(sequence.imu)) == samples
