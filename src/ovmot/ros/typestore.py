"""The classes of `rosbags` for both ROS versions, and our messages turned into them."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from ovmot.ros.environment import SHARE
from ovmot.ros.values import Message, Time, Value

_OWN = "ovmot_msgs"
_TF = "geometry_msgs/TransformStamped[] transforms\n"


@cache
def typestore(ros_version: int) -> Typestore:
    """The standard types of ROS 1 (Noetic) or ROS 2 (Humble), tf2_msgs and ovmot_msgs with them."""
    store = get_typestore(Stores.ROS1_NOETIC if ros_version == 1 else Stores.ROS2_HUMBLE)
    definitions = own_definitions()
    if "tf2_msgs/msg/TFMessage" not in store.fielddefs:
        definitions["tf2_msgs/TFMessage"] = _TF
    types: dict[str, Any] = {}
    for name, text in definitions.items():
        types.update(get_types_from_msg(text, rosbags_name(name)))
    store.register(types)
    return store


def own_definitions() -> dict[str, str]:
    """The text of each message that ovmot defines itself, by its ROS name."""
    files = sorted((SHARE / _OWN / "msg").glob("*.msg"))
    return {f"{_OWN}/{file.stem}": file.read_text() for file in files}


def rosbags_name(type_name: str) -> str:
    """`package/Name` as rosbags and ROS 2 write it: `package/msg/Name`."""
    package, _, name = type_name.partition("/")
    return f"{package}/msg/{name}"


def filled(store: Typestore, message: Message) -> object:
    """The message as an instance of the store's class; fields left out take their defaults.

    Raises `KeyError` for a type or a field that the store does not have.
    """
    return _instance(store, rosbags_name(message.type_name), message)


def _instance(store: Typestore, name: str, message: Message | None) -> object:
    fields = dict(store.fielddefs[name][1])
    given = {} if message is None else message.fields
    unknown = given.keys() - fields.keys()
    if unknown:
        raise KeyError(f"{name} has no field {', '.join(sorted(unknown))}")
    values: dict[str, Any] = {
        key: _value(store, kind, given.get(key)) for key, kind in fields.items()
    }
    return store.types[name](**values)


def _value(store: Typestore, kind: Any, given: Value | None) -> object:
    node, detail = kind
    if node == Nodetype.BASE:
        return _CASTS[_family(detail[0])](0 if given is None else given)
    if node == Nodetype.NAME:
        if isinstance(given, Time):
            seconds, rest = given.parts
            return store.types[detail](sec=seconds, nanosec=rest)
        assert given is None or isinstance(given, Message)
        return _instance(store, detail, given)
    (inner, inner_detail), size = detail
    if inner == Nodetype.BASE and inner_detail[0] != "string":
        count = size if node == Nodetype.ARRAY else 0
        return np.asarray(np.zeros(count) if given is None else given, dtype=inner_detail[0])
    items: Any = () if given is None else given
    return [_value(store, (inner, inner_detail), item) for item in items]


def _family(base: str) -> str:
    return base.rstrip("0123456789").lstrip("u")


_CASTS: dict[str, Callable[[Any], object]] = {
    "bool": bool,
    "int": int,
    "byte": int,
    "char": int,
    "octet": int,
    "float": float,
    "string": lambda given: str(given or ""),
}
