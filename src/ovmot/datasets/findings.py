"""What a reader notices while it reads: warnings for the user and counts for `run.json`.

The notes and refusals that several readers share stand here too."""

from dataclasses import dataclass, field
from pathlib import Path

from ovmot.errors import InputError


@dataclass(slots=True)
class Findings:
    """Collects counted warnings; a count of 0 leaves no trace."""

    warnings: list[str] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)

    def note(self, key: str, count: int, text: str) -> None:
        """Add `count` under `key`, and its sentence, if there is anything to say."""
        if count:
            self.warnings.append(text)
            self.counts[key] = self.counts.get(key, 0) + count


def note_no_imu(path: Path, findings: Findings) -> None:
    """Note that the IMU's file is missing."""
    findings.note("no_imu", 1, f"{path}: no IMU file; the ego motion must come from poses")


def note_no_imu_noise(path: Path, findings: Findings) -> None:
    """Note that the file with the IMU's noise is missing."""
    findings.note("no_imu_noise", 1, f"{path}: missing; the IMU noise of the settings is used")


def refuse_choice(root: Path, sequence: str | None) -> None:
    """Raise `InputError` where `--sequence` is given for a folder of one sequence."""
    if sequence is not None:
        raise InputError.at(root, "holds one sequence", f"leave out '--sequence {sequence}'")
