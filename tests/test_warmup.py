"""Warm-up: each part runs, and a failure of one is said in one line."""

import pytest

from ovmot import warmup
from ovmot.errors import OvmotError


@pytest.mark.parametrize("part", warmup.PARTS)
def test_a_part_calls_its_kernels(part: str) -> None:
    warmup.PARTS[part]()


def test_processes_do_the_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(warmup, "PROCESSES", (("front end",),))
    warmup.warm_up()


def test_the_processes_call_every_part() -> None:
    assert sorted(sum(warmup.PROCESSES, ())) == sorted(warmup.PARTS)


def test_a_failure_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(warmup, "PROCESSES", (("none", "objects"),))
    with pytest.raises(
        OvmotError, match="kernels of the none and objects could not be compiled: KeyError"
    ):
        warmup.warm_up()
