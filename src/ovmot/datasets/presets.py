"""Presets: the settings that a kind of data wants, in `preset.yaml` of its folder."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ovmot.settings import Settings
from ovmot.settings_file import make_settings, read_yaml_mapping

Sections = Mapping[str, Mapping[str, Any]]
"""Settings by section and key."""

_NOISE = ("gyro_noise", "gyro_walk", "accel_noise", "accel_walk")


def always(root: Path, sequence: str | None) -> bool:
    """The condition of a preset for all folders of its kind."""
    return True


@dataclass(frozen=True, slots=True)
class Preset:
    """Settings that differ from the defaults for one kind of data; what the user gives overrules.

    `name` is the format's. `serves` says whether a folder of that format, and the sequence chosen
    in it, wants the preset.
    """

    name: str
    sections: Sections
    serves: Callable[[Path, str | None], bool] = always

    @property
    def values(self) -> dict[str, Any]:
        """The same, flat: `section.key` -> value."""
        return {
            f"{section}.{key}": value
            for section, keys in self.sections.items()
            for key, value in keys.items()
        }

    def in_force(self, settings: Settings) -> dict[str, Any]:
        """Those of `values` that `settings` have: nothing has overruled them."""
        used = settings.model_dump()
        return {
            f"{section}.{key}": value
            for section, keys in self.sections.items()
            for key, value in keys.items()
            if used[section][key] == value
        }

    def under(self, given: Settings) -> Settings:
        """`given` with the preset's values for all that was not given: left at its default."""
        merged = {name: dict(keys) for name, keys in self.sections.items()}
        for name, keys in given.model_dump(exclude_unset=True).items():
            merged[name] = merged.get(name, {}) | keys
        return make_settings(merged, (), f"preset {self.name}")

    def without_noise(self) -> "Preset":
        """The same without the IMU's noise, for data whose calibration says it."""
        sections = {
            name: {key: v for key, v in keys.items() if name != "imu" or key not in _NOISE}
            for name, keys in self.sections.items()
        }
        return replace(self, sections={name: keys for name, keys in sections.items() if keys})


def shipped_preset(
    name: str, folder: str, serves: Callable[[Path, str | None], bool] = always
) -> Preset:
    """The preset in `folder` beside this file."""
    return Preset(name, read_yaml_mapping(Path(__file__).parent / folder / "preset.yaml"), serves)


def given_max_gap_s(settings: Settings) -> float | None:
    """The setting `imu.max_gap_s` where it was given, None where it is the default."""
    given = "max_gap_s" in settings.imu.model_fields_set
    return settings.imu.max_gap_s if given else None
