"""What goes into a page: the numbers of a run, as they are in its files."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from run_folders import SPEED, START_NS, STEP_NS, write_run, write_true_folder, write_truth

from ovmot.cameras.rig import StereoRig
from ovmot.errors import InputError
from ovmot.outputs.finished_run import Run
from ovmot.report.contents import page_contents, run_names
from ovmot.settings import Settings


@pytest.fixture
def folder(tmp_path: Path, painted_rig: StereoRig) -> Path:
    return write_run(tmp_path / "street", painted_rig)


def one(folder: Path, truth: Path | None = None) -> dict[str, Any]:
    (run,) = page_contents([Run(folder)], truth)["runs"]
    assert isinstance(run, dict)
    return run


def test_path_speed_and_health_are_the_run_s(folder: Path) -> None:
    run = one(folder)
    assert run["name"] == "street"
    assert run["t"] == pytest.approx([0.1 * k for k in range(40)])
    assert run["ego"]["x"] == pytest.approx([SPEED * 0.1 * k for k in range(40)])
    assert run["ego"]["yaw"] == pytest.approx([0.0] * 40)  # the camera looks along x
    assert run["ego"]["speed"] == [SPEED] * 40
    assert run["health"] == {"degraded": [[2.0, 2.4]], "lost": []}
    facts = {fact["name"]: fact["value"] for fact in run["facts"]}
    assert facts["path"] == "19.5 m"
    assert facts["tracking"] == "87.5 %"
    assert facts["objects"] == "2"
    assert facts["frames/s"] == "20.0"
    json.dumps(run, allow_nan=False)


def test_objects_that_were_not_looked_for(tmp_path: Path, painted_rig: StereoRig) -> None:
    off = Settings.model_validate({"objects": {"enabled": False}})
    run = one(write_run(tmp_path / "off", painted_rig, settings=off))
    facts = {fact["name"]: fact["value"] for fact in run["facts"]}
    assert facts["objects"] == "not looked for"
    assert run["looked_for_objects"] is False


def test_objects_have_their_path_and_a_row(folder: Path) -> None:
    run = one(folder)
    assert [track["id"] for track in run["tracks"]] == [1, 2]  # the tentative one is none
    assert [track["kind"] for track in run["tracks"]] == ["vehicle", ""]
    second = run["tracks"][1]
    assert second["at"] == list(range(10, 40))
    assert second["x"][0] == pytest.approx(15.0 + 8.0)
    assert second["speed"] == [8.0] * 30
    row = run["objects"][1]
    assert (row["id"], row["first"], row["frames"]) == (2, 1.0, 30)
    assert row["seconds"] == pytest.approx(2.9)
    assert row["nearest"] == pytest.approx(np.hypot(18.0, 2.5), abs=0.06)
    assert row["size"] == [4.0, 1.8, 1.4]
    assert row["view"].startswith("data:image/jpeg;base64,")


def test_tables_of_earlier_versions_have_no_classes(folder: Path) -> None:
    path = folder / "tracks.csv"
    lines = [line.split(",") for line in path.read_text().splitlines()]
    kept = [i for i, name in enumerate(lines[0]) if not name.startswith("p_")]
    path.write_text("".join(",".join(line[i] for i in kept) + "\n" for line in lines))
    run = one(folder)
    assert [track["kind"] for track in run["tracks"]] == ["", ""]
    assert run["pictures"]["src"]


def test_pictures_go_with_their_times(folder: Path) -> None:
    pictures = one(folder)["pictures"]
    assert len(pictures["t"]) == len(pictures["src"]) == 20  # five a second
    assert pictures["t"][:3] == pytest.approx([0.0, 0.2, 0.4])
    assert len(set(pictures["src"])) == 20


def test_a_run_without_a_preview_has_no_pictures(tmp_path: Path, painted_rig: StereoRig) -> None:
    run = one(write_run(tmp_path / "run", painted_rig, preview=False))
    assert run["pictures"] == {"t": [], "src": []}
    assert run["objects"][0]["view"] is None


def test_errors_and_bounds_where_truth_is_known(folder: Path, tmp_path: Path) -> None:
    run = one(folder, write_truth(tmp_path / "truth.tum"))
    # the page's world is that of the truth: the run goes along y at x = 7
    assert run["ego"]["x"] == pytest.approx([7.0] * 40, abs=0.02)
    assert run["ego"]["y"][-1] == pytest.approx(SPEED * 3.9, abs=0.02)
    assert run["ego"]["yaw"][0] == pytest.approx(0.5 * np.pi, abs=0.01)
    assert run["tracks"][0]["x"][0] == pytest.approx(7.0 - 2.0, abs=0.05)
    assert len(run["truth"]["errors"]) == len(run["truth"]["bounds"]) == 6
    assert np.abs(run["truth"]["errors"][3:]).max() < 0.03
    assert run["truth"]["bounds"][3][0] == pytest.approx(3 * 0.01, rel=0.01)
    assert any(fact["name"].startswith("ATE") for fact in run["facts"])
    orientation, position = run["truth"]["nees"]
    assert len(orientation) == len(position) == 40
    assert position[1] == pytest.approx((0.01 / 0.012) ** 2, rel=0.02)
    assert run["truth"]["nees_band"] == pytest.approx([0.216, 9.348], abs=1e-3)
    assert run["truth"]["objects"] == []
    assert one(folder)["truth"] is None


def test_true_objects_where_they_are_known(folder: Path, tmp_path: Path) -> None:
    """In the truth's world, at the frames in which the left camera sees them."""
    run = one(folder, write_true_folder(tmp_path / "street_truth"))
    (car,) = run["truth"]["objects"]
    assert car["at"] == list(range(5, 40))
    assert (car["x"][0], car["y"][0]) == pytest.approx((5.0, 16.0))
    assert (car["length"][0], car["width"][0], car["yaw"][0]) == (4.0, 1.8, 1.57)


def test_warnings_have_a_remedy(folder: Path) -> None:
    (warning,) = one(folder)["warnings"]
    assert warning["count"] == 3
    assert "at rest" in warning["remedy"]


def test_settings_that_differ(tmp_path: Path, painted_rig: StereoRig) -> None:
    changed = Settings().model_copy(
        update={"tracker": Settings().tracker.model_copy(update={"max_features": 321})}
    )
    (row,) = one(write_run(tmp_path / "run", painted_rig, settings=changed))["settings"]
    assert row["key"] == "tracker.max_features"
    assert row["value"] == "321"
    assert row["default"] == str(Settings().tracker.max_features)
    assert row["meaning"]


def test_times_of_stages(folder: Path) -> None:
    timing = one(folder)["timing"]
    assert timing["stages"] == ["track", "update"]
    assert timing["ms"][0][:3] == [12.0, 13.0, 14.0]
    assert timing["median"] == [13.0, 4.0]


def test_runs_of_one_recording_share_time_and_world(tmp_path: Path, painted_rig: StereoRig) -> None:
    first = write_run(tmp_path / "a", painted_rig)
    later = write_run(tmp_path / "b", painted_rig, 20, start_ns=START_NS + 5 * STEP_NS)
    a, b = page_contents([Run(first), Run(later)])["runs"]
    assert b["t"][0] == pytest.approx(0.5)
    # b's own world starts at its first frame, which is 2.5 m along the way of a
    assert b["ego"]["x"][0] == pytest.approx(a["ego"]["x"][5], abs=0.02)
    apart = write_run(tmp_path / "c", painted_rig, 20, start_ns=START_NS + 10**12)
    _, c = page_contents([Run(first), Run(apart)])["runs"]
    assert c["t"][0] == 0.0


def test_a_long_run_stays_small(tmp_path: Path, painted_rig: StereoRig) -> None:
    run = one(write_run(tmp_path / "run", painted_rig, 3000, preview=False))
    assert len(run["t"]) == 2400
    assert run["t"][-1] == pytest.approx(299.9)
    assert max(run["tracks"][0]["at"]) < 2400


def test_many_runs_share_the_room(tmp_path: Path, painted_rig: StereoRig) -> None:
    run = Run(write_run(tmp_path / "run", painted_rig, 2000))
    pages = {n: page_contents([run] * n)["runs"] for n in (1, 8)}
    assert len(pages[1][0]["t"]) == 2000
    assert len(pages[8][0]["t"]) == 600
    rows = {n: sum(len(track["at"]) for track in pages[n][0]["tracks"]) for n in pages}
    assert rows[1] == 2000 + 1990
    assert rows[8] <= 40_000 // 8


def test_names_tell_runs_apart() -> None:
    assert run_names([Path("/a/x"), Path("/a/y")]) == ["x", "y"]
    assert run_names([Path("/a/x"), Path("/b/x")]) == ["a/x", "b/x"]


def test_a_truth_that_is_none_is_an_error(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        one(folder, tmp_path / "nothing.tum")
