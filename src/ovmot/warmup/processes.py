"""Processes that compile the kernels, while others do something else.

Each has one of the parts (`warmup.parts`); the next one begins where one has ended. A stamp in the
cache says that all was compiled; it is missing after another version, processor or interruption.
"""

import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from types import TracebackType
from typing import Self

import ovmot
from ovmot.errors import OvmotError
from ovmot.kernels.cache import can_keep, code_folders, has_code, is_warm, set_warm
from ovmot.runtime import n_processors

NAMES = ("objects", "filter", "front end", "start and SLAM features", "simulator")
"""The keys of `warmup.parts.PARTS`, in the order in which they begin; not imported from there, so
that the processes begin before what they need is loaded here."""

_AT_ONCE = 3
"""Of more, two would compile the same: the last part needs what the second one compiles."""
_LOOK_EVERY_S = 0.3


def needs_warm_up() -> bool:
    """Is something to be compiled, and can it be kept?"""
    return not is_warm(_package()) and can_keep()


def warm_up() -> None:
    """Compile what is not compiled yet; raises `OvmotError` where that fails, and says why."""
    with WarmUp() as compiling:
        compiling.wait()


class WarmUp(AbstractContextManager["WarmUp"]):
    """The processes at work; those that still are when the block ends, are killed."""

    def __init__(self) -> None:
        self._waiting = list(NAMES)
        self._jobs: dict[str, subprocess.Popen[str]] = {}

    def __enter__(self) -> Self:
        self._begin_more()
        return self

    def wait(self, on_progress: Callable[[int, int], None] = lambda done, total: None) -> None:
        """Wait for all; `on_progress` is told of how many files of kernels some code is compiled.

        Raises `OvmotError` with the last words of a process that failed.
        """
        folders = code_folders(_package())
        while self._jobs or self._waiting:
            self._end_those_done()
            self._begin_more()
            on_progress(sum(map(has_code, folders)), len(folders))
            time.sleep(_LOOK_EVERY_S)
        set_warm(_package())

    def _begin_more(self) -> None:
        at_once = min(_AT_ONCE, n_processors())
        while self._waiting and len(self._jobs) < at_once:
            name = self._waiting.pop(0)
            self._jobs[name] = subprocess.Popen(
                [sys.executable, "-c", f"from ovmot.warmup.parts import call; call({name!r})"],
                stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
            )  # fmt: skip

    def _end_those_done(self) -> None:
        for name in [name for name, job in self._jobs.items() if job.poll() is not None]:
            job = self._jobs.pop(name)
            _, said = job.communicate()
            if job.returncode:
                last = said.strip().splitlines()[-1] if said.strip() else f"exit {job.returncode}"
                raise OvmotError(f"kernels of the {name} could not be compiled: {last}")

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for job in self._jobs.values():
            if job.poll() is None:  # after an error or Ctrl-C
                job.kill()
                job.communicate()


def _package() -> Path:
    return Path(ovmot.__file__).parent
