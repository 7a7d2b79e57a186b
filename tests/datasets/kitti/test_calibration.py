"""KITTI calibration files, good ones and broken ones."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ovmot.datasets.kitti.calibration import read_kitti_calibration
from ovmot.errors import CalibrationError
from ovmot.geometry import se3

Edit = Callable[[Path, str, str], None]


def test_kitti_tracking_rig(kitti_tracking: Path) -> None:
    rig = read_kitti_calibration(kitti_tracking / "calib" / "0010.txt", 2, (32, 24)).rig
    # K^-1 P[:, 3]: camera 2 stands 0.06 m left of camera 0, camera 3 0.47 m right of it
    np.testing.assert_allclose(rig.T_cam1_cam0[:3, 3], [-0.53, 0.0, 0.0], atol=1e-12)
    # IMU -> velodyne (-0.8, 0.3, -0.8) -> camera axes: right 0 - 0.3, down 0.8 - 0.1, ahead -1.1
    np.testing.assert_allclose(
        se3.inverse(rig.T_imu_cam0)[:3, 3], [-0.3 + 0.06, 0.7, -1.1], atol=1e-12
    )
    assert (rig.cam0.model.name, rig.cam0.width, rig.cam0.height) == ("none", 32, 24)


def test_kitti_odometry_puts_the_imu_at_the_left_camera(kitti_odometry: Path) -> None:
    path = kitti_odometry / "sequences" / "00" / "calib.txt"
    rig = read_kitti_calibration(path, 0, (32, 24)).rig
    np.testing.assert_allclose(rig.T_imu_cam0[:3, 3], 0.0, atol=1e-12)
    np.testing.assert_allclose(rig.T_imu_cam0[:3, 2], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(rig.T_imu_cam1[:3, 3], [0, -0.5, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("P3:", "Q3:", "'P3': this key is missing"),
        ("P2: 20 0 16 1.2", "P2: 20 0 16", "'P2': expected 3x4"),
        ("P2: 20", "P2: 0", "'P2': not a projection"),
        ("R_rect 1", "R_rect 2", "'R_rect': not a rotation"),
        ("Tr_velo_cam", "Tr_radar", "'Tr_velo_to_cam': this key is missing"),
        ("-9.4", "nan", "'P3': holds a number that is not finite"),
        ("-9.4", "1.2", "same place"),
    ],
)
def test_broken_kitti_files(
    kitti_tracking: Path, edit: Edit, old: str, new: str, message: str
) -> None:
    path = kitti_tracking / "calib" / "0010.txt"
    edit(path, old, new)
    with pytest.raises(CalibrationError, match=message) as caught:
        read_kitti_calibration(path, 2, (32, 24))
    assert str(path) in str(caught.value)
