"""The classes that catkin would generate, made on import by ROS 1's own generator.

They have the same MD5 sums. Only packages of ROS 1 are needed: `rostopic` runs with a Python that
has no ovmot.
"""

from importlib import import_module
from pathlib import Path
from typing import Any

_DEFINITIONS = Path(__file__).parents[3] / "share" / "ovmot_msgs" / "msg"
_USED = ("std_msgs/Header", "geometry_msgs/Pose", "geometry_msgs/Vector3")
_RULE = "\n" + "=" * 80 + "\n"


def _texts(name: str, full_text: str) -> dict[str, str]:
    """A definition and those that it needs, apart, by their names."""
    first, *others = full_text.split(_RULE)
    texts = {name: first}
    for other in others:
        title, _, text = other.partition("\n")
        texts[title.removeprefix("MSG: ").strip()] = text
    return texts


def _made() -> tuple[Any, Any]:
    """`Object` and `ObjectArray`; raises `ImportError` where ROS 1 is not installed."""
    from genpy.dynamic import generate_dynamic

    own = {f"ovmot_msgs/{file.stem}": file.read_text() for file in _DEFINITIONS.glob("*.msg")}
    texts = dict(own)
    for name in _USED:
        package, _, short = name.partition("/")
        texts.update(_texts(name, getattr(import_module(f"{package}.msg"), short)._full_text))
    core = "ovmot_msgs/ObjectArray"
    others = (f"MSG: {name}\n{text}" for name, text in texts.items() if name != core)
    made: dict[str, Any] = generate_dynamic(core, _RULE.join([texts[core], *others]))
    for name in own:
        made[name].__module__ = __name__
    return made["ovmot_msgs/Object"], made[core]


Object, ObjectArray = _made()
