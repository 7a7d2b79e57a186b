"""The node of ROS 2; what needs ROS 2 skips without it."""

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.ros.session import LIVE_TOPICS
from ovmot.types import FrameResult


@pytest.mark.skipif(find_spec("rclpy") is not None, reason="ROS 2 is there")
def test_without_ros_2_the_command_says_what_it_needs(ovmot_command: Callable[..., Any]) -> None:
    found = ovmot_command("ros2", "--calibration", "chain.yaml")
    assert found.code == 2
    assert "ROS 2 is not there" in found.complaint
    assert "Jazzy or later" in found.complaint


def test_every_message_fits_the_classes_of_ros_2(
    result: FrameResult, rig_of_result: StereoRig
) -> None:
    pytest.importorskip("rclpy")
    from builtin_interfaces.msg import Time

    from ovmot.ros.instances import filled
    from ovmot.ros.messages import PathSoFar, frame_messages
    from ovmot.ros.ros2_node import _class_of

    checked = 0
    for published in frame_messages(result, PathSoFar().extended(result), rig_of_result):
        try:
            _class_of(LIVE_TOPICS[published.topic])
        except ImportError:  # that package is not installed
            continue
        filled(published.message, _class_of, lambda s, n: Time(sec=s, nanosec=n))
        checked += 1
    assert checked >= 4


def test_a_wrong_chain_is_an_input_error(tmp_path: Path, ovmot_command: Callable[..., Any]) -> None:
    pytest.importorskip("rclpy")
    found = ovmot_command("ros2", "--calibration", tmp_path / "chain.yaml")
    assert found.code == 2
    assert "no such calibration file" in found.complaint
