"""The classes of ROS 1's messages, and its stamps."""

from importlib import import_module
from typing import Any

from ovmot.ros.typestore import own_definitions

_RULE = "\n" + "=" * 80 + "\n"
_OWN_PACKAGE = "ovmot_msgs"
_USED_BY_OWN = ("std_msgs/Header", "geometry_msgs/Pose", "geometry_msgs/Vector3")


class Ros1Classes:
    """Looks classes up by `package/Name`. Those of ovmot_msgs are made from our definitions.

    So no catkin workspace is needed; subscribers that have one get the same MD5 sum.
    """

    def __init__(self) -> None:
        self._known: dict[str, Any] = {}

    def __call__(self, type_name: str) -> Any:
        """The class; raises `ImportError` where its package is not installed."""
        if type_name not in self._known:
            package, _, name = type_name.partition("/")
            if package == _OWN_PACKAGE:
                self._known.update(_own_classes())
            else:
                self._known[type_name] = getattr(import_module(f"{package}.msg"), name)
        return self._known[type_name]


def stamp_ns(message: Any) -> int:
    """The stamp in a message's header."""
    stamp = message.header.stamp
    return int(stamp.secs) * 1_000_000_000 + int(stamp.nsecs)


def _own_classes() -> dict[str, Any]:
    """Classes of every definition of ours, by ROS 1's own generator."""
    from genpy.dynamic import generate_dynamic

    texts = own_definitions()
    for name in _USED_BY_OWN:
        package, _, short = name.partition("/")
        texts.update(_texts(name, getattr(import_module(f"{package}.msg"), short)._full_text))
    core = f"{_OWN_PACKAGE}/ObjectArray"
    others = (f"MSG: {name}\n{text}" for name, text in texts.items() if name != core)
    made: dict[str, Any] = generate_dynamic(core, _RULE.join([texts[core], *others]))
    return {name: made[name] for name in own_definitions()}


def _texts(name: str, full_text: str) -> dict[str, str]:
    """A definition and those that it needs, apart, by their names."""
    first, *others = full_text.split(_RULE)
    texts = {name: first}
    for other in others:
        title, _, text = other.partition("\n")
        texts[title.removeprefix("MSG: ").strip()] = text
    return texts
