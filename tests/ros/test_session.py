"""The worker on a pipeline made by hand: what is published, and how it goes on."""

from collections import Counter
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ovmot.cameras.camera import Camera
from ovmot.cameras.rig import StereoRig
from ovmot.errors import OvmotError
from ovmot.geometry import se3
from ovmot.ros.intake import Intake
from ovmot.ros.messages import OBJECTS, OVERLAY, PATH, STATIC_POINTS, TF, TF_STATIC
from ovmot.ros.session import IMU_ODOMETRY, RESET_ASKED, Session
from ovmot.ros.values import Published
from ovmot.ros.watch import Line
from ovmot.settings import LiveSettings
from ovmot.types import Event, FrameResult, ImuSample, StereoFrame

MS = 1_000_000
WIDTH, HEIGHT = 60, 40


class Sink:
    """Remembers what was sent; listens to every topic but those left out."""

    def __init__(self, unwanted: tuple[str, ...] = ()) -> None:
        self.unwanted = unwanted
        self.sent: list[Published] = []

    def wanted(self, topic: str) -> bool:
        return topic not in self.unwanted

    def send(self, published: Published) -> None:
        self.sent.append(published)

    def topics(self) -> Counter[str]:
        return Counter(published.topic for published in self.sent)


class Odometry:
    """Gives the same result for each frame, with its stamp; breaks down at 13."""

    started, not_started_because = True, None

    def __init__(self, result: FrameResult) -> None:
        self.result = result
        self.counts: Counter[str] = Counter(resets=0)
        self.closed = False
        self.taken: list[Event] = []

    def add(self, event: Event) -> list[FrameResult]:
        self.taken.append(event)
        if isinstance(event, ImuSample):
            return []
        assert isinstance(event, StereoFrame)
        if event.timestamp_ns == 13 * MS:
            raise OvmotError("the estimate broke down")
        ego = replace(self.result.ego, timestamp_ns=event.timestamp_ns)
        return [replace(self.result, frame=event, ego=ego)]

    def latest(self) -> Any:
        return self.result.ego

    def ready(self) -> list[FrameResult]:
        return []

    def close(self) -> None:
        self.closed = True


class Setup:
    """A session, what it talks to, and what it says."""

    def __init__(self, result: FrameResult, sink: Sink, settings: LiveSettings) -> None:
        camera = Camera.make((WIDTH, HEIGHT), (50.0, 50.0), (30.0, 20.0), "none", [])
        T = se3.make(np.eye(3), np.array([0.5, 0.0, 0.0]))
        rig = StereoRig(camera, camera, np.eye(4), T)
        self.intake, self.sink = Intake(settings), sink
        self.said: list[str] = []
        self.levels: list[str] = []
        self.pipelines: list[Odometry] = []

        def make() -> Any:
            self.pipelines.append(Odometry(result))
            return self.pipelines[-1]

        self.session = Session(self.intake, make, rig, settings, sink, self._say)

    def _say(self, line: Line) -> None:
        self.said.append(line.text)
        self.levels.append(line.level)

    def frame(self, at_ms: int, width: int = WIDTH) -> None:
        message = SimpleNamespace(
            encoding="mono8", height=HEIGHT, width=width, step=width, is_bigendian=0,
            data=bytes(HEIGHT * width),
        )  # fmt: skip
        for side in ("left", "right"):
            self.intake.put_image(side, at_ms * MS, message)
        self.imu(at_ms)
        self.session.work_once()

    def imu(self, at_ms: int) -> None:
        self.intake.put_imu(ImuSample(at_ms * MS, np.zeros(3), np.zeros(3)))


@pytest.fixture
def setup(result: FrameResult) -> Setup:
    return Setup(result, Sink(unwanted=(OVERLAY,)), LiveSettings())


def test_a_frame_becomes_messages_and_the_imu_goes_on_between(setup: Setup) -> None:
    setup.frame(100)
    topics = setup.sink.topics()
    assert topics[TF] == topics[PATH] == 1 and topics[OVERLAY] == topics[IMU_ODOMETRY] == 0
    setup.imu(110)
    setup.imu(120)
    setup.session.work_once()
    assert setup.sink.topics()[IMU_ODOMETRY] == 2
    setup.imu(1200)  # the camera is silent: the IMU alone is no odometry
    setup.imu(1210)
    setup.session.work_once()
    assert setup.sink.topics()[IMU_ODOMETRY] == 3  # that of 120 ms, which waited for the next one


def test_spoilt_imu_samples_are_left_out(setup: Setup) -> None:
    """As in a run: a sample waits for the next one, which tells a spike from a jolt."""
    rng = np.random.default_rng(0)
    for k in range(150):
        accel = rng.normal(0.0, 0.1, 3) + np.array([0.0, 0.0, 100.0 if k == 120 else 9.8])
        setup.intake.put_imu(ImuSample(5 * k * MS, rng.normal(0.0, 0.01, 3), accel))
    setup.session.work_once()
    assert setup.session.counts["imu_spikes"] == 1
    taken = [event.timestamp_ns // (5 * MS) for event in setup.pipelines[0].taken]
    assert taken == [k for k in range(149) if k != 120]


def test_the_overlay_is_drawn_for_those_who_look(setup: Setup) -> None:
    setup.frame(100)
    setup.sink.unwanted = ()
    setup.frame(200)
    assert setup.sink.topics()[OVERLAY] == 1


def test_tf_can_be_left_to_others(result: FrameResult) -> None:
    setup = Setup(result, Sink(unwanted=(OVERLAY,)), LiveSettings(publish_tf=False))
    setup.frame(100)
    topics = setup.sink.topics()
    assert topics[TF] == topics[TF_STATIC] == 0 and topics[PATH] == 1


def test_a_restart_makes_a_new_pipeline_and_a_new_path(setup: Setup) -> None:
    setup.frame(10_000)
    setup.frame(100)  # ten seconds back
    assert setup.pipelines[0].closed and len(setup.pipelines) == 2
    assert any("went back by" in line and "new segment" in line for line in setup.said)
    paths = [p.message.fields["poses"] for p in setup.sink.sent if p.topic == PATH]
    assert [len(poses) for poses in paths] == [1, 1]  # type: ignore[arg-type]


def test_a_reset_that_was_asked_for_is_no_warning(setup: Setup) -> None:
    setup.frame(100)
    setup.intake.restart(RESET_ASKED)
    setup.session.work_once()
    setup.frame(200)
    setup.frame(5_200, width=WIDTH + 2)
    assert setup.levels == ["info", "warning"]
    assert setup.said[0].startswith(f"{RESET_ASKED}: starting again")


def test_no_id_comes_twice(setup: Setup) -> None:
    used: list[tuple[int, ...]] = []
    for at_ms in (20_000, 10_000, 100):  # back, twice
        setup.frame(at_ms)
        used.append(ids_of_objects(setup.sink) + ids_of_points(setup.sink))
    assert setup.session.counts["restarts"] == 2
    assert all(used) and len({i for ids in used for i in ids}) == sum(map(len, used))


def ids_of_objects(sink: Sink) -> tuple[int, ...]:
    objects: Any = newest(sink, OBJECTS)["objects"]
    return tuple(o.fields["id"] for o in objects)


def ids_of_points(sink: Sink) -> tuple[int, ...]:
    data: Any = newest(sink, STATIC_POINTS)["data"]
    return tuple(1000 + i for i in data.view("<i4").reshape(-1, 5)[:, 3].tolist())


def newest(sink: Sink, topic: str) -> Any:
    return [p for p in sink.sent if p.topic == topic][-1].message.fields


def test_a_breakdown_is_said_and_the_next_frame_goes_on(setup: Setup) -> None:
    setup.frame(10)
    setup.frame(13)
    setup.frame(20)
    assert setup.session.counts["restarts"] == 1 and setup.session.counts["results"] == 2
    assert "the estimate broke down: starting again, in a new segment" in setup.said


def test_an_image_of_another_size_is_refused_with_topic_and_remedy(setup: Setup) -> None:
    setup.frame(100, width=WIDTH + 2)
    setup.frame(200)
    assert setup.session.counts["refused"] == 1 and setup.session.counts["results"] == 1
    assert "/cam0/image_raw at 100000000 ns: the image is 62x40 pixels" in setup.said[0]
