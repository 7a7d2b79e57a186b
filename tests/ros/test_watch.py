"""Silent inputs and losses are said once."""

from collections import Counter

from ovmot.ros.watch import Watch

TOPICS = {"left": "/l", "right": "/r", "imu": "/i"}


def look(watch: Watch, now_s: float, **counts: int) -> tuple[Watch, list[str]]:
    return watch.look(now_s, Counter(counts), TOPICS, 0.012)


def test_silence_and_its_end_are_said_once() -> None:
    watch, lines = look(Watch.begin(0.0), 0.5, left=1, right=1, imu=9, pairs=1)
    assert lines == []
    watch, lines = look(watch, 1.4, left=9, right=9, imu=9, pairs=9)
    assert lines == []
    watch, lines = look(watch, 1.6, left=10, right=10, imu=9, pairs=10)
    assert lines == ["/i: nothing for 1 s"]
    watch, lines = look(watch, 1.7, left=11, right=11, imu=9, pairs=11)
    assert lines == []
    watch, lines = look(watch, 1.8, left=12, right=12, imu=10, pairs=12)
    assert lines == ["/i: messages again"]


def test_images_that_never_pair_are_said_with_their_distance() -> None:
    _, lines = look(Watch.begin(0.0), 1.1, left=10, right=10, imu=100)
    assert len(lines) == 1 and "12.0 ms apart" in lines[0]


def test_losses_are_added_up_and_said_every_five_seconds() -> None:
    busy = {"left": 9, "right": 9, "imu": 9, "pairs": 9}
    watch, lines = look(Watch.begin(0.0), 0.9, dropped=3, **busy)
    assert lines == []
    watch, lines = look(watch, 5.0, dropped=4, left=10, right=10, imu=10, pairs=10)
    assert lines == ["4 frames dropped: the machine is too slow, or the IMU is late"]
    _, lines = look(watch, 5.5, dropped=4, left=11, right=11, imu=11, pairs=11)
    assert lines == []
