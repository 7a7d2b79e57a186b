"""Says which input is silent, and what has been lost since the last look; pure."""

from collections import Counter
from dataclasses import dataclass, replace

SILENT_S = 1.0
_REPORT_S = 5.0
_STREAMS = ("left", "right", "imu")


@dataclass(frozen=True, slots=True)
class Watch:
    """What was seen at the last look: counts, when each stream last grew, which are silent."""

    counts: Counter[str]
    grew_s: dict[str, float]
    silent: frozenset[str]
    reported_s: float
    reported: Counter[str]

    @classmethod
    def begin(cls, now_s: float) -> "Watch":
        """Nothing has come yet."""
        names = (*_STREAMS, "pairs")
        return cls(Counter(), dict.fromkeys(names, now_s), frozenset(), now_s, Counter())

    def look(
        self, now_s: float, counts: Counter[str], topics: dict[str, str], apart_s: float | None
    ) -> tuple["Watch", list[str]]:
        """The watch after a look at `counts`, and lines for the user.

        `topics` names the topic of each stream; `apart_s` is how far the stamps of images without
        a partner are from each other, None where there are none.
        """
        grew_s = {
            name: now_s if counts[name] > self.counts[name] else then
            for name, then in self.grew_s.items()
        }
        silent = frozenset(name for name, then in grew_s.items() if now_s - then >= SILENT_S)
        lines = [f"{topics[n]}: nothing for {SILENT_S:g} s" for n in _in(silent - self.silent)]
        lines += [f"{topics[n]}: messages again" for n in _in(self.silent - silent)]
        if "pairs" in silent - self.silent and not {"left", "right"} & silent:
            apart = "unknown" if apart_s is None else f"{1e3 * apart_s:.1f} ms"
            lines.append(
                f"left and right images do not make pairs: their stamps are {apart} apart; "
                "see live.pair_tolerance_s"
            )
        seen = replace(self, counts=counts, grew_s=grew_s, silent=silent)
        if now_s - self.reported_s < _REPORT_S:
            return seen, lines
        lines += _losses(counts, self.reported)
        return replace(seen, reported_s=now_s, reported=counts), lines


def _in(names: frozenset[str]) -> list[str]:
    return [name for name in _STREAMS if name in names]


def _losses(counts: Counter[str], before: Counter[str]) -> list[str]:
    new = counts - before
    what = {
        "dropped": "frames dropped: the machine is too slow, or the IMU is late",
        "late": "messages out of order: left out",
        "unpaired": "images without a partner: left out",
    }
    return [f"{new[name]} {text}" for name, text in what.items() if new[name]]
