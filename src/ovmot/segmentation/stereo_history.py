"""The stereo history of a frame: every feature's triangulated positions, now and at earlier times.

Built once a frame and used by whatever asks how a point has moved: the tests of the segmentation,
zero-velocity detection, and the clustering of moving points. Positions come from one stereo pair
each, since a moving point cannot be refined by repeated views; they are in the left camera of
their own time, so that they do not depend on the poses.
"""

from dataclasses import dataclass, replace

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.segmentation.history_kernel import triangulate_pairs_compiled
from ovmot.types import PixelNoise

_TOLERANCE = 0.3  # of a look-back time, by which a frame may miss it


@dataclass(frozen=True, slots=True)
class StereoHistory:
    """Stereo pairs and positions of N features at L earlier frames, oldest first, and now.

    `feature_id` (N,); `row` (L,): rows of the feature table; `clone_ns` (L,): the clones that hold
    their poses; `span_s` (L,) seconds and `n_frames` (L,) frames before now. `then` (L, N, 4) and
    `now` (N, 4): normalized coordinates. `p_then` (L, N, 3), `p_now` (N, 3): positions in the left
    camera of that time, metres, with covariances `cov_then` (L, N, 3, 3), `cov_now` (N, 3, 3). NaN
    where there is no stereo pair. `noise`: that of the pixels, from which the covariances follow.
    """

    feature_id: IntArray
    row: IntArray
    clone_ns: IntArray
    span_s: FloatArray
    n_frames: IntArray
    then: FloatArray
    now: FloatArray
    p_then: FloatArray
    cov_then: FloatArray
    p_now: FloatArray
    cov_now: FloatArray
    noise: PixelNoise

    def __len__(self) -> int:
        return len(self.row)

    def younger(self, max_span_s: float) -> "StereoHistory":
        """The history without the frames that are longer ago."""
        kept = self.span_s < max_span_s + 0.5 * _TOLERANCE * self.span_s.min(initial=max_span_s)
        return replace(
            self,
            row=self.row[kept],
            clone_ns=self.clone_ns[kept],
            span_s=self.span_s[kept],
            n_frames=self.n_frames[kept],
            then=self.then[kept],
            p_then=self.p_then[kept],
            cov_then=self.cov_then[kept],
        )

    def only(self, index: IntArray) -> "StereoHistory":
        """The history of some features."""
        return replace(
            self,
            feature_id=self.feature_id[index],
            then=self.then.take(index, axis=1),
            now=self.now[index],
            p_then=self.p_then.take(index, axis=1),
            cov_then=self.cov_then.take(index, axis=1),
            p_now=self.p_now[index],
            cov_now=self.cov_now[index],
        )


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
    return history_of(
        table.normalized[row].take(column, axis=1), table.normalized[-1, column], feature_id,
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
    T_cam1_cam0 = np.ascontiguousarray(rig.T_cam1_cam0)
    sigma = rig.normalized_sigma(noise.sigma_px)
    pairs = np.concatenate([then.reshape(-1, 4), now])
    p, C = triangulate_pairs_compiled(pairs, T_cam1_cam0, sigma)
    n_then = then.shape[0] * then.shape[1]
    return StereoHistory(
        feature_id, row, clone_ns, span_s, n_frames, np.ascontiguousarray(then),
        np.ascontiguousarray(now), p[:n_then].reshape(*then.shape[:2], 3),
        C[:n_then].reshape(*then.shape[:2], 3, 3), p[n_then:], C[n_then:], noise,
    )  # fmt: skip


def look_back_rows(
    table: FeatureTable, window_ns: IntArray, look_back_s: tuple[float, ...]
) -> IntArray:
    """Earlier rows (L,) with a known pose, oldest first: near each look-back time, and the last."""
    posed = np.isin(table.clone_ns, window_ns)
    posed[-1] = False
    rows = np.flatnonzero(posed)
    if len(rows) == 0:
        return rows
    age_ns = table.frame_ns[-1] - table.frame_ns[rows]
    wanted_ns = np.round(1e9 * np.array(look_back_s)).astype(np.int64)
    apart = np.abs(age_ns[None] - wanted_ns[:, None])  # integers: rounding decides no tie
    near = apart.min(1) < _TOLERANCE * wanted_ns
    return np.unique(np.append(rows[apart.argmin(1)[near]], rows[-1]))
