"""What a live node of either ROS is given and listens to: calibration and topics."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from ovmot.datasets.calibration import Calibration
from ovmot.datasets.given_calibration import read_calibration
from ovmot.datasets.registry import open_sequence, recognise
from ovmot.errors import InputError
from ovmot.settings import LiveSettings

IMAGES_QUEUED, IMU_QUEUED, RESULTS_QUEUED = 10, 2000, 10
"""Messages that ROS may keep for us before it drops them itself."""

LOOK_EVERY_S = 0.5
"""How often a node looks after its inputs."""

STREAMS = ("left", "right", "imu")

_IMAGE, _COMPRESSED, _IMU = "sensor_msgs/Image", "sensor_msgs/CompressedImage", "sensor_msgs/Imu"
_OWN = "/ovmot/"


@dataclass(frozen=True, slots=True)
class InputTopic:
    """A topic by its full name, and the type (`package/Name`) that is asked for there."""

    name: str
    type_name: str

    @property
    def is_compressed(self) -> bool:
        """Is it one of compressed images?"""
        return self.type_name == _COMPRESSED


def input_topics(live: LiveSettings, resolved: Callable[[str], str]) -> dict[str, InputTopic]:
    """The topic of each of `STREAMS`; `resolved` makes a full name of one in the settings."""
    topics = {}
    for stream, name in zip(STREAMS, (live.left, live.right, live.imu), strict=True):
        image = _COMPRESSED if name.endswith("/compressed") else _IMAGE
        topics[stream] = InputTopic(resolved(name), _IMU if stream == "imu" else image)
    return topics


def why_silent(topic: InputTopic, published: Mapping[str, str]) -> str:
    """Why a topic may be silent, judged by the published topics and their types."""
    type_name = published.get(topic.name)
    if type_name == topic.type_name:
        return "it is published, but nothing comes"
    if type_name is not None:
        return f"it is a {type_name}, expected is {topic.type_name}"
    others = [
        name
        for name, kind in sorted(published.items())
        if kind == topic.type_name and not name.startswith(_OWN)
    ]
    if not others:
        return f"nobody publishes it, nor any other {topic.type_name}"
    return f"nobody publishes it; topics of {topic.type_name}: {', '.join(others)}"


def live_calibration(path: Path | None) -> Calibration:
    """The calibration in a Kalibr chain, a rig's file of VINS, or the folder of a data set.

    Raises `InputError` where there is none, or one of one camera.
    """
    if path is None:
        raise InputError("no calibration: give --calibration FILE (Kalibr chain) or ~calibration")
    if path.is_dir() and recognise(path):
        sequence = open_sequence(path)
        return Calibration.of_rig(sequence.rig, sequence.imu_noise)
    calibration = read_calibration(path)
    if calibration.rig.n_cameras == 1:
        problem = "has one camera, a live node needs two"
        raise InputError.at(path, problem, "run recordings of one camera with 'ovmot run'")
    return calibration
