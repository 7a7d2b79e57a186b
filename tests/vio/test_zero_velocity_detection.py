"""Does the picture stand? Points that keep their place, and no metric motion."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import FeatureTable, append_frame, empty_table, mark_dynamic
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.settings import ZeroVelocitySettings
from ovmot.types import FrontendFrame
from ovmot.vio.zero_velocity_detection import image_is_stationary, still_share

SETTINGS = ZeroVelocitySettings()
Observe = Callable[..., FrontendFrame]


@pytest.fixture
def watched(
    rig: StereoRig, landmarks: FloatArray, observe: Observe, start_ns: int
) -> Callable[[float, float], FeatureTable]:
    """A function (speed in m/s, seconds) to the table of a rig that goes forward, at 10 Hz."""

    def build(speed: float, seconds: float) -> FeatureTable:
        rng, table = np.random.default_rng(1), empty_table()
        for k in range(round(10 * seconds) + 1):
            T = se3.make(np.eye(3), np.array([0.1 * k * speed, 0.0, 0.0]))
            stamp = start_ns + 100_000_000 * k
            table = append_frame(table, observe(rig, T, landmarks[:100], stamp, 0.1, rng))
        return table

    return build


def test_share_counts_candidates_seen_in_both_frames() -> None:
    earlier = np.tile([100.0, 50.0], (40, 1))
    now = earlier.copy()
    now[:10] += 3.0
    now[10:20, 0] += 0.3  # within the noise
    earlier[20:25] = np.nan
    now[25:30] = np.nan
    candidates = np.arange(40) >= 5
    assert still_share(now, earlier, candidates, 0.4) == pytest.approx(20 / 25)
    assert still_share(now, earlier, np.arange(40) < 7, 0.4) == 0.0  # too few to say


def test_rest_is_still_and_a_creep_is_not(
    watched: Callable[[float, float], FeatureTable], rig: StereoRig
) -> None:
    assert image_is_stationary(watched(0.0, 1.0), rig, SETTINGS)
    assert not image_is_stationary(watched(0.1, 1.0), rig, SETTINGS)


def test_points_that_look_still_do_not_hide_a_metric_motion(
    watched: Callable[[float, float], FeatureTable], rig: StereoRig
) -> None:
    lenient = SETTINGS.model_copy(update={"pixel": 100.0})
    assert image_is_stationary(watched(0.0, 1.0), rig, lenient)
    assert not image_is_stationary(watched(0.2, 1.0), rig, lenient)


def test_a_short_history_says_nothing(
    watched: Callable[[float, float], FeatureTable], rig: StereoRig
) -> None:
    assert not image_is_stationary(watched(0.0, 0.2), rig, SETTINGS)
    assert image_is_stationary(watched(0.0, 0.3), rig, SETTINGS)


def test_suspects_and_barred_features_have_no_say(
    watched: Callable[[float, float], FeatureTable], rig: StereoRig
) -> None:
    table = watched(0.0, 1.0)
    everyone = mark_dynamic(table, table.feature_id)
    assert not image_is_stationary(everyone, rig, SETTINGS)
    assert not image_is_stationary(replace(table, outlier=~table.outlier), rig, SETTINGS)
