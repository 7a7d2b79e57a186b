"""From a scene to its figures, by commands alone; each mistake on the way is one line."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ovmot.datasets.pose_files import write_tum
from ovmot.geometry import se3, so3

Command = Callable[..., Any]
ORIGIN_NS = 1_500_000_000_000_000_000


def simulate(command: Command, out: Path, *more: object) -> Any:
    return command("simulate", out, "--size", "320x140", "--duration", "2.5", *more)


def walk_file(path: Path, seconds: float = 8.0) -> Path:
    """A TUM file of a short walk."""
    t = np.arange(0.0, seconds, 0.05)
    R = so3.exp(np.stack([0.1 * np.sin(t), 0.3 * np.sin(0.7 * t), 0.2 * np.cos(t)], axis=-1))
    p = np.stack([1.2 * t, 0.4 * np.sin(t), 0.1 * np.sin(3.0 * t)], axis=-1)
    write_tum(path, ORIGIN_NS + np.round(1e9 * t).astype(np.int64), se3.make(R, p))
    return path


@pytest.mark.slow
@pytest.mark.parametrize("form", ["kaist", "asl"])
def test_simulate_run_evaluate(ovmot_command: Command, tmp_path: Path, form: str) -> None:
    data, out = tmp_path / "data", tmp_path / "out"
    told = simulate(ovmot_command, data, "--scene", "crossing", "--format", form)
    assert (told.code, told.out) == (0, f"25 frames -> {data}\n")
    assert ovmot_command("run", data, "-o", out, "--save-points").code == 0
    told = ovmot_command("evaluate", out, "--truth", data)
    assert told.code == 0, told.err
    shown = told.out + ovmot_command("evaluate", out, "--truth", data, "--all", "--no-plots").out
    assert "ate_yaw_m" in told.out and "stereo_recall" not in told.out
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["ate_yaw_m"] < 0.02
    assert metrics["object_boxes"] > 20
    assert metrics["static_kept"] > 0.9
    for name in ("ate_yaw_m", "object_recall", "point_precision", "stereo_recall"):
        assert name in metrics
        assert name in shown
    for name in ("ego_error.png", "nees.png", "map.png"):
        image = cv2.imread(str(out / name))
        assert image is not None
        assert image.std() > 5.0


@pytest.mark.slow
@pytest.mark.parametrize("path", ["stand", "drive"])
def test_nothing_moves_where_nothing_moves(
    ovmot_command: Command, tmp_path: Path, path: str
) -> None:
    """An empty street seen from the true poses has points, and none of them is dynamic."""
    data, out = tmp_path / "data", tmp_path / "out"
    simulate(ovmot_command, data, "--scene", "empty", "--path", path)
    ego = ("--ego", "poses", data / "truth" / "poses.csv")
    told = ovmot_command("run", data, "-o", out, "--save-points", *ego)
    assert told.code == 0, told.err
    labels = [row.split(",")[9] for row in (out / "points.csv").read_text().splitlines()[1:]]
    assert labels.count("static") > 1000
    assert labels.count("dynamic") == 0


@pytest.mark.slow
def test_a_batch_of_features(ovmot_command: Command, tmp_path: Path) -> None:
    walk_file(tmp_path / "walk.txt")
    plan, out = tmp_path / "plan.yaml", tmp_path / "out"
    plan.write_text(
        "sequences: {walk: {features: walk.txt, n_features: 60, duration_s: 4}}\n"
        "settings: {few: {filter.max_clones: 6}}\n"
    )
    told = ovmot_command("batch", plan, "-o", out, "--monte-carlo", "2", "--workers", "1")
    assert told.code == 0, told.err
    assert "nees_position" in told.out
    (ate,) = [
        m for m in json.loads((out / "summary.json").read_text())["metrics"]
        if m["metric"] == "ate_yaw_m"
    ]  # fmt: skip
    assert ate["count"] == 2
    assert 0.0 < ate["mean"] < 0.1
    stamps = {path: path.stat().st_mtime_ns for path in out.rglob("job.json")}
    assert len(stamps) == 2
    assert ovmot_command("batch", plan, "-o", out, "--monte-carlo", "2").code == 0
    assert stamps == {path: path.stat().st_mtime_ns for path in out.rglob("job.json")}


@pytest.mark.slow
def test_a_batch_says_which_run_failed(ovmot_command: Command, tmp_path: Path) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text(f"sequences: {{none: {{data: {tmp_path / 'nowhere'}}}}}\n")
    told = ovmot_command("batch", plan, "-o", tmp_path / "out", "--workers", "1")
    assert told.code == 1
    *progress, complaint = told.err.splitlines()
    assert progress == ["ovmot: run: 0 of 1", "ovmot: run: 1 of 1"]
    assert complaint.startswith("ovmot: none/default/0: ")
    assert str(tmp_path / "nowhere") in complaint


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scene", "lunar"], "lunar: neither a scene of the catalog nor a file"),
        (["--scene", "nowhere.yaml"], "nowhere.yaml"),
        (["--path", "fly"], "fly"),
        (["--format", "bag"], "--format bag: unknown; choose one of asl, kaist"),
        (["--size", "640"], "--size 640: is no size; write WIDTHxHEIGHT, as in 640x280"),
        (["--size", "640x481"], "640x481"),
        (["--rate", "0"], "rate"),
        (["--duration", "-3"], "duration"),
    ],
)
def test_a_wrong_simulation_is_one_line(
    ovmot_command: Command, tmp_path: Path, arguments: list[str], message: str
) -> None:
    told = ovmot_command("simulate", tmp_path / "data", *arguments)
    assert told.code == 2
    assert message in told.complaint
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("road: {length_m: -1}\n", "road.length_m"),
        ("lights: {}\n", "lights"),
        ("along: [{kind: tank}]\n", "along.0.kind"),
        ("duration_s: [\n", "row 2"),
        ("- 1\n", "scene.yaml"),
    ],
)
def test_a_wrong_scene_file_is_one_line(
    ovmot_command: Command, tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    told = ovmot_command("simulate", tmp_path / "data", "--scene", path)
    assert told.code == 2
    assert told.complaint.startswith(f"ovmot: {path}")
    assert message in told.complaint


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sequences: {}\n", "sequences"),
        ("sequence: {a: {scene: demo}}\n", "sequence"),
        ("sequences: {a: {scene: demo, data: x}}\n", "exactly one of the keys"),
        ("sequences: {a: {scene: demo}}\nsettings: {b: {trackr.x: 1}}\n", "trackr"),
        ("sequences: {a: {scene: demo}}\nseeds: 0\n", "seeds"),
        ("sequences: {a/b: {scene: demo}}\n", "a/b"),
        ("sequences: {a\n", "row 2"),
    ],
)
def test_a_wrong_plan_is_one_line(
    ovmot_command: Command, tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text(text)
    told = ovmot_command("batch", path, "-o", tmp_path / "out")
    assert told.code == 2
    assert told.complaint.startswith(f"ovmot: {path}")
    assert message in told.complaint
    assert not (tmp_path / "out").exists()


def test_a_cluster_has_its_own_workers(ovmot_command: Command, tmp_path: Path) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text("sequences: {a: {scene: demo}}\n")
    both = ("--cluster", "tcp://127.0.0.1:9", "--workers", 2)
    told = ovmot_command("batch", plan, "-o", tmp_path / "out", *both)
    assert told.code == 2
    assert "leave it out with --cluster" in told.complaint


def test_evaluate_says_what_is_missing(ovmot_command: Command, tmp_path: Path) -> None:
    told = ovmot_command("evaluate", tmp_path / "run", "--truth", tmp_path)
    assert told.code == 2
    assert str(tmp_path / "run") in told.complaint
    run = tmp_path / "run"
    run.mkdir()
    walk_file(run / "trajectory.tum")
    told = ovmot_command("evaluate", run, "--truth", tmp_path / "nowhere")
    assert told.code == 2
    assert f"{tmp_path / 'nowhere'}: no such file or folder" in told.complaint
    other = tmp_path / "other.tum"
    write_tum(other, ORIGIN_NS // 2 + np.array([0, 10**9]), np.stack([np.eye(4)] * 2))
    told = ovmot_command("evaluate", run, "--truth", other)
    assert told.code == 2
    assert not (run / "metrics.json").exists()
