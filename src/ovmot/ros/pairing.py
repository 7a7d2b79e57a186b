"""Pairs of left and right images by their stamps."""

from collections import deque
from dataclasses import dataclass
from typing import Any, Literal

Side = Literal["left", "right"]
_WAITING = 10  # images of one camera whose other half has not come


@dataclass(frozen=True, slots=True)
class ImagePair:
    """Two messages of one exposure; the stamp (ns) is the left one's."""

    timestamp_ns: int
    left: Any
    right: Any


class StereoPairing:
    """Keeps images until their partner arrives, at most the ten newest of each camera.

    Pairs come out in the order of time: images older than the last pair are never paired.
    """

    def __init__(self, tolerance_ns: int) -> None:
        self._tolerance_ns = tolerance_ns
        self._waiting: dict[Side, deque[tuple[int, Any]]] = {"left": deque(), "right": deque()}
        self.unpaired = 0
        self.nearest_ns: int | None = None  # of the last image without a partner

    def add(self, side: Side, stamp_ns: int, message: Any) -> ImagePair | None:
        """The pair that this image completes, if it does."""
        others = self._waiting["right" if side == "left" else "left"]
        found = min(others, key=lambda other: abs(other[0] - stamp_ns), default=None)
        if found is None or abs(found[0] - stamp_ns) > self._tolerance_ns:
            self.nearest_ns = None if found is None else abs(found[0] - stamp_ns)
            self._keep(self._waiting[side], stamp_ns, message)
            return None
        self._drop_until(max(stamp_ns, found[0]))
        if side == "left":
            return ImagePair(stamp_ns, message, found[1])
        return ImagePair(found[0], found[1], message)

    def clear(self) -> None:
        """Drop the images that wait."""
        for waiting in self._waiting.values():
            waiting.clear()

    def _keep(self, waiting: deque[tuple[int, Any]], stamp_ns: int, message: Any) -> None:
        if len(waiting) == _WAITING:
            waiting.popleft()
            self.unpaired += 1
        waiting.append((stamp_ns, message))

    def _drop_until(self, stamp_ns: int) -> None:
        """Drop the images up to a pair's stamp.

        The pair's own waiting image is not counted as lost.
        """
        lost = -1
        for waiting in self._waiting.values():
            while waiting and waiting[0][0] <= stamp_ns:
                waiting.popleft()
                lost += 1
        self.unpaired += lost
