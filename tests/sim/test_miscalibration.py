"""A wrong calibration is wrong by the amounts asked for, in directions that the seed draws."""

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import so3
from ovmot.sim.handheld import handheld_rig
from ovmot.sim.miscalibration import Miscalibration, miscalibrated

ERROR = Miscalibration(rotation_deg=1.0, position_m=0.02, focal_share=0.01, time_offset_s=0.01)


@pytest.mark.parametrize("seed", range(4))
def test_it_is_wrong_by_these_amounts(seed: int) -> None:
    true = handheld_rig()
    prior = miscalibrated(true, ERROR, np.random.default_rng(seed))
    for T, T_true in zip(poses(prior), poses(true), strict=True):
        turn = np.linalg.norm(so3.log(T[:3, :3].T @ T_true[:3, :3]))
        assert np.degrees(turn) == pytest.approx(1.0)
        assert np.linalg.norm(T[:3, 3] - T_true[:3, 3]) == pytest.approx(0.02)
    for camera, right in zip(prior.cameras, true.cameras, strict=True):
        share = camera.intrinsics[:2] / right.intrinsics[:2] - 1.0
        np.testing.assert_allclose(np.abs(share), 0.01)
        assert share[0] == pytest.approx(share[1])
        np.testing.assert_array_equal(camera.intrinsics[2:], right.intrinsics[2:])
        np.testing.assert_array_equal(camera.distortion, right.distortion)
    assert abs(prior.time_offset_s - true.time_offset_s) == pytest.approx(0.01)


def test_the_seed_decides_the_directions() -> None:
    one, same, other = (
        miscalibrated(handheld_rig(), ERROR, np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one.T_imu_cam0, same.T_imu_cam0)
    assert np.abs(one.T_imu_cam0 - other.T_imu_cam0).max() > 1e-3
    assert np.abs(one.T_imu_cam0 - one.T_imu_cam1)[:3, :3].max() > 1e-3  # each camera its own


def test_no_error_is_the_true_rig() -> None:
    true = handheld_rig()
    told = miscalibrated(true, Miscalibration(), np.random.default_rng(0))
    np.testing.assert_allclose(told.T_imu_cam1, true.T_imu_cam1, atol=1e-14)
    np.testing.assert_array_equal(told.cam0.intrinsics, true.cam0.intrinsics)
    assert told.time_offset_s == true.time_offset_s


def poses(rig: StereoRig) -> tuple[np.ndarray, np.ndarray]:
    return rig.T_imu_cam0, rig.T_imu_cam1
