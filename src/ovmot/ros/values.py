"""ROS messages as plain values, the same for ROS 1 and ROS 2, bags and live.

A transport fills its own classes from them: a field that is left out takes its type's default
(also where only one ROS has it, as a header's `seq`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ovmot.geometry import so3
from ovmot.geometry.arrays import AnyArray, FloatArray

_JPEG_QUALITY = 80  # of 100: the default of image_transport


@dataclass(frozen=True, slots=True)
class Time:
    """A stamp; ROS 1 calls its parts secs and nsecs, ROS 2 sec and nanosec."""

    nanoseconds: int

    @property
    def parts(self) -> tuple[int, int]:
        """Whole seconds and the nanoseconds that are left."""
        return divmod(self.nanoseconds, 1_000_000_000)


@dataclass(frozen=True, slots=True)
class Message:
    """A message: its type as `package/Name`, and fields by their ROS names.

    Arrays of numbers are NumPy arrays in the field's own type, `uint8[]` included; arrays of
    messages are tuples.
    """

    type_name: str
    fields: Mapping[str, "Value"]


Value = bool | int | float | str | AnyArray | Time | Message | Sequence[Message]


@dataclass(frozen=True, slots=True)
class Published:
    """A message and the topic that it goes to."""

    topic: str
    message: Message


def header(timestamp_ns: int, frame: str) -> Message:
    return Message("std_msgs/Header", {"stamp": Time(timestamp_ns), "frame_id": frame})


def vector(values: FloatArray, type_name: str = "geometry_msgs/Vector3") -> Message:
    """Three numbers (3,) as a `Vector3` or a `Point`."""
    return Message(type_name, dict(zip("xyz", values.tolist(), strict=True)))


def point(position: FloatArray) -> Message:
    return vector(position, "geometry_msgs/Point")


def quaternion(R_a_b: FloatArray) -> Message:
    """A rotation matrix (3, 3)."""
    xyzw = so3.to_quaternion(R_a_b).tolist()
    return Message("geometry_msgs/Quaternion", dict(zip("xyzw", xyzw, strict=True)))


def pose(T_a_b: FloatArray) -> Message:
    """A pose (4, 4) of b in a."""
    parts = {"position": point(T_a_b[:3, 3]), "orientation": quaternion(T_a_b[:3, :3])}
    return Message("geometry_msgs/Pose", parts)


def transform(timestamp_ns: int, frame: str, child: str, T_frame_child: FloatArray) -> Message:
    """One edge of the tree of frames; `T_frame_child` (4, 4) maps child's points into frame."""
    parts = {
        "translation": vector(T_frame_child[:3, 3]),
        "rotation": quaternion(T_frame_child[:3, :3]),
    }
    return Message(
        "geometry_msgs/TransformStamped",
        {
            "header": header(timestamp_ns, frame),
            "child_frame_id": child,
            "transform": Message("geometry_msgs/Transform", parts),
        },
    )


_FIELD_TYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


def point_cloud(timestamp_ns: int, frame: str, points: AnyArray) -> Message:
    """A structured array (N,), little-endian, as a `PointCloud2` of one row."""
    packed = np.ascontiguousarray(points)
    assert packed.dtype.names is not None and packed.dtype.fields is not None
    fields = tuple(
        Message(
            "sensor_msgs/PointField",
            {
                "name": name,
                "offset": int(packed.dtype.fields[name][1]),
                "datatype": _FIELD_TYPES[packed.dtype.fields[name][0].str[1:]],
                "count": 1,
            },
        )
        for name in packed.dtype.names
    )
    return Message(
        "sensor_msgs/PointCloud2",
        {
            "header": header(timestamp_ns, frame),
            "height": 1,
            "width": len(packed),
            "fields": fields,
            "is_bigendian": False,
            "point_step": packed.dtype.itemsize,
            "row_step": packed.nbytes,
            "data": np.frombuffer(packed.tobytes(), dtype=np.uint8),
            "is_dense": True,
        },
    )


def jpeg(timestamp_ns: int, frame: str, pixels: AnyArray) -> Message:
    """An image (height, width, 3) in blue-green-red, uint8, as a `CompressedImage`."""
    done, packed = cv2.imencode(".jpg", pixels, (cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY))
    assert done
    fields: dict[str, Value] = {
        "header": header(timestamp_ns, frame),
        "format": "jpeg",
        "data": packed.reshape(-1),
    }
    return Message("sensor_msgs/CompressedImage", fields)


def image(timestamp_ns: int, frame: str, pixels: AnyArray) -> Message:
    """An image (height, width) in grey or (height, width, 3) in blue-green-red, uint8."""
    packed = np.ascontiguousarray(pixels)
    height, width = packed.shape[:2]
    return Message(
        "sensor_msgs/Image",
        {
            "header": header(timestamp_ns, frame),
            "height": height,
            "width": width,
            "encoding": "mono8" if packed.ndim == 2 else "bgr8",
            "is_bigendian": 0,
            "step": packed.nbytes // height,
            "data": packed.reshape(-1),
        },
    )
