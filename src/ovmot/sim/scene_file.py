"""Scenes as data: road, street, traffic, light and sensors, declared in YAML files.

`load_scene` reads a scene of the catalog by its name, or a file. Lengths are in metres along the
road (`at_m`, `start_m`) and to the left of its middle (`offset_m`), times in seconds since the
first frame, and knots are pairs [place, value] with smooth steps between them (`SmoothSteps`).
"""

from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, get_args

from pydantic import AfterValidator, Field, ValidationError

from ovmot.errors import InputError
from ovmot.settings import Section
from ovmot.settings_file import plain_messages, read_yaml_mapping

CATALOG = Path(str(resources.files("ovmot.sim") / "catalog"))
SCENES: tuple[str, ...] = (
    "demo", "traffic", "crossing", "jam", "pullout", "queue", "abreast", "trailer", "arm_in_arm",
    "bus", "cyclists", "empty", "night", "fisheye",
)  # fmt: skip
MAX_DURATION_S = 600.0
RigName = Literal["street", "fisheye"]
Kind = Literal["car", "van", "truck", "bus", "car_trailer", "walker", "cyclist"]
RIGS: tuple[str, ...] = get_args(RigName)
_MOST_MOVERS = 255  # an object id is one byte of the truth images
Knots = tuple[tuple[float, float], ...]


def _rising(knots: Knots) -> Knots:
    places = [place for place, _ in knots]
    if not knots or any(b <= a for a, b in pairwise(places)):
        raise ValueError("the first numbers of the knots must rise")
    return knots


def _forward(knots: Knots) -> Knots:
    if any(not 0.0 <= speed <= 40.0 for _, speed in knots):
        raise ValueError("speeds are from 0 to 40 m/s")
    return knots


def _gentle(knots: Knots) -> Knots:
    if any(abs(curvature) > 0.2 for _, curvature in knots):
        raise ValueError("curvatures are from -0.2 to 0.2 1/m")
    return knots


def _ordered(stretch: tuple[float, float]) -> tuple[float, float]:
    if not stretch[0] < stretch[1]:
        raise ValueError("a stretch goes from its smaller to its greater end")
    return stretch


Speed = Annotated[Knots, AfterValidator(_rising), AfterValidator(_forward)]
Curvature = Annotated[Knots, AfterValidator(_rising), AfterValidator(_gentle)]
Stretch = Annotated[tuple[float, float], AfterValidator(_ordered)]
Grey = Annotated[float, Field(ge=0.0, le=255.0)]
Length = Annotated[float, Field(ge=0.2, le=30.0)]
Size = tuple[Length, Length, Length]


class RoadPart(Section):
    """The road's middle line; it begins at the world's origin along x, straight on at its end."""

    length_m: float = Field(160.0, gt=10.0, le=10_000.0)
    """Length of the line, m; houses stand along all of it and beyond."""
    curvature: Curvature = ((0.0, 0.0),)
    """Knots [m, 1/m], positive to the left."""


class DrivePart(Section):
    """How the rig's vehicle goes along the road."""

    start_m: float = 5.0
    """Where it is at the first frame, m."""
    offset_m: float = -1.7
    """Its lane, m to the left of the road's middle."""
    speed: Speed = ((0.0, 0.0),)
    """Knots [s, m/s]; it stands without them."""


class StreetPart(Section):
    """What stands along the road."""

    facades: bool = True
    """Houses wall to wall on both sides."""
    facade_m: float = Field(9.5, gt=2.0)
    """Their distance from the road's middle, m."""
    kerb_m: float = Field(5.6, gt=1.0)
    """Distance of parked cars from the road's middle, m; poles stand 1.8 m behind."""
    parked_every_m: float | None = Field(17.0, ge=6.0)
    """Distance between parked cars on either side, m; none without it."""
    poles_every_m: float | None = Field(23.0, ge=1.0)
    """Distance between poles on either side, m; none without it."""
    crossing: Stretch | None = None
    """Stretch of the road [from, to], m, along which nothing stands: another street's mouth."""


class AlongPart(Section):
    """A mover that follows the road."""

    kind: Kind = "car"
    """Its shape and size; `car_trailer` is a car with a trailer on a bar, one rigid body."""
    size: Size | None = None
    """Its length, width and height, m; those of its kind without it."""
    start_m: float
    """Where it is at the first frame, m along the road."""
    offset_m: float
    """Its lane, m to the left of the road's middle."""
    speed: Speed | None = None
    """Knots [s, m/s]; without them it goes as the rig does, `ahead_s` earlier."""
    ahead_s: float = Field(0.0, ge=-5.0, le=5.0)
    """How much earlier than the rig it does the same, s, where it has no speed of its own."""
    oncoming: bool = False
    """Whether it comes towards the road's start."""
    grey: Grey | None = None
    """Mean grey of its paint; drawn without it."""
    group: str | None = None
    """Movers of one group are shifted and hurried alike by the seed, and may be close together."""


class AcrossPart(Section):
    """A mover that goes straight, across the road or at any angle to it."""

    kind: Kind = "walker"
    """Its shape and size; `car_trailer` is a car with a trailer on a bar, one rigid body."""
    size: Size | None = None
    """Its length, width and height, m; those of its kind without it."""
    at_m: float
    """The place along the road where it starts, m."""
    from_offset_m: float
    """Its start, m to the left of the road's middle."""
    heading_deg: float = Field(90.0, ge=-360.0, le=360.0)
    """Its direction against the road's there, degrees; 90 is to the left."""
    speed: Speed
    """Knots [s, m/s]."""
    grey: Grey | None = None
    """Mean grey of its paint; drawn without it."""
    group: str | None = None
    """Movers of one group are shifted and hurried alike by the seed, and may be close together."""


class JitterPart(Section):
    """How much the seed changes each mover. It never makes two of them touch."""

    start_m: float = Field(2.0, ge=0.0, le=20.0)
    """Greatest change of the start, m along the mover's way."""
    speed: float = Field(0.1, ge=0.0, le=0.5)
    """Greatest change of its speed, as a share."""
    size: float = Field(0.0, ge=0.0, le=0.3)
    """Greatest change of its length, width and height, each as a share."""


class LightPart(Section):
    """Brightness in grey levels of 0..255, and what the optics do to it."""

    ground: Grey = 95.0
    """Mean of the ground."""
    sky: Grey = 205.0
    """Mean of the sky."""
    faces: tuple[Grey, Grey] = (95.0, 165.0)
    """Least and greatest mean of a house's front."""
    paint: tuple[Grey, Grey] = (80.0, 170.0)
    """Least and greatest mean of cars and walkers."""
    contrast: float = Field(1.0, ge=0.0, le=3.0)
    """Factor on the contrast of all textures."""
    sun: tuple[float, float, float] = (-0.3, 0.5, 0.8)
    """Direction to the sun: ahead, left, up at the road's start."""
    noise_grey: float = Field(2.0, ge=0.0, le=50.0)
    """Standard deviation of the white noise of each pixel."""
    exposure_drift: float = Field(0.0, ge=0.0, le=0.5)
    """Amplitude of slow changes of the brightness, as a share; a bit different in both cameras."""
    defocus_px: float = Field(0.0, ge=0.0, le=10.0)
    """Standard deviation of the lens's Gaussian blur, pixels."""
    exposure_s: float = Field(0.0, ge=0.0, le=0.1)
    """Exposure time, s, that blurs what moves; 0 is an image of one moment."""


class ImuPart(Section):
    """The rig's IMU."""

    rate_hz: float = Field(100.0, ge=20.0, le=2000.0)
    """Samples per second."""
    errors: bool = False
    """Whether it has scale errors, misalignment and g-sensitivity of a consumer's sensor."""


class SceneFile(Section):
    """One scene."""

    duration_s: float = Field(gt=0.0, le=MAX_DURATION_S)
    """Length, s."""
    rate_hz: float = Field(10.0, ge=1.0, le=100.0)
    """Stereo frames per second."""
    rig: RigName = "street"
    """Cameras: `street`, 640x280, radial-tangential; `fisheye`, 512x512, 150 degrees."""
    road: RoadPart = RoadPart()
    drive: DrivePart = DrivePart()
    street: StreetPart = StreetPart()
    along: tuple[AlongPart, ...] = Field((), max_length=_MOST_MOVERS)
    """Movers that follow the road."""
    across: tuple[AcrossPart, ...] = Field((), max_length=_MOST_MOVERS)
    """Movers that go straight."""
    jitter: JitterPart = JitterPart()
    light: LightPart = LightPart()
    imu: ImuPart = ImuPart()


def load_scene(name_or_path: str) -> SceneFile:
    """A scene of the catalog (`SCENES`) by its name, or one from a YAML file.

    Raises `InputError`, one line that names the file and each wrong key.
    """
    if name_or_path in SCENES:
        path = CATALOG / f"{name_or_path}.yaml"
    else:
        path = Path(name_or_path)
        if not path.suffix and not path.exists():
            problem = "neither a scene of the catalog nor a file"
            raise InputError.at(name_or_path, problem, f"the catalog holds {', '.join(SCENES)}")
    try:
        scene = SceneFile.model_validate(read_yaml_mapping(path))
    except ValidationError as error:
        problems = plain_messages(error, "see docs/simulator.md for what a scene holds")
        raise InputError(f"{path}: {problems}") from None
    if len(scene.along) + len(scene.across) > _MOST_MOVERS:
        raise InputError.at(path, f"more than {_MOST_MOVERS} movers", "leave some out")
    return scene
