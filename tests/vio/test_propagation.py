"""IMU propagation: mean, transition, noise, first estimates, and the cloned pose."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import expm

from ovmot.geometry import so3
from ovmot.geometry.arrays import BoolArray, FloatArray
from ovmot.geometry.splines import PoseSpline
from ovmot.sim.imu import noisy_imu, perfect_imu
from ovmot.types import ImuData, ImuNoise, ImuSample
from ovmot.vio.imu_buffer import ImuBuffer
from ovmot.vio.integrators import INTEGRATORS, integrate_rk4
from ovmot.vio.propagation import (
    Propagation,
    clone_pose,
    propagate,
    propagate_imu,
)
from ovmot.vio.state import (
    ACCEL_BIAS,
    GYRO_BIAS,
    N_BASE,
    N_IMU,
    POSITION,
    THETA,
    TIME_OFFSET,
    VELOCITY,
    ImuState,
    State,
    box_minus,
    box_plus,
    no_clones,
)

G = 9.81
BLOCKS = {
    "rotation": THETA, "position": POSITION, "velocity": VELOCITY,
    "gyro bias": GYRO_BIAS, "accel bias": ACCEL_BIAS,
}  # fmt: skip
integrators = pytest.mark.parametrize("name", list(INTEGRATORS))
Derivative = Callable[..., FloatArray]


def stamps(start_ns: int, span_s: float, rate_hz: float) -> np.ndarray:
    n = round(span_s * rate_hz)
    return start_ns + np.round(1e9 * np.arange(n + 1) / rate_hz).astype(np.int64)


def imu_state(path: PoseSpline, stamp: int) -> ImuState:
    T = path.pose(stamp)
    return ImuState(T[:3, :3], T[:3, 3], path.velocity(stamp), np.zeros(3), np.zeros(3))


def as_state(imu: ImuState, stamp: int) -> State:
    return State(stamp, imu, imu, 0.0, no_clones(), np.eye(N_BASE))


def run(imu: ImuState, samples: ImuData, noise: ImuNoise, name: str) -> Propagation:
    return propagate_imu(imu, imu, samples, noise, G, INTEGRATORS[name])


@integrators
def test_transition_is_the_derivative_of_the_mean(
    name: str,
    curvy_path: PoseSpline,
    start_ns: int,
    noise: ImuNoise,
    central_differences: Derivative,
) -> None:
    # The transition is that of continuous time: what it leaves out falls with the samples' step.
    samples = perfect_imu(curvy_path, stamps(start_ns, 0.1, 1000.0))
    imu = replace(
        imu_state(curvy_path, start_ns),
        gyro_bias=np.array([0.02, -0.01, 0.03]),
        accel_bias=np.array([0.1, 0.2, -0.15]),
    )
    start = as_state(imu, start_ns)
    result = run(imu, samples, noise, name)
    end = replace(start, imu=result.imu)

    def moved_end(error: FloatArray) -> FloatArray:
        moved = box_plus(start, np.append(error, 0.0)).imu
        return box_minus(replace(end, imu=run(moved, samples, noise, name).imu), end)[:N_IMU]

    expected = central_differences(moved_end, np.zeros(N_IMU), 1e-5)
    for row, r in BLOCKS.items():
        for column, c in BLOCKS.items():
            # `discrete` does not turn the body within a step, the transition does
            loose = name == "discrete" and column == "gyro bias" and row in ("position", "velocity")
            tolerance = (0.02 if loose else 2e-4) * np.abs(expected[r, c]).max() + 1e-8
            error = np.abs(result.transition[r, c] - expected[r, c]).max()
            assert error <= tolerance, f"{row} by {column}"


@integrators
def test_a_long_step_turns_with_the_gyro_bias_exactly(
    name: str, start_ns: int, noise: ImuNoise, central_differences: Derivative
) -> None:
    t = np.array([start_ns, start_ns + 100_000_000])
    one = np.ones((2, 1))
    samples = ImuData(t, one * [2.0, -5.0, 3.0], one * [0.0, 0.0, G])
    zero = np.zeros(3)
    imu = ImuState(np.eye(3), zero, zero, zero, zero)
    end = run(imu, samples, noise, name)

    def turned(bias: FloatArray) -> FloatArray:
        R = run(replace(imu, gyro_bias=bias), samples, noise, name).imu.R_world_imu
        return so3.log(end.imu.R_world_imu.T @ R)

    expected = central_differences(turned, zero)
    # a step of Runge-Kutta is off by the fifth power of its angle
    tolerance = {"discrete": 1e-8, "analytic": 1e-8, "rk4": 5e-4}[name]
    np.testing.assert_allclose(end.transition[THETA, GYRO_BIAS], expected, atol=tolerance)
    assert np.abs(expected + 0.1 * np.eye(3)).max() > 0.01


def increments(gyro: FloatArray, accel: FloatArray, t: float) -> FloatArray:
    """[R v p] (3, 5) after t seconds of constant body rates, from rest, without gravity."""
    A = np.zeros((5, 5))
    A[:3, :3], A[:3, 3], A[3, 4] = so3.hat(gyro), accel, 1.0
    return np.asarray(expm(A * t)[:3])


@pytest.mark.parametrize(("name", "order"), [("discrete", 1), ("rk4", 4)])
def test_error_under_constant_rates_falls_by_the_integrators_order(
    name: str, order: int, curvy_path: PoseSpline, start_ns: int, noise: ImuNoise
) -> None:
    gyro, accel, span = np.array([0.8, -1.5, 2.0]), np.array([3.0, -2.0, 11.0]), 0.8
    imu = imu_state(curvy_path, start_ns)
    X, g = increments(gyro, accel, span), np.array([0.0, 0.0, -G])
    v = imu.velocity + g * span + imu.R_world_imu @ X[:, 3]
    p = imu.position + imu.velocity * span + 0.5 * g * span**2 + imu.R_world_imu @ X[:, 4]
    errors = []
    for rate_hz in (20.0, 40.0):
        t = stamps(start_ns, span, rate_hz)
        one = np.ones((len(t), 1))
        end = run(imu, ImuData(t, gyro * one, accel * one), noise, name).imu
        np.testing.assert_allclose(end.R_world_imu, imu.R_world_imu @ X[:, :3], atol=1e-7)
        errors.append([np.linalg.norm(end.velocity - v), np.linalg.norm(end.position - p)])
    fall = np.array(errors[0]) / np.array(errors[1])
    np.testing.assert_allclose(fall, 2.0**order, rtol=0.25)


@integrators
def test_helix(name: str, start_ns: int, noise: ImuNoise) -> None:
    radius, climb, w, span = 5.0, 0.7, 1.2, 2.0
    t = stamps(start_ns, span, 400.0)
    one = np.ones((len(t), 1))
    samples = ImuData(t, one * [0.0, 0.0, w], one * [-radius * w**2, 0.0, G])
    zero = np.zeros(3)
    start = ImuState(
        np.eye(3), np.array([radius, 0.0, 0.0]), np.array([0.0, radius * w, climb]), zero, zero
    )
    end = run(start, samples, noise, name).imu
    c, s = np.cos(w * span), np.sin(w * span)
    tolerance = {"rk4": 1e-8, "analytic": 1e-9, "discrete": 0.05}[name]
    np.testing.assert_allclose(end.position, [radius * c, radius * s, climb * span], atol=tolerance)
    np.testing.assert_allclose(
        end.velocity, [-radius * w * s, radius * w * c, climb], atol=tolerance
    )
    np.testing.assert_allclose(end.R_world_imu, [[c, -s, 0], [s, c, 0], [0, 0, 1]], atol=1e-9)


def test_noise_is_the_scatter_of_the_end(
    curvy_path: PoseSpline, start_ns: int, noise: ImuNoise
) -> None:
    clean = perfect_imu(curvy_path, stamps(start_ns, 0.1, 200.0))
    imu = imu_state(curvy_path, start_ns)
    end = run(imu, clean, noise, "rk4")
    rng = np.random.default_rng(9)
    zero = np.zeros(3)
    errors = []
    for _ in range(400):
        sensor = noisy_imu(clean, noise, rng, gyro_bias=zero, accel_bias=zero)
        reached = as_state(run(imu, sensor.data, noise, "rk4").imu, start_ns)
        walked = replace(end.imu, gyro_bias=sensor.gyro_bias[-1], accel_bias=sensor.accel_bias[-1])
        errors.append(box_minus(as_state(walked, start_ns), reached)[:N_IMU])
    L = np.linalg.inv(np.linalg.cholesky(end.noise))
    white = np.cov(np.array(errors).T)
    white = L @ white @ L.T
    np.testing.assert_allclose(np.diag(white), 1.0, atol=0.25)
    np.testing.assert_allclose(white, np.eye(N_IMU), atol=0.3)


def test_a_gap_leaves_the_end_uncertain_also_with_frames_inside_it(
    curvy_path: PoseSpline, start_ns: int, noise: ImuNoise
) -> None:
    t = stamps(start_ns, 1.5, 100.0)
    data = perfect_imu(curvy_path, t)

    def position_sigma(kept: BoolArray) -> float:
        """After frames at 10 Hz over the whole stretch, each cut from what is left."""
        buffer = ImuBuffer()
        for i in np.flatnonzero(kept):
            buffer.append(ImuSample(int(t[i]), data.gyro[i], data.accel[i]))
        imu, P = imu_state(curvy_path, start_ns), np.zeros((N_IMU, N_IMU))
        for begin in range(start_ns, int(t[-1]), 100_000_000):
            cut = buffer.between(begin, begin + 100_000_000)
            unseen = buffer.spacing_s(cut) > 0.1
            step = propagate_imu(imu, imu, cut, noise, 9.81, integrate_rk4, unseen)
            Phi = step.transition[:, :N_IMU]
            imu, P = step.imu, Phi @ P @ Phi.T + step.noise
        return float(np.sqrt(P[POSITION, POSITION].max()))

    everything = np.ones(len(t), dtype=np.bool_)
    short_gap, long_gap = everything.copy(), everything.copy()
    short_gap[21:25] = False  # 50 ms
    long_gap[21:81] = False  # 0.6 s, with six frames inside
    assert position_sigma(short_gap) < 1.5 * position_sigma(everything)
    assert position_sigma(long_gap) > 100.0 * position_sigma(everything)


def test_where_the_length_is_unsure_the_pose_is_along_its_motion(
    curvy_path: PoseSpline, start_ns: int, noise: ImuNoise
) -> None:
    """By a length of the interval that differs by one standard deviation."""
    imu = imu_state(curvy_path, start_ns)
    t = stamps(start_ns, 0.02, 200.0)
    gyro, force = np.array([0.3, -0.2, 0.5]), imu.R_world_imu.T @ np.array([0.0, 0.0, 9.81])
    sigma_s = 1e-3

    def moved(length: float, unsure_s: float = 0.0) -> Propagation:
        times = start_ns + np.round(length * (t - start_ns)).astype(np.int64)
        samples = ImuData(times, np.tile(gyro, (len(t), 1)), np.tile(force, (len(t), 1)))
        return propagate_imu(imu, imu, samples, noise, 9.81, integrate_rk4, unsure_s=unsure_s)

    span_s = 1e-9 * float(t[-1] - t[0])
    end, longer = moved(1.0).imu, moved(1.0 + sigma_s / span_s).imu
    turned = so3.log(end.R_world_imu.T @ longer.R_world_imu)
    by_length = np.concatenate([turned, longer.position - end.position])
    added = moved(1.0, sigma_s).noise - moved(1.0).noise
    np.testing.assert_allclose(added[:6, :6], np.outer(by_length, by_length), rtol=0.02, atol=1e-12)
    assert not added[6:].any()


def unobservable(imu: ImuState) -> FloatArray:
    """Directions (15, 4) of the error that no measurement can see: position, and yaw."""
    g = np.array([0.0, 0.0, G])
    N = np.zeros((N_IMU, 4))
    N[POSITION, :3] = np.eye(3)
    N[THETA, 3] = imu.R_world_imu.T @ g
    N[POSITION, 3] = -so3.hat(imu.position) @ g
    N[VELOCITY, 3] = -so3.hat(imu.velocity) @ g
    return N


def test_first_estimates_keep_yaw_and_position_unobservable(
    curvy_path: PoseSpline, start_ns: int, noise: ImuNoise
) -> None:
    rng = np.random.default_rng(12)
    imu_first = imu_state(curvy_path, start_ns)
    N = unobservable(imu_first)
    N_current = N
    for a, b in pairwise(start_ns + 100_000_000 * np.arange(6)):
        samples = perfect_imu(curvy_path, np.linspace(a, b, 21).astype(np.int64))
        # an update has moved the estimate since the first one was taken
        error = np.concatenate([rng.normal(0.0, 0.03, 15), [0.0]])
        imu = box_plus(as_state(imu_first, int(a)), error).imu
        first = propagate_imu(imu, imu_first, samples, noise, G, INTEGRATORS["rk4"])
        np.testing.assert_allclose(
            first.transition[:, :N_IMU] @ unobservable(imu_first),
            unobservable(first.imu),
            atol=1e-9,
        )
        N = first.transition[:, :N_IMU] @ N
        N_current = run(imu, samples, noise, "rk4").transition[:, :N_IMU] @ N_current
        imu_first = first.imu
    np.testing.assert_allclose(N, unobservable(imu_first), atol=1e-8)
    # latest estimates in place of first ones would make the heading seem to be measured
    assert np.abs(N_current - unobservable(imu_first)).max() > 0.1


def test_propagate_keeps_clones_and_their_correlation(
    make_state: Callable[..., State], curvy_path: PoseSpline, start_ns: int, noise: ImuNoise
) -> None:
    state = make_state(np.random.default_rng(1), 2)
    samples = perfect_imu(curvy_path, stamps(start_ns, 0.1, 200.0))
    result = run(state.imu, samples, noise, "rk4")
    end = propagate(state, result, int(samples.timestamp_ns[-1]))
    F = np.eye(len(state.covariance))
    F[:N_IMU, : N_IMU + 1] = result.transition
    Q = np.zeros_like(F)
    Q[:N_IMU, :N_IMU] = result.noise
    np.testing.assert_allclose(end.covariance, F @ state.covariance @ F.T + Q, atol=1e-12)
    np.testing.assert_array_equal(end.covariance, end.covariance.T)
    np.testing.assert_array_equal(end.clones.T_world_imu, state.clones.T_world_imu)
    assert end.timestamp_ns == start_ns + 100_000_000
    assert end.imu is result.imu
    assert end.imu_first is result.imu


def test_clone_is_a_copy_of_the_pose_with_its_errors(
    make_state: Callable[..., State], start_ns: int
) -> None:
    state = replace(make_state(np.random.default_rng(2), 2), time_offset_s=0.0)
    rate = np.array([0.3, -0.2, 0.5])
    cloned = clone_pose(state, start_ns + 7, rate)
    assert cloned.clones.timestamp_ns[-1] == start_ns + 7
    np.testing.assert_array_equal(cloned.clones.T_world_imu[-1, :3, :3], state.imu.R_world_imu)
    np.testing.assert_array_equal(cloned.clones.T_world_imu[-1, :3, 3], state.imu.position)
    np.testing.assert_array_equal(
        cloned.clones.T_world_imu_first[-1], cloned.clones.T_world_imu[-1]
    )
    n = len(state.covariance)
    new = state.clone_columns(2)
    J = np.zeros((6, n))
    J[:3, THETA] = J[3:, POSITION] = np.eye(3)
    J[:, TIME_OFFSET] = [*rate, *state.imu.velocity]
    full = np.concatenate([np.eye(n), J])
    np.testing.assert_allclose(cloned.covariance, full @ state.covariance @ full.T, atol=1e-14)
    assert new.stop == len(cloned.covariance)


def test_clone_moves_with_the_time_offset(
    curvy_path: PoseSpline, start_ns: int, noise: ImuNoise, central_differences: Derivative
) -> None:
    frame_ns = start_ns + 200_000_000
    imu = imu_state(curvy_path, start_ns)

    def pose_at(offset: FloatArray) -> State:
        # a larger offset: the frame was taken later on the IMU's clock
        end_ns = frame_ns + round(1e9 * float(offset[0]))
        cut = np.linspace(start_ns, end_ns, 201).astype(np.int64)
        result = run(imu, perfect_imu(curvy_path, cut), noise, "rk4")
        return clone_pose(
            propagate(as_state(imu, start_ns), result, end_ns), frame_ns, result.angular_velocity
        )

    reference = pose_at(np.zeros(1))
    by_offset = central_differences(
        lambda x: box_minus(pose_at(x), reference)[reference.clone_columns(0)], np.zeros(1), 1e-4
    )[:, 0]
    only_offset = np.zeros_like(reference.covariance[:N_BASE, :N_BASE])
    only_offset[TIME_OFFSET, TIME_OFFSET] = 1.0
    known = replace(reference, clones=no_clones(), covariance=only_offset)
    rate = curvy_path.angular_velocity(frame_ns)
    claimed = clone_pose(known, frame_ns, rate).covariance[known.clone_columns(0), TIME_OFFSET]
    np.testing.assert_allclose(claimed, by_offset, rtol=1e-3, atol=1e-4)
