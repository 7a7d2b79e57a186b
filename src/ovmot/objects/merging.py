"""Merging of duplicates: two tracks of one body become one."""

from collections.abc import Sequence
from dataclasses import replace
from math import hypot

import numpy as np

from ovmot.objects.bodies_kernel import velocity_distance_compiled
from ovmot.objects.motion_models import VELOCITY
from ovmot.objects.track import DRIVES_MPS, Track, TrackState
from ovmot.objects.track_box import centre_distances
from ovmot.physics import CAR_SIZE_M, MAX_VEHICLE_SIZE_M, gate
from ovmot.settings import ObjectTrackSettings

_MERGE_FRAMES = 3  # in a row after which a track that lies on an older one ends
_SAME_SPEED_MPS, _SPEED_SPREAD = 1.5, 0.3
_FEW_OF_MANY = 0.1
_GAP_M = 2.5  # without features, between two ends of a lorry
_SIGMAS = 3.0  # of the position of a coasting track
BESIDE_NS = 500_000_000
"""Two tracks that were seen together for so long are two bodies."""


def merge_duplicates(tracks: Sequence[Track], settings: ObjectTrackSettings) -> tuple[Track, ...]:
    """The tracks, those merged with an older one of which they were duplicates for some frames.

    The older one's id stays, with the state of the one with more features. Until then a new
    duplicate stays tentative.
    """
    out: list[Track] = []
    for track in tracks:
        older = next((k for k, other in enumerate(out) if _are_duplicates(track, other)), None)
        if older is None:
            new = track.hits <= settings.confirm_hits
            part = new and any(_may_be_part_of(track, other) for other in out)
            state = TrackState.TENTATIVE if part else track.state
            out.append(replace(track, state=state, overlaps=max(track.overlaps - 1, 0)))
        elif track.overlaps + 1 < _MERGE_FRAMES:
            young = track.hits <= settings.confirm_hits + _MERGE_FRAMES
            state = TrackState.TENTATIVE if young else track.state
            out.append(replace(track, state=state, overlaps=track.overlaps + 1))
        else:
            out[older] = _merge(out[older], track)
    return tuple(out)


def _may_be_part_of(track: Track, other: Track) -> bool:
    """Can a new track be another part of a vehicle that has a track?"""
    along, across = centre_distances(track, other)
    gap = along - 0.5 * (track.size[0] + other.size[0])
    return bool(gap < _GAP_M and across < MAX_VEHICLE_SIZE_M[1] and _same_velocity(track, other))


def _merge(track: Track, other: Track) -> Track:
    """A track and a younger one of the same body: with the state of the one with more features."""
    ids = np.union1d(track.feature_id, other.feature_id)
    known = track if len(track.feature_id) >= len(other.feature_id) else other
    return replace(known, track_id=track.track_id, feature_id=ids, overlaps=0)


def _are_duplicates(track: Track, other: Track) -> bool:
    """Is one inside the other, or do they overlap with one velocity?"""
    if TrackState.COASTING not in (track.state, other.state) and (
        _is_within(track, other) or _is_within(other, track)
    ):
        return True
    along, across = centre_distances(track, other)
    slack = _slack(track, other)
    along, across = max(along - slack, 0.0), max(across - slack, 0.0)
    reach = 0.5 * (other.size + np.minimum(track.size, other.size))
    near = along < max(reach[0], 1.0) and across < max(0.7 * reach[1], 0.7)
    driving = min(hypot(*track.velocity), hypot(*other.velocity)) > DRIVES_MPS
    near |= (
        driving and along < CAR_SIZE_M[0] and across < 0.5 * CAR_SIZE_M[1]
    )  # two ends of a vehicle
    near |= driving and _is_far_end(track, other, along, across)
    return bool(near and _same_velocity(track, other))


def _slack(track: Track, other: Track) -> float:
    """How much nearer two centres may be than estimated, metres: where one of the tracks coasts and
    they were not seen side by side."""
    together = track.born_ns + BESIDE_NS <= other.updated_ns
    if together or TrackState.COASTING not in (track.state, other.state):
        return 0.0
    P = sum(t.filter.best.covariance[:2, :2] for t in (track, other))
    return _SIGMAS * float(np.sqrt(0.5 * np.trace(P)))


def _same_velocity(track: Track, other: Track) -> bool:
    """Are two velocities equal within their covariance, and within a walker's speed?"""
    dv = track.velocity - other.velocity
    own, others = (t.filter.best.covariance[VELOCITY, VELOCITY] for t in (track, other))
    P = own + others
    distance = velocity_distance_compiled(dv, np.ascontiguousarray(P), _SPEED_SPREAD)
    return distance < gate(3, 0.99) and hypot(*dv) < _SAME_SPEED_MPS


def _is_far_end(track: Track, other: Track, along: float, across: float) -> bool:
    """Can a track of few features be the far end of one that has many?"""
    few = len(track.feature_id) < _FEW_OF_MANY * len(other.feature_id)
    gap = along - 0.5 * (track.size[0] + other.size[0])
    width = across + 0.5 * (track.size[1] + other.size[1])
    return bool(few and gap < _GAP_M and width < MAX_VEHICLE_SIZE_M[1])


def _is_within(track: Track, other: Track) -> bool:
    """Is a track's centre inside the box of another one with more features?"""
    along, across = centre_distances(track, other)
    inner = along < 0.5 * other.size[0] and across < 0.5 * min(other.size[1], CAR_SIZE_M[1])
    return bool(inner and len(track.feature_id) < len(other.feature_id))
