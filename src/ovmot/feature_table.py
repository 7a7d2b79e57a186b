"""The table of what was seen: every feature in every frame of the window, as arrays.

Rows are frames, columns are features. A frame's pose is held by a clone of the filter; while the
rig stands, several frames share one clone, so a row names its clone. Functions return new tables.
"""

from dataclasses import dataclass, replace

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.id_sets import contained
from ovmot.kernels.table_kernel import (
    columns_of_compiled,
    live_columns_compiled,
)
from ovmot.types import FrontendFrame, PixelNoise

MAX_SHARING_ROWS = 20
"""Frames of a standstill that are kept for the segmentation; the filter needs none of them."""


LOOK_BACK_TOLERANCE = 0.3
"""Part of a look-back time by which a frame may miss it."""


@dataclass(frozen=True, slots=True)
class FeatureTable:
    """T frames by F features.

    `frame_ns`, `clone_ns` (T,): the frame's stamp and that of the clone that holds its pose.
    `pixels`, `normalized` (T, F, 4): left u, v and right u, v, NaN where unseen by that camera;
    distorted pixels and undistorted plane coordinates. `track_length` (F,): KLT steps so far.
    `used` (T, F): observations that an update has taken. `dynamic` (F,): features that no update
    may ever use, since they were found to move. `outlier` (F,): features that did not look at rest
    when last seen.
    """

    frame_ns: IntArray
    clone_ns: IntArray
    feature_id: IntArray
    pixels: FloatArray
    normalized: FloatArray
    track_length: IntArray
    used: BoolArray
    dynamic: BoolArray
    outlier: BoolArray

    @property
    def shape(self) -> tuple[int, int]:
        """Number of frames and of features."""
        return len(self.frame_ns), len(self.feature_id)

    @property
    def seen(self) -> BoolArray:
        """Observations (T, F), by whichever camera."""
        return np.asarray(np.isfinite(self.pixels[..., ::2]).any(axis=-1))

    @property
    def seen_now(self) -> BoolArray:
        """Features (F,) that the newest frame holds."""
        if len(self.frame_ns) == 0:
            return np.zeros(len(self.feature_id), dtype=np.bool_)
        left, right = self.pixels[-1, :, 0], self.pixels[-1, :, 2]
        return np.asarray(np.isfinite(left) | np.isfinite(right))

    def columns(self, feature_id: IntArray) -> IntArray:
        """Columns (N,) of features (N,), -1 for those that the table does not hold."""
        ids = np.ascontiguousarray(feature_id, dtype=np.int64)
        return columns_of_compiled(ids, self.feature_id)


@dataclass(frozen=True, slots=True)
class StereoHistory:
    """Stereo pairs and positions of N features at L earlier frames, oldest first, and now.

    `feature_id` (N,); `row` (L,): rows of the feature table; `clone_ns` (L,): the clones that hold
    their poses; `span_s` (L,) seconds and `n_frames` (L,) frames before now. `then` (L, N, 4) and
    `now` (N, 4): normalized coordinates. `p_then` (L, N, 3), `p_now` (N, 3): positions in the left
    camera of that time, metres; `cov_now` (N, 3, 3): covariance now. NaN where there is no stereo
    pair. `noise`: that of the pixels, from which the covariances follow.
    """

    feature_id: IntArray
    row: IntArray
    clone_ns: IntArray
    span_s: FloatArray
    n_frames: IntArray
    then: FloatArray
    now: FloatArray
    p_then: FloatArray
    p_now: FloatArray
    cov_now: FloatArray
    noise: PixelNoise

    def __len__(self) -> int:
        return len(self.row)

    def younger(self, max_span_s: float) -> "StereoHistory":
        """The history without the frames that are longer ago."""
        reach = max_span_s + 0.5 * LOOK_BACK_TOLERANCE * self.span_s.min(initial=max_span_s)
        kept = slice(int(np.count_nonzero(self.span_s >= reach)), None)  # the oldest come first
        return replace(
            self,
            row=self.row[kept],
            clone_ns=self.clone_ns[kept],
            span_s=self.span_s[kept],
            n_frames=self.n_frames[kept],
            then=self.then[kept],
            p_then=self.p_then[kept],
        )

    def only(self, index: IntArray) -> "StereoHistory":
        """The history of some features."""
        return replace(
            self,
            feature_id=self.feature_id[index],
            then=self.then.take(index, axis=1),
            now=self.now[index],
            p_then=self.p_then.take(index, axis=1),
            p_now=self.p_now[index],
            cov_now=self.cov_now[index],
        )


def empty_table() -> FeatureTable:
    """A table of no frames and no features."""
    ints = np.empty(0, dtype=np.int64)
    seen = np.empty((0, 0, 4))
    none = np.empty(0, np.bool_)
    return FeatureTable(ints, ints, ints, seen, seen, ints, np.empty((0, 0), np.bool_), none, none)


def append_frame(table: FeatureTable, seen: FrontendFrame) -> FeatureTable:
    """The table with one more row, and a column for each feature that is new in it."""
    n_rows, n_old = table.shape
    column = table.columns(seen.feature_id)
    is_new = column < 0
    n_new = int(is_new.sum())
    column[is_new] = n_old + np.arange(n_new)
    track_length = np.concatenate([table.track_length, np.zeros(n_new, dtype=np.int64)])
    track_length[column] = seen.track_length
    used = np.zeros((n_rows + 1, n_old + n_new), dtype=np.bool_)
    used[:-1, :n_old] = table.used
    none = np.zeros(n_new, dtype=np.bool_)
    return FeatureTable(
        frame_ns=np.append(table.frame_ns, seen.timestamp_ns),
        clone_ns=np.append(table.clone_ns, seen.timestamp_ns),
        feature_id=np.concatenate([table.feature_id, seen.feature_id[is_new]]),
        pixels=_with_row(table.pixels, seen.pixels, column, n_new),
        normalized=_with_row(table.normalized, seen.normalized, column, n_new),
        track_length=track_length,
        used=used,
        dynamic=np.concatenate([table.dynamic, none]),
        outlier=np.concatenate([table.outlier, none]),
    )


def _with_row(views: FloatArray, seen: FloatArray, column: IntArray, n_new: int) -> FloatArray:
    """Views (T, F, 4) with `n_new` more columns, NaN, and one more row: those seen (N, 4) in
    `column` (N,), NaN elsewhere."""
    n_rows, n_old = views.shape[:2]
    out = np.empty((n_rows + 1, n_old + n_new, 4))
    out[:-1, :n_old], out[:-1, n_old:], out[-1] = views, np.nan, np.nan
    out[-1, column] = seen
    return out


def mark_dynamic(table: FeatureTable, feature_id: IntArray) -> FeatureTable:
    """The table with these features closed to the filter for good."""
    if not len(feature_id):
        return table
    dynamic, column = table.dynamic.copy(), table.columns(feature_id)
    dynamic[column[column >= 0]] = True
    return _marked(table, dynamic=dynamic)


def mark_outliers(table: FeatureTable, feature_id: IntArray, outlier: BoolArray) -> FeatureTable:
    """The table with a new verdict on the features (N,) seen now; of others the last one stays."""
    out, column = table.outlier.copy(), table.columns(feature_id)
    out[column[column >= 0]] = outlier[column >= 0]
    return _marked(table, outlier=out)


def mark_used(table: FeatureTable, used: BoolArray) -> FeatureTable:
    """The table with these observations (T, F) taken by an update."""
    return _marked(table, used=table.used | used)


def _marked(
    table: FeatureTable, *, used: BoolArray | None = None, dynamic: BoolArray | None = None,
    outlier: BoolArray | None = None,
) -> FeatureTable:  # fmt: skip
    """The table with other marks, those that are not None."""
    return FeatureTable(
        table.frame_ns, table.clone_ns, table.feature_id, table.pixels, table.normalized,
        table.track_length, table.used if used is None else used,
        table.dynamic if dynamic is None else dynamic,
        table.outlier if outlier is None else outlier,
    )  # fmt: skip


def share_clone(table: FeatureTable, dropped_ns: int, kept_ns: int) -> FeatureTable:
    """Rows whose clone `dropped_ns` leaves the state, since the rig stood, point to `kept_ns`."""
    return replace(table, clone_ns=np.where(table.clone_ns == dropped_ns, kept_ns, table.clone_ns))


def keep_window(table: FeatureTable, clone_ns: IntArray) -> FeatureTable:
    """Only rows whose clone is still there, and no dead columns.

    Rows that share another frame's clone (the rig stands) are kept up to `MAX_SHARING_ROWS`, the
    newest first. A column lives while the newest row or an observation that no update has used
    holds it.
    """
    rows = contained(table.clone_ns, np.sort(clone_ns))
    sharing = np.flatnonzero(rows & (table.frame_ns != table.clone_ns))
    rows[sharing[:-MAX_SHARING_ROWS]] = False
    row = np.flatnonzero(rows)
    column = np.flatnonzero(live_columns_compiled(table.pixels, table.used, table.dynamic, row))
    view = row[:, None] * table.shape[1] + column  # in one step: a third of the memory to go over
    return FeatureTable(
        frame_ns=table.frame_ns[row],
        clone_ns=table.clone_ns[row],
        feature_id=table.feature_id[column],
        pixels=table.pixels.reshape(-1, 4).take(view, axis=0),
        normalized=table.normalized.reshape(-1, 4).take(view, axis=0),
        track_length=table.track_length[column],
        used=table.used.ravel().take(view),
        dynamic=table.dynamic[column],
        outlier=table.outlier[column],
    )
