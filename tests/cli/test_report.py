"""`ovmot report`, and the page at the end of a run, which never fails the run."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
import typer
from run_folders import write_run, write_truth

import ovmot
from ovmot.cameras.rig import StereoRig
from ovmot.cli.progress import Style
from ovmot.cli.report import report_of_run

Command = Callable[..., SimpleNamespace]


def test_a_report_of_one_run_and_of_two(
    ovmot_command: Command, tmp_path: Path, painted_rig: StereoRig
) -> None:
    a, b = (write_run(tmp_path / name, painted_rig, 12) for name in "ab")
    truth = write_truth(tmp_path / "truth.tum", 12)
    outcome = ovmot_command("report", a, "--truth", truth)
    assert outcome.code == 0
    assert str(a / "report.html") in outcome.out
    assert "ATE" in (a / "report.html").read_text(encoding="utf-8")
    page = tmp_path / "both.html"
    assert ovmot_command("report", a, b, "-o", page).code == 0
    assert page.stat().st_size > 100_000


def test_what_is_no_run_is_one_line_and_exit_code_2(ovmot_command: Command, tmp_path: Path) -> None:
    outcome = ovmot_command("report", tmp_path)
    assert outcome.code == 2
    assert "is not a run" in outcome.complaint


def test_a_page_that_fails_is_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object) -> Path:
        raise ValueError("anything at all")

    monkeypatch.setattr(ovmot, "write_report", fail)
    report_of_run(tmp_path, Style.BAR)
    captured = capsys.readouterr()
    assert captured.err.splitlines() == ["ovmot: warning: no report.html: anything at all"]


def test_ctrl_c_during_the_page_says_how_to_make_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*_: object) -> Path:
        raise KeyboardInterrupt

    monkeypatch.setattr(ovmot, "write_report", interrupt)
    with pytest.raises(typer.Exit) as ended:
        report_of_run(tmp_path, Style.BAR)
    assert ended.value.exit_code == 130
    assert f"ovmot report {tmp_path}" in capsys.readouterr().err


@pytest.mark.parametrize("wanted", [True, False])
def test_a_run_ends_with_its_page(
    ovmot_command: Command, painted_euroc: Path, tmp_path: Path, wanted: bool
) -> None:
    out = tmp_path / "out"
    options = ("--set", "tracker.max_features=80", *(() if wanted else ("--no-report",)))
    outcome = ovmot_command("run", painted_euroc, "-o", out, "--threads", 1, *options)
    assert outcome.code == 0, outcome.err
    assert (out / "report.html").exists() == wanted
    assert (out / "preview.npz").exists() == wanted
    assert ("report.html" in outcome.out) == wanted
