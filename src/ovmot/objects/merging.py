"""Two tracks on one body become one."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ovmot.objects.motion_models import VELOCITY
from ovmot.objects.track import DRIVES_MPS, Track, TrackState
from ovmot.settings import ObjectTrackSettings

_SAME_SPEED_MPS, _SPEED_SPREAD = 1.5, 0.3
_ALIKE_GATE = 11.34  # 99 % of chi-squared with 3 degrees of freedom
_LENGTH_M, _HALF_WIDTH_M = 4.0, 1.0  # nearer than this, two middles are of one vehicle
_FEW_OF_MANY = 0.1
_GAP_M = 2.5  # without features, between two ends of a lorry
_BODY_WIDTH_M = 3.2  # boxes of few points are too wide
_WIDTH_M = 2.0  # within a box that is wider, there may be two bodies
_SIGMAS = 3.0  # by which a body that is not seen may be off
BESIDE_NS = 500_000_000
"""Two tracks that were seen together for so long are two bodies."""


def merged(tracks: Sequence[Track], settings: ObjectTrackSettings) -> tuple[Track, ...]:
    """Tracks that have lain on an older one for some frames become one with it.

    The older one's id stays, with what the one of more features knows. Until then a new one that
    lies on an older one is not believed.
    """
    out: list[Track] = []
    for track in tracks:
        over = next((k for k, other in enumerate(out) if _same_body(track, other)), None)
        if over is None:
            new = track.hits <= settings.confirm_hits
            part = new and any(_may_be_part(track, other) for other in out)
            state = TrackState.TENTATIVE if part else track.state
            out.append(replace(track, state=state, overlaps=max(track.overlaps - 1, 0)))
        elif track.overlaps + 1 < settings.merge_frames:
            young = track.hits <= settings.confirm_hits + settings.merge_frames
            state = TrackState.TENTATIVE if young else track.state
            out.append(replace(track, state=state, overlaps=track.overlaps + 1))
        else:
            out[over] = _united(out[over], track)
    return tuple(out)


def _may_be_part(track: Track, other: Track) -> bool:
    """Can a new track be of another part of a vehicle that has a track?"""
    along, across = _apart(track, other)
    gap = along - 0.5 * (track.size[0] + other.size[0])
    return bool(gap < _GAP_M and across < _BODY_WIDTH_M and _goes_like(track, other))


def _united(track: Track, other: Track) -> Track:
    """A track and a younger one of the same body: as the one of more features knows it."""
    ids = np.union1d(track.feature_id, other.feature_id)
    known = track if len(track.feature_id) >= len(other.feature_id) else other
    return replace(known, track_id=track.track_id, feature_id=ids, overlaps=0)


def _same_body(track: Track, other: Track) -> bool:
    """Is one in the other, where no second body can be, or do they overlap and move alike?"""
    if TrackState.COASTING not in (track.state, other.state) and (
        _is_within(track, other) or _is_within(other, track)
    ):
        return True
    along, across = _apart(track, other)
    slack = _slack(track, other)
    along, across = max(along - slack, 0.0), max(across - slack, 0.0)
    reach = 0.5 * (other.size + np.minimum(track.size, other.size))
    near = along < max(reach[0], 1.0) and across < max(0.7 * reach[1], 0.7)
    drive = min(np.linalg.norm(track.velocity), np.linalg.norm(other.velocity)) > DRIVES_MPS
    near |= drive and along < _LENGTH_M and across < _HALF_WIDTH_M  # two ends of a vehicle
    near |= drive and _is_piece(track, other, along, across)
    return bool(near and _goes_like(track, other))


def _slack(track: Track, other: Track) -> float:
    """How much nearer two middles may be than they seem, where one of the tracks is not seen, and
    they have not been seen together: metres."""
    together = track.born_ns + BESIDE_NS <= other.updated_ns
    if together or TrackState.COASTING not in (track.state, other.state):
        return 0.0
    P = sum(t.filter.best.covariance[:2, :2] for t in (track, other))
    return _SIGMAS * float(np.sqrt(0.5 * np.trace(P)))


def _goes_like(track: Track, other: Track) -> bool:
    """Are two velocities the same, within their covariance and by no more than a walker's speed?"""
    dv = track.velocity - other.velocity
    P = sum(t.filter.best.covariance[VELOCITY, VELOCITY] for t in (track, other))
    C = P + _SPEED_SPREAD**2 * np.eye(3)
    alike = dv @ np.linalg.solve(C, dv) < _ALIKE_GATE
    return bool(alike and np.linalg.norm(dv) < _SAME_SPEED_MPS)


def _is_piece(track: Track, other: Track, along: float, across: float) -> bool:
    """Can a track of few features be the far end of one that has many?"""
    few = len(track.feature_id) < _FEW_OF_MANY * len(other.feature_id)
    gap = along - 0.5 * (track.size[0] + other.size[0])
    width = across + 0.5 * (track.size[1] + other.size[1])
    return bool(few and gap < _GAP_M and width < _BODY_WIDTH_M)


def _is_within(track: Track, other: Track) -> bool:
    """Is a track's middle inside the box of another one with more features?"""
    along, across = _apart(track, other)
    inner = along < 0.5 * other.size[0] and across < 0.5 * min(other.size[1], _WIDTH_M)
    return bool(inner and len(track.feature_id) < len(other.feature_id))


def _apart(track: Track, other: Track) -> tuple[float, float]:
    """Distances of the middles, along and across the other's heading, metres."""
    apart = track.position - other.position
    c, s = np.cos(other.yaw), np.sin(other.yaw)
    return abs(c * apart[0] + s * apart[1]), abs(-s * apart[0] + c * apart[1])
