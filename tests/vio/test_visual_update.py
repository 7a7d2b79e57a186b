"""Which observations an update takes, and the consistency of the filter that it makes."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable, append_frame, empty_table, mark_dynamic, mark_outliers
from ovmot.geometry import so3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.settings import Settings
from ovmot.sim.imu import noisy_imu, perfect_imu
from ovmot.types import FrontendFrame, ImuNoise, ImuSample
from ovmot.vio import visual_update
from ovmot.vio.filter import MsckfFilter
from ovmot.vio.imu_buffer import ImuBuffer
from ovmot.vio.state import (
    ACCEL_BIAS,
    GYRO_BIAS,
    N_BASE,
    POSITION,
    THETA,
    TIME_OFFSET,
    VELOCITY,
    ImuState,
    State,
    box_minus,
    no_clones,
)

FRAME_NS = 100_000_000
PIXEL_SIGMA = 1.0
SIGMA = np.repeat([0.01, 1e-3, 0.05, 5e-3, 0.05], 3)
OFFSET_SIGMA = 0.003


@dataclass(frozen=True)
class Drive:
    """One seed: a filter started with an error from its own covariance, and what it will get."""

    ego: MsckfFilter
    imu: ImuBuffer
    frames: list[FrontendFrame]
    path: PoseSpline

    def run(self, bar: Callable[[FeatureTable], BoolArray] | None = None) -> Iterator["Step"]:
        ego, table = self.ego, empty_table()
        for seen in self.frames:
            ego = ego.propagate(seen.timestamp_ns, self.imu)
            table = append_frame(table, seen)
            if bar is not None:
                table = mark_dynamic(table, table.feature_id[bar(table)])
            before = table
            ego, table = ego.update(table)
            yield Step(ego, before, table, seen.timestamp_ns)
            ego, table = ego.marginalize(table)


@dataclass(frozen=True)
class Step:
    """The filter and the table after a frame's visual_update, and the table before it."""

    ego: MsckfFilter
    before: FeatureTable
    table: FeatureTable
    frame_ns: int


MakeDrive = Callable[..., Drive]


@pytest.fixture
def make_drive(
    rig: StereoRig,
    curvy_path: PoseSpline,
    landmarks: FloatArray,
    observe: Callable[..., FrontendFrame],
    noise: ImuNoise,
    start_ns: int,
) -> MakeDrive:
    """A function (seed, seconds) to a drive along the path, with a pixel of noise."""

    def make(seed: int, span_s: float = 5.0, points: FloatArray = landmarks[:100]) -> Drive:
        rng = np.random.default_rng(seed)
        e = np.concatenate([rng.normal(0.0, SIGMA), rng.normal(0.0, [OFFSET_SIGMA])])
        stamps = start_ns + 10_000_000 * np.arange(-5, round(100 * span_s) + 10)
        clean = perfect_imu(curvy_path, stamps, time_offset_s=float(e[TIME_OFFSET]))
        sensor = noisy_imu(clean, noise, rng, gyro_bias=e[GYRO_BIAS], accel_bias=e[ACCEL_BIAS])
        buffer = ImuBuffer()
        for stamp, gyro, accel in zip(stamps, sensor.data.gyro, sensor.data.accel, strict=True):
            buffer.append(ImuSample(int(stamp), gyro, accel))
        # the filter begins at start_ns on the IMU's clock, and takes the offset for zero
        at = start_ns - round(1e9 * float(e[TIME_OFFSET]))
        T, zero = curvy_path.pose(at), np.zeros(3)
        imu = ImuState(
            T[:3, :3] @ so3.exp(-e[THETA]),
            T[:3, 3] - e[POSITION],
            curvy_path.velocity(at) - e[VELOCITY],
            zero,
            zero,
        )
        P = np.diag(np.append(SIGMA, OFFSET_SIGMA) ** 2)
        state = State(start_ns, imu, imu, 0.0, no_clones(), P)
        settings = Settings.model_validate({"filter": {"pixel_sigma": PIXEL_SIGMA}})
        frames = [
            observe(rig, curvy_path.pose(t), points, t, PIXEL_SIGMA, rng)
            for t in range(start_ns, start_ns + round(1e9 * span_s) + 1, FRAME_NS)
        ]
        return Drive(MsckfFilter(state, rig, noise, settings), buffer, frames, curvy_path)

    return make


def pose_error(ego: MsckfFilter, path: PoseSpline) -> tuple[FloatArray, FloatArray]:
    """Error (6,) of the newest clone against the path at its frame, and its covariance (6, 6)."""
    window = ego.window()
    T, T_true = window.T_world_imu[-1], path.pose(int(window.timestamp_ns[-1]))
    rotation = so3.log(T[:3, :3].T @ T_true[:3, :3])
    return np.concatenate([rotation, T_true[:3, 3] - T[:3, 3]]), window.covariance[-6:, -6:]


def test_errors_are_as_large_as_the_covariance_says(make_drive: MakeDrive) -> None:
    nees, last = [], []
    for seed in range(10):
        drive = make_drive(seed)
        for step in drive.run():
            e, P = pose_error(step.ego, drive.path)
            nees.append(e @ np.linalg.solve(P, e))
        last.append(e[3:] / np.sqrt(np.diag(P)[3:]))
        sigma = np.sqrt(np.diag(step.ego.state.covariance))
        # 15 m on, the images have taught it
        assert sigma[GYRO_BIAS].max() < 0.002
        assert sigma[THETA].max() < 0.01
        assert sigma[TIME_OFFSET] < 0.6 * OFFSET_SIGMA
    assert np.abs(last).max() < 3.0
    assert 4.0 < np.mean(nees) < 9.0  # 6 degrees of freedom


def test_standing_and_moving_are_told_apart(make_drive: MakeDrive) -> None:
    drive = make_drive(1, 2.0)
    assert not any(step.ego.standing for step in drive.run())
    # the same picture again and again is not enough while the IMU says that we drive
    frozen = [replace(drive.frames[0], timestamp_ns=f.timestamp_ns) for f in drive.frames]
    assert not any(step.ego.standing for step in replace(drive, frames=frozen[:4]).run())


DOORS = {"msckf_update": 3, "update_slam_features": 3}
"""Functions through which features enter the filter, and which argument holds their pixels."""


@pytest.fixture
def taken(monkeypatch: pytest.MonkeyPatch) -> list[FloatArray]:
    """Left pixels (n, 2) of every observation that each update is given, as a growing list."""
    calls: list[FloatArray] = []

    def watch(name: str, position: int) -> None:
        function = getattr(visual_update, name)

        def spy(*arguments: Any) -> State:
            pixels = arguments[position]
            calls.append(pixels[np.isfinite(pixels[..., 0])][:, :2])
            state: State = function(*arguments)
            return state

        monkeypatch.setattr(visual_update, name, spy)

    for name, position in DOORS.items():
        watch(name, position)
    return calls


def pixel_set(pixels: FloatArray) -> set[tuple[float, ...]]:
    """Noise makes every observation's pixels unique."""
    return {tuple(row) for row in pixels.tolist()}


def test_no_observation_is_used_twice(make_drive: MakeDrive, taken: list[FloatArray]) -> None:
    steps = list(make_drive(2, 3.0).run())
    everything = np.concatenate(taken)
    assert len(everything) > 1000
    assert len(pixel_set(everything)) == len(everything)
    # and what was taken is marked
    last = steps[-1].table
    marked = pixel_set(last.pixels[last.used][:, :2])
    in_table = pixel_set(last.pixels[np.isfinite(last.pixels[..., 0])][:, :2])
    assert pixel_set(everything) & in_table <= marked


def test_barred_features_enter_no_update(make_drive: MakeDrive, taken: list[FloatArray]) -> None:
    n_calls, updates_after, known = 0, 0, 0
    for step in make_drive(3, 4.5).run(bar=late_and_odd):
        new, n_calls = taken[n_calls:], len(taken)
        columns = step.before.pixels[:, step.before.dynamic]
        dynamic = pixel_set(columns[np.isfinite(columns[..., 0])][:, :2])
        known += len(dynamic)
        for pixels in new:
            assert not pixel_set(pixels) & dynamic
            updates_after += bool(dynamic)
    # they were barred in the middle of their life, and updates went on with the others
    assert known > 1000
    assert updates_after > 5


def late_and_odd(table: FeatureTable) -> BoolArray:
    """Every second feature, from the frame at 1.3 s on."""
    late: bool = table.frame_ns[-1] % 10_000_000_000 >= 1_300_000_000
    odd: BoolArray = table.feature_id % 2 == 1
    return odd & late


def test_barred_from_the_first_is_as_never_seen(make_drive: MakeDrive) -> None:
    drive = make_drive(4, 2.0)
    *_, dynamic = drive.run(bar=lambda table: table.feature_id % 3 == 0)
    *_, without = replace(
        drive, frames=[only(f, f.feature_id % 3 != 0) for f in drive.frames]
    ).run()
    *_, everything = drive.run()
    np.testing.assert_allclose(box_minus(dynamic.ego.state, without.ego.state), 0.0, atol=1e-9)
    np.testing.assert_allclose(
        dynamic.ego.state.covariance, without.ego.state.covariance, atol=1e-9
    )
    a, b = everything.ego.state.imu, without.ego.state.imu
    assert np.abs(a.position - b.position).max() > 1e-4


def only(frame: FrontendFrame, kept: BoolArray) -> FrontendFrame:
    return FrontendFrame(
        frame.timestamp_ns,
        frame.feature_id[kept],
        frame.pixels[kept],
        frame.normalized[kept],
        frame.track_length[kept],
        frame.two_view_inlier[kept],
    )


def filled_window(drive: Drive, n_frames: int) -> tuple[MsckfFilter, FeatureTable]:
    """A filter that has cloned so many frames, and their table, of which nothing is used."""
    ego, table = drive.ego, empty_table()
    for seen in drive.frames[:n_frames]:
        ego, table = ego.propagate(seen.timestamp_ns, drive.imu), append_frame(table, seen)
    return ego, table


def corrected(
    ego: MsckfFilter, table: FeatureTable, *, oldest_leaves: bool = False
) -> tuple[State, FeatureTable]:
    return visual_update.update_with_features(
        ego.state, table, ego.rig, ego.settings.filter, oldest_leaves=oldest_leaves
    )


def end_tracks(table: FeatureTable, ended: BoolArray) -> FeatureTable:
    """The newest frame does not see these features."""
    pixels = table.pixels.copy()
    pixels[-1, ended] = np.nan
    return replace(table, pixels=pixels)


def test_only_ended_features_with_three_views_are_taken(
    make_drive: MakeDrive, taken: list[FloatArray]
) -> None:
    ego, table = filled_window(make_drive(5, 1.0), 6)
    whole = np.isfinite(table.pixels[..., 0]).sum(axis=0) == len(table.pixels)
    ended: BoolArray = whole & (np.arange(len(whole)) % 2 == 0)
    short = np.flatnonzero(ended)[:4]
    table = end_tracks(table, ended)
    table.pixels[:3, short] = np.nan  # two views are left
    state, after = corrected(ego, table)
    used_features = after.used.sum(axis=0) > 0
    assert set(np.flatnonzero(used_features)) >= set(np.flatnonzero(ended))
    assert not used_features[table.seen_now].any()
    given = pixel_set(np.concatenate(taken))
    assert not given & pixel_set(table.pixels[3:5, short].reshape(-1, 4)[:, :2])
    first_long = np.flatnonzero(ended)[4]
    assert pixel_set(table.pixels[:5, first_long, :2]) <= given
    assert np.trace(state.covariance) < np.trace(ego.state.covariance)


def test_suspects_wait(make_drive: MakeDrive, taken: list[FloatArray]) -> None:
    ego, table = filled_window(make_drive(6, 1.0), 6)
    outliers = np.arange(table.shape[1]) % 2 == 0
    table = mark_outliers(table, table.feature_id, outliers)
    _, after = corrected(ego, table, oldest_leaves=True)
    given = pixel_set(np.concatenate(taken))
    of_suspects = table.pixels[:, outliers]
    assert given
    assert not given & pixel_set(of_suspects[np.isfinite(of_suspects[..., 0])][:, :2])
    # those still in view are kept for later, when they may be cleared
    assert not after.used[:, outliers & table.seen_now].any()
    cleared = mark_outliers(after, after.feature_id, np.zeros(table.shape[1], dtype=np.bool_))
    corrected(ego, cleared, oldest_leaves=True)
    alive = table.pixels[:, outliers & table.seen_now]
    assert pixel_set(taken[-1]) & pixel_set(alive[np.isfinite(alive[..., 0])][:, :2])


def test_features_that_ended_as_suspects_are_never_used(
    make_drive: MakeDrive, taken: list[FloatArray]
) -> None:
    ego, table = filled_window(make_drive(6, 1.0), 6)
    outliers: BoolArray = np.arange(table.shape[1]) % 2 == 0
    table = mark_outliers(table, table.feature_id, outliers)
    table = end_tracks(table, np.ones(table.shape[1], dtype=np.bool_))
    _, after = corrected(ego, table)
    given, of_suspects = pixel_set(np.concatenate(taken)), table.pixels[:, outliers]
    assert given
    assert not given & pixel_set(of_suspects[np.isfinite(of_suspects[..., 0])][:, :2])
    assert after.used[np.isfinite(table.pixels[..., 0])].all()  # nor can they be later


def test_features_beyond_the_cap_keep_their_views_while_they_are_seen(
    make_drive: MakeDrive, taken: list[FloatArray]
) -> None:
    ego, table = filled_window(make_drive(7, 1.0), 6)
    settings = ego.settings.filter.model_copy(
        update={"max_features_per_update": 5, "max_landmarks": 0}
    )
    _, after = visual_update.update_with_features(
        ego.state, table, ego.rig, settings, oldest_leaves=True
    )
    used = after.used.any(axis=0)
    assert len(taken) == 1
    assert (used & table.seen_now).sum() == 5


def test_the_longest_tracks_come_first(make_drive: MakeDrive, taken: list[FloatArray]) -> None:
    ego, table = filled_window(make_drive(7, 1.0), 6)
    settings = ego.settings.filter.model_copy(update={"max_features_per_update": 5})
    table = end_tracks(table, np.ones(table.shape[1], dtype=np.bool_))
    views = np.isfinite(table.pixels[..., 0]).sum(axis=0)
    visual_update.update_with_features(ego.state, table, ego.rig, settings, oldest_leaves=False)
    assert len(taken) == 1
    assert len(taken[0]) == np.sort(views)[-5:].sum()


def test_a_feature_that_moves_is_gated(make_drive: MakeDrive) -> None:
    drive = make_drive(8, 1.5)
    ego, table = filled_window(drive, 8)
    seen = np.isfinite(table.pixels).all(axis=(0, 2))
    pixels = np.moveaxis(table.pixels[:, seen], 0, 1)
    drift = 12.0 * np.arange(8)[None, :, None] * [1.0, 0.3, 1.0, 0.3]

    def updated(seen_as: FloatArray) -> State:
        none_kept = np.full(len(pixels), visual_update.NOT_KEPT)
        return visual_update.msckf_update(
            ego.state, ego.rig, ego.rig.T_imu_cam0, seen_as, none_kept, ego.settings.filter
        )

    assert updated(pixels + drift) is ego.state
    assert updated(pixels) is not ego.state


def test_mono_features_teach_too(make_drive: MakeDrive) -> None:
    drive = make_drive(9, 3.0)
    mono = []
    for frame in drive.frames:
        pixels, normalized = frame.pixels.copy(), frame.normalized.copy()
        pixels[:, 2:] = normalized[:, 2:] = np.nan
        mono.append(replace(frame, pixels=pixels, normalized=normalized))
    *_, step = replace(drive, frames=mono).run()
    e, P = pose_error(step.ego, drive.path)
    assert e @ np.linalg.solve(P, e) < 22.5  # 99.9 % of chi-squared with 6
    sigma = np.sqrt(np.diag(step.ego.state.covariance))
    assert sigma[GYRO_BIAS].max() < 0.6 * SIGMA[GYRO_BIAS].max()


def test_standing_drops_the_newest_clone_and_its_rows_point_to_the_kept_one(
    make_drive: MakeDrive,
) -> None:
    ego, table = filled_window(make_drive(10, 1.0), 4)
    stamps = ego.state.clones.timestamp_ns
    still, shared = replace(ego, standing=True).marginalize(table)
    np.testing.assert_array_equal(still.state.clones.timestamp_ns, stamps[:-1])
    np.testing.assert_array_equal(shared.clone_ns, [*stamps[:-1], stamps[-2]])
    np.testing.assert_array_equal(shared.frame_ns, stamps)
    # the shared row is no measurement of the filter's
    np.testing.assert_array_equal(
        visual_update.clone_rows(shared, still.state), [True, True, True, False]
    )
    assert not visual_update.usable_observations(shared, still.state)[-1].any()


def test_driving_drops_the_oldest_clone_of_a_full_window(make_drive: MakeDrive) -> None:
    drive = make_drive(11, 2.0)
    n = drive.ego.settings.filter.max_clones
    ego, table = filled_window(drive, n)
    same, _ = ego.marginalize(table)
    assert len(same.state.clones) == n
    ego, table = filled_window(drive, n + 1)
    stamps = ego.state.clones.timestamp_ns
    less, table = ego.marginalize(table)
    np.testing.assert_array_equal(less.state.clones.timestamp_ns, stamps[1:])
    np.testing.assert_array_equal(table.frame_ns, stamps[1:])
    assert less.state.covariance.shape == (N_BASE + 6 * n, N_BASE + 6 * n)


def test_prediction_clones_the_pose_of_the_frame(make_drive: MakeDrive) -> None:
    drive = make_drive(13, 1.0)
    ego, _ = filled_window(drive, 5)
    stamp = drive.frames[4].timestamp_ns
    assert ego.state.timestamp_ns == ego.imu_needed_until(stamp) == ego.imu_time_ns(stamp)
    assert ego.state.clones.timestamp_ns[-1] == stamp
    np.testing.assert_array_equal(ego.window().T_world_imu[-1], ego.estimate(stamp).T_world_imu)
    # a later moment of the frame is farther along the way and the turn
    by_offset = ego.state.covariance[-6:, TIME_OFFSET] / OFFSET_SIGMA**2
    rate = drive.path.angular_velocity(stamp)
    np.testing.assert_allclose(by_offset[:3], rate, atol=0.1)
    np.testing.assert_allclose(by_offset[3:], ego.state.imu.velocity, atol=1e-9)
    assert np.linalg.norm(rate) > 0.2


def test_estimate_and_window_are_the_state(make_drive: MakeDrive) -> None:
    ego, _ = filled_window(make_drive(12, 1.0), 3)
    estimate, window = ego.estimate(77), ego.window()
    assert estimate.timestamp_ns == 77
    np.testing.assert_array_equal(estimate.T_world_imu[:3, 3], ego.state.imu.position)
    np.testing.assert_array_equal(estimate.T_world_imu[:3, :3], ego.state.imu.R_world_imu)
    np.testing.assert_array_equal(estimate.covariance, ego.state.covariance[:15, :15])
    assert estimate.time_offset_std_s == pytest.approx(OFFSET_SIGMA)
    np.testing.assert_array_equal(window.T_world_imu, ego.state.clones.T_world_imu)
    np.testing.assert_array_equal(window.covariance, ego.state.covariance[N_BASE:, N_BASE:])


def test_clones_of_fast_frames_leave_before_the_newest(make_drive: MakeDrive) -> None:
    drive = make_drive(0, 2.0)
    settings = Settings.model_validate({"filter": {"clone_spacing_s": 0.2, "max_clones": 6}})
    ego = replace(drive.ego, settings=settings)
    table = empty_table()
    for frame in drive.frames:
        ego = ego.propagate(frame.timestamp_ns, drive.imu)
        table = append_frame(table, frame)
        ego, table = ego.update(table)
        ego, table = ego.marginalize(table)
        assert ego.window().timestamp_ns[-1] == frame.timestamp_ns
    gaps = np.diff(ego.window().timestamp_ns) * 1e-9
    # no two neighbours of a clone are nearer to each other than the spacing
    assert (gaps[:-1] + gaps[1:] > 0.2).all()
    assert gaps[:-1].max() <= 0.2 + 1e-9
