"""Motions that are none are refused, by covariance and by thresholds."""

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.objects.bodies_kernel import known_part
from ovmot.objects.measurement_kernel import MeasuredBodies
from ovmot.objects.static_motion import (
    FoundMotions,
    static_by_covariance,
    static_by_thresholds,
)
from ovmot.settings import ObjectSettings, SegmentationSettings

POINTS = np.array([[-1.0, 0.2, 15.0], [0.5, -0.3, 15.5], [0.2, 0.6, 16.0], [0.9, 0.1, 15.2]])
SETTINGS = ObjectSettings(alpha_m=0.1, beta_m=0.4, gamma_px_m=15.0, delta_px=2.0)
OF_POINTS = SegmentationSettings(depth_weight=0.3)


def _motions(velocity: FloatArray, C: FloatArray, shift: FloatArray, n: int = 4) -> FoundMotions:
    """A body without inliers, and one that was shifted (3,), with the first n of the points."""
    covariance = np.zeros((2, 6, 6))
    covariance[1, 3:, 3:] = C
    none, zeros = np.zeros((2, 3)), np.zeros(2, np.int64)
    T_now_before = np.stack([np.zeros((4, 4)), se3.make(np.eye(3), shift)])
    measured = MeasuredBodies(
        np.arange(4), zeros, np.array([0, n]), none, none, none, np.stack([none[0], velocity]),
        T_now_before, covariance,
    )  # fmt: skip
    return FoundMotions(measured, POINTS, np.eye(4))


def _shifted(shift: list[float], n: int = 4) -> FoundMotions:
    return _motions(np.array([1.0, 0.0, 0.0]), 0.01 * np.eye(3), np.array(shift), n)


def _found(velocity: FloatArray, covariance: FloatArray) -> FoundMotions:
    return _motions(velocity, covariance, np.zeros(3))


def is_static_by_covariance(rig: StereoRig, motions: FoundMotions) -> bool:
    return bool(static_by_covariance(motions, rig, SETTINGS, OF_POINTS)[1])


def is_static_by_thresholds(
    rig: StereoRig, motions: FoundMotions, settings: ObjectSettings = SETTINGS
) -> bool:
    return bool(static_by_thresholds(motions, rig, settings, OF_POINTS)[1])


@pytest.mark.parametrize(("sigma", "static"), [(0.1, False), (0.3, True)])
def test_covariance_decides_by_the_share_of_noise(
    rig: StereoRig, sigma: float, static: bool
) -> None:
    # 1 m/s at 21.1 = 99.99 % of chi-squared with 3 degrees of freedom: 4.59 sigmas
    motion = _found(np.array([1.0, 0.0, 0.0]), sigma**2 * np.eye(3))
    assert is_static_by_covariance(rig, motion) is static


def test_directions_in_which_little_is_known_do_not_count(rig: StereoRig) -> None:
    ray = np.array([0.6, 0.0, 0.8])
    across = np.array([0.8, 0.0, -0.6])
    C = 0.1**2 * np.eye(3) + 5.0**2 * np.outer(ray, ray)
    both = np.eye(6)
    both[3:, 3:] = C
    known, variance = known_part(40.0 * ray + 2.0 * across, both, 1.5)
    assert np.linalg.norm(known) == pytest.approx(2.0)
    np.testing.assert_allclose(variance, 0.01)
    along = _found(40.0 * ray, C)  # eight sigmas, that mean nothing there
    assert is_static_by_covariance(rig, along)
    assert not is_static_by_covariance(rig, _found(2.0 * across, C))
    assert is_static_by_covariance(rig, _found(across, 9.0 * np.eye(3)))


def test_thresholds_want_metres_and_pixels(rig: StereoRig) -> None:
    # α + β/4 = 0.2 m across the ray; 406 px x 0.21 / 15.4 = 5.5 px against 15/15.4 + 2/4 = 1.5 px
    assert not is_static_by_thresholds(rig, _shifted([0.21, 0.0, 0.0]))
    assert is_static_by_thresholds(rig, _shifted([0.19, 0.0, 0.0]))
    # along the ray: metres count 0.3, and the picture hardly changes
    assert is_static_by_thresholds(rig, _shifted([0.0, 0.0, 0.6]))
    assert not is_static_by_thresholds(rig, _shifted([0.0, 0.0, 3.0]))


def test_few_points_must_show_more(rig: StereoRig) -> None:
    shift = [0.22, 0.0, 0.0]
    assert not is_static_by_thresholds(rig, _shifted(shift))
    assert is_static_by_thresholds(rig, _shifted(shift, 3))


def test_pixels_alone_can_refuse(rig: StereoRig) -> None:
    strict = SETTINGS.model_copy(update={"gamma_px_m": 150.0})
    assert is_static_by_thresholds(rig, _shifted([0.21, 0.0, 0.0]), strict)
