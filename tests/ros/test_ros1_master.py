"""The look at the ROS master, with a master made by hand."""

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from ovmot.ros.ros1_master import MasterWatch


class Master:
    """Answers with `pid`; None is a master that is gone."""

    pid: int | None = 1

    def __init__(self, name: str) -> None:
        assert name == "/ovmot"

    def getPid(self) -> int:
        if self.pid is None:
            raise ConnectionRefusedError
        return self.pid

    def getPublishedTopics(self, subgraph: str) -> list[list[str]]:
        if self.pid is None:
            raise ConnectionRefusedError
        return [["/imu0", "sensor_msgs/Imu"]]


@pytest.fixture
def registered(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Stands in for rospy's registration; what is registered again is in the list."""
    seen: list[str] = []
    listeners = SimpleNamespace(notify_added=lambda name, uri, kind: seen.append(name))
    topics = SimpleNamespace(
        get_publications=lambda: [("/ovmot/tracks", "x")],
        get_subscriptions=lambda: [("/imu0", "y")],
    )
    registration: Any = ModuleType("rospy.impl.registration")
    registration.get_registration_listeners = lambda: listeners
    registration.get_topic_manager = lambda: topics
    registration.get_service_manager = lambda: SimpleNamespace(get_services=lambda: [])
    registration.Registration = SimpleNamespace(PUB="pub", SUB="sub", SRV="srv")
    rosgraph: Any = ModuleType("rosgraph")
    rosgraph.Master = Master
    implementation: Any = ModuleType("rospy.impl")
    implementation.registration = registration
    for name, module in (
        ("rosgraph", rosgraph), ("rospy", ModuleType("rospy")), ("rospy.impl", implementation),
        ("rospy.impl.registration", registration),
    ):  # fmt: skip
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.setattr(Master, "pid", 1)
    return seen


def test_a_master_that_goes_and_comes_is_said_once_each(
    registered: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    watch = MasterWatch(SimpleNamespace(get_name=lambda: "/ovmot"))
    assert watch.look() == []
    assert watch.published() == {"/imu0": "sensor_msgs/Imu"}
    monkeypatch.setattr(Master, "pid", None)
    assert ["gone" in line.text for line in watch.look()] == [True]
    assert watch.look() == []
    assert watch.published() is None
    assert registered == []
    monkeypatch.setattr(Master, "pid", 2)
    assert [(line.level, "registered" in line.text) for line in watch.look()] == [("info", True)]
    assert registered == ["/ovmot/tracks", "/imu0"]
