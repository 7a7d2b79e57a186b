"""Values into classes of a ROS, here made by hand."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ovmot.ros.instances import filled, imu_sample
from ovmot.ros.values import Message, Time, Value


class Header:
    def __init__(self) -> None:
        self.seq, self.stamp, self.frame_id = 0, None, ""


class Cloud:
    def __init__(self) -> None:
        self.header: Any = None
        self.fields: Any = []
        self.data: Any = b""
        self.values: Any = []


CLASSES = {"std_msgs/Header": Header, "sensor_msgs/PointCloud2": Cloud}


def test_messages_nest_and_arrays_take_the_form_of_ros() -> None:
    header = Message("std_msgs/Header", {"stamp": Time(3_000_000_007), "frame_id": "world"})
    fields: dict[str, Value] = {
        "header": header,
        "fields": (header, header),
        "data": np.array([1, 255], dtype=np.uint8),
        "values": np.array([0.5, 2.0]),
    }
    cloud = filled(
        Message("sensor_msgs/PointCloud2", fields), CLASSES.__getitem__, lambda *parts: parts
    )
    assert cloud.header.stamp == (3, 7) and cloud.header.seq == 0
    assert [h.frame_id for h in cloud.fields] == ["world", "world"]
    assert cloud.data == b"\x01\xff" and cloud.values == [0.5, 2.0]


def test_a_field_that_the_class_lacks_is_an_error() -> None:
    with pytest.raises(AttributeError, match="no field frame"):
        filled(Message("std_msgs/Header", {"frame": "x"}), CLASSES.__getitem__, lambda *p: p)


def test_an_imu_message_keeps_its_nanoseconds() -> None:
    def xyz(x: float, y: float, z: float) -> SimpleNamespace:
        return SimpleNamespace(x=x, y=y, z=z)

    message = SimpleNamespace(
        angular_velocity=xyz(1.0, 2.0, 3.0), linear_acceleration=xyz(4.0, 5.0, 6.0)
    )
    sample = imu_sample(message, 1_700_000_000_123_456_789)
    assert sample.timestamp_ns == 1_700_000_000_123_456_789
    np.testing.assert_array_equal(sample.gyro, [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(sample.accel, [4.0, 5.0, 6.0])
