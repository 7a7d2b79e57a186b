"""Open what the commands that read a recorded sequence are given, all in the same way."""

import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import ovmot
from ovmot import RecordedSequence, RunConfig
from ovmot.cli.console import NOTHING_WRITTEN, interruptible


def open_recorded(
    data: Path,
    format: str | None,
    sequence: str | None,
    calibration: Path | None,
    topics: ovmot.BagTopics,
    config: Path | None,
    overrides: Sequence[str],
    *,
    need_imu_pose: bool = True,
    need_pairs: bool = True,
) -> tuple[RunConfig, RecordedSequence]:
    """What `--config` and `--set` say, and the sequence as they have it, with the warnings of both.

    A calibration of its own stands in place of that of the settings file. Raises `InputError`.
    """
    given = ovmot.load_run_config(
        config, overrides, topics.left, topics.right, need_imu_pose=need_imu_pose
    )
    with interruptible(NOTHING_WRITTEN):
        recorded = ovmot.open(
            data,
            format,
            sequence,
            calibration or given.calibration,
            given.imu_max_gap_s,
            topics,
            given.settings.recording.pair_tolerance_s,
            need_imu_pose,
            need_pairs,
        )
    recorded = recorded.without_mended_warnings(given.settings.recording)
    return given, replace(recorded, warnings=(*given.warnings, *recorded.warnings))


def repeated_options(**given: str | Path | None) -> str:
    """The options that were given, by their names, as another command takes them."""
    return " ".join(f"--{name} {shlex.quote(str(v))}" for name, v in given.items() if v is not None)
