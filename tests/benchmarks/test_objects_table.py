"""`benchmarks/objects_table.py`: tables of finished runs, and that it asks for what is missing."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

import objects_table
from ovmot.batch.plan import read_plan

SUMMARY = """sequence,settings,metric,count,mean,median,std,least,greatest
queue,default,object_recall,5,0.91,0.92,0.01,0.85,0.95
queue,default,id_switches,5,0.6,0,0.5,0,2
queue,default,object_velocity_nees,5,2.5,2.4,0.5,1.5,4
bus,default,object_recall,5,0.8,0.8,0,0.8,0.8
"""


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> list[Sequence[str]]:
    """What was asked for in place of running it: a batch has the summary above, a run no track."""
    asked: list[Sequence[str]] = []

    def record(command: Sequence[str], environment: Mapping[str, str]) -> None:
        asked.append(command)
        if command[0] == "batch":
            out = Path(command[3])
            out.mkdir(parents=True, exist_ok=True)
            (out / "summary.csv").write_text(SUMMARY)
        elif command[0] == "evaluate":
            run = Path(command[1])
            run.mkdir(parents=True, exist_ok=True)
            (run / "metrics.json").write_text(json.dumps({"confirmed_tracks": 0.0}))

    monkeypatch.setattr(objects_table, "ovmot", record)
    return asked


@pytest.mark.parametrize("name", ["objects", "objects_still", "objects_drive"])
def test_plans_are_read(name: str) -> None:
    plan = read_plan(objects_table.PLANS / f"{name}.yaml")
    assert plan.metrics is not None
    assert set(plan.metrics) <= {*objects_table.COLUMNS, *objects_table.STILL}


def test_a_row_a_scene_with_mean_and_worst(
    commands: list[Sequence[str]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    objects_table.main([str(tmp_path), "--only", "scenes", "--workers", "2"])
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in capsys.readouterr().out.splitlines()
    ]
    assert rows[0][:4] == ["scene", "recall", "precision", "id switches"]
    assert rows[2][:4] == ["queue", "0.91 (0.85)", "", "0.60 (2.00)"]
    assert rows[2][rows[0].index("velocity NEES")] == "2.50 (1.50 ... 4.00)"
    assert rows[3][:2] == ["bus", "0.80 (0.80)"]
    assert commands[0][-1] == "2"


def test_finished_runs_are_not_made_again(
    commands: list[Sequence[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    (tmp_path / "data" / "euroc_mh01").mkdir(parents=True)
    monkeypatch.setenv("OVMOT_DATA", str(tmp_path / "data"))
    for _ in range(2):
        objects_table.main([str(tmp_path / "out"), "--only", "real", "kitti"])
    assert len(commands) == 2 * len(objects_table.STILL_RUNS)  # run and evaluate, once
    said = capsys.readouterr().out
    assert "| euroc_mh01 from frame 80" in said
    assert "kitti_tracking/training is missing" in said


def test_a_command_that_fails_is_said(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="no such"):
        objects_table.ovmot(("run", str(tmp_path / "nothing"), "-o", str(tmp_path / "o")), {})
