"""SLAM features (landmarks of the state): measurement, delayed initialization, change of anchor.

Delayed initialization takes all that the window saw of a feature (M. Li & A. Mourikis, RSS 2012):
the rows that determine the landmark give its value and covariance; the other rows update the state
as those of an MSCKF feature do.
"""

from dataclasses import dataclass

import numpy as np

from ovmot.cameras.lens_kernel import packed_cameras
from ovmot.cameras.rig import StereoRig
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.physics import gates
from ovmot.vio.innovation_consistency import VELOCITY_BOUND
from ovmot.vio.landmark_kernel import landmark_rows_compiled, update_by_landmarks_compiled
from ovmot.vio.landmark_point_kernel import (
    change_anchors_compiled,
    initialize_landmarks_compiled,
    place_landmarks_compiled,
)
from ovmot.vio.landmarks import NO_ANCHOR, Landmarks
from ovmot.vio.msckf_features import PointRows, calibration_jacobians
from ovmot.vio.state import N_BASE, Clones, State, with_landmarks
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
    anchor = landmarks.anchor_ns
    if landmarks.representation.anchored:
        anchor = np.searchsorted(clones.timestamp_ns, anchor)
    poses = clones.T_world_imu_first if first else clones.T_world_imu
    points = place_landmarks_compiled(
        coordinates.form, coordinates.axes, value, anchor, poses, T_imu_anchor
    )
    return LandmarkPoints(*points, anchor)


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
        view.T_world_imu, view.T_world_imu_first,
        rig.T_cam_imu, *packed_cameras(rig),
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
    bounds = chi2_multiplier * gates(4, 0.95)[dof]
    passed, weight, error, covariance = update_by_landmarks_compiled(
        state.covariance, H, residual, N_BASE, state.considered, dof, bounds, VELOCITY_BOUND
    )
    rejections = state.landmarks.rejections + ((dof > 0) & ~passed)
    rejections[passed] = 0
    known = state.landmarks
    counted = Landmarks(
        known.representation, known.feature_id, known.value, known.first, known.anchor_ns,
        rejections,
    )  # fmt: skip
    state = with_landmarks(state, counted, state.covariance)
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
    landmarks, clones, n = state.landmarks, state.clones, len(feature_id)
    representation, newest = landmarks.representation, len(clones) - 1
    coordinates = representation.coordinates
    value, first, covariance = initialize_landmarks_compiled(
        coordinates.form, coordinates.axes, landmarks.size, p_world, rows.R, rows.E,
        newest if representation.anchored else NO_ANCHOR,
        (clones.T_world_imu, clones.T_world_imu_first), T_imu_anchor, state.covariance,
        (N_BASE, len(state.calibration)), error,
    )  # fmt: skip
    anchor_ns = np.full(n, clones.timestamp_ns[-1] if representation.anchored else NO_ANCHOR)
    new = Landmarks(
        representation, feature_id, value, first, anchor_ns, np.zeros(n, dtype=np.int64)
    )
    return with_landmarks(state, landmarks.append(new), covariance)


def change_anchor(state: State, old_ns: int, new_ns: int, T_imu_anchor: FloatArray) -> State:
    """The landmarks anchored at clone `old_ns` expressed relative to clone `new_ns`.

    The value changes by the latest estimates, the first estimates by the first ones; so the
    Jacobian of the change is taken at the first (G. Huang et al., ISER 2008).
    """
    landmarks, clones = state.landmarks, state.clones
    index = np.flatnonzero(landmarks.anchor_ns == old_ns)
    if not landmarks.representation.anchored or not len(index):
        return state
    coordinates = landmarks.representation.coordinates
    old, new = clones.timestamp_ns.searchsorted([old_ns, new_ns]).tolist()
    value, first, covariance = change_anchors_compiled(
        coordinates.form, coordinates.axes, landmarks.size, (landmarks.value, landmarks.first),
        index, (old, new), (clones.T_world_imu, clones.T_world_imu_first), T_imu_anchor,
        state.covariance, state.first_clone, state.first_landmark,
    )  # fmt: skip
    anchor_ns = landmarks.anchor_ns.copy()
    anchor_ns[index] = new_ns
    moved_ones = Landmarks(
        landmarks.representation, landmarks.feature_id, value, first, anchor_ns,
        landmarks.rejections,
    )  # fmt: skip
    return with_landmarks(state, moved_ones, covariance)
