"""One visual correction: choose ended features, triangulate, gate, compress, update."""

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.config import FilterSettings
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.msckf.features import chi2_gate, linearize, project_nullspace, triangulate_features
from ovmot.msckf.state import FIRST_CLONE, State
from ovmot.msckf.update import compress, ekf_update
from ovmot.tracks import TrackTable, mark_used

_MIN_VIEWS = 3  # left observations from different clones


def own_rows(table: TrackTable, state: State) -> BoolArray:
    """Rows (T,) whose frame is itself a clone of the state: the filter's measurements."""
    own: BoolArray = table.frame_ns == table.clone_ns
    return own & np.isin(table.clone_ns, state.clones.timestamp_ns)


def usable_observations(table: TrackTable, state: State) -> BoolArray:
    """Observations (T, F) that an update may take: unused, of features that are not barred."""
    seen = np.isfinite(table.pixels[..., 0])
    return seen & ~table.used & ~table.barred & own_rows(table, state)[:, None]


def correct_with_features(
    state: State,
    table: TrackTable,
    rig: StereoRig,
    settings: FilterSettings,
    *,
    oldest_leaves: bool,
) -> tuple[State, TrackTable]:
    """Update by features that ended, or that the oldest clone, about to leave, still holds.

    Features that were suspect when last seen are not used. Observations of the chosen features are
    marked as used, also where a test then refuses them, and all those of features that are gone.
    """
    usable = usable_observations(table, state)
    views = usable.sum(axis=0)
    gone = ~table.seen_now
    due = gone & (views > 0)
    if oldest_leaves and len(state.clones):
        oldest = table.frame_ns == state.clones.timestamp_ns[0]
        due |= usable[oldest].any(axis=0)
    chosen = due & (views >= _MIN_VIEWS) & ~table.suspect
    if chosen.sum() > settings.max_features_per_update:
        ranked = np.argsort(np.where(chosen, -views, 1), kind="stable")
        chosen = np.zeros_like(chosen)
        chosen[ranked[: settings.max_features_per_update]] = True
    spent = usable & (chosen | gone)
    if chosen.any():
        pixels, normalized = _per_clone(table, state, usable, chosen)
        state = update_with_tracks(state, rig, pixels, normalized, settings)
    return state, mark_used(table, spent)


def update_with_tracks(
    state: State,
    rig: StereoRig,
    pixels: FloatArray,
    normalized: FloatArray,
    settings: FilterSettings,
) -> State:
    """MSCKF update by features seen as (F, K, 4) from the K clones."""
    sigma = settings.pixel_sigma
    depth_range = (settings.min_depth_m, settings.max_depth_m)
    points = triangulate_features(state, rig, normalized, sigma, depth_range)
    keep = points.valid
    if not keep.any():
        return state
    system = linearize(state, rig, pixels[keep], points.p_world[keep], sigma)
    H, residual = project_nullspace(system)
    passed = chi2_gate(state, H, residual, system.n_rows - 3, settings.chi2_multiplier)
    if not passed.any():
        return state
    H, residual = H[passed].reshape(-1, H.shape[2]), residual[passed].ravel()
    real = np.abs(H).max(axis=1) > 0.0
    H, residual = compress(H[real], residual[real])
    columns = np.arange(FIRST_CLONE, len(state.covariance))
    return ekf_update(state, H, columns, residual, np.ones(len(residual)))


def _per_clone(
    table: TrackTable, state: State, usable: BoolArray, chosen: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Pixels and plane coordinates (F, K, 4) of chosen features, NaN where not to be used."""
    features = np.flatnonzero(chosen)
    pixels = np.full((len(features), len(state.clones), 4), np.nan)
    normalized = np.full_like(pixels, np.nan)
    for k, stamp in enumerate(state.clones.timestamp_ns):
        row = np.flatnonzero(table.frame_ns == stamp)
        if len(row):
            take = usable[row[0], features]
            pixels[take, k] = table.pixels[row[0], features[take]]
            normalized[take, k] = table.normalized[row[0], features[take]]
    return pixels, normalized
