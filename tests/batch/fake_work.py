"""Work that costs nothing, for tests of the engine; at the module's top so that it can be sent."""

import json
import os
import signal
import time
from pathlib import Path

from ovmot.batch.jobs import JOB_JSON, METRICS_JSON, Job, RunJob
from ovmot.batch.work import Outcome
from ovmot.errors import InputError


def write_result(job: Job) -> Outcome:
    """A run whose metrics follow from its seed, and a line for each time that it was done."""
    if not isinstance(job, RunJob):
        job.folder.mkdir(parents=True)
        return Outcome(job.name)
    job.folder.mkdir(parents=True, exist_ok=True)
    with (job.folder / "done.txt").open("a") as file:
        file.write("done\n")
    metrics = {"ate_yaw_m": 1.0 + job.seed, "nees_position": 3.0, "hota": None}
    (job.folder / METRICS_JSON).write_text(json.dumps(metrics))
    (job.folder / JOB_JSON).write_text(json.dumps({"identity": job.identity}))
    return Outcome(job.name)


def fail_on_seed_1(job: Job) -> Outcome:
    """Seed 1 ends with the user's mistake, seed 2 with an error of our own."""
    if job.seed == 1:
        return Outcome(job.name, str(InputError("a.yaml, row 3: no number")))
    if job.seed == 2:
        raise ZeroDivisionError("by\nnothing")
    return write_result(job)


def die_once_on_seed_2(job: Job) -> Outcome:
    """Seed 2 kills its process the first time; the others take a moment."""
    mark = Path(os.environ["OVMOT_TEST_MARKS"]) / f"{job.seed}"
    if job.seed == 2 and not mark.exists():
        mark.touch()
        time.sleep(0.3)
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.05)
    return write_result(job)


def always_die_on_seed_2(job: Job) -> Outcome:
    """Seed 2 kills its process each time."""
    if job.seed == 2:
        os.kill(os.getpid(), signal.SIGKILL)
    return write_result(job)
