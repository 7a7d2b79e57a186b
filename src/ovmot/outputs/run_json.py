"""`run.json`: the inputs of a run, its counts, and how it ended."""

import contextlib
import functools
import json
import os
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import scipy

import ovmot
from ovmot.errors import OvmotError
from ovmot.settings import Settings
from ovmot.types import ImuNoise

RUN_JSON = "run.json"
PARTIAL_RUN_JSON = "run.json.part"
RUNNING = "running"
"""What `ended` says until the run has ended; where nothing runs any more, it was killed."""
_RESERVED_BYTES = 65_536  # several times what run.json needs


@dataclass(frozen=True, slots=True)
class InputIdentity:
    """The sequence that was read: where, of which kind, how much, from when to when (ns)."""

    path: str
    kind: str
    n_frames: int
    n_imu_samples: int
    first_timestamp_ns: int | None
    last_timestamp_ns: int | None


@dataclass(frozen=True, slots=True)
class RunSummary:
    """A run in numbers.

    `options` is what it was asked beside the settings. `preset` are the values of the data's preset
    that are in force, by `section.key`, under `preset_name`. `imu_noise` is what the filter used,
    from the settings, the data or the fallback.
    `counts` by name (frames_in, frames_written, imu_samples, resets, frames_dropped, ...);
    `not_started_because`: the last reason for which the ego motion could not start at a frame, None
    where it always could. `warnings` says how often each was given; `ended` is `finished`,
    `interrupted`, `failed: <message>` or, until then, `running`; `wall_seconds` is how long it has
    taken.
    """

    settings: Settings
    options: Mapping[str, str | int | None]
    imu_noise: ImuNoise | None
    source: InputIdentity
    counts: Mapping[str, int]
    warnings: Mapping[str, int]
    not_started_because: str | None
    ended: str
    wall_seconds: float
    preset_name: str | None = None
    preset: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        endings = ("finished", "interrupted", RUNNING)
        if self.ended not in endings and not self.ended.startswith("failed: "):
            raise ValueError(f"not a way for a run to end: {self.ended!r}")


def write_run_json(folder: Path, summary: RunSummary) -> None:
    """Write `run.json` into `folder` in one move: it is there whole, or as it was before.

    What it needs on the disk may have been reserved before (`reserve_run_json`). Raises
    `OvmotError` with the file's name where it cannot be written.
    """
    path, partial = folder / RUN_JSON, folder / PARTIAL_RUN_JSON
    text = json.dumps(_as_json(summary), indent=2, allow_nan=False, ensure_ascii=False) + "\n"
    # a path need not be UTF-8; what it is written as then is JSON's own escape
    data = text.encode("utf-8", errors="backslashreplace")
    try:
        with partial.open("r+b" if partial.exists() else "wb") as file:
            file.write(data)
            file.truncate()
        partial.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        raise OvmotError(f"{path}: cannot be written: {error.strerror}") from None


def reserve_run_json(folder: Path) -> bool:
    """Take the room on the disk that the next `write_run_json` needs: True where it is there.

    So `run.json` can tell how a run ended also when the disk is full.
    """
    partial = folder / PARTIAL_RUN_JSON
    if partial.exists():
        return True
    try:
        with partial.open("xb") as file:
            os.posix_fallocate(file.fileno(), 0, _RESERVED_BYTES)
    except OSError:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        return False
    return True


@functools.cache
def versions() -> dict[str, str]:
    """Versions of ovmot and of all that its numbers depend on."""
    return {
        "ovmot": ovmot.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "opencv": cv2.__version__,
        "av": av.__version__,
        "platform": platform.platform(),
    }


def _as_json(summary: RunSummary) -> dict[str, Any]:
    return {
        "ended": summary.ended,
        "input": asdict(summary.source),
        "counts": {name: int(count) for name, count in summary.counts.items()},
        "warnings": [
            {"message": message, "count": int(count)} for message, count in summary.warnings.items()
        ],
        "not_started_because": summary.not_started_because,
        "options": dict(summary.options),
        "preset": None
        if summary.preset_name is None
        else {"name": summary.preset_name, "values": dict(summary.preset)},
        "settings": summary.settings.model_dump(mode="json"),
        "imu_noise": None if summary.imu_noise is None else asdict(summary.imu_noise),
        "versions": versions(),
        "wall_seconds": round(float(summary.wall_seconds), 3),
    }
