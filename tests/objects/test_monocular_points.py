"""Features of one camera get the depth of their track, known across the ray only."""

import numpy as np
from object_fixtures import T_WORLD_CAM0, feature_motions, make_track, scene_points, small_rig

from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.objects.monocular_points import with_track_depths
from ovmot.objects.track import TrackState
from ovmot.types import ScenePoints

POSITIONS = np.array([[12.0, 0.5, 1.0], [12.2, 0.1, 0.6]])
UNSEEN = feature_motions(np.empty((0, 3)))


def monocular(p_world: FloatArray) -> ScenePoints:
    """Features that only the left camera sees."""
    uv = small_rig().cam0.project(se3.apply(se3.inverse(T_WORLD_CAM0), p_world))
    pixels = np.concatenate([uv, np.full_like(uv, np.nan)], axis=1)
    return scene_points([0] * len(p_world), pixels=pixels)


def test_a_feature_is_placed_where_its_track_takes_it() -> None:
    velocity = np.array([0.0, 4.0, 0.0])
    track = make_track((12.0, 0.4, 0.8), (0.0, 4.0, 0.0), ids=(0, 1))
    now = POSITIONS + 0.1 * velocity
    before = feature_motions(np.zeros((2, 3)), POSITIONS)
    placed = with_track_depths(monocular(now), [track], before, 0.1, T_WORLD_CAM0, small_rig(), 0.5)
    p_world = se3.apply(T_WORLD_CAM0, placed.p_cam0)
    np.testing.assert_allclose(p_world, now, atol=1e-9)
    variance, axes = np.linalg.eigh(placed.cov_cam0[0])
    assert np.sqrt(variance[-1]) > 3.0 and np.sqrt(variance[:2]).max() < 0.05
    ray = placed.p_cam0[0] / np.linalg.norm(placed.p_cam0[0])
    assert abs(axes[:, -1] @ ray) > 0.999


def test_a_feature_without_a_past_is_at_the_tracks_depth() -> None:
    track = make_track((12.0, 0.4, 0.8), (0.0, 4.0, 0.0), ids=(0, 1))
    placed = with_track_depths(
        monocular(POSITIONS), [track], UNSEEN, 0.1, T_WORLD_CAM0, small_rig(), 0.5
    )
    np.testing.assert_allclose(placed.p_cam0[:, 2], 12.0)


def test_others_stay_without_a_position() -> None:
    """Of a tentative track, of one along the ray, and of no track."""
    across = make_track((12.0, 0.4, 0.8), (0.0, 4.0, 0.0), ids=(0, 1), state=TrackState.TENTATIVE)
    along = make_track((12.0, 0.4, 0.8), (9.0, 0.5, 0.0), ids=(0, 1))
    other = make_track((12.0, 0.4, 0.8), (0.0, 4.0, 0.0), ids=(7,))
    for track in (across, along, other):
        placed = with_track_depths(
            monocular(POSITIONS), [track], UNSEEN, 0.1, T_WORLD_CAM0, small_rig(), 0.5
        )
        assert np.isnan(placed.p_cam0).all()
