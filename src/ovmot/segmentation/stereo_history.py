"""The stereo history of a frame: every feature's triangulated positions, now and at earlier times.

Built once a frame and used by whatever asks how a point has moved: the tests of the segmentation,
zero-velocity detection, and the clustering of moving points. Positions come from one stereo pair
each, since a moving point cannot be refined by repeated views; they are in the left camera of
their own time, so that they do not depend on the poses.
"""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import LOOK_BACK_TOLERANCE, FeatureTable, StereoHistory
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.segmentation.history_kernel import triangulate_pairs_compiled
from ovmot.types import PixelNoise


def stereo_history(
    table: FeatureTable,
    feature_id: IntArray,
    window_ns: IntArray,
    rig: StereoRig,
    look_back_s: tuple[float, ...],
    noise: PixelNoise,
) -> StereoHistory:
    """The history of features (N,) of the table's last row.

    `window_ns` (K,): stamps of the clones whose poses are known; only frames that one of them holds
    are looked at: those nearest to the `look_back_s`, and the last one.
    """
    row = look_back_rows(table, window_ns, look_back_s)
    column = table.columns(feature_id)
    age_ns = table.frame_ns[-1] - table.frame_ns[row]
    then = table.normalized.reshape(-1, 4).take(row[:, None] * table.shape[1] + column, axis=0)
    return history_of(
        then, table.normalized[-1].take(column, axis=0), feature_id,
        row, table.clone_ns[row], age_ns * 1e-9, len(table.frame_ns) - 1 - row, rig, noise,
    )  # fmt: skip


def history_of(
    then: FloatArray,
    now: FloatArray,
    feature_id: IntArray,
    row: IntArray,
    clone_ns: IntArray,
    span_s: FloatArray,
    n_frames: IntArray,
    rig: StereoRig,
    noise: PixelNoise,
) -> StereoHistory:
    """The history of normalized stereo pairs `then` (L, N, 4) and `now` (N, 4)."""
    then, now = np.ascontiguousarray(then), np.ascontiguousarray(now)
    p_then, p_now, cov_now = triangulate_pairs_compiled(
        then, now, np.ascontiguousarray(rig.T_cam1_cam0), rig.normalized_sigma(noise.sigma_px)
    )
    return StereoHistory(
        feature_id, row, clone_ns, span_s, n_frames, then, now, p_then, p_now, cov_now, noise
    )


def look_back_rows(
    table: FeatureTable, window_ns: IntArray, look_back_s: tuple[float, ...]
) -> IntArray:
    """Earlier rows (L,) with a known pose, oldest first: near each look-back time, and the last."""
    posed, frame_ns = set(window_ns.tolist()), table.frame_ns.tolist()
    rows = [row for row, clone in enumerate(table.clone_ns[:-1].tolist()) if clone in posed]
    chosen = set(rows[-1:])
    for wanted_ns in [round(1e9 * seconds) for seconds in look_back_s if rows]:
        apart_ns = [abs(frame_ns[-1] - frame_ns[row] - wanted_ns) for row in rows]
        nearest_ns = min(apart_ns)  # integers: rounding decides no tie
        if nearest_ns < LOOK_BACK_TOLERANCE * wanted_ns:
            chosen.add(rows[apart_ns.index(nearest_ns)])
    return np.array(sorted(chosen), dtype=np.int64)
