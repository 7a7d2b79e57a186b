"""A batch does what is not done, survives what dies, and adds up rightly."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from fake_work import fail_on_seed_1, write_result

from ovmot.batch.batch import run_batch
from ovmot.batch.execute import LocalProcesses, Work
from ovmot.batch.jobs import METRICS_JSON, Job
from ovmot.batch.plan import Plan
from ovmot.batch.summary import BatchSummary
from ovmot.batch.work import Outcome


def plan_of(seeds: int = 4, **settings: dict[str, object]) -> Plan:
    return Plan.model_validate(
        {
            "sequences": {"walk": {"features": "/nowhere/walk.txt"}, "street": {"scene": "demo"}},
            "settings": settings or {"default": {}},
            "seeds": seeds,
        }
    )


class InThisProcess:
    """An executor without processes."""

    def __call__(self, work: Work, jobs: object) -> Iterator[Outcome]:
        assert isinstance(jobs, tuple)
        return map(work, jobs)


def times_done(out: Path) -> dict[str, int]:
    return {
        str(path.parent.relative_to(out)): path.read_text().count("done")
        for path in out.rglob("done.txt")
    }


def test_finished_runs_are_not_done_again(tmp_path: Path) -> None:
    first = run_batch(plan_of(2), tmp_path, InThisProcess(), write_result)
    assert (first.finished, first.failures) == (4, {})
    again = run_batch(plan_of(3), tmp_path, InThisProcess(), write_result)
    assert again.finished == 6
    changed = plan_of(3, default={"tracker.max_features": 99}, other={})
    run_batch(changed, tmp_path, InThisProcess(), write_result)
    done = times_done(tmp_path)
    assert len(done) == 12
    assert all(n == (2 if "/default/" in name else 1) for name, n in done.items())


def test_a_run_cut_off_in_the_middle_is_done_again(tmp_path: Path) -> None:
    run_batch(plan_of(2), tmp_path, InThisProcess(), write_result)
    path = tmp_path / "walk" / "default" / "1" / METRICS_JSON
    path.write_text(path.read_text()[:10])
    run_batch(plan_of(2), tmp_path, InThisProcess(), write_result)
    assert {name: n for name, n in times_done(tmp_path).items() if n > 1} == {"walk/default/1": 2}


def test_rendered_data_goes_when_its_runs_are_done(tmp_path: Path) -> None:
    def keep_none(job: Job) -> Outcome:
        return write_result(job)

    run_batch(plan_of(2), tmp_path, InThisProcess(), keep_none)
    assert not list((tmp_path / "data").rglob("*-*"))
    kept = plan_of(3).model_copy(update={"keep_data": True})
    run_batch(kept, tmp_path, InThisProcess(), keep_none)
    assert len(list((tmp_path / "data" / "street").iterdir())) == 1


def test_a_sequence_that_is_not_rendered_is_not_run(tmp_path: Path) -> None:
    def no_disk(job: Job) -> Outcome:
        if job.name.startswith("render"):
            return Outcome(job.name, "disk full")
        return write_result(job)

    summary = run_batch(plan_of(1), tmp_path, InThisProcess(), no_disk)
    assert summary.finished == 1
    assert summary.failures == {
        "render street/0": "disk full", "street/default/0": "was not rendered",
    }  # fmt: skip


def test_the_figures(tmp_path: Path) -> None:
    summary = run_batch(plan_of(), tmp_path, InThisProcess(), write_result, monte_carlo=5)
    ate = next(s for s in summary.spreads if s.metric == "ate_yaw_m" and s.sequence == "walk")
    values = np.arange(1.0, 6.0)
    assert (ate.count, ate.mean, ate.median) == (5, 3.0, 3.0)
    assert ate.std == pytest.approx(values.std(ddof=1))
    assert (ate.least, ate.greatest) == (1.0, 5.0)
    assert not [s for s in summary.spreads if s.metric == "hota"]  # no run has a value
    (nees,) = [c for c in summary.consistency if c.sequence == "walk"]
    assert nees.runs == 5
    assert nees.inside
    assert nees.low < 3.0 < nees.high
    found = json.loads((tmp_path / "summary.json").read_text())
    assert found["finished"] == 10
    rows = (tmp_path / "summary.csv").read_text().splitlines()
    assert rows[0] == "sequence,settings,metric,count,mean,median,std,least,greatest"
    assert len(rows) == 1 + len(summary.spreads)


def assert_only_the_failing_fail(summary: BatchSummary) -> None:
    assert summary.finished == 4
    assert summary.failures["walk/default/1"] == "a.yaml, row 3: no number"
    assert summary.failures["walk/default/2"] == "ZeroDivisionError: by nothing"


def test_failures_are_told_and_hold_nothing_up(tmp_path: Path) -> None:
    plan = plan_of().model_copy(update={"sequences": {"walk": plan_of().sequences["walk"]}})
    plan = plan.model_copy(update={"seeds": 6})
    summary = run_batch(plan, tmp_path, LocalProcesses(2), fail_on_seed_1)
    assert_only_the_failing_fail(summary)
