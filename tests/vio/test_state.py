"""The laws of the filter's error coordinates."""

from collections.abc import Callable

import numpy as np
import pytest

from ovmot.geometry import se3, so3
from ovmot.vio.state import (
    CLONE_SIZE,
    N_BASE,
    State,
    box_minus,
    box_plus,
    marginalize_clone,
)

MakeState = Callable[..., State]
n_clones = pytest.mark.parametrize("n", [0, 1, 4])


def error_vector(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.uniform(-0.8, 0.8, N_BASE + CLONE_SIZE * n)


@n_clones
def test_box_minus_undoes_box_plus(make_state: MakeState, n: int) -> None:
    rng = np.random.default_rng(1)
    state, error = make_state(rng, n), error_vector(rng, n)
    np.testing.assert_allclose(box_minus(box_plus(state, error), state), error, atol=1e-12)
    np.testing.assert_allclose(box_minus(state, state), 0.0, atol=1e-12)


@n_clones
def test_box_plus_of_box_minus_is_the_other_state(make_state: MakeState, n: int) -> None:
    rng = np.random.default_rng(2)
    state = make_state(rng, n)
    other = box_plus(state, error_vector(rng, n))
    again = box_plus(state, box_minus(other, state))
    for name in ("R_world_imu", "position", "velocity", "gyro_bias", "accel_bias"):
        np.testing.assert_allclose(
            getattr(again.imu, name), getattr(other.imu, name), atol=1e-12, err_msg=name
        )
    assert again.time_offset_s == pytest.approx(other.time_offset_s, abs=1e-15)
    np.testing.assert_allclose(again.clones.T_world_imu, other.clones.T_world_imu, atol=1e-12)


@n_clones
def test_poses_are_those_of_the_plain_twin(make_state: MakeState, n: int) -> None:
    rng = np.random.default_rng(5)
    state, error = make_state(rng, n), error_vector(rng, n)
    moved = box_plus(state, error)
    T, d = state.clones.T_world_imu, error[N_BASE:].reshape(-1, CLONE_SIZE)
    R = so3.project_to_rotation(T[:, :3, :3] @ so3.exp(d[:, :3]))
    plain = se3.make(R, T[:, :3, 3] + d[:, 3:])
    np.testing.assert_allclose(moved.clones.T_world_imu, plain, atol=1e-14)
    plain_R = so3.project_to_rotation(state.imu.R_world_imu @ so3.exp(error[:3]))
    np.testing.assert_allclose(moved.imu.R_world_imu, plain_R, atol=1e-14)
    np.testing.assert_array_equal(moved.imu.position, state.imu.position + error[3:6])


def test_rotation_errors_are_on_the_right(make_state: MakeState) -> None:
    state = make_state(np.random.default_rng(3), 1)
    error = np.zeros(N_BASE + CLONE_SIZE)
    error[2] = error[N_BASE + 2] = np.pi / 2  # about the body's z axis: x goes to y
    moved = box_plus(state, error)
    R, R_clone = state.imu.R_world_imu, state.clones.T_world_imu[0, :3, :3]
    np.testing.assert_allclose(moved.imu.R_world_imu[:, 0], R[:, 1], atol=1e-12)
    np.testing.assert_allclose(moved.clones.T_world_imu[0, :3, 0], R_clone[:, 1], atol=1e-12)


def test_box_plus_leaves_first_estimates_covariance_and_its_argument(
    make_state: MakeState,
) -> None:
    rng = np.random.default_rng(4)
    state = make_state(rng, 2)
    before = state.clones.T_world_imu.copy()
    moved = box_plus(state, error_vector(rng, 2))
    assert moved.imu_first is state.imu_first
    np.testing.assert_array_equal(moved.clones.T_world_imu_first, before)
    np.testing.assert_array_equal(state.clones.T_world_imu, before)
    np.testing.assert_array_equal(moved.covariance, state.covariance)
    assert not np.allclose(moved.clones.T_world_imu, before)


def test_clone_columns_move_that_clone_alone(make_state: MakeState) -> None:
    state = make_state(np.random.default_rng(5), 3)
    for index in range(3):
        error = np.zeros(len(state.covariance))
        error[state.clone_columns(index)] = 0.1
        moved = box_plus(state, error)
        changed = (
            np.abs(moved.clones.T_world_imu - state.clones.T_world_imu).max(axis=(1, 2)) > 0.01
        )
        np.testing.assert_array_equal(changed, np.arange(3) == index)
        np.testing.assert_allclose(moved.imu.R_world_imu, state.imu.R_world_imu, atol=1e-14)


@pytest.mark.parametrize("index", [0, 1, 2])
def test_marginalize_clone_keeps_the_rest_s_distribution(make_state: MakeState, index: int) -> None:
    state = make_state(np.random.default_rng(6), 3)
    less = marginalize_clone(state, index)
    kept = [i for i in range(3) if i != index]
    np.testing.assert_array_equal(less.clones.timestamp_ns, state.clones.timestamp_ns[kept])
    np.testing.assert_array_equal(less.clones.T_world_imu, state.clones.T_world_imu[kept])
    # A marginal of a Gaussian: any linear function of the rest keeps its variance.
    J = np.random.default_rng(7).normal(size=len(less.covariance))
    J_full = np.insert(J, [N_BASE + CLONE_SIZE * index] * CLONE_SIZE, 0.0)
    assert J @ less.covariance @ J == pytest.approx(J_full @ state.covariance @ J_full, rel=1e-12)
    assert len(state.clones) == 3
