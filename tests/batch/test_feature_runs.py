"""A feature-level simulation goes through the same pipeline and leaves an ordinary run."""

import csv
import json
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ovmot.batch.feature_runs import run_features
from ovmot.datasets.pose_files import read_tum
from ovmot.errors import InputError
from ovmot.evaluation.calibration import calibration_errors, calibration_scalars
from ovmot.evaluation.consistency import nees, pose_errors
from ovmot.geometry import se3, so3
from ovmot.geometry.splines import PoseSpline
from ovmot.outputs.run_reader import read_calibration, read_ego_run
from ovmot.run import RunOptions
from ovmot.settings import Settings
from ovmot.settings_file import load_settings
from ovmot.sim.features import FeatureBody, FeatureOptions, FeatureRecording, FeatureSimulation
from ovmot.sim.handheld import EUROC_NOISE, ORIGIN_NS, handheld_rig
from ovmot.sim.miscalibration import Miscalibration, miscalibrated
from ovmot.sim.simulation import ImuModel


@pytest.fixture(scope="module")
def recording() -> FeatureRecording:
    t = np.arange(-1.0, 7.1, 0.05)
    R = so3.exp(np.stack([0.2 * np.sin(t), 0.6 * np.sin(0.7 * t), 0.2 * np.cos(t)], axis=-1))
    p = np.stack([1.2 * t, 0.4 * np.sin(t), 0.1 * np.sin(3.0 * t)], axis=-1)
    path = PoseSpline.through(ORIGIN_NS + np.round(1e9 * t).astype(np.int64), se3.make(R, p))
    stamps = ORIGIN_NS + 100_000_000 * np.arange(60, dtype=np.int64)
    imu = ImuModel(200.0, EUROC_NOISE, np.full(3, 2e-3), np.full(3, 3e-2))
    options = FeatureOptions(n_features=100, wrong_match_share=0.05)
    return FeatureRecording(FeatureSimulation(handheld_rig(), path, stamps, imu, options), 4)


def test_the_run_follows_the_truth(recording: FeatureRecording, tmp_path: Path) -> None:
    done: list[int] = []
    run_features(recording, Settings(), RunOptions(tmp_path / "out"), done.append)
    assert done == list(range(1, 61))
    run, truth = read_tum(tmp_path / "out" / "trajectory.tum"), recording.truth()
    np.testing.assert_array_equal(run.timestamp_ns, truth.timestamp_ns)
    error = run.T_world_imu[:, :3, 3] - truth.T_world_imu[:, :3, 3]
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.08
    prior = json.loads((tmp_path / "out" / "run.json").read_text())
    assert prior["ended"] == "finished"
    assert prior["input"]["kind"] == "features"
    assert prior["options"]["start"] == "truth"
    assert prior["counts"]["frames_written"] == 60


def test_the_covariance_is_honest(recording: FeatureRecording, tmp_path: Path) -> None:
    """NEES of runs that share nothing but the path: within wide bounds around its 3."""
    simulation = replace(
        recording.simulation, options=FeatureOptions(n_features=100, pixel_sigma=0.4)
    )
    of_runs = []
    for seed in range(3):
        run_features(
            FeatureRecording(simulation, seed), load_settings(None, ["filter.pixel_sigma=0.4"]),
            RunOptions(tmp_path / str(seed)),
        )  # fmt: skip
        run, truth = read_ego_run(tmp_path / str(seed)), FeatureRecording(simulation, seed).truth()
        assert run.covariance is not None
        errors = pose_errors(truth.T_world_imu, run.T_world_imu)
        of_runs.append(
            [nees(errors[:, k], run.covariance[:, k, k]) for k in (slice(0, 3), slice(3, 6))]
        )
    orientation, position = np.mean(of_runs, axis=(0, 2))
    assert 0.5 < orientation < 7.0
    assert 0.5 < position < 7.0


def test_points_on_a_moving_body_are_found_dynamic(
    recording: FeatureRecording, tmp_path: Path
) -> None:
    ahead = recording.simulation.path.pose(ORIGIN_NS + 3_000_000_000) @ handheld_rig().T_imu_cam0
    t = np.linspace(-1.0, 7.0, 40)
    across = np.stack([1.5 * (t - 3.0), np.zeros(40), np.full(40, 5.0)], axis=-1)
    poses = ahead @ se3.make(np.broadcast_to(np.eye(3), (40, 3, 3)), across)
    path = PoseSpline.through(ORIGIN_NS + np.round(1e9 * t).astype(np.int64), poses)
    points = np.random.default_rng(5).uniform(-0.7, 0.7, (30, 3))
    simulation = replace(
        recording.simulation,
        options=FeatureOptions(n_features=100, pixel_sigma=0.3),
        bodies=(FeatureBody(1, path, points),),
    )
    moving = FeatureRecording(simulation, 6)
    run_features(moving, Settings(), RunOptions(tmp_path / "out", save_points=True))
    true_body = {
        (seen.frame.timestamp_ns, feature_id): body
        for seen in moving.frames()
        for feature_id, body in zip(
            seen.frame.feature_id.tolist(), seen.object_id.tolist(), strict=True
        )
    }
    found: dict[int, Counter[str]] = {0: Counter(), 1: Counter()}
    with (tmp_path / "out" / "points.csv").open() as file:
        for row in csv.DictReader(file):
            found[true_body[int(row["timestamp_ns"]), int(row["feature_id"])]][row["label"]] += 1
    assert found[1]["dynamic"] > 300
    assert found[1]["static"] < 0.1 * found[1]["dynamic"]
    assert found[0]["dynamic"] < 0.01 * found[0]["static"]


def test_what_needs_images_is_refused(recording: FeatureRecording, tmp_path: Path) -> None:
    for options in (
        RunOptions(tmp_path / "out", video=True),
        RunOptions(tmp_path / "out", first=3),
        RunOptions(tmp_path / "out", ego_poses=tmp_path / "poses.txt"),
    ):
        with pytest.raises(InputError, match="no images"):
            run_features(recording, Settings(), options)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_wrong_calibration_is_found_and_its_errors_stay_inside_their_sigmas(
    tmp_path: Path,
) -> None:
    """Extrinsics off by 1 degree and 2 cm, focal lengths by 1 %, the clock by 10 ms."""
    simulation = FeatureSimulation(
        handheld_rig(), lively_path(22.0), ORIGIN_NS + 100_000_000 * np.arange(200),
        ImuModel(200.0, EUROC_NOISE, np.full(3, 2e-3), np.full(3, 3e-2)),
        FeatureOptions(n_features=150),
    )  # fmt: skip
    wrong = Miscalibration(rotation_deg=1.0, position_m=0.02, focal_share=0.01, time_offset_s=0.01)
    true, prior = simulation.rig, miscalibrated(simulation.rig, wrong, np.random.default_rng(0))
    settings = load_settings(
        None,
        [
            "calibration.extrinsics=true", "calibration.intrinsics=true",
            "calibration.position_sigma_m=0.012", "calibration.focal_sigma_px=5",
            "calibration.stereo_rotation_sigma_rad=0.014", "calibration.baseline_sigma=0.15",
            "calibration.stereo_position_sigma_m=0.017",
            "filter.time_offset_sigma_s=0.01", "filter.pixel_sigma=1",
            "filter.landmark_pixel_sigma=1", "epipolar.threshold_px=30",
            "segmentation.enabled=false",
        ],
    )  # fmt: skip
    recording = FeatureRecording(simulation, 1)
    run_features(recording, settings, RunOptions(tmp_path / "out"), initial_rig=prior)
    errors = calibration_errors(read_calibration(tmp_path / "out"), prior, true)
    assert errors is not None
    assert (np.abs(errors.error[20:]) < 4.0 * errors.sigma[20:]).all()
    found = calibration_scalars(errors)
    for metric, bound in (
        ("calibration_rotation_deg", 0.2), ("calibration_focal_px", 2.0),  # of 1.0 and 6.5
        ("calibration_time_offset_ms", 0.5),  # of 10
    ):  # fmt: skip
        value = found[metric]
        assert value is not None and value < bound, metric
    assert (found["calibration_inside_3_sigma"] or 0.0) > 0.95


def lively_path(seconds: float) -> PoseSpline:
    """About every axis and along every axis, so that all of the calibration can be seen."""
    t = np.arange(-1.0, seconds, 0.05)
    turn = [0.5 * np.sin(1.9 * t), 0.6 * np.sin(1.3 * t + 0.5), 0.4 * np.cos(1.6 * t)]
    p = np.stack([1.2 * t, 0.8 * np.sin(1.7 * t), 0.5 * np.sin(2.3 * t)], axis=-1)
    stamps = ORIGIN_NS + np.round(1e9 * t).astype(np.int64)
    return PoseSpline.through(stamps, se3.make(so3.exp(np.stack(turn, axis=-1)), p))


@pytest.mark.slow
def test_what_the_motion_cannot_show_stays_as_unsure_as_it_was(tmp_path: Path) -> None:
    """Straight on at constant speed: neither the accelerometer's scales nor where the camera is on
    the IMU, nor the length of the baseline."""
    t = np.arange(-1.0, 9.0, 0.05)
    p = np.stack([2.0 * t, np.zeros_like(t), np.zeros_like(t)], axis=-1)
    path = PoseSpline.through(
        ORIGIN_NS + np.round(1e9 * t).astype(np.int64),
        se3.make(np.broadcast_to(np.eye(3), (len(t), 3, 3)), p),
    )
    simulation = FeatureSimulation(
        handheld_rig(), path, ORIGIN_NS + 100_000_000 * np.arange(80),
        ImuModel(200.0, EUROC_NOISE, np.full(3, 2e-3), np.full(3, 3e-2)),
        FeatureOptions(n_features=100),
    )  # fmt: skip
    settings = load_settings(
        None, ["calibration.imu_intrinsics=true", "calibration.extrinsics=true"]
    )
    run_features(FeatureRecording(simulation, 2), settings, RunOptions(tmp_path / "out"))
    with (tmp_path / "out" / "calibration.csv").open() as file:
        rows = list(csv.DictReader(file))
    names = (
        "gyro_matrix_00", "gyro_matrix_11", "gyro_matrix_22", "accel_matrix_11",
        "cam0_pose_x", "cam0_pose_y", "cam0_pose_z", "stereo_length",
    )  # fmt: skip
    for name in names:
        first, last = float(rows[0][f"std_{name}"]), float(rows[-1][f"std_{name}"])
        assert last > 0.9 * first, name
        assert abs(float(rows[-1][name])) < 3.0 * last


@pytest.mark.slow
def test_a_rig_that_turns_about_the_vertical_does_not_show_its_cameras_height(
    tmp_path: Path,
) -> None:
    """With one axis of rotation the lever arm along it drops out of all measurements."""
    t = np.arange(-1.0, 11.0, 0.05)
    yaw = 0.8 * np.sin(0.8 * t)
    p = np.stack([3.0 * t, np.sin(0.8 * t), np.zeros_like(t)], axis=-1)
    R = so3.exp(yaw[:, None] * [0.0, 0.0, 1.0])
    path = PoseSpline.through(ORIGIN_NS + np.round(1e9 * t).astype(np.int64), se3.make(R, p))
    simulation = FeatureSimulation(
        handheld_rig(), path, ORIGIN_NS + 100_000_000 * np.arange(95),
        ImuModel(200.0, EUROC_NOISE, np.full(3, 2e-3), np.full(3, 3e-2)),
        FeatureOptions(n_features=100),
    )  # fmt: skip
    settings = load_settings(None, ["calibration.extrinsics=true"])
    run_features(FeatureRecording(simulation, 2), settings, RunOptions(tmp_path / "out"))
    found = read_calibration(tmp_path / "out")
    assert found is not None
    shrunk = dict(zip(found.names, found.sigma[-1] / found.sigma[0], strict=True))
    assert shrunk["cam0_pose_z"] > 0.99
    assert shrunk["stereo_length"] > 0.9
    assert shrunk["cam0_pose_rx"] < 0.5
    assert shrunk["stereo_ry"] < 0.3
