"""Which features the ego filter leaves alone, since a tracked body has them."""

import numpy as np

from ovmot.geometry.arrays import IntArray
from ovmot.types import PointLabel, ScenePoints


def excluded_features(seen: ScenePoints, most_share: float) -> IntArray:
    """Ids of the points of bodies that move, or may, whatever the split says of each by itself.

    Of all points at most `most_share`: the bodies with most points stay in the filter's view, since
    one that has most of the picture may be the street, taken for a body.
    """
    has = (seen.track_id >= 0) & (seen.label != int(PointLabel.STATIC))
    bodies, count = np.unique(seen.track_id[has], return_counts=True)
    smallest_first = np.argsort(count, kind="stable")
    within = np.cumsum(count[smallest_first]) <= most_share * len(seen.feature_id)
    ids: IntArray = seen.feature_id[has & np.isin(seen.track_id, bodies[smallest_first][within])]
    return ids
