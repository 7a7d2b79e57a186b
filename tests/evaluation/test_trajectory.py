from collections.abc import Callable

import numpy as np
import pytest

from ovmot.datasets.pose_files import Trajectory
from ovmot.evaluation.alignment import ALIGNMENTS
from ovmot.evaluation.trajectory import (
    PoseErrors,
    absolute_errors,
    associate_stamps,
    drift_percent,
    pairs_by_distance,
    pairs_by_time,
    path_lengths,
    relative_errors,
    statistics,
)
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray, IntArray

Path = Callable[[int], FloatArray]
Recorded = tuple[Trajectory, Trajectory]


def straight(x: FloatArray) -> FloatArray:
    position = np.stack([x, 0.0 * x, 0.0 * x], axis=-1)
    return se3.make(np.broadcast_to(np.eye(3), (len(x), 3, 3)), position)


def test_absolute_errors_of_known_ones(winding_path: Path) -> None:
    truth = winding_path(3)
    shift = np.array([[0.0, 0, 0], [3, 0, 4], [0, 0, 2]])
    turn = np.array([[0.0, 0, 0], [0, 0.6, 0.8], [1e-7, 0, 0]])
    estimate = se3.make(truth[:, :3, :3] @ so3.exp(turn), truth[:, :3, 3] + shift)
    errors = absolute_errors(truth, estimate)
    np.testing.assert_allclose(errors.translation, [0.0, 5.0, 2.0], atol=1e-14)
    np.testing.assert_allclose(errors.rotation, [0.0, 1.0, 1e-7], atol=1e-14)


def test_statistics() -> None:
    found = statistics(np.array([1.0, 1.0, 2.0, 6.0]))
    assert found is not None
    assert (found.mean, found.median, found.maximum) == (2.5, 1.5, 6.0)
    assert found.rmse == pytest.approx(10.5**0.5)
    assert statistics(np.empty(0)) is None


def test_relative_errors_do_not_see_the_world_but_see_the_scale(winding_path: Path) -> None:
    truth = winding_path(30)
    world = se3.make(so3.exp(np.array([0.5, 1.0, -2.0])), np.array([100.0, 3.0, 2.0]))
    first, second = np.arange(20), np.arange(20) + 10
    errors = relative_errors(truth, world @ truth, first, second)
    np.testing.assert_allclose(errors.translation, 0.0, atol=1e-12)
    np.testing.assert_allclose(errors.rotation, 0.0, atol=1e-12)
    longer = se3.make(truth[:, :3, :3], 1.1 * truth[:, :3, 3])
    errors = relative_errors(truth, longer, first, second)
    moved = np.linalg.norm(truth[second, :3, 3] - truth[first, :3, 3], axis=1)
    np.testing.assert_allclose(errors.translation, 0.1 * moved, rtol=1e-10)


def test_pairs_by_time_skip_holes() -> None:
    stamps = np.array([0, 100, 200, 300, 1000, 1100, 1203]) * 1_000_000
    first, second = pairs_by_time(stamps, 0.2)
    # 0.2 s and 0.3 s find nothing within 0.25 s; the hole's far side is too late for them
    assert list(zip(first.tolist(), second.tolist(), strict=True)) == [(0, 2), (1, 3), (4, 6)]


def test_pairs_by_distance_take_the_nearest_within_the_tolerance() -> None:
    truth = straight(np.array([0.0, 0.0, 4.0, 9.8, 10.3, 10.3, 30.0]))
    first, second = pairs_by_distance(truth, 10.0, 0.05)
    assert list(zip(first.tolist(), second.tolist(), strict=True)) == [(0, 3), (1, 3)]
    first, _ = pairs_by_distance(truth, 100.0)
    assert len(first) == 0


def test_drift_is_in_percent_of_the_path_between() -> None:
    truth = straight(np.arange(31.0))
    estimate = straight(1.02 * np.arange(31.0))
    pairs = pairs_by_distance(truth, 10.0)
    assert drift_percent(truth, relative_errors(truth, estimate, *pairs), *pairs) == (
        pytest.approx(2.0)
    )
    nothing = np.empty(0, dtype=np.int64)
    assert drift_percent(truth, PoseErrors(np.empty(0), np.empty(0)), nothing, nothing) is None
    assert path_lengths(truth)[-1] == pytest.approx(30.0)


@pytest.mark.parametrize("name", ["none", "se3", "sim3"])
def test_absolute_errors_are_those_of_evo(recorded: Recorded, name: str) -> None:
    pytest.importorskip("evo")
    from evo.core import metrics, sync

    truth, run = recorded
    reference, estimate = sync.associate_trajectories(_evo(truth), _evo(run))
    if name != "none":
        estimate.align(reference, correct_scale=name == "sim3")
    aligned = ALIGNMENTS[name](truth.T_world_imu, run.T_world_imu).poses(run.T_world_imu)
    ours = absolute_errors(truth.T_world_imu, aligned)
    for values, relation in (
        (ours.translation, metrics.PoseRelation.translation_part),
        (ours.rotation, metrics.PoseRelation.rotation_angle_rad),
    ):
        theirs = metrics.APE(relation)
        theirs.process_data((reference, estimate))
        np.testing.assert_allclose(values, theirs.error, atol=1e-6)
        _statistics_agree(values, theirs.get_all_statistics())
    assert ours.translation.max() > 0.05  # the run was not perfect, so that errors were compared


@pytest.mark.parametrize(
    ("unit", "delta", "n_pairs_at_least"), [("frames", 5, 90), ("meters", 10.0, 60)]
)
def test_relative_errors_are_those_of_evo(
    recorded: Recorded, unit: str, delta: float, n_pairs_at_least: int
) -> None:
    pytest.importorskip("evo")
    from evo.core import metrics

    truth, run = recorded
    if unit == "frames":  # the frames are 0.2 s apart
        pairs = pairs_by_time(truth.timestamp_ns, 0.2 * delta)
    else:
        pairs = pairs_by_distance(truth.T_world_imu, delta)
    ours = relative_errors(truth.T_world_imu, run.T_world_imu, *pairs)
    assert len(ours) >= n_pairs_at_least
    for values, relation in (
        (ours.translation, metrics.PoseRelation.translation_part),
        (ours.rotation, metrics.PoseRelation.rotation_angle_rad),
    ):
        theirs = metrics.RPE(
            relation,
            delta=delta,
            delta_unit=metrics.Unit[unit],
            rel_delta_tol=0.1,
            all_pairs=True,
            pairs_from_reference=True,
        )
        theirs.process_data((_evo(truth), _evo(run)))
        assert theirs.delta_ids == pairs[1].tolist()
        np.testing.assert_allclose(values, theirs.error, atol=1e-6)
        _statistics_agree(values, theirs.get_all_statistics())


def _evo(trajectory: Trajectory):  # type: ignore[no-untyped-def]
    """The same trajectory as a value of evo's."""
    from evo.core.trajectory import PoseTrajectory3D

    poses = list(trajectory.T_world_imu)
    return PoseTrajectory3D(poses_se3=poses, timestamps=trajectory.timestamp_ns * 1e-9)


def _statistics_agree(ours: FloatArray, theirs: dict[str, float]) -> None:
    found = statistics(ours)
    assert found is not None
    for value, name in (
        (found.rmse, "rmse"),
        (found.mean, "mean"),
        (found.median, "median"),
        (found.maximum, "max"),
    ):
        assert value == pytest.approx(theirs[name], abs=1e-6)


def stamps(*values: int) -> IntArray:
    return np.array(values, dtype=np.int64)


@pytest.mark.parametrize(
    ("reference", "estimate", "pairs"),
    [
        ((0, 10, 20), (0, 10, 20), [(0, 0), (1, 1), (2, 2)]),
        ((0, 10, 20), (12, 18), [(1, 0), (2, 1)]),
        ((0, 10, 20), (-3, 23, 24), [(0, 0), (2, 1)]),  # 24 comes second
        ((0, 10, 20), (8, 9, 12), [(1, 1)]),  # one each: the nearest has it
        ((0, 10), (5,), [(1, 0)]),  # as near to both: the later
        ((0, 10), (-4,), []),  # 4 apart
        ((), (1,), []),
        ((1,), (), []),
    ],
)
def test_pairs(
    reference: tuple[int, ...], estimate: tuple[int, ...], pairs: list[tuple[int, int]]
) -> None:
    limit = 5 if 5 in estimate else 3
    a, b = associate_stamps(stamps(*reference), stamps(*estimate), limit)
    assert list(zip(a.tolist(), b.tolist(), strict=True)) == pairs


def test_nanoseconds_of_today_stay_exact() -> None:
    start = 1_700_000_000_000_000_000
    a, b = associate_stamps(stamps(start, start + 3), stamps(start + 1, start + 2), 1)
    assert (a.tolist(), b.tolist()) == ([0, 1], [0, 1])
