"""Another program and `ovmot run` in turn on the same sequence, each as a whole process."""

import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import ovmot

_UNIT = 1 if sys.platform == "darwin" else 1024  # of ru_maxrss, man getrusage


@dataclass(frozen=True, slots=True)
class ProcessTimes:
    """Seconds of wall and CPU time of a process and its children, and its peak memory, bytes."""

    wall_s: float
    cpu_s: float
    peak_bytes: int


def in_turn(folder: Path, command: str, runs: int) -> tuple[list[ProcessTimes], list[ProcessTimes]]:
    """`ovmot run` on a sequence, and the other program, `runs` times each, after one run of
    `ovmot` that is not counted.

    In `command`, `{sequence}` is the folder of the sequence and `{out}` an empty folder. Raises
    `OvmotError` where one of them fails.
    """
    ours = [sys.executable, "-m", "ovmot", "run", "{sequence}", "-o", "{out}", "--force"]
    theirs = shlex.split(command)
    timed_process(ours, folder)
    found: tuple[list[ProcessTimes], list[ProcessTimes]] = ([], [])
    for _ in range(runs):
        for times, words in zip(found, (ours, theirs), strict=True):
            times.append(timed_process(words, folder))
    return found


def timed_process(words: Sequence[str], folder: Path) -> ProcessTimes:
    """Run one program to its end; what it prints is dropped.

    Raises `OvmotError` where it cannot be started or ends with an error.
    """
    with tempfile.TemporaryDirectory(prefix="bench") as out:
        places = {"{sequence}": str(folder), "{out}": out}
        for key, place in places.items():
            words = [word.replace(key, place) for word in words]
        begin = time.perf_counter()
        try:
            process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        except OSError as error:
            raise ovmot.InputError(f"--against {words[0]}: {error.strerror}") from None
        _, status, used = os.wait4(process.pid, 0)
        wall_s = time.perf_counter() - begin
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise ovmot.OvmotError(f"{shlex.join(words)}: ended with code {process.returncode}")
    return ProcessTimes(wall_s, used.ru_utime + used.ru_stime, _UNIT * used.ru_maxrss)
