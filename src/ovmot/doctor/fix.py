"""The settings that make good what the doctor is sure of."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from ovmot.doctor.report import Report
from ovmot.errors import InputError
from ovmot.settings import Settings

_SCALES = ("recording.gyro_scale", "recording.accel_scale")
_EXCHANGE = "recording.exchange_cameras"


def fixed_settings(report: Report, given: Settings) -> dict[str, dict[str, Any]] | None:
    """Sections and keys of the settings `given`, with what mends the findings; None if nothing
    does.

    A scale that is given is multiplied, cameras that are exchanged already are exchanged back.
    """
    fix = {key: value for f in report.findings for key, value in f.fix.items()}
    if not fix:
        return None
    fix = fix_over(fix, given)
    sections: dict[str, dict[str, Any]] = given.model_dump(mode="json", exclude_unset=True)
    for key, value in fix.items():
        section, _, name = key.partition(".")
        sections.setdefault(section, {})[name] = value
    return sections


def fix_over(fix: Mapping[str, Any], given: Settings) -> dict[str, Any]:
    """The settings `fix`, found in a recording that the settings `given` have corrected before."""
    over = dict(fix)
    for key in _SCALES:
        if key in over:
            over[key] *= getattr(given.recording, key.partition(".")[2])
    if _EXCHANGE in over:
        over[_EXCHANGE] = not given.recording.exchange_cameras
    return over


def set_options(fix: Mapping[str, float | bool]) -> str:
    """Settings as the options of a command that set them."""
    return " ".join(f"--set {key}={_written(value)}" for key, value in fix.items())


def _written(value: float | bool) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value:.6g}"


def write_settings(path: Path, sections: Mapping[str, Mapping[str, Any]]) -> None:
    """A settings file; raises `InputError` where there is one, or it can not be written."""
    text = yaml.safe_dump({k: dict(v) for k, v in sections.items()}, sort_keys=False)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise InputError.at(path, "is there already", "give another name") from None
    except OSError as error:
        raise InputError.at(path, f"cannot be written: {error.strerror}") from None
