"""Motions of features by their positions at earlier times."""

import numpy as np
from object_fixtures import FRAME_NS, T_WORLD_CAM0, scene_points

from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.objects.feature_motions import FeatureHistory, FeatureMotions
from ovmot.types import ScenePoints


def seen_at(p_world: FloatArray, ids: list[int]) -> ScenePoints:
    p_cam0 = se3.apply(se3.inverse(T_WORLD_CAM0), p_world)
    return scene_points([0] * len(ids), feature_id=ids, p_cam0=p_cam0)


def moved(n_frames: int) -> tuple[FeatureMotions, FloatArray]:
    """Two features that move for some frames, and one that is new in the last."""
    history = FeatureHistory()
    start = np.array([[10.0, 1.0, 0.5], [12.0, -1.0, 0.7], [9.0, 0.0, 0.2]])
    velocity = np.array([[3.0, 1.0, 0.0], [0.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    for k in range(n_frames):
        ids = [5, 2, 9] if k == n_frames - 1 else [5, 2]
        p_world = (start + 0.1 * k * velocity)[: len(ids)]
        motions = history.add(k * FRAME_NS, seen_at(p_world, ids), T_WORLD_CAM0)
    return motions, velocity


def test_velocities_are_those_of_the_positions() -> None:
    motions, velocity = moved(5)
    assert motions.feature_id.tolist() == [5, 2, 9]
    assert motions.known.tolist() == [True, True, False]
    np.testing.assert_allclose(motions.velocity[:2], velocity[:2], atol=1e-9)
    sigma = np.sqrt(np.linalg.eigvalsh(motions.velocity_cov[0])[-1])
    assert 0.05 < sigma < 1.5
    assert (motions.change[:2] < sigma**2).all()


def test_what_is_too_old_is_dropped() -> None:
    history = FeatureHistory()
    p_world = np.array([[10.0, 1.0, 0.5]])
    history.add(0, seen_at(p_world, [4]), T_WORLD_CAM0)
    late = history.add(11 * FRAME_NS, seen_at(p_world, [4]), T_WORLD_CAM0)
    assert not late.known.any()
