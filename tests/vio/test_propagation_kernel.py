"""The compiled propagation against plain NumPy: the chain of pairs, and the covariance's blocks."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.vio.integrators import Increments, integrate_rk4
from ovmot.vio.propagation_kernel import (
    chain_pairs_compiled,
    clone_covariance_compiled,
    covariance_of_compiled,
    propagate_covariance_compiled,
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
    State,
)

WALK = np.array([1e-8, 1e-6])
GRAVITY = 9.81
MakeState = Callable[..., State]


def pair_matrices(
    R: FloatArray, pairs: Increments, rate: FloatArray, force: FloatArray,
    by: tuple[FloatArray, FloatArray], variance: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """F and Q (n, 15, 15) of pairs that start at R (n, 3, 3), and the calibration's columns."""
    n, h = len(pairs.dt), pairs.dt[:, None, None]
    Jr = so3.right_jacobian(rate * pairs.dt[:, None])
    RA = R @ so3.hat(force)
    by_rate = np.concatenate([Jr * h, -RA * h**3 / 6.0, -0.5 * RA * h**2], axis=1)
    by_force = np.concatenate([0.0 * R, 0.5 * R * h**2, R * h], axis=1)
    columns = by_rate @ by[0] + by_force @ by[1]
    F = np.broadcast_to(np.eye(N_IMU), (n, N_IMU, N_IMU)).copy()
    F[:, THETA, THETA] = np.swapaxes(pairs.rotation, -1, -2)
    F[:, POSITION, THETA] = -R @ so3.hat(pairs.position)
    F[:, POSITION, VELOCITY] = np.eye(3) * h
    F[:, VELOCITY, THETA] = -R @ so3.hat(pairs.velocity)
    F[:, :9, 9:] = columns[..., :6]
    gyro, accel = variance[:, 0, None, None], variance[:, 1, None, None] * np.eye(3)
    Q = np.zeros((n, N_IMU, N_IMU))
    Q[:, THETA, THETA] = gyro * h * Jr @ np.swapaxes(Jr, -1, -2)
    Q[:, VELOCITY, VELOCITY] = accel * h
    Q[:, POSITION, POSITION] = accel * h**3 / 4.0
    Q[:, POSITION, VELOCITY] = Q[:, VELOCITY, POSITION] = accel * h**2 / 2.0
    Q[:, GYRO_BIAS, GYRO_BIAS] = WALK[0] * h * np.eye(3)
    Q[:, ACCEL_BIAS, ACCEL_BIAS] = WALK[1] * h * np.eye(3)
    return F, Q, columns[..., 6:]


@pytest.mark.parametrize("n_calibration", [0, 4])
def test_the_chain_is_that_of_plain_products(n_calibration: int) -> None:
    rng, n = np.random.default_rng(1), 9
    dt = rng.uniform(0.003, 0.02, n)
    gyro, accel = rng.normal(0.0, 0.5, (n + 1, 3)), rng.normal(0.0, 3.0, (n + 1, 3))
    pairs = integrate_rk4(gyro, accel, dt)
    rate, force = 0.5 * (gyro[1:] + gyro[:-1]), 0.5 * (accel[1:] + accel[:-1])
    by_rate, by_force = rng.normal(size=(2, n, 3, 6 + n_calibration))
    variance = rng.uniform(1e-6, 1e-4, (n, 2))
    T, v = se3.exp(rng.normal(size=6)), rng.normal(0.0, 5.0, 3)

    R = [T[:3, :3]]
    for turn in pairs.rotation:
        R.append(R[-1] @ turn)
    F, Q, columns = pair_matrices(
        np.array(R[:-1]), pairs, rate, force, (by_rate, by_force), variance
    )
    Phi, noise = np.eye(N_IMU, N_BASE + n_calibration), np.zeros((N_IMU, N_IMU))
    p, velocity, g = T[:3, 3], v, np.array([0.0, 0.0, -GRAVITY])
    for i, h in enumerate(dt):
        noise = F[i] @ noise @ F[i].T + Q[i]
        Phi = F[i] @ Phi
        Phi[:9, N_BASE:] += columns[i]
        p = p + velocity * h + 0.5 * g * h * h + R[i] @ pairs.position[i]
        velocity = velocity + g * h + R[i] @ pairs.velocity[i]

    found = chain_pairs_compiled(
        T, v, GRAVITY, pairs.rotation, pairs.velocity, pairs.position, dt, rate, force, by_rate,
        by_force, variance, WALK,
    )  # fmt: skip
    np.testing.assert_allclose(found[0], se3.make(R[-1], p), atol=1e-13)
    np.testing.assert_allclose(found[1], velocity, atol=1e-13)
    np.testing.assert_allclose(found[2], Phi, atol=1e-12)
    np.testing.assert_allclose(found[3], noise, rtol=1e-10, atol=1e-18)
    np.testing.assert_array_equal(found[3], found[3].T)


def test_the_covariance_goes_through_the_transition(make_state: MakeState) -> None:
    rng = np.random.default_rng(2)
    P = make_state(rng, 3).covariance
    Phi, Q = rng.normal(size=(N_IMU, N_BASE)), np.diag(rng.uniform(0.1, 1.0, N_IMU))
    G = np.eye(len(P))
    G[:N_IMU, :N_BASE] = Phi
    expected = G @ P @ G.T
    expected[:N_IMU, :N_IMU] += Q
    found = propagate_covariance_compiled(P, Phi, Q)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    np.testing.assert_array_equal(found, found.T)


def test_a_clone_copies_the_pose_s_rows(make_state: MakeState) -> None:
    rng = np.random.default_rng(3)
    P, at = make_state(rng, 3).covariance, N_BASE + 12  # before the third clone
    by_offset = rng.normal(size=6)
    G = np.insert(np.eye(len(P)), [at] * 6, np.eye(len(P))[:6], axis=0)
    G[at : at + 6, TIME_OFFSET] = by_offset
    found = clone_covariance_compiled(P, by_offset, at, TIME_OFFSET)
    np.testing.assert_allclose(found, G @ P @ G.T, atol=1e-14)
    np.testing.assert_array_equal(found, found.T)


def test_rows_and_columns_are_chosen(make_state: MakeState) -> None:
    P, kept = make_state(np.random.default_rng(4), 2).covariance, np.array([0, 3, 4, 20, 27])
    np.testing.assert_array_equal(covariance_of_compiled(P, kept), P[np.ix_(kept, kept)])
