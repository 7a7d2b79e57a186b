"""`report.html` of one run, or of several side by side."""

from collections.abc import Sequence
from pathlib import Path

from ovmot.errors import InputError, OvmotError
from ovmot.outputs.finished_run import Run
from ovmot.report.contents import page_contents
from ovmot.report.page import report_page
from ovmot.text_files import StrPath

REPORT_FILE = "report.html"


def write_report(
    runs: Sequence[StrPath | Run], out: StrPath | None = None, truth: StrPath | None = None
) -> Path:
    """Write the page of some finished runs and return its path.

    It is one file that works offline: a map, the overlay's frames, plots and tables, all moved by
    one time slider.

    Parameters
    ----------
    runs
        Folders of runs, or the runs themselves; several are shown side by side.
    out
        The file; None for `report.html` in the run, or, for several, in the current folder.
    truth
        Data with true poses, or a TUM file; None for the data that each run has read.

    Raises
    ------
    InputError
        Where a folder is no run, a file of it is broken, or the truth is none of it.
    OvmotError
        Where the page cannot be written.
    """
    if not runs:
        raise InputError("a report needs a run: give the output folder of 'ovmot run'")
    found = [run if isinstance(run, Run) else Run(run) for run in runs]
    path = Path(out) if out is not None else _place_of(found)
    page = report_page(page_contents(found, None if truth is None else Path(truth)))
    write_page(path, page)
    return path


def write_page(path: Path, page: str) -> None:
    """Write a page in one move: the file is there whole, or as it was; raises `OvmotError`."""
    partial = path.with_name(f"{path.name}.part")
    try:
        partial.write_text(page, encoding="utf-8")
        partial.replace(path)
    except OSError as error:
        raise OvmotError(f"{path}: cannot be written: {error.strerror}") from None


def _place_of(runs: Sequence[Run]) -> Path:
    return runs[0].folder / REPORT_FILE if len(runs) == 1 else Path(REPORT_FILE)
