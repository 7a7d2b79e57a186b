"""Our messages as instances of ROS 1's classes, and ROS 1's as our values."""

from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np

from ovmot.ros.typestore import own_definitions
from ovmot.ros.values import Message, Time, Value
from ovmot.types import ImuSample

_RULE = "\n" + "=" * 80 + "\n"
_OWN_PACKAGE = "ovmot_msgs"
_USED_BY_OWN = ("std_msgs/Header", "geometry_msgs/Pose", "geometry_msgs/Vector3")


class Ros1Classes:
    """Looks classes up by `package/Name`. Those of ovmot_msgs are made from our definitions.

    So no catkin workspace is needed; subscribers that have one get the same MD5 sum.
    """

    def __init__(self) -> None:
        self._known: dict[str, Any] = {}

    def __call__(self, type_name: str) -> Any:
        """The class; raises `ImportError` where its package is not installed."""
        if type_name not in self._known:
            package, _, name = type_name.partition("/")
            if package == _OWN_PACKAGE:
                self._known.update(_own_classes())
            else:
                self._known[type_name] = getattr(import_module(f"{package}.msg"), name)
        return self._known[type_name]


def filled(message: Message, class_of: Callable[[str], Any], time_of: Callable[..., Any]) -> Any:
    """The message as an instance; `time_of(secs, nsecs)` makes its stamps (`genpy.Time`).

    Raises `AttributeError` for a field that the class does not have.
    """
    instance = class_of(message.type_name)()
    for name, value in message.fields.items():
        if not hasattr(instance, name):
            raise AttributeError(f"{message.type_name} has no field {name}")
        setattr(instance, name, _value(value, class_of, time_of))
    return instance


def _value(given: Value, class_of: Callable[[str], Any], time_of: Callable[..., Any]) -> Any:
    if isinstance(given, Message):
        return filled(given, class_of, time_of)
    if isinstance(given, Time):
        return time_of(*given.parts)
    if isinstance(given, np.ndarray):
        return given.tobytes() if given.dtype == np.uint8 else given.tolist()
    if isinstance(given, tuple | list):
        return [_value(item, class_of, time_of) for item in given]
    return given


def stamp_ns(message: Any) -> int:
    """The stamp in a message's header."""
    stamp = message.header.stamp
    return int(stamp.secs) * 1_000_000_000 + int(stamp.nsecs)


def imu_sample(message: Any) -> ImuSample:
    """A `sensor_msgs/Imu`; its orientation is not used."""
    gyro, accel = message.angular_velocity, message.linear_acceleration
    return ImuSample(
        stamp_ns(message),
        np.array([gyro.x, gyro.y, gyro.z]),
        np.array([accel.x, accel.y, accel.z]),
    )


def _own_classes() -> dict[str, Any]:
    """Classes of every definition of ours, by ROS 1's own generator."""
    from genpy.dynamic import generate_dynamic

    texts = own_definitions()
    for name in _USED_BY_OWN:
        package, _, short = name.partition("/")
        texts.update(_texts(name, getattr(import_module(f"{package}.msg"), short)._full_text))
    core = f"{_OWN_PACKAGE}/ObjectArray"
    others = (f"MSG: {name}\n{text}" for name, text in texts.items() if name != core)
    made: dict[str, Any] = generate_dynamic(core, _RULE.join([texts[core], *others]))
    return {name: made[name] for name in own_definitions()}


def _texts(name: str, full_text: str) -> dict[str, str]:
    """A definition and those that it needs, apart, by their names."""
    first, *others = full_text.split(_RULE)
    texts = {name: first}
    for other in others:
        title, _, text = other.partition("\n")
        texts[title.removeprefix("MSG: ").strip()] = text
    return texts
