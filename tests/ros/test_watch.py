"""Silent inputs and losses are said once, and again after a while."""

from collections import Counter
from collections.abc import Mapping

from ovmot.ros.inputs import InputTopic
from ovmot.ros.watch import Sight, Watch

IMAGE, IMU = "sensor_msgs/Image", "sensor_msgs/Imu"
TOPICS = {
    "left": InputTopic("/l", IMAGE),
    "right": InputTopic("/r", IMAGE),
    "imu": InputTopic("/i", IMU),
}
PUBLISHED = {"/l": IMAGE, "/r": IMAGE, "/i": IMU}


def begin() -> Watch:
    return Watch.begin(TOPICS, 0.0)


def look(
    watch: Watch, now_s: float, published: Mapping[str, str] | None = None, **counts: int
) -> tuple[Watch, list[str]]:
    watch, lines = watch.look(Sight(now_s, Counter(counts), 0.012, published))
    return watch, [line.text for line in lines]


def test_that_messages_come_is_no_warning() -> None:
    watch, silence = begin().look(Sight(1.1, Counter(left=1, right=1, pairs=1)))
    _, arrival = watch.look(Sight(1.6, Counter(left=2, right=2, pairs=2, imu=5)))
    assert [line.level for line in (*silence, *arrival)] == ["warning", "info"]


def test_silence_and_its_end_are_said_once() -> None:
    watch, lines = look(begin(), 0.5, left=1, right=1, imu=9, pairs=1)
    assert lines == []
    watch, lines = look(watch, 1.4, left=9, right=9, imu=9, pairs=9)
    assert lines == []
    watch, lines = look(watch, 1.6, left=10, right=10, imu=9, pairs=10)
    assert lines == ["/i: nothing for 1 s"]
    watch, lines = look(watch, 1.7, left=11, right=11, imu=9, pairs=11)
    assert lines == []
    watch, lines = look(watch, 1.8, left=12, right=12, imu=10, pairs=12)
    assert lines == ["/i: messages again"]


def test_a_topic_that_never_comes_is_said_again_with_those_that_are_there() -> None:
    there = {"/camera/l": IMAGE, "/r": IMAGE, "/i": IMU}
    watch, said = begin(), []
    for second in range(1, 130):
        watch, lines = look(watch, second, there, right=second, imu=second)
        said += [line for line in lines if line.startswith("/l")]
    assert said == [
        f"/l: nothing for {s} s: nobody publishes it; topics of sensor_msgs/Image: /camera/l, /r"
        for s in (1, 30, 60, 120)
    ]


def test_a_reason_that_comes_later_is_said_later() -> None:
    watch, lines = look(begin(), 1.0, {}, left=1, right=0, imu=1)
    assert lines == ["/r: nothing for 1 s: nobody publishes it, nor any other sensor_msgs/Image"]
    watch, lines = look(watch, 2.0, {"/x": IMAGE}, left=2, imu=2)  # the bag begins
    assert lines == []
    watch, lines = look(watch, 6.0, {"/x": IMAGE}, left=3, imu=3)
    assert lines[0] == ("/r: nothing for 6 s: nobody publishes it; topics of sensor_msgs/Image: /x")
    _, lines = look(watch, 12.0, None, left=4, imu=4)  # the master is gone: nothing new
    assert not any(line.startswith("/r") for line in lines)


def test_a_topic_that_came_once_is_not_taken_for_a_wrong_name() -> None:
    watch, _ = look(begin(), 0.5, PUBLISHED, left=1, right=1, imu=1, pairs=1)
    _, lines = look(watch, 2.0, {"/r": IMAGE, "/i": IMU}, left=1, right=9, imu=1, pairs=1)
    assert lines == ["/l: nothing for 2 s: nobody publishes it any more", "/i: nothing for 2 s"]


def test_left_without_right_is_said_of_the_right_one_only() -> None:
    _, lines = look(begin(), 1.1, {"/l": IMAGE, "/i": IMU}, left=10, imu=100)
    assert len(lines) == 1 and lines[0].startswith("/r: nothing for 1 s: nobody publishes it")


def test_the_first_messages_are_said_after_a_silence() -> None:
    watch, _ = look(begin(), 1.1, left=1, right=1, pairs=1)
    _, lines = look(watch, 1.6, left=2, right=2, pairs=2, imu=5)
    assert lines == ["/i: messages come"]


def test_images_that_never_pair_are_said_with_their_distance() -> None:
    watch, lines = look(begin(), 1.1, PUBLISHED, left=10, right=10, imu=100)
    assert len(lines) == 1 and lines[0].startswith("pairs of left and right: nothing for 1 s")
    assert "12.0 ms apart" in lines[0]
    _, lines = look(watch, 1.6, PUBLISHED, left=15, right=15, imu=150)
    assert lines == []


def test_losses_are_added_up_and_said_every_five_seconds() -> None:
    busy = {"left": 9, "right": 9, "imu": 9, "pairs": 9}
    watch, lines = look(begin(), 0.9, None, dropped=3, **busy)
    assert lines == []
    watch, lines = look(watch, 5.0, dropped=4, left=10, right=10, imu=10, pairs=10)
    assert lines == ["4 frames dropped: the machine is too slow, or the IMU is late"]
    _, lines = look(watch, 5.5, dropped=4, left=11, right=11, imu=11, pairs=11)
    assert lines == []
