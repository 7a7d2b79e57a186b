"""A recorded sequence as a ROS 1 bag, to be played into the live node; also a command.

    python tests/ros/sequence_bag.py SEQUENCE OUT.bag
"""

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer

from ovmot.datasets.registry import open_sequence
from ovmot.datasets.sequence import RecordedSequence
from ovmot.datasets.stream import events
from ovmot.ros.typestore import filled, rosbags_name, typestore
from ovmot.ros.values import Message, header, image, vector
from ovmot.types import FeatureFrame, ImuSample

LEFT, RIGHT, IMU = "/cam0/image_raw", "/cam1/image_raw", "/imu0"


def write_bag(
    sequence: RecordedSequence, path: Path, imu_hole_s: tuple[float, float] | None = None
) -> None:
    """Grey images and the IMU, at their stamps; `imu_hole_s`, counted from the first frame, is cut
    out of the IMU's."""
    store, first_ns = typestore(1), int(sequence.frame_ns[0])
    with Writer(path) as writer:
        connections = {
            topic: writer.add_connection(topic, rosbags_name(kind), typestore=store)
            for topic, kind in (
                (LEFT, "sensor_msgs/Image"), (RIGHT, "sensor_msgs/Image"), (IMU, "sensor_msgs/Imu"),
            )
        }  # fmt: skip
        for stamp, topic, message in _messages(sequence):
            at_s = 1e-9 * (stamp - first_ns)
            if topic == IMU and imu_hole_s and imu_hole_s[0] < at_s < imu_hole_s[1]:
                continue
            kind = rosbags_name(message.type_name)
            data = store.serialize_ros1(filled(store, message), kind)
            writer.write(connections[topic], stamp, data)


def _messages(sequence: RecordedSequence) -> Iterator[tuple[int, str, Message]]:
    for event in events(sequence):
        stamp = event.timestamp_ns
        if isinstance(event, ImuSample):
            yield stamp, IMU, _imu(event)
        elif not isinstance(event, FeatureFrame):
            yield stamp, LEFT, image(stamp, "cam0", event.left)
            yield stamp, RIGHT, image(stamp, "cam1", event.right)


def _imu(sample: ImuSample) -> Message:
    return Message(
        "sensor_msgs/Imu",
        {
            "header": header(sample.timestamp_ns, "imu"),
            "angular_velocity": vector(sample.gyro),
            "linear_acceleration": vector(sample.accel),
            "orientation_covariance": np.array([-1.0, *[0.0] * 8]),  # no orientation
        },
    )


if __name__ == "__main__":
    write_bag(open_sequence(Path(sys.argv[1])), Path(sys.argv[2]))
