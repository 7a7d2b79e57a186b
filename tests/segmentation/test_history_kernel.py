"""The compiled triangulation and ego motion equal their plain NumPy twins."""

from collections.abc import Callable

import numpy as np
import pytest
from static_twin import ego_part

from ovmot.cameras.rig import StereoRig
from ovmot.feature_table import StereoHistory
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.triangulation import stereo_covariance, triangulate_stereo
from ovmot.segmentation.history_kernel import (
    ego_motion,
    ego_motion_compiled,
    triangulate_pairs,
    triangulate_pairs_compiled,
)
from ovmot.types import PoseWindow

SIGMA_PX = 0.3
Case = tuple[StereoHistory, PoseWindow]
Triangulation = Callable[..., tuple[FloatArray, FloatArray, FloatArray]]


@pytest.mark.parametrize("pairs", [triangulate_pairs, triangulate_pairs_compiled])
def test_pairs_are_triangulated_as_by_the_twin(
    rig: StereoRig, compared_case: Case, pairs: Triangulation
) -> None:
    history, T10 = compared_case[0], np.ascontiguousarray(rig.T_cam1_cam0)
    sigma = rig.normalized_sigma(SIGMA_PX)
    p_then, p_now, cov_now = pairs(history.then, history.now, T10, sigma)
    twin = triangulate_stereo(history.now, T10)
    np.testing.assert_allclose(p_then, triangulate_stereo(history.then, T10), rtol=1e-12)
    np.testing.assert_allclose(p_now, twin, rtol=1e-12)
    C = stereo_covariance(twin, T10, sigma)
    np.testing.assert_allclose(cov_now, C, rtol=1e-9, atol=1e-15)
    assert np.isnan(p_now[5]).all() and np.isfinite(p_now[0]).all()


@pytest.mark.parametrize("motion", [ego_motion, ego_motion_compiled])
def test_the_ego_motion_and_what_its_errors_do(
    rig: StereoRig, compared_case: Case, motion: Callable[..., tuple[FloatArray, FloatArray]]
) -> None:
    history, window = compared_case
    clone = np.searchsorted(window.timestamp_ns, history.clone_ns)
    T_now_then, covariance = motion(
        window.T_world_imu, window.covariance, clone, np.ascontiguousarray(rig.T_imu_cam0)
    )
    T = window.T_world_imu @ rig.T_imu_cam0
    np.testing.assert_allclose(T_now_then, se3.inverse(T[-1]) @ T[clone], atol=1e-12)
    p = se3.apply(T_now_then[:, None], history.p_then)
    B = np.concatenate([so3.hat(p), np.broadcast_to(np.eye(3), (*p.shape, 3))], axis=-1)
    expected = ego_part(history, window, rig)
    found = B @ covariance[:, None] @ np.swapaxes(B, -1, -2)
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-10 * np.nanmax(expected))
