"""Bags that ovmot writes: the results of a run, and the sensors of a recorded sequence."""

from pathlib import Path

import numpy as np

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.sequence import RecordedSequence
from ovmot.datasets.stream import events
from ovmot.outputs.trails import Trails
from ovmot.outputs.views import View, draw_view
from ovmot.ros.bag_writer import BagWriter
from ovmot.ros.messages import PathSoFar, frame_messages, overlay_message
from ovmot.ros.values import Message, Published, header, image, vector
from ovmot.types import FrameResult, ImuSample, StereoFrame


class BagOutput:
    """The messages that a live node would publish, as an output of a run (`run_writer.Output`).

    `overlay` adds the frames of the video, which show `view`, as JPEG.
    """

    def __init__(
        self,
        path: Path,
        rig: StereoRig,
        *,
        overlay: bool = False,
        view: View = "objects",
        replace: bool = False,
    ) -> None:
        """Start the bag; raises `InputError` as `BagWriter`."""
        self._rig = rig
        self._overlay = overlay
        self._view = view
        self._path = PathSoFar()
        self._trails = Trails()
        self._bag = BagWriter(path, replace=replace)

    def write(self, result: FrameResult) -> None:
        self._path = self._path.extended(result)
        said = frame_messages(result, self._path, self._rig)
        if self._overlay and isinstance(result.frame, StereoFrame):
            self._trails = self._trails.extended(result)
            overlay = draw_view(self._view, result, self._rig, self._trails)
            said.append(overlay_message(result.timestamp_ns, overlay))
        for published in said:
            self._bag.write(published, result.timestamp_ns)

    def close(self) -> None:
        self._bag.close()


LEFT, RIGHT, IMU = "/cam0/image_raw", "/cam1/image_raw", "/imu0"


def write_sequence_bag(path: Path, sequence: RecordedSequence) -> int:
    """Write the grey images and the IMU samples of a sequence; returns the number of stereo frames.

    `path` is as in `BagWriter`. IMU samples are those that a run reads (`stream.events`).
    """
    frames = 0
    with BagWriter(path) as bag:
        for event in events(sequence):
            if isinstance(event, ImuSample):
                said = [Published(IMU, imu_message(event))]
            else:
                assert isinstance(event, StereoFrame)
                said = [Published(LEFT, image(event.timestamp_ns, "cam0", event.left))]
                if event.right is not None:
                    said.append(Published(RIGHT, image(event.timestamp_ns, "cam1", event.right)))
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
