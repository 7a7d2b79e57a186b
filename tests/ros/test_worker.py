"""The thread of a live node, fed by hand."""

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from ovmot.datasets import open_sequence
from ovmot.datasets.calibration import Calibration
from ovmot.datasets.stream import events
from ovmot.ros import messages
from ovmot.ros.inputs import input_topics
from ovmot.ros.intake import Intake
from ovmot.ros.typestore import filled, typestore
from ovmot.ros.values import Published, image
from ovmot.ros.watch import Line
from ovmot.ros.worker import Worker
from ovmot.settings import LiveSettings, Settings
from ovmot.types import ImuSample, StereoFrame

SETTINGS = Settings.model_validate(
    {
        "tracker": {
            "max_features": 120, "fine_columns": 16, "fast_threshold": 12,
            "equalization": "none", "klt_window_px": 13, "klt_levels": 5,
        },
        "initialization": {"window_s": 0.5},
        "live": {"queue_frames": 100},
    }
)  # fmt: skip

TOPICS = input_topics(SETTINGS.live, str)


class Heard:
    """A sink that keeps what is sent."""

    def __init__(self) -> None:
        self.sent: list[Published] = []

    def wanted(self, topic: str) -> bool:
        return topic == messages.ODOMETRY

    def send(self, published: Published) -> None:
        self.sent.append(published)

    def odometry(self) -> list[Published]:
        return [p for p in list(self.sent) if p.topic == messages.ODOMETRY]


def feed(data: Path, intake: Intake) -> None:
    for event in events(open_sequence(data)):
        if isinstance(event, ImuSample):
            intake.put_imu(event)
        else:
            assert isinstance(event, StereoFrame)
            stamp = event.timestamp_ns
            for side, pixels in zip(("left", "right"), event.pair, strict=True):
                message = filled(typestore(2), image(stamp, "cam", pixels))
                intake.put_image(side, stamp, message)  # type: ignore[arg-type]


def until(true: Callable[[], bool], seconds: float = 60.0) -> bool:
    ends = time.monotonic() + seconds
    while not true() and time.monotonic() < ends:
        time.sleep(0.02)
    return true()


def test_what_comes_in_goes_out_as_messages(painted_euroc: Path) -> None:
    sequence, heard, said = open_sequence(painted_euroc), Heard(), list[Line]()
    known = Calibration(sequence.rig, sequence.imu_noise)
    worker = Worker(SETTINGS, known, TOPICS, heard, said.append)
    feed(painted_euroc, worker.intake)
    assert until(lambda: len(heard.odometry()) >= 6)
    assert worker.look(None) == []
    summary = worker.close()
    assert summary.startswith("12 frames, ") and "0 dropped" in summary and "p95" in summary
    kinds = {p.topic for p in heard.sent}
    assert kinds == set(messages.TOPICS) - {messages.OVERLAY}


def test_what_ends_the_thread_is_raised_by_the_next_look(
    painted_euroc: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence = open_sequence(painted_euroc)
    known = Calibration(sequence.rig, sequence.imu_noise)
    worker = Worker(SETTINGS, known, TOPICS, Heard(), print)

    def broken(_: float) -> None:
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr(worker.intake, "take", broken)
    assert until(lambda: not worker._thread.is_alive())
    with pytest.raises(ZeroDivisionError, match="a defect"):
        worker.look(None)
    worker.close()


def test_live_settings_have_the_topics_that_a_sequence_bag_has() -> None:
    from ovmot.ros.bag_output import IMU, LEFT, RIGHT

    live = LiveSettings()
    assert (live.left, live.right, live.imu) == (LEFT, RIGHT, IMU)
