"""What the tracks say of the points: one that belongs to a body does what the body does."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ovmot.geometry.arrays import BoolArray, IntArray
from ovmot.objects.followed import FeatureMotions, rest_or_body
from ovmot.objects.motion_models import VELOCITY
from ovmot.objects.track import Track, TrackState
from ovmot.types import PointLabel, ScenePoints

_MOVING_MPS = 0.85  # below a walker's pace: a body that is surely as fast has points that move
_CLEAR = 9.0  # squared sigmas by which rest must explain a point of it better


def label_points(
    seen: ScenePoints,
    owner: IntArray,
    tracks: Sequence[Track],
    motions: FeatureMotions,
    before: IntArray,
) -> ScenePoints:
    """The N points with the ids of their tracks, `owner` (N,), -1 for none.

    Those of a confirmed track are dynamic or static as the track is, but for points which clearly
    rest beside one that moves. A point of no track that moves must have done so `before` (ids of
    the last frame): else it is unknown, for one wrong match looks like that.
    """
    label = seen.label.copy()
    new = (owner < 0) & (label == int(PointLabel.DYNAMIC)) & ~np.isin(seen.feature_id, before)
    label[new] = int(PointLabel.UNKNOWN)
    for track in tracks:
        if track.state == TrackState.CONFIRMED:
            own = owner == track.track_id
            label[own] = np.where(
                _moves_with(track, own, motions), int(PointLabel.DYNAMIC), int(PointLabel.STATIC)
            )
    return replace(seen, track_id=owner, label=label)


def moving_ids(seen: ScenePoints) -> IntArray:
    """Ids of the points that the split found moving."""
    ids: IntArray = seen.feature_id[seen.label == int(PointLabel.DYNAMIC)]
    return ids


def _moves_with(track: Track, own: BoolArray, motions: FeatureMotions) -> BoolArray:
    """Which of a track's own points move as it does."""
    P = track.filter.best.covariance[VELOCITY, VELOCITY]
    speed = float(np.linalg.norm(track.velocity))
    sigma = float(np.sqrt(track.velocity @ P @ track.velocity)) / max(speed, 1e-9)
    if speed - sigma < _MOVING_MPS:
        return np.zeros(int(own.sum()), dtype=np.bool_)
    at_rest, with_body = rest_or_body(motions, np.flatnonzero(own), track.velocity, P)
    rests: BoolArray = at_rest + _CLEAR < with_body
    return ~rests
