"""`ovmot ros`: the live node on ROS 1 (Noetic). The only file that imports rospy."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ovmot.datasets.calibration import Calibration
from ovmot.errors import InputError, OvmotError
from ovmot.ros.inputs import (
    IMAGES_QUEUED,
    IMU_QUEUED,
    LOOK_EVERY_S,
    RESULTS_QUEUED,
    InputTopic,
    input_topics,
    live_calibration,
)
from ovmot.ros.instances import filled, imu_sample
from ovmot.ros.messages import LATCHED
from ovmot.ros.pairing import Side
from ovmot.ros.parameters import read_parameters
from ovmot.ros.ros1_master import MasterWatch
from ovmot.ros.ros1_messages import Ros1Classes, stamp_ns
from ovmot.ros.session import LIVE_TOPICS, RESET_ASKED
from ovmot.ros.values import Published
from ovmot.ros.watch import Line
from ovmot.ros.worker import Worker, load_kernels
from ovmot.settings import Settings
from ovmot.settings_file import load_settings

_IMAGE_BUFFER = 1 << 24  # rospy's own, 64 KiB, holds less than an image and then lags
REMEDY = (
    "on Debian: apt-get install python3-rospy python3-sensor-msgs python3-nav-msgs "
    "python3-visualization-msgs python3-tf2-msgs python3-std-srvs, and let the virtual environment "
    "see them: make install-ros (docs/ros.md)"
)


def run_node(config: Path | None, calibration: Path | None, overrides: tuple[str, ...]) -> None:
    """Run until shutdown. Files given here win over those of the node's parameters.

    Raises `InputError` for a missing rospy, calibration or master, KeyboardInterrupt on Ctrl-C.
    """
    rospy = _import_rospy()
    _require_master()
    rospy.init_node("ovmot", disable_signals=True)
    given = read_parameters(rospy.get_param("~", {}))
    settings = load_settings(config or given.config, [*given.overrides, *overrides])
    known = live_calibration(calibration or given.calibration)
    node = _Node(rospy, settings, known)
    try:
        node.spin()
    finally:
        node.close()
        rospy.signal_shutdown("ovmot ends")


class _Node:
    """Subscribers that fill the worker's intake, and publishers behind it."""

    def __init__(self, rospy: Any, settings: Settings, calibration: Calibration) -> None:
        self._rospy = rospy
        topics = input_topics(settings.live, rospy.resolve_name)
        self._worker = Worker(settings, calibration, topics, _Publishers(rospy), self._say)
        load_kernels()  # while the front end's process starts
        self._subscribe(topics)

    def spin(self) -> None:
        """Look after inputs and master until shutdown; raises what ended the worker."""
        master = MasterWatch(self._rospy)
        while not self._rospy.is_shutdown():
            time.sleep(LOOK_EVERY_S)  # not rospy.sleep: simulated time may stand
            for line in (*master.look(), *self._worker.look(master.published())):
                self._say(line)

    def _say(self, line: Line) -> None:
        log = self._rospy.loginfo if line.level == "info" else self._rospy.logwarn
        log(line.text)

    def close(self) -> None:
        """End the worker and say what was done."""
        self._rospy.loginfo(self._worker.close())

    def _subscribe(self, topics: Mapping[str, InputTopic]) -> None:
        from sensor_msgs.msg import CompressedImage, Image, Imu
        from std_srvs.srv import Trigger, TriggerResponse

        rospy, intake = self._rospy, self._worker.intake

        def on_image(message: Any, side: Side) -> None:
            intake.put_image(side, stamp_ns(message), message)

        def on_reset(_: Any) -> Any:
            intake.restart(RESET_ASKED)
            return TriggerResponse(success=True, message="starting again, in a new segment")

        for side in ("left", "right"):
            kind = CompressedImage if topics[side].is_compressed else Image
            rospy.Subscriber(
                topics[side].name, kind, on_image, side, queue_size=IMAGES_QUEUED,
                buff_size=_IMAGE_BUFFER, tcp_nodelay=True,
            )  # fmt: skip
        rospy.Subscriber(
            topics["imu"].name, Imu,
            lambda message: intake.put_imu(imu_sample(message, stamp_ns(message))),
            queue_size=IMU_QUEUED, tcp_nodelay=True,
        )  # fmt: skip
        rospy.Service("~reset", Trigger, on_reset)


class _Publishers:
    """A `Sink`: a publisher for every topic."""

    def __init__(self, rospy: Any) -> None:
        import genpy

        self._class_of = Ros1Classes()
        self._time_of = genpy.Time
        self._publishers = {
            topic: rospy.Publisher(
                topic, self._class_of(kind), queue_size=RESULTS_QUEUED, latch=topic in LATCHED
            )
            for topic, kind in LIVE_TOPICS.items()
        }

    def wanted(self, topic: str) -> bool:
        """Does anybody listen to this topic?"""
        return bool(self._publishers[topic].get_num_connections() > 0)

    def send(self, published: Published) -> None:
        """Publish, where anybody listens or may listen later."""
        if published.topic in LATCHED or self.wanted(published.topic):
            message = filled(published.message, self._class_of, self._time_of)
            self._publishers[published.topic].publish(message)


def _import_rospy() -> Any:
    try:
        import genpy  # noqa: F401
        import nav_msgs.msg  # noqa: F401
        import rospy
        import sensor_msgs.msg  # noqa: F401
        import std_srvs.srv  # noqa: F401
        import tf2_msgs.msg  # noqa: F401
        import visualization_msgs.msg  # noqa: F401
    except ImportError as error:
        raise InputError(f"ROS 1 is not there ({error}); {REMEDY}") from None
    return rospy


def _require_master() -> None:
    import rosgraph

    if not rosgraph.is_master_online():
        uri = rosgraph.get_master_uri()
        raise OvmotError(f"no ROS master at {uri}: start one with 'roscore', or set ROS_MASTER_URI")
