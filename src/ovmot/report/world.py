"""One world for the map of a page: that of the truth, else that of the first run."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ovmot.datasets.truth import ObjectTruth
from ovmot.errors import OvmotError
from ovmot.evaluation.alignment import ALIGNMENTS, Alignment
from ovmot.evaluation.ego import EgoMetrics
from ovmot.evaluation.trajectory import associate_stamps
from ovmot.geometry.arrays import FloatArray
from ovmot.outputs.finished_run import Run
from ovmot.run_evaluation import MotionComparison, compare_motion

_SAME_FRAME_NS = 1_000_000
UNMOVED = Alignment(np.eye(3), np.zeros(3))


@dataclass(frozen=True, slots=True)
class Placed:
    """A run, where its world lies in that of the page, and its errors where truth is known.

    `true_objects` are in the page's world, which then is that of the truth.
    """

    run: Run
    to_page: Alignment
    truth: EgoMetrics | None = None
    true_objects: ObjectTruth | None = None

    def positions(self, position: FloatArray) -> FloatArray:
        """Positions (..., 3) of the run in the page's world."""
        return self.to_page.positions(position)

    def yaw(self, yaw: FloatArray) -> FloatArray:
        """Headings (...) of the run in the page's world, rad."""
        R = self.to_page.R
        return np.asarray(yaw + np.arctan2(R[1, 0], R[0, 0]))


def placed_runs(runs: Sequence[Run], truth: Path | None = None) -> tuple[Placed, ...]:
    """The runs in one world.

    `truth` is that of all runs; None for the data that each has read. Where there is none, runs of
    the same recording are laid onto the first one by yaw and position. Raises `InputError` only
    for a `truth` that was given.
    """
    placed: list[Placed] = []
    for run in runs:
        found = _compared(run, truth)
        if found is not None:
            placed.append(Placed(run, found.alignment, found.metrics, found.objects))
        else:
            placed.append(Placed(run, _onto(placed[0], run) if placed else UNMOVED))
    return tuple(placed)


def _compared(run: Run, truth: Path | None) -> MotionComparison | None:
    try:
        return compare_motion(run, truth)
    except OvmotError:
        if truth is not None:
            raise
        return None  # no truth is known


def _onto(first: Placed, run: Run) -> Alignment:
    """The alignment of a run to the first one at their common frames; none without any."""
    reference, estimate = first.run.trajectory, run.trajectory
    a, b = associate_stamps(reference.timestamp_ns, estimate.timestamp_ns, _SAME_FRAME_NS)
    try:
        T = first.to_page.poses(reference.T_world_imu[a])
        return ALIGNMENTS["yaw"](T, estimate.T_world_imu[b])
    except OvmotError:
        return UNMOVED
