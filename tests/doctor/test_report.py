"""The report: the worst first, and as JSON."""

import json
from pathlib import Path

import pytest
from rich.console import Console

from ovmot.doctor.report import Finding, Severity, make_report, report_table, write_report
from ovmot.errors import InputError

REPORT = make_report(
    "urban",
    "kaist",
    [
        Finding("a", Severity.FINE, "good"),
        Finding("b", Severity.WRONG, "see [left]/data", "swap them"),
        Finding("c", Severity.DOUBTFUL, "odd"),
    ],
)


def test_the_worst_comes_first() -> None:
    assert [f.check for f in REPORT.findings] == ["b", "c", "a"]
    assert REPORT.is_wrong
    assert not make_report("urban", "kaist", REPORT.findings[1:]).is_wrong


def test_brackets_are_text(capsys: pytest.CaptureFixture[str]) -> None:
    Console(width=100).print(report_table(REPORT))
    assert "see [left]/data: swap them" in capsys.readouterr().out


def test_json(tmp_path: Path) -> None:
    path = tmp_path / "found.json"
    write_report(path, REPORT)
    first = json.loads(path.read_text())["findings"][0]
    assert first == {
        "check": "b", "severity": "wrong", "says": "see [left]/data", "remedy": "swap them",
        "fix": {},
    }  # fmt: skip
    with pytest.raises(InputError, match="nowhere"):
        write_report(tmp_path / "nowhere" / "found.json", REPORT)


def test_a_name_that_is_no_text_comes_back(tmp_path: Path) -> None:
    strange = "urban\udcff"  # a byte of a name that is not UTF-8, as Python holds it
    write_report(tmp_path / "found.json", make_report(strange, "kaist", []))
    assert json.loads((tmp_path / "found.json").read_text())["name"] == strange
