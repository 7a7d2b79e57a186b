"""The integrators on a fast motion, against a fine reference."""

import numpy as np
import pytest

from ovmot.geometry import so3
from ovmot.geometry.arrays import FloatArray
from ovmot.types import ImuData, ImuNoise
from ovmot.vio.integrators import INTEGRATORS
from ovmot.vio.propagation import propagate_imu
from ovmot.vio.state import ImuState

G = 9.81


def fast_motion(t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Body rates (N, 3) up to 6 rad/s and forces (N, 3) up to 20 m/s² of a rig that is shaken."""
    phase = t[:, None] * np.array([9.0, 13.0, 17.0]) + np.array([0.3, 1.1, 2.0])
    gyro = np.array([5.0, 6.0, 4.0]) * np.sin(phase)
    accel = np.array([10.0, 8.0, 6.0]) * np.cos(1.3 * phase) + np.array([0.0, 0.0, G])
    return gyro, accel


def fast_end(name: str, step_s: float, noise: ImuNoise) -> FloatArray:
    """Rotation vector, velocity and position (9,) after a second of it."""
    t = np.linspace(0.0, 1.0, round(1.0 / step_s) + 1)
    zero = np.zeros(3)
    samples = ImuData(np.round(1e9 * t).astype(np.int64), *fast_motion(t))
    rest = ImuState(np.eye(3), zero, zero, zero, zero)
    end = propagate_imu(rest, rest, samples, noise, G, INTEGRATORS[name]).imu
    return np.concatenate([so3.log(end.R_world_imu), end.velocity, end.position])


FAST_STEPS_S = (0.01, 0.005, 0.0025)
FAST_ERRORS = {
    "discrete": [(2.1e-3, 0.13, 0.060), (5.2e-4, 0.067, 0.031), (1.3e-4, 0.034, 0.016)],
    "analytic": [(2.1e-3, 0.014, 0.0089), (5.2e-4, 0.0036, 0.0022), (1.3e-4, 0.0009, 0.00056)],
    "rk4": [(1.5e-3, 0.0089, 0.0059), (3.8e-4, 0.0022, 0.0015), (9.4e-5, 0.00055, 0.00037)],
}
"""Errors in rad, m/s and m at each step: the table of docs/algorithm/filter.md."""


@pytest.mark.parametrize("name", list(INTEGRATORS))
def test_errors_on_a_fast_motion_are_those_of_the_docs(name: str, noise: ImuNoise) -> None:
    reference = fast_end("rk4", 1e-4, noise)
    for step_s, expected in zip(FAST_STEPS_S, FAST_ERRORS[name], strict=True):
        off = fast_end(name, step_s, noise) - reference
        errors = np.linalg.norm(off.reshape(3, 3), axis=1)
        np.testing.assert_allclose(errors, expected, rtol=0.05)


@pytest.mark.parametrize(("name", "order"), [("discrete", 2), ("analytic", 2), ("rk4", 4)])
def test_rotation_under_linear_rates_falls_by_the_integrators_order(name: str, order: int) -> None:
    def rates(t: FloatArray) -> FloatArray:
        return np.asarray([1.0, -2.0, 0.5] + t[:, None] * np.array([-3.0, 4.0, 6.0]))

    def turned(n: int, integrator: str) -> FloatArray:
        t = np.linspace(0.0, 0.8, n + 1)
        R: FloatArray = np.eye(3)
        for step in INTEGRATORS[integrator](rates(t), 0.0 * rates(t), np.diff(t)).rotation:
            R = np.asarray(R @ step)
        return R

    truth = turned(640, "rk4")
    error = [float(np.linalg.norm(so3.log(truth.T @ turned(n, name)))) for n in (10, 20)]
    assert error[0] / error[1] == pytest.approx(2.0**order, rel=0.25)
