"""A run held against the truth: where that is found, and what it may lack."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from run_folders import START_NS, write_run

from ovmot.cameras.rig import StereoRig
from ovmot.datasets.pose_files import tum_line
from ovmot.errors import InputError
from ovmot.evaluation.headline import headline
from ovmot.geometry import se3, so3
from ovmot.geometry.arrays import FloatArray
from ovmot.run_evaluation import evaluate
from ovmot.settings import Settings

STEP_NS = 100_000_000


def pose(t_s: float) -> FloatArray:
    """A wide curve at 5 m/s, slower and faster."""
    turn = 0.3 * t_s
    place = [20.0 * np.sin(turn), 20.0 * (1.0 - np.cos(turn)), 0.1 * t_s]
    return se3.make(so3.exp(np.array([0.0, 0.0, turn])), np.array(place))


def write_tum(path: Path, stamps_ns: list[int]) -> Path:
    path.write_text("".join(f"{tum_line(t, pose(t * 1e-9))}\n" for t in stamps_ns))
    return path


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    folder.mkdir()
    write_tum(folder / "trajectory.tum", [i * STEP_NS for i in range(60)])
    return folder


def test_a_truth_with_stamps_of_its_own_is_interpolated(run: Path, tmp_path: Path) -> None:
    """OXTS has ten packets a second, up to 50 ms from the frames."""
    truth = write_tum(tmp_path / "oxts.tum", [i * STEP_NS + 43_000_000 for i in range(-2, 62)])
    metrics = evaluate(run, truth).scalars()
    assert metrics["poses"] == 60
    ate = metrics["ate_none_m"]
    assert ate is not None and ate < 3e-3  # a line for an arc


def test_a_sparse_truth_is_not_stretched(run: Path, tmp_path: Path) -> None:
    """Keyframes a second apart say nothing of the frames between them."""
    truth = write_tum(tmp_path / "keyframes.tum", [i * 10 * STEP_NS for i in range(7)])
    assert evaluate(run, truth).scalars()["poses"] == 6


def test_without_truth_it_is_what_the_run_has_read(run: Path, painted_euroc: Path) -> None:
    with pytest.raises(InputError, match=r"run\.json: no such file"):
        evaluate(run)
    path = painted_euroc / "mav0" / "state_groundtruth_estimate0" / "trajectory.tum"
    path.parent.mkdir()
    write_tum(path, [i * STEP_NS for i in range(60)])
    (run / "run.json").write_text(json.dumps({"input": {"path": str(painted_euroc)}}))
    assert evaluate(run).scalars()["poses"] == 60
    (run / "run.json").write_text(json.dumps({"input": {"path": str(painted_euroc / "gone")}}))
    with pytest.raises(InputError, match="is gone; give --truth"):
        evaluate(run)
    (run / "run.json").write_text("{}")
    with pytest.raises(InputError, match="does not say what it has read; give --truth"):
        evaluate(run)


def test_tracks_count_where_objects_were_looked_for(tmp_path: Path, painted_rig: StereoRig) -> None:
    """A run with one camera or `--no-objects` has an empty table of tracks: 0 would be a claim."""
    off = Settings.model_validate({"objects": {"enabled": False}})
    truth = write_tum(tmp_path / "t.tum", [START_NS + i * STEP_NS for i in range(40)])
    found = evaluate(write_run(tmp_path / "on", painted_rig), truth).scalars()
    assert found["confirmed_tracks"] == 2.0
    found = evaluate(write_run(tmp_path / "off", painted_rig, settings=off), truth).scalars()
    assert "confirmed_tracks" not in found
    assert "confirmed_tracks_per_min" not in headline(found)


def test_real_labels(data_root: Path, ovmot_command: Callable[..., Any], tmp_path: Path) -> None:
    """KITTI tracking 0010: a car ahead and two oncoming ones, by the benchmark's own rules."""
    folder = data_root / "kitti_tracking" / "training"
    if not folder.is_dir():
        pytest.skip(f"{folder} is missing")
    poses, out = folder / "poses" / "0010.txt", tmp_path / "out"
    said = ovmot_command("run", folder, "-o", out, "--ego", "poses", poses, "--threads", "1")
    assert said.code == 0, said.err
    assert ovmot_command("evaluate", out, "--no-plots").code == 0
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["object_boxes"] == 39
    assert metrics["object_recall"] > 0.6
    assert metrics["false_boxes"] <= 2
    assert metrics["object_speed_rmse_mps"] < 2.0
