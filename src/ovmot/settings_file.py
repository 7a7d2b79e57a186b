"""Settings from a YAML file and `--set`: only what differs from the defaults.

Unknown keys and values of the wrong type are errors that name the file and the key. Keys of version
0.1 that have another name now are accepted with a warning.
"""

import difflib
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from ovmot.errors import InputError, SettingsWarning
from ovmot.settings import Settings, describe_settings
from ovmot.text_files import StrPath, YamlError, parse_yaml, read_yaml

RENAMED = {
    "split": "segmentation",
    "split.pixel_sigma": "noise.pixel_sigma",
    "split.drift_per_flow": "noise.drift_per_flow",
    "objects.pixel_sigma": "noise.pixel_sigma",
    "objects.slide_per_hop_px": "noise.drift_per_frame_px",
    "objects.slide_per_flow": "noise.drift_per_flow",
    "objects.look_back_s": "segmentation.look_back_s",
    "objects.max_range_m": "segmentation.max_range_m",
    "objects.static_false_alarm": "segmentation.false_alarm",
    "objects.depth_weight": "segmentation.depth_weight",
    "calibration.center_sigma_px": "calibration.focal_sigma_px",
    "initialization.rest_pixel": "zero_velocity.pixel",
}
"""Sections and keys of version 0.1, and what they are called now."""

_BY_IMAGE = "it follows from the image's width and tracker.fine_columns"
_PHYSICS = "it is a fact of road users, in ovmot/physics.py"
_FIXED = "its former default is fixed"
REMOVED = {
    "tracker.min_distance_px": _BY_IMAGE,
    "tracker.grid_cell_px": _BY_IMAGE,
    "tracker.focus_distance_px": _BY_IMAGE,
    "tracker.focus_per_cell": _BY_IMAGE,
    "tracker.focus_width_m": _PHYSICS,
    "tracker.klt_near_levels": "it is tracker.klt_levels less 2",
    "filter.min_depth_m": _FIXED,
    "filter.max_depth_m": _FIXED,
    "calibration.distortion_sigma": _FIXED,
    "calibration.imu_matrix_sigma": _FIXED,
    "calibration.g_sensitivity_sigma": _FIXED,
    "imu.fallback": "give the four densities of imu.*",
    "zero_velocity.look_back_s": "it is half a second",
    "zero_velocity.velocity_sigma_mps": "it is a fact of a rig at rest, in ovmot/physics.py",
    "zero_velocity.rotation_sigma_rad": "it is a fact of a rig at rest, in ovmot/physics.py",
    "zero_velocity.position_sigma_m": "it is a fact of a rig at rest, in ovmot/physics.py",
    "objects.noise": "the noise is measured unless noise.pixel_sigma is given",
    "objects.max_points": _FIXED,
    "objects.neighbour_radius_m": _FIXED,
    "object_tracks.merge_frames": _FIXED,
    "objects.points_per_track": _FIXED,
    "objects.body_width_m": _PHYSICS,
    "objects.max_height_m": _PHYSICS,
    "objects.max_speed_sigma_mps": _FIXED,
    "object_tracks.accel": _PHYSICS,
    "object_tracks.lift": _FIXED,
    "object_tracks.yaw_accel": _FIXED,
    "object_tracks.missed_s": _FIXED,
    "object_tracks.place_sigma_m": _FIXED,
    "live.jump_s": _FIXED,
    "live.world_frame": "give all four names as live.frames",
    "live.imu_frame": "give all four names as live.frames",
    "live.left_frame": "give all four names as live.frames",
    "live.right_frame": "give all four names as live.frames",
}
"""Keys of version 0.1 that are no settings any more, and what takes their place."""

SETTINGS_REMEDY = "list them with 'ovmot settings'"


def load_settings(path: StrPath | None = None, overrides: Sequence[str] = ()) -> Settings:
    """Settings from a YAML file (or none) and `section.key=value` overrides, later ones winning.

    Raises `InputError` naming the file or the override, the key, and what is allowed.
    """
    data: dict[str, Any] = {}
    if path is not None:
        loaded = read_yaml_mapping(Path(path))
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
    data = accept_old_keys(data)
    try:
        return Settings.model_validate(data)
    except ValidationError as error:
        sources = ([] if source is None else [source]) + [f"--set {text}" for text in overrides]
        raise InputError(
            f"{', '.join(sources)}: {plain_messages(error, SETTINGS_REMEDY, _known_keys())}"
        ) from None


def _known_keys() -> list[str]:
    """Sections and keys."""
    return [*Settings.model_fields, *(key for key, *_ in describe_settings())]


def dump_settings(settings: Settings, only_changed: bool = False) -> str:
    """Settings as the text of a YAML file that `load_settings` reads back; those of the defaults
    are left out with `only_changed`."""
    sections = settings.model_dump(mode="json", exclude_defaults=only_changed)
    kept = {name: keys for name, keys in sections.items() if keys}
    return yaml.safe_dump(kept, sort_keys=False) if kept else ""


def accept_old_keys(data: dict[str, Any]) -> dict[str, Any]:
    """The sections with the present names of old keys; each old one is warned of, and gives way
    where the new one is there too."""
    out: dict[str, Any] = {}
    old: list[tuple[str, str, Any]] = []
    for section, keys in data.items():
        target = RENAMED.get(section, section)
        if target != section:
            _warn(section, f"is called '{target}' now")
        if not isinstance(keys, dict):
            out[target] = keys
            continue
        kept = out.setdefault(target, {})
        for name, value in keys.items():
            key = f"{section}.{name}"
            if key in REMOVED:
                _warn(key, f"is no setting any more: {REMOVED[key]}")
            elif key in RENAMED:
                _warn(key, f"is called '{RENAMED[key]}' now")
                old.append((*RENAMED[key].split("."), value))
            else:
                kept[name] = value
    for section, name, value in old:
        out.setdefault(section, {}).setdefault(name, value)
    return out


def _warn(key: str, what: str) -> None:
    warnings.warn(f"setting '{key}' {what}", SettingsWarning, stacklevel=5)


def read_yaml_mapping(path: Path) -> dict[str, Any]:
    """The keys of a YAML file, none of an empty one; `InputError` for anything else."""
    loaded = read_yaml(path, InputError)
    if loaded is None:
        return {}
    if not isinstance(loaded, dict):
        raise InputError.at(path, "holds no keys", "write sections of keys")
    return loaded


def _apply_override(data: dict[str, Any], text: str) -> None:
    key, equals, value = text.partition("=")
    section, dot, name = key.strip().partition(".")
    if not (equals and dot and section and name):
        raise InputError(f"--set {text}: write it as section.key=value")
    try:
        parsed = parse_yaml(value)
    except YamlError:
        raise InputError(f"--set {text}: the value is not valid YAML") from None
    keys = data.get(section, {})
    if not isinstance(keys, dict):
        raise InputError(f"--set {text}: '{section}' holds no keys in the settings file")
    data[section] = {**keys, name: parsed}


def plain_messages(error: ValidationError, remedy: str, known: Sequence[str] = ()) -> str:
    """One line for all mistakes: each key, what is wrong, what was given; for an unknown key, the
    nearest one of `known`."""
    lines = []
    for item in error.errors():
        place = ".".join(str(part) for part in item["loc"])
        if item["type"] == "extra_forbidden":
            like = nearest(place, known)
            asked = f"; did you mean '{like}'?" if like else ""
            lines.append(f"unknown key '{place}'{asked} ({remedy})")
        elif item["type"] == "missing":
            lines.append(f"'{place}' is missing")
        else:
            lines.append(f"'{place}': {item['msg']}, got {_short(item.get('input'))}")
    return "; ".join(lines)


def nearest(key: str, known: Sequence[str]) -> str | None:
    """The one of `known` that `key` was most likely meant to be: by its letters, or the only one
    whose last part is the same; None if none is near."""
    if alike := difflib.get_close_matches(key, known, n=1, cutoff=0.75):
        return alike[0]
    last = key.rpartition(".")[2]
    same = [name for name in known if name.rpartition(".")[2] == last]
    return same[0] if len(same) == 1 else None


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
