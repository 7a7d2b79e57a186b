"""A small simulated sequence, rendered once, and copies of it, spoiled as users spoil theirs."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml

from ovmot.datasets.euroc.writer import write_asl
from ovmot.datasets.text_tables import read_stamped_csv
from ovmot.datasets.writing import write_rows
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.sim.recording import record
from ovmot.sim.scene_file import load_scene
from ovmot.sim.scenes import make_simulation


@pytest.fixture(scope="session")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A walk of 5 s through an empty street, a EuRoC folder of 50 pairs of 320x140 pixels."""
    root = tmp_path_factory.mktemp("doctor") / "walked"
    simulation = make_simulation(
        load_scene("empty"), seed=1, path="walk", size=(320, 140), duration_s=5.0
    )
    for _ in write_asl(root, record(simulation, 1)):
        pass
    shutil.rmtree(root / "truth")
    return root


@pytest.fixture
def spoiled(walked: Path, tmp_path: Path) -> Callable[[str], Path]:
    """Makes a copy that has one fault, by the name of the function below."""

    def spoil(fault: str) -> Path:
        root = Path(shutil.copytree(walked, tmp_path / "spoiled"))
        FAULTS[fault](root)
        return root

    return spoil


def swap_sides(root: Path) -> None:
    """The right camera's images as the left one's, and the other way round."""
    left, right = (root / "mav0" / name / "data" for name in ("cam0", "cam1"))
    aside = left.with_name("aside")
    left.rename(aside)
    right.rename(left)
    aside.rename(right)


def accel_in_g(root: Path) -> None:
    """Accelerations in multiples of standard gravity."""
    change_imu(root, lambda ns, values: (ns, values / ([1.0] * 3 + [9.80665] * 3)))


def gyro_in_degrees(root: Path) -> None:
    """Rates in degrees a second."""
    change_imu(root, lambda ns, values: (ns, values * ([180.0 / np.pi] * 3 + [1.0] * 3)))


def accel_negated(root: Path) -> None:
    """The reaction in place of the specific force."""
    change_imu(root, lambda ns, values: (ns, values * ([1.0] * 3 + [-1.0] * 3)))


def clock_ahead(root: Path) -> None:
    """An IMU clock that reads 300 ms more than the cameras'."""
    change_imu(root, lambda ns, values: (ns + 300_000_000, values))


def change_imu(
    root: Path, change: Callable[[IntArray, FloatArray], tuple[IntArray, FloatArray]]
) -> None:
    """Rewrite stamps (N,) and values (N, 6), gyro and accel."""
    path = root / "mav0" / "imu0" / "data.csv"
    table = read_stamped_csv(path, 7)
    write_rows(path, *change(table.timestamp_ns, table.values))


def turn_right_camera(root: Path) -> None:
    """The right camera's pose, wrong by 2 degrees about its x axis."""
    _, right = poses_of(root)
    right[:3, :3] = right[:3, :3] @ so3.exp(np.radians([2.0, 0.0, 0.0]))
    write_pose(root, "cam1", right)


def permute_axes(root: Path) -> None:
    """Both cameras' axes as if z were up, as those of the IMU often are."""
    turn_both_cameras(root, np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]))


def tilt_both_cameras(root: Path) -> None:
    """Both cameras turned by 20 degrees about the optical axis of the left one."""
    turn_both_cameras(root, so3.exp(np.radians([0.0, 0.0, 20.0])))


def turn_both_cameras(root: Path, R: FloatArray) -> None:
    """The left camera's pose on the IMU turned by R (3, 3) about its own axes, the right along."""
    left, right = poses_of(root)
    turned = left.copy()
    turned[:3, :3] = left[:3, :3] @ R
    write_pose(root, "cam0", turned)
    write_pose(root, "cam1", turned @ np.linalg.inv(left) @ right)


def invert_right_pose(root: Path) -> None:
    """The right camera as far to the left of the left one as it is to its right."""
    left, right = poses_of(root)
    write_pose(root, "cam1", left @ np.linalg.inv(right) @ left)


def lengthen_baseline(root: Path) -> None:
    """The right camera 1.3 times as far from the left one as it is."""
    left, right = poses_of(root)
    right[:3, 3] = left[:3, 3] + 1.3 * (right[:3, 3] - left[:3, 3])
    write_pose(root, "cam1", right)


def poses_of(root: Path) -> list[FloatArray]:
    """T_imu_cam (4, 4) of the left and the right camera."""
    sensors = [root / "mav0" / name / "sensor.yaml" for name in ("cam0", "cam1")]
    data = [yaml.safe_load(path.read_text())["T_BS"]["data"] for path in sensors]
    return [np.array(values).reshape(4, 4) for values in data]


def write_pose(root: Path, camera: str, T_imu_cam: FloatArray) -> None:
    path = root / "mav0" / camera / "sensor.yaml"
    sensor = yaml.safe_load(path.read_text())
    sensor["T_BS"]["data"] = T_imu_cam.ravel().tolist()
    path.write_text(yaml.safe_dump(sensor))


def drop_frames(root: Path) -> None:
    """Six of the stereo pairs lost while recording, three of them in a row."""
    images = sorted((root / "mav0" / "cam0" / "data").iterdir())
    for i in (5, 17, 20, 21, 22, 31):
        images[i].unlink()
        (root / "mav0" / "cam1" / "data" / images[i].name).unlink()


FAULTS: dict[str, Callable[[Path], None]] = {
    fault.__name__: fault
    for fault in (
        swap_sides, accel_in_g, gyro_in_degrees, accel_negated, clock_ahead, turn_right_camera,
        invert_right_pose, lengthen_baseline, drop_frames, permute_axes, tilt_both_cameras,
    )
}  # fmt: skip
