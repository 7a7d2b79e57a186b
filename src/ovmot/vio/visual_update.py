"""One visual correction: landmarks in view; then ended features, located, gated, compressed."""

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
from ovmot.vio.state import State, drop_landmarks
from ovmot.vio.update import ekf_update

NOT_KEPT = -1
"""Instead of a landmark's id: the feature is used once."""
_MIN_VIEWS = 3  # observations from different clones, a stereo pair counted once
_MAX_REFUSED = 3  # updates in a row after which a landmark is not believed any more


def clone_rows(table: FeatureTable, state: State) -> BoolArray:
    """Rows (T,) whose frame is itself a clone of the state: the filter's measurements."""
    own: BoolArray = table.frame_ns == table.clone_ns
    return own & np.isin(table.clone_ns, state.clones.timestamp_ns)


def usable_observations(table: FeatureTable, state: State) -> BoolArray:
    """Observations (T, F) that an update may take: unused, of features that are not barred."""
    return table.seen & ~table.used & ~table.dynamic & clone_rows(table, state)[:, None]


def update_with_features(
    state: State,
    table: FeatureTable,
    rig: StereoRig,
    settings: FilterSettings,
    *,
    oldest_leaves: bool,
) -> tuple[State, FeatureTable]:
    """Update by landmarks in view and by features that ended, or that the oldest clone still holds.

    Of those that the oldest clone, about to leave, holds and that are still seen, the ones seen
    longest become landmarks while there is room. `rig` is that of the calibration files. Features
    that were suspect when last seen are not used. Observations of the chosen features are marked as
    used, also where a test then refuses them, and all those of features that are gone.
    """
    now = calibrated_rig(rig, state.calibration)
    state, table = _update_with_slam_features(state, table, now, rig.T_imu_cam0, settings)
    usable = usable_observations(table, state)
    views = usable.sum(axis=0)
    gone = ~table.seen_now
    due = gone & (views > 0)
    if oldest_leaves and len(state.clones):
        oldest = table.frame_ns == state.clones.timestamp_ns[0]
        due |= usable[oldest].any(axis=0)
    due &= ~np.isin(table.feature_id, state.landmarks.feature_id)
    chosen = due & (views >= _MIN_VIEWS) & ~table.outlier
    room = settings.max_landmarks - len(state.landmarks)
    lasting = _first(chosen & ~gone, views, room)
    chosen = _first(chosen & ~lasting, views, settings.max_features_per_update)
    spent = usable & (chosen | lasting | gone)
    taken = chosen | lasting
    if taken.any():
        pixels = _per_clone(table, state, usable, taken)
        joining = np.where(lasting, table.feature_id, NOT_KEPT)[taken]
        state = msckf_update(state, now, rig.T_imu_cam0, pixels, joining, settings)
    return state, mark_used(table, spent)


def msckf_update(
    state: State,
    rig: StereoRig,
    T_imu_anchor: FloatArray,
    pixels: FloatArray,
    landmark_id: IntArray,
    settings: FilterSettings,
) -> State:
    """Update by features seen as (F, K, 4) from the K clones; `rig` as calibrated now.

    Those with a `landmark_id` (F,) stay in the state as landmarks of that id. All are linearised at
    one state and update together: one after another, each would have to be linearised anew.
    """
    system, p_world, found = _located(state, rig, pixels, settings)
    if not len(system.residual):
        return state
    free = project_nullspace(system)
    columns = np.arange(state.first_clone - len(state.calibration), state.first_landmark)
    P = state.covariance[columns[0] : columns[-1] + 1, columns[0] : columns[-1] + 1]
    distance = innovation_distances(P, free.H, free.residual)
    passed = chi2_gate(distance, free.dof, settings.chi2_multiplier)
    agreed = innovation_consistency(state, free.H, free.residual, columns, distance, passed)
    if agreed is None:
        return state
    landmark_id = landmark_id[found]
    joining = (agreed.share > 0.0) & (landmark_id != NOT_KEPT)
    state = delayed_initialization(
        state, free.points.rows(joining), landmark_id[joining], p_world[joining], T_imu_anchor
    )
    variance = np.ones(len(agreed.residual))
    return ekf_update(state, agreed.H, columns, agreed.residual, variance, agreed.L)


def _update_with_slam_features(
    state: State,
    table: FeatureTable,
    rig: StereoRig,
    T_imu_anchor: FloatArray,
    settings: FilterSettings,
) -> tuple[State, FeatureTable]:
    """Let landmarks go that are lost, move or were refused too often; update by the others."""
    ids = state.landmarks.feature_id
    alive = table.feature_id[table.seen_now & ~table.dynamic]
    gone = ~np.isin(ids, alive) | (state.landmarks.refused >= _MAX_REFUSED)
    state = drop_landmarks(state, gone)
    if not len(state.landmarks):
        return state, table
    column = table.columns(state.landmarks.feature_id)
    pixels = table.pixels[-1, column]
    pixels[table.outlier[column]] = np.nan
    state = update_slam_features(
        state, rig, T_imu_anchor, pixels, settings.landmark_pixel_sigma, settings.chi2_multiplier
    )
    spent = np.zeros_like(table.used)
    spent[-1, column] = True
    return state, mark_used(table, spent)


def _first(candidates: BoolArray, views: IntArray, count: int) -> BoolArray:
    """At most `count` of the candidates (F,), those with most views first."""
    if candidates.sum() <= count:
        return candidates
    out = np.zeros_like(candidates)
    ranked = np.argsort(np.where(candidates, -views, 1), kind="stable")
    out[ranked[: max(count, 0)]] = True
    return out


def _located(
    state: State, rig: StereoRig, pixels: FloatArray, settings: FilterSettings
) -> tuple[FeatureSystem, FloatArray, BoolArray]:
    """Measurements and points of the features that could be triangulated, and which (F,) these are.

    The plane coordinates are made here, by the lenses as they are calibrated now.
    """
    sigma = settings.pixel_sigma
    normalized = np.concatenate(
        [rig.cam0.normalize(pixels[..., :2]), rig.cam1.normalize(pixels[..., 2:])], axis=-1
    )
    depth_range = (settings.min_depth_m, settings.max_depth_m)
    points = triangulate_features(state, rig, normalized, sigma, depth_range)
    found = points.valid
    system = linearize(state, rig, pixels[found], points.p_world[found], sigma)
    return system, points.p_world[found], found


def _per_clone(
    table: FeatureTable, state: State, usable: BoolArray, chosen: BoolArray
) -> FloatArray:
    """Pixels (F, K, 4) of chosen features, NaN where not to be used."""
    features = np.flatnonzero(chosen)
    pixels = np.full((len(features), len(state.clones), 4), np.nan)
    for k, stamp in enumerate(state.clones.timestamp_ns):
        row = np.flatnonzero(table.frame_ns == stamp)
        if len(row):
            take = usable[row[0], features]
            pixels[take, k] = table.pixels[row[0], features[take]]
    return pixels
