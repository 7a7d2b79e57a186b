"""Start in motion: velocity, gravity and gyro bias of a curvy path, or a refusal with numbers."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.initialization.dynamic import (
    CannotInitialize,
    DynamicSolution,
    InitializationPrior,
    dynamic_initialization,
    fit_path,
    stereo_path,
)
from ovmot.sim.imu import noisy_imu, perfect_imu
from ovmot.types import FrontendFrame, ImuData, ImuNoise, ImuSample
from ovmot.vio.imu_buffer import ImuBuffer
from ovmot.vio.state import GYRO_BIAS, THETA, VELOCITY, ImuState

G = 9.81
ROUNDING_M = 1e-12
"""Some thousand last bits of the metres that a path goes."""
PRIOR = InitializationPrior(G, 0.05)
N_FRAMES = 13  # 1.2 s at 10 frames a second
FRAME_NS = 100_000_000
GYRO_BIAS_TRUE = np.array([0.02, -0.015, 0.03])
ACCEL_BIAS_TRUE = np.array([0.04, -0.03, 0.05])


@dataclass(frozen=True)
class Drive:
    """What a start gets, and the truth at its first frame."""

    frames: list[FrontendFrame]
    imu: list[ImuData]
    truth: ImuState


MakeDrive = Callable[[int], Drive]


def pieces(data: ImuData, stamps: list[int]) -> list[ImuData]:
    buffer = ImuBuffer()
    for stamp, gyro, accel in zip(data.timestamp_ns, data.gyro, data.accel, strict=True):
        buffer.append(ImuSample(int(stamp), gyro, accel))
    return [buffer.between(a, b) for a, b in pairwise(stamps)]


@pytest.fixture
def make_drive(
    rig: StereoRig,
    curvy_path: PoseSpline,
    landmarks: FloatArray,
    observe: Callable[..., FrontendFrame],
    noise: ImuNoise,
    start_ns: int,
) -> MakeDrive:
    """From a seed: another part of the path, with half a pixel of noise."""

    def make(seed: int) -> Drive:
        rng = np.random.default_rng(seed)
        begin = start_ns + round(1e9 * rng.uniform(0.0, 4.0))
        clean = perfect_imu(curvy_path, begin - 10_000_000 + 5_000_000 * np.arange(245))
        data = noisy_imu(
            clean, noise, rng, gyro_bias=GYRO_BIAS_TRUE, accel_bias=ACCEL_BIAS_TRUE
        ).data
        stamps = [begin + FRAME_NS * k for k in range(N_FRAMES)]
        frames = [observe(rig, curvy_path.pose(t), landmarks, t, 0.5, rng) for t in stamps]
        T = curvy_path.pose(begin)
        truth = ImuState(
            T[:3, :3], T[:3, 3], curvy_path.velocity(begin), GYRO_BIAS_TRUE, ACCEL_BIAS_TRUE
        )
        return Drive(frames, pieces(data, stamps), truth)

    return make


def start(drive: Drive, rig: StereoRig, noise: ImuNoise) -> DynamicSolution:
    return dynamic_initialization(drive.frames, drive.imu, rig, noise, PRIOR)


def test_stereo_path_is_the_path_of_the_imu(
    make_drive: MakeDrive, rig: StereoRig, curvy_path: PoseSpline
) -> None:
    drive = make_drive(1)
    path = stereo_path(drive.frames, drive.imu, rig)
    T = curvy_path.pose(np.array([f.timestamp_ns for f in drive.frames]))
    expected = se3.inverse(T[0]) @ T
    miss = np.linalg.norm(path.T_start_imu[:, :3, 3] - expected[:, :3, 3], axis=1)
    # the first pose is given: its sigma is 0, what it misses is rounding
    assert (miss <= 3.0 * path.sigma + ROUNDING_M).all()
    assert miss[-1] < 0.05
    assert (np.diff(path.sigma) > 0.0).all()


def test_recovers_velocity_gravity_and_biases(
    make_drive: MakeDrive,
    rig: StereoRig,
    noise: ImuNoise,
    start_error: Callable[[ImuState, ImuState], FloatArray],
) -> None:
    for seed in range(4):
        drive = make_drive(seed)
        error = start_error(drive.truth, start(drive, rig, noise).first)
        assert np.linalg.norm(error[VELOCITY]) < 0.05
        assert np.linalg.norm(error[THETA]) < 0.02
        assert np.linalg.norm(error[GYRO_BIAS]) < 0.008


def test_the_world_begins_at_the_first_frame(
    make_drive: MakeDrive, rig: StereoRig, noise: ImuNoise
) -> None:
    found = start(make_drive(3), rig, noise)
    R = found.first.R_world_imu
    assert abs(np.arctan2(R[1, 0], R[0, 0])) < 1e-9
    np.testing.assert_array_equal(found.first.position, 0.0)
    assert len(found.T_world_imu) == N_FRAMES
    np.testing.assert_allclose(found.T_world_imu[0], se3.make(R, np.zeros(3)), atol=1e-12)


def test_exact_data_give_the_exact_start(
    rig: StereoRig,
    curvy_path: PoseSpline,
    landmarks: FloatArray,
    observe: Callable[..., FrontendFrame],
    noise: ImuNoise,
    start_ns: int,
    start_error: Callable[[ImuState, ImuState], FloatArray],
) -> None:
    stamps = [start_ns + FRAME_NS * k for k in range(N_FRAMES)]
    frames = [observe(rig, curvy_path.pose(t), landmarks, t) for t in stamps]
    data = perfect_imu(curvy_path, start_ns - 10_000_000 + 2_500_000 * np.arange(490))
    T, zero = curvy_path.pose(start_ns), np.zeros(3)
    truth = ImuState(T[:3, :3], T[:3, 3], curvy_path.velocity(start_ns), zero, zero)
    found = start(Drive(frames, pieces(data, stamps), truth), rig, noise)
    np.testing.assert_allclose(start_error(truth, found.first), 0.0, atol=2e-3)


def test_refuses_an_imu_that_feels_other_gravity(
    make_drive: MakeDrive, rig: StereoRig, noise: ImuNoise
) -> None:
    drive = make_drive(2)
    imu = [ImuData(x.timestamp_ns, x.gyro, 1.3 * x.accel) for x in drive.imu]
    with pytest.raises(
        CannotInitialize, match=r"gravity .* is 1[23]\.\d+ m/s² \(within 1.5 of 9.81\)"
    ):
        start(replace(drive, imu=imu), rig, noise)


def test_refuses_an_imu_that_shakes_otherwise(
    make_drive: MakeDrive, rig: StereoRig, noise: ImuNoise
) -> None:
    drive = make_drive(2)
    begin = drive.imu[0].timestamp_ns[0]
    imu = []
    for x in drive.imu:
        t = 1e-9 * (x.timestamp_ns - begin)
        shake = 30.0 * np.sin(2.0 * np.pi * t / 0.6)[:, None] * [0.0, 1.0, 0.0]
        imu.append(ImuData(x.timestamp_ns, x.gyro, x.accel + shake))
    with pytest.raises(CannotInitialize, match=r"differ by \d+\.\d sigma \(at most"):
        start(replace(drive, imu=imu), rig, noise)


def test_refuses_frames_that_share_nothing(
    make_drive: MakeDrive, rig: StereoRig, noise: ImuNoise
) -> None:
    drive = make_drive(2)
    lost = [*drive.frames]
    lost[5] = replace(lost[5], feature_id=lost[5].feature_id + 100_000)
    with pytest.raises(CannotInitialize, match="no common stereo motion among 0 tracked points"):
        start(replace(drive, frames=lost), rig, noise)


N_TRUCK = 300
TRUCKS: dict[str, Callable[[float], FloatArray]] = {
    # the way of a truck ahead, in world, after so many seconds
    "swerving": lambda t: np.array([2.5 * t, 1.2 * np.sin(5.0 * t), 0.0]),
    "steady": lambda t: np.array([4.0 * t, -0.5 * t, 0.0]),
}


@pytest.mark.parametrize("truck", list(TRUCKS))
def test_the_nearest_and_largest_body_is_not_the_world(
    truck: str, rig: StereoRig, curvy_path: PoseSpline, landmarks: FloatArray,
    observe: Callable[..., FrontendFrame], noise: ImuNoise, start_ns: int,
    start_error: Callable[[ImuState, ImuState], FloatArray],
) -> None:  # fmt: skip
    """Most points are those of a truck. Of one that swerves the IMU knows that the rig does not
    move against it so; a steady one is a world like any other, but a small one."""
    rng = np.random.default_rng(5)
    body = rng.uniform([9.0, -2.0, -1.0], [12.0, 1.5, 2.0], (N_TRUCK, 3))
    stamps = [start_ns + FRAME_NS * k for k in range(N_FRAMES)]
    frames = []
    for t in stamps:
        points = np.concatenate([body + TRUCKS[truck](1e-9 * (t - start_ns)), landmarks[:150]])
        frames.append(observe(rig, curvy_path.pose(t), points, t, 0.3, rng))
    clean = perfect_imu(curvy_path, start_ns - 10_000_000 + 5_000_000 * np.arange(245))
    zero = np.zeros(3)
    data = noisy_imu(clean, noise, rng, gyro_bias=zero, accel_bias=zero).data
    imu = pieces(data, stamps)
    first = stereo_path(frames, imu, rig)
    followed = np.unique(np.concatenate([f.feature_id for f in frames]))
    n_truck = (followed < N_TRUCK).sum()
    # the images alone would take the truck
    assert (first.feature_id < N_TRUCK).sum() > 0.9 * n_truck
    if truck == "swerving":
        with pytest.raises(CannotInitialize, match=r"m/s²|sigma"):
            fit_path(first, imu, noise, PRIOR)
    found = dynamic_initialization(frames, imu, rig, noise, PRIOR)
    assert (found.feature_id < N_TRUCK).sum() < 0.1 * n_truck
    T = curvy_path.pose(start_ns)
    truth = ImuState(T[:3, :3], T[:3, 3], curvy_path.velocity(start_ns), zero, zero)
    error = start_error(truth, found.first)
    assert np.linalg.norm(error[VELOCITY]) < 0.1
    assert np.linalg.norm(error[THETA]) < 0.03
