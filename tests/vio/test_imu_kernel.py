"""The compiled work on IMU samples against plain NumPy."""

import numpy as np
import pytest

from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.vio.imu_kernel import rk4_increments_compiled, samples_between_compiled

EPOCH = 1_403_636_580_000_000_003


def plain_samples(
    stamps: IntArray, rates: FloatArray, wanted: IntArray
) -> tuple[IntArray, FloatArray]:
    """Stamps (n,) and rates (n, 6), by NumPy's interpolation."""
    inner = stamps[(stamps > wanted[0]) & (stamps < wanted[-1])]
    at = np.union1d(inner, wanted)
    x, measured = (at - wanted[0]) * 1e-9, (stamps - wanted[0]) * 1e-9
    return at, np.stack([np.interp(x, measured, rates[:, i]) for i in range(6)], axis=1)


@pytest.mark.parametrize(
    "wanted",
    [
        (12_000_000, 37_000_001),
        (10_000_000, 40_000_000),
        (10_000_000, 20_000_000, 40_000_000),
        (12_000_000, 25_000_000, 37_000_000),
        (12_000_000, 12_000_000, 103_000_000),  # beyond the last: held
        (98_000_000, 103_000_000, 103_000_000),
    ],
)
def test_samples_of_an_interval(wanted: tuple[int, ...]) -> None:
    stamps = EPOCH + 10_000_000 * np.arange(11)
    rates = np.random.default_rng(0).normal(size=(11, 6))
    at = EPOCH + np.array(wanted)
    first = int(np.searchsorted(stamps, at[0], side="right")) - 1
    end = min(int(np.searchsorted(stamps, at[-1])) + 1, len(stamps))
    found, gyro, accel = samples_between_compiled(stamps, rates, first, end, at)
    expected, values = plain_samples(stamps, rates, at)
    assert found.tolist() == expected.tolist()
    np.testing.assert_allclose(np.hstack([gyro, accel]), values, rtol=0.0, atol=1e-15)


def plain_rk4(
    gyro: FloatArray, accel: FloatArray, dt: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """All pairs at once."""
    h = dt[:, None]
    w0, w1, a0, a1 = gyro[:-1], gyro[1:], accel[:-1], accel[1:]
    wm, am = 0.5 * (w0 + w1), 0.5 * (a0 + a1)

    def rate(phi: FloatArray, w: FloatArray) -> FloatArray:
        return np.asarray((so3.right_jacobian_inverse(phi) @ w[..., None])[..., 0])

    k1 = w0
    k2 = rate(0.5 * h * k1, wm)
    k3 = rate(0.5 * h * k2, wm)
    k4 = rate(h * k3, w1)
    R_mid, R_end = so3.exp(0.5 * h * k2), so3.exp(h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4))
    f0, fm, f1 = a0, (R_mid @ am[..., None])[..., 0], (R_end @ a1[..., None])[..., 0]
    return R_end, h / 6.0 * (f0 + 4.0 * fm + f1), h**2 / 6.0 * (f0 + 2.0 * fm)


@pytest.mark.parametrize("scale", [0.01, 30.0])
def test_runge_kutta_increments(scale: float) -> None:
    rng = np.random.default_rng(1)
    gyro, accel = scale * rng.normal(size=(21, 3)), 10.0 * rng.normal(size=(21, 3))
    dt = rng.uniform(1e-4, 0.02, 20)
    for found, expected in zip(
        rk4_increments_compiled(gyro, accel, dt), plain_rk4(gyro, accel, dt), strict=True
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-14)
