"""Landmarks in the state: where they are, how they are seen, how they come and change their anchor.

Initialised late, from all that the window saw of them (M. Li & A. Mourikis, RSS 2012): the rows of
that measurement which determine the landmark give its value and covariance; the others update, as
those of any feature.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.vio.innovation_consistency import innovation_consistency
from ovmot.vio.landmarks import NO_ANCHOR, Landmarks
from ovmot.vio.msckf_features import (
    PointRows,
    chi2_gate,
    innovation_distances,
    reproject,
    triangularize,
)
from ovmot.vio.state import CLONE_SIZE, Clones, State
from ovmot.vio.update import ekf_update


@dataclass(frozen=True, slots=True)
class LandmarkPoints:
    """World points (L, 3) and their derivatives by values (L, 3, 3) and anchor poses (L, 3, 6).

    `anchor` (L,): index of the anchor's clone, -1 for none, where the derivative is zero.
    """

    p_world: FloatArray
    by_value: FloatArray
    by_anchor: FloatArray
    anchor: IntArray


def landmark_points(
    landmarks: Landmarks, clones: Clones, T_imu_anchor: FloatArray, *, first: bool
) -> LandmarkPoints:
    """Where the landmarks are, by the latest or by the first estimates."""
    value = landmarks.first if first else landmarks.value
    coordinates = landmarks.representation.coordinates
    p, J = coordinates.to_point(value), coordinates.jacobian(value)
    nothing = np.zeros((len(p), 3, CLONE_SIZE))
    if not landmarks.representation.anchored or not len(p):
        return LandmarkPoints(p, J, nothing, np.full(len(p), NO_ANCHOR))
    anchor = np.searchsorted(clones.timestamp_ns, landmarks.anchor_ns)
    T = (clones.T_world_imu_first if first else clones.T_world_imu)[anchor]
    p_imu = se3.apply(T_imu_anchor, p)
    R = T[:, :3, :3]
    nothing[..., :3] = -R @ so3.hat(p_imu)
    nothing[..., 3:] = np.eye(3)
    p_world = (R @ p_imu[..., None])[..., 0] + T[:, :3, 3]
    return LandmarkPoints(p_world, R @ T_imu_anchor[:3, :3] @ J, nothing, anchor)


def landmark_system(
    state: State, rig: StereoRig, T_imu_anchor: FloatArray, pixels: FloatArray, sigma_px: float
) -> tuple[FloatArray, FloatArray, IntArray]:
    """H (L, m, N - 16), residual (L, m) and real rows (L,) of the newest clone's view of landmarks.

    `pixels` (L, 4), NaN where unseen. N - 16 are the coordinates after the time offset. Where only
    the inverse depth is estimated, the bearing is projected out, and two rows are lost.
    """
    landmarks, n = state.landmarks, len(state.landmarks)
    now = landmark_points(landmarks, state.clones, T_imu_anchor, first=False)
    first = landmark_points(landmarks, state.clones, T_imu_anchor, first=True)
    newest = len(state.clones) - 1
    view = Clones(
        state.clones.timestamp_ns[-1:], state.clones.T_world_imu[-1:],
        state.clones.T_world_imu_first[-1:],
    )  # fmt: skip
    r = reproject(
        view, rig, pixels[:, None], (now.p_world, first.p_world), sigma_px, state.calibration
    )
    by_point = r.by_point[:, 0]
    offset = len(state.calibration)
    H = np.zeros((n, 4, len(state.covariance) - state.first_clone + offset))
    H[..., :offset] = r.by_calibration[:, 0]
    pose = offset + CLONE_SIZE * newest
    H[..., pose : pose + CLONE_SIZE] = r.by_pose[:, 0]
    _add_anchor(H, by_point @ first.by_anchor, first.anchor, offset)
    size = landmarks.size
    by_value = by_point @ first.by_value
    start = offset + CLONE_SIZE * len(state.clones) + size * np.arange(n)
    for k in range(size):
        H[np.arange(n), :, start + k] = by_value[..., 3 - size + k]
    bearing = by_value[..., : 3 - size]
    return _without(bearing, H, r.residual[:, 0], r.seen[:, 0].sum(1))


def update_slam_features(
    state: State,
    rig: StereoRig,
    T_imu_anchor: FloatArray,
    pixels: FloatArray,
    sigma_px: float,
    chi2_multiplier: float,
) -> State:
    """Update by landmarks seen now as `pixels` (L, 4), each gated; refusals are counted."""
    if not len(state.landmarks) or not np.isfinite(pixels).any():
        return state
    H, residual, rows = landmark_system(state, rig, T_imu_anchor, pixels, sigma_px)
    start = state.first_clone - len(state.calibration)
    columns = np.arange(start, len(state.covariance))
    P = state.covariance[start:, start:]
    distance = innovation_distances(P, H, residual)
    passed = chi2_gate(distance, rows, chi2_multiplier)
    seen = rows > 0
    refused = np.where(seen & ~passed, state.landmarks.refused + 1, state.landmarks.refused)
    refused = np.where(passed, 0, refused)
    state = replace(state, landmarks=replace(state.landmarks, refused=refused))
    agreed = innovation_consistency(state, H, residual, columns, distance, passed)
    if agreed is None:
        return state
    variance = np.ones(len(agreed.residual))
    return ekf_update(state, agreed.H, columns, agreed.residual, variance, agreed.L)


def delayed_initialization(
    state: State,
    rows: PointRows,
    feature_id: IntArray,
    p_world: FloatArray,
    T_imu_anchor: FloatArray,
) -> State:
    """Take features (L,) at `p_world` (L, 3) into the state by the rows that determine them.

    The newest clone becomes the anchor. The value v follows from A v + B x = r, with white noise of
    variance 1: its error is -A⁻¹ (B x - n). Features whose rows leave a direction open stay out.
    """
    pivots = np.abs(np.diagonal(rows.R, axis1=1, axis2=2))
    known = pivots.min(axis=1) > 1e-9 * pivots.max(axis=1)
    rows, feature_id, p_world = rows.rows(known), feature_id[known], p_world[known]
    if not len(feature_id):
        return state
    new = _new_landmarks(state, feature_id, p_world, T_imu_anchor)
    A, B, residual = _rows_of_values(state, new, rows, T_imu_anchor)
    A_inverse = np.linalg.inv(A)
    n, size = len(new), new.size
    G = (-A_inverse @ B).reshape(n * size, -1)
    used = slice(state.first_clone - len(state.calibration), state.first_landmark)
    P = state.covariance
    cross = G @ P[used]
    own = cross[:, used] @ G.T
    own += block_diag(*(A_inverse @ np.swapaxes(A_inverse, -1, -2)))
    value = new.moved((A_inverse @ residual[..., None]).ravel())
    covariance = np.block([[P, cross.T], [cross, 0.5 * (own + own.T)]])
    return replace(state, landmarks=state.landmarks.joined(value), covariance=covariance)


def change_anchor(state: State, leaving_ns: int, kept_ns: int, T_imu_anchor: FloatArray) -> State:
    """Landmarks of one clone written relative to another one, with their covariance.

    The value changes by the latest estimates, the first estimates by the first ones; so the
    Jacobian of the change is taken at the first (G. Huang et al., ISER 2008).
    """
    landmarks = state.landmarks
    moving = np.flatnonzero(landmarks.anchor_ns == leaving_ns)
    if not landmarks.representation.anchored or not len(moving):
        return state
    old = landmarks.rows(moving)
    new = replace(old, anchor_ns=np.full(len(moving), kept_ns))
    new = replace(
        new,
        value=_written(landmark_points(old, state.clones, T_imu_anchor, first=False).p_world, new,
                       state.clones.T_world_imu, state.clones, T_imu_anchor),
        first=_written(landmark_points(old, state.clones, T_imu_anchor, first=True).p_world, new,
                       state.clones.T_world_imu_first, state.clones, T_imu_anchor),
    )  # fmt: skip
    before = landmark_points(old, state.clones, T_imu_anchor, first=True)
    after = landmark_points(new, state.clones, T_imu_anchor, first=True)
    to_value = np.linalg.inv(after.by_value)
    size, first_column = landmarks.size, state.first_landmark
    G = np.zeros((len(moving), size, len(state.covariance)))
    for k, index in enumerate(moving):
        own = slice(first_column + size * index, first_column + size * (index + 1))
        step = to_value[k][3 - size :]
        G[k, :, own] = step @ before.by_value[k][:, 3 - size :]
        G[k, :, state.clone_columns(int(before.anchor[k]))] += step @ before.by_anchor[k]
        G[k, :, state.clone_columns(int(after.anchor[k]))] -= step @ after.by_anchor[k]
    by_state = G.reshape(len(moving) * size, -1)
    rows = first_column + (size * moving[:, None] + np.arange(size)).ravel()
    covariance = state.covariance.copy()
    cross = by_state @ covariance
    covariance[rows], covariance[:, rows] = cross, cross.T
    covariance[np.ix_(rows, rows)] = cross @ by_state.T
    anchor_ns = landmarks.anchor_ns.copy()
    value, first = landmarks.value.copy(), landmarks.first.copy()
    anchor_ns[moving], value[moving], first[moving] = new.anchor_ns, new.value, new.first
    return replace(
        state,
        landmarks=replace(landmarks, anchor_ns=anchor_ns, value=value, first=first),
        covariance=covariance,
    )


def _new_landmarks(
    state: State, feature_id: IntArray, p_world: FloatArray, T_imu_anchor: FloatArray
) -> Landmarks:
    """Landmarks at world points (L, 3), relative to the newest clone where they have an anchor.

    By the first poses and by the latest ones they are at the same point, where it was linearised.
    """
    n, clones = len(feature_id), state.clones
    anchored = state.landmarks.representation.anchored
    anchor_ns = np.full(n, clones.timestamp_ns[-1] if anchored else NO_ANCHOR)
    new = replace(
        state.landmarks, feature_id=feature_id, value=np.zeros((n, 3)), first=np.zeros((n, 3)),
        anchor_ns=anchor_ns, refused=np.zeros(n, dtype=np.int64),
    )  # fmt: skip
    return replace(
        new,
        value=_written(p_world, new, clones.T_world_imu, clones, T_imu_anchor),
        first=_written(p_world, new, clones.T_world_imu_first, clones, T_imu_anchor),
    )


def _rows_of_values(
    state: State, new: Landmarks, rows: PointRows, T_imu_anchor: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A (L, s, s), B (L, s, C + 6K) and residual (L, s) of A v + B x = r, from rows in points."""
    point = landmark_points(new, state.clones, T_imu_anchor, first=True)
    B = rows.H.copy()
    _add_anchor(B, rows.R @ point.by_anchor, point.anchor, len(state.calibration))
    by_value, size = rows.R @ point.by_value, new.size
    estimated = np.concatenate([by_value[..., 3 - size :], B], axis=2)
    n_rows = np.full(len(new), 3)
    H, residual, _ = _without(by_value[..., : 3 - size], estimated, rows.residual, n_rows)
    return H[..., :size], H[..., size:], residual


def _written(
    p_world: FloatArray, landmarks: Landmarks, poses: FloatArray, clones: Clones,
    T_imu_anchor: FloatArray,
) -> FloatArray:  # fmt: skip
    """World points (L, 3) as values (L, 3) of the landmarks' representation, by these poses."""
    coordinates = landmarks.representation.coordinates
    if not landmarks.representation.anchored:
        return coordinates.from_point(p_world)
    anchor = np.searchsorted(clones.timestamp_ns, landmarks.anchor_ns)
    T = se3.inverse(poses[anchor] @ T_imu_anchor)
    return coordinates.from_point((T[:, :3, :3] @ p_world[..., None])[..., 0] + T[:, :3, 3])


def _add_anchor(H: FloatArray, by_anchor: FloatArray, anchor: IntArray, offset: int) -> None:
    """Add derivatives (L, m, 6) by the anchors' poses to H (L, m, n), in place."""
    for k in np.flatnonzero(anchor >= 0):
        start = offset + CLONE_SIZE * int(anchor[k])
        H[k, :, start : start + CLONE_SIZE] += by_anchor[k]


def _without(
    bearing: FloatArray, H: FloatArray, residual: FloatArray, n_rows: IntArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """The measurements with what is not estimated (L, m, b) projected out of them."""
    b = bearing.shape[2]
    if b == 0:
        return H, residual, n_rows
    A = triangularize(np.concatenate([bearing, H, residual[..., None]], axis=2), b)
    return A[:, b:, b:-1], A[:, b:, -1], np.maximum(n_rows - b, 0)
