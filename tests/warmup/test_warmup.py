"""Warm-up: each part runs, a failure of one is said in one line, and the end is noted."""

import importlib
from pathlib import Path

import pytest
from numba.core.dispatcher import Dispatcher

import ovmot
from ovmot.errors import OvmotError
from ovmot.warmup import parts, processes


def test_the_parts_call_every_kernel() -> None:
    """Else one would be compiled in the middle of somebody's first run."""
    for call in parts.PARTS.values():
        call()
    package = Path(ovmot.__file__).parent
    for source in package.rglob("*_kernel.py"):
        name = ".".join(source.relative_to(package.parent).with_suffix("").parts)
        kernels = vars(importlib.import_module(name)).items()
        dispatchers = {key: value for key, value in kernels if isinstance(value, Dispatcher)}
        kept = {
            key: value
            for key, value in dispatchers.items()
            if hasattr(vars(value)["_cache"], "kept")
        }
        assert [key for key, value in kept.items() if not value.signatures] == [], name


def test_processes_do_the_parts_and_leave_a_stamp(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """With no process at all, so that it is quick."""
    monkeypatch.setattr(processes, "NAMES", ())
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    told: list[tuple[int, int]] = []
    assert processes.needs_warm_up()
    with processes.WarmUp() as work:
        work.wait(lambda done, total: told.append((done, total)))
    assert not processes.needs_warm_up()
    (stamp,) = (tmp_path / "ovmot").glob("warm-*")
    stamp.unlink()
    assert processes.needs_warm_up()


def test_nothing_is_compiled_ahead_that_cannot_be_kept(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    assert not processes.needs_warm_up()


def test_processes_do_the_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "NAMES", ("front end",))
    processes.warm_up()


def test_the_processes_call_every_part() -> None:
    assert tuple(parts.PARTS) == processes.NAMES


def test_a_failure_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "NAMES", ("front end", "none"))
    message = "kernels of the none could not be compiled: KeyError"
    with pytest.raises(OvmotError, match=message):
        processes.warm_up()
