"""`ovmot demo`."""

import shutil
import time
from pathlib import Path
from typing import Annotated

import typer

from ovmot.cli.console import printable
from ovmot.cli.options import QuietOption
from ovmot.errors import InputError

_DATA, _OUT, _TRUTH = "data", "out", "truth/poses.csv"


def demo(
    folder: Annotated[Path, typer.Argument(help="Folder to write into.")] = Path("ovmot-demo"),
    duration: Annotated[
        float, typer.Option(min=3.0, metavar="SECONDS", help="Length of the sequence.")
    ] = 8.0,
    video: Annotated[bool, typer.Option(help="Write overlay.mp4.")] = True,
    quiet: QuietOption = False,
) -> None:
    """Simulate a small street, run on it, and hold the result against the truth.

    As `ovmot simulate`, `run` and `evaluate` would do. An earlier demo in the folder is replaced.
    """
    from ovmot.cli.app import evaluate, run, simulate  # which has this command too

    start = time.monotonic()
    data, out = folder / _DATA, folder / _OUT
    _make_room(data)
    _say(quiet, f"ovmot simulate {data} --scene demo --duration {duration:g}")
    simulate(data, scene="demo", duration=duration, quiet=quiet)
    more = " --video" if video else ""
    _say(quiet, f"ovmot run {data} -o {out} --save-points --force{more}")
    run(data, out, save_points=True, video=video, force=True, quiet=quiet)
    _say(quiet, f"ovmot evaluate {out}")
    evaluate(out)
    _say(quiet, f"done in {time.monotonic() - start:.0f} s: see {out / 'report.html'}")


def _make_room(data: Path) -> None:
    """Remove the data of an earlier demo; `InputError` where other data stands there."""
    if not data.exists():
        return
    if not (data / _TRUTH).is_file():
        raise InputError.at(data, "is no data of a demo", "choose another folder")
    shutil.rmtree(data)


def _say(quiet: bool, line: str) -> None:
    if not quiet:
        typer.echo(printable(f"$ {line}" if line.startswith("ovmot ") else line))
