"""What a reader noticed: counted warnings."""

from pathlib import Path

import pytest

from ovmot.datasets.findings import Findings, note_no_imu, note_no_imu_noise, refuse_choice
from ovmot.errors import InputError


def test_nothing_noticed_leaves_no_trace() -> None:
    findings = Findings()
    findings.note("gaps", 0, "no gaps")
    assert (findings.warnings, findings.counts) == ([], {})


def test_counts_of_one_key_are_added_up() -> None:
    findings = Findings()
    findings.note("gaps", 2, "two gaps")
    findings.note("gaps", 3, "three more")
    note_no_imu(Path("imu.csv"), findings)
    note_no_imu_noise(Path("imu.yaml"), findings)
    assert findings.counts == {"gaps": 5, "no_imu": 1, "no_imu_noise": 1}
    assert len(findings.warnings) == 4
    assert findings.warnings[2].startswith("imu.csv: no IMU file")


def test_a_choice_is_refused_where_there_is_none() -> None:
    refuse_choice(Path("folder"), None)
    with pytest.raises(InputError, match="folder"):
        refuse_choice(Path("folder"), "00")
