"""The truth of every format: poses of the IMU, in metres, in a world with z up."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from bag_fixtures import START_NS

from ovmot.cameras.camera import Camera
from ovmot.datasets import open_sequence
from ovmot.datasets.find_truth import find_ego_truth, find_object_truth, upright
from ovmot.datasets.kaist.truth import kaist_truth
from ovmot.datasets.kaist.writer import write_kaist
from ovmot.datasets.pose_files import read_tum
from ovmot.datasets.truth import EgoTruth, ImageRules
from ovmot.datasets.writing import SequenceToWrite
from ovmot.errors import DatasetError, InputError
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.ros.bag_writer import BagWriter
from ovmot.ros.values import Message, Published, Value, header, pose
from ovmot.sim.recording import record
from ovmot.sim.simulation import Simulation
from ovmot.types import ImuData

FIRST_NS = 1_403_636_580_000_000_555
SYNC = "2011_09_26_drive_0001_sync"
Edit = Callable[[Path, str, str], None]


def test_oxts_is_what_the_data_sets_own_kit_makes_of_it(data_root: Path) -> None:
    root = data_root / "kitti_raw"
    if not root.is_dir():
        pytest.skip(f"{root} is missing")
    expected = read_tum(root / "truth_imu.tum")
    found = find_ego_truth(root / "2011_09_26")
    assert np.abs(found.timestamp_ns - expected.timestamp_ns).max() < 1000
    np.testing.assert_allclose(found.T_world_imu, expected.T_world_imu, atol=1e-5)
    assert found.velocity is not None
    moved = np.gradient(found.T_world_imu[:, :3, 3], found.timestamp_ns * 1e-9, axis=0)
    assert np.median(np.linalg.norm(moved - found.velocity, axis=1)) < 0.1


def test_oxts_of_one_drive_of_several(kitti_raw: Path) -> None:
    for path in (kitti_raw / SYNC / "oxts" / "data").iterdir():
        values = [49.0, 8.0 + 1e-5 * int(path.stem), 100.0, 0.0, 0.0, 0.5, 1.0, 2.0, *[0.0] * 22]
        values[23] = 0.3 + 0.01 * int(path.stem)
        path.write_text(" ".join(map(str, values)))
    with pytest.raises(InputError, match="2 drives; choose one"):
        find_ego_truth(kitti_raw)
    found = find_ego_truth(kitti_raw, SYNC)
    east = 6378137.0 * np.cos(np.radians(49.0)) * np.radians(1e-5)
    np.testing.assert_allclose(found.T_world_imu[:, 0, 3], east * np.arange(4), atol=1e-6)
    np.testing.assert_allclose(so3.log(found.T_world_imu[0, :3, :3]), [0.0, 0.0, 0.5], atol=1e-12)
    assert found.velocity is not None
    np.testing.assert_array_equal(found.velocity[0], [2.0, 1.0, 0.0])
    assert found.position_sigma_m is not None
    np.testing.assert_allclose(found.position_sigma_m, [0.3, 0.31, 0.32, 0.33])


def test_kaist_poses_are_those_of_the_vehicle(small_simulation: Simulation, tmp_path: Path) -> None:
    sequence: SequenceToWrite = record(small_simulation, 1)
    for _ in write_kaist(tmp_path / "kaist", sequence):
        pass
    expected = find_ego_truth(tmp_path / "kaist")
    assert expected.path.name == "poses.csv"
    (tmp_path / "kaist" / "truth" / "poses.csv").unlink()
    found = find_ego_truth(tmp_path / "kaist")
    assert found.path.name == "global_pose.csv"
    same = se3.inverse(expected.T_world_imu[0]) @ expected.T_world_imu
    np.testing.assert_allclose(
        se3.inverse(found.T_world_imu[0]) @ found.T_world_imu, same, atol=1e-6
    )
    assert np.abs(found.T_world_imu[0, :3, 3]).max() < 5.0  # UTM is 1e6 m
    (tmp_path / "kaist" / "global_pose.csv").write_text("1," + ",".join(["2"] * 12) + "\n")
    with pytest.raises(DatasetError, match=r"global_pose\.csv, row 1: not a rotation"):
        kaist_truth(tmp_path / "kaist", None)


def tum_rows(separator: str, first: Callable[[int], str], wxyz: bool) -> str:
    """Five poses, 0.1 s and a metre apart, a quarter turn about z."""
    q = (0.5**0.5, 0, 0, 0.5**0.5) if wxyz else (0, 0, 0.5**0.5, 0.5**0.5)
    rows = (separator.join([first(i), str(i), "2", "3", *map(str, q)]) for i in range(5))
    return "".join(f"{row}\n" for row in rows)


def stamp(i: int) -> int:
    return FIRST_NS + i * 100_000_000


def assert_quarter_turn(truth: EgoTruth) -> None:
    assert np.abs(truth.timestamp_ns - [stamp(i) for i in range(5)]).max() < 1000
    np.testing.assert_allclose(truth.T_world_imu[:, :3, 3], [[i, 2, 3] for i in range(5)])
    turn = so3.log(truth.T_world_imu[2, :3, :3])
    np.testing.assert_allclose(turn, [0.0, 0.0, 0.5 * np.pi], atol=1e-6)


def test_tum_vi(tum_vi: Path) -> None:
    path = tum_vi / "mav0" / "mocap0" / "data.csv"
    path.parent.mkdir()
    header = "#timestamp [ns], p_RS_R_x [m], ...\n"
    path.write_text(header + tum_rows(",", lambda i: str(stamp(i)), wxyz=True))
    assert_quarter_turn(find_ego_truth(tum_vi))
    path.rename(tum_vi / "dso" / "gt_imu.csv")
    assert_quarter_turn(find_ego_truth(tum_vi))


@pytest.mark.parametrize("numbered", [True, False])
def test_uzh_fpv(uzh_fpv: Path, numbered: bool) -> None:
    def first(i: int) -> str:
        return f"{i} {stamp(i) / 1e9:.7f}" if numbered else f"{stamp(i) / 1e9:.7f}"

    text = "# timestamp tx ty tz qx qy qz qw\n" + tum_rows(" ", first, wxyz=False)
    (uzh_fpv / "groundtruth.txt").write_text(text)
    assert_quarter_turn(find_ego_truth(uzh_fpv))


def test_four_seasons_poses_are_scaled_and_those_of_the_camera(four_seasons: Path) -> None:
    rows = [f"{stamp(i)},{0.5 * i},0,0,0,0,0,1,2.0,1\n" for i in range(3)]
    (four_seasons / "GNSSPoses.txt").write_text("# frame_id, ...\n" + "".join(rows))
    found = find_ego_truth(four_seasons)
    T_imu = found.T_world_imu
    # metres, and between them the camera's own displacement from the IMU, (0.1, 0.2, 0.3)
    np.testing.assert_allclose(np.diff(T_imu[:, :3, 3], axis=0), [[1, 0, 0]] * 2, atol=0.02)
    assert len(found.timestamp_ns) == 3
    (four_seasons / "GNSSPoses.txt").write_text("1,2,3,4,0,0,0,2,1\n")
    with pytest.raises(DatasetError, match=r"GNSSPoses\.txt, row 1: no unit quaternion"):
        find_ego_truth(four_seasons)


def resting(R_world_imu: FloatArray) -> tuple[EgoTruth, ImuData]:
    """A rig at rest, in a world whose z axis is up if `R_world_imu` is the identity."""
    stamps = np.arange(0, 1_000_000_000, 10_000_000)
    accel = np.tile([0.0, 0.0, 9.81], (100, 1))
    poses = np.tile(se3.make(R_world_imu, np.array([1.0, 2.0, 3.0])), (10, 1, 1))
    truth = EgoTruth(Path("t"), stamps[::10], poses, np.tile([1.0, 2.0, 3.0], (10, 1)))
    return truth, ImuData(stamps, np.zeros((100, 3)), accel)


@pytest.mark.parametrize(
    "turn", [[np.pi, 0, 0], [0, np.pi, 0], [0.5 * np.pi, 0, 0], [0, -0.5 * np.pi, 0], [0.7, 0.4, 0]]
)
def test_a_world_is_turned_upright(turn: list[float]) -> None:
    truth, imu = resting(so3.exp(np.array(turn)))
    found = upright(truth, imu)
    up = found.T_world_imu[0, :3, :3] @ [0.0, 0.0, 1.0]
    np.testing.assert_allclose(up, [0.0, 0.0, 1.0], atol=1e-9)
    assert np.linalg.det(found.T_world_imu[0, :3, :3]) == pytest.approx(1.0)
    assert truth.velocity is not None and found.velocity is not None
    R = found.T_world_imu[0, :3, :3] @ truth.T_world_imu[0, :3, :3].T
    np.testing.assert_allclose(found.velocity[0], R @ truth.velocity[0])


def test_a_world_that_is_upright_is_left_alone() -> None:
    truth, imu = resting(so3.exp(np.array([0.1, 0.0, 2.0])))  # 6 degrees: an acceleration
    assert upright(truth, imu) is truth
    assert upright(truth, None) is truth


def test_viode_whose_world_points_down(viode: Path) -> None:
    (viode / "mav0" / "cam0" / "segmentation" / f"{FIRST_NS}.png").write_bytes(
        next((viode / "mav0" / "cam0" / "data").iterdir()).read_bytes()
    )
    (viode / "mav0" / "cam1" / "segmentation" / f"{FIRST_NS}.png").write_bytes(
        next((viode / "mav0" / "cam0" / "data").iterdir()).read_bytes()
    )
    imu = open_sequence(viode).imu
    assert imu is not None
    up = imu.accel.mean(axis=0) / np.linalg.norm(imu.accel.mean(axis=0))
    folder = viode / "mav0" / "odometry"
    folder.mkdir()
    folder.joinpath("data.csv").write_text(
        "#ns,x,y,z,qw,qx,qy,qz\n"
        + "".join(f"{stamp(i)},{i},0,-1,0,1,0,0\n" for i in range(5))  # half a turn about x
    )
    found = find_ego_truth(viode)
    assert found.path == folder / "data.csv"
    assert (found.T_world_imu[0, :3, :3] @ up)[2] > np.cos(np.radians(10.0))


def test_a_bag_with_odometry(tmp_path: Path) -> None:
    path = tmp_path / "drive.bag"
    turns = (so3.exp(np.array([0.0, 0.0, 0.1 * i])) for i in range(4))
    poses = [se3.make(R, np.array([i, 0.0, 1.0])) for i, R in enumerate(turns)]
    with BagWriter(path) as bag:
        for i, T in enumerate(poses):
            fields: dict[str, Value] = {"pose": pose(T), "covariance": np.zeros(36)}
            posed = Message("geometry_msgs/PoseWithCovariance", fields)
            stamp_ns = START_NS + i * 10**8
            message = Message(
                "nav_msgs/Odometry", {"header": header(stamp_ns, "world"), "pose": posed}
            )
            bag.write(Published("/odometry", message), stamp_ns)
    found = find_ego_truth(path)
    assert found.timestamp_ns.tolist() == [START_NS + i * 10**8 for i in range(4)]
    np.testing.assert_allclose(found.T_world_imu, poses, atol=1e-9)


LABELS = """\
0 -1 DontCare -1 -1 -10 1 2 5 6 -1 -1 -1 -1000 -1000 -1000 -10
0 7 Car 0 0 0 14 10 18 14 2 1.8 4 0 1 10 -1.5707963267948966
1 7 Car 0 0 0 14 10 18 14 2 1.8 4 0 1 11 -1.5707963267948966
2 7 Car 0 1 0 14 10 18 14 2 1.8 4 0 1 12 -1.5707963267948966
2 8 Van 0 0 0 14 10 18 14 2 1.8 4 3 1 12 0
3 7 Car 0 3 0 14 10 18 14 2 1.8 4 0 1 13 -1.5707963267948966
3 9 Pedestrian 1 0 0 14 10 18 14 2 1 1 3 1 12 0
"""


@pytest.fixture
def labelled(kitti_tracking: Path) -> Path:
    for name, text in (("label_02", LABELS), ("poses", "1 0 0 0 0 1 0 0 0 0 1 0\n" * 4)):
        (kitti_tracking / name).mkdir()
        (kitti_tracking / name / "0010.txt").write_text(text)
    return kitti_tracking


def test_kitti_poses_are_those_of_the_left_camera(labelled: Path) -> None:
    ego = find_ego_truth(labelled)
    assert ego.timestamp_ns.tolist() == [i * 10**8 for i in range(4)]
    T_world_cam0 = ego.T_world_imu @ open_sequence(labelled).rig.T_imu_cam0
    np.testing.assert_allclose(T_world_cam0[0, :3, 2], [1.0, 0.0, 0.0], atol=1e-9)  # looks along x
    np.testing.assert_allclose(T_world_cam0[0, :3, 3], 0.0, atol=1e-9)


def test_kitti_packets_come_before_poses(labelled: Path) -> None:
    (labelled / "oxts").mkdir()
    packet = " ".join(["49", "8", "100", *["0"] * 27])
    (labelled / "oxts" / "0010.txt").write_text(f"{packet}\n" * 4)
    ego = find_ego_truth(labelled)
    assert ego.path.parent.name == "oxts"
    np.testing.assert_array_equal(ego.T_world_imu[3], np.eye(4))


def test_kitti_odometry_poses(kitti_odometry: Path) -> None:
    (kitti_odometry / "poses").mkdir()
    (kitti_odometry / "poses" / "00.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 5\n" * 3)
    ego = find_ego_truth(kitti_odometry)
    assert ego.timestamp_ns.tolist() == [0, 103_859_000, 207_600_000]
    np.testing.assert_allclose(ego.T_world_imu[0, :3, 3], [5.0, 0.0, 0.0], atol=1e-9)


def test_kitti_labels(labelled: Path) -> None:
    ego = find_ego_truth(labelled)
    truth = find_object_truth(labelled, None, ego)
    assert truth is not None and not truth.has_ids and not truth.has_depth
    first, third, last = (truth.frames[i * 10**8] for i in (0, 2, 3))
    # camera 2 is 0.06 m to the left of camera 0, in which labels are
    np.testing.assert_allclose(first.center, [[10.0, -0.06, 0.0]], atol=1e-9)
    np.testing.assert_allclose(first.size, [[4.0, 1.8, 2.0]])
    np.testing.assert_allclose(first.velocity, [[10.0, 0.0, 0.0]], atol=1e-9)
    np.testing.assert_allclose([first.yaw[0], first.yaw_rate[0]], 0.0, atol=1e-9)
    assert np.isnan(last.velocity[last.object_id == 9]).all()
    assert third.evaluated is not None and last.evaluated is not None
    # the benchmark evaluates cars and pedestrians that are neither cut off nor largely hidden
    assert dict(zip(third.object_id.tolist(), third.evaluated.tolist(), strict=True)) == {
        7: True, 8: False,
    }  # fmt: skip
    assert not last.evaluated.any()


def test_kitti_labels_that_are_none(labelled: Path, edit: Edit) -> None:
    path = labelled / "label_02" / "0010.txt"
    ego = find_ego_truth(labelled)
    edit(path, "2 8 Van 0 0", "2 8 Van x 0")
    with pytest.raises(DatasetError, match=r"0010\.txt: cannot be read"):
        find_object_truth(labelled, None, ego)
    path.write_text("0 1 Car\n")
    with pytest.raises(DatasetError, match=r"0010\.txt, row 1: 3 columns where 17"):
        find_object_truth(labelled, None, ego)


def test_rules_of_the_image() -> None:
    """Small tracks and those in a region that nobody labelled are left out."""
    camera = Camera.make((640, 480), (500.0, 500.0), (320.0, 240.0))
    rules = ImageRules(camera, np.eye(4), 25.0, {5: np.array([[300.0, 220.0, 340.0, 260.0]])})
    center = np.array([[0.0, 0.0, 20.0], [4.0, 0.0, 20.0], [4.0, 0.0, 60.0], [0.0, 0.0, -20.0]])
    height = np.full(4, 1.5)  # 37 px at 20 m, 12.5 px at 60 m
    assert rules.leave_out(5, center, height).tolist() == [True, False, True, False]
    assert rules.leave_out(6, center, height).tolist() == [False, False, True, False]


def test_data_without_truth_says_so(euroc: Path, kaist: Path, tmp_path: Path) -> None:
    for data in (euroc, kaist):
        with pytest.raises(InputError, match="holds no true poses"):
            find_ego_truth(data)
    with pytest.raises(InputError, match="no such file or folder"):
        find_ego_truth(tmp_path / "gone")
