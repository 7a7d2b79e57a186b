"""A plan of many runs: what `ovmot batch` is asked to do, read from YAML.

sequences:
  mh01:    {data: ../data/euroc_mh01}
  street:  {scene: traffic, size: [1280, 560]}
  walk:    {features: ../data/udel_gore.txt}
settings:
  default: {}
  no_segmentation: {segmentation.enabled: false}
seeds: 10
"""

import re
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, ValidationError, field_validator, model_validator

from ovmot.errors import InputError
from ovmot.settings import Section, Settings
from ovmot.settings_file import SETTINGS_REMEDY, accept_old_keys, plain_messages, read_yaml_mapping
from ovmot.sim.miscalibration import Miscalibration

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")
_RESERVED = ("data",)
_MOST_SEEDS = 100_000


class Recorded(Section):
    """A recorded sequence; seeds do not apply to it."""

    data: Path
    """Folder of the sequence."""
    truth: Path | None = None
    """Its truth, where that is not in the folder: a TUM file."""


class Rendered(Section):
    """A sequence rendered anew for each seed; see `ovmot simulate`."""

    scene: str
    """A scene of the catalog, or a YAML file."""
    path: str | None = None
    """The rig's path: stand, walk, drive or a TUM file; else the scene's own."""
    size: tuple[int, int] | None = None
    """Width and height of the images."""
    rate_hz: float | None = Field(None, gt=0.0)
    """Stereo frames a second."""
    duration_s: float | None = Field(None, gt=0.0)
    """Length of the sequence."""
    format: Literal["kaist", "asl"] = "kaist"
    """Layout that it is written in."""


class Features(Section):
    """A feature-level simulation along a recorded path, drawn anew for each seed."""

    features: Path
    """TUM file of IMU poses."""
    stereo: bool = True
    """Whether the right camera sees anything."""
    n_features: int = Field(250, ge=10)
    """Features that a camera sees."""
    pixel_sigma: float = Field(1.0, ge=0.0)
    """Noise of each coordinate, pixels."""
    depth_m: tuple[float, float] = (5.0, 7.0)
    """Range of depths at which points are made."""
    wrong_match_share: float = Field(0.0, ge=0.0, le=1.0)
    """Share of the stereo matches that are wrong."""
    start_s: float = Field(0.0, ge=0.0)
    """Where in the recording to begin."""
    duration_s: float | None = Field(None, gt=0.0)
    """How long; else to its end."""
    max_gap_s: float = Field(0.5, gt=0.0)
    """Holes in the recording up to this long are bridged."""
    calibration_error: Miscalibration | None = None
    """How far the calibration is off that the filter is given; drawn for each seed."""

    @model_validator(mode="after")
    def _depths_rise(self) -> "Features":
        if not 0.1 < self.depth_m[0] < self.depth_m[1]:
            raise ValueError("depth_m must be two depths over 0.1 m, the smaller one first")
        return self


def _kind_of(value: Any) -> str | None:
    """Which of the three keys an entry has; None where it has none or several."""
    given = value if isinstance(value, dict) else dict(value) if isinstance(value, Section) else {}
    present = [key for key in ("data", "scene", "features") if key in given]
    return present[0] if len(present) == 1 else None


Sequence = Recorded | Rendered | Features
_Sequence = Annotated[
    Annotated[Recorded, Tag("data")]
    | Annotated[Rendered, Tag("scene")]
    | Annotated[Features, Tag("features")],
    Discriminator(
        _kind_of,
        custom_error_type="kind",
        custom_error_message="give exactly one of the keys data, scene and features",
    ),
]


class Plan(Section):
    """Everything that a batch is asked to do."""

    sequences: dict[str, _Sequence] = Field(min_length=1)
    """What to run on, by name."""
    settings: dict[str, dict[str, Any]] = Field(default={"default": {}}, min_length=1)
    """Settings that differ from the defaults, by name; keys dotted or nested."""
    seeds: int | tuple[int, ...] = 1
    """A number of seeds, from 0 on, or a list of them."""
    metrics: tuple[str, ...] | None = None
    """Which metrics the table shows; else a usual choice."""
    keep_data: bool = False
    """Keep rendered sequences when their runs are done."""

    @field_validator("sequences", "settings")
    @classmethod
    def _plain_names(cls, value: dict[str, Any]) -> dict[str, Any]:
        for name in value:
            if not _NAME.fullmatch(name) or name in _RESERVED:
                raise ValueError(f"'{name}' can not be the name of a folder here")
        return value

    @field_validator("seeds")
    @classmethod
    def _good_seeds(cls, value: int | tuple[int, ...]) -> int | tuple[int, ...]:
        if (value if isinstance(value, int) else len(value)) > _MOST_SEEDS:
            raise ValueError(f"at most {_MOST_SEEDS} seeds")
        listed = (value - 1,) if isinstance(value, int) else value
        if not listed or min(listed) < 0 or len(set(listed)) != len(listed):
            raise ValueError("a number from 1 on, or a list of different seeds from 0 on")
        return value

    @property
    def seed_list(self) -> tuple[int, ...]:
        """The seeds one by one."""
        return tuple(range(self.seeds)) if isinstance(self.seeds, int) else self.seeds

    def settings_of(self, name: str) -> Settings:
        """The settings of that name, whole."""
        return Settings.model_validate(accept_old_keys(nested(self.settings[name])))


def read_plan(path: Path) -> Plan:
    """A plan from a YAML file; relative paths in it start at the file's folder.

    Raises `InputError` naming the file, the key and what is allowed.
    """
    try:
        plan = Plan.model_validate(read_yaml_mapping(path))
    except ValidationError as error:
        problems = plain_messages(error, "see docs/batch.md for what a plan holds")
        raise InputError(f"{path}: {problems}") from None
    for name in plan.settings:
        try:
            plan.settings_of(name)
        except ValidationError as error:
            problems = plain_messages(error, SETTINGS_REMEDY)
            raise InputError(f"{path}: settings {name}: {problems}") from None
    folder = path.resolve().parent
    located = {name: _located(entry, folder) for name, entry in plan.sequences.items()}
    return plan.model_copy(update={"sequences": located})


def nested(flat: dict[str, Any]) -> dict[str, Any]:
    """Settings with dotted keys taken apart: {"a.b": 1} becomes {"a": {"b": 1}}."""
    out: dict[str, Any] = {}
    for key, value in flat.items():
        section, dot, name = key.partition(".")
        if dot:
            out[section] = {**out.get(section, {}), name: value}
        else:
            out[section] = {**out.get(section, {}), **value} if isinstance(value, dict) else value
    return out


def _located(entry: Sequence, folder: Path) -> Sequence:
    """The entry with its paths absolute."""
    if isinstance(entry, Recorded):
        truth = None if entry.truth is None else folder / entry.truth
        return entry.model_copy(update={"data": folder / entry.data, "truth": truth})
    if isinstance(entry, Features):
        return entry.model_copy(update={"features": folder / entry.features})
    updates = {}
    if entry.scene.endswith((".yaml", ".yml")):
        updates["scene"] = str(folder / entry.scene)
    if entry.path is not None and (folder / entry.path).is_file():
        updates["path"] = str(folder / entry.path)
    return entry.model_copy(update=updates)
