"""The folder of a run: its files, all of which are closed also after an error."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.kalibr import CHAIN_FILE
from ovmot.errors import InputError, OvmotError
from ovmot.outputs.kitti_tracks import KittiTracks
from ovmot.outputs.preview import PREVIEW_FILE, PreviewFile
from ovmot.outputs.run_json import PARTIAL_RUN_JSON, RUN_JSON
from ovmot.outputs.tables import (
    CalibrationTable,
    CovarianceTable,
    PointsTable,
    StateTable,
    StereoTable,
    TimingTable,
    TracksTable,
    TrajectoryTable,
)
from ovmot.outputs.video import OverlayVideo
from ovmot.outputs.views import View
from ovmot.types import FrameResult


class Output(Protocol):
    """One file of a run; it gets every result, in order of time."""

    def write(self, result: FrameResult) -> None:
        """Write one frame; raises `OvmotError` with the file's name where it cannot."""
        ...

    def close(self) -> None:
        """Finish the file; a second call does nothing."""
        ...


@dataclass(frozen=True, slots=True)
class RunContext:
    """What outputs know of the run.

    The rig, the names of the stages if known, the number of each stamp's frame, and the view that
    overlays show.
    """

    rig: StereoRig
    stages: tuple[str, ...] = ()
    frame_number: Mapping[int, int] = field(default_factory=dict)
    view: View = "objects"


OutputFactory = Callable[[Path, RunContext], Output]

OUTPUTS: dict[str, OutputFactory] = {
    "trajectory.tum": lambda path, _: TrajectoryTable(path),
    "state.csv": lambda path, context: StateTable(path, context.rig.n_cameras),
    "covariance.csv": lambda path, _: CovarianceTable(path),
    "calibration.csv": lambda path, _: CalibrationTable(path),
    "tracks.csv": lambda path, _: TracksTable(path),
    "objects_kitti.txt": lambda path, context: KittiTracks(
        path, context.rig.cam0, context.frame_number
    ),
    "timing.csv": lambda path, context: TimingTable(path, context.stages),
    "points.csv": lambda path, _: PointsTable(path),
    "stereo.csv": lambda path, _: StereoTable(path),
    "overlay.mp4": lambda path, context: OverlayVideo(path, context.rig, context.view),
    PREVIEW_FILE: lambda path, context: PreviewFile(path, context.rig.cam0),
}

_ALWAYS = ("trajectory.tum", "state.csv", "covariance.csv", "tracks.csv", "timing.csv")
_OBJECTS = ("objects_kitti.txt",)
_CALIBRATION = ("calibration.csv",)
_POINTS = ("points.csv", "stereo.csv")
_VIDEO = ("overlay.mp4",)
_PREVIEW = (PREVIEW_FILE,)
EVALUATION_FILES = ("metrics.json", "ego_error.png", "nees.png", "map.png")
"""What `ovmot evaluate` adds to a run; a new run in the folder removes them."""

_RUN_FILES = (
    *OUTPUTS,
    RUN_JSON,
    PARTIAL_RUN_JSON,
    "report.html",
    CHAIN_FILE,
    *EVALUATION_FILES,
)


class RunWriter:
    """Forwards each result to all outputs of a run. A context manager: it always closes them."""

    def __init__(self, outputs: Sequence[Output]) -> None:
        self._outputs = tuple(outputs)
        self.frames_written = 0

    def write(self, result: FrameResult) -> None:
        """Write one frame everywhere; raises `OvmotError` where a file, or the pose, is bad."""
        if not np.all(np.isfinite(result.ego.T_world_imu)):
            raise OvmotError(f"the pose at {result.timestamp_ns} ns is not finite: run ended there")
        for output in self._outputs:
            output.write(result)
        self.frames_written += 1

    def close(self) -> None:
        """Close all outputs; the first failure is raised when all are closed."""
        failures = self._close_all()
        if failures:
            raise failures[0]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        failures = self._close_all()
        if error is None and failures:
            raise failures[0]
        for failure in failures:  # the first error is the one to report
            if error is not None:
                error.add_note(str(failure))

    def _close_all(self) -> list[Exception]:
        failures: list[Exception] = []
        for output in self._outputs:
            try:
                output.close()
            except Exception as error:
                failures.append(error)
        return failures


def open_outputs(
    folder: Path,
    *,
    rig: StereoRig,
    save_points: bool = False,
    video: bool = False,
    view: View = "objects",
    preview: bool = False,
    force: bool = False,
    stages: Sequence[str] = (),
    calibration: bool = False,
    frame_number: Mapping[int, int] | None = None,
    more: Sequence[Callable[[RunContext], Output]] = (),
) -> RunWriter:
    """Start the files of a run in `folder`, which is made if missing.

    `stages` are the columns of `timing.csv`; without them the first frame's are taken.
    `frame_number` gives the number of each stamp (ns) in the sequence; None where no objects are
    tracked, which leaves `objects_kitti.txt` out. `view` is what overlays show; `preview`
    keeps small pictures for the report. `more` makes outputs beyond the folder. Raises `InputError`
    where the folder holds a run already (unless `force`, which removes that run's files and nothing
    else) or cannot be written into.
    """
    check_folder(folder, force=force)
    names = (
        *_ALWAYS,
        *(() if frame_number is None else _OBJECTS),
        *(_CALIBRATION if calibration else ()),
        *(_POINTS if save_points else ()),
        *(_VIDEO if video else ()),
        *(_PREVIEW if preview else ()),
    )
    context = RunContext(rig, tuple(stages), frame_number or {}, view)
    opened: list[Output] = []
    try:
        for make in more:  # first: where one is refused, the folder is as it was
            opened.append(make(context))
        prepare_folder(folder, force=force)
        for name in names:
            opened.append(OUTPUTS[name](folder / name, context))
    except BaseException:
        RunWriter(opened).close()
        raise
    return RunWriter(opened)


def check_folder(folder: Path, *, force: bool) -> None:
    """Raise `InputError` where `folder` is a file, or holds a run and `force` is not given."""
    with _folder_errors(folder):
        if folder.exists() and not folder.is_dir():
            raise InputError.at(folder, "is a file", "give a folder with -o")
        present = _files_of_a_run(folder)
    if present and not force:
        problem = f"holds a run already ({present[0].name})"
        remedy = "choose another folder, or replace that run with --force"
        raise InputError.at(folder, problem, remedy)


def prepare_folder(folder: Path, *, force: bool) -> None:
    """Make `folder`, empty of a run's files; raises `InputError` (see `open_outputs`)."""
    check_folder(folder, force=force)
    with _folder_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for path in _files_of_a_run(folder):
            path.unlink()


@contextmanager
def _folder_errors(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise InputError.at(
            error.filename or folder,
            f"cannot prepare the output folder: {error.strerror}",
            "choose another folder with -o",
        ) from None


def _files_of_a_run(folder: Path) -> list[Path]:
    paths = (folder / name for name in _RUN_FILES)
    return [path for path in paths if path.is_symlink() or path.exists()]
