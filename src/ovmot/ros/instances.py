"""Messages as instances of the classes of ROS 1 or ROS 2, and their IMU messages as samples."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ovmot.ros.values import Message, Time, Value
from ovmot.types import ImuSample


def filled(message: Message, class_of: Callable[[str], Any], time_of: Callable[..., Any]) -> Any:
    """The message as an instance; `time_of` makes a stamp of its seconds and nanoseconds.

    `class_of` gives the class of a `package/Name`. Raises `AttributeError` for a field that the
    class does not have.
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


def imu_sample(message: Any, stamp_ns: int) -> ImuSample:
    """A `sensor_msgs/Imu`; its orientation is not used."""
    gyro, accel = message.angular_velocity, message.linear_acceleration
    return ImuSample(
        stamp_ns,
        np.array([gyro.x, gyro.y, gyro.z]),
        np.array([accel.x, accel.y, accel.z]),
    )
