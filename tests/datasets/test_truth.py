"""The truth of a sequence: poses, objects, images of ids and depth."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets.truth import depth_image, read_ego_truth, read_object_truth
from ovmot.errors import InputError


def test_depth_image_has_256_steps_to_the_metre() -> None:
    depth = np.array([[0.05, 1.0, 255.99], [256.0, np.inf, np.nan]], dtype=np.float32)
    np.testing.assert_array_equal(depth_image(depth), [[13, 256, 65533], [0, 0, 0]])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("[{", "cannot be read"),
        ("{}", "not a list of frames"),
        ("[{}]", "frame 0 lacks 'objects'"),
        ('[{"t_ns": 5, "objects": [{"id": 1}]}]', "frame 0 lacks 'x'"),
        ("[5]", "objects.json: "),
    ],
)
def test_bad_object_truth(tmp_path: Path, content: str, message: str) -> None:
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "objects.json").write_text(content)
    with pytest.raises(InputError, match=message):
        read_object_truth(tmp_path)


def test_an_id_twice(tmp_path: Path) -> None:
    (tmp_path / "truth").mkdir()
    keys = ("x", "y", "z", "yaw", "l", "w", "h", "vx", "vy", "yaw_rate", "visible_px")
    car = {**dict.fromkeys(keys, 1.0), "id": 3}
    listed = [{"t_ns": 5, "objects": [car, car]}]
    (tmp_path / "truth" / "objects.json").write_text(json.dumps(listed))
    with pytest.raises(InputError, match="an id twice"):
        read_object_truth(tmp_path)


ASL = "mav0/state_groundtruth_estimate0/data.csv"


POSES = "#ns,x,y,z,qw,qx,qy,qz\n100,1,2,3,1,0,0,0\n200,4,5,6,0,0,0,1\n"


EUROC_ROW = "{},1,2,3,0,0,0,1,0.1,0.2,0.3,-1,-2,-3,7,8,9\n"


TUM = "0.0000001 1 2 3 0 0 0 1\n0.0000002 4 5 6 0 0 1 0\n"


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("truth/poses.csv", POSES),
        (ASL, POSES),
        ("mav0/state_groundtruth_estimate0/trajectory.tum", TUM),
        ("state_groundtruth_estimate0/data.csv", POSES),  # the folder mav0 itself
    ],
)
def test_poses_of_the_known_folders(tmp_path: Path, name: str, text: str) -> None:
    path = write(tmp_path / name, text)
    truth = read_ego_truth(tmp_path)
    assert truth.path == path
    assert truth.timestamp_ns.tolist() == [100, 200]
    np.testing.assert_array_equal(truth.T_world_imu[:, :3, 3], [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_allclose(truth.T_world_imu[1, :3, :3], np.diag([-1, -1, 1]), atol=1e-15)
    assert truth.velocity is None
    assert truth.gyro_bias is None
    assert truth.accel_bias is None


@pytest.mark.parametrize(("name", "text"), [("any.tum", TUM), ("any.txt", TUM), ("a.csv", POSES)])
def test_a_single_file(tmp_path: Path, name: str, text: str) -> None:
    truth = read_ego_truth(write(tmp_path / name, text))
    np.testing.assert_array_equal(truth.T_world_imu[1, :3, 3], [4, 5, 6])


def test_what_is_known_of_the_accuracy(tmp_path: Path) -> None:
    """EuRoC's is a millimetre, of a simulation in EuRoC's layout zero, of any other file none."""
    write(tmp_path / "real" / ASL, EUROC_ROW.format(100))
    np.testing.assert_array_equal(read_ego_truth(tmp_path / "real").position_sigma_m, [1e-3])
    write(tmp_path / "made" / ASL, EUROC_ROW.format(100))
    write(tmp_path / "made" / "truth" / "objects.json", "[]")
    np.testing.assert_array_equal(read_ego_truth(tmp_path / "made").position_sigma_m, [0.0])
    other = write(tmp_path / "a.tum", TUM)
    assert read_ego_truth(other).position_sigma_m is None


def test_velocity_and_biases_of_euroc(tmp_path: Path) -> None:
    rows = EUROC_ROW.format(100) + EUROC_ROW.format(100).replace("0.1", "9") + EUROC_ROW.format(300)
    write(tmp_path / ASL, rows)
    truth = read_ego_truth(tmp_path)
    assert truth.timestamp_ns.tolist() == [100, 300]  # an equal stamp keeps the first
    assert truth.velocity is not None
    assert truth.gyro_bias is not None
    assert truth.accel_bias is not None
    np.testing.assert_array_equal(truth.velocity, [[0.1, 0.2, 0.3]] * 2)
    np.testing.assert_array_equal(truth.gyro_bias, [[-1, -2, -3]] * 2)
    np.testing.assert_array_equal(truth.accel_bias, [[7, 8, 9]] * 2)


def test_the_file_with_velocities_is_preferred(tmp_path: Path) -> None:
    write(tmp_path / "truth/poses.csv", POSES)
    write(tmp_path / ASL, EUROC_ROW.format(100))
    assert read_ego_truth(tmp_path).velocity is not None


def test_no_truth_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"holds no true poses \(looked for mav0/state_ground"):
        read_ego_truth(tmp_path)
    with pytest.raises(InputError, match="nowhere: no such file or folder"):
        read_ego_truth(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("truth/poses.csv", "", "holds no data"),
        ("truth/poses.csv", "1,2,3\n", "3 columns"),
        ("truth/poses.csv", POSES + "300,4,5,x,1,0,0,0\n", "row 4: 'x' is not a number"),
        ("truth/poses.csv", POSES + "300,4,5,6,1,1,0,0\n", "row 4: .*unit length"),
        ("truth/poses.csv", POSES + "150,4,5,6,1,0,0,0\n", "row 4: .*before"),
    ],
)
def test_broken_truth_names_file_and_row(
    tmp_path: Path, name: str, text: str, message: str
) -> None:
    write(tmp_path / name, text)
    with pytest.raises(InputError, match=message) as caught:
        read_ego_truth(tmp_path)
    assert str(tmp_path / name) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_simulated_folder(simulated_street: Callable[[str], Path]) -> None:
    street = read_ego_truth(simulated_street("crossing"))
    assert len(street.timestamp_ns) == 691  # at 100 Hz from the first to the 70th picture
    assert street.T_world_imu.shape == (691, 4, 4)


def test_the_real_folder(data_root: Path) -> None:
    assert len(read_ego_truth(data_root / "euroc_mh01").timestamp_ns) > 1000
