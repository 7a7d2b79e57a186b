"""Where the points of one camera are, while no stereo match tells it."""

import numpy as np

from ovmot.frontend.klt_tracker import TrackedPoints
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.id_sets import positions
from ovmot.geometry.triangulation import triangulate_stereo


def positions_by_motion(
    before: TrackedPoints, now: TrackedPoints, T_now_before: FloatArray
) -> FloatArray:
    """Points (N, 3) in the present camera, metres, from the last two views; NaN for new ones.

    Only as good as the predicted motion; it serves to predict how the points go on.
    """
    at = positions(now.feature_id, before.feature_id)
    pairs = np.full((len(now), 4), np.nan)
    pairs[:, :2], pairs[at >= 0, 2:] = now.xy, before.xy[at[at >= 0]]
    return triangulate_stereo(pairs, se3.inverse(T_now_before))


def carried_positions(
    before: TrackedPoints, now: TrackedPoints, p_before: FloatArray, T_now_before: FloatArray
) -> FloatArray:
    """Points (N, 3) in the present camera, metres: at rest where they were, `p_before` (M, 3) in
    the camera of then, on the ray of now; of others, from the last two views."""
    at = positions(now.feature_id, before.feature_id)
    p = np.full((len(now), 3), np.nan)
    p[at >= 0] = se3.apply(T_now_before, p_before[at[at >= 0]])
    ray = np.concatenate([now.xy, np.ones((len(now), 1))], axis=1)
    with np.errstate(invalid="ignore"):
        p = np.where(p[:, 2:] > 0.0, ray * p[:, 2:], np.nan)
    return np.where(np.isfinite(p), p, positions_by_motion(before, now, T_now_before))
