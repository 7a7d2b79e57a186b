from collections.abc import Callable

import numpy as np
import pytest

from ovmot.errors import OvmotError
from ovmot.evaluation.alignment import ALIGNMENTS, align_first, align_sim3, align_yaw
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray

Path = Callable[[int], FloatArray]
TURN = so3.exp(np.array([0.3, -0.8, 2.0]))
YAW = so3.exp(np.array([0.0, 0.0, 2.5]))
SHIFT = np.array([5.0, -3.0, 20.0])


def moved(path: FloatArray, R: FloatArray, scale: float = 1.0) -> FloatArray:
    """The path in another world: the true one is found by R, `SHIFT` and the scale."""
    return se3.make(R.T @ path[:, :3, :3], (path[:, :3, 3] - SHIFT) @ R / scale)


@pytest.mark.parametrize(
    ("name", "R", "scale"),
    [("yaw", YAW, 1.0), ("first", YAW, 1.0), ("se3", TURN, 1.0), ("sim3", TURN, 1.7)],
)
def test_a_known_transform_is_recovered(
    winding_path: Path, name: str, R: FloatArray, scale: float
) -> None:
    path = winding_path(50)
    found = ALIGNMENTS[name](path, moved(path, R, scale))
    np.testing.assert_allclose(found.R, R, atol=1e-12)
    np.testing.assert_allclose(found.t, SHIFT, atol=1e-10)
    assert found.scale == pytest.approx(scale, rel=1e-12)
    np.testing.assert_allclose(found.poses(moved(path, R, scale)), path, atol=1e-10)


def test_none_changes_nothing(winding_path: Path) -> None:
    path = winding_path(5)
    found = ALIGNMENTS["none"](path, moved(path, TURN))
    np.testing.assert_array_equal(found.poses(path), path)


@pytest.mark.parametrize("name", ["yaw", "first"])
def test_roll_and_pitch_are_left_alone(winding_path: Path, name: str) -> None:
    path = winding_path(40)
    tilted = moved(path, so3.exp(np.array([0.05, -0.02, 1.0])))
    found = ALIGNMENTS[name](path, tilted)
    np.testing.assert_allclose(found.R[2], [0.0, 0.0, 1.0], atol=1e-14)
    up = np.array([0.0, 0.0, 1.0])
    aligned = found.poses(tilted)
    np.testing.assert_allclose(up @ aligned[:, :3, :3], up @ tilted[:, :3, :3], atol=1e-12)


@pytest.mark.parametrize(("name", "n_parameters"), [("yaw", 4), ("se3", 6), ("sim3", 7)])
def test_no_neighbouring_transform_fits_better(
    winding_path: Path, name: str, n_parameters: int
) -> None:
    path = winding_path(60)
    rng = np.random.default_rng(3)
    estimate = moved(path, YAW)
    estimate[:, :3, 3] += rng.normal(0.0, 0.5, (60, 3))
    found = ALIGNMENTS[name](path, estimate)

    def cost(x: FloatArray) -> float:
        turn = so3.exp(np.array([0.0, 0.0, x[3]]) if len(x) == 4 else x[3:6])
        scale = found.scale * (1.0 + x[6]) if len(x) == 7 else 1.0
        points = scale * estimate[:, :3, 3] @ (turn @ found.R).T + found.t + x[:3]
        return float(np.sum((points - path[:, :3, 3]) ** 2))

    best = cost(np.zeros(n_parameters))
    for step in 1e-4 * np.concatenate([np.eye(n_parameters), -np.eye(n_parameters)]):
        assert cost(step) > best


def test_a_short_path_takes_the_heading_from_the_attitudes() -> None:
    rng = np.random.default_rng(0)
    turns = np.linspace(0.0, 0.3, 40)
    R = so3.exp(np.stack([0.0 * turns, 0.0 * turns, turns], axis=-1))
    truth = se3.make(R, np.zeros((40, 3)))
    estimate = moved(truth, YAW)
    estimate[:, :3, 3] += rng.normal(0.0, 0.02, (40, 3))  # it stands: positions are noise
    np.testing.assert_allclose(align_yaw(truth, estimate).R, YAW, atol=1e-12)
    one = align_yaw(truth[:1], estimate[:1])
    np.testing.assert_allclose(one.R, YAW, atol=1e-12)


def test_a_lift_going_straight_up_takes_the_heading_from_the_attitudes() -> None:
    position = np.zeros((20, 3))
    position[:, 2] = np.arange(20)
    truth = se3.make(np.broadcast_to(np.eye(3), (20, 3, 3)), position)
    np.testing.assert_allclose(align_yaw(truth, moved(truth, YAW)).R, YAW, atol=1e-12)


def test_an_estimate_that_never_moved_still_has_a_heading(winding_path: Path) -> None:
    truth = winding_path(30)
    stuck = truth.copy()
    stuck[:, :3, 3] = 0.0
    assert np.isfinite(align_yaw(truth, stuck).R).all()
    with pytest.raises(OvmotError, match="same point"):
        align_sim3(truth, stuck)


def test_first_is_exact_at_the_first_pose_only(winding_path: Path) -> None:
    path = winding_path(10)
    estimate = moved(path, YAW)
    estimate[5:, :3, 3] += 1.0
    aligned = align_first(path, estimate).poses(estimate)
    np.testing.assert_allclose(aligned[:5], path[:5], atol=1e-12)
    assert np.linalg.norm(aligned[5, :3, 3] - path[5, :3, 3]) == pytest.approx(3**0.5)


@pytest.mark.parametrize("name", ["se3", "sim3"])
def test_a_straight_line_does_not_determine_a_rotation(name: str) -> None:
    position = np.arange(10.0)[:, None] * np.array([1.0, 2.0, -0.5])
    line = se3.make(np.broadcast_to(np.eye(3), (10, 3, 3)), position)
    with pytest.raises(OvmotError, match=f"'{name}': all positions lie on one line"):
        ALIGNMENTS[name](line, line)


@pytest.mark.parametrize("name", sorted(ALIGNMENTS))
def test_too_few_poses_and_unequal_counts_are_refused(winding_path: Path, name: str) -> None:
    path = winding_path(4)
    needed = 3 if name in ("se3", "sim3") else 1
    with pytest.raises(OvmotError, match=f"needs {needed} poses or more and has {needed - 1}"):
        ALIGNMENTS[name](path[: needed - 1], path[: needed - 1])
    with pytest.raises(OvmotError, match="4 true and 3 estimated poses cannot be paired"):
        ALIGNMENTS[name](path, path[:3])


@pytest.mark.parametrize("name", sorted(ALIGNMENTS))
def test_a_pose_that_is_not_finite_is_refused(winding_path: Path, name: str) -> None:
    path = winding_path(4)
    broken = path.copy()
    broken[2] = np.nan
    with pytest.raises(OvmotError, match="not finite"):
        ALIGNMENTS[name](path, broken)
