"""The node's private parameters: settings that a launch file gives."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ovmot.errors import InputError
from ovmot.settings_file import SETTINGS_REMEDY

_FILES = ("config", "calibration")


@dataclass(frozen=True, slots=True)
class NodeParameters:
    """Files, each None where not given, and settings as `section.key=value`."""

    config: Path | None
    calibration: Path | None
    overrides: tuple[str, ...]


def read_parameters(private: Mapping[str, Any]) -> NodeParameters:
    """The parameters below the node's name: `config`, `calibration` and `section/key`.

    An empty text is a parameter that a launch file leaves open. Raises `InputError` for a
    parameter that is neither.
    """
    overrides = []
    for name, value in private.items():
        if name in _FILES:
            continue
        if not isinstance(value, Mapping):
            raise InputError(
                f"parameter ~{name}: unknown; they are ~{', ~'.join(_FILES)} and ~section/key of "
                f"the settings ({SETTINGS_REMEDY})"
            )
        for key, setting in value.items():
            if setting != "":
                overrides.append(f"{name}.{key}={json.dumps(setting)}")  # YAML holds JSON
    config, calibration = (_file(private.get(name)) for name in _FILES)
    return NodeParameters(config, calibration, tuple(overrides))


def _file(value: Any) -> Path | None:
    return Path(str(value)).expanduser() if value else None
