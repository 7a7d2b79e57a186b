"""Configurations of OpenVINS, as they are: what each key becomes, and that they run."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.kalibr import write_chain
from ovmot.datasets.openvins_config import ALWAYS, PLAIN, WORDS, load_run_config
from ovmot.datasets.pose_files import Trajectory, interpolate_poses, read_tum
from ovmot.datasets.registry import open_sequence
from ovmot.datasets.truth import read_ego_truth
from ovmot.errors import CalibrationError, InputError
from ovmot.settings import Settings
from ovmot.types import ImuNoise

FILES = Path(__file__).parent / "data" / "openvins"


@pytest.fixture(params=["euroc", "kaist"])
def config(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A copy of a whole configuration, to be changed."""
    folder = tmp_path / str(request.param)
    shutil.copytree(FILES / str(request.param), folder)
    return folder / "estimator_config.yaml"


def keys_of(path: Path) -> list[str]:
    text = path.read_text().split("\n", 1)[1]
    return list(yaml.safe_load(text))


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def named(warning: str) -> set[str]:
    """The keys of the estimator's file that the warning names."""
    of_estimator = warning.split(": ", 2)[2].split("; ", maxsplit=1)[0]
    return set(of_estimator.split(", "))


def test_settings_of_the_euroc_configuration() -> None:
    given = load_run_config(FILES / "euroc" / "estimator_config.yaml")
    expected = {
        "tracker": {
            "max_features": 180, "fast_threshold": 20,
            "equalization": "histogram", "cameras": "stereo",
        },
        "filter": {
            "max_clones": 11, "integration": "rk4", "pixel_sigma": 1.0, "chi2_multiplier": 1.0,
            "max_features_per_update": 40, "max_landmarks": 30, "landmark_pixel_sigma": 1.2,
            "landmark_representation": "anchored_msckf_inverse_depth", "gravity_mps2": 9.81,
            "estimate_time_offset": True,
        },
        "calibration": {"extrinsics": True, "intrinsics": True},
        "initialization": {"window_s": 1.0},
        "zero_velocity": {"enabled": True, "pixel": 0.4},
    }  # fmt: skip
    assert given.settings == Settings.model_validate(expected)
    assert given.calibration is not None
    assert given.calibration.imu_noise == ImuNoise(1.6968e-4, 1.9393e-5, 2e-3, 3e-3)
    assert given.calibration.rig.baseline == pytest.approx(0.110, abs=1e-3)
    assert given.mask_files == (None, None)


def test_settings_of_the_kaist_configuration() -> None:
    given = load_run_config(FILES / "kaist" / "estimator_config.yaml")
    settings = given.settings
    assert settings.filter.integration == "analytic"
    assert settings.filter.landmark_representation == "global_xyz"
    assert settings.tracker.equalization == "clahe"
    assert settings.initialization.motion_window_s == 1.5
    assert settings.initialization.window_s == Settings().initialization.window_s
    assert settings.zero_velocity.pixel == Settings().zero_velocity.pixel
    assert given.mask_files == (FILES / "kaist/mask_left.png", FILES / "kaist/mask_right.png")
    assert given.calibration is not None
    rig = given.calibration.rig
    np.testing.assert_allclose(rig.T_imu_cam0[:3, 3], [1.712, 0.247, -0.116], atol=5e-4)


def test_every_key_is_used_or_named_in_one_warning(config: Path) -> None:
    given = load_run_config(config)
    (warning,) = given.warnings
    assert "\n" not in warning
    used = set(keys_of(config)) - named(warning)
    masks = {"mask0", "mask1"} if "kaist" in str(config) else set()
    always = {"use_fej", "use_klt", "use_aruco", "downsample_cameras", "zupt_only_at_beginning"}
    dynamic = {"init_dyn_use"} if "kaist" in str(config) else {"zupt_max_disparity"}
    assert used == PLAIN.keys() | WORDS.keys() | always | dynamic | masks | {
        "use_stereo", "max_cameras", "init_window_time", "use_mask",
        "relative_config_imu", "relative_config_imucam",
    }  # fmt: skip
    assert "knn_ratio" in named(warning)
    assert "kalibr_imucam_chain.yaml: cam_overlaps, rostopic" in warning
    assert warning.endswith("kalibr_imu_chain.yaml: rostopic, update_rate, model")


@pytest.mark.parametrize("key", sorted(ALWAYS))
def test_what_ovmot_always_does_is_named_when_asked_not_to(key: str, config: Path) -> None:
    text = config.read_text().split(f"\n{key}: ")
    value = str(not ALWAYS[key]).lower()
    config.write_text(f"{text[0]}\n{key}: {value}\n{text[1].split(chr(10), 1)[1]}")
    assert key in named(load_run_config(config).warnings[0])
    config.write_text(config.read_text().replace(f"\n{key}: {value}", f"\n{key}: {ALWAYS[key]}"))
    assert key not in named(load_run_config(config).warnings[0])


@pytest.mark.parametrize(
    ("count", "stereo", "cameras"),
    [(2, "true", "stereo"), (2, "false", "each"), (1, "true", "left"), (1, "false", "left")],
)
def test_cameras(config: Path, count: int, stereo: str, cameras: str) -> None:
    edit(config, "max_cameras: 2", f"max_cameras: {count}")
    edit(config, "use_stereo: true", f"use_stereo: {stereo}")
    given = load_run_config(config)
    assert given.settings.tracker.cameras == cameras
    assert given.calibration is not None
    assert given.calibration.rig.n_cameras == count


def test_a_chain_of_one_camera(config: Path) -> None:
    edit(config, "max_cameras: 2", "max_cameras: 1")
    chain = config.with_name("kalibr_imucam_chain.yaml")
    chain.write_text(chain.read_text().split("\ncam1:")[0])
    given = load_run_config(config)
    assert given.calibration is not None
    assert given.calibration.rig.n_cameras == 1
    assert "cam0" not in named(given.warnings[0])


def test_older_keys_and_other_integrations(config: Path) -> None:
    line = next(x for x in config.read_text().split("\n") if x.startswith("integration"))
    edit(config, line, "use_rk4int: true\nuse_imuavg: true")
    given = load_run_config(config)
    assert given.settings.filter.integration == "rk4"
    assert "use_imuavg" in named(given.warnings[0])
    edit(config, "use_rk4int: true", "use_rk4int: false")
    given = load_run_config(config)
    assert given.settings.filter.integration == "discrete"
    assert "use_imuavg" not in named(given.warnings[0])


def test_a_calibrated_imu_is_not_passed_over(config: Path) -> None:
    chain = config.with_name("kalibr_imu_chain.yaml")
    edit(chain, "Tw: [[1.0", "Tw: [[1.01")
    edit(chain, "time_offset: 0.0", "time_offset: 0.02")
    assert (
        load_run_config(config)
        .warnings[0]
        .endswith("rostopic, time_offset, update_rate, model, Tw")
    )


def test_overrides_win(config: Path) -> None:
    settings = load_run_config(config, ["filter.max_clones=8"]).settings
    assert settings.filter.max_clones == 8


def test_our_own_settings_stay_ours(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("filter: {max_clones: 9}\n")
    given = load_run_config(path)
    assert given.settings.filter.max_clones == 9
    assert (given.calibration, given.warnings) == (None, ())
    path.write_text("filter: {max_clones: 9}\nmax_clones: 9\n")
    with pytest.raises(InputError, match="unknown key 'max_clones'"):
        load_run_config(path)
    assert load_run_config(None).settings == Settings()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("max_clones: 1", "max_clones: 991", r"\(OpenVINS\): 'filter.max_clones'"),
        ("use_stereo: true", 'use_stereo: "false"', "'use_stereo': 'false' is neither true nor f"),
        (
            'feat_rep_slam: "',
            'feat_rep_slam: "NEW_',
            "'feat_rep_slam': 'NEW_.* is not known; known:",
        ),
        ('imucam: "', 'imucam: "no_', r"no_kalibr_imucam_chain.yaml: no such"),
        ('imu: "', 'imu: "no_', r"no_kalibr_imu_chain.yaml: no such"),
        ("num_pts: ", "num_pts: many #", "'tracker.max_features'"),
        ("use_klt: true", "use_klt: true\nuse_klt: true", r"row \d+: .*'use_klt' twice"),
    ],
)
def test_mistakes_name_file_and_key(config: Path, old: str, new: str, message: str) -> None:
    edit(config, old, new)
    with pytest.raises(InputError, match=message) as caught:
        load_run_config(config)
    assert str(config.parent) in str(caught.value)


def test_a_missing_mask_is_said(config: Path) -> None:
    text = config.read_text().replace("use_mask: false", "use_mask: true")
    config.write_text(text.replace("mask_right", "mask_gone"))
    (config.parent / "mask_left.png").touch()
    with pytest.raises(InputError, match=r"'mask1': no such file .*mask_gone\.png"):
        load_run_config(config)


def test_a_configuration_runs(
    config: Path,
    painted_euroc: Path,
    painted_rig: StereoRig,
    ovmot_command: Callable[..., Any],
    tmp_path: Path,
) -> None:
    """With the chain of the painted rig; the masks are brought to its size."""
    write_chain(config.with_name("kalibr_imucam_chain.yaml"), painted_rig)
    for mask in config.parent.glob("mask*.png"):
        cv2.imwrite(str(mask), np.zeros((240, 320), dtype=np.uint8))
    out = tmp_path / "out"
    outcome = ovmot_command("run", painted_euroc, "-o", out, "--config", config)
    assert outcome.code == 0, outcome.err
    warning = "warning: keys of OpenVINS that have no effect here: "
    assert outcome.err.startswith(f"ovmot: {warning}") and outcome.err.count(warning) == 1
    (noted, *_) = json.loads((out / "run.json").read_text())["warnings"]
    assert "keys of OpenVINS" in str(noted)
    trajectory = read_tum(out / "trajectory.tum")
    np.testing.assert_allclose(trajectory.T_world_imu[:, :3, 3], 0.0, atol=0.02)


def test_the_chains_replace_the_calibration_of_the_data(config: Path, painted_euroc: Path) -> None:
    calibration = load_run_config(config).calibration
    sequence = open_sequence(painted_euroc, calibration=calibration)
    assert calibration is not None
    assert sequence.rig == calibration.rig
    with pytest.raises(CalibrationError, match="no such calibration file"):
        open_sequence(painted_euroc, calibration=painted_euroc / "gone.yaml")


@pytest.mark.slow
def test_euroc_as_it_is_on_real_images(
    data_root: Path, ovmot_command: Callable[..., Any], tmp_path: Path
) -> None:
    folder = data_root / "euroc_mh01"
    if not folder.is_dir():
        pytest.skip(f"{folder} is missing")
    config = FILES / "euroc" / "estimator_config.yaml"
    options = ("--config", config, "--no-objects", "--last", 70)
    outcome = ovmot_command("run", folder, "-o", tmp_path / "out", *options)
    assert outcome.code == 0, outcome.err
    assert_follows(tmp_path / "out", folder, moved_m=0.3, atol=0.03)


@pytest.mark.slow
def test_euroc_with_one_camera_started_in_motion(
    data_root: Path, ovmot_command: Callable[..., Any], config: Path, tmp_path: Path
) -> None:
    folder = data_root / "euroc_mh01"
    if not folder.is_dir() or config.parent.name != "euroc":
        pytest.skip(f"{folder} is missing, or not for this configuration")
    edit(config, "max_cameras: 2", "max_cameras: 1")
    chain = config.with_name("kalibr_imucam_chain.yaml")
    chain.write_text(chain.read_text().split("\ncam1:")[0])
    outcome = ovmot_command("run", folder, "-o", tmp_path / "out", "--config", config)
    assert outcome.code == 0, outcome.err
    assert "objects are off" in outcome.err
    assert_follows(tmp_path / "out", folder, moved_m=0.3, atol=0.04)
    told = json.loads((tmp_path / "out" / "run.json").read_text())
    assert told["counts"]["frames_before_start"] < 40


@pytest.mark.slow
def test_kaist_on_rendered_images(
    simulated_street: Callable[[str], Path], ovmot_command: Callable[..., Any], tmp_path: Path
) -> None:
    """The rendered rig's chain, since the real calibration is that of another rig."""
    folder = simulated_street("traffic")
    shutil.copytree(FILES / "kaist", tmp_path / "kaist")
    config = tmp_path / "kaist" / "estimator_config.yaml"
    edit(config, "use_mask: true", "use_mask: false")
    write_chain(config.with_name("kalibr_imucam_chain.yaml"), open_sequence(folder).rig)
    outcome = ovmot_command(
        "run", folder, "-o", tmp_path / "out", "--config", config, "--no-objects"
    )
    assert outcome.code == 0, outcome.err
    assert_follows(tmp_path / "out", folder, moved_m=5.0, atol=0.15)


def assert_follows(out: Path, data: Path, moved_m: float, atol: float) -> None:
    """Distances from the first pose agree with the truth's: free of where the world begins."""
    found, truth = read_tum(out / "trajectory.tum"), read_ego_truth(data)
    true = interpolate_poses(Trajectory(truth.timestamp_ns, truth.T_world_imu), found.timestamp_ns)
    assert np.isfinite(true).all(axis=(1, 2)).mean() > 0.9
    gone = [np.linalg.norm(T[:, :3, 3] - T[0, :3, 3], axis=1) for T in (found.T_world_imu, true)]
    known = np.isfinite(gone[1])
    assert gone[1][known].max() > moved_m
    np.testing.assert_allclose(gone[0][known], gone[1][known], atol=atol)
