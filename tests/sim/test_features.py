"""Simulated features are the projections of points at rest, or of bodies, with the noise asked."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.datasets.pose_files import write_tum
from ovmot.errors import InputError
from ovmot.frontend.given_features import GivenFeatures
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.geometry.triangulation import triangulate_stereo
from ovmot.interfaces import no_feedback
from ovmot.settings import Settings
from ovmot.sim.features import (
    FeatureBody,
    FeatureOptions,
    FeatureRecording,
    FeatureSimulation,
    ObservedFrame,
)
from ovmot.sim.handheld import EUROC_NOISE, ORIGIN_NS, handheld_rig, handheld_simulation
from ovmot.sim.paths import standing_path
from ovmot.sim.simulation import ImuModel
from ovmot.types import FeatureFrame, ImuSample

NO_NOISE = FeatureOptions(n_features=120, pixel_sigma=0.0)


def path_of(seconds: float) -> PoseSpline:
    """A gentle walk with turns, long enough for margins around `seconds`."""
    t = np.arange(-1.0, seconds + 1.1, 0.05)
    R = so3.exp(np.stack([0.1 * np.sin(t), 0.6 * np.sin(0.7 * t), 0.1 * np.cos(t)], axis=-1))
    p = np.stack([1.2 * t, 0.3 * np.sin(t), 0.1 * np.sin(3.0 * t)], axis=-1)
    return PoseSpline.through(ORIGIN_NS + np.round(1e9 * t).astype(np.int64), se3.make(R, p))


def simulation_of(
    options: FeatureOptions,
    seconds: float = 3.0,
    rig: StereoRig | None = None,
    bodies: tuple[FeatureBody, ...] = (),
) -> FeatureSimulation:
    stamps = ORIGIN_NS + 100_000_000 * np.arange(round(10 * seconds), dtype=np.int64)
    imu = ImuModel(200.0, EUROC_NOISE, np.zeros(3), np.zeros(3))
    return FeatureSimulation(
        rig or handheld_rig(), path_of(seconds), stamps, imu, options, bodies
    )  # fmt: skip


def with_model(model: str) -> StereoRig:
    coefficients = {"equidistant": [0.02, -0.01, 0.004, -0.001], "none": []}[model]
    camera = Camera.make((640, 480), (300.0, 300.0), (319.5, 239.5), model, coefficients)
    return replace(handheld_rig(), cam0=camera, cam1=camera)


def points_in_world(simulation: FeatureSimulation, seen: ObservedFrame) -> FloatArray:
    """Stereo points (N, 3) of a frame in world, NaN without a right half."""
    rig, pixels = simulation.rig, seen.frame.pixels
    normalized = np.concatenate(
        [rig.cam0.normalize(pixels[:, :2]), rig.cam1.normalize(pixels[:, 2:])], axis=1
    )
    T_world_cam0 = simulation.path.pose(seen.frame.timestamp_ns) @ rig.T_imu_cam0
    return se3.apply(T_world_cam0, triangulate_stereo(normalized, rig.T_cam1_cam0))


def turned_apart() -> StereoRig:
    """A rig whose camera model folds over what its right camera, looking aside, does not see."""
    camera = Camera.make((752, 480), (458.0, 458.0), (375.5, 239.5), "radtan", [-0.3, 0, 0, 0])
    rig = replace(handheld_rig(), cam0=camera, cam1=camera)
    turn = se3.make(so3.exp(np.array([0.0, 0.8, 0.0])), np.zeros(3))
    return replace(rig, T_imu_cam1=rig.T_imu_cam1 @ turn)


@pytest.mark.parametrize(
    "rig",
    [handheld_rig(), with_model("equidistant"), with_model("none"), turned_apart()],
    ids=["radtan", "equidistant", "none", "turned apart"],
)
def test_without_noise_every_feature_is_one_point_at_rest(rig: StereoRig) -> None:
    simulation = simulation_of(NO_NOISE, rig=rig)
    first_seen: dict[int, FloatArray] = {}
    compared = 0
    for seen in FeatureRecording(simulation, 1).frames():
        points = points_in_world(simulation, seen)
        for feature_id, point in zip(seen.frame.feature_id.tolist(), points, strict=True):
            if np.isfinite(point[0]):
                earlier = first_seen.setdefault(feature_id, point)
                np.testing.assert_allclose(point, earlier, atol=1e-6)
                compared += earlier is not point
    assert compared > 1000


def test_it_keeps_the_asked_number_of_features_at_the_asked_depth() -> None:
    options = replace(NO_NOISE, depth_m=(4.0, 9.0))
    simulation = simulation_of(options)
    for seen in FeatureRecording(simulation, 1).frames():
        assert 0.9 * options.n_features <= len(seen.frame.feature_id) <= options.n_features
        T_cam0_world = se3.inverse(
            simulation.path.pose(seen.frame.timestamp_ns) @ simulation.rig.T_imu_cam0
        )
        depth = se3.apply(T_cam0_world, points_in_world(simulation, seen))[:, 2]
        assert np.nanmax(depth) <= 9.0 + 1e-6
        assert np.isfinite(depth).mean() > 0.7  # the right camera sees most of them


def test_a_feature_lost_from_view_comes_back_under_another_id() -> None:
    ids = [set(s.frame.feature_id.tolist()) for s in FeatureRecording(
        simulation_of(NO_NOISE, seconds=8.0), 1
    ).frames()]  # fmt: skip
    lost: set[int] = set()
    for before, now in pairwise(ids):
        assert not now & lost
        lost |= before - now
    assert len(lost) > 100


def test_pixel_noise_is_white_and_of_the_asked_size() -> None:
    options = FeatureOptions(n_features=200, pixel_sigma=0.7)
    simulation = simulation_of(options)
    exact = FeatureRecording(replace(simulation, options=replace(options, pixel_sigma=0.0)), 1)
    errors = []
    for noisy, true in zip(
        FeatureRecording(simulation, 1).frames(), exact.frames(), strict=True
    ):  # fmt: skip
        _, i, j = np.intersect1d(noisy.frame.feature_id, true.frame.feature_id, return_indices=True)
        errors.append(noisy.frame.pixels[i] - true.frame.pixels[j])
    e = np.concatenate(errors)
    assert np.isfinite(e).sum() > 10_000
    np.testing.assert_allclose(np.nanstd(e, axis=0), 0.7, rtol=0.05)
    np.testing.assert_allclose(np.nanmean(e, axis=0), 0.0, atol=0.03)


def test_wrong_matches_come_at_the_asked_rate_and_the_gate_refuses_most() -> None:
    options = FeatureOptions(n_features=200, pixel_sigma=0.3, wrong_match_share=0.3)
    simulation = simulation_of(options)
    settings = Settings()
    frontend = GivenFeatures(simulation.rig, settings.tracker, settings.epipolar)
    wrong_seen = wrong_kept = right_seen = right_kept = 0
    for seen in FeatureRecording(simulation, 3).frames():
        _, matches = frontend.track(seen.frame, np.eye(4), no_feedback(simulation.rig))
        _, i, j = np.intersect1d(seen.frame.feature_id, matches.feature_id, return_indices=True)
        wrong = seen.wrong_match[i]
        wrong_seen += int(wrong.sum())
        right_seen += int((~wrong).sum())
        wrong_kept += int((wrong & matches.accepted[j]).sum())
        right_kept += int((~wrong & matches.accepted[j]).sum())
    assert 0.25 < wrong_seen / (wrong_seen + right_seen) < 0.4  # stray ones are always in view
    assert wrong_kept < 0.03 * wrong_seen
    assert right_kept > 0.99 * right_seen


def test_swapped_tracks_go_on_at_another_point() -> None:
    simulation = simulation_of(replace(NO_NOISE, swapped_track_share=0.1))
    where: dict[int, FloatArray] = {}
    followed = jumped = 0
    for seen in FeatureRecording(simulation, 2).frames():
        points = points_in_world(simulation, seen)
        for feature_id, point, swapped in zip(
            seen.frame.feature_id.tolist(), points, seen.swapped, strict=True
        ):
            before = where.pop(feature_id, None)
            if np.isfinite(point[0]):
                where[feature_id] = point
                if before is not None:
                    assert (np.linalg.norm(point - before) > 1e-3) == swapped
                    followed += 1
                    jumped += int(swapped)
    assert 0.07 < jumped / followed < 0.13


@pytest.mark.parametrize(
    ("options", "problem"),
    [
        ({"n_features": 0}, "n_features"),
        ({"pixel_sigma": -1.0}, "pixel_sigma"),
        ({"depth_m": (7.0, 5.0)}, "depth_m"),
        ({"wrong_match_share": 1.5}, "shares"),
        ({"swapped_track_share": float("nan")}, "shares"),
    ],
)
def test_options_that_mean_nothing_are_refused(options: dict[str, Any], problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        FeatureOptions(**options)


def test_a_body_moves_as_its_path_does() -> None:
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    ahead = se3.make(np.eye(3), np.array([2.0, 0.0, 6.0]))
    times = path_of(3.0)
    standing = standing_path(ahead, ORIGIN_NS, 3.0)
    drift = PoseSpline.through(
        np.linspace(times.start_ns, times.end_ns, 40).astype(np.int64),
        ahead @ se3.make(np.broadcast_to(np.eye(3), (40, 3, 3)),
                         np.linspace((0, 0, 0), (3.0, 0, 0), 40)),
    )  # fmt: skip
    bodies = (FeatureBody(1, standing, corners), FeatureBody(2, drift, corners))
    simulation = simulation_of(NO_NOISE, bodies=bodies)
    compared = np.zeros(3, dtype=np.int64)
    for seen in FeatureRecording(simulation, 1).frames():
        points = points_in_world(simulation, seen)
        for body in bodies:
            mine = (seen.object_id == body.object_id) & np.isfinite(points[:, 0])
            true = se3.apply(body.path.pose(seen.frame.timestamp_ns), corners)
            for point in points[mine]:
                assert np.linalg.norm(true - point, axis=1).min() < 1e-6
            compared[body.object_id] += mine.sum()
    assert compared[1] > 50
    assert compared[2] > 50


def test_events_are_in_order_and_the_same_for_a_seed() -> None:
    simulation = simulation_of(FeatureOptions(n_features=50), seconds=1.0)
    first = list(FeatureRecording(simulation, 5).events())
    again = list(FeatureRecording(simulation, 5).events())
    other = list(FeatureRecording(simulation, 6).events())
    stamps = [event.timestamp_ns for event in first]
    assert stamps == sorted(stamps)
    frames = [event for event in first if isinstance(event, FeatureFrame)]
    assert [frame.timestamp_ns for frame in frames] == simulation.camera_ns.tolist()
    samples = [event for event in first if isinstance(event, ImuSample)]
    assert samples[0].timestamp_ns < frames[0].timestamp_ns
    assert samples[-1].timestamp_ns > frames[-1].timestamp_ns
    for a, b in zip(first, again, strict=True):
        if isinstance(a, FeatureFrame) and isinstance(b, FeatureFrame):
            np.testing.assert_array_equal(a.pixels, b.pixels)
        elif isinstance(a, ImuSample) and isinstance(b, ImuSample):
            np.testing.assert_array_equal(a.gyro, b.gyro)
    samples_of_other = [event for event in other if isinstance(event, ImuSample)]
    assert np.any(samples[0].gyro != samples_of_other[0].gyro)


def test_mono_frames_have_no_right_half() -> None:
    simulation = simulation_of(FeatureOptions(n_features=50, stereo=False), seconds=0.5)
    for seen in FeatureRecording(simulation, 1).frames():
        assert np.isnan(seen.frame.pixels[:, 2:]).all()
        assert np.isfinite(seen.frame.pixels[:, :2]).all()


def test_a_recorded_walk(tmp_path: Path) -> None:
    t = np.arange(0.0, 8.0, 0.05)
    R = so3.exp(np.stack([0.1 * np.sin(t), 0.3 * np.sin(0.7 * t), 0.2 * np.cos(t)], axis=-1))
    p = np.stack([1.2 * t, 0.4 * np.sin(t), 0.1 * np.sin(3.0 * t)], axis=-1)
    write_tum(tmp_path / "walk.txt", np.round(1e9 * t).astype(np.int64), se3.make(R, p))
    assert_recorded(tmp_path / "walk.txt")


def test_a_real_walk(data_root: Path) -> None:
    recording = data_root / "sim_paths" / "udel_gore.txt"
    if not recording.exists():
        pytest.skip(f"{recording} is missing")
    assert_recorded(recording)


def assert_recorded(file: Path) -> None:
    """Its features are those of 5 s of the recorded path, at 10 Hz."""
    simulation = handheld_simulation(file, FeatureOptions(), duration_s=5.0)
    assert len(simulation.camera_ns) == 51
    truth = FeatureRecording(simulation, 0).truth()
    np.testing.assert_array_equal(truth.timestamp_ns, simulation.camera_ns)
    np.testing.assert_array_equal(truth.T_world_imu, simulation.path.pose(simulation.camera_ns))
    assert np.all(truth.gyro_bias[-1] != 0.0)  # it walks
