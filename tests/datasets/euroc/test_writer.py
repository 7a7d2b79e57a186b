"""A written sequence is a EuRoC folder: the ordinary reader reads back what was simulated."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.models import CAMERA_MODELS
from ovmot.cameras.rig import StereoRig
from ovmot.datasets.euroc.writer import write_asl
from ovmot.datasets.registry import open_sequence
from ovmot.datasets.text_tables import read_stamped_csv
from ovmot.errors import InputError
from ovmot.geometry import so3
from ovmot.sim.imu_errors import ImuErrors
from ovmot.sim.recording import generators, imu_samples, record
from ovmot.sim.render import render_stereo
from ovmot.sim.simulation import Simulation

DISTORTION = {
    "radtan": [-0.05, 0.02, -0.001, 0.0007],
    "equidistant": [-0.02, 0.004, -0.002, 0.0003],
    "none": [],
}
SEED = 5


def with_model(camera: Camera, model: str) -> Camera:
    return replace(camera, model=CAMERA_MODELS[model], distortion=np.array(DISTORTION[model]))


@pytest.fixture(scope="module", params=sorted(DISTORTION))
def simulation(request: pytest.FixtureRequest, small_simulation: Simulation) -> Simulation:
    """The small street through each model, with a bad IMU whose clock is 23 ms ahead."""
    rig = small_simulation.rig
    cam0, cam1 = (with_model(camera, request.param) for camera in rig.cameras)
    errors = ImuErrors.random(np.random.default_rng(1), dropped_share=0.15)
    return replace(
        small_simulation,
        rig=replace(rig, cam0=cam0, cam1=cam1, time_offset_s=0.0234),
        imu=replace(small_simulation.imu, errors=errors, rate_hz=200.0),
        camera_ns=small_simulation.camera_ns[:3],
    )


@pytest.fixture(scope="module")
def written(simulation: Simulation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("asl") / "data"
    assert list(write_asl(folder, record(simulation, SEED))) == simulation.camera_ns.tolist()
    return folder


def test_the_reader_finds_the_simulated_rig_images_and_imu(
    written: Path,
    simulation: Simulation,
    assert_same_rig: Callable[[StereoRig, StereoRig], None],
) -> None:
    sequence = open_sequence(written)
    assert sequence.kind == "euroc"
    assert_same_rig(sequence.rig, simulation.rig)
    assert sequence.imu_noise == simulation.imu.noise
    np.testing.assert_array_equal(sequence.frame_ns, simulation.camera_ns)
    image_rng, imu_rng = generators(SEED)
    imu = imu_samples(simulation, imu_rng).data
    assert sequence.imu is not None
    np.testing.assert_array_equal(sequence.imu.timestamp_ns, imu.timestamp_ns)
    np.testing.assert_allclose(sequence.imu.gyro, imu.gyro, rtol=0.0, atol=5.1e-10)
    np.testing.assert_allclose(sequence.imu.accel, imu.accel, rtol=0.0, atol=5.1e-10)
    assert np.diff(imu.timestamp_ns).max() >= 10_000_000  # samples are missing from the file
    frames = render_stereo(
        simulation.scene, simulation.rig, simulation.path, simulation.camera_ns,
        simulation.optics, image_rng,
    )  # fmt: skip
    paths = zip(sequence.left_paths, sequence.right_paths, strict=True)
    for frame, (left, right) in zip(frames, paths, strict=True):
        np.testing.assert_array_equal(sequence.decode(left), frame.frame.left)
        np.testing.assert_array_equal(sequence.decode(right), frame.frame.right)


def test_states_are_those_of_the_path_and_the_imu(written: Path, simulation: Simulation) -> None:
    table = read_stamped_csv(written / "mav0/state_groundtruth_estimate0/data.csv", 17)
    times, values = table.timestamp_ns, table.values
    assert set(simulation.camera_ns.tolist()) <= set(times.tolist())
    T = simulation.path.pose(times)
    np.testing.assert_allclose(values[:, :3], T[:, :3, 3], atol=1e-9)
    R = so3.from_quaternion(values[:, [4, 5, 6, 3]])
    np.testing.assert_allclose(R, T[:, :3, :3], atol=1e-8)
    np.testing.assert_allclose(values[:, 7:10], simulation.path.velocity(times), atol=1e-9)
    imu = imu_samples(simulation, generators(SEED)[1])
    at = times + round(1e9 * simulation.rig.time_offset_s)
    near = np.abs(imu.data.timestamp_ns[:, None] - at).argmin(axis=0)
    assert np.abs(imu.data.timestamp_ns[near] - at).max() < 15_000_000
    np.testing.assert_allclose(values[:, 10:13], imu.gyro_bias[near], atol=1e-5)
    np.testing.assert_allclose(values[:, 13:16], imu.accel_bias[near], atol=1e-4)


def test_truth_is_whole(written: Path, simulation: Simulation) -> None:
    truth = json.loads((written / "truth/objects.json").read_text())
    assert [frame["t_ns"] for frame in truth] == simulation.camera_ns.tolist()
    for time_ns in simulation.camera_ns.tolist():
        assert (written / f"truth/{time_ns}.png").exists()
        assert (written / f"truth/depth/{time_ns}.png").exists()


def test_same_seed_same_bytes(written: Path, simulation: Simulation, tmp_path: Path) -> None:
    list(write_asl(tmp_path / "again", record(simulation, SEED)))
    list(write_asl(tmp_path / "other", record(simulation, SEED + 1)))
    names = sorted(p.relative_to(written) for p in written.rglob("*") if p.is_file())
    assert len(names) > 20
    assert all((written / n).read_bytes() == (tmp_path / "again" / n).read_bytes() for n in names)
    for n in ("mav0/imu0/data.csv", f"mav0/cam1/data/{simulation.camera_ns[0]}.png"):
        assert (written / n).read_bytes() != (tmp_path / "other" / n).read_bytes()


def test_an_imu_without_noise_can_be_read(small_simulation: Simulation, tmp_path: Path) -> None:
    silent = replace(small_simulation.imu.noise, gyro=0.0)
    imu = replace(small_simulation.imu, noise=silent)
    one = replace(small_simulation, imu=imu, camera_ns=small_simulation.camera_ns[:1])
    list(write_asl(tmp_path, record(one, SEED)))
    assert open_sequence(tmp_path).imu_noise is None


def test_refuses_full_folders_and_cameras_that_the_format_can_not_hold(
    small_simulation: Simulation, tmp_path: Path
) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("")
    with pytest.raises(InputError, match="not an empty folder"):
        next(write_asl(tmp_path / "full", record(small_simulation, SEED)))
    skewed = Camera.make((160, 70), (100, 100), (80, 35), "none", skew=0.1)
    rig = replace(small_simulation.rig, cam1=skewed)
    with pytest.raises(InputError, match=r"skew of 0\.1"):
        next(write_asl(tmp_path / "new", record(replace(small_simulation, rig=rig), SEED)))
    assert not (tmp_path / "new").exists()
