"""What the doctor found, as values, as a table, and as JSON."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

from rich.table import Column, Table
from rich.text import Text

from ovmot.errors import InputError


class Severity(StrEnum):
    """How serious a finding is; `unknown` where the data does not allow the check."""

    WRONG = "wrong"
    DOUBTFUL = "doubtful"
    FINE = "fine"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Finding:
    """The outcome of one check: a sentence with its numbers, and what to do (empty if nothing).

    `fix`: settings by `section.key` that make it good, where the check is sure of them.
    """

    check: str
    severity: Severity
    says: str
    remedy: str = ""
    fix: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Report:
    """All findings about one sequence, worst first."""

    name: str
    kind: str
    findings: tuple[Finding, ...]

    @property
    def is_wrong(self) -> bool:
        """Whether anything is `wrong`."""
        return any(f.severity is Severity.WRONG for f in self.findings)


def make_report(name: str, kind: str, findings: Iterable[Finding]) -> Report:
    """The findings in order of severity, those of one severity in the order they came."""
    order = list(Severity)
    worst_first = sorted(findings, key=lambda f: order.index(f.severity))
    return Report(name, kind, tuple(worst_first))


_STYLES = {
    Severity.WRONG: "bold red",
    Severity.DOUBTFUL: "yellow",
    Severity.FINE: "green",
    Severity.UNKNOWN: "dim",
}


def report_table(report: Report) -> Table:
    """The report for a reader's eyes."""
    table = Table(
        Column(""), Column("check", no_wrap=True), Column("finding", overflow="fold"),
        title=Text(f"{report.name} ({report.kind})"),
    )  # fmt: skip
    for f in report.findings:
        text = f"{f.says}: {f.remedy}" if f.remedy else f.says
        table.add_row(Text(f.severity, _STYLES[f.severity]), f.check, Text(text))
    return table


def write_report(path: Path, report: Report) -> None:
    """The report as JSON; raises `InputError` where the file can not be written."""
    text = json.dumps(asdict(report), indent=2, ensure_ascii=False) + "\n"
    try:
        # a name need not be UTF-8; what it is written as then is JSON's own escape
        path.write_text(text, encoding="utf-8", errors="backslashreplace")
    except OSError as error:
        raise InputError.at(path, f"cannot be written: {error.strerror}") from None
