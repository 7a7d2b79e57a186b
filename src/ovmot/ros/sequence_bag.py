"""A recorded sequence as a bag: the same images and IMU as messages, to be played or read again."""

from pathlib import Path

import numpy as np

from ovmot.datasets.sequence import RecordedSequence
from ovmot.datasets.stream import events
from ovmot.ros.bag_writer import BagWriter
from ovmot.ros.values import Message, Published, header, image, vector
from ovmot.types import ImuSample, StereoFrame

LEFT, RIGHT, IMU = "/cam0/image_raw", "/cam1/image_raw", "/imu0"


def write_sequence_bag(path: Path, sequence: RecordedSequence) -> int:
    """Write the grey images and the IMU samples of a sequence; the number of stereo frames.

    `path` is as in `BagWriter`. IMU samples are those that a run reads (`stream.events`).
    """
    frames = 0
    with BagWriter(path) as bag:
        for event in events(sequence):
            if isinstance(event, ImuSample):
                said = [Published(IMU, imu_message(event))]
            else:
                assert isinstance(event, StereoFrame)
                said = [
                    Published(LEFT, image(event.timestamp_ns, "cam0", event.left)),
                    Published(RIGHT, image(event.timestamp_ns, "cam1", event.right)),
                ]
                frames += 1
            for published in said:
                bag.write(published, event.timestamp_ns)
    return frames


def imu_message(sample: ImuSample) -> Message:
    """One sample as `sensor_msgs/Imu`; the orientation is marked as not measured."""
    unknown = [-1.0, *[0.0] * 8]
    return Message(
        "sensor_msgs/Imu",
        {
            "header": header(sample.timestamp_ns, "imu"),
            "orientation_covariance": np.array(unknown),
            "angular_velocity": vector(sample.gyro),
            "linear_acceleration": vector(sample.accel),
        },
    )
