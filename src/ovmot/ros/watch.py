"""Reports which input is silent and why, and what was lost since the last look: pure functions."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from ovmot.ros.inputs import STREAMS, InputTopic, why_silent

SILENT_S = 1.0
_REMIND_S = 30.0  # and after twice the time, and so on
_REPORT_S = 5.0  # losses, and new reasons for a silence, no more often
_PAIRS, _SUBJECT = "pairs", "pairs of left and right"


class Line(NamedTuple):
    """A line for the user; a warning unless everything is as it should be."""

    text: str
    level: Literal["info", "warning"] = "warning"


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
class _Said:
    """What was last said of a silent stream, and after how long a silence."""

    why: str
    after_s: float

    def is_enough(self, why: str, silent_s: float) -> bool:
        """Is there nothing to add?"""
        if why != self.why:
            return silent_s < self.after_s + _REPORT_S
        return silent_s < max(_REMIND_S, 2.0 * self.after_s)


@dataclass(frozen=True, slots=True)
class Watch:
    """What was seen at the last look: counts, when each stream last grew, what was said of those
    that are silent."""

    topics: Mapping[str, InputTopic]
    counts: Counter[str]
    grew_s: Mapping[str, float]
    said: Mapping[str, _Said]
    reported_s: float
    reported: Counter[str]

    @classmethod
    def begin(cls, topics: Mapping[str, InputTopic], now_s: float) -> "Watch":
        """Nothing has come yet on the topics of the streams."""
        grew_s = dict.fromkeys((*STREAMS, _PAIRS), now_s)
        return cls(topics, Counter(), grew_s, {}, now_s, Counter())

    def look(self, sight: Sight) -> tuple["Watch", list[Line]]:
        """The watch after this look, and lines for the user."""
        now_s, counts = sight.now_s, sight.counts
        grew_s = {
            name: now_s if counts[name] > self.counts[name] else then
            for name, then in self.grew_s.items()
        }
        silent_s = {name: now_s - then for name, then in grew_s.items() if now_s - then >= SILENT_S}
        if "left" in silent_s or "right" in silent_s:
            silent_s.pop(_PAIRS, None)  # no wonder
        lines, said = list[Line](), dict[str, _Said]()
        for name, duration_s in silent_s.items():
            before = self.said.get(name)
            why = self._why(name, sight, "" if before is None else before.why)
            if before is not None and before.is_enough(why, duration_s):
                said[name] = before
                continue
            said[name] = _Said(why, duration_s)
            subject = _SUBJECT if name == _PAIRS else self.topics[name].name
            lines.append(Line(f"{subject}: nothing for {duration_s:.0f} s{why}"))
        lines += [
            Line(
                f"{self.topics[name].name}: messages {'again' if self.counts[name] else 'come'}",
                "info",
            )
            for name in STREAMS
            if name in self.said and name not in silent_s
        ]
        seen = replace(self, counts=counts, grew_s=grew_s, said=said)
        if now_s - self.reported_s < _REPORT_S:
            return seen, lines
        lines += [Line(text) for text in _losses(counts, self.reported)]
        return replace(seen, reported_s=now_s, reported=counts), lines

    def _why(self, name: str, sight: Sight, before: str) -> str:
        """The likely reason of a silence, appended to its report; the earlier one where none is
        known.

        How far apart stamps are changes with each pair: that is said once.
        """
        if name == _PAIRS:
            apart = "unknown" if sight.apart_s is None else f"{1e3 * sight.apart_s:.1f} ms"
            return before or f": their stamps are {apart} apart; see live.pair_tolerance_s"
        topic, published = self.topics[name], sight.published
        if published is None:
            return before
        if not sight.counts[name]:
            return f": {why_silent(topic, published)}"
        return "" if topic.name in published else ": nobody publishes it any more"


def _losses(counts: Counter[str], before: Counter[str]) -> list[str]:
    new = counts - before
    what = {
        "dropped": "frames dropped: the machine is too slow, or the IMU is late",
        "late": "messages out of order: left out",
        "unpaired": "images without a partner: left out",
    }
    return [f"{new[name]} {text}" for name, text in what.items() if new[name]]
