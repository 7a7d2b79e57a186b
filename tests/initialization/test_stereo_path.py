"""The stereo path of an initializer's window, and the space that a body's points occupy."""

from collections.abc import Callable

import numpy as np
import pytest
from drive_fixtures import ImuDrive

from ovmot.cameras.rig import StereoRig
from ovmot.errors import InitializationError
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.initialization.stereo_path import occupied_cells, stereo_path
from ovmot.types import FrontendFrame

ROUNDING_M = 1e-12
"""Some thousand last bits of the metres that a path goes."""
MakeImuDrive = Callable[[int], ImuDrive]


def test_stereo_path_is_the_path_of_the_imu(
    make_imu_drive: MakeImuDrive, rig: StereoRig, curvy_path: PoseSpline
) -> None:
    drive = make_imu_drive(1)
    path = stereo_path(drive.frames, drive.imu, rig)
    T = curvy_path.pose(np.array([f.timestamp_ns for f in drive.frames]))
    expected = se3.inverse(T[0]) @ T
    miss = np.linalg.norm(path.T_first_imu[:, :3, 3] - expected[:, :3, 3], axis=1)
    # the first pose is given: its sigma is 0, what it misses is rounding
    assert (miss <= 3.0 * path.position_sigma + ROUNDING_M).all()
    assert miss[-1] < 0.05
    assert (np.diff(path.position_sigma) > 0.0).all()


def test_excluded_features_are_left_out(make_imu_drive: MakeImuDrive, rig: StereoRig) -> None:
    drive = make_imu_drive(1)
    excluded = np.arange(0, 400, 2)
    path = stereo_path(drive.frames, drive.imu, rig, excluded)
    assert len(path.feature_id) > 20
    assert not np.isin(path.feature_id, excluded).any()
    with pytest.raises(InitializationError, match="no common stereo motion among 0 tracked"):
        stereo_path(drive.frames, drive.imu, rig, np.arange(400))


def test_a_street_occupies_more_space_than_a_truck_with_more_points(
    rig: StereoRig, landmarks: FloatArray, observe: Callable[..., FrontendFrame]
) -> None:
    rng = np.random.default_rng(2)
    truck = rng.uniform([8.0, -1.2, -1.0], [12.0, 1.2, 2.0], (500, 3))
    near = landmarks[landmarks[:, 0] < 20.0]

    def cells(points: FloatArray) -> int:
        return occupied_cells(observe(rig, np.eye(4), points, 0).normalized, rig)

    assert len(near) < 200
    assert 0 < cells(truck) < cells(near)
    # far points have no depth, and points without a right view no place
    assert cells(truck + np.array([400.0, 0.0, 0.0])) == 0
    mono = observe(rig, np.eye(4), truck, 0).normalized.copy()
    mono[:, 2:] = np.nan
    assert occupied_cells(mono, rig) == 0
