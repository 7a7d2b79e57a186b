"""Settings from a YAML file and `--set`: only what differs from the defaults.

Unknown keys and values of the wrong type are errors that name the file and the key.
"""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from ovmot.config import Settings
from ovmot.errors import InputError, yaml_problem

SETTINGS_REMEDY = "list them with 'ovmot settings'"


def load_settings(path: Path | None, overrides: Sequence[str] = ()) -> Settings:
    """Settings from a YAML file (or none) and `section.key=value` overrides, later ones winning.

    Raises `InputError` naming the file or the override, the key, and what is allowed.
    """
    data: dict[str, Any] = {}
    if path is not None:
        loaded = read_yaml_mapping(path)
        # a section whose keys are all commented out
        data = {key: {} if value is None else value for key, value in loaded.items()}
    return make_settings(data, overrides, None if path is None else str(path))


def make_settings(
    sections: dict[str, Any], overrides: Sequence[str], source: str | None
) -> Settings:
    """Settings of sections of keys, and `overrides`; errors as `load_settings`, naming `source`."""
    data = dict(sections)
    for text in overrides:
        _apply_override(data, text)
    try:
        return Settings.model_validate(data)
    except ValidationError as error:
        sources = ([] if source is None else [source]) + [f"--set {text}" for text in overrides]
        raise InputError(
            f"{', '.join(sources)}: {plain_messages(error, SETTINGS_REMEDY)}"
        ) from None


class UniqueKeyLoader(yaml.SafeLoader):
    """YAML's safe loader, but a key given twice is an error: else the first is lost silently."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue  # refused below
            if key.value in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"found '{key.value}' twice", key.start_mark
                )
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def read_yaml_mapping(path: Path) -> dict[str, Any]:
    """The keys of a YAML file, read safely; none of an empty file. OpenCV's header is let pass.

    Raises `InputError` for a file that can not be read, is no YAML, or holds something else.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
        text = re.sub(r"\A\s*%YAML:[^\n]*", "", text)  # no directive of YAML
        loaded = yaml.load(text, UniqueKeyLoader)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot read the file: {error}") from None
    except yaml.YAMLError as error:
        problem, row = yaml_problem(error)
        raise InputError.at(path, problem, row=row) from None
    if loaded is None:
        return {}
    if not isinstance(loaded, dict):
        raise InputError(f"{path}: expected sections of keys, found {loaded!r}")
    return loaded


def _apply_override(data: dict[str, Any], text: str) -> None:
    key, equals, value = text.partition("=")
    section, dot, name = key.strip().partition(".")
    if not (equals and dot and section and name):
        raise InputError(f"--set {text}: write it as section.key=value")
    try:
        parsed = yaml.safe_load(value)
    except yaml.YAMLError:
        raise InputError(f"--set {text}: the value is not valid YAML") from None
    keys = data.get(section, {})
    if not isinstance(keys, dict):
        raise InputError(f"--set {text}: '{section}' holds no keys in the settings file")
    data[section] = {**keys, name: parsed}


def plain_messages(error: ValidationError, remedy: str) -> str:
    """One line for all mistakes: each key, what is wrong, what was given."""
    lines = []
    for item in error.errors():
        place = ".".join(str(part) for part in item["loc"])
        if item["type"] == "extra_forbidden":
            lines.append(f"unknown key '{place}' ({remedy})")
        elif item["type"] == "missing":
            lines.append(f"'{place}' is missing")
        else:
            lines.append(f"'{place}': {item['msg']}, got {item.get('input')!r}")
    return "; ".join(lines)
