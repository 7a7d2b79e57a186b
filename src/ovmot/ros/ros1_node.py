"""`ovmot ros`: the live node on ROS 1 (Noetic). The only file that imports rospy."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ovmot.cameras.calibration import Calibration
from ovmot.cameras.kalibr import read_kalibr
from ovmot.config import Settings
from ovmot.datasets.registry import open_sequence, recognise
from ovmot.errors import InputError, OvmotError
from ovmot.ros.master import MasterWatch
from ovmot.ros.pairing import Side
from ovmot.ros.parameters import read_parameters
from ovmot.ros.ros1_messages import Ros1Classes, filled, imu_sample, stamp_ns
from ovmot.ros.session import LIVE_TOPICS
from ovmot.ros.values import Published
from ovmot.ros.worker import Worker
from ovmot.settings_file import load_settings

_LOOK_EVERY_S = 0.5
_IMAGE_BUFFER = 1 << 24  # rospy's own, 64 KiB, holds less than an image and then lags
_IMAGES_QUEUED, _IMU_QUEUED, _RESULTS_QUEUED = 10, 2000, 10
_REMEDY = (
    "on Debian: apt-get install python3-rospy python3-sensor-msgs python3-nav-msgs "
    "python3-visualization-msgs python3-tf2-msgs python3-std-srvs, and let the virtual environment "
    "see them (docs/ros.md)"
)


def run_node(config: Path | None, calibration: Path | None, overrides: tuple[str, ...]) -> None:
    """Run until shutdown. Files given here win over those of the node's parameters.

    Raises `InputError` for a missing rospy, calibration or master, KeyboardInterrupt on Ctrl-C.
    """
    rospy = _import_rospy()
    _require_master()
    rospy.init_node("ovmot", disable_signals=True)
    told = read_parameters(rospy.get_param("~", {}))
    settings = load_settings(config or told.config, [*told.overrides, *overrides])
    known = live_calibration(calibration or told.calibration)
    node = _Node(rospy, settings, known)
    try:
        node.spin()
    finally:
        node.close()
        rospy.signal_shutdown("ovmot ends")


def live_calibration(path: Path | None) -> Calibration:
    """The calibration in a Kalibr chain, or in the folder of a data set.

    Raises `InputError` where there is none.
    """
    if path is None:
        raise InputError("no calibration: give --calibration FILE (Kalibr chain) or ~calibration")
    if path.is_dir() and recognise(path):
        sequence = open_sequence(path)
        return Calibration(sequence.rig, sequence.imu_noise)
    return read_kalibr(path)


class _Node:
    """Subscribers that fill the worker's intake, and publishers behind it."""

    def __init__(self, rospy: Any, settings: Settings, calibration: Calibration) -> None:
        self._rospy = rospy
        self._live = settings.live
        self._worker = Worker(settings, calibration, _Publishers(rospy), rospy.logwarn)
        self._subscribe()

    def spin(self) -> None:
        """Look after inputs and master until shutdown; raises what ended the worker."""
        master = MasterWatch(self._rospy)
        while not self._rospy.is_shutdown():
            time.sleep(_LOOK_EVERY_S)  # not rospy.sleep: simulated time may stand
            for line in (*self._worker.look(), *master.look()):
                self._rospy.logwarn(line)

    def close(self) -> None:
        """End the worker and say what was done."""
        self._rospy.loginfo(self._worker.close())

    def _subscribe(self) -> None:
        from sensor_msgs.msg import CompressedImage, Image, Imu
        from std_srvs.srv import Trigger, TriggerResponse

        rospy, live, intake = self._rospy, self._live, self._worker.intake

        def on_image(side: Side) -> Callable[[Any], None]:
            return lambda message: intake.put_image(side, stamp_ns(message), message)

        def on_reset(_: Any) -> Any:
            intake.restart("reset asked for")
            return TriggerResponse(success=True, message="starting again, in a new segment")

        sides: tuple[tuple[Side, str], ...] = (("left", live.left), ("right", live.right))
        for side, topic in sides:
            kind = CompressedImage if topic.endswith("/compressed") else Image
            rospy.Subscriber(
                topic, kind, on_image(side), queue_size=_IMAGES_QUEUED, buff_size=_IMAGE_BUFFER,
                tcp_nodelay=True,
            )  # fmt: skip
        rospy.Subscriber(
            live.imu, Imu, lambda message: intake.put_imu(imu_sample(message)),
            queue_size=_IMU_QUEUED, tcp_nodelay=True,
        )  # fmt: skip
        rospy.Service("~reset", Trigger, on_reset)


class _Publishers:
    """A `Sink`: a publisher for every topic."""

    def __init__(self, rospy: Any) -> None:
        import genpy

        self._class_of = Ros1Classes()
        self._time_of = genpy.Time
        self._publishers = {
            topic: rospy.Publisher(topic, self._class_of(kind), queue_size=_RESULTS_QUEUED)
            for topic, kind in LIVE_TOPICS.items()
        }

    def wanted(self, topic: str) -> bool:
        """Does anybody listen to this topic?"""
        return bool(self._publishers[topic].get_num_connections() > 0)

    def send(self, published: Published) -> None:
        """Publish, where anybody listens."""
        if self.wanted(published.topic):
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
        raise InputError(f"ROS 1 is not there ({error}); {_REMEDY}") from None
    return rospy


def _require_master() -> None:
    import rosgraph

    if not rosgraph.is_master_online():
        uri = rosgraph.get_master_uri()
        raise OvmotError(f"no ROS master at {uri}: start one with 'roscore', or set ROS_MASTER_URI")
