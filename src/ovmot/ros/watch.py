"""Says which input is silent and why, and what has been lost since the last look; pure."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace

from ovmot.ros.inputs import STREAMS, InputTopic, why_silent

SILENT_S = 1.0
_REMIND_S = 30.0
_REPORT_S = 5.0
_PAIRS = "pairs"


@dataclass(frozen=True, slots=True)
class Sight:
    """What is there at one look, at `now_s` of the monotonic clock.

    `counts` are the intake's, `apart_s` is how far the stamps of images without a partner are from
    each other (None: there are none), `published` the types of all topics that anybody publishes
    (None: not known).
    """

    now_s: float
    counts: Counter[str]
    apart_s: float | None = None
    published: Mapping[str, str] | None = None


@dataclass(frozen=True, slots=True)
class Watch:
    """What was seen at the last look: counts, when each stream last grew, and what was said when.

    `silent_s` holds the silent streams, and when that was last said.
    """

    topics: Mapping[str, InputTopic]
    counts: Counter[str]
    grew_s: Mapping[str, float]
    silent_s: Mapping[str, float]
    reported_s: float
    reported: Counter[str]

    @classmethod
    def begin(cls, topics: Mapping[str, InputTopic], now_s: float) -> "Watch":
        """Nothing has come yet on the topics of the streams."""
        grew_s = dict.fromkeys((*STREAMS, _PAIRS), now_s)
        return cls(topics, Counter(), grew_s, {}, now_s, Counter())

    def look(self, sight: Sight) -> tuple["Watch", list[str]]:
        """The watch after this look, and lines for the user."""
        now_s, counts = sight.now_s, sight.counts
        grew_s = {
            name: now_s if counts[name] > self.counts[name] else then
            for name, then in self.grew_s.items()
        }
        silent = [name for name, then in grew_s.items() if now_s - then >= SILENT_S]
        if "left" in silent or "right" in silent:
            silent = [name for name in silent if name != _PAIRS]  # no wonder
        due = [n for n in silent if now_s - self.silent_s.get(n, -_REMIND_S) >= _REMIND_S]
        lines = [self._silence(name, now_s - grew_s[name], sight) for name in due]
        lines += [
            f"{self.topics[name].name}: messages again"
            for name in STREAMS
            if name in self.silent_s and name not in silent
        ]
        silent_s = {name: now_s if name in due else self.silent_s[name] for name in silent}
        seen = replace(self, counts=counts, grew_s=grew_s, silent_s=silent_s)
        if now_s - self.reported_s < _REPORT_S:
            return seen, lines
        lines += _losses(counts, self.reported)
        return replace(seen, reported_s=now_s, reported=counts), lines

    def _silence(self, name: str, silent_s: float, sight: Sight) -> str:
        if name == _PAIRS:
            apart = "unknown" if sight.apart_s is None else f"{1e3 * sight.apart_s:.1f} ms"
            return (
                f"left and right images do not make pairs: their stamps are {apart} apart; "
                "see live.pair_tolerance_s"
            )
        line = f"{self.topics[name].name}: nothing for {silent_s:.0f} s"
        topic, published = self.topics[name], sight.published
        if published is None:
            return line
        if not sight.counts[name]:
            return f"{line}: {why_silent(topic, published)}"
        return line if topic.name in published else f"{line}: nobody publishes it any more"


def _losses(counts: Counter[str], before: Counter[str]) -> list[str]:
    new = counts - before
    what = {
        "dropped": "frames dropped: the machine is too slow, or the IMU is late",
        "late": "messages out of order: left out",
        "unpaired": "images without a partner: left out",
    }
    return [f"{new[name]} {text}" for name, text in what.items() if new[name]]
