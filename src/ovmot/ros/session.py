"""The worker of the live node: received data goes through the odometry, messages come out.

Nothing here knows a version of ROS: a `Sink` sends the messages.
"""

import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from typing import Literal, Protocol

import numpy as np

from ovmot import Odometry
from ovmot.cameras.rig import StereoRig
from ovmot.datasets.bag.images import stored_image
from ovmot.datasets.usable_events import PlausibleImu
from ovmot.errors import DatasetError, OvmotError
from ovmot.geometry.arrays import Image
from ovmot.outputs.trails import Trails
from ovmot.outputs.views import draw_view
from ovmot.ros.intake import Batch, Intake, WaitingPair
from ovmot.ros.messages import (
    OVERLAY,
    TF,
    TF_STATIC,
    TOPICS,
    FrameNames,
    PathSoFar,
    frame_messages,
    odometry,
    overlay_message,
)
from ovmot.ros.numbering import Numbers
from ovmot.ros.values import Published
from ovmot.ros.watch import Line
from ovmot.settings import LiveSettings
from ovmot.types import FrameResult, ImuSample, StereoFrame

IMU_ODOMETRY = "/ovmot/odometry/imu_rate"
LIVE_TOPICS = {**TOPICS, IMU_ODOMETRY: "nav_msgs/Odometry"}
"""Every topic of a live node and its type."""

RESET_ASKED = "reset asked for"

_WAIT_S = 0.1
_LOOK_S = 0.003  # while a result is awaited: it is there between two messages, too
_MOST_AWAITED = 500  # of frames before the start, most never have a result
_CARRY_NS = 1_000_000_000  # the IMU alone is no odometry for longer
_SAY_EVERY_S = 2.0
_LATENCIES = 10_000


class Sink(Protocol):
    """Where messages go."""

    def wanted(self, topic: str) -> bool:
        """Does anybody listen to this topic?"""
        ...

    def send(self, published: Published) -> None:
        """Publish a message on its topic."""
        ...


class Session:
    """Runs the odometry on an intake; after a restart or an error, with a new odometry.

    Use it from one thread. `counts` are the frames by what became of them, `say` tells the user.
    """

    def __init__(
        self,
        intake: Intake,
        make_odometry: Callable[[], Odometry],
        rig: StereoRig,
        settings: LiveSettings,
        sink: Sink,
        say: Callable[[Line], None],
    ) -> None:
        self._intake = intake
        self._make_odometry = make_odometry
        self._rig = rig
        self._settings = settings
        self._sink = sink
        self._say = say
        self._names = frame_names(settings)
        self._odometry = make_odometry()
        self.counts: Counter[str] = Counter()
        self._imu = PlausibleImu(self.counts)
        self._first = Numbers()  # of this odometry
        self._free = Numbers()
        self._path = PathSoFar()
        self._trails = Trails()
        self._newest_ns: int | None = None  # frame with a result
        self._said_s = dict[str, float]()
        self._arrived_s: dict[int, float] = {}  # by stamp, of frames without a result yet
        self._latency_s: deque[float] = deque(maxlen=_LATENCIES)

    def work_once(self) -> None:
        """Wait a moment for work and do it.

        An error is reported, and the next batch is taken as before.
        """
        awaited = self._odometry.started and bool(self._arrived_s)
        batch = self._intake.take(_LOOK_S if awaited else _WAIT_S)
        if batch.restart is not None:
            self._begin_again(batch.restart, "info" if batch.restart == RESET_ASKED else "warning")
        try:
            self._do(batch)
        except DatasetError as error:  # one message was bad
            self.counts["refused"] += 1
            self._say_seldom("refused", Line(f"{error}: left out"))
        except OvmotError as error:
            self._begin_again(str(error))

    def close(self) -> None:
        """End the odometry's threads."""
        self._odometry.close()

    def latency_ms(self, percent: float) -> float | None:
        """Percentile of the time from a pair's arrival to its odometry, None without a frame."""
        return float(1e3 * np.percentile(self._latency_s, percent)) if self._latency_s else None

    def _do(self, batch: Batch) -> None:
        for received in batch.imu:
            sample = self._imu.before(received)
            if sample is not None:
                self._publish_all(self._odometry.add(sample))
                self._publish_between(sample, batch)
        if batch.pair is not None:
            frame = decoded(batch.pair, self._settings, self._rig)
            self.counts["frames"] += 1
            self._arrived_s[frame.timestamp_ns] = batch.pair.arrived_s
            if len(self._arrived_s) > _MOST_AWAITED:
                del self._arrived_s[next(iter(self._arrived_s))]
            self._publish_all(self._odometry.add(frame))
            self._say_why_not_started()
        self._publish_all(self._odometry.ready())

    def _publish_all(self, results: Sequence[FrameResult]) -> None:
        for result in self._numbered(results):
            self._publish(result)
            self._note_latency(result.timestamp_ns)
            self._publish_overlay(result)

    def _note_latency(self, frame_ns: int) -> None:
        """A frame has its result; those before it have theirs or get none."""
        arrived_s = self._arrived_s.pop(frame_ns, None)
        if arrived_s is not None:
            self._latency_s.append(time.monotonic() - arrived_s)
        for older in [stamp for stamp in self._arrived_s if stamp < frame_ns]:
            del self._arrived_s[older]

    def _begin_again(self, why: str, level: Literal["info", "warning"] = "warning") -> None:
        self._say(Line(f"{why}: starting again, in a new segment", level))
        self.counts["restarts"] += 1
        self._first = self._free
        self._odometry.close()
        self._odometry = self._make_odometry()
        self._imu = PlausibleImu(self.counts)
        self._arrived_s.clear()
        self._trails = Trails()
        self._newest_ns = None
        self._said_s.pop("start", None)

    def _numbered(self, results: Sequence[FrameResult]) -> Iterator[FrameResult]:
        """The results, with segments and ids that no earlier odometry has used."""
        for result in results:
            stamp = result.timestamp_ns
            if not np.all(np.isfinite(result.ego.T_world_imu)):
                raise OvmotError(f"the pose at {stamp} ns is not finite")
            numbered = self._first.applied(result)
            self._free = self._free.beyond(numbered)
            if result.segment and numbered.segment != self._path.segment:
                self._say(Line(f"the motion was lost before {stamp} ns: started again there"))
            yield numbered

    def _publish(self, result: FrameResult) -> None:
        self.counts["results"] += 1
        self._newest_ns = result.timestamp_ns
        self._path = self._path.extended(result)
        for published in frame_messages(result, self._path, self._rig, self._names):
            if published.topic not in (TF, TF_STATIC) or self._settings.publish_tf:
                self._sink.send(published)

    def _publish_between(self, sample: ImuSample, batch: Batch) -> None:
        """Odometry at the IMU's rate, where somebody wants it and no frame is late."""
        newest = self._newest_ns
        if newest is None or batch.waiting or not self._sink.wanted(IMU_ODOMETRY):
            return
        if sample.timestamp_ns - newest > _CARRY_NS:
            return
        ego = self._odometry.latest()
        if ego is not None:
            self._sink.send(Published(IMU_ODOMETRY, odometry(ego, self._names)))

    def _publish_overlay(self, result: FrameResult) -> None:
        self._trails = self._trails.extended(result)
        if self._sink.wanted(OVERLAY):
            overlay = draw_view("objects", result, self._rig, self._trails)
            self._sink.send(overlay_message(result.timestamp_ns, overlay, self._names))

    def _say_why_not_started(self) -> None:
        if not self._odometry.started:
            self.counts["before_start"] += 1
            self._said_s.setdefault("start", time.monotonic())  # a quick start needs no words
            why = self._odometry.not_started_because or "no frame is covered by the IMU"
            self._say_seldom("start", Line(f"no start yet: {why}", "info"))

    def _say_seldom(self, subject: str, line: Line) -> None:
        now_s = time.monotonic()
        if now_s - self._said_s.get(subject, -np.inf) >= _SAY_EVERY_S:
            self._said_s[subject] = now_s
            self._say(line)


def frame_names(settings: LiveSettings) -> FrameNames:
    """What the settings call the frames."""
    return FrameNames(*settings.frames)


def decoded(waiting: WaitingPair, settings: LiveSettings, rig: StereoRig) -> StereoFrame:
    """The pair's images in grey; raises `DatasetError` with topic and stamp for a broken one."""
    pair = waiting.pair
    sides = ((settings.left, pair.left, rig.cam0), (settings.right, pair.right, rig.cam1))
    images: list[Image] = []
    for topic, message, camera in sides:
        where = f"{topic} at {pair.timestamp_ns} ns"
        image = stored_image(message, where).decode()
        height, width = image.shape
        if (width, height) != (camera.width, camera.height):
            raise DatasetError.at(
                where,
                f"the image is {width}x{height} pixels, its camera {camera.width}x{camera.height}",
                "give the calibration that belongs to these images",
            )
        images.append(image)
    return StereoFrame(pair.timestamp_ns, images[0], images[1])
