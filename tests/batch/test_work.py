"""A job of a feature-level simulation, done: its calibration may start wrong."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from ovmot.batch.jobs import METRICS_JSON, RunJob
from ovmot.batch.plan import Features
from ovmot.batch.work import work
from ovmot.datasets.pose_files import write_tum
from ovmot.geometry import se3, so3
from ovmot.settings_file import load_settings
from ovmot.sim.miscalibration import Miscalibration

CALIBRATING = load_settings(None, ["calibration.extrinsics=true", "epipolar.threshold_px=30"])
WRONG = Miscalibration(rotation_deg=1.0, position_m=0.02, time_offset_s=0.004)


@pytest.fixture
def walk(tmp_path: Path) -> Path:
    """A TUM file of 6 s of walking and turning."""
    t = 0.05 * np.arange(120)
    R = so3.exp(np.stack([0.2 * np.sin(t), 0.3 * np.sin(1.7 * t), 0.4 * np.sin(t)], axis=-1))
    p = np.stack([1.2 * t, 0.4 * np.sin(t), 0.1 * np.sin(3.0 * t)], axis=-1)
    write_tum(tmp_path / "walk.txt", np.round(1e9 * t).astype(np.int64), se3.make(R, p))
    return tmp_path / "walk.txt"


def done(walk: Path, folder: Path, error: Miscalibration | None, seed: int = 3) -> dict[str, float]:
    """The metrics of a run of 1.5 s that starts from a calibration with this error."""
    spec = Features(
        features=walk, n_features=60, pixel_sigma=0.3, duration_s=1.5, calibration_error=error
    )
    job = RunJob("walk", "calibrating", seed, spec, CALIBRATING, folder, None)
    outcome = work(job)
    assert outcome.failure is None
    return dict(json.loads((folder / METRICS_JSON).read_text()))


def first_offset_s(folder: Path) -> float:
    with (folder / "state.csv").open() as file:
        return float(next(csv.DictReader(file))["time_offset_s"])


def test_the_filter_is_told_a_wrong_calibration_and_measured_against_the_true_one(
    walk: Path, tmp_path: Path
) -> None:
    right = done(walk, tmp_path / "right", None)
    wrong = done(walk, tmp_path / "wrong", WRONG)
    # the start is that of the wrong clock, and the truth is not moved by it
    started = first_offset_s(tmp_path / "wrong") - first_offset_s(tmp_path / "right")
    assert abs(started) == pytest.approx(0.004, abs=1e-3)
    assert right["calibration_rotation_deg"] < 0.5
    assert 0.01 < wrong["calibration_rotation_deg"] < 2.0
    assert wrong["ate_none_m"] < 0.2
    assert 0.0 <= wrong["calibration_end_inside_3_sigma"] <= 1.0
    assert right["calibration_end_inside_3_sigma"] > 0.9


def test_each_seed_has_its_own_error(walk: Path, tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("a", "b")]
    first = [done(walk, folder, WRONG, seed=4) for folder in folders]
    assert first[0] == first[1]
    assert done(walk, tmp_path / "c", WRONG, seed=5) != first[0]
