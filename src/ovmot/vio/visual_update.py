"""The visual update of one frame: SLAM features in view, then MSCKF features.

The sets of features are those of OpenVINS: lost features, features of the clone to be marginalized,
and, of the latter, the longest tracks as candidates for SLAM features.
"""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable, mark_used
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.settings import FilterSettings
from ovmot.vio.innovation_consistency import innovation_consistency
from ovmot.vio.msckf_features import (
    FeatureSystem,
    chi2_gate,
    innovation_distances,
    linearize,
    project_nullspace,
    triangulate_features,
)
from ovmot.vio.online_calibration import calibrated_rig
from ovmot.vio.slam_features import delayed_initialization, update_slam_features
from ovmot.vio.state import State, marginalize_landmarks
from ovmot.vio.update import ekf_update

_MIN_VIEWS = 3  # clones that observe a feature, a stereo pair counted once
_MAX_REJECTIONS = 3  # in a row, after which a SLAM feature is marginalized


def update_with_features(
    state: State,
    table: FeatureTable,
    rig: StereoRig,
    settings: FilterSettings,
    *,
    oldest_is_marginalized: bool,
) -> tuple[State, FeatureTable]:
    """The state updated by the features of the newest frame, and the table with what was used.

    `rig`: that of the calibration files. `oldest_is_marginalized`: the oldest clone leaves the
    window after this frame, so that features seen from it must be used now.

    Features that were outliers when last seen are not used. Marked as used are all observations of
    features that enter an update, also where a gate then rejects them, and of lost features.
    """
    calibrated = calibrated_rig(rig, state.calibration)
    state, table = _update_with_slam_features(state, table, calibrated, rig.T_imu_cam0, settings)
    available = available_observations(table, state)
    n_views = available.sum(axis=0)

    lost = ~table.seen_now
    marginalized = np.zeros_like(lost)
    if oldest_is_marginalized and len(state.clones):
        oldest = table.frame_ns == state.clones.timestamp_ns[0]
        marginalized = available[oldest].any(axis=0)
    candidates = (lost | marginalized) & (n_views >= _MIN_VIEWS) & ~table.outlier
    candidates &= ~np.isin(table.feature_id, state.landmarks.feature_id)
    room = settings.max_landmarks - len(state.landmarks)
    slam_candidates = _longest(candidates & ~lost, n_views, room)
    msckf_features = _longest(
        candidates & ~slam_candidates, n_views, settings.max_features_per_update
    )

    updating = msckf_features | slam_candidates
    if updating.any():
        pixels = _pixels_per_clone(table, state, available, updating)
        state = msckf_update(
            state, calibrated, rig.T_imu_cam0, pixels,
            table.feature_id[updating], slam_candidates[updating], settings,
        )  # fmt: skip
    return state, mark_used(table, available & (updating | lost))


def available_observations(table: FeatureTable, state: State) -> BoolArray:
    """Observations (T, F) that an update may use: from clones, unused, of features not dynamic."""
    return table.seen & ~table.used & ~table.dynamic & clone_rows(table, state)[:, None]


def clone_rows(table: FeatureTable, state: State) -> BoolArray:
    """Rows (T,) whose frame is itself a clone of the state, not one that shares a clone."""
    own: BoolArray = table.frame_ns == table.clone_ns
    return own & np.isin(table.clone_ns, state.clones.timestamp_ns)


def msckf_update(
    state: State,
    rig: StereoRig,
    T_imu_anchor: FloatArray,
    pixels: FloatArray,
    feature_id: IntArray,
    slam_candidate: BoolArray,
    settings: FilterSettings,
) -> State:
    """MSCKF update by F features, of which the SLAM candidates enter the state.

    `rig`: as calibrated now; `T_imu_anchor` (4, 4): the left camera of the files; `pixels` (F, K,
    4) from the K clones, NaN where not to be used; `feature_id` (F,), `slam_candidate` (F,).

    All are linearized at one state and update it together: updates one after another would need a
    new linearization each.
    """
    system, p_world, triangulated = _linearized_features(state, rig, pixels, settings)
    if not len(system.residual):
        return state
    projected = project_nullspace(system)
    columns = np.arange(state.first_clone - len(state.calibration), state.first_landmark)
    P = state.covariance[columns[0] : columns[-1] + 1, columns[0] : columns[-1] + 1]
    distance = innovation_distances(P, projected.H, projected.residual)
    passed = chi2_gate(distance, projected.dof, settings.chi2_multiplier)
    consistent = innovation_consistency(
        state, projected.H, projected.residual, columns, distance, projected.dof, passed
    )
    if consistent is None:
        return state
    new = (consistent.weight > 0.0) & slam_candidate[triangulated]
    state = delayed_initialization(
        state, projected.points.rows(new), feature_id[triangulated][new], p_world[new], T_imu_anchor
    )
    variance = np.ones(len(consistent.residual))
    return ekf_update(
        state, consistent.H, columns, consistent.residual, variance, consistent.L
    )  # fmt: skip


def _update_with_slam_features(
    state: State,
    table: FeatureTable,
    rig: StereoRig,
    T_imu_anchor: FloatArray,
    settings: FilterSettings,
) -> tuple[State, FeatureTable]:
    """Marginalize SLAM features that are lost, dynamic or rejected; update by the others."""
    ids = state.landmarks.feature_id
    alive = table.feature_id[table.seen_now & ~table.dynamic]
    rejected = state.landmarks.rejections >= _MAX_REJECTIONS
    state = marginalize_landmarks(state, ~np.isin(ids, alive) | rejected)
    if not len(state.landmarks):
        return state, table
    column = table.columns(state.landmarks.feature_id)
    pixels = table.pixels[-1, column]
    pixels[table.outlier[column]] = np.nan
    state = update_slam_features(
        state, rig, T_imu_anchor, pixels, settings.landmark_pixel_sigma, settings.chi2_multiplier
    )
    used = np.zeros_like(table.used)
    used[-1, column] = True
    return state, mark_used(table, used)


def _longest(candidates: BoolArray, n_views: IntArray, count: int) -> BoolArray:
    """At most `count` of the candidates (F,), those with most views first."""
    if candidates.sum() <= count:
        return candidates
    out = np.zeros_like(candidates)
    ranked = np.argsort(np.where(candidates, -n_views, 1), kind="stable")
    out[ranked[: max(count, 0)]] = True
    return out


def _linearized_features(
    state: State, rig: StereoRig, pixels: FloatArray, settings: FilterSettings
) -> tuple[FeatureSystem, FloatArray, BoolArray]:
    """Measurements and world points (T, 3) of the features that could be triangulated, and which
    (F,) these are."""
    sigma = settings.pixel_sigma
    points = triangulate_features(state, rig, rig.normalize(pixels), sigma)
    valid = points.valid
    system = linearize(state, rig, pixels[valid], points.p_world[valid], sigma)
    return system, points.p_world[valid], valid


def _pixels_per_clone(
    table: FeatureTable, state: State, available: BoolArray, features: BoolArray
) -> FloatArray:
    """Available pixels (F, K, 4) of the features marked, from the K clones; NaN elsewhere."""
    index = np.flatnonzero(features)
    pixels = np.full((len(index), len(state.clones), 4), np.nan)
    for k, stamp in enumerate(state.clones.timestamp_ns):
        row = np.flatnonzero(table.frame_ns == stamp)
        if len(row):
            seen = available[row[0], index]
            pixels[seen, k] = table.pixels[row[0], index[seen]]
    return pixels
