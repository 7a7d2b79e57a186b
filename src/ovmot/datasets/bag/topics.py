"""Which topics of a bag are the two cameras and the IMU."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ovmot.errors import InputError

IMAGE_TYPES = ("sensor_msgs/Image", "sensor_msgs/CompressedImage")
IMU_TYPE = "sensor_msgs/Imu"
_MOST_LISTED = 12
_COMPRESSED = "/compressed"


@dataclass(frozen=True, slots=True)
class BagTopics:
    """The topics of a bag that a user names; None for those to be found by their type."""

    left: str | None = None
    right: str | None = None
    imu: str | None = None


@dataclass(frozen=True, slots=True)
class FoundTopics:
    """The topics that are read; `imu` is None where the bag has none, `right` with one camera."""

    left: str
    right: str | None
    imu: str | None

    @property
    def images(self) -> tuple[str, ...]:
        """Those of the cameras, left first."""
        return (self.left,) if self.right is None else (self.left, self.right)


def find_topics(
    path: Path, types: Mapping[str, str], asked: BagTopics, n_cameras: int = 2
) -> FoundTopics:
    """The topics of the cameras and the IMU among those of a bag (topic -> type).

    A bag of one image topic has one camera. `n_cameras`: that of the calibration; with 1, the left
    topic alone is taken: the one that is named, or the first. Two image topics are left and right
    in the order of their names (left before right, cam0 before cam1). A compressed topic beside its
    raw one is the same camera. Raises `InputError` with the candidates and the options where it is
    not clear which to take.
    """
    images = [topic for topic, kind in types.items() if kind in IMAGE_TYPES]
    left, right = (
        None if name is None else _named(path, name, images, option, "image")
        for name, option in ((asked.left, "--left"), (asked.right, "--right"))
    )
    cameras = _cameras(images)
    if right is None and (n_cameras == 1 or len(cameras) == 1) and cameras:
        return FoundTopics(left or min(cameras), None, _imu(path, types, asked.imu))
    if left is None or right is None:
        left, right = _pair(path, images, left, right)
    if left == right:
        raise InputError.at(path, f"left and right are both {left}", "give two topics")
    return FoundTopics(left, right, _imu(path, types, asked.imu))


def _cameras(images: Sequence[str]) -> list[str]:
    """The image topics, without compressed ones beside their raw one."""
    return [t for t in images if t.removesuffix(_COMPRESSED) not in images or t == _raw(t)]


def _pair(
    path: Path, images: Sequence[str], left: str | None, right: str | None
) -> tuple[str, str]:
    """Fill in the cameras that were not named."""
    cameras = _cameras(images)
    others = [t for t in cameras if _raw(t) not in (_raw(left or ""), _raw(right or ""))]
    missing = [side for side, topic in (("left", left), ("right", right)) if topic is None]
    if len(others) != len(missing):
        options = " ".join(f"--{side} TOPIC" for side in missing)
        found = f"{len(cameras)} image topics" if cameras else "no image topics"
        known = f": {', '.join(cameras)}" if cameras else " (sensor_msgs/Image or CompressedImage)"
        enough = len(others) > len(missing)
        remedy = f"choose with {options}" if enough else "two cameras are needed"
        raise InputError.at(path, f"holds {found}{known}", remedy)
    chosen = dict(zip(missing, sorted(others), strict=True))
    return left or chosen["left"], right or chosen["right"]


def _imu(path: Path, types: Mapping[str, str], asked: str | None) -> str | None:
    found = [topic for topic, kind in types.items() if kind == IMU_TYPE]
    if asked is not None:
        return _named(path, asked, found, "--imu", "IMU")
    if len(found) > 1:
        problem = f"holds {len(found)} IMU topics: {', '.join(found)}"
        raise InputError.at(path, problem, "choose with --imu TOPIC")
    return found[0] if found else None


def without_imu(types: Mapping[str, str]) -> str:
    """That none of the topics is an IMU, and which ones there are."""
    known = [f"{topic} ({kind})" for topic, kind in types.items()]
    more = len(known) - _MOST_LISTED
    listed = [*known[:_MOST_LISTED], *([f"{more} more"] if more > 0 else [])]
    return (
        f"no topic of type {IMU_TYPE}, only {', '.join(listed)}: record the IMU, or give the ego"
        " motion by --ego poses FILE"
    )


def _named(path: Path, name: str, known: Sequence[str], option: str, what: str) -> str:
    topic = name if name in known else f"/{name.strip('/')}"
    if topic not in known:
        there = f"there are: {', '.join(known)}" if known else f"it has no {what} topics"
        raise InputError.at(path, f"no {what} topic {name} ({option})", there)
    return topic


def _raw(topic: str) -> str:
    return topic.removesuffix(_COMPRESSED)
