"""Warm-up: each part runs, a failure of one is said in one line, and the end is noted."""

from pathlib import Path

import pytest

from ovmot.errors import OvmotError
from ovmot.warmup import parts, processes


@pytest.mark.parametrize("part", parts.PARTS)
def test_a_part_calls_its_kernels(part: str) -> None:
    parts.PARTS[part]()


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
