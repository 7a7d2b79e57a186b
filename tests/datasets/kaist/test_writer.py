"""A written sequence is a KAIST folder: the ordinary reader reads back what was simulated."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.datasets.kaist.writer import write_kaist
from ovmot.datasets.registry import open_sequence
from ovmot.datasets.text_tables import read_stamped_csv
from ovmot.errors import InputError
from ovmot.geometry import so3
from ovmot.sim.imu_errors import ImuErrors
from ovmot.sim.recording import generators, imu_samples, imu_times, record
from ovmot.sim.render import render_stereo
from ovmot.sim.simulation import Simulation


@pytest.fixture(scope="module")
def written(small_simulation: Simulation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kaist") / "data"
    assert (
        list(write_kaist(folder, record(small_simulation, 1)))
        == small_simulation.camera_ns.tolist()
    )
    return folder


def test_the_reader_finds_the_simulated_rig_images_and_imu(
    written: Path,
    small_simulation: Simulation,
    assert_same_rig: Callable[[StereoRig, StereoRig], None],
) -> None:
    simulation = small_simulation
    sequence = open_sequence(written)
    assert sequence.kind == "kaist"
    assert_same_rig(sequence.rig, simulation.rig)
    np.testing.assert_array_equal(sequence.frame_ns, simulation.camera_ns)
    assert sequence.imu is not None
    times = imu_times(simulation)
    np.testing.assert_array_equal(sequence.imu.timestamp_ns, times)
    gravity = sequence.imu.accel.mean(axis=0) - simulation.imu.accel_bias
    np.testing.assert_allclose(gravity, [0.0, 0.0, 9.81], atol=0.02)  # it stands for 1.5 s
    np.testing.assert_allclose(sequence.imu.gyro.mean(axis=0), simulation.imu.gyro_bias, atol=1e-3)
    first = sequence.decode(sequence.left_paths[0])
    rng = np.random.default_rng(np.random.SeedSequence(1).spawn(2)[0])
    frame = next(
        render_stereo(
            simulation.scene, simulation.rig, simulation.path, simulation.camera_ns,
            simulation.optics, rng,
        )
    )  # fmt: skip
    # demosaicing averages neighbours: it blurs the noise, and keeps the image
    assert np.abs(first.astype(float) - frame.left.grey).mean() < 4.0
    raw = cv2.imread(str(sequence.left_paths[0]), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(raw, frame.frame.left)


def test_the_imu_file_holds_the_simulated_samples_and_no_lost_ones(
    small_simulation: Simulation, tmp_path: Path
) -> None:
    """A bad IMU whose clock is ahead: the file has its stamps, and the attitude at its instants."""
    errors = ImuErrors.random(np.random.default_rng(1), dropped_share=0.2)
    offset_s = 0.0234
    simulation = replace(
        small_simulation,
        rig=replace(small_simulation.rig, time_offset_s=offset_s),
        imu=replace(small_simulation.imu, errors=errors),
        camera_ns=small_simulation.camera_ns[:1],
    )
    list(write_kaist(tmp_path, record(simulation, 4)))
    imu = imu_samples(simulation, generators(4)[1]).data
    table = read_stamped_csv(tmp_path / "sensor_data/xsens_imu.csv", 17)
    np.testing.assert_array_equal(table.timestamp_ns, imu.timestamp_ns)
    np.testing.assert_allclose(table.values[:, 7:10], imu.gyro, rtol=0.0, atol=5.1e-10)
    np.testing.assert_allclose(table.values[:, 10:13], imu.accel, rtol=0.0, atol=5.1e-10)
    assert len(imu) < 0.9 * len(imu_times(simulation))
    R = simulation.path.pose(imu.timestamp_ns - round(1e9 * offset_s))[:, :3, :3]
    np.testing.assert_allclose(so3.from_quaternion(table.values[:, :4]), R, atol=1e-8)


def test_truth_tells_poses_objects_and_pixels(written: Path, small_simulation: Simulation) -> None:
    simulation = small_simulation
    rows = np.loadtxt(written / "truth/poses.csv", delimiter=",", usecols=range(1, 8))
    stamps = [int(line.split(",")[0]) for line in (written / "truth/poses.csv").open()]
    T = simulation.path.pose(np.array(stamps))
    np.testing.assert_allclose(rows[:, :3], T[:, :3, 3], atol=1e-8)
    R = so3.from_quaternion(rows[:, [4, 5, 6, 3]])
    np.testing.assert_allclose(R, T[:, :3, :3], atol=1e-8)
    assert set(simulation.camera_ns.tolist()) <= set(stamps)
    truth = json.loads((written / "truth/objects.json").read_text())
    assert [frame["t_ns"] for frame in truth] == simulation.camera_ns.tolist()
    frame = truth[2]
    ids = cv2.imread(str(written / f"truth/{frame['t_ns']}.png"), cv2.IMREAD_GRAYSCALE)
    assert [o["id"] for o in frame["objects"]] == [m.object_id for m in simulation.scene.movers]
    for entry, mover in zip(frame["objects"], simulation.scene.movers, strict=True):
        state = mover.state(frame["t_ns"])
        np.testing.assert_allclose([entry[c] for c in "xyz"], state.center, atol=1e-12)
        assert entry["visible_px"] == np.count_nonzero(ids == entry["id"])
        assert entry["cls"] == mover.category
    assert max(o["visible_px"] for o in frame["objects"]) > 50


def test_global_pose_is_the_vehicle_s(written: Path, small_simulation: Simulation) -> None:
    simulation = small_simulation
    row = (written / "global_pose.csv").read_text().splitlines()[0].split(",")
    T = np.array([float(x) for x in row[1:]]).reshape(3, 4)
    vehicle = simulation.path.pose(int(row[0])) @ np.linalg.inv(simulation.T_vehicle_imu)
    np.testing.assert_allclose(T[:, :3], vehicle[:3, :3], atol=1e-8)
    assert abs(T[0, 3]) > 1e5  # UTM-like large numbers, as in the real data


def test_same_seed_same_bytes(written: Path, small_simulation: Simulation, tmp_path: Path) -> None:
    simulation = small_simulation
    again, other = tmp_path / "again", tmp_path / "other"
    list(write_kaist(again, record(simulation, 1)))
    list(write_kaist(other, record(simulation, 2)))
    names = sorted(p.relative_to(written) for p in written.rglob("*") if p.is_file())
    assert len(names) > 20
    assert all((written / n).read_bytes() == (again / n).read_bytes() for n in names)
    assert any((written / n).read_bytes() != (other / n).read_bytes() for n in names)


def test_refuses_full_folders_and_other_lenses(
    written: Path, small_simulation: Simulation, tmp_path: Path
) -> None:
    simulation = small_simulation
    with pytest.raises(InputError, match="not an empty folder"):
        next(write_kaist(written, record(simulation, 1)))
    fisheye = Camera.make((160, 70), (100, 100), (80, 35), "equidistant", [0.0, 0.0, 0.0, 0.0])
    rig = replace(simulation.rig, cam1=fisheye)
    with pytest.raises(InputError, match="equidistant"):
        next(write_kaist(tmp_path / "new", record(replace(simulation, rig=rig), 1)))
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        next(write_kaist(tmp_path / "file" / "below", record(simulation, 1)))
