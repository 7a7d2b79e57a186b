"""What is ROS 1's own: its stamps."""

from types import SimpleNamespace

from ovmot.ros.ros1_messages import stamp_ns


def test_a_stamp_keeps_its_nanoseconds() -> None:
    stamp = SimpleNamespace(secs=1_700_000_000, nsecs=123_456_789)
    message = SimpleNamespace(header=SimpleNamespace(stamp=stamp))
    assert stamp_ns(message) == 1_700_000_000_123_456_789
