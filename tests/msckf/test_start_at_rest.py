"""Start at rest: level, gyro bias, and a covariance that ties tilt and accelerometer bias."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import chi2

from ovmot.config import InitializationSettings
from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray
from ovmot.msckf.start_at_rest import StartPrior, rest_failure, start_at_rest
from ovmot.msckf.state import ACCEL_BIAS, GYRO_BIAS, POSITION, THETA, TIME_OFFSET, ImuState, State
from ovmot.sim.imu import noisy_imu
from ovmot.types import ImuData, ImuNoise

G = 9.81
ACCEL_BIAS_SIGMA = 0.05  # m/s²
SETTINGS = InitializationSettings()
StartError = Callable[[ImuState, ImuState], FloatArray]


def resting_imu(start_ns: int, R_world_imu: FloatArray, span_s: float = 0.5) -> ImuData:
    t = start_ns + 5_000_000 * np.arange(round(200 * span_s) + 1)
    one = np.ones((len(t), 1))
    return ImuData(t, one * np.zeros(3), one * (R_world_imu.T @ [0.0, 0.0, G]))


def truth(R: FloatArray, gyro_bias: FloatArray, accel_bias: FloatArray) -> ImuState:
    return ImuState(R, np.zeros(3), np.zeros(3), gyro_bias, accel_bias)


@pytest.mark.parametrize(
    "rotation", [[0.0, 0.0, 0.0], [0.3, -0.5, 2.0], [np.pi - 1e-9, 0.0, 0.0], [0.0, 1.5707, 0.0]]
)
def test_levels_and_takes_the_gyro_bias(
    rotation: list[float], start_ns: int, noise: ImuNoise, start_error: StartError
) -> None:
    R, bias = so3.exp(np.array(rotation)), np.array([0.02, -0.03, 0.01])
    clean = resting_imu(start_ns, R)
    imu = ImuData(clean.timestamp_ns, clean.gyro + bias, clean.accel)
    state = start_at_rest(imu, noise, StartPrior(G, 0.002, 0.005, ACCEL_BIAS_SIGMA))
    error = start_error(truth(R, bias, np.zeros(3)), state.imu)
    np.testing.assert_allclose(error, 0.0, atol=1e-9)
    np.testing.assert_allclose(state.imu.R_world_imu.T[:, 2], R.T[:, 2], atol=1e-9)
    assert abs(np.arctan2(state.imu.R_world_imu[1, 0], state.imu.R_world_imu[0, 0])) < 1e-9
    assert state.timestamp_ns == imu.timestamp_ns[-1]
    assert state.imu_first is state.imu
    assert state.time_offset_s == 0.002
    assert state.covariance[TIME_OFFSET, TIME_OFFSET] == pytest.approx(0.005**2)
    assert len(state.clones) == 0


def draw(rng: np.random.Generator, noise: ImuNoise) -> tuple[State, ImuState]:
    """A start from a random attitude with random biases, and the truth."""
    R = so3.exp(rng.uniform(-1.0, 1.0, 3) * [0.5, 0.5, 3.0])
    accel_bias = rng.normal(0.0, ACCEL_BIAS_SIGMA, 3)
    sensor = noisy_imu(
        resting_imu(0, R), noise, rng, gyro_bias=rng.normal(0.0, 0.05, 3), accel_bias=accel_bias
    )
    state = start_at_rest(sensor.data, noise, StartPrior(G, 0.0, 0.0, ACCEL_BIAS_SIGMA))
    return state, truth(R, sensor.gyro_bias[-1], sensor.accel_bias[-1])


def test_errors_of_many_starts_are_as_large_as_claimed(
    noise: ImuNoise, start_error: StartError
) -> None:
    rng, n = np.random.default_rng(1), 300
    tied, gyro = [], []
    columns = np.r_[0:3, 12:15]
    for _ in range(n):
        state, true = draw(rng, noise)
        e, P = start_error(true, state.imu), state.covariance
        tied.append(e[columns] @ np.linalg.solve(P[np.ix_(columns, columns)], e[columns]))
        b = e[GYRO_BIAS]
        gyro.append(b @ np.linalg.solve(P[GYRO_BIAS, GYRO_BIAS], b))
    for nees, dof in ((tied, 5), (gyro, 3)):  # two tilts and three biases: heading is no error
        low, high = (float(chi2.ppf(q, dof * n)) / n for q in (0.025, 0.975))
        assert low < np.mean(nees) < high


def test_tilt_is_tied_to_the_accelerometer_bias(start_ns: int, noise: ImuNoise) -> None:
    R = so3.exp(np.array([0.2, -0.1, 0.0]))
    P = start_at_rest(
        resting_imu(start_ns, R, 2.0), noise, StartPrior(G, 0.0, 0.0, ACCEL_BIAS_SIGMA)
    ).covariance
    up = R.T @ np.array([0.0, 0.0, 1.0])
    side = np.cross(up, [1.0, 0.0, 0.0]) / np.linalg.norm(np.cross(up, [1.0, 0.0, 0.0]))
    # alone, the tilt is known as well as the bias; with the bias given, far better
    tilt = side @ P[THETA, THETA] @ side
    assert np.sqrt(tilt) == pytest.approx(ACCEL_BIAS_SIGMA / G, rel=0.02)
    cross, bias = P[THETA, ACCEL_BIAS], P[ACCEL_BIAS, ACCEL_BIAS]
    given = side @ (P[THETA, THETA] - cross @ np.linalg.solve(bias, cross.T)) @ side
    assert given < 0.05 * tilt
    assert np.sqrt(up @ P[THETA, THETA] @ up) < 1e-4
    assert np.sqrt(P[POSITION, POSITION].max()) < 1e-4
    # along gravity the bias is measured outright
    assert np.sqrt(up @ bias @ up) < 0.01


def test_failures_name_the_reason_and_its_numbers(start_ns: int) -> None:
    rest = resting_imu(start_ns, np.eye(3))
    wave = np.sin(np.arange(len(rest)))[:, None] * [0.0, 1.0, 0.0]
    assert rest_failure(rest, 0.9, SETTINGS) is None
    # biases are no motion
    assert (
        rest_failure(ImuData(rest.timestamp_ns, rest.gyro + 0.1, rest.accel), 0.9, SETTINGS) is None
    )
    turning = ImuData(rest.timestamp_ns, rest.gyro + 0.1 * wave, rest.accel)
    assert "gyroscope varies by 0.07" in str(rest_failure(turning, 0.9, SETTINGS))
    shaking = ImuData(rest.timestamp_ns, rest.gyro, rest.accel + wave)
    assert "accelerometer varies by 0.7" in str(rest_failure(shaking, 0.9, SETTINGS))
    assert "only 30 % of the points" in str(rest_failure(rest, 0.3, SETTINGS))
