"""How far a command is: a bar on a terminal, lines of JSON where they are asked for."""

import json
import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from ovmot.cli.console import printable, say
from ovmot.errors import InputError

if TYPE_CHECKING:
    from ovmot import FrameResult, RunContext

_JSON_EVERY_S = 1.0
_SAME_OFFSET_S = 0.01


class Style(Enum):
    """What a command says beside warnings and errors."""

    BAR = "bar"
    QUIET = "quiet"
    JSON_LINES = "json lines"


def style_of(quiet: bool, json_lines: bool) -> Style:
    """The style that `--quiet` and `--json-lines` ask for; `InputError` for both."""
    if quiet and json_lines:
        raise InputError("--quiet and --json-lines: choose one of them")
    if json_lines:
        return Style.JSON_LINES
    return Style.QUIET if quiet else Style.BAR


def say_result(style: Style, line: str, **values: Any) -> None:
    """What a command has done: words, or the values as JSON."""
    say_event(style, "finished", line, **values)


def say_event(style: Style, event: str, line: str, **values: Any) -> None:
    """An event of a command: words, or its name and the values as JSON."""
    if style is Style.JSON_LINES:
        json_line(event, **values)
    elif style is Style.BAR:
        typer.echo(printable(line))


def json_line(event: str, **values: Any) -> None:
    """One JSON object on one line of standard output, at once."""
    sys.stdout.write(json.dumps({"event": event, **values}) + "\n")
    sys.stdout.flush()


@dataclass(slots=True)
class HealthWatch:
    """What is said of a run: an output that writes nothing.

    The health and the clocks' offset (with its sigma, s) of the newest frame, the offset that was
    given, and the numbers of all moving objects that were confirmed.
    """

    health: str = "starting"
    given_offset_s: float = 0.0
    offset_s: tuple[float, float] = (math.nan, math.nan)
    objects: set[int] = field(default_factory=set)

    def __call__(self, context: "RunContext") -> "HealthWatch":
        """Itself, as the factory that a run asks for."""
        self.given_offset_s = context.rig.time_offset_s
        return self

    def write(self, result: "FrameResult") -> None:
        """Note one frame."""
        self.health = result.health.value
        self.offset_s = result.ego.time_offset_s, result.ego.time_offset_std_s
        self.objects.update(t.track_id for t in result.tracks if t.state == "confirmed")

    def close(self) -> None:
        """Nothing is open."""

    def counted_objects(self) -> str:
        """How many objects moved, in words."""
        return f"{len(self.objects)} moving object{'' if len(self.objects) == 1 else 's'}"

    def other_offset(self) -> str | None:
        """That the clocks' offset was found to be another than the one given, if it surely is."""
        found, sigma = self.offset_s
        apart = abs(found - self.given_offset_s)
        if not apart > max(_SAME_OFFSET_S, 3.0 * sigma):  # NaN without an estimate
            return None
        return (
            f"the clocks' offset (t_imu - t_camera) was found to be {found:.4f} s, given"
            f" {self.given_offset_s:.4f} s: to start from it, run with"
            f" --set recording.time_offset_s={found:.4f}"
        )


@contextmanager
def progress(
    task_name: str, total: int, style: Style = Style.BAR, watch: HealthWatch | None = None
) -> Iterator[Callable[[int], None]]:
    """A bar of frames with their rate, the time left, and the health where it is watched."""
    if style is Style.JSON_LINES:
        yield _JsonProgress(task_name, total, watch)
        return
    health = () if watch is None else (_Health(watch),)
    columns = (TimeRemainingColumn(compact=True), _FramesPerSecond(), *health)
    with _bar(style is Style.QUIET, *columns) as bar:
        task = bar.add_task(task_name, total=total)
        yield lambda done: bar.update(task, completed=done)


@contextmanager
def stages(style: Style = Style.BAR) -> Iterator[Callable[[str, int, int], None]]:
    """A bar for each stage (name, how many are done, of how many); lines where no one watches."""
    if style is Style.JSON_LINES:
        yield lambda name, done, total: json_line("progress", task=name, done=done, total=total)
        return
    with _bar(style is Style.QUIET, TimeElapsedColumn()) as bar:
        tasks: dict[str, TaskID] = {}

        def advance(name: str, done: int, total: int) -> None:
            if name not in tasks:
                tasks[name] = bar.add_task(name, total=total)
            bar.update(tasks[name], completed=done, total=total)

        def line(name: str, done: int, total: int) -> None:
            say(f"ovmot: {name}: {done} of {total}")

        on_paper = bar.disable and style is Style.BAR
        yield line if on_paper else advance


@contextmanager
def steps(task_name: str, style: Style) -> Iterator[Callable[[int, int], None]]:
    """A bar of how many of how many are done; nothing where no one watches."""
    if style is Style.JSON_LINES:
        yield lambda done, total: json_line("progress", task=task_name, done=done, total=total)
        return
    with _bar(style is Style.QUIET, TimeElapsedColumn()) as bar:
        task = bar.add_task(task_name, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


class _JsonProgress:
    """A line of JSON each second, and one at the end."""

    def __init__(self, task: str, total: int, watch: HealthWatch | None) -> None:
        self._task, self._total, self._watch = task, total, watch
        self._start = self._last = time.monotonic()

    def __call__(self, done: int) -> None:
        now = time.monotonic()
        if now - self._last < _JSON_EVERY_S and done < self._total:
            return
        self._last = now
        rate = done / max(now - self._start, 1e-9)
        left = (self._total - done) / rate if rate > 0.0 else None
        values: dict[str, Any] = {
            "task": self._task,
            "done": done,
            "total": self._total,
            "frames_per_s": round(rate, 2),
            "eta_s": None if left is None else round(left, 1),
        }
        if self._watch is not None:
            values["health"] = self._watch.health
        json_line("progress", **values)


class _FramesPerSecond(ProgressColumn):
    """The rate so far."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:.1f} frames/s" if task.speed else "- frames/s")


class _Health(ProgressColumn):
    """The health of the newest frame."""

    def __init__(self, watch: HealthWatch) -> None:
        super().__init__()
        self._watch = watch

    def render(self, task: Task) -> Text:
        return Text(self._watch.health)


def _bar(quiet: bool, *last_columns: ProgressColumn) -> Progress:
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), *last_columns)
    # into a file, a bar would only be a broken line before the messages
    return Progress(*columns, console=console, disable=quiet or not console.is_terminal)
