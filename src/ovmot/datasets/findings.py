"""What a reader noticed while it read: sentences for the user and counts for `run.json`."""

from dataclasses import dataclass, field


@dataclass(slots=True)
class Findings:
    """Collects counted warnings; a count of 0 leaves no trace."""

    warnings: list[str] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)

    def note(self, key: str, count: int, text: str) -> None:
        """Add `count` under `key`, and its sentence, if there is anything to say."""
        if count:
            self.warnings.append(text)
            self.counts[key] = self.counts.get(key, 0) + count
