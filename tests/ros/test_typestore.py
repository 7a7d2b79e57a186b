"""Messages of both ROS versions as instances, and their bytes."""

from typing import Any

import cv2
import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.ros import messages
from ovmot.ros.messages import PathSoFar, frame_messages, overlay_message
from ovmot.ros.typestore import filled, rosbags_name, typestore
from ovmot.ros.values import Message
from ovmot.types import FrameResult


def by_topic(result: FrameResult, rig: StereoRig) -> dict[str, Message]:
    made = frame_messages(result, PathSoFar().extended(result), rig)
    return {published.topic: published.message for published in made}


def through(version: int, message: Message) -> Any:
    """The message written and read again by the wire format of one ROS version."""
    store, name = typestore(version), rosbags_name(message.type_name)
    if version == 1:
        return store.deserialize_ros1(store.serialize_ros1(filled(store, message), name), name)
    return store.deserialize_cdr(store.serialize_cdr(filled(store, message), name), name)


@pytest.mark.parametrize("version", [1, 2])
def test_both_versions_of_ros_carry_every_message(
    result: FrameResult, rig_of_result: StereoRig, version: int
) -> None:
    made = by_topic(result, rig_of_result)
    drawn = np.full((40, 60, 3), (200, 100, 50), dtype=np.uint8)
    overlay = overlay_message(result.timestamp_ns, drawn)
    read = {topic: through(version, m) for topic, m in made.items()}
    image = through(version, overlay.message)
    types = {topic: message.type_name for topic, message in made.items()}
    assert types | {overlay.topic: overlay.message.type_name} == messages.TOPICS
    odometry = read[messages.ODOMETRY]
    assert (odometry.header.stamp.sec, odometry.header.stamp.nanosec) == (1_700_000_000, 123456789)
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("world", "imu")
    assert odometry.pose.pose.position.z == 3.0
    assert image.format == "jpeg" and len(image.data) < drawn.size
    shown = cv2.imdecode(np.asarray(image.data), cv2.IMREAD_COLOR)
    assert shown is not None
    np.testing.assert_allclose(shown, drawn, atol=4)
    objects = read[messages.OBJECTS].objects
    assert [(o.id, o.state) for o in objects] == [(7, 1), (8, 2), (9, 0)]
    assert np.isnan(objects[0].yaw_rate) and objects[0].size.x == 4.0
    assert objects[0].box_px.tolist() == [10.0, 20.0, 50.0, 60.0]


def test_a_field_that_no_ros_has_is_an_error() -> None:
    with pytest.raises(KeyError, match="sequence"):
        filled(typestore(1), Message("std_msgs/Header", {"sequence": 1}))
