"""Where jobs are done: dying processes, a cluster."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fake_work import always_die_on_seed_2, die_once_on_seed_2, write_result

from ovmot.batch.batch import run_batch
from ovmot.batch.execute import DaskCluster, LocalProcesses
from ovmot.batch.plan import Plan
from ovmot.errors import InputError


def plan_of(seeds: int = 4, **settings: dict[str, object]) -> Plan:
    return Plan.model_validate(
        {
            "sequences": {"walk": {"features": "/nowhere/walk.txt"}, "street": {"scene": "demo"}},
            "settings": settings or {"default": {}},
            "seeds": seeds,
        }
    )


def times_done(out: Path) -> dict[str, int]:
    return {
        str(path.parent.relative_to(out)): path.read_text().count("done")
        for path in out.rglob("done.txt")
    }


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
    said: list[str] = []
    execute = LocalProcesses(2, retries=1, on_death=said.append)
    summary = run_batch(walks(4), tmp_path, execute, always_die_on_seed_2)
    assert any(line.startswith("a worker died; tried again") for line in said)
    assert "walk/default/2: its worker died, try 1 of 1" in said
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
