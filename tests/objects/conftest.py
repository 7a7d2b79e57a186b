"""The fixtures that these tests share, also with those of other folders."""

from collections.abc import Callable

import numpy as np
import pytest
from street_fixtures import (
    body,
    compared_case,
    drive,
    in_view,
    measure,
    rig,
    scene_of,
    window_of,
)

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.objects.clustering import MotionHistory, motion_history
from ovmot.segmentation.stereo_history import stereo_history
from ovmot.settings import ObjectSettings, SegmentationSettings
from ovmot.types import PixelNoise, PoseWindow, ScenePoints

__all__ = [
    "body",
    "compared_case",
    "drive",
    "history_of",
    "in_view",
    "measure",
    "rig",
    "scene_of",
    "window_of",
]

NOISE = PixelNoise(0.3, 0.3, 0.0, 0.0)
Scene = tuple[FeatureTable, ScenePoints, PoseWindow]
Bodies = list[tuple[float, float, tuple[float, float, float], int]]


@pytest.fixture(scope="session")
def history_of(
    rig: StereoRig, drive: Callable[..., FloatArray], body: Callable[..., FloatArray],
    scene_of: Callable[..., Scene],
) -> Callable[..., MotionHistory | None]:  # fmt: skip
    """The history of bodies (ahead, left, velocity, points) as 12 frames show it."""

    def make(
        bodies: Bodies, seed: int = 0, size: tuple[float, float, float] = (4.0, 1.8, 1.4)
    ) -> MotionHistory | None:
        rng = np.random.default_rng(seed)
        T = drive(12)
        parts = [
            body(12, n, se3.apply(T[-1], np.array([ahead, left, 0.0])), np.array(v), 0.0, rng, size)
            for ahead, left, v, n in bodies
        ]
        table, points, window = scene_of(rig, T, np.concatenate(parts, axis=1), 0.3, rng)
        history = stereo_history(
            table, points.feature_id, window.timestamp_ns, rig,
            SegmentationSettings().look_back_s, NOISE,
        )  # fmt: skip
        return motion_history(history.younger(1.0), points, window, rig, ObjectSettings(), 60.0)

    return make
