"""Scale, axes, g-sensitivity, ranges and lost samples come out of the IMU as they were put in."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.geometry import se3, so3
from ovmot.geometry.splines import PoseSpline
from ovmot.sim.imu import noisy_imu, perfect_imu, simulated_imu
from ovmot.sim.imu_errors import NO_ERRORS, ImuErrors
from ovmot.sim.simulation import ImuModel
from ovmot.sim.walk import stroll, walk_path
from ovmot.types import ImuData, ImuNoise

ORIGIN = 1_500_000_000_000_000_000
SILENT = ImuNoise(0.0, 0.0, 0.0, 0.0)
GYRO_BIAS, ACCEL_BIAS = np.array([0.01, -0.02, 0.03]), np.array([0.1, 0.2, -0.3])
TIMES = ORIGIN + np.arange(2000) * 5_000_000


@pytest.fixture(scope="module")
def path() -> PoseSpline:
    rng = np.random.default_rng(3)
    mount = se3.make(so3.exp(np.array([0.3, -0.2, 0.1])), np.array([0.0, 0.0, 1.4]))
    return walk_path(*stroll(10.0, rng), ORIGIN, 10.0, rng, T_walker_body=mount)


def model(errors: ImuErrors, noise: ImuNoise = SILENT) -> ImuModel:
    return ImuModel(200.0, noise, GYRO_BIAS, ACCEL_BIAS, errors)


def test_matrices_are_found_again_from_the_readings(path: PoseSpline) -> None:
    errors = ImuErrors.random(np.random.default_rng(1), g_sensitivity=1e-3)
    perfect = perfect_imu(path, TIMES, time_offset_s=0.01)
    rng = np.random.default_rng(0)
    data = simulated_imu(path, TIMES, model(errors), rng, time_offset_s=0.01).data
    regressors = np.concatenate([perfect.gyro, perfect.accel, np.ones((len(TIMES), 1))], axis=1)
    gyro = np.linalg.lstsq(regressors, data.gyro, rcond=None)[0].T
    accel = np.linalg.lstsq(regressors, data.accel, rcond=None)[0].T
    np.testing.assert_allclose(gyro[:, :3], errors.gyro_matrix, atol=1e-9)
    np.testing.assert_allclose(gyro[:, 3:6], errors.g_sensitivity, atol=1e-9)
    np.testing.assert_allclose(gyro[:, 6], GYRO_BIAS, atol=1e-8)
    np.testing.assert_allclose(accel[:, :3], 0.0, atol=1e-9)
    np.testing.assert_allclose(accel[:, 3:6], errors.accel_matrix, atol=1e-9)
    np.testing.assert_allclose(accel[:, 6], ACCEL_BIAS, atol=1e-8)


def test_without_errors_it_is_the_noisy_imu(path: PoseSpline) -> None:
    noise = ImuNoise(1e-3, 2e-4, 1e-2, 3e-3)
    made = simulated_imu(path, TIMES, model(NO_ERRORS, noise), np.random.default_rng(5))
    expected = noisy_imu(
        perfect_imu(path, TIMES), noise, np.random.default_rng(5),
        gyro_bias=GYRO_BIAS, accel_bias=ACCEL_BIAS,
    )  # fmt: skip
    np.testing.assert_allclose(made.data.gyro, expected.data.gyro, atol=1e-12)
    np.testing.assert_allclose(made.data.accel, expected.data.accel, atol=1e-12)
    np.testing.assert_array_equal(made.gyro_bias, expected.gyro_bias)


def test_lost_samples_are_missing_and_the_others_stay_as_they_were(path: PoseSpline) -> None:
    noise = ImuNoise(1e-3, 2e-4, 1e-2, 3e-3)
    full, thin = (
        simulated_imu(path, TIMES, model(errors, noise), np.random.default_rng(5))
        for errors in (NO_ERRORS, ImuErrors(dropped_share=0.3))
    )
    assert 0.66 < len(thin.data) / len(full.data) < 0.74
    index = np.searchsorted(full.data.timestamp_ns, thin.data.timestamp_ns)
    np.testing.assert_array_equal(full.data.timestamp_ns[index], thin.data.timestamp_ns)
    np.testing.assert_array_equal(full.data.gyro[index], thin.data.gyro)
    np.testing.assert_array_equal(full.accel_bias[index], thin.accel_bias)


def test_bursts_leave_holes_of_their_length() -> None:
    errors = ImuErrors(bursts_per_s=0.2, burst_s=0.25)
    times = ORIGIN + np.arange(60_000) * 5_000_000
    kept = times[errors.kept(times, np.random.default_rng(0))]
    gaps = np.diff(kept) * 1e-9
    holes = gaps[gaps > 0.006]
    assert 40 < len(holes) < 80  # 300 s
    assert np.median(holes) == pytest.approx(0.255, abs=0.006)
    assert kept[0] == times[0]
    assert kept[-1] == times[-1]


def test_readings_end_at_the_range() -> None:
    wild = ImuData(TIMES[:2], np.array([[1.0, -9.0, 2.0], [0.0, 0.0, 7.0]]), np.full((2, 3), 50.0))
    cut = ImuErrors(gyro_range=4.0, accel_range=40.0).saturated(wild)
    np.testing.assert_array_equal(cut.gyro, [[1.0, -4.0, 2.0], [0.0, 0.0, 4.0]])
    np.testing.assert_array_equal(cut.accel, np.full((2, 3), 40.0))


def test_random_errors_have_the_size_asked_for() -> None:
    rng = np.random.default_rng(7)
    drawn = [ImuErrors.random(rng, scale=0.02, misalignment_rad=0.01) for _ in range(400)]
    gyro = np.array([e.gyro_matrix for e in drawn]) - np.eye(3)
    accel = np.array([e.accel_matrix for e in drawn]) - np.eye(3)
    np.testing.assert_allclose(gyro.std(axis=0)[np.eye(3) > 0], 0.02, rtol=0.15)
    np.testing.assert_allclose(gyro.std(axis=0)[np.eye(3) == 0], 0.01, rtol=0.15)
    np.testing.assert_array_equal(accel[:, [0, 0, 1], [1, 2, 2]], 0.0)
    assert all(e.any for e in drawn)
    assert not NO_ERRORS.any
    assert ImuErrors(dropped_share=0.1).any


@pytest.mark.parametrize(
    "impossible",
    [
        lambda: ImuErrors(gyro_matrix=np.eye(4)),
        lambda: ImuErrors(g_sensitivity=np.full((3, 3), np.nan)),
        lambda: ImuErrors(dropped_share=1.0),
        lambda: ImuErrors(burst_s=-1.0),
        lambda: ImuErrors(accel_range=0.0),
    ],
)
def test_refuses_impossible_errors(impossible: Callable[[], ImuErrors]) -> None:
    with pytest.raises(ValueError, match=r"IMU|dropped"):
        impossible()
