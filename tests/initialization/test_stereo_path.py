"""The stereo path of an initializer's window, and the space that a body's points occupy."""

from collections.abc import Callable

import numpy as np
import pytest
from drive_fixtures import FRAME_NS, N_WINDOW_FRAMES, ImuDrive, intervals_of

from ovmot.cameras.rig import StereoRig
from ovmot.errors import InitializationError
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.initialization.stereo_path import measured_pixel_sigma, occupied_cells, stereo_path
from ovmot.physics import PIXEL_SIGMA
from ovmot.sim.imu import perfect_imu
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


def test_the_noise_of_the_pairs_is_measured(
    rig: StereoRig, landmarks: FloatArray, observe: Callable[..., FrontendFrame]
) -> None:
    """Too few pairs show none."""
    rng = np.random.default_rng(4)
    frames = [observe(rig, np.eye(4), landmarks, t, 0.2, rng) for t in range(10)]
    assert measured_pixel_sigma(frames, rig) == pytest.approx(0.2, rel=0.1)
    few = [observe(rig, np.eye(4), landmarks[:10], 0, 0.2, rng)]
    assert measured_pixel_sigma(few, rig) == PIXEL_SIGMA


def test_a_path_follows_the_world_beside_a_vehicle_that_drives_almost_as_fast(
    rig: StereoRig, curvy_path: PoseSpline, observe: Callable[..., FrontendFrame], start_ns: int
) -> None:
    """All near points are a vehicle's; those of the street are far."""
    rng = np.random.default_rng(6)
    street = rng.uniform([12.0, -25.0, -2.0], [60.0, 25.0, 12.0], (300, 3))
    vehicle = rng.uniform([5.0, -3.0, -1.0], [8.0, -1.5, 0.5], (100, 3))
    stamps = [start_ns + FRAME_NS * k for k in range(N_WINDOW_FRAMES)]
    frames = []
    for t in stamps:
        along = 0.9 * (curvy_path.pose(t)[:3, 3] - curvy_path.pose(start_ns)[:3, 3])
        points = np.concatenate([street, vehicle + along])
        frames.append(observe(rig, curvy_path.pose(t), points, t, 0.15, rng))
    samples = perfect_imu(curvy_path, start_ns - 10_000_000 + 5_000_000 * np.arange(245))
    path = stereo_path(frames, intervals_of(samples, stamps), rig)
    T = curvy_path.pose(np.array(stamps))
    expected = se3.inverse(T[0]) @ T
    miss = np.linalg.norm(path.T_first_imu[:, :3, 3] - expected[:, :3, 3], axis=1)
    assert miss[-1] < 3.0 * path.position_sigma[-1]
    assert (path.feature_id >= len(street)).sum() < 0.1 * len(vehicle)


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
