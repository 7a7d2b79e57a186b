"""`ovmot ros2`: the live node on ROS 2. The only file that imports rclpy."""

import time
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from ovmot.datasets.calibration import Calibration
from ovmot.errors import InputError
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
from ovmot.ros.session import LIVE_TOPICS, RESET_ASKED
from ovmot.ros.values import Published
from ovmot.ros.watch import Line
from ovmot.ros.worker import Worker, load_kernels
from ovmot.settings import Settings
from ovmot.settings_file import load_settings

_REMEDY = "run it by the Python of a sourced ROS 2, 3.11 or newer: Jazzy or later (docs/ros.md)"


def run_node(
    config: Path | None,
    calibration: Path | None,
    overrides: tuple[str, ...],
    arguments: Sequence[str] = (),
) -> None:
    """Run until Ctrl-C, which is raised; `arguments` are ROS's own (`--ros-args ...`).

    Raises `InputError` where rclpy or the calibration is missing.
    """
    rclpy = _import_rclpy()
    settings, known = load_settings(config, overrides), live_calibration(calibration)
    try:
        rclpy.init(
            args=["ovmot", *arguments], signal_handler_options=rclpy.signals.SignalHandlerOptions.NO
        )
    except Exception as error:  # rclpy has no common base of what it makes of bad arguments
        raise InputError(f"ROS 2 does not start: {' '.join(str(error).split())}") from None
    node = _Node(rclpy, settings, known)
    try:
        node.spin()
    finally:
        node.close()
        rclpy.shutdown()


class _Node:
    """Subscriptions that fill the worker's intake, and publishers behind it."""

    def __init__(self, rclpy: Any, settings: Settings, calibration: Calibration) -> None:
        self._rclpy = rclpy
        self._node = rclpy.create_node("ovmot")
        self._log = self._node.get_logger()
        topics = input_topics(settings.live, self._node.resolve_topic_name)
        publishers = _Publishers(self._node)
        self._worker = Worker(settings, calibration, topics, publishers, self._say)
        load_kernels()  # while the front end's process starts
        self._subscribe(topics)

    def spin(self) -> None:
        """Give out messages and look after the inputs until ROS ends."""
        next_look_s = time.monotonic()
        while self._rclpy.ok():
            self._rclpy.spin_once(self._node, timeout_sec=LOOK_EVERY_S)
            if time.monotonic() >= next_look_s:
                next_look_s += LOOK_EVERY_S
                for line in self._worker.look(self._published()):
                    self._say(line)

    def _say(self, line: Line) -> None:
        log = self._log.info if line.level == "info" else self._log.warning
        log(line.text)

    def close(self) -> None:
        """End the worker and say what was done."""
        self._log.info(self._worker.close())
        self._node.destroy_node()

    def _published(self) -> dict[str, str]:
        """The types of all topics that anybody publishes."""
        return {
            name: kinds[0].replace("/msg/", "/")
            for name, kinds in self._node.get_topic_names_and_types()
            if self._node.count_publishers(name)
        }

    def _subscribe(self, topics: Mapping[str, InputTopic]) -> None:
        """Best effort: such a subscription takes what any publisher offers."""
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from sensor_msgs.msg import CompressedImage, Image, Imu
        from std_srvs.srv import Trigger

        intake = self._worker.intake
        effort = ReliabilityPolicy.BEST_EFFORT

        def subscribe_image(side: Side) -> None:
            kind = CompressedImage if topics[side].is_compressed else Image
            self._node.create_subscription(
                kind, topics[side].name, lambda m: intake.put_image(side, _stamp_ns(m), m),
                QoSProfile(depth=IMAGES_QUEUED, reliability=effort),
            )  # fmt: skip

        def on_reset(_: Any, response: Any) -> Any:
            intake.restart(RESET_ASKED)
            response.success, response.message = True, "starting again, in a new segment"
            return response

        subscribe_image("left")
        subscribe_image("right")
        self._node.create_subscription(
            Imu, topics["imu"].name, lambda m: intake.put_imu(imu_sample(m, _stamp_ns(m))),
            QoSProfile(depth=IMU_QUEUED, reliability=effort),
        )  # fmt: skip
        self._node.create_service(Trigger, "~/reset", on_reset)


class _Publishers:
    """A `Sink`: a publisher for every topic whose type is installed."""

    def __init__(self, node: Any) -> None:
        from builtin_interfaces.msg import Time

        self._time_of = lambda seconds, rest: Time(sec=seconds, nanosec=rest)
        self._publishers: dict[str, Any] = {}
        for topic, kind in LIVE_TOPICS.items():
            try:
                found = _class_of(kind)
            except ImportError:
                node.get_logger().warning(f"{topic} is left out: {kind} is not installed")
                continue
            self._publishers[topic] = node.create_publisher(found, topic, _quality(topic))

    def wanted(self, topic: str) -> bool:
        """Does anybody listen to this topic?"""
        publisher = self._publishers.get(topic)
        return publisher is not None and publisher.get_subscription_count() > 0

    def send(self, published: Published) -> None:
        """Publish, where anybody listens or may listen later."""
        publisher = self._publishers.get(published.topic)
        if publisher is None:
            return
        if published.topic in LATCHED or self.wanted(published.topic):
            publisher.publish(filled(published.message, _class_of, self._time_of))


def _quality(topic: str) -> Any:
    """Of a publisher; a latched topic is one that is transient local."""
    from rclpy.qos import DurabilityPolicy, QoSProfile

    if topic in LATCHED:
        return QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    return QoSProfile(depth=RESULTS_QUEUED)


def _class_of(type_name: str) -> Any:
    package, _, name = type_name.partition("/")
    return getattr(import_module(f"{package}.msg"), name)


def _stamp_ns(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _import_rclpy() -> Any:
    try:
        import rclpy
        import rclpy.signals
        import sensor_msgs.msg  # noqa: F401
        import std_srvs.srv  # noqa: F401
    except ImportError as error:
        raise InputError(f"ROS 2 is not there ({error}); {_REMEDY}") from None
    return rclpy
