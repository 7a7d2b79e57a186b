"""One run against the truth: reads both, measures everything, writes metrics and plots."""

import contextlib
import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.table import Table

from ovmot.cameras.camera import Camera
from ovmot.datasets.find_truth import find_ego_truth, find_object_truth
from ovmot.datasets.pose_files import Trajectory, interpolate_poses
from ovmot.datasets.registry import open_sequence
from ovmot.datasets.truth import EgoTruth, ObjectTruth
from ovmot.errors import InputError, OvmotError
from ovmot.evaluation.alignment import ALIGNMENTS, Alignment
from ovmot.evaluation.calibration import CalibrationErrors, calibration_scalars
from ovmot.evaluation.ego import EgoMetrics, evaluate_ego, scalars
from ovmot.evaluation.headline import HEADLINES, NOTES, headline
from ovmot.evaluation.labels import LabelCounts, count_labels
from ovmot.evaluation.matching import ComparedFrame, ObjectCriteria, compare_frames
from ovmot.evaluation.objects import (
    ObjectMetrics,
    evaluate_objects,
    gate_scalars,
    label_scalars,
    object_scalars,
)
from ovmot.evaluation.stereo_gate import GateCounts, count_gate
from ovmot.evaluation.track_quality import confirmed_scalars
from ovmot.evaluation.trajectory import associate_stamps
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.outputs.finished_run import Run
from ovmot.outputs.run_json import RUN_JSON
from ovmot.outputs.run_reader import (
    EgoRun,
    Tracks,
    read_ego_run,
    read_matches,
    read_points,
    read_tracks,
)
from ovmot.outputs.run_writer import EVALUATION_FILES
from ovmot.text_files import StrPath, read_text

_MAX_GAP_NS = 6_000_000
_METRICS, _ERRORS, _NEES, _MAP = EVALUATION_FILES


@dataclass(frozen=True, slots=True)
class Evaluation:
    """All that was measured; None where the run or the truth lacks what it takes."""

    ego: EgoMetrics
    confirmed: dict[str, float | None] = field(default_factory=dict)
    frames: tuple[ComparedFrame, ...] = ()
    objects: ObjectMetrics | None = None
    labels: LabelCounts | None = None
    gate: GateCounts | None = None
    calibration: CalibrationErrors | None = None

    def scalars(self) -> dict[str, float | None]:
        """Every metric as one flat table, names ending in the unit."""
        return {name: value for group in self.groups() for name, value in group.items()}

    def groups(self) -> tuple[dict[str, float | None], ...]:
        """The same, apart: the ego motion, the moving objects, the labels, the stereo gate,
        the calibration."""
        return (
            scalars(self.ego),
            self.confirmed | ({} if self.objects is None else object_scalars(self.objects)),
            {} if self.labels is None else label_scalars(self.labels),
            {} if self.gate is None else gate_scalars(self.gate),
            {} if self.calibration is None else calibration_scalars(self.calibration),
        )


def evaluate(
    run: StrPath | Run,
    truth: StrPath | None = None,
    criteria: ObjectCriteria | None = None,
    sequence: str | None = None,
) -> Evaluation:
    """Measure a finished run against the truth; nothing is written.

    Parameters
    ----------
    run
        The folder of a run, or the run itself.
    truth
        The folder of a sequence with its truth, a bag with an odometry, or a TUM file of true
        poses; None for the data that the run has read.
    criteria
        When an object counts as found; by default those of docs/evaluation.md.
    sequence
        Which one, where the folder holds several.

    Raises
    ------
    InputError
        Where one of them is not what it should be, or they have no time in common.
    """
    folder = run.folder if isinstance(run, Run) else Path(run)
    place = _input_of(folder) if truth is None else Path(truth)
    return _evaluation(folder, place, sequence, criteria or ObjectCriteria())


@dataclass(frozen=True, slots=True)
class MotionComparison:
    """The ego motion against the truth, and the alignment `yaw` of the run's world to its world.

    `objects` are the true ones, in the truth's world; None where they are not known.
    """

    metrics: EgoMetrics
    alignment: Alignment
    objects: ObjectTruth | None = None


def compare_motion(
    run: StrPath | Run, truth: StrPath | None = None, sequence: str | None = None
) -> MotionComparison:
    """The ego motion alone against the truth; arguments and errors as those of `evaluate`."""
    folder = run.folder if isinstance(run, Run) else Path(run)
    place = _input_of(folder) if truth is None else Path(truth)
    ego_run = read_ego_run(folder)
    known = find_ego_truth(place, sequence)
    ego_truth = _at_poses_of(ego_run, known)
    metrics = evaluate_ego(ego_run, ego_truth)
    of_truth, of_run = associate_stamps(ego_truth.timestamp_ns, ego_run.timestamp_ns, _MAX_GAP_NS)
    alignment = ALIGNMENTS["yaw"](ego_truth.T_world_imu[of_truth], ego_run.T_world_imu[of_run])
    return MotionComparison(metrics, alignment, find_object_truth(place, sequence, known))


def _input_of(run: Path) -> Path:
    """The data that a run has read; raises `InputError` where it does not say, or it is gone."""
    try:
        path = Path(json.loads(read_text(run / RUN_JSON, InputError))["input"]["path"])
    except (ValueError, KeyError, TypeError):
        raise InputError.at(run, "does not say what it has read", "give --truth") from None
    if not path.exists():
        raise InputError.at(path, "was read by the run, and is gone", "give --truth")
    return path


def _evaluation(run: Path, truth: Path, sequence: str | None, wanted: ObjectCriteria) -> Evaluation:
    ego_run = read_ego_run(run)
    known = find_ego_truth(truth, sequence)
    ego_truth = _at_poses_of(ego_run, known)
    ego = evaluate_ego(ego_run, ego_truth)
    true_objects = _objects_of(truth, sequence, known)
    tracks = read_tracks(run) if Run(run).looked_for_objects else None
    confirmed = {} if tracks is None else confirmed_scalars(tracks, ego_run.timestamp_ns)
    if true_objects is None:
        return Evaluation(ego, confirmed)
    frames = _compared(tracks, ego_run, ego_truth, true_objects, wanted)
    points, matches = read_points(run), read_matches(run)
    with_ids = points is not None and true_objects.has_ids
    labels = None if points is None or not with_ids else count_labels(points, true_objects, wanted)
    gate = None
    if matches is not None and true_objects.has_depth:
        gate = count_gate(matches, true_objects, open_sequence(truth).rig)
    objects = None
    if frames:
        objects = evaluate_objects(frames, wanted, _left_camera(truth, sequence, true_objects))
    return Evaluation(ego, confirmed, frames, objects, labels, gate)


def _left_camera(
    data: Path, sequence: str | None, truth: ObjectTruth
) -> tuple[Camera, FloatArray] | None:
    """The left camera and T_cam0_imu (4, 4); None where the data does not say, as a bag."""
    if truth.image_rules is not None:
        return truth.image_rules.camera, truth.image_rules.T_cam0_imu
    try:
        rig = open_sequence(data, sequence=sequence).rig
    except InputError:
        return None
    return rig.cam0, se3.inverse(rig.T_imu_cam0)


def write_metrics(run: StrPath, evaluation: Evaluation) -> None:
    """Write `metrics.json` into the run, in one step; raises `OvmotError` where it cannot."""
    path = Path(run) / _METRICS
    partial = path.with_suffix(".json.part")
    text = json.dumps(evaluation.scalars(), indent=2, allow_nan=False) + "\n"
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        raise OvmotError(f"{path}: cannot be written: {error.strerror}") from None


def write_plots(run: StrPath, evaluation: Evaluation) -> None:
    """Write the errors with their bounds, NEES, and the map; raises `OvmotError`."""
    # matplotlib loads for half a second: no other command shall wait for it
    from ovmot.evaluation.ego_plots import error_figure, nees_figure, save_figure
    from ovmot.evaluation.map_plot import map_figure

    folder, series = Path(run), evaluation.ego.series
    save_figure(error_figure(series), folder / _ERRORS)
    save_figure(nees_figure(series), folder / _NEES)
    save_figure(map_figure(series, evaluation.frames), folder / _MAP)


def metrics_table(evaluation: Evaluation, *, everything: bool = False) -> Table:
    """The metrics to read first, for a terminal; with `everything` all that have a value."""
    table = Table("metric", "value", "meaning", title="against the truth")
    if everything:
        for group in evaluation.groups():
            for name, value in group.items():
                if value is not None:
                    table.add_row(name, _written(value), HEADLINES.get(name) or NOTES.get(name, ""))
            table.add_section()
        return table
    values = evaluation.scalars()
    for name in headline(values):
        table.add_row(name, _written(values[name]), HEADLINES[name])
    return table


def _written(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:.0f}" if value == round(value) else f"{value:.4g}"


def _at_poses_of(run: EgoRun, truth: EgoTruth) -> EgoTruth:
    """The truth, or, where it is too sparse for most poses of the run, interpolated at them.

    Such is a truth of a rate like that of the frames, but with stamps of its own (OXTS).
    """
    of_truth, _ = associate_stamps(truth.timestamp_ns, run.timestamp_ns, _MAX_GAP_NS)
    inside = run.timestamp_ns[
        (run.timestamp_ns >= truth.timestamp_ns[0]) & (run.timestamp_ns <= truth.timestamp_ns[-1])
    ]
    if 2 * len(of_truth) >= len(inside):
        return truth
    T = interpolate_poses(Trajectory(truth.timestamp_ns, truth.T_world_imu), inside)
    kept = np.isfinite(T[:, 0, 0])
    if kept.sum() <= len(of_truth):
        return truth
    sigma_m = truth.position_sigma_m
    if sigma_m is not None:
        since_ns = truth.timestamp_ns - truth.timestamp_ns[0]
        sigma_m = np.interp(inside[kept] - truth.timestamp_ns[0], since_ns, sigma_m)
    return EgoTruth(truth.path, inside[kept], T[kept], position_sigma_m=sigma_m)


def _objects_of(data: Path, sequence: str | None, ego: EgoTruth) -> ObjectTruth | None:
    """The true objects of a sequence; raises `InputError` where its writing was interrupted."""
    truth = find_object_truth(data, sequence, ego)
    if truth is None and (data / "truth").is_dir():
        raise InputError.at(
            data / "truth", "holds no objects.json: it was not written to its end",
            "simulate it again, or give the file with the poses by --truth",
        )  # fmt: skip
    return truth


def _compared(
    tracks: Tracks | None, ego_run: EgoRun, ego_truth: EgoTruth, truth: ObjectTruth,
    criteria: ObjectCriteria,
) -> tuple[ComparedFrame, ...]:  # fmt: skip
    if tracks is None:
        return ()
    of_truth, of_run = associate_stamps(ego_truth.timestamp_ns, ego_run.timestamp_ns, _MAX_GAP_NS)
    return compare_frames(
        ego_run.timestamp_ns[of_run], ego_truth.T_world_imu[of_truth], ego_run.T_world_imu[of_run],
        truth, tracks, criteria,
    )  # fmt: skip
