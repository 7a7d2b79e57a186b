"""A feature-level simulation goes through the same pipeline and leaves an ordinary run."""

import json
from pathlib import Path

import numpy as np
import pytest

from ovmot.config import Settings
from ovmot.errors import InputError
from ovmot.formats import read_tum
from ovmot.geometry import se3, so3
from ovmot.geometry.splines import PoseSpline
from ovmot.run import RunOptions, run_features
from ovmot.sim.features import FeatureOptions, FeatureRecording, FeatureSimulation
from ovmot.sim.handheld import EUROC_NOISE, ORIGIN_NS, handheld_rig
from ovmot.sim.simulation import ImuModel


@pytest.fixture(scope="module")
def recording() -> FeatureRecording:
    t = np.arange(-1.0, 7.1, 0.05)
    R = so3.exp(np.stack([0.2 * np.sin(t), 0.6 * np.sin(0.7 * t), 0.2 * np.cos(t)], axis=-1))
    p = np.stack([1.2 * t, 0.4 * np.sin(t), 0.1 * np.sin(3.0 * t)], axis=-1)
    path = PoseSpline.through(ORIGIN_NS + np.round(1e9 * t).astype(np.int64), se3.make(R, p))
    stamps = ORIGIN_NS + 100_000_000 * np.arange(60, dtype=np.int64)
    imu = ImuModel(200.0, EUROC_NOISE, np.full(3, 2e-3), np.full(3, 3e-2))
    options = FeatureOptions(n_features=100, wrong_match_share=0.05)
    return FeatureRecording(FeatureSimulation(handheld_rig(), path, stamps, imu, options), 4)


def test_the_run_follows_the_truth(recording: FeatureRecording, tmp_path: Path) -> None:
    done: list[int] = []
    run_features(recording, Settings(), RunOptions(tmp_path / "out"), done.append)
    assert done == list(range(1, 61))
    run, truth = read_tum(tmp_path / "out" / "trajectory.tum"), recording.truth()
    np.testing.assert_array_equal(run.timestamp_ns, truth.timestamp_ns)
    error = run.T_world_imu[:, :3, 3] - truth.T_world_imu[:, :3, 3]
    assert np.sqrt((error**2).sum(axis=1).mean()) < 0.08
    told = json.loads((tmp_path / "out" / "run.json").read_text())
    assert told["ended"] == "finished"
    assert told["input"]["kind"] == "features"
    assert told["options"]["start"] == "truth"
    assert told["counts"]["frames_written"] == 60


def test_what_needs_images_is_refused(recording: FeatureRecording, tmp_path: Path) -> None:
    for options in (
        RunOptions(tmp_path / "out", video=True),
        RunOptions(tmp_path / "out", first=3),
        RunOptions(tmp_path / "out", ego_poses=tmp_path / "poses.txt"),
    ):
        with pytest.raises(InputError, match="no images"):
            run_features(recording, Settings(), options)
    assert not (tmp_path / "out").exists()
