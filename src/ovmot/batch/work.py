"""What a worker process does: render a sequence, or run one and measure it."""

import json
import os
import platform
import shutil
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ovmot import (
    InputError,
    OvmotError,
    RunOptions,
    evaluate,
    prepare_process,
    run_sequence,
    simulate,
    write_metrics,
    write_report,
)
from ovmot import open as open_sequence
from ovmot.batch.feature_runs import evaluate_features, run_features
from ovmot.batch.jobs import JOB_JSON, METRICS_JSON, Job, RenderJob, RunJob, is_done
from ovmot.batch.plan import Features, Recorded
from ovmot.datasets.presets import given_max_gap_s
from ovmot.sim.features import FeatureOptions, FeatureRecording
from ovmot.sim.handheld import handheld_simulation
from ovmot.sim.miscalibration import miscalibrated

_CALIBRATION_STREAM = 100
"""Of a seed's random numbers: apart from those of the simulation itself."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a job ended: `failure` is one line, None where it is done."""

    name: str
    failure: str | None = None


def work(job: Job) -> Outcome:
    """Do one job; a failure that is meant for the user comes back as its line, any other rises."""
    prepare_process()
    try:
        if isinstance(job, RenderJob):
            _render(job)
        elif not is_done(job):  # a cluster that lost the answer of a finished job asks again
            _run(job)
    except (OvmotError, OSError) as error:
        return Outcome(job.name, str(error))
    return Outcome(job.name)


def _render(job: RenderJob) -> None:
    """Into a folder of another name first: the final one is there whole or not at all."""
    spec = job.sequence
    simulated = simulate(
        spec.scene, seed=job.seed, path=spec.path, size=spec.size, rate_hz=spec.rate_hz,
        duration_s=spec.duration_s,
    )  # fmt: skip
    unfinished = job.folder.with_name(f"{job.folder.name}.{platform.node()}.{os.getpid()}.part")
    shutil.rmtree(unfinished, ignore_errors=True)
    try:
        simulated.write(unfinished, spec.format)
        if not job.folder.is_dir():
            unfinished.rename(job.folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def _run(job: RunJob) -> None:
    """`job.json` comes last: a run without it is done again."""
    for name in (JOB_JSON, METRICS_JSON):
        (job.folder / name).unlink(missing_ok=True)
    sequence = job.sequence
    if isinstance(sequence, Features):
        _run_features(job, sequence)
    elif job.data is None:
        raise InputError(f"{job.name}: has no data")
    else:
        truth = sequence.truth if isinstance(sequence, Recorded) else None
        _run_folder(job, job.data, truth or job.data)
    note = {"identity": job.identity, "host": platform.node(), "pid": os.getpid()}
    partial = job.folder / f"{JOB_JSON}.part"
    partial.write_text(json.dumps(note) + "\n", encoding="utf-8")
    partial.replace(job.folder / JOB_JSON)


def _run_folder(job: RunJob, data: Path, truth: Path) -> None:
    sequence = open_sequence(
        data,
        imu_max_gap_s=given_max_gap_s(job.settings),
        pair_tolerance_s=job.settings.recording.pair_tolerance_s,
    )
    options = RunOptions(job.folder, save_points=True, preview=True, force=True)
    run_sequence(sequence, sequence.settings(job.settings), options)
    write_metrics(job.folder, evaluate(job.folder, truth))
    _write_report(job.folder, truth)


def _write_report(folder: Path, truth: Path | None) -> None:
    """The page of a run; a run without its page is done all the same."""
    try:
        write_report([folder], truth=truth)
    except Exception as error:
        warnings.warn(f"{folder}: no report.html: {error}", stacklevel=2)


def _run_features(job: RunJob, spec: Features) -> None:
    options = FeatureOptions(
        n_features=spec.n_features, pixel_sigma=spec.pixel_sigma, depth_m=spec.depth_m,
        wrong_match_share=spec.wrong_match_share, stereo=spec.stereo,
    )  # fmt: skip
    simulation = handheld_simulation(
        spec.features, options, start_s=spec.start_s, duration_s=spec.duration_s,
        max_gap_s=spec.max_gap_s,
    )  # fmt: skip
    recording = FeatureRecording(simulation, job.seed)
    prior_rig = None
    if spec.calibration_error is not None:
        rng = np.random.default_rng([job.seed, _CALIBRATION_STREAM])
        prior_rig = miscalibrated(simulation.rig, spec.calibration_error, rng)
    run_features(recording, job.settings, RunOptions(job.folder, force=True), initial_rig=prior_rig)
    write_metrics(job.folder, evaluate_features(job.folder, recording, prior_rig))
    _write_report(job.folder, None)
