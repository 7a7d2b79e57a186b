"""KITTI raw drives: choosing one, times, packets out of order, and what is refused."""

import shutil
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets import open_sequence
from ovmot.errors import CalibrationError, DatasetError, InputError
from ovmot.geometry import se3

Edit = Callable[[Path, str, str], None]
SYNC, EXTRACT = "2011_09_26_drive_0001_sync", "2011_09_26_drive_0001_extract"


@pytest.mark.parametrize("inside", [True, False])
def test_sync_has_rectified_cameras_and_slow_oxts(kitti_raw: Path, inside: bool) -> None:
    if inside:
        sequence = open_sequence(kitti_raw / SYNC)
    else:
        sequence = open_sequence(kitti_raw, sequence=SYNC)
    assert (sequence.kind, sequence.name, len(sequence)) == ("kitti_raw", SYNC, 4)
    moment = datetime(2011, 9, 26, 13, 2, 25, tzinfo=UTC).timestamp()
    assert sequence.frame_ns.tolist() == [int(moment) * 10**9 + i * 10**8 for i in range(4)]
    assert sequence.frame_number.tolist() == [0, 1, 2, 3]
    assert sequence.imu is not None
    np.testing.assert_array_equal(sequence.imu.timestamp_ns, sequence.frame_ns)
    np.testing.assert_array_equal(sequence.imu.accel[2], [0.1, 0.2, 9.8])
    np.testing.assert_array_equal(sequence.imu.gyro[2], [0.01, 0.02, 0.002])
    rig = sequence.rig
    assert rig.cam0.model.name == "none"
    assert rig.cam0.intrinsics.tolist() == [18.0, 18.0, 16.0, 12.0, 0.0]
    np.testing.assert_allclose(rig.T_cam1_cam0[:3, 3], [-0.5, 0.0, 0.0], atol=1e-12)
    # IMU -> velodyne (-0.8, 0.3, -0.8) -> camera axes: right 0 - 0.3, down 0.8 - 0.1, ahead -1.1
    np.testing.assert_allclose(se3.inverse(rig.T_imu_cam0)[:3, 3], [-0.3, 0.7, -1.1], atol=1e-12)


def test_extract_has_lenses_and_fast_oxts(kitti_raw: Path) -> None:
    sequence = open_sequence(kitti_raw / EXTRACT)
    assert sequence.imu is not None
    assert (len(sequence), len(sequence.imu)) == (4, 31)
    rig = sequence.rig
    assert rig.cam0.model.name == "radtan"
    assert rig.cam0.intrinsics.tolist() == [20.0, 21.0, 16.0, 12.0, 0.0]
    assert rig.cam1.distortion.tolist() == [-0.3, 0.1, 0.001, -0.002, 0.01]
    np.testing.assert_allclose(rig.T_cam1_cam0[:3, 3], [-0.5, 0.0, 0.0], atol=1e-12)


def test_colour_cameras_serve_where_the_grey_ones_are_missing(kitti_raw: Path, edit: Edit) -> None:
    for old, new in (("image_00", "image_02"), ("image_01", "image_03")):
        (kitti_raw / SYNC / old).rename(kitti_raw / SYNC / new)
    with pytest.raises(CalibrationError, match="'S_rect_02': this key is missing"):
        open_sequence(kitti_raw / SYNC)
    edit(kitti_raw / "calib_cam_to_cam.txt", "_01", "_03")
    text = (kitti_raw / "calib_cam_to_cam.txt").read_text()
    more = text.replace("_00", "_02").replace("P_rect_02: 18 0 16 0", "P_rect_02: 18 0 16 1.8")
    (kitti_raw / "calib_cam_to_cam.txt").write_text(text + more)
    sequence = open_sequence(kitti_raw / SYNC)
    assert sequence.rig.baseline == pytest.approx(0.6)  # camera 2 stands 0.1 m left of camera 0
    assert sequence.left_paths[0].parent.parent.name == "image_02"


def test_a_drive_is_chosen(kitti_raw: Path) -> None:
    with pytest.raises(InputError, match=f"2 drives; choose one.*{EXTRACT}, {SYNC}"):
        open_sequence(kitti_raw)
    with pytest.raises(InputError, match="no drive 'x'; there are"):
        open_sequence(kitti_raw, sequence="x")
    with pytest.raises(InputError, match="holds one drive"):
        open_sequence(kitti_raw / SYNC, sequence=SYNC)
    with pytest.raises(InputError, match="not a KITTI raw folder"):
        open_sequence(kitti_raw / SYNC / "oxts", format="kitti_raw")
    shutil.rmtree(kitti_raw / EXTRACT)
    assert open_sequence(kitti_raw.parent).name == SYNC


def test_files_of_a_drive_that_was_copied_alone(kitti_raw: Path) -> None:
    for path in kitti_raw.glob("calib_*.txt"):
        path.rename(kitti_raw / SYNC / path.name)
    assert len(open_sequence(kitti_raw / SYNC)) == 4
    with pytest.raises(CalibrationError, match=r"2011_09_26/calib_cam_to_cam\.txt: no such"):
        open_sequence(kitti_raw / EXTRACT)


def test_packets_out_of_order_are_dropped_and_counted(kitti_raw: Path) -> None:
    times = kitti_raw / EXTRACT / "oxts" / "timestamps.txt"
    lines = times.read_text().splitlines()
    lines[10], lines[11], lines[20] = lines[11], lines[10], lines[19]
    times.write_text("\n".join(lines))
    sequence = open_sequence(kitti_raw / EXTRACT)
    assert sequence.imu is not None
    assert sequence.counts == {"imu_out_of_order": 2}
    assert len(sequence.imu) == 29
    assert np.all(np.diff(sequence.imu.timestamp_ns) > 0)


def test_missing_files_leave_the_others_their_times(kitti_raw: Path) -> None:
    drive = kitti_raw / EXTRACT
    (drive / "oxts" / "data" / "0000000003.txt").unlink()
    for camera in ("image_00", "image_01"):
        (drive / camera / "data" / "0000000001.png").unlink()
    sequence = open_sequence(drive)
    assert sequence.frame_number.tolist() == [0, 2, 3]
    np.testing.assert_array_equal(np.diff(sequence.frame_ns), [2 * 10**8, 10**8])
    assert sequence.imu is not None
    assert np.diff(sequence.imu.timestamp_ns[:4]).tolist() == [10**7, 10**7, 2 * 10**7]
    shutil.rmtree(drive / "oxts")
    assert open_sequence(drive).counts["no_imu"] == 1


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        ("image_00/timestamps.txt", ":25.1", ":soon", "row 2: '.*' is no time"),
        ("image_00/timestamps.txt", ":25.1", ":24.1", "row 2: the time does not lie after"),
        ("image_00/timestamps.txt", "2011-09-26 13:02:25.300000000", "", "row 4: no time for the"),
        ("oxts/timestamps.txt", "25.000000000", "25,0", "row 1: '.*' is no time"),
        ("oxts/data/0000000002.txt", "9.8", "", "29 numbers where 30"),
        ("oxts/data/0000000002.txt", "9.8", "nan", "finite"),
        ("oxts/data/0000000002.txt", "9.8", "up", "cannot be read"),
    ],
)
def test_broken_files(
    kitti_raw: Path, edit: Edit, name: str, old: str, new: str, message: str
) -> None:
    edit(kitti_raw / SYNC / name, old, new)
    with pytest.raises(DatasetError, match=message) as caught:
        open_sequence(kitti_raw / SYNC)
    assert str(kitti_raw / SYNC / name) in str(caught.value)
