"""What every written format shares: truth beside it, time grids, and no finished look when cut."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from ovmot.cameras.rig import StereoRig, rectified, without_distortion
from ovmot.datasets.registry import WRITERS
from ovmot.datasets.text_tables import read_stamped_csv
from ovmot.datasets.writing import Writer, truth_times
from ovmot.errors import InputError
from ovmot.sim.imu_errors import ImuErrors
from ovmot.sim.recording import generators, imu_samples, record
from ovmot.sim.render import camera_rays, render_image
from ovmot.sim.simulation import Simulation


def _image_rig(writer: Writer, rig: StereoRig) -> StereoRig:
    """The rig whose images a format holds."""
    if writer in (WRITERS["kitti_sync"], WRITERS["4seasons"]):
        return rectified(rig)
    return without_distortion(rig) if writer is WRITERS["viode"] else rig


@pytest.fixture(params=sorted(WRITERS))
def writer(request: pytest.FixtureRequest) -> Writer:
    return WRITERS[request.param]


def test_depth_and_imu_truth_are_written(
    small_simulation: Simulation, writer: Writer, tmp_path: Path
) -> None:
    errors = ImuErrors.random(np.random.default_rng(2), dropped_share=0.2)
    simulation = replace(
        small_simulation,
        imu=replace(small_simulation.imu, errors=errors),
        camera_ns=small_simulation.camera_ns[:1],
    )
    assert list(writer(tmp_path, record(simulation, 3))) == simulation.camera_ns.tolist()
    time_ns = int(simulation.camera_ns[0])
    steps = cv2.imread(str(tmp_path / f"truth/depth/{time_ns}.png"), cv2.IMREAD_UNCHANGED)
    assert steps is not None
    assert steps.dtype == np.uint16
    rig = _image_rig(writer, simulation.rig)
    T_world_cam0 = simulation.path.pose(time_ns) @ rig.T_imu_cam0
    true = render_image(simulation.scene, camera_rays(rig.cam0), T_world_cam0, time_ns).depth
    near = np.isfinite(true) & (true < 255.0)
    assert 0.4 < near.mean() < 1.0
    np.testing.assert_allclose(steps[near] / 256.0, true[near], atol=0.5 / 256.0 + 1e-4)
    np.testing.assert_array_equal(steps[~np.isfinite(true)], 0)
    imu = imu_samples(simulation, generators(3)[1])
    table = read_stamped_csv(tmp_path / "truth/imu.csv", 7)
    np.testing.assert_array_equal(table.timestamp_ns, imu.data.timestamp_ns)
    np.testing.assert_allclose(table.values[:, :3], imu.gyro_bias, atol=5.1e-10)
    np.testing.assert_allclose(table.values[:, 3:], imu.accel_bias, atol=5.1e-10)
    stated = yaml.safe_load((tmp_path / "truth/imu_errors.yaml").read_text())
    np.testing.assert_array_equal(stated["gyro_matrix"], errors.gyro_matrix)
    np.testing.assert_array_equal(stated["g_sensitivity"], errors.g_sensitivity)
    assert stated["dropped_share"] == 0.2
    assert stated["time_offset_s"] == 0.0


def test_an_imu_without_errors_has_no_file_of_them(
    small_simulation: Simulation, writer: Writer, tmp_path: Path
) -> None:
    list(
        writer(
            tmp_path, record(replace(small_simulation, camera_ns=small_simulation.camera_ns[:1]), 3)
        )
    )
    assert (tmp_path / "truth/imu.csv").exists()
    assert not (tmp_path / "truth/imu_errors.yaml").exists()


def test_an_interrupted_sequence_has_no_objects_file(
    small_simulation: Simulation, writer: Writer, tmp_path: Path
) -> None:
    frames = writer(tmp_path, record(small_simulation, 3))
    first = next(frames)
    frames.close()  # type: ignore[attr-defined]
    assert first == small_simulation.camera_ns[0]
    assert (tmp_path / f"truth/{first}.png").exists()
    assert not list(tmp_path.rglob("objects.json*"))


def test_a_folder_that_vanishes_is_one_clear_error(
    small_simulation: Simulation, writer: Writer, tmp_path: Path
) -> None:
    frames = writer(tmp_path / "data", record(small_simulation, 3))
    next(frames)
    (tmp_path / "data/truth/depth").rename(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="data: cannot be written: No such file"):
        list(frames)


def test_truth_has_every_frame_also_between_imu_samples(small_simulation: Simulation) -> None:
    odd = small_simulation.camera_ns[0] + np.array([0, 33_333_333, 66_666_667])
    times = truth_times(record(replace(small_simulation, camera_ns=odd), 0))
    assert set(odd.tolist()) <= set(times.tolist())
    assert np.diff(times).max() <= 10_000_000
    assert np.all(np.diff(times) > 0)
