"""Segmentation of a frame, through the feature table, as the odometry calls it."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable, append_frame, empty_table
from ovmot.geometry import se3
from ovmot.geometry.arrays import AnyArray, BoolArray, FloatArray
from ovmot.segmentation.segmentation import Segmentation, segment_points
from ovmot.segmentation.stereo_history import stereo_history
from ovmot.settings import SegmentationSettings
from ovmot.types import FrontendFrame, PixelNoise, PointLabel, PoseWindow

STATIC, DYNAMIC, UNKNOWN = int(PointLabel.STATIC), int(PointLabel.DYNAMIC), int(PointLabel.UNKNOWN)
SETTINGS = SegmentationSettings(
    enabled=True, candidates="tracked", test="covariance", max_range_m=60.0, false_alarm=1e-4,
    forgiven_speed_mps=0.15,
    distance_threshold_m=0.25,
    depth_weight=0.3, reprojection_threshold_px=3.0, combine="any",
)  # fmt: skip
NOISE = PixelNoise(0.4, 0.4, 0.0, 0.0)
N_CAR, N_REST = 6, 60
Make = Callable[..., FloatArray]


def changed(**updates: object) -> SegmentationSettings:
    return SETTINGS.model_copy(update=updates)


@dataclass(frozen=True)
class Recording:
    """What was seen on the way: the newest frame is the table's last row."""

    table: FeatureTable
    seen: FrontendFrame
    window: PoseWindow
    rig: StereoRig

    def segmented(self, settings: SegmentationSettings = SETTINGS) -> Segmentation:
        history = stereo_history(
            self.table, self.seen.feature_id, self.window.timestamp_ns, self.rig,
            settings.look_back_s, NOISE,
        )  # fmt: skip
        return segment_points(self.table, history, self.seen, self.window, self.rig, settings)

    def with_verdict(self, inlier: BoolArray) -> "Recording":
        return replace(self, seen=replace(self.seen, two_view_inlier=inlier))


def record(
    rig: StereoRig, T: FloatArray, window: PoseWindow, normalized: FloatArray
) -> tuple[FeatureTable, FrontendFrame]:
    """A table of the frames (K, N, 4) and the last frame."""
    pixels = np.concatenate(
        [rig.cam0.denormalize(normalized[..., :2]), rig.cam1.denormalize(normalized[..., 2:])], -1
    )
    n = normalized.shape[1]
    table = empty_table()
    for k, stamp in enumerate(window.timestamp_ns.tolist()):
        # ids in another order in every frame, as nothing promises one
        order = np.roll(np.arange(n), k)
        seen = FrontendFrame(
            stamp, 100 + order, pixels[k, order], normalized[k, order],
            np.full(n, k), np.ones(n, dtype=np.bool_),
        )  # fmt: skip
        table = append_frame(table, seen)
    return table, seen


def in_order(split: Segmentation, values: AnyArray | None = None) -> AnyArray:
    """Labels (or other values) by feature id."""
    order = np.argsort(split.points.feature_id)
    return np.asarray((split.points.label if values is None else values)[order])


@pytest.fixture
def world(
    rig: StereoRig, drive: Make, measure: Make, in_view: Make, window_of: Callable[..., PoseWindow]
) -> Callable[..., Recording]:
    """The first six points are a body 12 m ahead that crosses at `speed`; the rest rests."""

    def make(
        speed: float = 3.0, n_frames: int = 12, rig_speed: float = 6.0, sigma_px: float = 0.4,
        depth: float = 12.0,
    ) -> Recording:  # fmt: skip
        T, rng = drive(n_frames, rig_speed), np.random.default_rng(0)
        T = T if rig_speed else np.repeat(T[:1], n_frames, axis=0)
        body = np.column_stack(
            [rng.uniform(-0.8, 0.8, N_CAR), rng.uniform(-0.5, 0.5, N_CAR), np.full(N_CAR, depth)]
        )
        p = se3.apply(T[-1] @ rig.T_imu_cam0, body)
        p = np.concatenate([p, in_view(rig, T, N_REST, (20.0, 35.0), rng)])
        age = 0.1 * np.arange(n_frames - 1, -1, -1.0)
        path = np.repeat(p[None], n_frames, axis=0)
        path[:, :N_CAR, 1] -= speed * age[:, None]
        window = window_of(T)
        table, seen = record(rig, T, window, measure(rig, T, path, sigma_px, rng))
        return Recording(table, seen, window, rig)

    return make


def test_the_moving_body_is_dynamic_and_the_rest_static(world: Callable[..., Recording]) -> None:
    split = world().segmented()
    label = in_order(split)
    assert label[:N_CAR].tolist() == [DYNAMIC] * N_CAR
    assert (label[N_CAR:] == STATIC).mean() > 0.97
    outlier = in_order(split, split.outlier)
    assert outlier[:N_CAR].all()
    assert (outlier == (label != STATIC)).all()
    assert (split.points.track_id == -1).all()
    assert split.points.feature_id.tolist() == world().seen.feature_id.tolist()


def test_the_rows_say_what_was_compared(world: Callable[..., Recording], rig: StereoRig) -> None:
    """Exact pixels: the prediction of a resting point is where it is, previous where it was."""
    recording = world(sigma_px=0.0)
    split = recording.segmented()
    points, order = split.points, np.argsort(split.points.feature_id)
    rest = order[N_CAR:]
    np.testing.assert_allclose(points.predicted[rest], points.pixels[rest, :2], atol=1e-6)
    assert points.distance_m[rest].max() < 1e-6
    assert points.reprojection_px[rest].max() < 1e-6
    before = recording.table.pixels[-2]
    columns = [recording.table.feature_id.tolist().index(i) for i in points.feature_id]
    np.testing.assert_array_equal(points.previous, before[columns, :2])
    # the body went 0.3 m to the left of the world in the last 0.1 s
    T_world_cam = recording.window.T_world_imu[-1] @ rig.T_imu_cam0
    moved = np.array([0.0, 0.3, 0.0]) @ T_world_cam[:3, :3]
    body = order[:N_CAR]
    expected = np.linalg.norm(moved * (1.0, 1.0, SETTINGS.depth_weight))
    np.testing.assert_allclose(points.distance_m[body], expected, rtol=1e-6)
    off = np.linalg.norm(points.predicted[body] - points.pixels[body, :2], axis=1)
    assert (points.reprojection_px[body] >= off - 1e-6).all()
    np.testing.assert_allclose(points.reprojection_px[body], off, rtol=0.05)


def test_depth_is_weighted_down(world: Callable[..., Recording]) -> None:
    recording = world()
    whole = recording.segmented(changed(depth_weight=1.0)).points.distance_m
    light = recording.segmented(changed(depth_weight=0.0)).points.distance_m
    assert (light <= whole).all()
    assert np.median(light) < 0.5 * np.median(whole)


def test_fixed_thresholds_and_their_combination(world: Callable[..., Recording]) -> None:
    """0.3 m in the last interval at 12 m, i.e. 10 px: both thresholds are passed or one."""
    recording = world(sigma_px=0.01)

    def found(**settings: object) -> int:
        label = in_order(recording.segmented(changed(test="fixed", **settings)))
        assert (label[N_CAR:] == STATIC).all()
        return int((label[:N_CAR] == DYNAMIC).sum())

    assert found() == N_CAR
    assert found(distance_threshold_m=1.0) == N_CAR
    assert found(distance_threshold_m=1.0, combine="all") == 0
    assert found(reprojection_threshold_px=20.0) == N_CAR
    assert found(reprojection_threshold_px=20.0, combine="all") == 0
    assert found(combine="all") == N_CAR
    assert found(distance_threshold_m=1.0, reprojection_threshold_px=20.0) == 0


@pytest.mark.parametrize("test", ["covariance", "fixed"])
def test_among_ransac_candidates_what_the_two_view_test_accepted_is_static(
    world: Callable[..., Recording], test: str
) -> None:
    recording = world(sigma_px=0.1)
    inlier = np.isin(recording.seen.feature_id, (100, 101, 102))  # half of the body
    inlier |= recording.seen.feature_id >= 100 + N_CAR
    label = in_order(
        recording.with_verdict(inlier).segmented(changed(test=test, candidates="ransac"))
    )
    assert label[:3].tolist() == [STATIC] * 3
    assert label[3:N_CAR].tolist() == [DYNAMIC] * 3
    tracked = in_order(recording.with_verdict(inlier).segmented(changed(test=test)))
    assert tracked[:N_CAR].tolist() == [DYNAMIC] * N_CAR


def test_a_point_at_rest_is_static_though_the_two_view_test_rejected_it(
    world: Callable[..., Recording],
) -> None:
    recording = world(sigma_px=0.1).with_verdict(np.zeros(N_CAR + N_REST, dtype=np.bool_))
    split = recording.segmented()
    assert (in_order(split)[N_CAR:] == STATIC).all()
    assert not in_order(split, split.outlier)[N_CAR:].any()
    assert not split.points.two_view_inlier.any()


def test_far_points_are_not_judged(world: Callable[..., Recording]) -> None:
    label = in_order(world().segmented(changed(max_range_m=15.0)))
    assert (label[:N_CAR] == DYNAMIC).all()
    assert (label[N_CAR:] == UNKNOWN).all()


def test_points_seen_by_one_camera_are_unknown_and_suspect_only_if_rejected(
    world: Callable[..., Recording],
) -> None:
    recording = world()
    mono = recording.seen.feature_id >= 100 + N_CAR + 30
    normalized = np.where(mono[:, None] & (np.arange(4) >= 2), np.nan, recording.seen.normalized)
    inlier = recording.seen.feature_id < 100 + N_CAR + 45
    seen = replace(recording.seen, normalized=normalized, two_view_inlier=inlier)
    in_table = recording.table.normalized.copy()
    in_table[-1, recording.table.columns(seen.feature_id)] = normalized
    table = replace(recording.table, normalized=in_table)
    split = replace(recording, seen=seen, table=table).segmented()
    label, outlier = in_order(split), in_order(split, split.outlier)
    assert (label[N_CAR + 30 :] == UNKNOWN).all()
    assert not outlier[N_CAR + 30 : N_CAR + 45].any()
    assert outlier[N_CAR + 45 :].all()
    assert np.isnan(split.points.p_cam0[mono]).all()


def test_slow_motion_needs_the_long_look_back(world: Callable[..., Recording]) -> None:
    """0.25 m/s is 0.8 px after 0.1 s: only the seconds before tell it from noise."""
    settings = changed(forgiven_speed_mps=0.02)
    long = in_order(world(speed=0.25, n_frames=23).segmented(settings))
    short = in_order(world(speed=0.25, n_frames=2).segmented(settings))
    assert (long[:N_CAR] == DYNAMIC).all()
    assert (short[:N_CAR] == STATIC).all()


def test_at_a_standstill_frames_share_a_clone(world: Callable[..., Recording]) -> None:
    """Ten frames, two poses: rows whose frame is no clone compare by the clone they share."""
    recording = world(rig_speed=0.0, n_frames=10, speed=1.5)
    stamps = recording.table.frame_ns
    shared = np.where(np.arange(10) < 9, stamps[0], stamps[-1])
    P = recording.window.covariance[:12, :12]
    window = PoseWindow(stamps[[0, 9]], recording.window.T_world_imu[[9, 9]], P)
    table = replace(recording.table, clone_ns=shared)
    standing = replace(recording, table=table, window=window)
    assert _moves_alone(standing)


def _moves_alone(recording: Recording) -> bool:
    label = in_order(recording.segmented())
    return bool((label[:N_CAR] == DYNAMIC).all() and (label[N_CAR:] == STATIC).mean() > 0.95)


def test_rows_whose_pose_has_left_are_not_compared(world: Callable[..., Recording]) -> None:
    recording = world(n_frames=12)
    window = recording.window
    newest = PoseWindow(
        window.timestamp_ns[-1:], window.T_world_imu[-1:], window.covariance[-6:, -6:]
    )
    split = replace(recording, window=newest).segmented()
    assert (split.points.label == UNKNOWN).all()
    assert not split.outlier.any()
    last_two = PoseWindow(
        window.timestamp_ns[-2:], window.T_world_imu[-2:], window.covariance[-12:, -12:]
    )
    label = in_order(replace(recording, window=last_two).segmented())
    assert (label[N_CAR:] == STATIC).all()
    assert (label[:N_CAR] == DYNAMIC).all()  # one interval is enough for many that go alike


def test_the_first_frame_has_nothing_to_compare(world: Callable[..., Recording]) -> None:
    split = world(n_frames=1).segmented()
    assert (split.points.label == UNKNOWN).all()
    assert np.isfinite(split.points.p_cam0).all()
    assert np.isfinite(split.points.cov_cam0).all()
    assert np.isnan(split.points.previous).all()


def test_switched_off_everything_is_static(world: Callable[..., Recording]) -> None:
    split = world().segmented(changed(enabled=False))
    assert (split.points.label == STATIC).all()
    assert not split.outlier.any()
    assert np.isfinite(split.points.p_cam0).all()
