"""Tracks as messages: objects and markers."""

from typing import Any

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.ros import messages
from ovmot.ros.messages import PathSoFar, frame_messages
from ovmot.ros.object_messages import object_array
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


def test_markers_begin_with_a_clean_slate_and_show_no_tentative_track(
    result: FrameResult, rig_of_result: StereoRig
) -> None:
    drawn = through(1, by_topic(result, rig_of_result)[messages.MARKERS]).markers
    assert drawn[0].action == drawn[0].DELETEALL
    assert [(m.ns, m.id) for m in drawn[1:]] == [
        (name, track) for track in (7, 8) for name in ("boxes", "ids", "velocities")
    ]
    box, label, arrow = drawn[1:4]
    assert label.text == "7: 5.0 m/s" and box.scale.x == 4.0
    assert arrow.points[1].x - arrow.points[0].x == pytest.approx(3.0)
    assert np.isclose(box.pose.orientation.z, np.sin(0.15))


def test_every_track_is_in_the_array_also_a_tentative_one(result: FrameResult) -> None:
    made = object_array(result.timestamp_ns, "world", result.tracks)
    objects = through(2, made).objects
    assert [o.id for o in objects] == [track.track_id for track in result.tracks]
    assert "tentative" in {track.state for track in result.tracks}
    first, track = objects[0], result.tracks[0]
    np.testing.assert_allclose(
        [first.velocity.x, first.velocity.y, first.velocity.z], track.velocity
    )
    np.testing.assert_allclose([first.size.x, first.size.y, first.size.z], track.size)
    assert first.n_points == track.n_points
