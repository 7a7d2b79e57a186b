"""The visual update of one frame: SLAM features in view, then MSCKF features.

The sets of features are those of OpenVINS: lost features, features of the clone to be marginalized,
and, of the latter, the longest tracks as candidates for SLAM features.
"""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable, mark_used
from ovmot.geometry.arrays import BoolArray, FloatArray, IntArray
from ovmot.geometry.id_sets import contained, positions
from ovmot.kernels.table_kernel import available_views_compiled, gather_views_compiled
from ovmot.settings import FilterSettings
from ovmot.vio.msckf_features import consistent_features, triangulate_features
from ovmot.vio.online_calibration import calibrated_rig
from ovmot.vio.slam_features import delayed_initialization, update_slam_features
from ovmot.vio.state import State, marginalize_landmarks, with_landmarks
from ovmot.vio.update import moved

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
    candidates[table.columns(state.landmarks.feature_id)] = False
    room = settings.max_landmarks - len(state.landmarks)
    slam_candidates = _longest(candidates & ~lost, n_views, room)
    msckf_features = _longest(
        candidates & ~slam_candidates, n_views, settings.max_features_per_update
    )

    updating = msckf_features | slam_candidates
    if updating.any():
        pixels, normalized = gather_views_compiled(
            table.pixels, table.normalized, available, np.flatnonzero(updating),
            positions(state.clones.timestamp_ns, table.frame_ns),
        )  # fmt: skip
        if calibrated is not rig:
            normalized = calibrated.normalize(pixels)
        state = msckf_update(
            state, calibrated, rig.T_imu_cam0, pixels, normalized,
            table.feature_id[updating], slam_candidates[updating], settings,
        )  # fmt: skip
    return state, mark_used(table, available & (updating | lost))


def available_observations(table: FeatureTable, state: State) -> BoolArray:
    """Observations (T, F) that an update may use: from clones, unused, of features not dynamic."""
    return available_views_compiled(
        table.pixels, table.used, table.dynamic, clone_rows(table, state)
    )


def clone_rows(table: FeatureTable, state: State) -> BoolArray:
    """Rows (T,) whose frame is itself a clone of the state, not one that shares a clone."""
    own: BoolArray = table.frame_ns == table.clone_ns
    return own & contained(table.clone_ns, state.clones.timestamp_ns)


def msckf_update(
    state: State,
    rig: StereoRig,
    T_imu_anchor: FloatArray,
    pixels: FloatArray,
    normalized: FloatArray,
    feature_id: IntArray,
    slam_candidate: BoolArray,
    settings: FilterSettings,
) -> State:
    """MSCKF update by F features, of which the SLAM candidates enter the state.

    `rig`: as calibrated now; `T_imu_anchor` (4, 4): the left camera of the files; `pixels` (F, K,
    4) from the K clones, NaN where not to be used, with their `normalized` coordinates (F, K, 4);
    `feature_id` (F,), `slam_candidate` (F,).

    All are linearized at one state and update it together: updates one after another would need a
    new linearization each.
    """
    points, valid = triangulate_features(state, rig, normalized, settings.pixel_sigma)
    if not valid.any():
        return state
    points, slam_candidate = points[valid], slam_candidate[valid]
    consistent = consistent_features(state, rig, pixels[valid], points, settings)
    if not consistent.weight.any():
        return state
    new = (consistent.weight > 0.0) & slam_candidate
    error, covariance = consistent.error, consistent.covariance
    if new.any():
        state = delayed_initialization(
            with_landmarks(state, state.landmarks, covariance), consistent.points.rows(new),
            feature_id[valid][new], points[new], T_imu_anchor, error,
        )  # fmt: skip
        covariance = state.covariance
        error = np.concatenate([error, np.zeros(len(covariance) - len(error))])
    return moved(state, error, covariance)


def _update_with_slam_features(
    state: State,
    table: FeatureTable,
    rig: StereoRig,
    T_imu_anchor: FloatArray,
    settings: FilterSettings,
) -> tuple[State, FeatureTable]:
    """Marginalize SLAM features that are lost, dynamic or rejected; update by the others."""
    if not len(state.landmarks):
        return state, table
    column = table.columns(state.landmarks.feature_id)
    alive = (column >= 0) & table.seen_now[column] & ~table.dynamic[column]
    alive &= state.landmarks.rejections < _MAX_REJECTIONS
    state, column = marginalize_landmarks(state, ~alive), column[alive]
    if not len(column):
        return state, table
    pixels = table.pixels[-1, column]
    pixels[table.outlier[column]] = np.nan
    state = update_slam_features(
        state, rig, T_imu_anchor, pixels, settings.landmark_pixel_sigma, settings.chi2_multiplier
    )
    used = np.zeros(table.shape, dtype=np.bool_)
    used[-1, column] = True
    return state, mark_used(table, used)


def _longest(candidates: BoolArray, n_views: IntArray, count: int) -> BoolArray:
    """At most `count` of the candidates (F,), those with most views first."""
    index = np.flatnonzero(candidates)
    if len(index) <= count:
        return candidates
    out = np.zeros_like(candidates)
    ranked = index[np.argsort(-n_views[index], kind="stable")]
    out[ranked[: max(count, 0)]] = True
    return out
