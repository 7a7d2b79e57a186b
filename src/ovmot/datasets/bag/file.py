"""A ROS bag, open for reading: topics and messages, and one clear line for whatever is broken.

By `rosbags`, without ROS: `.bag` of ROS 1, and `.mcap`, `.db3` or their folder of ROS 2.
"""

from collections import Counter
from collections.abc import Collection, Generator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from ovmot.errors import DatasetError, InputError
from ovmot.text_files import LFS_POINTER, LFS_REMEDY, is_lfs_pointer

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

    `types` maps each topic to its type, as `package/Name`, `counts` to how many messages it
    holds by the bag's own word. What cannot be read raises `DatasetError` with file and remedy.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        for file in [path] if path.is_file() else path.glob("*.db3"):
            if _is_pointer(file):
                raise DatasetError.at(file, LFS_POINTER, LFS_REMEDY)
            if file.suffix == ".db3" and _is_cut(file):
                raise self.unreadable(f"{file.name} is truncated")
        try:
            # bags of older ROS 2 hold no definitions
            self._reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
            self._reader.open()
        except Exception as error:  # rosbags lets through what sqlite, zstd and struct raise
            raise self.unreadable(_words(error)) from None
        self.types = {
            c.topic: c.msgtype.replace("/msg/", "/")
            for c in sorted(self._reader.connections, key=lambda c: c.topic)
        }
        self.counts: Counter[str] = Counter()
        for connection in self._reader.connections:
            self.counts[connection.topic] += connection.msgcount

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._reader.close()

    def unreadable(self, why: str) -> InputError:
        """The error for a bag that is broken, with a remedy."""
        remedy = _REMEDIES.get(self.path.suffix, _REMEDY)
        problem = f"cannot be read as a bag, or not to its end: {why}"
        return DatasetError.at(self.path, problem, remedy)

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
                raise self.unreadable(_words(error)) from None
            yield BagMessage(connection.topic, received_ns, value)


def _is_pointer(file: Path) -> bool:
    with file.open("rb") as opened:
        return is_lfs_pointer(opened.read(64))


def _is_cut(database: Path) -> bool:
    """Is an SQLite file shorter than it says? SQLite itself takes a half last page for zeros.

    Page size at byte 16, pages at byte 28, big-endian (SQLite's "Database File Format", 1.3).
    """
    with database.open("rb") as file:
        head = file.read(32)
    page = int.from_bytes(head[16:18], "big")
    bytes_told = (page if page > 1 else 65536) * int.from_bytes(head[28:32], "big")
    return len(head) < 32 or database.stat().st_size < bytes_told


def _words(error: Exception) -> str:
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__
