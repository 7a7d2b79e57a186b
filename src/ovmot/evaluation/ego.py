"""The ego motion of a run against the truth: every metric of `ovmot evaluate` in one value."""

from dataclasses import dataclass

import numpy as np

from ovmot.datasets.pose_files import Trajectory, interpolate_poses
from ovmot.datasets.text_tables import ns_to_seconds
from ovmot.datasets.truth import EgoTruth
from ovmot.errors import InputError, OvmotError
from ovmot.evaluation.alignment import ALIGNMENTS, align_first
from ovmot.evaluation.consistency import Average, average, nees, pose_errors, turn_world
from ovmot.evaluation.standstill import StandstillDrift, standing_intervals, standstill_drift
from ovmot.evaluation.trajectory import (
    ErrorStatistics,
    absolute_errors,
    associate_stamps,
    drift_percent,
    pairs_by_distance,
    pairs_by_time,
    path_lengths,
    relative_errors,
    statistics,
)
from ovmot.geometry.arrays import FloatArray, IntArray
from ovmot.outputs.run_reader import EgoRun

ATE_ALIGNMENTS = ("yaw", "se3", "sim3", "none")
RPE_SECONDS = (1.0,)
RPE_METRES = (10.0, 50.0, 100.0, 500.0)
NEES_DOF = {"orientation": 3, "position": 3, "pose": 6, "position_with_truth": 3}

_GAUGE_S = 2.0
_SHORT_M = 2.0  # below it, errors in percent of the path say nothing


@dataclass(frozen=True, slots=True)
class AbsoluteSummary:
    """ATE after one alignment: translation in m, rotation in rad; `scale` is the alignment's."""

    translation: ErrorStatistics
    rotation: ErrorStatistics
    scale: float


@dataclass(frozen=True, slots=True)
class RelativeSummary:
    """RPE over all pairs `delta` (`1s`, `10m`) apart; None where there is no such pair.

    Translation in m, rotation in rad, `percent` of the path between (pairs by distance only).
    """

    delta: str
    n_pairs: int
    translation: ErrorStatistics | None
    rotation: ErrorStatistics | None
    percent: float | None


@dataclass(frozen=True, slots=True)
class EgoSeries:
    """Errors over time, at the N compared poses, for plots.

    `errors` and `three_sigma` (N, 6): rotation (right perturbation, rad), then position (m, in
    the truth's world), after the alignment `first` at the pose of the first 2 s whose position the
    run is surest of; `nees` by name (N,), `position_with_truth` that of the position where the
    truth's own errors are taken into account. NaN where run or truth state no covariance.
    `position_true` and `position_aligned` (N, 3): the path, and the estimate laid onto it by the
    alignment `yaw`.
    """

    timestamp_ns: IntArray
    errors: FloatArray
    three_sigma: FloatArray
    nees: dict[str, FloatArray]
    position_true: FloatArray
    position_aligned: FloatArray


@dataclass(frozen=True, slots=True)
class EgoMetrics:
    """How far a run's ego motion is from the truth; `scalars` gives it as one flat table.

    `first_pose_s` is from the truth's first stamp to the first compared pose, `distance_m` the
    true path between the compared poses. `ate` by alignment, `nees` by part of the pose; None where
    the poses do not determine it, or the run states no covariance.
    """

    n_poses: int
    first_pose_s: float
    distance_m: float
    ate: dict[str, AbsoluteSummary | None]
    rpe: tuple[RelativeSummary, ...]
    nees: dict[str, Average | None]
    standstill: tuple[StandstillDrift, ...]
    velocity_rmse_mps: float | None
    series: EgoSeries


def evaluate_ego(run: EgoRun, truth: EgoTruth, *, max_gap_s: float = 0.006) -> EgoMetrics:
    """Compare the poses whose stamps are at most `max_gap_s` from one of the truth.

    ATE and RPE take the true pose with the nearest stamp, as evo does. The series and NEES, for
    which some millimetres count, take the truth interpolated to the run's stamp.
    Raises `InputError` where no stamps agree.
    """
    of_truth, of_run = associate_stamps(
        truth.timestamp_ns, run.timestamp_ns, round(max_gap_s * 1e9)
    )
    if len(of_run) == 0:
        raise InputError(_nothing_in_common(run, truth, max_gap_s))
    stamps = run.timestamp_ns[of_run]
    T_true, T_run = truth.T_world_imu[of_truth], run.T_world_imu[of_run]
    series = _series(run, truth, of_run, of_truth)
    intervals = standing_intervals(truth.timestamp_ns, truth.T_world_imu)
    return EgoMetrics(
        n_poses=len(stamps),
        first_pose_s=float((stamps[0] - truth.timestamp_ns[0]) * 1e-9),
        distance_m=float(path_lengths(T_true)[-1]),
        ate={name: _absolute(T_true, T_run, name) for name in ATE_ALIGNMENTS},
        rpe=_relative(stamps, T_true, T_run),
        nees={name: average(series.nees[name], dof) for name, dof in NEES_DOF.items()},
        standstill=tuple(standstill_drift(stamps, T_true, T_run, intervals)),
        velocity_rmse_mps=_velocity_rmse(run, truth, of_run, of_truth),
        series=series,
    )


def scalars(metrics: EgoMetrics) -> dict[str, float | None]:
    """The metrics as one flat table, names ending in the unit; None where there is no value.

    ATE and RPE are RMSE. The keys are the same for every run, but for RPE over 50 m and more, which
    need a path that long.
    """
    out: dict[str, float | None] = {
        "poses": float(metrics.n_poses),
        "first_pose_s": metrics.first_pose_s,
        "distance_m": metrics.distance_m,
    }
    for name, ate in metrics.ate.items():
        out[f"ate_{name}_m"] = None if ate is None else ate.translation.rmse
        out[f"ate_{name}_deg"] = None if ate is None else float(np.degrees(ate.rotation.rmse))
    sim3, yaw = metrics.ate["sim3"], metrics.ate["yaw"]
    out["scale_error_percent"] = None if sim3 is None else 100.0 * (1.0 / sim3.scale - 1.0)
    far = metrics.distance_m > _SHORT_M
    out["ate_percent"] = (
        100.0 * yaw.translation.rmse / metrics.distance_m if far and yaw is not None else None
    )
    for rpe in metrics.rpe:
        t, r = rpe.translation, rpe.rotation
        out[f"rpe_{rpe.delta}_m"] = None if t is None else t.rmse
        out[f"rpe_{rpe.delta}_deg"] = None if r is None else float(np.degrees(r.rmse))
        if rpe.delta.endswith("m"):
            out[f"rpe_{rpe.delta}_percent"] = rpe.percent
    out["velocity_rmse_mps"] = metrics.velocity_rmse_mps
    for name, found in metrics.nees.items():
        out[f"nees_{name}"] = None if found is None else found.mean
        out[f"nees_{name}_inside_95_percent"] = (
            None if found is None else 100.0 * found.share_inside
        )
        undefined = metrics.n_poses if found is None else found.undefined
        out[f"nees_{name}_undefined_poses"] = float(undefined)
    return out | _standstill_scalars(metrics.standstill)


def _standstill_scalars(drifts: tuple[StandstillDrift, ...]) -> dict[str, float | None]:
    """Total time, the worst interval's drift, and the drift per second over all of them."""
    seconds = sum(drift.duration_s for drift in drifts)
    if not drifts:
        nothing = ("standstill_worst_m", "standstill_worst_deg", "standstill_mps")
        return {"standstill_s": 0.0, **dict.fromkeys(nothing)}
    return {
        "standstill_s": seconds,
        "standstill_worst_m": max(drift.translation_m for drift in drifts),
        "standstill_worst_deg": float(np.degrees(max(drift.rotation_rad for drift in drifts))),
        "standstill_mps": sum(drift.translation_m for drift in drifts) / seconds,
    }


def _absolute(T_true: FloatArray, T_run: FloatArray, name: str) -> AbsoluteSummary | None:
    try:
        alignment = ALIGNMENTS[name](T_true, T_run)
    except OvmotError:  # the path does not determine it: a straight line, a single point
        return None
    errors = absolute_errors(T_true, alignment.poses(T_run))
    translation, rotation = statistics(errors.translation), statistics(errors.rotation)
    if translation is None or rotation is None:
        return None
    return AbsoluteSummary(translation, rotation, alignment.scale)


def _relative(
    stamps: IntArray, T_true: FloatArray, T_run: FloatArray
) -> tuple[RelativeSummary, ...]:
    """RPE over each time, and over the shortest length and all that the path is long enough for."""
    pairs = {f"{delta:g}s": pairs_by_time(stamps, delta) for delta in RPE_SECONDS}
    path_m = path_lengths(T_true)[-1]
    lengths = [delta for delta in RPE_METRES if delta <= max(path_m, RPE_METRES[0])]
    pairs |= {f"{delta:g}m": pairs_by_distance(T_true, delta) for delta in lengths}
    out = []
    for name, (first, second) in pairs.items():
        errors = relative_errors(T_true, T_run, first, second)
        by_distance = name.endswith("m")
        out.append(
            RelativeSummary(
                delta=name,
                n_pairs=len(errors),
                translation=statistics(errors.translation),
                rotation=statistics(errors.rotation),
                percent=drift_percent(T_true, errors, first, second) if by_distance else None,
            )
        )
    return tuple(out)


def _series(run: EgoRun, truth: EgoTruth, of_run: IntArray, of_truth: IntArray) -> EgoSeries:
    stamps, T_run = run.timestamp_ns[of_run], run.T_world_imu[of_run]
    T_true = interpolate_poses(Trajectory(truth.timestamp_ns, truth.T_world_imu), stamps)
    outside = ~np.isfinite(T_true[:, 0, 0])  # before the first or after the last true pose
    T_true[outside] = truth.T_world_imu[of_truth[outside]]
    covariance = np.full((len(stamps), 6, 6), np.nan)
    if run.covariance is not None:
        covariance = run.covariance[of_run, :6, :6]
    surest = _surest_pose(stamps, covariance)
    gauge = align_first(T_true[surest:], T_run[surest:])
    errors = pose_errors(T_true, gauge.poses(T_run))
    covariance = turn_world(covariance, gauge.R)
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    of_both = covariance[:, 3:, 3:] + _of_truth(truth, of_truth, surest)[:, None, None] * np.eye(3)
    parts = {"orientation": slice(0, 3), "position": slice(3, 6), "pose": slice(0, 6)}
    yaw = ALIGNMENTS["yaw"](T_true, T_run)
    return EgoSeries(
        timestamp_ns=stamps,
        errors=errors,
        three_sigma=3.0 * np.sqrt(np.where(variance >= 0.0, variance, np.nan)),
        nees={
            **{name: nees(errors[:, k], covariance[:, k, k]) for name, k in parts.items()},
            "position_with_truth": nees(errors[:, 3:], of_both),
        },
        position_true=T_true[:, :3, 3],
        position_aligned=yaw.positions(T_run[:, :3, 3]),
    )


def _of_truth(truth: EgoTruth, of_truth: IntArray, gauge: int) -> FloatArray:
    """Variance (N,), m², that the truth's errors give to a coordinate of the position's error.

    The error is that of the true position there and of the one that the run is aligned at, taken
    as independent: where they are alike, it is less. NaN where the truth states none.
    """
    if truth.position_sigma_m is None:
        return np.full(len(of_truth), np.nan)
    variance = truth.position_sigma_m[of_truth] ** 2
    return np.asarray(variance + variance[gauge])


def _surest_pose(stamps: IntArray, covariance: FloatArray) -> int:
    """Index of the pose of the first seconds whose position the run is surest of; else the first.

    A start in motion defines the filter's world some frames before its first pose, so that this
    pose has an error of its own, which must not become that of all the others.
    """
    early = int(np.searchsorted(stamps, stamps[0] + round(_GAUGE_S * 1e9)))
    variance = np.trace(covariance[:early, 3:, 3:], axis1=1, axis2=2)
    if not np.any(np.isfinite(variance)):
        return 0
    return int(np.nanargmin(variance))


def _velocity_rmse(
    run: EgoRun, truth: EgoTruth, of_run: IntArray, of_truth: IntArray
) -> float | None:
    """RMSE of the velocity in m/s, in the body frame, so that no alignment enters."""
    if run.velocity is None or truth.velocity is None:
        return None
    R_true, R_run = truth.T_world_imu[of_truth, :3, :3], run.T_world_imu[of_run, :3, :3]
    v_true = np.einsum("nji,nj->ni", R_true, truth.velocity[of_truth])
    v_run = np.einsum("nji,nj->ni", R_run, run.velocity[of_run])
    squared = np.sum((v_run - v_true) ** 2, axis=1)
    known = np.isfinite(squared)
    return float(np.sqrt(np.mean(squared[known]))) if np.any(known) else None


def _nothing_in_common(run: EgoRun, truth: EgoTruth, max_gap_s: float) -> str:
    spans = [
        f"{ns_to_seconds(int(stamps[0]))} ... {ns_to_seconds(int(stamps[-1]))} s"
        for stamps in (run.timestamp_ns, truth.timestamp_ns)
    ]
    return (
        f"{truth.path}: no true pose within {1e3 * max_gap_s:g} ms of any pose of the run"
        f" (run {spans[0]}, truth {spans[1]}); is it the truth of this run?"
    )
