"""The page of plainatch: the worst runs by name, with links to their pages."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fake_work import fail_on_seed_1, write_result

from ovmot.batch.batch import run_batch
from ovmot.batch.execute import Work
from ovmot.batch.jobs import Job
from ovmot.batch.page import badness
from ovmot.batch.plan import Plan
from ovmot.batch.work import Outcome

PLAN = Plan.model_validate(
    {
        "sequences": {"walk": {"features": "/nowhere/walk.txt"}},
        "settings": {"plain": {}},
        "seeds": 4,
    }
)


class InThisProcess:
    """An executor without processes."""

    def __call__(self, work: Work, jobs: object) -> Iterator[Outcome]:
        assert isinstance(jobs, tuple)
        return map(work, jobs)


def with_page(job: Job) -> Outcome:
    """A run, and its page where the seed is even."""
    outcome = write_result(job)
    if job.seed % 2 == 0:
        (job.folder / "report.html").write_text("a page")
    return outcome


def contents(out: Path) -> dict[str, Any]:
    page = (out / "report.html").read_text(encoding="utf-8")
    found = re.search(r'id="data">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    loaded: dict[str, Any] = json.loads(found[1])
    return loaded


def test_runs_spreads_and_the_worst(tmp_path: Path) -> None:
    run_batch(PLAN, tmp_path, InThisProcess(), with_page)
    data = contents(tmp_path)
    assert [run["name"] for run in data["runs"]] == [f"walk/plain/{seed}" for seed in range(4)]
    assert data["runs"][0]["report"] == "walk/plain/0/report.html"
    assert data["runs"][1]["report"] is None
    worst = {row["metric"]: row for row in data["worst"]}
    assert worst["ate_yaw_m"]["run"] == 3
    assert worst["ate_yaw_m"]["value"] == 4.0
    assert worst["ate_yaw_m"]["median"] == 2.5
    spread = next(row for row in data["spreads"] if row["metric"] == "ate_yaw_m")
    assert spread["values"] == [1.0, 2.0, 3.0, 4.0]
    assert spread["usual"]


def test_failures_are_named(tmp_path: Path) -> None:
    run_batch(PLAN, tmp_path, InThisProcess(), fail_on_seed_1_only)
    assert contents(tmp_path)["failures"] == {"walk/plain/1": "a.yaml, row 3: no number"}


def fail_on_seed_1_only(job: Job) -> Outcome:
    return fail_on_seed_1(job) if job.seed == 1 else write_result(job)


@pytest.mark.parametrize(
    ("metric", "better", "worse"),
    [
        ("ate_yaw_m", 0.1, 0.2),
        ("object_recall", 0.9, 0.8),
        ("nees_position", 3.5, 9.0),
        ("nees_position", 3.5, 0.5),  # too cautious is wrong too
    ],
)
def test_what_is_worse(metric: str, better: float, worse: float) -> None:
    assert badness(metric, worse) > badness(metric, better)
