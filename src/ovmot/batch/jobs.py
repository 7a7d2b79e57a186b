"""A plan taken apart into runs, and which of them are done already."""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ovmot
from ovmot.batch.plan import Plan, Recorded, Rendered, Sequence
from ovmot.settings import Settings

METRICS_JSON, JOB_JSON = "metrics.json", "job.json"


@dataclass(frozen=True, slots=True)
class RenderJob:
    """A sequence to be rendered into `folder` for one seed."""

    name: str
    sequence: Rendered
    seed: int
    folder: Path


@dataclass(frozen=True, slots=True)
class RunJob:
    """One run into `folder`; `data` is the sequence's folder, None for a feature simulation."""

    sequence_name: str
    settings_name: str
    seed: int
    sequence: Sequence
    settings: Settings
    folder: Path
    data: Path | None

    @property
    def name(self) -> str:
        """What a person calls it."""
        return f"{self.sequence_name}/{self.settings_name}/{self.seed}"

    @property
    def identity(self) -> str:
        """A hash of all that its result follows from, but the data's own bytes."""
        what = {
            "sequence": self.sequence.model_dump(mode="json"),
            "settings": self.settings.model_dump(mode="json"),
            "seed": self.seed,
            "version": ovmot.__version__,
        }
        return hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()


Job = RenderJob | RunJob


def run_jobs(plan: Plan, out: Path, seeds: tuple[int, ...]) -> tuple[RunJob, ...]:
    """Every run of a plan: sequences x settings x seeds, recorded sequences with seed 0 only."""
    return tuple(
        RunJob(
            name, settings_name, seed, sequence, plan.settings_of(settings_name),
            out / name / settings_name / str(seed), _data_of(sequence, out, name, seed),
        )
        for name, sequence in plan.sequences.items()
        for seed in ((0,) if isinstance(sequence, Recorded) else seeds)
        for settings_name in plan.settings
    )  # fmt: skip


def render_jobs(runs: tuple[RunJob, ...]) -> tuple[RenderJob, ...]:
    """What has to be rendered for these runs: each sequence and seed once, if not there already."""
    wanted = {
        run.data: RenderJob(f"render {run.sequence_name}/{run.seed}", run.sequence, run.seed,
                            run.data)
        for run in runs
        if isinstance(run.sequence, Rendered) and run.data is not None and not run.data.is_dir()
    }  # fmt: skip
    return tuple(wanted.values())


def is_done(job: RunJob) -> bool:
    """Whether the folder holds the finished run of exactly this job."""
    note = read_json(job.folder / JOB_JSON)
    return note is not None and note.get("identity") == job.identity and bool(result_of(job))


def result_of(job: RunJob) -> dict[str, float | None] | None:
    """The metrics of a finished run, None where there are none."""
    return read_json(job.folder / METRICS_JSON)


def read_json(path: Path) -> dict[str, Any] | None:
    """The object in a JSON file; None for a file that is missing or cut off."""
    try:
        loaded = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return loaded if isinstance(loaded, dict) else None


def _data_of(sequence: Sequence, out: Path, name: str, seed: int) -> Path | None:
    if isinstance(sequence, Recorded):
        return sequence.data
    if isinstance(sequence, Rendered):
        spec = json.dumps(sequence.model_dump(mode="json"), sort_keys=True) + ovmot.__version__
        return out / "data" / name / f"{seed}-{hashlib.sha256(spec.encode()).hexdigest()[:8]}"
    return None
