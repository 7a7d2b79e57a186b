"""Writes messages into a bag of either ROS, without ROS."""

import shutil
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag1 import WriterError as WriterError1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.rosbag2 import WriterError as WriterError2

from ovmot.errors import InputError, OvmotError
from ovmot.ros.messages import LATCHED
from ovmot.ros.typestore import filled, rosbags_name, typestore
from ovmot.ros.values import Published

_METADATA_VERSION: Literal[8] = (
    8  # the older one of those that rosbags writes: more of ROS 2 reads it
)
_FOREVER = QosTime(9223372036, 854775807)  # as ROS 2 writes an infinite duration
_LATCHED = Qos(
    QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL,
    _FOREVER, _FOREVER, QosLiveliness.AUTOMATIC, _FOREVER, False,
)  # fmt: skip
_ENDINGS = "end it in .bag (ROS 1) or .mcap (ROS 2), or in nothing: a folder with .db3 (ROS 2)"


class BagWriter:
    """A new bag; the ending chooses its kind: `.bag`, `.mcap`, or none: a folder with a `.db3`.

    A context manager. An `.mcap` stands in a folder `<name>.unfinished` until it is closed.
    Raises `InputError` where the bag is there already or cannot be made; with `replace`, an
    older bag is removed first, and nothing else.
    """

    def __init__(self, path: Path, *, replace: bool = False) -> None:
        if path.suffix not in ("", ".bag", ".mcap"):
            raise InputError.at(path, "no kind of bag has this ending", _ENDINGS)
        self.path = path
        if path.exists():
            _remove(path, replace)
        self._version = 1 if path.suffix == ".bag" else 2
        self._store = typestore(self._version)
        self._connections: dict[str, Any] = {}
        self._made_in = path
        self._writer: Writer1 | Writer2
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.suffix == ".bag":
                self._writer = Writer1(path)
            else:
                mcap = path.suffix == ".mcap"
                self._made_in = path.with_suffix(".unfinished") if mcap else path
                plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
                self._writer = Writer2(
                    self._made_in, version=_METADATA_VERSION, storage_plugin=plugin
                )
            self._writer.open()
        except (OSError, WriterError1, WriterError2) as error:
            problem = f"cannot make the bag ({_words(error)})"
            raise InputError.at(self._made_in, problem, "choose another name") from None
        self._open = True

    def write(self, published: Published, recorded_ns: int) -> None:
        """Append a message; raises `OvmotError` with the bag's name where the disk is full."""
        name = rosbags_name(published.message.type_name)
        value = filled(self._store, published.message)
        serialize = self._store.serialize_ros1 if self._version == 1 else self._store.serialize_cdr
        try:
            connection = self._connections.get(published.topic)
            if connection is None:
                connection = self._connect(published.topic, name)
                self._connections[published.topic] = connection
            self._writer.write(connection, recorded_ns, serialize(value, name))
        except Exception as error:  # a full disk is an error of sqlite in one kind, not in others
            raise OvmotError(f"{self.path}: cannot write any further: {_words(error)}") from None

    def _connect(self, topic: str, name: str) -> Any:
        """A connection; a player latches what a node would."""
        writer, is_latched = self._writer, topic in LATCHED
        if isinstance(writer, Writer1):
            return writer.add_connection(
                topic, name, typestore=self._store, latching=1 if is_latched else None
            )
        return writer.add_connection(
            topic,
            name,
            typestore=self._store,
            offered_qos_profiles=[_LATCHED] if is_latched else [],
        )

    def close(self) -> None:
        """Finish the bag; a second call does nothing. Raises `OvmotError`."""
        if not self._open:
            return
        self._open = False
        try:
            self._writer.close()
            if self._made_in != self.path:
                (self._made_in / f"{self._made_in.name}.mcap").replace(self.path)
                shutil.rmtree(self._made_in)
        except Exception as error:
            raise OvmotError(f"{self.path}: cannot be closed: {_words(error)}") from None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def _remove(path: Path, replace: bool) -> None:
    if not replace:
        raise InputError.at(path, "is already there", "replace it with --force")
    if path.is_file():
        path.unlink()
    elif (path / "metadata.yaml").is_file():
        shutil.rmtree(path)
    else:
        raise InputError.at(path, "is a folder, but no bag", "choose another name")


def _words(error: Exception) -> str:
    return " ".join(str(getattr(error, "strerror", None) or error).split()) or type(error).__name__
