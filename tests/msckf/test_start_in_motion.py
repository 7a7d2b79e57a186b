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
from ovmot.imu_buffer import ImuBuffer
from ovmot.msckf.start_at_rest import StartPrior
from ovmot.msckf.start_in_motion import CannotStart, start_in_motion, stereo_path
from ovmot.msckf.state import GYRO_BIAS, THETA, TIME_OFFSET, VELOCITY, ImuState, State
from ovmot.sim.imu import noisy_imu, perfect_imu
from ovmot.types import FrontendFrame, ImuData, ImuNoise, ImuSample

G = 9.81
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


def start(drive: Drive, rig: StereoRig, noise: ImuNoise) -> State:
    return start_in_motion(drive.frames, drive.imu, rig, noise, StartPrior(G, 0.001, 0.004, 0.05))


def test_stereo_path_is_the_path_of_the_imu(
    make_drive: MakeDrive, rig: StereoRig, curvy_path: PoseSpline
) -> None:
    drive = make_drive(1)
    path = stereo_path(drive.frames, drive.imu, rig)
    T = curvy_path.pose(np.array([f.timestamp_ns for f in drive.frames]))
    expected = se3.inverse(T[0]) @ T
    miss = np.linalg.norm(path.T_start_imu[:, :3, 3] - expected[:, :3, 3], axis=1)
    assert (miss <= 3.0 * path.sigma).all()
    assert miss[-1] < 0.05
    assert (np.diff(path.sigma) > 0.0).all()


def test_recovers_velocity_gravity_and_biases(
    make_drive: MakeDrive,
    rig: StereoRig,
    noise: ImuNoise,
    start_error: Callable[[ImuState, ImuState], FloatArray],
) -> None:
    parts = np.r_[0:3, 6:15]
    nees = []
    for seed in range(4):
        drive = make_drive(seed)
        state = start(drive, rig, noise)
        error = start_error(drive.truth, state.imu)
        sigma = np.sqrt(np.diag(state.covariance))[:15]
        assert (np.abs(error)[parts] < 3.5 * sigma[parts]).all()
        assert np.linalg.norm(error[VELOCITY]) < 0.05
        assert np.linalg.norm(error[THETA]) < 0.02
        assert np.linalg.norm(error[GYRO_BIAS]) < 0.008
        # it claims to know something
        assert sigma[VELOCITY].max() < 0.1
        assert sigma[THETA].max() < 0.02
        P = state.covariance[np.ix_(parts, parts)]
        nees.append(error[parts] @ np.linalg.solve(P, error[parts]))
    assert 1.0 < np.mean(nees) < 12.0  # 11 degrees of freedom; sigmas are inflated on purpose


def test_state_is_that_of_the_first_frame(
    make_drive: MakeDrive, rig: StereoRig, noise: ImuNoise
) -> None:
    drive = make_drive(3)
    state = start(drive, rig, noise)
    assert state.timestamp_ns == drive.imu[0].timestamp_ns[0]
    assert state.time_offset_s == 0.001
    assert state.covariance[TIME_OFFSET, TIME_OFFSET] == pytest.approx(0.004**2)
    assert len(state.clones) == 0
    assert abs(np.arctan2(state.imu.R_world_imu[1, 0], state.imu.R_world_imu[0, 0])) < 1e-9
    np.testing.assert_array_equal(state.imu.position, 0.0)
    assert np.linalg.eigvalsh(state.covariance).min() > 0.0


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
    state = start(Drive(frames, pieces(data, stamps), truth), rig, noise)
    np.testing.assert_allclose(start_error(truth, state.imu), 0.0, atol=2e-3)


def test_refuses_an_imu_that_feels_other_gravity(
    make_drive: MakeDrive, rig: StereoRig, noise: ImuNoise
) -> None:
    drive = make_drive(2)
    imu = [ImuData(x.timestamp_ns, x.gyro, 1.3 * x.accel) for x in drive.imu]
    with pytest.raises(CannotStart, match=r"gravity .* is 1[23]\.\d+ m/s² \(within 1.5 of 9.81\)"):
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
    with pytest.raises(CannotStart, match=r"differ by \d+\.\d sigma \(at most"):
        start(replace(drive, imu=imu), rig, noise)


def test_refuses_frames_that_share_nothing(
    make_drive: MakeDrive, rig: StereoRig, noise: ImuNoise
) -> None:
    drive = make_drive(2)
    lost = [*drive.frames]
    lost[5] = replace(lost[5], feature_id=lost[5].feature_id + 100_000)
    with pytest.raises(CannotStart, match="no common stereo motion among 0 tracked points"):
        start(replace(drive, frames=lost), rig, noise)
