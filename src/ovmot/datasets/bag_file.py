"""A ROS bag, open for reading: topics and messages, and one clear line for whatever is broken.

By `rosbags`, without ROS: `.bag` of ROS 1, and `.mcap`, `.db3` or their folder of ROS 2.
"""

from collections.abc import Collection, Generator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from ovmot.errors import DatasetError

_REMEDIES = {
    ".bag": "copy the bag again, or repair it with 'rosbag reindex'",
    ".mcap": "copy the bag again, or repair it with 'mcap recover'",
}
_REMEDY = "copy the bag again, or repair it with 'ros2 bag reindex'"
_METADATA = "metadata.yaml"


@dataclass(frozen=True, slots=True)
class BagMessage:
    """One message: when it was recorded (ns), and its fields by their ROS names."""

    topic: str
    received_ns: int
    value: Any


def bag_at(path: Path) -> Path | None:
    """The bag that a file or folder is, or a folder's only one; None where there is none."""
    if path.is_file():
        return path if path.suffix in (".bag", ".mcap", ".db3") else None
    if (path / _METADATA).is_file():
        return path
    files = [f for ending in ("*.mcap", "*.db3") for f in path.glob(ending)]
    return files[0] if len(files) == 1 else None


class Bag:
    """A bag open for reading; a context manager.

    `types` maps each topic to its type, as `package/Name`. What cannot be read raises
    `DatasetError` with file and remedy.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            # bags of older ROS 2 hold no definitions
            self._reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
            self._reader.open()
        except Exception as error:  # rosbags lets through what sqlite, zstd and struct raise
            raise _unreadable(path, error) from None
        self.types = {
            c.topic: c.msgtype.replace("/msg/", "/")
            for c in sorted(self._reader.connections, key=lambda c: c.topic)
        }

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._reader.close()

    def messages(
        self, topics: Collection[str], start_ns: int | None = None, stop_ns: int | None = None
    ) -> Generator[BagMessage, None, None]:
        """Messages of some topics in the order of recording, from `start_ns` to before `stop_ns`.

        One at a time: no more than a chunk of the bag is in memory.
        """
        wanted = [c for c in self._reader.connections if c.topic in topics]
        if not wanted:  # rosbags would take it for all of them
            return
        stored = self._reader.messages(wanted, start_ns, stop_ns)
        while True:
            try:
                connection, received_ns, data = next(stored)
                value = self._reader.deserialize(data, connection.msgtype)
            except StopIteration:
                return
            except Exception as error:
                raise _unreadable(self.path, error) from None
            yield BagMessage(connection.topic, received_ns, value)


def _unreadable(path: Path, error: Exception) -> DatasetError:
    why = " ".join(str(error).split()).rstrip(".") or type(error).__name__
    remedy = _REMEDIES.get(path.suffix, _REMEDY)
    return DatasetError(f"{path}: cannot be read as a bag, or not to its end: {why}; {remedy}")
