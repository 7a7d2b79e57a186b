"""Which features the tracks hold, which join them and which leave them."""

from collections.abc import Sequence
from math import log

import numpy as np

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.interfaces import HiddenFeatures
from ovmot.kernels.table_kernel import columns_of_compiled
from ovmot.objects.body import (
    LEAST_SEEN,
    MOST_IN_STATE,
    VELOCITY,
    exchange_members,
    with_members,
)
from ovmot.objects.body_box import gap_of
from ovmot.objects.body_step_kernel import FrameViews
from ovmot.objects.feature_motions import FeatureMotions
from ovmot.objects.merging import BESIDE_NS
from ovmot.objects.reappearance import full_braking, unseen
from ovmot.objects.track import Track, TrackState, horizontal_variance
from ovmot.objects.track_features_kernel import (
    Held,
    Hulls,
    Limits,
    Moving,
    carried_by_compiled,
    joining_and_leaving_compiled,
    near_hulls_compiled,
    nearest_of_compiled,
    owners_of_compiled,
    recovering_compiled,
)
from ovmot.physics import MAX_VEHICLE_SIZE_M, gate

LIMITS = Limits(
    margin_m=0.5,  # a body is larger than what was seen of it
    sigmas=2.0,
    spread_mps=0.2,
    same=gate(3, 0.99),
    least_mps=1.0,
    share=0.3,
    clearly=2.0 * log(100.0),  # one motion is a hundred times likelier
)

_NONE = np.empty(0, np.int64)


def hulls_of(tracks: Sequence[Track]) -> Hulls:
    """Those of T tracks."""
    T, boxes = len(tracks), [t.box for t in tracks]
    return Hulls(
        np.array([box.hull_centre for box in boxes]).reshape(T, 3),
        np.array([box.hull_size for box in boxes]).reshape(T, 3),
        np.array([box.yaw for box in boxes], np.float64),
        np.array([2.0 * horizontal_variance(t) for t in tracks], np.float64),
        np.array([box.velocity for box in boxes]).reshape(T, 3),
        np.array([box.covariance[3:, 3:] for box in boxes]).reshape(T, 3, 3),
    )


def moving_of(motions: FeatureMotions) -> Moving:
    """Places and velocities of N features."""
    return Moving(
        motions.p_world, motions.position_cov, motions.velocity, motions.velocity_cov
    )  # fmt: skip


def held_by(tracks: Sequence[Track]) -> Held:
    """The features that T tracks hold."""
    ids = [t.feature_id for t in tracks]
    first = np.zeros(len(ids) + 1, np.int64)
    first[1:] = np.cumsum([len(own) for own in ids])
    return Held(np.concatenate([_NONE, *ids]), first)


def owners(held: Held, holds: BoolArray, feature_id: IntArray) -> IntArray:
    """The row of the track that holds each feature (N,), of those that hold any (T,); -1 for none,
    and the last of several."""
    return owners_of_compiled(held, holds, feature_id)


def are_seen(tracks: Sequence[Track]) -> BoolArray:
    """Which tracks (T,) do not coast: those that do hold no feature of the frame."""
    return np.array([t.state != TrackState.COASTING for t in tracks], np.bool_)


def ids_of(tracks: Sequence[Track]) -> IntArray:
    """The tracks' ids (T + 1,), with -1 at the end: that of no track, of row -1."""
    return np.array([*(t.track_id for t in tracks), -1], np.int64)


def own_features(
    tracks: Sequence[Track], hulls: Hulls, i: int, ids: IntArray, frame: FrameViews
) -> IntArray:
    """Those of the features (k,) that may be of track i's body, and are no nearer to another one.

    With each of them its hull must be no larger than vehicles are, nor have a greater gap.
    """
    at = columns_of_compiled(ids, frame.feature_id)
    p, C = frame.p_world[at], frame.cov_world[at]
    sigma = np.sqrt(np.einsum("nii->n", C))
    rivals = np.array([t.state == TrackState.CONFIRMED for t in tracks])
    gap, greatest = gap_of(tracks[i].box), np.array(MAX_VEHICLE_SIZE_M)
    return ids[nearest_of_compiled(i, p, sigma, hulls, rivals, gap, greatest)]


def recovered(tracks: Sequence[Track], motions: FeatureMotions, frame: FrameViews) -> list[Track]:
    """The tracks, those that were lost with the features in their boxes that move as they do, if
    there are enough."""
    seen = are_seen(tracks)
    if seen.all():
        return list(tracks)
    hulls, moving = hulls_of(tracks), moving_of(motions)
    in_box = near_hulls_compiled(hulls, moving, LIMITS)
    candidate = recovery_candidates(
        tracks, in_box, owners(held_by(tracks), seen, motions.feature_id)
    )
    own = recovering_compiled(candidate & ~seen[:, None], hulls, moving, LIMITS)
    out = list(tracks)
    for k in np.flatnonzero(own.sum(1) >= LEAST_SEEN).tolist():
        body = with_members(out[k].body, frame, motions.feature_id[own[k]])
        out[k] = out[k]._replace(
            body=body, state=TrackState.CONFIRMED, updated_ns=frame.timestamp_ns
        )
    return out


def recovery_candidates(tracks: Sequence[Track], in_box: BoolArray, owner: IntArray) -> BoolArray:
    """Features (T, N) by which each track may be found again.

    Those in its box, `in_box` (T, N), that no other track, a row `owner` (N,), holds, and that are
    not in the box of a body that was seen beside it.
    """
    in_view = np.array([t.state == TrackState.CONFIRMED for t in tracks], dtype=np.bool_)
    born = np.array([t.born_ns for t in tracks], dtype=np.int64)
    updated = np.array([t.updated_ns for t in tracks], dtype=np.int64)
    beside = in_view & (born + BESIDE_NS < updated[:, None])
    np.fill_diagonal(beside, False)
    rows = np.arange(len(tracks))[:, None]
    candidate: BoolArray = in_box & ~(beside @ in_box) & ((owner < 0) | (owner == rows))
    return candidate


def with_exchanged_features(
    tracks: Sequence[Track], hulls: Hulls, motions: FeatureMotions, frame: FrameViews
) -> list[Track]:
    """The tracks with the features that they hold now, as many in their states as have room.

    Free features in a track's box that move as it does and do not rest join it; those that clearly
    rest leave it: they lie behind it. Of two tracks the older one keeps a common feature.
    """
    if not tracks:
        return []
    joins, leaves = joining_and_leaving_compiled(
        held_by(tracks), motions.feature_id, hulls, moving_of(motions),
        np.array([t.state == TrackState.CONFIRMED for t in tracks]), are_seen(tracks), LIMITS,
    )  # fmt: skip
    ids = motions.feature_id
    return [
        track._replace(body=exchange_members(track.body, frame, ids[leaves[k]], ids[joins[k]]))
        for k, track in enumerate(tracks)
    ]


def velocities_of_members(
    held: Held, hulls: Hulls, motions: FeatureMotions
) -> tuple[IntArray, FloatArray]:
    """Features (K,) that move on with a track, ids and velocity (K, 3) in world: those that are
    `held` by it, and those near it whose motion is not known. `hulls` are those of the tracks."""
    row = carried_by_compiled(held, motions.feature_id, hulls, moving_of(motions), LIMITS)
    carried = row >= 0
    return motions.feature_id[carried], hulls.velocity[row[carried]]


def hidden_features(tracks: Sequence[Track], frame: FrameViews) -> HiddenFeatures:
    """Features of bodies that are out of sight, or nearly, where their maps have them now: of each
    up to twice as many as its state holds, those that were seen most often."""
    lost = [
        t for t in tracks if t.state != TrackState.TENTATIVE and t.body.n_used <= LEAST_SEEN
    ]  # fmt: skip
    maps = [t.body.map for t in lost]
    chosen = [np.argsort(-m.n_seen, kind="stable")[: 2 * MOST_IN_STATE] for m in maps]
    n = [len(rows) for rows in chosen]
    late = [unseen(t.body, 1e-9 * (frame.timestamp_ns - t.updated_ns)).state for t in lost]
    places = [
        s.x[:3] + m.f[rows] @ so3.rotation_z(s.x[3]).T
        for s, m, rows in zip(late, maps, chosen, strict=True)
    ]
    sigma = [np.sqrt(0.5 * (s.P[0, 0] + s.P[1, 1])) for s in late]
    velocity = np.array([s.x[VELOCITY] for s in late]).reshape(-1, 3)
    return HiddenFeatures(
        frame.timestamp_ns,
        np.concatenate(
            [_NONE, *(m.feature_id[rows] for m, rows in zip(maps, chosen, strict=True))]
        ),
        np.repeat(np.arange(len(lost)), n),
        se3.apply(frame.T_cam0_world, np.concatenate([np.empty((0, 3)), *places])),
        np.repeat(np.array(sigma, np.float64), n),
        np.repeat(velocity @ frame.T_world_cam0[:3, :3], n, axis=0),
    )


def hidden_places(tracks: Sequence[Track], frame: FrameViews) -> FloatArray:
    """Where the bodies that coast may come into sight (K, 3), in the left camera: from where they
    go on to, to where they would be had they braked fully, a vehicle's width apart."""
    places = [np.empty((0, 3))]
    for track in tracks:
        if track.state == TrackState.COASTING:
            late = full_braking(track.body, 1e-9 * (frame.timestamp_ns - track.updated_ns)).late
            n = 1 + int(np.hypot(late[0], late[1]) / MAX_VEHICLE_SIZE_M[1])
            places.append(track.position - np.linspace(np.zeros(3), [*late, 0.0], n + 1))
    return se3.apply(frame.T_cam0_world, np.concatenate(places))
