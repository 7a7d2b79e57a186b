"""The classes of ROS 1's messages, and its stamps."""

from importlib import import_module
from typing import Any

_OWN = {"ovmot_msgs": "ovmot.ros.python.ovmot_msgs"}


class Ros1Classes:
    """Looks classes up by `package/Name`. Those of ovmot_msgs are the ones that come with ovmot.

    So no catkin workspace is needed; subscribers that have one get the same MD5 sum.
    """

    def __init__(self) -> None:
        self._known: dict[str, Any] = {}

    def __call__(self, type_name: str) -> Any:
        """The class; raises `ImportError` where its package is not installed."""
        if type_name not in self._known:
            package, _, name = type_name.partition("/")
            module = import_module(f"{_OWN.get(package, package)}.msg")
            self._known[type_name] = getattr(module, name)
        return self._known[type_name]


def stamp_ns(message: Any) -> int:
    """The stamp in a message's header."""
    stamp = message.header.stamp
    return int(stamp.secs) * 1_000_000_000 + int(stamp.nsecs)
