"""Object metrics agree with the project's scorer, and are exact on exact tracks."""

import csv
import importlib.util
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ovmot.datasets.pose_files import write_tum
from ovmot.datasets.truth import TrueObjects, read_ego_truth
from ovmot.evaluation.matching import (
    ComparedFrame,
    ObjectCriteria,
    box_distances,
    compare_frame,
    tracking_sequence,
)
from ovmot.evaluation.object_errors import detection_latency, pair_errors, pull_out_latency
from ovmot.evaluation.objects import evaluate_objects, object_scalars
from ovmot.evaluation.tracking import clear_mot
from ovmot.geometry import se3
from ovmot.geometry.arrays import FloatArray
from ovmot.outputs.run_reader import Tracks
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
        ("idf1", "idf1"), ("object_speed_rmse_mps", "speed_rmse"),
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


def objects_at(
    x: float, *, speed: float = 5.0, pixels: int = 900, yaw: float = 0.0, stamp: int = STAMP
) -> TrueObjects:
    """A car 4 x 2 x 1.6 m at (x, 3, 0.8)."""
    return TrueObjects(
        stamp, np.array([7]), np.array([[x, 3.0, 0.8]]), np.array([yaw]),
        np.array([[4.0, 2.0, 1.6]]), np.array([[speed, 0.0, 0.0]]), np.array([0.0]),
        np.array([pixels]),
    )  # fmt: skip


def tracks_at(*x: float, stamp: int = STAMP) -> Tracks:
    n = len(x)
    position = np.array([[value, 3.0, 0.8] for value in x]).reshape(-1, 3)
    return Tracks(
        np.full(n, stamp), np.arange(n), position, np.tile([5.0, 0.0, 0.0], (n, 1)), np.zeros(n),
        np.zeros(n), np.tile([4.0, 2.0, 1.6], (n, 1)), np.full((n, 6), 0.1),
    )  # fmt: skip


def test_distance_to_a_turned_box() -> None:
    turned = objects_at(10.0, yaw=0.5 * np.pi)
    points = np.array([[10.0, 3.0, 0.8], [10.0, 6.0, 0.8], [13.0, 3.0, 0.8], [11.5, 5.5, 2.6]])
    expected = [0.0, 1.0, 2.0, np.sqrt(0.25 + 0.25 + 1.0)]
    np.testing.assert_allclose(box_distances(points, turned)[0], expected)


@pytest.mark.parametrize(
    "free", [objects_at(10, speed=0.5), objects_at(10, pixels=300), objects_at(45), objects_at(-9)]
)
def test_what_need_not_be_found_is_neither_hit_nor_miss(free: TrueObjects) -> None:
    x = float(free.center[0, 0])
    frame = compare_frame(free, tracks_at(x), np.eye(4), np.eye(4), ObjectCriteria())
    clear = clear_mot(tracking_sequence([frame], 2.5))
    assert (clear.n_true, clear.n_tracks) == (0, 0)
    away = compare_frame(free, tracks_at(x + 8.0), np.eye(4), np.eye(4), ObjectCriteria())
    assert clear_mot(tracking_sequence([away], 2.5)).false_positives == 1


def test_one_track_too_many_is_false() -> None:
    frame = compare_frame(
        objects_at(10), tracks_at(10.0, 11.0), np.eye(4), np.eye(4), ObjectCriteria()
    )
    clear = clear_mot(tracking_sequence([frame], 2.5))
    assert (clear.hits, clear.false_positives) == (1, 1)


def test_drift_of_the_rig_is_not_counted_twice() -> None:
    T_run = np.eye(4)
    T_run[:3, 3] = [100.0, -50.0, 2.0]
    moved = tracks_at(110.0)
    moved = replace(moved, position=moved.position + np.array([0.0, -50.0, 2.0]))
    frame = compare_frame(objects_at(10), moved, np.eye(4), T_run, ObjectCriteria())
    np.testing.assert_allclose(frame.distance, 0.0, atol=1e-9)


def test_motion_error_and_latency() -> None:
    stamps = [0, 100_000_000, 200_000_000, 300_000_000]
    frames = [
        compare_frame(
            objects_at(10.0 + 6.0 * t * 1e-9, speed=6.0, stamp=t),
            tracks_at(*([10.0 + 6.0 * t * 1e-9] if t >= 200_000_000 else []), stamp=t),
            np.eye(4), np.eye(4), ObjectCriteria(),
        )
        for t in stamps
    ]  # fmt: skip
    latency = detection_latency(frames)
    np.testing.assert_allclose(latency.seconds, [0.2])
    assert latency.never == 0
    errors = pair_errors(frames)
    np.testing.assert_allclose(errors.speed, -1.0)
    np.testing.assert_allclose(errors.motion_m, [0.1])  # 1 m/s too slow for 0.1 s
    np.testing.assert_allclose(errors.motion_rad, 0.0)
    never = detection_latency(frames[:2])
    assert (len(never.seconds), never.never) == (0, 1)


def pulling_out(
    speeds: list[float], *, tracked_from: int, x: float = 12.0, pixels: int = 900
) -> list[ComparedFrame]:
    """Ten frames a second of a car at these speeds, with a track on it from some frame on."""
    return [
        compare_frame(
            objects_at(x, speed=speed, stamp=k * 10**8, pixels=pixels),
            tracks_at(*([x] if k >= tracked_from else []), stamp=k * 10**8),
            np.eye(4), np.eye(4), ObjectCriteria(),
        )
        for k, speed in enumerate(speeds)
    ]  # fmt: skip


PULL_OUT = ObjectCriteria(min_speed_mps=2.0, max_range_m=20.0)
STARTING = [0.0, 0.0, 1.2, 1.9, 2.1, 3.0, 4.0, 5.0]


@pytest.mark.parametrize(("tracked_from", "seconds"), [(7, 0.3), (4, 0.0), (2, 0.0)])
def test_pull_out_latency_counts_from_two_metres_a_second(
    tracked_from: int, seconds: float
) -> None:
    latency = pull_out_latency(pulling_out(STARTING, tracked_from=tracked_from), PULL_OUT)
    np.testing.assert_allclose(latency.seconds, [seconds], atol=1e-9)
    assert latency.never == 0


def test_a_pull_out_without_a_track_is_counted_apart() -> None:
    latency = pull_out_latency(pulling_out(STARTING, tracked_from=99), PULL_OUT)
    assert (len(latency.seconds), latency.never) == (0, 1)


@pytest.mark.parametrize(
    "frames",
    [
        pulling_out([5.0, 5.0, 1.0, 3.0, 5.0], tracked_from=0),  # it came in fast
        pulling_out(STARTING, tracked_from=0, x=25.0),
        pulling_out(STARTING, tracked_from=0, x=-8.0),
        pulling_out(STARTING, tracked_from=0, pixels=300),
        pulling_out([0.0, 1.5, 1.9], tracked_from=0),
    ],
)
def test_what_does_not_pull_out_near_by_has_no_latency(frames: list[ComparedFrame]) -> None:
    latency = pull_out_latency(frames, PULL_OUT)
    assert (len(latency.seconds), latency.never) == (0, 0)


def test_without_tracks_there_are_no_errors_to_report() -> None:
    frame = compare_frame(objects_at(10), tracks_at(), np.eye(4), np.eye(4), ObjectCriteria())
    found = object_scalars(evaluate_objects((frame,), ObjectCriteria()))
    assert found["object_recall"] == 0.0
    assert found["objects_never_found"] == 1.0
    for name in ("object_precision", "object_velocity_rmse_mps", "detection_latency_median_s",
                 "object_velocity_nees", "motp"):  # fmt: skip
        assert found[name] is None
