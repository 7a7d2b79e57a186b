"""Which observations each update uses, and that none is used twice."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from drive_fixtures import Drive, filled_window

from ovmot.feature_table import FeatureTable, mark_outliers
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.types import FrontendFrame
from ovmot.vio import visual_update
from ovmot.vio.filter import MsckfFilter
from ovmot.vio.state import State, box_minus

MakeDrive = Callable[..., Drive]

DOORS = {"msckf_update": 3, "update_slam_features": 3}
"""Functions through which features enter the filter, and which argument holds their pixels."""


@pytest.fixture
def given_pixels(monkeypatch: pytest.MonkeyPatch) -> list[FloatArray]:
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


def test_no_observation_is_used_twice(
    make_drive: MakeDrive, given_pixels: list[FloatArray]
) -> None:
    steps = list(make_drive(2, 3.0).run())
    everything = np.concatenate(given_pixels)
    assert len(everything) > 1000
    assert len(pixel_set(everything)) == len(everything)
    # and what was given_pixels is marked
    last = steps[-1].table
    marked = pixel_set(last.pixels[last.used][:, :2])
    in_table = pixel_set(last.pixels[np.isfinite(last.pixels[..., 0])][:, :2])
    assert pixel_set(everything) & in_table <= marked


def test_dynamic_features_enter_no_update(
    make_drive: MakeDrive, given_pixels: list[FloatArray]
) -> None:
    n_calls, updates_after, known = 0, 0, 0
    for step in make_drive(3, 4.5).run(dynamic=late_and_odd):
        new, n_calls = given_pixels[n_calls:], len(given_pixels)
        columns = step.before.pixels[:, step.before.dynamic]
        dynamic = pixel_set(columns[np.isfinite(columns[..., 0])][:, :2])
        known += len(dynamic)
        for pixels in new:
            assert not pixel_set(pixels) & dynamic
            updates_after += bool(dynamic)
    # they became dynamic in the middle of their life, and updates went on with the others
    assert known > 1000
    assert updates_after > 5


def late_and_odd(table: FeatureTable) -> BoolArray:
    """Every second feature, from the frame at 1.3 s on."""
    late: bool = table.frame_ns[-1] % 10_000_000_000 >= 1_300_000_000
    odd: BoolArray = table.feature_id % 2 == 1
    return odd & late


def test_dynamic_from_the_first_is_as_never_seen(make_drive: MakeDrive) -> None:
    drive = make_drive(4, 2.0)
    *_, dynamic = drive.run(dynamic=lambda table: table.feature_id % 3 == 0)
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


def updated(
    ego: MsckfFilter, table: FeatureTable, *, oldest_goes: bool = False
) -> tuple[State, FeatureTable]:
    return visual_update.update_with_features(
        ego.state, table, ego.rig, ego.settings.filter, oldest_is_marginalized=oldest_goes
    )


def end_tracks(table: FeatureTable, ended: BoolArray) -> FeatureTable:
    """The newest frame does not see these features."""
    pixels = table.pixels.copy()
    pixels[-1, ended] = np.nan
    return replace(table, pixels=pixels)


def test_only_lost_features_with_three_views_are_used(
    make_drive: MakeDrive, given_pixels: list[FloatArray]
) -> None:
    ego, table = filled_window(make_drive(5, 1.0), 6)
    whole = np.isfinite(table.pixels[..., 0]).sum(axis=0) == len(table.pixels)
    ended: BoolArray = whole & (np.arange(len(whole)) % 2 == 0)
    short = np.flatnonzero(ended)[:4]
    table = end_tracks(table, ended)
    table.pixels[:3, short] = np.nan  # two views are left
    state, after = updated(ego, table)
    used_features = after.used.sum(axis=0) > 0
    assert set(np.flatnonzero(used_features)) >= set(np.flatnonzero(ended))
    assert not used_features[table.seen_now].any()
    given = pixel_set(np.concatenate(given_pixels))
    assert not given & pixel_set(table.pixels[3:5, short].reshape(-1, 4)[:, :2])
    first_long = np.flatnonzero(ended)[4]
    assert pixel_set(table.pixels[:5, first_long, :2]) <= given
    assert np.trace(state.covariance) < np.trace(ego.state.covariance)


def test_outliers_wait(make_drive: MakeDrive, given_pixels: list[FloatArray]) -> None:
    ego, table = filled_window(make_drive(6, 1.0), 6)
    outliers = np.arange(table.shape[1]) % 2 == 0
    table = mark_outliers(table, table.feature_id, outliers)
    _, after = updated(ego, table, oldest_goes=True)
    given = pixel_set(np.concatenate(given_pixels))
    of_outliers = table.pixels[:, outliers]
    assert given
    assert not given & pixel_set(of_outliers[np.isfinite(of_outliers[..., 0])][:, :2])
    # those still in view are kept for later, when they may be cleared
    assert not after.used[:, outliers & table.seen_now].any()
    cleared = mark_outliers(after, after.feature_id, np.zeros(table.shape[1], dtype=np.bool_))
    updated(ego, cleared, oldest_goes=True)
    alive = table.pixels[:, outliers & table.seen_now]
    assert pixel_set(given_pixels[-1]) & pixel_set(alive[np.isfinite(alive[..., 0])][:, :2])


def test_features_lost_as_outliers_are_never_used(
    make_drive: MakeDrive, given_pixels: list[FloatArray]
) -> None:
    ego, table = filled_window(make_drive(6, 1.0), 6)
    outliers: BoolArray = np.arange(table.shape[1]) % 2 == 0
    table = mark_outliers(table, table.feature_id, outliers)
    table = end_tracks(table, np.ones(table.shape[1], dtype=np.bool_))
    _, after = updated(ego, table)
    given, of_outliers = pixel_set(np.concatenate(given_pixels)), table.pixels[:, outliers]
    assert given
    assert not given & pixel_set(of_outliers[np.isfinite(of_outliers[..., 0])][:, :2])
    assert after.used[np.isfinite(table.pixels[..., 0])].all()  # nor can they be later


def test_features_beyond_the_cap_keep_their_views_while_they_are_seen(
    make_drive: MakeDrive, given_pixels: list[FloatArray]
) -> None:
    ego, table = filled_window(make_drive(7, 1.0), 6)
    settings = ego.settings.filter.model_copy(
        update={"max_features_per_update": 5, "max_landmarks": 0}
    )
    _, after = visual_update.update_with_features(
        ego.state, table, ego.rig, settings, oldest_is_marginalized=True
    )
    used = after.used.any(axis=0)
    assert len(given_pixels) == 1
    assert (used & table.seen_now).sum() == 5


def test_the_longest_tracks_come_first(
    make_drive: MakeDrive, given_pixels: list[FloatArray]
) -> None:
    ego, table = filled_window(make_drive(7, 1.0), 6)
    settings = ego.settings.filter.model_copy(update={"max_features_per_update": 5})
    table = end_tracks(table, np.ones(table.shape[1], dtype=np.bool_))
    views = np.isfinite(table.pixels[..., 0]).sum(axis=0)
    visual_update.update_with_features(
        ego.state, table, ego.rig, settings, oldest_is_marginalized=False
    )
    assert len(given_pixels) == 1
    assert len(given_pixels[0]) == np.sort(views)[-5:].sum()


def test_a_feature_that_moves_is_gated(make_drive: MakeDrive) -> None:
    drive = make_drive(8, 1.5)
    ego, table = filled_window(drive, 8)
    seen = np.isfinite(table.pixels).all(axis=(0, 2))
    pixels = np.moveaxis(table.pixels[:, seen], 0, 1)
    drift = 12.0 * np.arange(8)[None, :, None] * [1.0, 0.3, 1.0, 0.3]

    def after(seen_as: FloatArray) -> State:
        ids, no_candidates = np.arange(len(pixels)), np.zeros(len(pixels), dtype=np.bool_)
        return visual_update.msckf_update(
            ego.state, ego.rig, ego.rig.T_imu_cam0, seen_as, ego.rig.normalize(seen_as), ids,
            no_candidates, ego.settings.filter,
        )  # fmt: skip

    assert after(pixels + drift) is ego.state
    assert after(pixels) is not ego.state
