"""Tracking without measurement: updates by features that have a track's velocity, or coasting.

A car that stops stays a track by its own features; one that was hidden is found again by features
in its box.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.id_sets import contained, without
from ovmot.geometry.triangulation import inverse_3x3, squared_distance
from ovmot.objects.feature_motions import SPEED_SPREAD, FeatureMotions, moving_with
from ovmot.objects.merging import BESIDE_NS
from ovmot.objects.motion_models import VELOCITY
from ovmot.objects.object_filter import distance, observe, update
from ovmot.objects.track import Track, TrackState, centre_sigma
from ovmot.physics import MAX_ACCEL_MPS2, gate

_MIN_FEATURES = 3
_MOST_FEATURES = 24  # of one body: more add little
_MIN_FOUND = 2  # features with a track's velocity in its box by which it is found again


@dataclass(frozen=True, slots=True)
class UnmeasuredBody:
    """Centre, velocity and their covariance (6, 6) of features with one velocity.

    `outlier_id`: ids of the features asked for that have another one.
    """

    position: FloatArray
    velocity: FloatArray
    covariance: FloatArray
    outlier_id: IntArray


def update_unmeasured(
    track: Track,
    motions: FeatureMotions,
    in_box: BoolArray,
    candidate: BoolArray,
    now_ns: int,
) -> Track:
    """The track updated by features in place of a measurement; coasting where there are none.

    `in_box` (N,): features in its predicted box; `candidate` (N,): those by which it may be found
    again.
    """
    if track.state == TrackState.TENTATIVE:
        return _missed(track)
    own = in_box & contained(motions.feature_id, track.feature_id)
    by_own = consistent_body(motions, own, track.velocity)
    for body in (by_own, _found_again(track, motions, candidate)):
        if body is None or not _is_feasible(track, body, now_ns):
            continue
        R = _with_centre_variance(body, track)
        observation = observe(body.position - track.offset, body.velocity, R)
        if distance(track.filter, observation) > gate(6, 0.999):  # of something else
            continue
        updated = update(track.filter, observation)
        return replace(
            track,
            state=TrackState.CONFIRMED,
            filter=updated,
            offset=body.position - updated.best.state[:3],
            feature_id=without(track.feature_id, body.outlier_id),
            updated_ns=now_ns,
        )
    return _missed(track)


def recovery_candidates(
    tracks: Sequence[Track], in_box: BoolArray, track_id: IntArray
) -> BoolArray:
    """Features (T, N) by which each track may be found again.

    Those in its box, `in_box` (T, N), that no other track holds by `track_id` (N,), and that are
    not in the box of a body that was seen beside it.
    """
    in_view = np.array([t.state == TrackState.CONFIRMED for t in tracks], dtype=np.bool_)
    born = np.array([t.born_ns for t in tracks], dtype=np.int64)
    updated = np.array([t.updated_ns for t in tracks], dtype=np.int64)
    beside = in_view & (born + BESIDE_NS < updated[:, None])
    np.fill_diagonal(beside, False)
    own_id = np.array([t.track_id for t in tracks], dtype=np.int64)
    candidate: BoolArray = (
        in_box & ~(beside @ in_box) & ((track_id < 0) | (track_id == own_id[:, None]))
    )
    return candidate


def consistent_body(
    motions: FeatureMotions, own: BoolArray, velocity: FloatArray
) -> UnmeasuredBody | None:
    """The body of the largest set of a track's `own` features (N,) with one velocity.

    `velocity` (3,): that of the track. None where fewer than three features agree.
    """
    index = np.flatnonzero(own & motions.known)
    if len(index) < _MIN_FEATURES:
        return None
    index = index[:: -(-len(index) // _MOST_FEATURES)]
    v, C = motions.velocity[index], motions.velocity_cov[index]
    agree = _largest_consensus(v, C, velocity)
    if agree.sum() < _MIN_FEATURES:
        return None
    return _body_of(motions, index[agree], motions.feature_id[index[~agree]])


def _found_again(
    track: Track, motions: FeatureMotions, candidate: BoolArray
) -> UnmeasuredBody | None:
    """The body of the `candidate` features with the track's velocity; None where they are few."""
    P = track.filter.best.covariance[VELOCITY, VELOCITY]
    with_track = moving_with(motions, candidate, track.velocity, P)
    if with_track.sum() < _MIN_FOUND:
        return None
    return _body_of(motions, np.flatnonzero(with_track), np.empty(0, dtype=np.int64))


def _is_feasible(track: Track, body: UnmeasuredBody, now_ns: int) -> bool:
    """Can a track have reached this velocity since it was last seen?

    Not by an acceleration beyond a road user's, and not where rest explains the velocity better
    than the hardest braking: then the features are static ones that the body has left behind.
    """
    most = MAX_ACCEL_MPS2 * 1e-9 * (now_ns - track.updated_ns)
    C = body.covariance[3:, 3:]
    change = body.velocity - track.velocity
    size = max(float(np.linalg.norm(change)), 1e-9)
    sigma = float(np.sqrt(change @ C @ change)) / size
    speed = float(np.linalg.norm(track.velocity))
    braked = track.velocity * max(1.0 - most / max(speed, 1e-9), 0.0)
    residual = np.stack([body.velocity - braked, body.velocity])
    from_braked, from_rest = (residual * np.linalg.solve(C, residual.T).T).sum(1)
    return bool(size < most + 3.0 * sigma and from_braked <= from_rest)


def _missed(track: Track) -> Track:
    """A tentative track must be measured in consecutive frames: its count begins again."""
    if track.state == TrackState.TENTATIVE:
        return replace(track, hits=0, evidence=0.0)
    return replace(track, state=TrackState.COASTING)


def _with_centre_variance(body: UnmeasuredBody, track: Track) -> FloatArray:
    """The covariance (6, 6), with that of the centre of whatever parts of the body are seen."""
    P = body.covariance.copy()
    P[:3, :3] += centre_sigma(track.size) ** 2 * np.eye(3)
    return P


def _body_of(motions: FeatureMotions, index: IntArray, outlier_id: IntArray) -> UnmeasuredBody:
    """The body of features with one velocity: its weighted mean, and the centre of their box."""
    W = inverse_3x3(motions.velocity_cov[index])
    P_v = inverse_3x3(W.sum(0))
    mean = P_v @ (W @ motions.velocity[index][..., None])[..., 0].sum(0)
    points = motions.p_world[index]
    P = np.zeros((6, 6))
    P[:3, :3] = motions.position_cov[index].mean(0) / len(index) + 0.01 * np.eye(3)
    P[3:, 3:] = P_v + motions.change[index].mean() * np.eye(3)
    return UnmeasuredBody(0.5 * (points.min(axis=0) + points.max(axis=0)), mean, P, outlier_id)


def _largest_consensus(
    velocity: FloatArray, C: FloatArray, track_velocity: FloatArray
) -> BoolArray:
    """The largest set (N,) of features whose velocities agree with that of one of them."""
    dv = velocity[:, None] - velocity[None]
    spread = C[:, None] + C[None] + SPEED_SPREAD**2 * np.eye(3)
    votes = squared_distance(dv, spread) < gate(3, 0.975)
    # among equals the one nearest to the track's velocity
    off = np.linalg.norm(velocity - track_velocity, axis=1)
    return np.asarray(votes[int(np.lexsort((off, -votes.sum(1)))[0])])
