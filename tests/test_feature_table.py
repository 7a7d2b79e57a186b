"""The track table: what appends, bars, marks, shares and forgets."""

import numpy as np

from ovmot.feature_table import (
    MAX_SHARING_ROWS,
    FeatureTable,
    append_frame,
    empty_table,
    keep_window,
    mark_dynamic,
    mark_used,
    share_clone,
)
from ovmot.types import FrontendFrame


def frame(
    stamp: int, ids: list[int], *, mono: tuple[int, ...] = (), track_length: int = 0
) -> FrontendFrame:
    """Features whose pixels tell their id and the frame: (id, stamp, id + 0.5, stamp)."""
    feature_id = np.array(ids, dtype=np.int64)
    pixels = np.column_stack(
        [feature_id, np.full(len(ids), stamp), feature_id + 0.5, np.full(len(ids), stamp)]
    ).astype(np.float64)
    pixels[np.isin(feature_id, mono), 2:] = np.nan
    n = len(ids)
    return FrontendFrame(
        stamp,
        feature_id,
        pixels,
        pixels / 100.0,
        np.full(n, track_length),
        np.ones(n, dtype=np.bool_),
    )


def table_of(*frames: FrontendFrame) -> FeatureTable:
    table = empty_table()
    for seen in frames:
        table = append_frame(table, seen)
    return table


def column(table: FeatureTable, feature: int) -> int:
    return int(np.flatnonzero(table.feature_id == feature)[0])


def observed(table: FeatureTable) -> set[tuple[int, int]]:
    """Pairs (stamp, feature) that the table holds."""
    rows, columns = np.nonzero(np.isfinite(table.pixels[..., 0]))
    return set(zip(table.frame_ns[rows].tolist(), table.feature_id[columns].tolist(), strict=True))


def test_an_empty_table() -> None:
    table = empty_table()
    assert table.shape == (0, 0)
    assert table.seen_now.shape == (0,)


def test_frames_become_rows_and_features_columns() -> None:
    table = table_of(frame(10, [3, 1]), frame(20, [1, 7, 3], mono=(7,)), frame(30, [7]))
    assert table.shape == (3, 3)
    assert observed(table) == {(10, 3), (10, 1), (20, 1), (20, 7), (20, 3), (30, 7)}
    for stamp, feature in observed(table):
        row = table.frame_ns.tolist().index(stamp)
        left = table.pixels[row, column(table, feature), :2]
        assert left.tolist() == [feature, stamp]
        assert (table.normalized[row, column(table, feature), :2] == left / 100.0).all()
    assert np.isnan(table.pixels[1, column(table, 7), 2:]).all()  # mono stays mono
    assert np.isfinite(table.pixels[2, column(table, 7), 2:]).all()
    np.testing.assert_array_equal(table.clone_ns, table.frame_ns)
    assert table.seen_now.tolist() == [f == 7 for f in table.feature_id.tolist()]
    assert not table.used.any()
    assert not table.dynamic.any()


def test_hops_are_the_newest() -> None:
    table = table_of(frame(10, [1, 2], track_length=4), frame(20, [2], track_length=5))
    assert table.track_length[column(table, 1)] == 4
    assert table.track_length[column(table, 2)] == 5


def test_an_append_leaves_the_old_table_as_it_was() -> None:
    old = table_of(frame(10, [1, 2]))
    before = old.pixels.copy()
    new = append_frame(old, frame(20, [2, 5]))
    assert old.shape == (1, 2)
    np.testing.assert_array_equal(old.pixels, before)
    assert new.shape == (2, 3)


def test_a_barred_feature_stays_barred() -> None:
    table = mark_dynamic(table_of(frame(10, [1, 2, 3])), np.array([2, 99]))
    table = append_frame(table, frame(20, [2, 3, 4]))
    table = mark_dynamic(table, np.array([4]))
    assert {f for f in (1, 2, 3, 4) if table.dynamic[column(table, f)]} == {2, 4}


def test_used_adds_up() -> None:
    table = table_of(frame(10, [1, 2]), frame(20, [1, 2]))
    first, second = np.zeros((2, 2), np.bool_), np.zeros((2, 2), np.bool_)
    first[0, 0], second[1, 1] = True, True
    table = mark_used(mark_used(table, first), second)
    assert table.used.tolist() == [[True, False], [False, True]]
    table = append_frame(table, frame(30, [1, 2, 3]))
    assert table.used.tolist() == [[True, False, False], [False, True, False], [False] * 3]


def test_rows_whose_clone_leaves_go() -> None:
    table = table_of(frame(10, [1, 2]), frame(20, [1, 2]), frame(30, [1]))
    kept = keep_window(table, np.array([20, 30]))
    assert kept.frame_ns.tolist() == [20, 30]
    assert observed(kept) == {(20, 1), (20, 2), (30, 1)}


def test_columns_die_when_nothing_fresh_holds_them() -> None:
    """2 ended and was used up; 3 ended and is unused; 4 is barred and gone; 1, 5 are seen now."""
    table = table_of(frame(10, [1, 2, 3, 4]), frame(20, [1, 5]))
    used = np.zeros(table.shape, dtype=np.bool_)
    used[0, column(table, 2)] = used[0, column(table, 1)] = True
    table = mark_dynamic(mark_used(table, used), np.array([4, 5]))
    kept = keep_window(table, np.array([10, 20]))
    assert sorted(kept.feature_id.tolist()) == [1, 3, 5]
    assert kept.dynamic[column(kept, 5)]
    assert kept.used[0, column(kept, 1)]
    assert not kept.used[0, column(kept, 3)]


def test_a_column_dies_with_its_last_row() -> None:
    table = table_of(frame(10, [1, 2]), frame(20, [1]))
    assert keep_window(table, np.array([20])).feature_id.tolist() == [1]


def test_frames_of_a_standstill_share_a_clone() -> None:
    table = table_of(frame(10, [1]), frame(20, [1]), frame(30, [1]))
    table = share_clone(table, 20, 10)
    assert table.clone_ns.tolist() == [10, 10, 30]
    assert table.frame_ns.tolist() == [10, 20, 30]
    assert keep_window(table, np.array([10])).frame_ns.tolist() == [10, 20]
    assert keep_window(table, np.array([30])).frame_ns.tolist() == [30]


def test_at_a_long_standstill_only_the_newest_sharing_rows_are_kept() -> None:
    table = table_of(frame(5, [1]), frame(10, [1]))
    n = MAX_SHARING_ROWS + 7
    for stamp in range(11, 11 + n):
        table = share_clone(append_frame(table, frame(stamp, [1])), stamp, 10)
        table = keep_window(table, np.array([5, 10]))
    newest = list(range(11 + n - MAX_SHARING_ROWS, 11 + n))
    assert table.frame_ns.tolist() == [5, 10, *newest]
    assert set(table.clone_ns.tolist()) == {5, 10}
