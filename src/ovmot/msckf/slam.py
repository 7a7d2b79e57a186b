"""Landmarks in the state: where they are, how they are seen, how they come and change their anchor.

Initialised late, from all that the window saw of them (M. Li & A. Mourikis, RSS 2012): the rows of
that measurement which determine the landmark give its value and covariance, the others update.
"""

from dataclasses import dataclass, replace

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.msckf.agreement import scaled, shares
from ovmot.msckf.features import FeatureSystem, chi2_gate, reproject, triangularize
from ovmot.msckf.landmarks import NO_ANCHOR, Landmarks
from ovmot.msckf.state import CLONE_SIZE, Clones, State
from ovmot.msckf.update import ekf_update


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


def update_landmarks(
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
    passed = chi2_gate(P, H, residual, rows, chi2_multiplier)
    seen = rows > 0
    refused = np.where(seen & ~passed, state.landmarks.refused + 1, state.landmarks.refused)
    refused = np.where(passed, 0, refused)
    state = replace(state, landmarks=replace(state.landmarks, refused=refused))
    share = shares(state, H, residual, columns, passed)
    if not share.any():
        return state
    H, residual = scaled(H, residual, share)
    return ekf_update(state, H, columns, residual, np.ones(len(residual)))


def add_landmarks(
    state: State,
    system: FeatureSystem,
    feature_id: IntArray,
    p_world: FloatArray,
    T_imu_anchor: FloatArray,
    chi2_multiplier: float,
) -> State:
    """Take features into the state, one after another, each with what the window saw of it.

    `system` over the calibration and the clones, as `linearize` gives it at `p_world` (F, 3); the
    newest clone becomes the anchor. A feature that the gate refuses is left out.
    """
    for k in range(len(feature_id)):
        one = FeatureSystem(
            system.H[k : k + 1], system.H_point[k : k + 1], system.residual[k : k + 1],
            system.n_rows[k : k + 1],
        )  # fmt: skip
        state = _add_landmark(
            state, one, int(feature_id[k]), p_world[k], T_imu_anchor, chi2_multiplier
        )
    return state


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
    G = np.eye(len(state.covariance))
    for k, index in enumerate(moving):
        rows = slice(first_column + size * index, first_column + size * (index + 1))
        step = to_value[k][3 - size :]
        G[rows] = 0.0
        G[rows, rows] = step @ before.by_value[k][:, 3 - size :]
        G[rows, state.clone_columns(int(before.anchor[k]))] += step @ before.by_anchor[k]
        G[rows, state.clone_columns(int(after.anchor[k]))] -= step @ after.by_anchor[k]
    anchor_ns = landmarks.anchor_ns.copy()
    value, first = landmarks.value.copy(), landmarks.first.copy()
    anchor_ns[moving], value[moving], first[moving] = new.anchor_ns, new.value, new.first
    return replace(
        state,
        landmarks=replace(landmarks, anchor_ns=anchor_ns, value=value, first=first),
        covariance=G @ state.covariance @ G.T,
    )


def _add_landmark(
    state: State, system: FeatureSystem, feature_id: int, p_world: FloatArray,
    T_imu_anchor: FloatArray, chi2_multiplier: float,
) -> State:  # fmt: skip
    """QR of [H_landmark | H | r]: the upper rows make the landmark, the lower ones update."""
    landmarks, size = state.landmarks, state.landmarks.size
    anchored = landmarks.representation.anchored
    anchor_ns = np.array([state.clones.timestamp_ns[-1] if anchored else NO_ANCHOR])
    new = replace(
        landmarks, feature_id=np.array([feature_id]), value=np.zeros((1, 3)),
        first=np.zeros((1, 3)), anchor_ns=anchor_ns, refused=np.zeros(1, dtype=np.int64),
    )  # fmt: skip
    first = _written(p_world[None], new, state.clones.T_world_imu_first, state.clones, T_imu_anchor)
    value = _written(p_world[None], new, state.clones.T_world_imu, state.clones, T_imu_anchor)
    new = replace(new, value=value, first=first)
    point = landmark_points(new, state.clones, T_imu_anchor, first=True)
    H = system.H.copy()
    _add_anchor(H, system.H_point @ point.by_anchor, point.anchor, len(state.calibration))
    by_value = system.H_point @ point.by_value
    H, residual, n_rows = _without(by_value[..., : 3 - size], np.concatenate(
        [by_value[..., 3 - size :], H], axis=2), system.residual, system.n_rows)  # fmt: skip
    A = triangularize(np.concatenate([H, residual[..., None]], axis=2), size)
    upper, lower = A[0, :size], A[:, size:]
    start, stop = state.first_clone - len(state.calibration), state.first_landmark
    P = state.covariance
    passed = chi2_gate(
        P[start:stop, start:stop], lower[..., size:-1], lower[..., -1], n_rows - size,
        chi2_multiplier,
    )  # fmt: skip
    R = upper[:, :size]
    if not passed[0] or np.abs(np.diag(R)).min() < 1e-9 * np.abs(np.diag(R)).max():
        return state
    R_inverse = np.linalg.inv(R)
    G = -R_inverse @ upper[:, size:-1]
    cross = G @ P[start:stop]
    own = cross[:, start:stop] @ G.T + R_inverse @ R_inverse.T
    moved = new.moved(R_inverse @ upper[:, -1])
    state = replace(
        state,
        landmarks=landmarks.joined(moved),
        covariance=np.block([[P, cross.T], [cross, 0.5 * (own + own.T)]]),
    )
    real = np.abs(lower[0]).max(axis=1) > 0.0
    rest = lower[0][real]
    return ekf_update(
        state, rest[:, size:-1], np.arange(start, stop), rest[:, -1], np.ones(len(rest))
    )


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
