"""Object metrics agree with the project's scorer, and are exact on exact tracks."""

import csv
import importlib.util
import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from true_objects import objects_at, tracks_at

from ovmot.datasets.pose_files import write_tum
from ovmot.datasets.truth import read_ego_truth
from ovmot.evaluation.matching import (
    ObjectCriteria,
    compare_frame,
)
from ovmot.evaluation.objects import evaluate_objects, object_scalars
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.run_evaluation import evaluate

TRACK_COLUMNS = (
    "timestamp_ns,track_id,state,x,y,z,vx,vy,vz,yaw,yaw_rate,length,width,height,"
    "u_min,v_min,u_max,v_max,n_points,std_x,std_y,std_z,std_vx,std_vy,std_vz"
)


@pytest.fixture
def noisy_run(tmp_path: Path) -> Callable[..., Path]:
    """A function (data, noise) to a run: the truth moved to another world, tracks with errors.

    With noise: misses, false tracks, changed ids, and deviations of `noise` metres and m/s.
    """

    def make(data: Path, noise: float) -> Path:
        out = tmp_path / f"run_{data.name}_{noise:g}"
        out.mkdir()
        rng = np.random.default_rng(5)
        listed = json.loads((data / "truth" / "objects.json").read_text())
        T_run_true = se3.make(
            Rotation.from_euler("z", 0.7).as_matrix(), np.array([3.0, -2.0, 1.0])
        )  # fmt: skip
        truth = read_ego_truth(data)
        pose_at = dict(zip(truth.timestamp_ns.tolist(), truth.T_world_imu, strict=True))
        frames = [frame for frame in listed if frame["t_ns"] in pose_at]
        stamps = np.array([frame["t_ns"] for frame in frames], dtype=np.int64)
        write_tum(
            out / "trajectory.tum", stamps, T_run_true @ np.array([pose_at[t] for t in stamps])
        )
        with (out / "tracks.csv").open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(TRACK_COLUMNS.split(","))
            for k, frame in enumerate(frames):
                writer.writerows(_rows(frame, k, noise, T_run_true, rng))
        return out

    return make


def _rows(
    frame: dict[str, Any], k: int, noise: float, T_run_true: FloatArray, rng: np.random.Generator
) -> list[list[object]]:
    rows: list[list[object]] = []
    R = T_run_true[:3, :3]
    for o in frame["objects"]:
        parked = np.hypot(o["vx"], o["vy"]) < 0.1
        if parked or (noise > 0.0 and rng.random() < 0.15):
            continue
        name = o["id"] + (100 * (k // 30) if noise > 0.0 and o["id"] % 2 else 0)
        p = se3.apply(T_run_true, np.array([o["x"], o["y"], o["z"]]))
        p = p + noise * rng.normal(0.0, 1.0, 3)
        v = R @ np.array([o["vx"], o["vy"], 0.0]) + noise * rng.normal(0.0, 1.0, 3)
        state = "tentative" if noise > 0.0 and rng.random() < 0.1 else "confirmed"
        rows.append([
            frame["t_ns"], name, state, *p, *v, o["yaw"] + 0.7, o["yaw_rate"],
            o["l"], o["w"], o["h"], 0, 0, 10, 10, 9, *[max(noise, 0.1)] * 6,
        ])  # fmt: skip
    if noise > 0.0 and rng.random() < 0.2:
        p = se3.apply(T_run_true, np.array(frame["T_w_body"])[:3, 3]) + rng.uniform(-30, 30, 3)
        rows.append([
            frame["t_ns"], 9000 + k // 5, "confirmed", *p, 1, 0, 0, 0, 0, 4, 2, 1.5,
            0, 0, 10, 10, 9, *[1.0] * 6,
        ])  # fmt: skip
    return rows


@pytest.fixture(scope="module")
def score(data_root: Path) -> ModuleType:
    """The scorer that stands beside the test data."""
    path = data_root.parent / "check" / "score.py"
    if not path.is_file():
        pytest.skip(f"no {path}")
    spec = importlib.util.spec_from_file_location("score", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["street_traffic", "street_crossing"])
@pytest.mark.parametrize("noise", [0.0, 0.4])
def test_the_same_figures_as_the_scorer(
    data_root: Path, score: ModuleType, noisy_run: Callable[..., Path], name: str, noise: float
) -> None:
    data = data_root / name
    run = noisy_run(data, noise)
    theirs = score.main(data, run)
    ours = evaluate(run, data).scalars()
    assert ours["ate_yaw_m"] == pytest.approx(theirs["ego"]["ate_m"], abs=1e-3)
    for key, other in (
        ("object_boxes", "gt_boxes"), ("object_recall", "recall"),
        ("object_precision", "precision"), ("id_switches", "id_switches"),
        ("false_boxes", "false_tracks"), ("idf1", "idf1"), ("object_speed_rmse_mps", "speed_rmse"),
        ("object_velocity_rmse_mps", "vel_rmse"), ("object_velocity_median_mps", "vel_median"),
        ("object_distance_mean_m", "pos_mean"),
    ):  # fmt: skip
        assert ours[key] == pytest.approx(theirs["objects"][other], abs=0.006), key
    assert ours["object_recall"] == (1.0 if noise == 0.0 else pytest.approx(0.75, abs=0.1))
    if noise == 0.0:
        assert (ours["hota"], ours["mota"], ours["objects_never_found"]) == (1.0, 1.0, 0.0)
        assert ours["object_velocity_rmse_mps"] == pytest.approx(0.0, abs=1e-4)
        assert ours["object_heading_rmse_deg"] == pytest.approx(0.0, abs=1e-3)
        assert ours["object_motion_rmse_m"] == pytest.approx(0.0, abs=0.04)  # cars brake
    else:
        assert theirs["objects"]["id_switches"] > 3
        nees = ours["object_velocity_nees"]  # of dimension 3, more where tracks met another object
        assert nees is not None
        assert 2.4 < nees < 6.0


STAMP = 100


def test_without_tracks_there_are_no_errors_to_report() -> None:
    frame = compare_frame(objects_at(10), tracks_at(), np.eye(4), np.eye(4), ObjectCriteria())
    found = object_scalars(evaluate_objects((frame,), ObjectCriteria()))
    assert found["object_recall"] == 0.0
    assert found["objects_never_found"] == 1.0
    for name in ("object_precision", "object_velocity_rmse_mps", "detection_latency_median_s",
                 "object_velocity_nees", "motp"):  # fmt: skip
        assert found[name] is None
