"""Dynamic initialization: velocity, gravity and biases of a curvy path, or why there are none."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from drive_fixtures import FRAME_NS, N_WINDOW_FRAMES, ImuDrive, intervals_of

from ovmot.cameras.rig import StereoRig
from ovmot.errors import InitializationError
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.initialization import dynamic
from ovmot.initialization.dynamic import (
    DynamicSolution,
    InitializationPrior,
    align_with_imu,
    dynamic_initialization,
)
from ovmot.initialization.stereo_path import StereoPath, stereo_path
from ovmot.sim.imu import noisy_imu, perfect_imu
from ovmot.types import FrontendFrame, ImuData, ImuNoise
from ovmot.vio.state import GYRO_BIAS, THETA, VELOCITY, ImuState

G = 9.81
PRIOR = InitializationPrior(G, 0.05)
MakeImuDrive = Callable[[int], ImuDrive]


def initialize(drive: ImuDrive, rig: StereoRig, noise: ImuNoise) -> DynamicSolution:
    return dynamic_initialization(drive.frames, drive.imu, rig, noise, PRIOR)


def test_recovers_velocity_gravity_and_biases(
    make_imu_drive: MakeImuDrive,
    rig: StereoRig,
    noise: ImuNoise,
    start_error: Callable[[ImuState, ImuState], FloatArray],
) -> None:
    for seed in range(4):
        drive = make_imu_drive(seed)
        error = start_error(drive.truth, initialize(drive, rig, noise).first)
        assert np.linalg.norm(error[VELOCITY]) < 0.05
        assert np.linalg.norm(error[THETA]) < 0.02
        assert np.linalg.norm(error[GYRO_BIAS]) < 0.008


def test_the_world_begins_at_the_first_frame(
    make_imu_drive: MakeImuDrive, rig: StereoRig, noise: ImuNoise
) -> None:
    found = initialize(make_imu_drive(3), rig, noise)
    R = found.first.R_world_imu
    assert abs(np.arctan2(R[1, 0], R[0, 0])) < 1e-9
    np.testing.assert_array_equal(found.first.position, 0.0)
    assert len(found.T_world_imu) == N_WINDOW_FRAMES
    np.testing.assert_allclose(found.T_world_imu[0], se3.make(R, np.zeros(3)), atol=1e-12)


def test_exact_data_give_the_exact_state(
    rig: StereoRig,
    curvy_path: PoseSpline,
    landmarks: FloatArray,
    observe: Callable[..., FrontendFrame],
    noise: ImuNoise,
    start_ns: int,
    start_error: Callable[[ImuState, ImuState], FloatArray],
) -> None:
    stamps = [start_ns + FRAME_NS * k for k in range(N_WINDOW_FRAMES)]
    frames = [observe(rig, curvy_path.pose(t), landmarks, t) for t in stamps]
    data = perfect_imu(curvy_path, start_ns - 10_000_000 + 2_500_000 * np.arange(490))
    T, zero = curvy_path.pose(start_ns), np.zeros(3)
    truth = ImuState(T[:3, :3], T[:3, 3], curvy_path.velocity(start_ns), zero, zero)
    found = initialize(ImuDrive(frames, intervals_of(data, stamps), truth), rig, noise)
    np.testing.assert_allclose(start_error(truth, found.first), 0.0, atol=2e-3)


def test_refuses_an_imu_that_feels_other_gravity(
    make_imu_drive: MakeImuDrive, rig: StereoRig, noise: ImuNoise
) -> None:
    drive = make_imu_drive(2)
    imu = [ImuData(x.timestamp_ns, x.gyro, 1.3 * x.accel) for x in drive.imu]
    with pytest.raises(
        InitializationError, match=r"gravity .* is 1[23]\.\d+ m/s² \(within 1.5 of 9.81\)"
    ):
        initialize(replace(drive, imu=imu), rig, noise)


def test_refuses_an_imu_that_shakes_otherwise(
    make_imu_drive: MakeImuDrive, rig: StereoRig, noise: ImuNoise
) -> None:
    drive = make_imu_drive(2)
    begin = drive.imu[0].timestamp_ns[0]
    imu = []
    for x in drive.imu:
        t = 1e-9 * (x.timestamp_ns - begin)
        shake = 30.0 * np.sin(2.0 * np.pi * t / 0.6)[:, None] * [0.0, 1.0, 0.0]
        imu.append(ImuData(x.timestamp_ns, x.gyro, x.accel + shake))
    with pytest.raises(InitializationError, match=r"differ by \d+\.\d sigma \(at most"):
        initialize(replace(drive, imu=imu), rig, noise)


def test_refuses_frames_that_share_nothing(
    make_imu_drive: MakeImuDrive, rig: StereoRig, noise: ImuNoise
) -> None:
    drive = make_imu_drive(2)
    lost = [*drive.frames]
    lost[5] = replace(lost[5], feature_id=lost[5].feature_id + 100_000)
    with pytest.raises(InitializationError, match="no common stereo motion among 0 tracked points"):
        initialize(replace(drive, frames=lost), rig, noise)


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
    stamps = [start_ns + FRAME_NS * k for k in range(N_WINDOW_FRAMES)]
    frames = []
    for t in stamps:
        points = np.concatenate([body + TRUCKS[truck](1e-9 * (t - start_ns)), landmarks[:150]])
        frames.append(observe(rig, curvy_path.pose(t), points, t, 0.3, rng))
    clean = perfect_imu(curvy_path, start_ns - 10_000_000 + 5_000_000 * np.arange(245))
    zero = np.zeros(3)
    data = noisy_imu(clean, noise, rng, gyro_bias=zero, accel_bias=zero).data
    imu = intervals_of(data, stamps)
    first = stereo_path(frames, imu, rig)
    tracked = np.unique(np.concatenate([f.feature_id for f in frames]))
    n_truck = (tracked < N_TRUCK).sum()
    # the images alone would take the truck
    assert (first.feature_id < N_TRUCK).sum() > 0.9 * n_truck
    if truck == "swerving":
        with pytest.raises(InitializationError, match=r"m/s²|sigma"):
            align_with_imu(first, imu, noise, PRIOR)
    found = dynamic_initialization(frames, imu, rig, noise, PRIOR)
    assert (found.feature_id < N_TRUCK).sum() < 0.1 * n_truck
    T = curvy_path.pose(start_ns)
    truth = ImuState(T[:3, :3], T[:3, 3], curvy_path.velocity(start_ns), zero, zero)
    error = start_error(truth, found.first)
    assert np.linalg.norm(error[VELOCITY]) < 0.1
    assert np.linalg.norm(error[THETA]) < 0.03


@pytest.mark.parametrize("plainly", [True, False])
def test_a_small_body_that_agrees_is_not_the_world_where_a_larger_one_may_be(
    plainly: bool, rig: StereoRig, curvy_path: PoseSpline, landmarks: FloatArray,
    observe: Callable[..., FrontendFrame], noise: ImuNoise, start_ns: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """A truck ahead keeps its speed; the world's motion differs from the IMU's by some sigmas."""
    rng = np.random.default_rng(6)
    body = rng.uniform([9.0, -2.0, -1.0], [12.0, 1.5, 2.0], (N_TRUCK, 3))
    stamps = [start_ns + FRAME_NS * k for k in range(N_WINDOW_FRAMES)]
    frames = []
    for t in stamps:
        points = np.concatenate([body + TRUCKS["steady"](1e-9 * (t - start_ns)), landmarks[:150]])
        frames.append(observe(rig, curvy_path.pose(t), points, t, 0.3, rng))
    clean = perfect_imu(curvy_path, start_ns - 10_000_000 + 5_000_000 * np.arange(245))
    zero = np.zeros(3)
    data = noisy_imu(clean, noise, rng, gyro_bias=zero, accel_bias=zero).data
    imu = intervals_of(data, stamps)
    refined = dynamic._refine_with_known_gravity
    misfit = 1.5 * (dynamic._PLAIN_RMS if plainly else dynamic._MAX_RMS)

    def aligned(path: StereoPath, *given: object) -> DynamicSolution:
        of_world = (path.feature_id >= N_TRUCK).mean() > 0.5

        def refine(*args: FloatArray) -> object:
            fit = refined(*args)  # type: ignore[arg-type]
            return replace(fit, rms=misfit) if of_world else fit

        monkeypatch.setattr(dynamic, "_refine_with_known_gravity", refine)
        return align_with_imu(path, *given)  # type: ignore[arg-type]

    monkeypatch.setattr(dynamic, "align_with_imu", aligned)
    if plainly:
        found = dynamic_initialization(frames, imu, rig, noise, PRIOR)
        assert (found.feature_id < N_TRUCK).mean() > 0.5
    else:
        with pytest.raises(InitializationError, match="a smaller body agrees"):
            dynamic_initialization(frames, imu, rig, noise, PRIOR)
