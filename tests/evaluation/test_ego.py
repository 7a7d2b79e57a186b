import importlib.util
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from ovmot.datasets.pose_files import write_tum
from ovmot.datasets.truth import EgoTruth, read_ego_truth
from ovmot.errors import InputError
from ovmot.evaluation.ego import evaluate_ego, scalars
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.outputs.run_reader import EgoRun, read_ego_run

Winding = Callable[[int], FloatArray]
STEP_NS = 10_000_000
WORLD = se3.make(so3.exp(np.array([0.0, 0.0, 2.0])), np.array([30.0, -4.0, 2.0]))


@pytest.fixture(scope="session")
def score(data_root: Path) -> ModuleType:
    """The independent scorer beside the data."""
    path = data_root.parent / "check" / "score.py"
    if not path.is_file():
        pytest.skip(f"no {path}")
    spec = importlib.util.spec_from_file_location("score", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def truth_of(path: FloatArray) -> EgoTruth:
    """The path as truth, 100 poses a second."""
    return EgoTruth(Path("truth.tum"), np.arange(len(path), dtype=np.int64) * STEP_NS, path)


def walk(rng: np.random.Generator, n: int, size: float) -> FloatArray:
    """A random walk (n, 3) that starts at zero."""
    steps = rng.normal(0.0, size, (n, 3))
    steps[0] = 0.0
    return np.cumsum(steps, axis=0)


def perturbed(truth: EgoTruth, every: int, rng: np.random.Generator) -> EgoRun:
    """Every so many true poses, seen from another world, with a drift in position and attitude."""
    T = truth.T_world_imu[::every]
    R = T[:, :3, :3] @ so3.exp(walk(rng, len(T), 2e-3))
    drifted = se3.make(R, T[:, :3, 3] + walk(rng, len(T), 0.02))
    return EgoRun(truth.timestamp_ns[::every], se3.inverse(WORLD) @ drifted)


@pytest.mark.parametrize("sequence", ["street_traffic", "street_crossing"])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_scorer_beside_the_data_agrees(
    data_root: Path, score: ModuleType, tmp_path: Path, sequence: str, seed: int
) -> None:
    """On a path of 88 m, and on one that stands (the heading is then that of the attitudes)."""
    truth = read_ego_truth(data_root / sequence)
    run = perturbed(truth, 10, np.random.default_rng(seed))
    kept = np.arange(len(run.timestamp_ns)) > 6  # a run starts late
    kept[90:93] = False  # and loses some frames
    run = EgoRun(run.timestamp_ns[kept], run.T_world_imu[kept])
    write_tum(tmp_path / "trajectory.tum", run.timestamp_ns, run.T_world_imu)
    ours = scalars(evaluate_ego(read_ego_run(tmp_path), truth))
    theirs, _ = score.ego(data_root / sequence, tmp_path)
    assert ours["poses"] == theirs["frames"]
    for mine, its in (
        ("first_pose_s", "first_pose_s"),
        ("ate_yaw_m", "ate_m"),
        ("ate_yaw_deg", "ate_deg"),
        ("distance_m", "dist_m"),
        ("rpe_1s_m", "rpe_1s_m"),
        ("ate_percent", "ate_pct"),
    ):
        assert ours[mine] == pytest.approx(theirs[its], abs=1e-3), mine
    assert theirs["ate_m"] > 0.02  # there was something to agree on


def test_a_perfect_run_in_another_world_has_no_error(winding_path: Winding) -> None:
    truth = truth_of(winding_path(1001))
    run = EgoRun(truth.timestamp_ns[200::10], se3.inverse(WORLD) @ truth.T_world_imu[200::10])
    found = scalars(evaluate_ego(run, truth))
    assert found["first_pose_s"] == pytest.approx(2.0)
    assert found["poses"] == 81
    for key in ("ate_yaw_m", "ate_se3_m", "ate_sim3_m", "rpe_1s_m", "rpe_10m_m", "ate_percent"):
        assert found[key] == pytest.approx(0.0, abs=1e-9), key
    assert found["scale_error_percent"] == pytest.approx(0.0, abs=1e-9)
    assert (found["ate_none_m"] or 0.0) > 10.0
    assert found["nees_pose"] is None
    assert found["nees_pose_undefined_poses"] == 81
    assert found["velocity_rmse_mps"] is None


def test_sim3_finds_a_scale(winding_path: Winding) -> None:
    truth = truth_of(winding_path(500))
    T = truth.T_world_imu[::10]
    run = EgoRun(truth.timestamp_ns[::10], se3.make(T[:, :3, :3], 1.05 * T[:, :3, 3]))
    found = scalars(evaluate_ego(run, truth))
    assert found["scale_error_percent"] == pytest.approx(5.0)
    assert found["ate_sim3_m"] == pytest.approx(0.0, abs=1e-9)
    assert (found["ate_se3_m"] or 0.0) > 0.1
    assert found["rpe_10m_percent"] == pytest.approx(4.8, abs=0.2)  # a bend's chord is shorter


def consistent_run(
    truth: EgoTruth, rng: np.random.Generator, every: int = 5, gauge: int = 0
) -> EgoRun:
    """Errors drawn from the covariance that the run states; the pose `gauge` has none."""
    stamps, T = truth.timestamp_ns[::every], truth.T_world_imu[::every]
    root = rng.standard_normal((len(T), 9, 9)) * np.repeat([0.01, 0.1, 0.2], 3)[:, None]
    root[gauge] *= 1e-6
    covariance = root @ np.swapaxes(root, -1, -2)
    error = (np.linalg.cholesky(covariance) @ rng.standard_normal((len(T), 9, 1)))[..., 0]
    inside = se3.inverse(WORLD) @ T
    R = inside[:, :3, :3] @ so3.exp(-error[:, :3])  # R_true = R_est exp(δθ), p_true = p_est + δp
    return EgoRun(stamps, se3.make(R, inside[:, :3, 3] - error[:, 3:6]), covariance=covariance)


@pytest.mark.parametrize("gauge", [0, 7])  # a start in motion defines its world elsewhere
def test_nees_of_a_consistent_run_keeps_its_bounds(winding_path: Winding, gauge: int) -> None:
    truth = truth_of(winding_path(10_001))
    run = consistent_run(truth, np.random.default_rng(11), gauge=gauge)
    metrics = evaluate_ego(run, truth)
    for name, dof in (("orientation", 3), ("position", 3), ("pose", 6)):
        found = metrics.nees[name]
        assert found is not None
        # 2000 independent values: three sigma of their mean is 3 sqrt(2 dof / 2000)
        assert found.mean == pytest.approx(dof, abs=3.0 * math.sqrt(2.0 * dof / 2000.0)), name
        assert found.share_inside == pytest.approx(0.95, abs=0.02)
    inside = np.abs(metrics.series.errors) < metrics.series.three_sigma
    np.testing.assert_allclose(inside.mean(axis=0), 0.997, atol=0.006)
    assert run.covariance is not None
    bold = evaluate_ego(replace(run, covariance=run.covariance / 9.0), truth).nees["pose"]
    assert bold is not None
    assert bold.mean > 45.0


def test_nees_with_a_truth_that_has_errors_of_its_own(winding_path: Winding) -> None:
    """A consistent run against positions with known noise: only with the noise is it honest."""
    rng, sigma_m = np.random.default_rng(12), 0.3
    exact = truth_of(winding_path(10_001))
    run = consistent_run(exact, rng)
    T = exact.T_world_imu.copy()
    T[1:, :3, 3] += rng.normal(0.0, sigma_m, (len(T) - 1, 3))
    sigmas = np.full(len(T), sigma_m)
    sigmas[0] = 0.0  # the gauge
    noisy = evaluate_ego(run, replace(exact, T_world_imu=T, position_sigma_m=sigmas)).nees
    alone, with_truth = noisy["position"], noisy["position_with_truth"]
    assert alone is not None and with_truth is not None
    assert alone.mean > 6.0
    assert with_truth.mean == pytest.approx(3.0, abs=3.0 * math.sqrt(6.0 / 2000.0))
    stated = replace(exact, position_sigma_m=np.zeros(len(T)))
    both = evaluate_ego(run, stated).nees
    assert both["position_with_truth"] == both["position"]
    assert evaluate_ego(run, exact).nees["position_with_truth"] is None


def test_a_gauge_with_errors_counts_at_every_pose(winding_path: Winding) -> None:
    truth = truth_of(winding_path(2001))
    run = consistent_run(truth, np.random.default_rng(13))
    sigmas = np.zeros(len(truth.timestamp_ns))
    sigmas[0] = 100.0
    found = evaluate_ego(run, replace(truth, position_sigma_m=sigmas)).nees["position_with_truth"]
    assert found is not None
    assert found.mean < 0.1


def test_covariances_that_are_singular_or_unknown_are_counted(winding_path: Winding) -> None:
    truth = truth_of(winding_path(101))
    run = consistent_run(truth, np.random.default_rng(1))
    assert run.covariance is not None
    covariance = run.covariance.copy()
    covariance[3] = 0.0
    covariance[4] = np.nan
    found = scalars(evaluate_ego(replace(run, covariance=covariance), truth))
    assert found["nees_position_undefined_poses"] == 2
    assert found["nees_position"] is not None


def test_consistency_takes_the_truth_at_the_runs_own_stamps(winding_path: Winding) -> None:
    path = winding_path(2001)
    truth = truth_of(path)
    odd = truth_of(path[::2])
    odd = replace(odd, timestamp_ns=truth.timestamp_ns[::2])
    run = EgoRun(truth.timestamp_ns[1::20], path[1::20])  # always between two true poses
    metrics = evaluate_ego(run, odd, max_gap_s=0.011)
    step = np.linalg.norm(path[1, :3, 3] - path[0, :3, 3])
    assert np.abs(metrics.series.errors[:, 3:]).max() < 0.02 * step
    assert evaluate_ego(run, odd, max_gap_s=0.011).n_poses == len(run.timestamp_ns)


def test_velocity_is_compared_in_the_body(winding_path: Winding) -> None:
    path = winding_path(101)
    velocity = np.gradient(path[:, :3, 3], 0.01, axis=0)
    truth = replace(truth_of(path), velocity=velocity)
    in_run = (velocity + np.array([0.0, 0.0, 0.3])) @ WORLD[:3, :3]
    run = EgoRun(truth.timestamp_ns, se3.inverse(WORLD) @ path, velocity=in_run)
    assert evaluate_ego(run, truth).velocity_rmse_mps == pytest.approx(0.3)


def test_standstill(winding_path: Winding) -> None:
    path = np.concatenate([np.repeat(winding_path(400)[:1], 300, axis=0), winding_path(400)])
    truth = truth_of(path)
    creep = np.zeros((700, 3))
    creep[:, 1] = 0.02 * np.arange(700) * 0.01
    run = EgoRun(truth.timestamp_ns, se3.make(path[:, :3, :3], path[:, :3, 3] + creep))
    found = scalars(evaluate_ego(run, truth))
    assert found["standstill_s"] == pytest.approx(3.0, abs=0.15)
    assert found["standstill_mps"] == pytest.approx(0.02, abs=1e-6)
    assert found["standstill_worst_m"] == pytest.approx(0.06, abs=0.003)
    assert found["standstill_worst_deg"] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("n", [1, 2, 30])
def test_short_and_straight_runs_leave_out_what_they_cannot_tell(n: int) -> None:
    position = np.arange(float(n))[:, None] * np.array([0.01, 0.0, 0.0])
    truth = truth_of(se3.make(np.broadcast_to(np.eye(3), (n, 3, 3)), position))
    found = scalars(evaluate_ego(EgoRun(truth.timestamp_ns, truth.T_world_imu), truth))
    assert found["ate_yaw_m"] == pytest.approx(0.0, abs=1e-12)
    for key in ("ate_se3_m", "ate_sim3_deg", "scale_error_percent", "ate_percent", "rpe_1s_m",
                "rpe_10m_percent", "standstill_mps"):  # fmt: skip
        assert found[key] is None, key
    assert all(value is None or math.isfinite(value) for value in found.values())


def test_the_table_has_the_same_keys_for_every_short_run(winding_path: Winding) -> None:
    truth = truth_of(winding_path(1001)[:300])
    short = truth_of(winding_path(1001)[:2])
    tables = [
        scalars(evaluate_ego(EgoRun(t.timestamp_ns, t.T_world_imu), t)) for t in (truth, short)
    ]
    assert list(tables[0]) == list(tables[1])


def test_a_truth_of_another_time_is_refused(winding_path: Winding) -> None:
    truth = truth_of(winding_path(100))
    run = EgoRun(truth.timestamp_ns + 10**12, truth.T_world_imu)
    with pytest.raises(InputError, match=r"truth.tum: no true pose within 6 ms") as caught:
        evaluate_ego(run, truth)
    assert "(run 1000.000000000 ... 1000.990000000 s, truth 0.000000000" in str(caught.value)
