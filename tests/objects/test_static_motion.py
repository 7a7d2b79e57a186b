"""Motions that are none are refused, by covariance and by thresholds."""

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.objects.measurement_kernel import known_part_compiled
from ovmot.objects.static_motion import (
    FoundMotion,
    is_static_by_covariance,
    is_static_by_thresholds,
)
from ovmot.settings import ObjectSettings, SegmentationSettings

POINTS = np.array([[-1.0, 0.2, 15.0], [0.5, -0.3, 15.5], [0.2, 0.6, 16.0], [0.9, 0.1, 15.2]])
SETTINGS = ObjectSettings(alpha_m=0.1, beta_m=0.4, gamma_px_m=15.0, delta_px=2.0)
OF_POINTS = SegmentationSettings(depth_weight=0.3)


def _shifted(shift: list[float], points: np.ndarray = POINTS) -> FoundMotion:
    T_now_before = se3.make(np.eye(3), np.array(shift))
    return FoundMotion(np.array([1.0, 0.0, 0.0]), 0.01 * np.eye(3), points, T_now_before, np.eye(4))


def _found(velocity: FloatArray, covariance: FloatArray) -> FoundMotion:
    return FoundMotion(velocity, covariance, POINTS, np.eye(4), np.eye(4))


@pytest.mark.parametrize(("sigma", "static"), [(0.1, False), (0.3, True)])
def test_covariance_decides_by_the_share_of_noise(
    rig: StereoRig, sigma: float, static: bool
) -> None:
    # 1 m/s at 21.1 = 99.99 % of chi-squared with 3 degrees of freedom: 4.59 sigmas
    motion = _found(np.array([1.0, 0.0, 0.0]), sigma**2 * np.eye(3))
    assert is_static_by_covariance(motion, rig, SETTINGS, OF_POINTS) is static


def test_directions_in_which_little_is_known_do_not_count(rig: StereoRig) -> None:
    ray = np.array([0.6, 0.0, 0.8])
    across = np.array([0.8, 0.0, -0.6])
    C = 0.1**2 * np.eye(3) + 5.0**2 * np.outer(ray, ray)
    known, variance = known_part_compiled(40.0 * ray + 2.0 * across, C, 1.5)
    assert np.linalg.norm(known) == pytest.approx(2.0)
    np.testing.assert_allclose(variance, 0.01)
    along = _found(40.0 * ray, C)  # eight sigmas, that mean nothing there
    assert is_static_by_covariance(along, rig, SETTINGS, OF_POINTS)
    assert not is_static_by_covariance(_found(2.0 * across, C), rig, SETTINGS, OF_POINTS)
    assert is_static_by_covariance(_found(across, 9.0 * np.eye(3)), rig, SETTINGS, OF_POINTS)


def test_thresholds_want_metres_and_pixels(rig: StereoRig) -> None:
    # α + β/4 = 0.2 m across the ray; 406 px x 0.21 / 15.4 = 5.5 px against 15/15.4 + 2/4 = 1.5 px
    assert not is_static_by_thresholds(_shifted([0.21, 0.0, 0.0]), rig, SETTINGS, OF_POINTS)
    assert is_static_by_thresholds(_shifted([0.19, 0.0, 0.0]), rig, SETTINGS, OF_POINTS)
    # along the ray: metres count 0.3, and the picture hardly changes
    assert is_static_by_thresholds(_shifted([0.0, 0.0, 0.6]), rig, SETTINGS, OF_POINTS)
    assert not is_static_by_thresholds(_shifted([0.0, 0.0, 3.0]), rig, SETTINGS, OF_POINTS)


def test_few_points_must_show_more(rig: StereoRig) -> None:
    shift = [0.22, 0.0, 0.0]
    assert not is_static_by_thresholds(_shifted(shift), rig, SETTINGS, OF_POINTS)
    assert is_static_by_thresholds(_shifted(shift, POINTS[:3]), rig, SETTINGS, OF_POINTS)


def test_pixels_alone_can_refuse(rig: StereoRig) -> None:
    strict = SETTINGS.model_copy(update={"gamma_px_m": 150.0})
    assert is_static_by_thresholds(_shifted([0.21, 0.0, 0.0]), rig, strict, OF_POINTS)
