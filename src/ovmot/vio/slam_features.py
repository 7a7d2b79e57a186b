"""SLAM features (landmarks of the state): measurement, delayed initialization, change of anchor.

Delayed initialization takes all that the window saw of a feature (M. Li & A. Mourikis, RSS 2012):
the rows that determine the landmark give its value and covariance; the other rows update the state
as those of an MSCKF feature do.
"""

from dataclasses import dataclass, replace

import numpy as np

from ovmot.cameras.lens_kernel import packed_cameras
from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.physics import gates
from ovmot.vio.innovation_consistency import VELOCITY_BOUND
from ovmot.vio.landmark_kernel import landmark_rows_compiled, update_by_landmarks_compiled
from ovmot.vio.landmarks import NO_ANCHOR, Landmarks
from ovmot.vio.msckf_features import PointRows, calibration_jacobians
from ovmot.vio.state import CLONE_SIZE, N_BASE, Clones, State
from ovmot.vio.update import moved


@dataclass(frozen=True, slots=True)
class LandmarkPoints:
    """World points (L, 3), m, and their Jacobians by values (L, 3, 3) and anchor poses (L, 3, 6).

    `anchor` (L,): index of the anchor clone; `NO_ANCHOR` for none, where the Jacobian is zero.
    """

    p_world: FloatArray
    by_value: FloatArray
    by_anchor: FloatArray
    anchor: IntArray


def landmark_points(
    landmarks: Landmarks, clones: Clones, T_imu_anchor: FloatArray, *, first: bool
) -> LandmarkPoints:
    """World points of the landmarks, by the latest or by the first estimates.

    `T_imu_anchor` (4, 4): the anchor's frame on a clone, that of the left camera of the files.
    """
    value = landmarks.first if first else landmarks.value
    coordinates = landmarks.representation.coordinates
    p, J = coordinates.to_point(value), coordinates.jacobian(value)
    by_anchor = np.zeros((len(p), 3, CLONE_SIZE))
    if not landmarks.representation.anchored or not len(p):
        return LandmarkPoints(p, J, by_anchor, np.full(len(p), NO_ANCHOR))
    anchor = np.searchsorted(clones.timestamp_ns, landmarks.anchor_ns)
    T = (clones.T_world_imu_first if first else clones.T_world_imu)[anchor]
    p_imu = se3.apply(T_imu_anchor, p)
    R = T[:, :3, :3]
    by_anchor[..., :3] = -R @ so3.hat(p_imu)
    by_anchor[..., 3:] = np.eye(3)
    p_world = (R @ p_imu[..., None])[..., 0] + T[:, :3, 3]
    return LandmarkPoints(p_world, R @ T_imu_anchor[:3, :3] @ J, by_anchor, anchor)


def landmark_system(
    state: State, rig: StereoRig, T_imu_anchor: FloatArray, pixels: FloatArray, sigma_px: float
) -> tuple[FloatArray, FloatArray, IntArray]:
    """H (L, 1 + s, N - 16), residual (L, 1 + s) and degrees of freedom (L,) of the newest view.

    `rig`: as calibrated now; `pixels` (L, 4), NaN where unseen; `sigma_px`: their standard
    deviation. N - 16 are the coordinates after the time offset. Where only the inverse depth is
    estimated, the bearing is projected out, and two rows are lost.
    """
    landmarks, clones = state.landmarks, state.clones
    latest = landmark_points(landmarks, clones, T_imu_anchor, first=False)
    first = landmark_points(landmarks, clones, T_imu_anchor, first=True)
    view = Clones(clones.timestamp_ns[-1:], clones.T_world_imu[-1:], clones.T_world_imu_first[-1:])
    return landmark_rows_compiled(
        latest.p_world, first.p_world, first.by_value, first.by_anchor, first.anchor,
        pixels[:, None], calibration_jacobians(view, rig, first.p_world, state.calibration),
        se3.inverse(view.T_world_imu), se3.inverse(view.T_world_imu_first),
        se3.inverse(np.stack([rig.T_imu_cam0, rig.T_imu_cam1])), *packed_cameras(rig),
        sigma_px, len(clones), landmarks.size,
    )  # fmt: skip


def update_slam_features(
    state: State,
    rig: StereoRig,
    T_imu_anchor: FloatArray,
    pixels: FloatArray,
    sigma_px: float,
    chi2_multiplier: float,
) -> State:
    """Update by SLAM features seen now as `pixels` (L, 4), NaN where unseen; count rejections.

    Each is gated at `chi2_multiplier` times the 95 % quantile, then all for consistency.
    """
    if not len(state.landmarks) or not np.isfinite(pixels).any():
        return state
    H, residual, dof = landmark_system(state, rig, T_imu_anchor, pixels, sigma_px)
    bounds = chi2_multiplier * gates(np.maximum(dof, 1.0), 0.95)
    passed, weight, error, covariance = update_by_landmarks_compiled(
        state.covariance, H, residual, N_BASE, dof, bounds, VELOCITY_BOUND
    )
    rejections = state.landmarks.rejections + ((dof > 0) & ~passed)
    rejections[passed] = 0
    state = replace(state, landmarks=replace(state.landmarks, rejections=rejections))
    return moved(state, error, covariance) if weight.any() else state


def delayed_initialization(
    state: State,
    rows: PointRows,
    feature_id: IntArray,
    p_world: FloatArray,
    T_imu_anchor: FloatArray,
    error: FloatArray,
) -> State:
    """Augment the state by features (L,) linearized at `p_world` (L, 3), by their `rows`.

    `error` (N,): of the estimate, as the update by the features' other rows has found it, zeros
    for none; the state's covariance is that after it, its estimate that before.
    The newest clone becomes the anchor. The value v follows from A v + B x = r, with white noise of
    variance 1: its error is -A⁻¹ (B x - n). Features whose rows leave a direction undetermined are
    left out.
    """
    pivots = np.abs(np.diagonal(rows.R, axis1=1, axis2=2))
    determined = pivots.min(axis=1) > 1e-9 * pivots.max(axis=1)
    rows, feature_id, p_world = rows.rows(determined), feature_id[determined], p_world[determined]
    if not len(feature_id):
        return state
    new = _new_landmarks(state, feature_id, p_world, T_imu_anchor)
    A, B, residual = _rows_of_values(state, new, rows, T_imu_anchor)
    A_inverse = np.linalg.inv(A)
    n, size = len(new), new.size
    G = (-A_inverse @ B).reshape(n * size, -1)
    columns = slice(state.first_clone - len(state.calibration), state.first_landmark)
    P = state.covariance
    cross = G @ P[columns]
    own = cross[:, columns] @ G.T
    k = np.arange(n)
    blocks = own.reshape(n, size, n, size)  # a view
    blocks[k, :, k] += A_inverse @ np.swapaxes(A_inverse, -1, -2)
    new = new.plus((A_inverse @ residual[..., None]).ravel() + G @ error[columns])
    at = len(P)
    covariance = np.empty((at + n * size, at + n * size))
    covariance[:at, :at], covariance[at:, at:] = P, 0.5 * (own + own.T)
    covariance[at:, :at], covariance[:at, at:] = cross, cross.T
    return replace(state, landmarks=state.landmarks.append(new), covariance=covariance)


def change_anchor(state: State, old_ns: int, new_ns: int, T_imu_anchor: FloatArray) -> State:
    """The landmarks anchored at clone `old_ns` expressed relative to clone `new_ns`.

    The value changes by the latest estimates, the first estimates by the first ones; so the
    Jacobian of the change is taken at the first (G. Huang et al., ISER 2008).
    """
    landmarks, clones = state.landmarks, state.clones
    index = np.flatnonzero(landmarks.anchor_ns == old_ns)
    if not landmarks.representation.anchored or not len(index):
        return state
    old = landmarks.rows(index)
    latest = landmark_points(old, clones, T_imu_anchor, first=False)
    before = landmark_points(old, clones, T_imu_anchor, first=True)
    new = replace(old, anchor_ns=np.full(len(index), new_ns))
    new = replace(
        new,
        value=_values(latest.p_world, new, clones.T_world_imu, clones, T_imu_anchor),
        first=_values(before.p_world, new, clones.T_world_imu_first, clones, T_imu_anchor),
    )
    after = landmark_points(new, clones, T_imu_anchor, first=True)
    by_state = _anchor_change_jacobian(state, index, before, after)
    size = landmarks.size
    rows = state.first_landmark + (size * index[:, None] + np.arange(size)).ravel()
    covariance = state.covariance.copy()
    cross = by_state @ covariance
    covariance[rows], covariance[:, rows] = cross, cross.T
    covariance[np.ix_(rows, rows)] = cross @ by_state.T
    anchor_ns = landmarks.anchor_ns.copy()
    value, first = landmarks.value.copy(), landmarks.first.copy()
    anchor_ns[index], value[index], first[index] = new.anchor_ns, new.value, new.first
    return replace(
        state,
        landmarks=replace(landmarks, anchor_ns=anchor_ns, value=value, first=first),
        covariance=covariance,
    )


def _anchor_change_jacobian(
    state: State, index: IntArray, before: LandmarkPoints, after: LandmarkPoints
) -> FloatArray:
    """Jacobian (M * size, N) of the new values of landmarks `index` (M,) by the error state."""
    to_value = np.linalg.inv(after.by_value)
    size = state.landmarks.size
    J = np.zeros((len(index), size, len(state.covariance)))
    for k, landmark in enumerate(index):
        start = state.first_landmark + size * landmark
        by_point = to_value[k][3 - size :]
        J[k, :, start : start + size] = by_point @ before.by_value[k][:, 3 - size :]
        J[k, :, state.clone_columns(int(before.anchor[k]))] += by_point @ before.by_anchor[k]
        J[k, :, state.clone_columns(int(after.anchor[k]))] -= by_point @ after.by_anchor[k]
    return J.reshape(len(index) * size, -1)


def _new_landmarks(
    state: State, feature_id: IntArray, p_world: FloatArray, T_imu_anchor: FloatArray
) -> Landmarks:
    """Landmarks at world points (L, 3), relative to the newest clone where they have an anchor.

    Latest and first estimates are at the same point, where it was linearized.
    """
    n, clones = len(feature_id), state.clones
    anchored = state.landmarks.representation.anchored
    anchor_ns = np.full(n, clones.timestamp_ns[-1] if anchored else NO_ANCHOR)
    new = replace(
        state.landmarks, feature_id=feature_id, value=np.zeros((n, 3)), first=np.zeros((n, 3)),
        anchor_ns=anchor_ns, rejections=np.zeros(n, dtype=np.int64),
    )  # fmt: skip
    return replace(
        new,
        value=_values(p_world, new, clones.T_world_imu, clones, T_imu_anchor),
        first=_values(p_world, new, clones.T_world_imu_first, clones, T_imu_anchor),
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
    H, residual, _ = _project_out(by_value[..., : 3 - size], estimated, rows.residual, n_rows)
    return H[..., :size], H[..., size:], residual


def _values(
    p_world: FloatArray, landmarks: Landmarks, poses: FloatArray, clones: Clones,
    T_imu_anchor: FloatArray,
) -> FloatArray:  # fmt: skip
    """Values (L, 3) in the landmarks' representation of world points (L, 3), by poses (K, 4, 4)."""
    coordinates = landmarks.representation.coordinates
    if not landmarks.representation.anchored:
        return coordinates.from_point(p_world)
    anchor = np.searchsorted(clones.timestamp_ns, landmarks.anchor_ns)
    T = se3.inverse(poses[anchor] @ T_imu_anchor)
    return coordinates.from_point((T[:, :3, :3] @ p_world[..., None])[..., 0] + T[:, :3, 3])


def _add_anchor(H: FloatArray, by_anchor: FloatArray, anchor: IntArray, offset: int) -> None:
    """Add Jacobians (L, m, 6) by the anchors' poses to H (L, m, n), in place."""
    for k in np.flatnonzero(anchor >= 0):
        start = offset + CLONE_SIZE * int(anchor[k])
        H[k, :, start : start + CLONE_SIZE] += by_anchor[k]


def _project_out(
    bearing: FloatArray, H: FloatArray, residual: FloatArray, n_rows: IntArray
) -> tuple[FloatArray, FloatArray, IntArray]:
    """H, residual and degrees of freedom without the bearing, whose Jacobian is (L, m, b)."""
    b = bearing.shape[2]
    if b == 0:
        return H, residual, n_rows
    A = triangularize(np.concatenate([bearing, H, residual[..., None]], axis=2), b)
    return A[:, b:, b:-1], A[:, b:, -1], np.maximum(n_rows - b, 0)


def triangularize(A: FloatArray, n_columns: int) -> FloatArray:
    """Matrices A (F, M, N) with the first `n_columns` columns zero below the diagonal.

    By Householder reflections (G. Golub & C. Van Loan, sec. 5.2): white noise stays white.
    """
    A = A.copy()
    for j in range(n_columns):
        x = A[:, j:, j]
        v = x.copy()
        sign = np.where(x[:, 0] < 0.0, -1.0, 1.0)
        v[:, 0] += sign * np.linalg.norm(x, axis=1)
        length = (v * v).sum(1)
        v *= np.sqrt(2.0 / np.where(length > 0.0, length, 1.0))[:, None]
        A[:, j:] -= v[:, :, None] * (v[:, None, :] @ A[:, j:])
    return A
