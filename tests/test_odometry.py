"""The pipeline on painted images: order of events, the filter, given poses, refused matches."""

import itertools
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from ovmot import odometry as odometry_module
from ovmot.cameras.rig import StereoRig
from ovmot.errors import DatasetError, OvmotError
from ovmot.feature_table import FeatureTable, StereoHistory
from ovmot.frontend.stereo_tracker import StereoTracker
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.interfaces import Feedback
from ovmot.objects import moving_objects
from ovmot.objects.tracker import ObjectTracker
from ovmot.odometry import STAGES, Odometry, noise_in_use
from ovmot.physics import MEMS_NOISE
from ovmot.segmentation.segmentation import Segmentation, segment_points
from ovmot.settings import ObjectSettings, Settings
from ovmot.types import (
    Event,
    FrameResult,
    Health,
    ImuNoise,
    ImuSample,
    PointLabel,
    StereoFrame,
    StereoMatches,
)
from ovmot.vio import visual_update
from ovmot.vio.filter import MsckfFilter
from ovmot.vio.given_poses import GivenPoses, GivenPosesInitializer
from ovmot.vio.state import State

Pair = Callable[..., StereoFrame]
ORIGIN_NS = 1_500_000_000_000_000_000
NOISE = ImuNoise(1e-4, 1e-5, 1e-3, 1e-4)
REST_S = 0.7
SETTINGS = Settings.model_validate(
    {
        "tracker": {
            "max_features": 120, "fine_columns": 16, "fast_threshold": 12,
            "equalization": "none", "klt_window_px": 13, "klt_levels": 5,
        },
        "epipolar": {"threshold_px": 1.5, "scale": "angle"},
        "filter": {
            "max_clones": 6, "pixel_sigma": 0.5, "estimate_time_offset": False,
            "gravity_mps2": 9.81,
        },
        "initialization": {"window_s": 0.5},
        "segmentation": {"test": "covariance", "candidates": "tracked"},
        "noise": {"pixel_sigma": 0.3},
    }
)  # fmt: skip


def sideways(t: float) -> tuple[float, float]:
    """Position and acceleration along y, s after the origin: at rest, then off to the left."""
    tau = max(t - REST_S, 0.0)
    return 1.5 / np.pi * (tau - np.sin(np.pi * tau) / np.pi), 1.5 * np.sin(np.pi * tau)


def frames_of(pair: Pair, n: int, *, body_mps: float = 0.0, lift: int = 0) -> list[StereoFrame]:
    return [
        pair(ORIGIN_NS + 10**8 * i, sideways(0.1 * i)[0], body_mps * 0.1 * i, lift)
        for i in range(n)
    ]


def imu_of(seconds: float) -> list[ImuSample]:
    """200 Hz from 20 ms before the first frame, with a little noise."""
    rng = np.random.default_rng(0)
    out = []
    for k in range(-4, round(200 * seconds) + 1):
        accel = np.array([0.0, sideways(k / 200.0)[1], 9.81]) + rng.normal(0.0, 0.01, 3)
        stamp = ORIGIN_NS + 5_000_000 * k
        out.append(ImuSample(stamp, rng.normal(0.0, 1e-3, 3), accel))
    return out


def merged(frames: Sequence[StereoFrame], imu: Sequence[ImuSample]) -> list[Event]:
    """In time order, the IMU first where stamps are equal."""
    return sorted([*imu, *frames], key=lambda e: (e.timestamp_ns, isinstance(e, StereoFrame)))


def with_filter(rig: StereoRig) -> Odometry:
    return Odometry(rig, NOISE, SETTINGS)


def with_poses(
    rig: StereoRig, frames: Sequence[StereoFrame], settings: Settings = SETTINGS
) -> Odometry:
    stamps = np.array([f.timestamp_ns for f in frames])
    positions = [[0.0, sideways(1e-9 * (int(s) - ORIGIN_NS))[0], 0.0] for s in stamps]
    T = se3.make(np.broadcast_to(np.eye(3), (len(stamps), 3, 3)), np.array(positions))
    given = GivenPosesInitializer(GivenPoses(stamps, T, rig, settings.given_ego))
    return Odometry(rig, None, settings, initializer=given)


def run(odometry: Odometry, events: Sequence[Event]) -> list[FrameResult]:
    try:
        results = list(itertools.chain.from_iterable(odometry.add(event) for event in events))
        return results + odometry.finish()
    finally:
        odometry.close()


@pytest.fixture(scope="module")
def drive(painted_pair: Pair) -> tuple[list[StereoFrame], list[ImuSample]]:
    return frames_of(painted_pair, 20), imu_of(2.0)


@pytest.fixture(scope="module")
def driven(
    painted_rig: StereoRig, drive: tuple[list[StereoFrame], list[ImuSample]]
) -> list[FrameResult]:
    return run(with_filter(painted_rig), merged(*drive))


def test_the_filter_starts_at_rest_and_follows_the_motion(driven: list[FrameResult]) -> None:
    assert driven[0].timestamp_ns <= ORIGIN_NS + 700_000_000
    assert driven[0].ego.standing
    for before, after in itertools.pairwise(driven):
        assert after.timestamp_ns == before.timestamp_ns + 10**8
    last = driven[-1]
    assert last.timestamp_ns == ORIGIN_NS + 1_900_000_000
    assert not last.ego.standing
    truth = [0.0, sideways(1.9)[0], 0.0]
    np.testing.assert_allclose(last.ego.T_world_imu[:3, 3], truth, atol=0.03)
    np.testing.assert_allclose(last.ego.T_world_imu[:3, :3], np.eye(3), atol=0.01)
    assert (np.linalg.eigvalsh(last.ego.covariance) > 0.0).all()
    static = last.points.label == int(PointLabel.STATIC)
    assert static.sum() > 30
    assert not (last.points.label == int(PointLabel.DYNAMIC)).any()
    assert set(last.milliseconds) == set(STAGES) - {"initialize"}


def assert_same(a: Sequence[FrameResult], b: Sequence[FrameResult]) -> None:
    assert [r.timestamp_ns for r in a] == [r.timestamp_ns for r in b]
    for x, y in zip(a, b, strict=True):
        np.testing.assert_array_equal(x.ego.T_world_imu, y.ego.T_world_imu)
        np.testing.assert_array_equal(x.ego.covariance, y.ego.covariance)
        np.testing.assert_array_equal(x.points.pixels, y.points.pixels)
        np.testing.assert_array_equal(x.points.label, y.points.label)


def test_two_runs_are_equal_bit_for_bit(
    painted_rig: StereoRig, drive: tuple[list[StereoFrame], list[ImuSample]],
    driven: list[FrameResult],
) -> None:  # fmt: skip
    assert_same(run(with_filter(painted_rig), merged(*drive)), driven)


def test_two_threads_give_the_same_bits_and_each_result_at_once(
    painted_rig: StereoRig, drive: tuple[list[StereoFrame], list[ImuSample]],
    driven: list[FrameResult],
) -> None:  # fmt: skip
    called: list[FrameResult] = []
    odometry = Odometry(painted_rig, NOISE, SETTINGS, threads=2, on_result=called.append)
    results = run(odometry, merged(*drive))
    assert_same(results, driven)
    assert [id(r) for r in called] == [id(r) for r in results]
    assert odometry.finish() == []


def test_what_is_given_up_ends_the_threads(
    painted_rig: StereoRig, drive: tuple[list[StereoFrame], list[ImuSample]]
) -> None:
    odometry = Odometry(painted_rig, NOISE, SETTINGS, threads=2)
    for event in merged(*drive)[:150]:
        odometry.add(event)
    odometry.close()
    odometry.close()
    assert odometry.finish() == []
    assert not [t for t in threading.enumerate() if t.name.startswith("ovmot")]


def test_any_order_that_keeps_each_kind_in_time_gives_the_same(
    painted_rig: StereoRig, drive: tuple[list[StereoFrame], list[ImuSample]],
    driven: list[FrameResult],
) -> None:  # fmt: skip
    frames, imu = drive
    assert_same(run(with_filter(painted_rig), [*frames, *imu]), driven)
    events: list[Event] = [*imu, *frames]
    late = sorted(events, key=lambda e: e.timestamp_ns + 230_000_000 * isinstance(e, ImuSample))
    assert_same(run(with_filter(painted_rig), late), driven)


def test_a_frame_waits_for_its_imu(
    painted_rig: StereoRig, drive: tuple[list[StereoFrame], list[ImuSample]],
    driven: list[FrameResult],
) -> None:  # fmt: skip
    frames, imu = drive
    odometry = with_filter(painted_rig)
    for frame in frames:
        assert odometry.add(frame) == []
    when: dict[int, int] = {}
    for sample in imu:
        for result in odometry.add(sample):
            when[result.timestamp_ns] = sample.timestamp_ns
    odometry.finish()
    assert odometry.dropped == 0
    assert list(when) == [r.timestamp_ns for r in driven]
    for frame_ns, sample_ns in when.items():
        assert 0 <= sample_ns - frame_ns < 5_000_000 or frame_ns == driven[0].timestamp_ns


def test_frames_never_covered_are_counted(
    painted_rig: StereoRig, drive: tuple[list[StereoFrame], list[ImuSample]]
) -> None:
    frames, imu = drive
    end = frames[-3].timestamp_ns + 50_000_000
    odometry = with_filter(painted_rig)
    results = run(odometry, merged(frames, [s for s in imu if s.timestamp_ns <= end]))
    assert results[-1].timestamp_ns == frames[-3].timestamp_ns
    assert odometry.dropped == 2


def test_stamps_must_rise(
    painted_rig: StereoRig, drive: tuple[list[StereoFrame], list[ImuSample]]
) -> None:
    frames, imu = drive
    odometry = with_filter(painted_rig)
    odometry.add(frames[1])
    for late in (frames[0], frames[1]):
        with pytest.raises(DatasetError, match=f"frame stamp {late.timestamp_ns} does not follow"):
            odometry.add(late)
    odometry.add(imu[5])
    for sample in (imu[4], imu[5]):
        with pytest.raises(DatasetError, match=f"IMU stamp {sample.timestamp_ns} does not follow"):
            odometry.add(sample)
    odometry.finish()


def test_without_a_start_it_says_why(painted_rig: StereoRig, painted_pair: Pair) -> None:
    odometry = with_filter(painted_rig)
    shaken = [ImuSample(s.timestamp_ns, s.gyro, s.accel * (1.0 + 0.2 * (i % 2)))
              for i, s in enumerate(imu_of(0.7))]  # fmt: skip
    assert run(odometry, merged(frames_of(painted_pair, 7), shaken)) == []
    assert "accelerometer varies" in str(odometry.not_started_because)


def test_given_poses_need_no_imu_and_find_the_moving_body(
    painted_rig: StereoRig, painted_pair: Pair
) -> None:
    frames = frames_of(painted_pair, 14, body_mps=1.5)
    results = run(with_poses(painted_rig, frames), frames)
    assert len(results) == 14
    for frame, result in zip(frames, results, strict=True):
        assert result.timestamp_ns == frame.timestamp_ns
        y = sideways(1e-9 * (frame.timestamp_ns - ORIGIN_NS))[0]
        np.testing.assert_allclose(result.ego.T_world_imu[:3, 3], [0.0, y, 0.0], atol=1e-12)
    last = results[-1].points
    t = 1.3
    u = 120.0 + 200.0 * (sideways(t)[0] - 1.5 * t) / 6.0
    inside = (
        (np.abs(last.pixels[:, 0] - u - 40.0) < 36.0) & (np.abs(last.pixels[:, 1] - 120.0) < 36.0)
    )  # fmt: skip
    outside = (np.abs(last.pixels[:, 0] - u - 40.0) > 50.0) | (
        np.abs(last.pixels[:, 1] - 120.0) > 50.0
    )
    dynamic = last.label == int(PointLabel.DYNAMIC)
    judged = last.label != int(PointLabel.UNKNOWN)
    assert (inside & judged).sum() >= 4
    assert dynamic[inside & judged].mean() > 0.8
    assert dynamic[outside & judged].mean() < 0.05


def test_without_objects_nothing_is_grouped_and_nowhere_is_looked_closer(
    painted_rig: StereoRig, painted_pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(*_: object) -> None:
        raise AssertionError("called without objects")

    monkeypatch.setattr(moving_objects, "measure_objects", never)
    monkeypatch.setattr(ObjectTracker, "step", never)
    frames = frames_of(painted_pair, 8, body_mps=1.5)
    off = SETTINGS.model_copy(update={"objects": ObjectSettings(enabled=False)})
    odometry = with_poses(painted_rig, frames, off)
    looked: list[FloatArray] = []
    true_track = StereoTracker.track

    def track(tracker: StereoTracker, frame: StereoFrame, T: FloatArray, feedback: Feedback) -> Any:
        looked.extend([feedback.focus_uv, feedback.focus_radius_px])
        return true_track(tracker, frame, T, feedback)

    monkeypatch.setattr(StereoTracker, "track", track)
    results = run(odometry, frames)
    assert (results[-1].points.label == int(PointLabel.DYNAMIC)).any()
    assert all(result.tracks == () for result in results)
    assert all((result.points.track_id == -1).all() for result in results)
    assert looked
    assert all(len(array) == 0 for array in looked)


def test_no_update_ever_uses_a_feature_once_it_was_found_to_move(
    painted_rig: StereoRig, painted_pair: Pair, spy: "UpdateSpy"
) -> None:
    frames = frames_of(painted_pair, 20, body_mps=1.5)
    odometry = with_filter(painted_rig)
    gone: set[tuple[float, ...]] = set()
    history: dict[int, set[tuple[float, ...]]] = {}
    n_dynamic = 0
    for event in merged(frames, imu_of(2.0)):
        spy.pixels.clear()
        for result in odometry.add(event):
            points = result.points
            for feature, uv in zip(points.feature_id.tolist(), points.pixels.tolist(), strict=True):
                history.setdefault(feature, set()).add(tuple(uv[:2]))
            moving = points.feature_id[points.label == int(PointLabel.DYNAMIC)].tolist()
            n_dynamic += len(moving)
            for feature in moving:
                gone |= history[feature]
            assert not {row[:2] for row in spy.rows()} & gone
    odometry.finish()
    assert n_dynamic > 30
    assert spy.calls > 3


@dataclass
class UpdateSpy:
    """The pixels that the filter was given, and how often it was."""

    pixels: list[FloatArray]
    calls: int = 0

    def rows(self) -> list[tuple[float, ...]]:
        """All observations (u, v, u_right, v_right), those of the left camera alone too."""
        every = [tuple(r) for p in self.pixels for r in p.reshape(-1, 4).tolist()]
        return [row for row in every if np.isfinite(row[0])]


@pytest.fixture
def spy(monkeypatch: pytest.MonkeyPatch) -> UpdateSpy:
    """Sits in the doors through which features enter the filter."""
    seen = UpdateSpy([])

    def watch(name: str, position: int) -> None:
        function = getattr(visual_update, name)

        def update(*arguments: object) -> object:
            seen.pixels.append(np.asarray(arguments[position]))
            seen.calls += 1
            return function(*arguments)

        monkeypatch.setattr(visual_update, name, update)

    for name, position in (
        ("msckf_update", 3),
        ("update_slam_features", 3),
    ):
        watch(name, position)
    return seen


def test_a_refused_right_observation_never_reaches_the_filter(
    painted_rig: StereoRig, painted_pair: Pair, spy: UpdateSpy, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Part of the right image stands 3 px too high: its matches break the epipolar constraint.

    None of them is in a result, in the track table or in what the filter is given, in no frame;
    their left halves are.
    """
    tables: list[FeatureTable] = []
    true_update = MsckfFilter.update

    def update(ego: MsckfFilter, table: FeatureTable, history: StereoHistory) -> object:
        tables.append(table)
        return true_update(ego, table, history)

    monkeypatch.setattr(MsckfFilter, "update", update)
    frames = frames_of(painted_pair, 20, lift=3)
    odometry = with_filter(painted_rig)
    tested = _spy_on_matches(monkeypatch)
    results = run(odometry, merged(frames, imu_of(2.0)))
    pairs = [tuple(row) for m in tested for row in m.pixels[~m.accepted].tolist()]
    accepted = {tuple(row) for m in tested for row in m.pixels[m.accepted].tolist()}
    refused_right = {row[2:] for row in pairs}
    refused_left = {row[:2] for row in pairs}
    assert len(refused_right) > 60
    assert len(tested) == 20

    in_results = {tuple(row[2:]) for r in results for row in r.points.pixels.tolist()}
    assert not refused_right & in_results
    in_tables = {tuple(row[2:]) for t in tables for row in t.pixels.reshape(-1, 4).tolist()}
    assert not refused_right & in_tables
    in_planes = {tuple(row[2:]) for t in tables for row in t.normalized.reshape(-1, 4).tolist()}
    plane = {
        tuple(xy) for xy in painted_rig.cam1.normalize(np.array(sorted(refused_right))).tolist()
    }
    assert not plane & in_planes

    given = spy.rows()
    assert len(given) > 100
    for row in given:
        assert row[2:] not in refused_right
        assert not np.isfinite(row[2]) or row in accepted
    mono = {row[:2] for row in given if not np.isfinite(row[2])}
    assert len(mono & refused_left) > 5  # the left half lives on and helps the filter
    lifted = [p.p_cam0 for r in results for p in (r.points,)]
    assert all(
        np.isnan(p[~np.isfinite(r.points.pixels[:, 2])]).all()
        for p, r in zip(lifted, results, strict=True)
    )


def _spy_on_matches(monkeypatch: pytest.MonkeyPatch) -> list[StereoMatches]:
    """The `StereoMatches` of every frame, also of those before the start."""
    tested: list[StereoMatches] = []
    true_track = StereoTracker.track

    def track(
        tracker: StereoTracker, frame: StereoFrame, T: FloatArray, feedback: Feedback
    ) -> object:
        seen, matches = true_track(tracker, frame, T, feedback)
        tested.append(matches)
        return seen, matches

    monkeypatch.setattr(StereoTracker, "track", track)
    return tested


@pytest.mark.parametrize(
    "failure",
    [np.linalg.LinAlgError("17-th leading minor not positive definite"),
     ValueError("array must not contain infs or NaNs"), FloatingPointError("overflow")],
)  # fmt: skip
def test_a_numerical_failure_names_the_frame(
    painted_rig: StereoRig, drive: tuple[list[StereoFrame], list[ImuSample]],
    monkeypatch: pytest.MonkeyPatch, failure: Exception,
) -> None:  # fmt: skip
    frames, imu = drive

    def fail(*_: object, **__: object) -> State:
        raise failure

    monkeypatch.setattr(visual_update, "msckf_update", fail)
    odometry = with_filter(painted_rig)
    done: list[FrameResult] = []
    with pytest.raises(OvmotError) as caught:
        for event in merged(frames, imu):
            done += odometry.add(event)
    odometry.finish()
    assert len(done) >= 1
    stamp = done[-1].timestamp_ns + 10**8
    assert str(caught.value) == f"the estimate broke down at frame {stamp} ns: {failure}"


@pytest.mark.parametrize("offset_s", [-1.5, 0.3])
def test_a_large_known_time_offset_changes_nothing(
    painted_rig: StereoRig,
    drive: tuple[list[StereoFrame], list[ImuSample]],
    driven: list[FrameResult],
    offset_s: float,
) -> None:
    frames, imu = drive
    shift = round(1e9 * offset_s)
    late = [replace(sample, timestamp_ns=sample.timestamp_ns + shift) for sample in imu]
    results = run(with_filter(replace(painted_rig, time_offset_s=offset_s)), merged(frames, late))
    assert [r.timestamp_ns for r in results] == [r.timestamp_ns for r in driven]
    for shifted, plain in zip(results, driven, strict=True):
        np.testing.assert_allclose(shifted.ego.T_world_imu, plain.ego.T_world_imu, atol=1e-9)


def test_the_imu_does_not_pile_up_before_a_start(
    painted_rig: StereoRig, painted_pair: Pair
) -> None:
    restless = replace_settings(rest_gyro_rps=1e-9, motion_window_s=1.2)
    odometry = Odometry(painted_rig, NOISE, restless)
    still = [painted_pair(ORIGIN_NS + 10**9 * i, 0.0, 0.0, 0) for i in range(8)]  # too seldom
    imu = [ImuSample(ORIGIN_NS + 5_000_000 * k, np.zeros(3), np.array([0.0, 0.0, 9.81]))
           for k in range(1600)]  # fmt: skip
    assert run(odometry, merged(still, imu)) == []
    assert "static initialization" in str(odometry.not_started_because)
    frames_begun_after_what_is_known_s = 2.0
    kept_s = 1.44 + 0.5 + 1.0 + 2.5 + frames_begun_after_what_is_known_s
    assert len(odometry._imu) < 200 * kept_s


def test_where_the_prediction_is_unsure_nothing_is_barred_for_good(
    painted_rig: StereoRig,
    drive: tuple[list[StereoFrame], list[ImuSample]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:

    def panic(*arguments: object) -> Segmentation:
        split = segment_points(*arguments)  # type: ignore[arg-type]
        label = np.full_like(split.points.label, int(PointLabel.DYNAMIC))
        return Segmentation(replace(split.points, label=label), ~(label == 0), trusted=False)

    monkeypatch.setattr(odometry_module, "segment_points", panic)
    odometry = with_filter(painted_rig)
    results = run(odometry, merged(*drive))
    assert len(results) > 5
    assert odometry.counts["frames_split_unsure"] >= len(results)
    assert not odometry._table.dynamic.any()
    assert odometry._table.outlier.any()


def replace_settings(**initialization: float) -> Settings:
    changed = SETTINGS.initialization.model_copy(update=initialization)
    return SETTINGS.model_copy(update={"initialization": changed})


def test_a_lost_filter_starts_again_where_it_was(
    painted_rig: StereoRig, painted_pair: Pair, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the twelfth frame the filter says that it is lost: the next segment begins at its pose."""
    frames = frames_of(painted_pair, 12)
    stand = [replace(frames[-1], timestamp_ns=ORIGIN_NS + 10**8 * i) for i in range(12, 34)]
    imu = imu_of(1.3)
    rng = np.random.default_rng(4)
    still = [
        ImuSample(
            ORIGIN_NS + 5_000_000 * k,
            rng.normal(0.0, 1e-3, 3),
            np.array([0.0, 0.0, 9.81]) + rng.normal(0.0, 0.01, 3),
        )
        for k in range(round(200 * 1.3) + 1, 200 * 4)
    ]
    lost_ns = frames[11].timestamp_ns
    true_health = MsckfFilter.health
    monkeypatch.setattr(
        MsckfFilter,
        "health",
        lambda ego, ns: Health.LOST if ns == lost_ns else true_health(ego, ns),
    )
    odometry = with_filter(painted_rig)
    results = run(odometry, merged([*frames, *stand], [*imu, *still]))
    lost = next(r for r in results if r.timestamp_ns == lost_ns)
    after = [r for r in results if r.timestamp_ns > lost_ns]
    assert lost.ego.health == Health.LOST
    assert lost.segment == 0
    assert len(after) > 5
    assert {r.segment for r in after} == {1}
    assert {r.ego.health for r in after} == {Health.TRACKING}
    np.testing.assert_allclose(
        after[0].ego.T_world_imu[:3, 3], lost.ego.T_world_imu[:3, 3], atol=0.02
    )
    assert odometry.counts["resets"] == odometry.counts["frames_lost"] == 1
    assert odometry.latest() is not None
    assert len({r.timestamp_ns for r in results}) == len(results)


def test_noise_of_the_imu_settings_before_data_before_a_usual_unit() -> None:
    data = ImuNoise(1.0, 2.0, 3.0, 4.0)
    given = Settings.model_validate({"imu": {"gyro_walk": 0.5}}).imu
    assert noise_in_use(data, given) == ImuNoise(1.0, 0.5, 3.0, 4.0)
    unknown = noise_in_use(None, Settings().imu)
    assert unknown == ImuNoise(*MEMS_NOISE)
    assert noise_in_use(None, given).gyro_walk == 0.5
