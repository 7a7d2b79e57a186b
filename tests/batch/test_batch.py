"""A batch does what is not done, survives what dies, and adds up rightly."""

import json
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from fake_work import always_die_on_seed_2, die_once_on_seed_2, fail_on_seed_1, write_result

from ovmot.batch.batch import run_batch
from ovmot.batch.execute import DaskCluster, LocalProcesses, Work
from ovmot.batch.jobs import METRICS_JSON, Job
from ovmot.batch.plan import Plan
from ovmot.batch.summary import BatchSummary, consistency_of, summary_tables
from ovmot.batch.work import Outcome
from ovmot.errors import InputError


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


def walks(seeds: int) -> Plan:
    plan = plan_of(seeds)
    return plan.model_copy(update={"sequences": {"walk": plan.sequences["walk"]}})


@pytest.mark.slow
def test_a_killed_process_costs_only_its_own_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "marks").mkdir()
    monkeypatch.setenv("OVMOT_TEST_MARKS", str(tmp_path / "marks"))
    summary = run_batch(walks(6), tmp_path / "out", LocalProcesses(2), die_once_on_seed_2)
    assert (summary.finished, summary.failures) == (6, {})
    assert (tmp_path / "marks" / "2").exists()
    done = times_done(tmp_path / "out")
    assert sum(done.values()) <= 7  # at most the job beside it was done a second time


@pytest.mark.slow
def test_a_job_that_always_kills_its_process_is_given_up(tmp_path: Path) -> None:
    summary = run_batch(walks(4), tmp_path, LocalProcesses(2, retries=1), always_die_on_seed_2)
    assert summary.finished == 3
    assert summary.failures == {"walk/default/2": "its process died 2 times"}


Cluster = tuple[str, list[subprocess.Popen[str]]]


@pytest.fixture
def dask_cluster(tmp_path: Path) -> Iterator[Callable[[str], Cluster]]:
    """A function (marks folder) to a real scheduler's address and two worker processes."""
    pytest.importorskip("distributed")
    running: list[subprocess.Popen[str]] = []

    def start(marks: str) -> Cluster:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OVMOT_TEST_MARKS": marks}

        def spawn(module: str, *arguments: str) -> subprocess.Popen[str]:
            command = [sys.executable, "-m", f"distributed.cli.{module}", *arguments]
            log = (tmp_path / f"{module}{len(running)}.log").open("w")
            process = subprocess.Popen(command, env=env, cwd=tmp_path, text=True, stdout=log,
                                       stderr=log)  # fmt: skip
            running.append(process)
            return process

        spawn("dask_scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard")
        address = f"tcp://127.0.0.1:{port}"
        workers = [
            spawn("dask_worker", address, "--host", "127.0.0.1", "--nthreads", "1", "--no-nanny",
                  "--no-dashboard") for _ in range(2)
        ]  # fmt: skip
        return address, workers

    yield start
    for process in running:
        process.kill()
        process.wait()


@pytest.mark.slow
def test_a_killed_worker_of_a_real_cluster_loses_nothing(
    tmp_path: Path,
    dask_cluster: Callable[[str], Cluster],
) -> None:
    """Seed 2 kills the worker that it runs on; the other one does the rest."""
    marks, out = tmp_path / "marks", tmp_path / "out"
    marks.mkdir()
    address, workers = dask_cluster(str(marks))
    summary = run_batch(walks(8), out, DaskCluster(address, timeout_s=60), die_once_on_seed_2)
    assert (summary.finished, summary.failures) == (8, {})
    deadline = time.monotonic() + 10.0
    while time.monotonic() < deadline and all(w.poll() is None for w in workers):
        time.sleep(0.05)
    assert sum(w.poll() is None for w in workers) == 1
    before = times_done(out)
    again = run_batch(walks(8), out, DaskCluster(address, timeout_s=60), die_once_on_seed_2)
    assert again.finished == 8
    assert times_done(out) == before


@pytest.mark.slow
def test_no_cluster_there() -> None:
    pytest.importorskip("distributed")
    cluster = DaskCluster("tcp://127.0.0.1:9", timeout_s=1)
    with pytest.raises(InputError, match=r"--cluster tcp://127.0.0.1:9: no scheduler answers"):
        list(cluster(write_result, ()))


@pytest.mark.parametrize(
    ("nees", "verdict"), [(1.2, "too cautious"), (4.6, "inside"), (7.0, "overconfident")]
)
def test_the_velocity_of_objects_is_judged_by_a_factor_of_two(nees: float, verdict: str) -> None:
    values = (nees - 0.2, nees + 0.2, None)
    runs: list[dict[str, float | None]] = [{"object_velocity_nees": value} for value in values]
    (found,) = consistency_of({("street", "default"): runs})
    assert (found.runs, found.low, found.high) == (2, 1.5, 6.0)
    assert found.mean == pytest.approx(nees)
    _, table = summary_tables(BatchSummary((), (found,), 2, {}), None)
    assert list(table.columns[-1].cells) == [verdict]
