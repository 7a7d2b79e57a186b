"""What a run has found, as a chain: what is observed is written, what is not is kept."""

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.kalibr import CHAIN_FILE, read_kalibr, write_chain
from ovmot.errors import InputError
from ovmot.geometry import so3
from ovmot.run_calibration import run_calibration, write_run_calibration
from ovmot.settings import Settings
from ovmot.settings_file import load_settings
from ovmot.sim.handheld import handheld_rig
from ovmot.vio.online_calibration import make_calibration

SETTINGS = load_settings(None, ["calibration.extrinsics=true"])
FOUND = {
    "cam0_pose_rx": 0.01, "cam0_pose_ry": -0.004, "cam0_pose_y": 0.02, "stereo_rx": 5e-4,
    "stereo_length": 0.003,
}  # fmt: skip
SURE = ("cam0_pose_rx", "cam0_pose_ry", "stereo_rx")


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return write_run(tmp_path / "run")


def write_run(
    folder: Path, settings: Settings = SETTINGS, sure: tuple[str, ...] = SURE,
    clock_sigma_s: float = 1e-4, n_cameras: int = 2, found: Mapping[str, float] = FOUND,
) -> Path:  # fmt: skip
    """A run of one frame; of what it is sure, the sigma is a tenth of the prior's."""
    folder.mkdir()
    rig = replace(handheld_rig(), n_cameras=n_cameras)
    write_chain(folder / CHAIN_FILE, rig)
    calibration, variance = make_calibration(rig, settings.calibration)
    names = calibration.names()
    sigma = [s * (0.1 if n in sure else 0.9) for n, s in zip(names, variance**0.5, strict=True)]
    row = [0, *(found.get(name, 0.0) for name in names), *sigma]
    header = ["timestamp_ns", *names, *(f"std_{name}" for name in names)]
    lines = [",".join(header), ",".join(str(v) for v in row)]
    (folder / "calibration.csv").write_text("\n".join(lines) + "\n")
    (folder / "state.csv").write_text(
        f"timestamp_ns,time_offset_s,std_time_offset_s\n0,0.02,{clock_sigma_s}\n"
    )
    (folder / "trajectory.tum").write_text("0 0 0 0 0 0 0 1\n")
    source = {"path": "/data/drive", "n_imu_samples": 2000, "first_timestamp_ns": 0,
              "last_timestamp_ns": 10**10}  # fmt: skip
    noise = {"gyro": 1e-3, "gyro_walk": 1e-5, "accel": 1e-2, "accel_walk": 1e-4}
    summary = {"settings": settings.model_dump(), "input": source, "imu_noise": noise}
    (folder / "run.json").write_text(json.dumps(summary))
    return folder


def test_what_is_observed_is_taken(run: Path) -> None:
    found = run_calibration(run)
    before, after = found.before, found.after
    turn = so3.log(before.T_imu_cam0[:3, :3].T @ after.T_imu_cam0[:3, :3])
    np.testing.assert_allclose(turn, [0.01, -0.004, 0.0], atol=1e-12)
    np.testing.assert_array_equal(after.T_imu_cam0[:3, 3], before.T_imu_cam0[:3, 3])
    assert after.baseline == pytest.approx(before.baseline, abs=1e-12)
    assert after.time_offset_s == 0.02
    values = {v.name: v for v in found.values}
    assert {name for name, v in values.items() if v.observed} == {*SURE, "time_offset_s"}
    assert values["cam0_pose_rx"].unit == "deg"
    assert values["cam0_pose_rx"].after == pytest.approx(np.degrees(0.01))
    assert values["stereo_length"].before == pytest.approx(before.baseline)
    assert values["cam0_pose_y"].after == pytest.approx(before.T_imu_cam0[1, 3] + 0.02)


def test_of_one_camera_no_second_one_is_told(tmp_path: Path) -> None:
    """The pose of a right camera that is not there is a placeholder."""
    sure = ("cam0_pose_rx", "cam0_pose_ry")
    run = write_run(tmp_path / "run", sure=sure, n_cameras=1)
    found, chain = run_calibration(run), tmp_path / "chain.yaml"
    assert {v.name for v in found.values if v.name.startswith(("stereo", "cam1"))} == set()
    write_run_calibration(run, chain, found)
    assert set(yaml.safe_load(chain.read_text())) == {"cam0"}
    assert "stereo" not in chain.read_text()


def test_the_files(run: Path, tmp_path: Path) -> None:
    chain = tmp_path / "out" / "chain.yaml"
    found = run_calibration(run)
    written = write_run_calibration(run, chain, found)
    assert [path.name for path in written.files] == ["chain.yaml", "kalibr_imu_chain.yaml"]
    again = read_kalibr(chain)
    np.testing.assert_allclose(again.rig.T_imu_cam1, found.after.T_imu_cam1, atol=1e-9)
    assert again.rig.time_offset_s == 0.02
    assert again.imu_noise is not None
    assert again.imu_noise.accel == 1e-2
    assert yaml.safe_load(written.files[1].read_text())["imu0"]["update_rate"] == 200.0
    text = chain.read_text()
    assert "# cam0_pose_rx: 0 -> 0.572958 +- 0.057 deg" in text
    assert f"# stereo_length: {handheld_rig().baseline:.6g} m: kept, not observed" in text
    with pytest.raises(InputError, match="is there already"):
        write_run_calibration(run, chain, found)
    write_run_calibration(run, chain, found, overwrite=True)


def test_nothing_observed_is_refused(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run", sure=(), clock_sigma_s=0.004)
    with pytest.raises(InputError, match="has shown nothing of the calibration"):
        run_calibration(run)


@pytest.mark.parametrize(("turn", "doubted"), [(0.03, False), (0.06, True)])
def test_what_the_prior_does_not_allow_is_doubted(
    ovmot_command: Callable[..., Any], tmp_path: Path, turn: float, doubted: bool
) -> None:
    """Three standard deviations of one of six coordinates are possible, six are not."""
    run = write_run(tmp_path / "run", found={"cam0_pose_ry": turn})
    chain = tmp_path / "chain.yaml"
    assert ("cam0_pose_ry comes out 6.0 prior" in run_calibration(run).doubt) == doubted
    said = ovmot_command("calibrate", run, "-o", chain)
    assert said.code == (2 if doubted else 0)
    assert chain.exists() != doubted
    if doubted:
        assert "--force writes anyway" in said.complaint
        assert ovmot_command("calibrate", run, "-o", chain, "--force").code == 0
        assert chain.exists()


def test_nothing_estimated_is_refused(run: Path) -> None:
    (run / "calibration.csv").unlink()
    with pytest.raises(InputError, match=r"calibration\.extrinsics=true"):
        run_calibration(run)


def test_lenses(tmp_path: Path) -> None:
    settings = load_settings(None, ["calibration.intrinsics=true"])
    found = run_calibration(write_run(tmp_path / "run", settings, ("cam1_lens_fy",)))
    values = {v.name: v for v in found.values}
    assert values["cam1_lens_fy"].before == found.before.cam1.fy
    assert values["cam0_lens_d1"].before == found.before.cam0.distortion[1]
    assert found.after.T_imu_cam1.tolist() == found.before.T_imu_cam1.tolist()


@pytest.mark.slow
def test_command(
    simulated_street: Callable[[str], Path], ovmot_command: Callable[..., Any], tmp_path: Path
) -> None:
    """A data set is run for it; a run is read; both give the same chain."""
    data, runs = simulated_street("empty"), tmp_path / "run"
    first, second = tmp_path / "a" / "chain.yaml", tmp_path / "b" / "chain.yaml"
    fast = ("--set", "objects.enabled=false", "--set", "calibration.extrinsics=true")
    said = ovmot_command("calibrate", data, "-o", first, *fast)
    assert said.code == 0, said.err
    assert "stereo_length" in said.out
    assert ovmot_command("run", data, "-o", runs, *fast, "--threads", "1").code == 0
    said = ovmot_command("calibrate", runs, "-o", second)
    assert said.code == 0, said.err
    rigs: list[StereoRig] = [read_kalibr(chain).rig for chain in (first, second)]
    np.testing.assert_allclose(rigs[0].T_imu_cam1, rigs[1].T_imu_cam1, atol=1e-6)
    assert ovmot_command("calibrate", runs, "-o", second).code == 2
