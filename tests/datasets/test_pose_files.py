"""Files of poses and sensor rows: exact stamps, honest errors, poses between rows."""

from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets import pose_files as formats
from ovmot.errors import InputError
from ovmot.geometry import se3, so3


def test_tum_comes_back_as_written(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    T = se3.exp(rng.standard_normal((20, 6)))
    stamps = 1_403_636_584_763_555_584 + np.arange(20) * 5_000_001
    formats.write_tum(tmp_path / "a.tum", stamps, T)
    back = formats.read_tum(tmp_path / "a.tum")
    np.testing.assert_array_equal(back.timestamp_ns, stamps)
    np.testing.assert_allclose(back.T_world_imu, T, atol=1e-8)


def test_kitti_poses_come_back_as_written(tmp_path: Path) -> None:
    T = se3.exp(np.random.default_rng(4).standard_normal((5, 6)))
    formats.write_kitti_poses(tmp_path / "p.txt", T)
    np.testing.assert_allclose(formats.read_kitti_poses(tmp_path / "p.txt"), T, atol=1e-8)


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("2.0 0 0 0 0 0 0", "7 columns where 8"),
        ("2.0 0 0 x 0 0 0 1", "'x' is not a number"),
        ("2.0 0 0 nan 0 0 0 1", "not finite"),
        ("2.0 0 0 0 0 0 0 2", "quaternion"),
        ("0.5 0 0 0 0 0 0 1", "before that of the row above"),
    ],
)
def test_a_bad_tum_row_is_named(tmp_path: Path, row: str, message: str) -> None:
    path = tmp_path / "a.tum"
    path.write_text(f"# time x y z\n1.0 0 0 0 0 0 0 1\n\n{row}\n")
    with pytest.raises(InputError, match=message) as caught:
        formats.read_tum(path)
    assert f"{path}, row 4:" in str(caught.value)


def test_euroc_truth_has_w_first(tmp_path: Path) -> None:
    path = tmp_path / "data.csv"
    half = np.sqrt(0.5)
    path.write_text(f"#timestamp, p\n7,1,2,3,{half},0,0,{half}" + ",0" * 9 + "\n")
    truth = formats.read_euroc_ground_truth(path)
    quarter_turn = so3.exp(np.array([0, 0, np.pi / 2]))
    np.testing.assert_allclose(truth.T_world_imu[0, :3, :3], quarter_turn, atol=1e-12)
    np.testing.assert_array_equal(truth.T_world_imu[0, :3, 3], [1, 2, 3])


def test_poses_between_tum_rows_follow_the_screw_of_both(tmp_path: Path) -> None:
    path = tmp_path / "ego.tum"
    T = np.stack([se3.make(so3.exp(np.array([0, 0, a])), np.array([a, 0, 0])) for a in (0, 0.2, 1)])
    formats.write_tum(path, np.array([1_000_000_000, 1_100_000_000, 1_400_000_000]), T)
    at = [999_999_999, 1_000_000_000, 1_025_000_000, 1_250_000_000, 1_400_000_000, 1_400_000_001]
    ego = formats.read_ego_poses(path, np.array(at))
    assert ego.body == "imu"
    assert ego.known.tolist() == [False, True, True, False, True, False]
    np.testing.assert_allclose(so3.log(ego.T_world_body[2, :3, :3]), [0, 0, 0.05], atol=1e-8)
    np.testing.assert_allclose(ego.T_world_body[2, :3, 3], [0.05, 0, 0], atol=1e-8)
    assert np.all(np.isnan(ego.T_world_body[3]))


def test_kitti_ego_poses_are_turned_upright(tmp_path: Path) -> None:
    """Forward along the camera's z becomes world x, down along y becomes world -z."""
    path = tmp_path / "ego.txt"
    step = se3.make(np.eye(3), np.array([0.5, 0.1, 2.0]))
    formats.write_kitti_poses(path, np.stack([np.eye(4), step]))
    ego = formats.read_ego_poses(path, np.array([0, 100_000_000]))
    assert ego.body == "cam0"
    np.testing.assert_allclose(ego.T_world_body[1, :3, 3], [2.0, -0.5, -0.1], atol=1e-9)
    down_cam = np.array([0.0, 1.0, 0.0])
    np.testing.assert_allclose(ego.T_world_body[0, :3, :3] @ down_cam, [0, 0, -1], atol=1e-12)


def test_ego_files_that_do_not_fit(tmp_path: Path) -> None:
    kitti, tum, other = tmp_path / "k.txt", tmp_path / "t.tum", tmp_path / "o.txt"
    formats.write_kitti_poses(kitti, np.stack([np.eye(4)] * 2))
    formats.write_tum(tum, np.array([5_000_000_000]), np.eye(4)[None])
    other.write_text("1 2 3\n")
    skewed = tmp_path / "s.txt"
    skewed.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n1 0.5 0 0 0 1 0 0 0 0 1 0\n")
    cases = [
        (kitti, "2 poses for 3 frames"),
        (tum, "no frame lies between"),
        (other, "3 columns"),
        (skewed, "row 2: not a rotation"),
        (tmp_path / "gone.tum", "no such file"),
    ]
    for path, message in cases:
        with pytest.raises(InputError, match=message):
            formats.read_ego_poses(path, np.array([0, 1, 2]))
