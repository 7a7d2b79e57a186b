"""`make bench`: each of its parts runs from end to end on a small street; no time is judged."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bench
import bench_curves
import ovmot
from bench_against import timed_process
from bench_curves import CURVES, CurveOptions, walkers
from bench_inputs import default_folders, in_memory, simulated_street
from ovmot.sim.render import camera_rays, render_image
from ovmot.sim.scene_file import SceneFile
from ovmot.sim.scenes import make_simulation


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """2.5 s of the demo's street."""
    folder = tmp_path_factory.mktemp("bench") / "street"
    ovmot.simulate("demo", seed=3, duration_s=2.5, size=(320, 140)).write(folder)
    return folder


def cells(line: str) -> list[str]:
    """The entries of a row of a table."""
    return [cell.strip() for cell in line.strip("|").split("|")]


@pytest.mark.slow
def test_speed(street: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two tables, with and without objects, and the line about the machine."""
    bench.main([str(street), "--runs", "1"])
    speed, stages, machine = capsys.readouterr().out.strip().split("\n\n")
    columns, _, with_objects, without = map(cells, speed.splitlines())
    assert tuple(columns) == bench.SPEED
    assert with_objects[:4] == ["street", "320x140", "with", "25"]
    assert without[:4] == ["street", "320x140", "without", "25"]
    names, *rows = map(cells, stages.splitlines())
    assert "track, ms" in names and len(rows) == 3
    assert all(len(row) == len(names) for row in rows)
    assert "load average" in machine and "OpenCV" in machine


def test_against_another_program(street: Path, capsys: pytest.CaptureFixture[str]) -> None:
    judge = f'import sys; sys.exit(sys.argv[1] != "{street}")'
    program = f"{sys.executable} -c '{judge}' {{sequence}}"
    bench.main([str(street), "--against", program, "--runs", "1"])
    lines = capsys.readouterr().out.splitlines()
    assert tuple(cells(lines[0])) == bench.AGAINST
    assert cells(lines[2])[1] == "ovmot run" and cells(lines[2])[-1] == "1.00"
    assert cells(lines[3])[:2] == ["street", sys.executable]


@pytest.mark.parametrize(
    ("program", "complaint"),
    [("no_such_program", "No such file"), ("false", "false: ended with code 1")],
)
def test_a_program_that_fails(tmp_path: Path, program: str, complaint: str) -> None:
    with pytest.raises(ovmot.OvmotError, match=complaint):
        timed_process([program], tmp_path)


@pytest.mark.parametrize("name", ["clones", "features"])
def test_curve_against_a_setting(street: Path, tmp_path: Path, name: str) -> None:
    label, rows = CURVES[name](CurveOptions(street, tmp_path, runs=1, values=(20, 60)))
    assert "street" in label
    assert [row[0] for row in rows] == ["20", "60"]
    assert all(len(row) == 1 + len(bench_curves.COLUMNS) for row in rows)


@pytest.mark.parametrize(
    ("name", "value", "label", "size"),
    [("objects", 3, "3", (640, 280)), ("size", 640, "320x140", (640, 280))],
)
def test_curve_over_streets(
    street: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    name: str, value: int, label: str, size: tuple[int, int],
) -> None:  # fmt: skip
    """Each value asks for a street of its own; a small one is given in its place."""
    asked: list[tuple[Any, ...]] = []

    def given(*arguments: Any) -> Path:
        asked.append(arguments)
        return street

    monkeypatch.setattr(bench_curves, "simulated_street", given)
    _, rows = CURVES[name](CurveOptions(street, tmp_path, runs=1, values=(value,)))
    assert [row[0] for row in rows] == [label]
    assert asked[0][0] == tmp_path and asked[0][2] == size


def test_curve_against_the_length(capsys: pytest.CaptureFixture[str]) -> None:
    bench.main(["--curve", "length", "--minutes", "0.1"])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + 10 + 2
    assert cells(lines[2])[0] == "0 to 6"
    errors = [float(cells(line)[-1]) for line in lines[2:12]]
    assert max(errors) < 0.1


def test_what_cannot_be_measured(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="choose at least"):
        bench.main(["--curve", "length", "--minutes", "0"])
    with pytest.raises(SystemExit, match=r"bench: .*nothing"):
        bench.main([str(tmp_path / "nothing"), "--against", "true"])


def test_walkers_of_the_curve_of_objects_are_all_in_view() -> None:
    scene = SceneFile.model_validate(walkers(20))
    simulation = make_simulation(scene, seed=0, size=(320, 140), duration_s=10.0)
    rays = camera_rays(simulation.rig.cam0)
    for stamp in simulation.camera_ns[::33].tolist():
        T_world_cam0 = simulation.path.pose(stamp) @ simulation.rig.T_imu_cam0
        ids = render_image(simulation.scene, rays, T_world_cam0, stamp).object_id
        assert len(np.unique(ids)) == 21


def test_a_street_is_simulated_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, simulated_street_of: Callable[[], Path]
) -> None:
    folder = simulated_street_of()
    monkeypatch.setattr(ovmot, "simulate", None)  # not called again
    assert simulated_street_of() == folder
    recording = in_memory(folder)
    assert recording.size == "160x70" and len(recording.pairs) == 3
    assert recording.image_bytes == 3 * 2 * 160 * 70


@pytest.fixture
def simulated_street_of(tmp_path: Path) -> Callable[[], Path]:
    """Asks for the same small street each time."""
    return lambda: simulated_street(tmp_path, "traffic", (160, 70), 0.3)


def test_default_sequences(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of the data that are there, and the street."""
    (tmp_path / "street_traffic").mkdir()
    monkeypatch.setenv("OVMOT_DATA", str(tmp_path))
    monkeypatch.setattr("bench_inputs.simulated_street", lambda *_: tmp_path / "simulated")
    assert default_folders(tmp_path) == [tmp_path / "street_traffic", tmp_path / "simulated"]
