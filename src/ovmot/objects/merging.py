"""Merging of duplicates: two tracks of one body become one."""

from collections.abc import Sequence

import numpy as np

from ovmot.geometry.so3 import rotation_z
from ovmot.objects.body_box import gap_of
from ovmot.objects.track import Track, TrackState
from ovmot.objects.track_features_kernel import Hulls, alike_velocities_compiled
from ovmot.physics import (
    CAR_SIZE_M,
    CYCLIST_SIZE_M,
    LEAST_HEADWAY_S,
    MAX_VEHICLE_SIZE_M,
    SIGMAS_95,
    SIZE_SPREAD,
    YAW_RATE_SIGMA_RPS,
    gate,
)

_MERGE_FRAMES = 3  # in a row after which a track that lies on an older one ends
_HALVES_MPS = YAW_RATE_SIGMA_RPS * 0.25 * CAR_SIZE_M[0]  # of the halves of a car that turns
_MAX_RIDER_M = (1.0 + SIGMAS_95 * SIZE_SPREAD) * np.array(CYCLIST_SIZE_M)
BESIDE_NS = 500_000_000
"""Two tracks that were seen together for so long are two bodies."""


def merge_duplicates(tracks: Sequence[Track], hulls: Hulls) -> tuple[Track, ...]:
    """The T tracks, those merged with an older one of which they were duplicates for some frames.

    The older one's id stays, with the state of the one with more features. Until then a new
    duplicate stays tentative. `hulls` are those of the tracks.
    """
    alike = alike_velocities_compiled(hulls, _HALVES_MPS, gate(3, 0.99))
    out: dict[int, Track] = {}  # by the row of the hull that each of them has
    for k, track in enumerate(tracks):
        older = next((i for i in out if alike[i, k] and _are_one(track, out[i])), None)
        if older is None:
            out[k] = track._replace(overlaps=max(track.overlaps - 1, 0))
        elif track.overlaps + 1 < _MERGE_FRAMES:
            young = (
                track.state == TrackState.CONFIRMED and track.updated_ns - track.born_ns < BESIDE_NS
            )
            state = TrackState.TENTATIVE if young else track.state
            out[k] = track._replace(state=state, overlaps=track.overlaps + 1)
        else:
            out[older] = _merge(out[older], track)
    return tuple(out.values())


def _merge(track: Track, other: Track) -> Track:
    """A track and a younger one of the same body: with the state of the one with more features."""
    known = track if len(track.feature_id) >= len(other.feature_id) else other
    return known._replace(track_id=track.track_id, overlaps=0)


def _are_one(track: Track, other: Track) -> bool:
    """Can two tracks of one velocity be of one body: has a vehicle a hull like that around both?"""
    sigma = sum(float(np.sqrt(t.body.state.P[0, 0] + t.body.state.P[1, 1])) for t in (track, other))
    more = max(track, other, key=lambda t: len(t.feature_id))
    less = other if more is track else track
    offset = rotation_z(more.box.yaw).T @ (less.box.hull_centre - more.box.hull_centre)
    half = 0.5 * more.box.hull_size
    turned = np.abs(rotation_z(less.box.yaw - more.box.yaw)) @ (0.5 * less.box.hull_size)
    gap = np.maximum(np.abs(offset) - half - turned, 0.0)
    whole = np.maximum(half, offset + turned) - np.minimum(-half, offset - turned)
    if more.box.is_vehicle and bool((whole[:2] <= np.array(CAR_SIZE_M[:2])).all()):
        return True  # two vehicles have no room where one car has
    largest = MAX_VEHICLE_SIZE_M if more.box.is_vehicle else _MAX_RIDER_M
    fits = bool((whole <= np.maximum(2.0 * half, largest)).all())
    apart = float(np.hypot(gap[0], gap[1]))
    headway = LEAST_HEADWAY_S * float(np.hypot(*more.velocity[:2]))
    if more.box.is_vehicle and fits and apart < min(gap_of(more.box), headway):
        return True  # who follows a vehicle keeps more room
    if _beside(track, other):  # as two for a while: two bodies, unless one lies in the other
        return apart == 0.0
    return fits and apart < gap_of(more.box) + sigma


def _beside(track: Track, other: Track) -> bool:
    """Were they seen side by side?"""
    return max(track.born_ns, other.born_ns) + BESIDE_NS <= min(track.updated_ns, other.updated_ns)
