"""A run read back: what was written is what is read."""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ovmot.cameras.rig import StereoRig
from ovmot.errors import InputError
from ovmot.outputs.finished_run import Run
from ovmot.outputs.run_json import RUN_JSON
from ovmot.outputs.run_writer import open_outputs
from ovmot.settings import Settings
from ovmot.types import FrameResult

Maker = Callable[[int], FrameResult]
STAMPS = [1_500_000_000_000_000_001, 1_500_000_000_100_000_001]


@pytest.fixture
def folder(tmp_path: Path, rig: StereoRig, make_result: Maker) -> Path:
    """Two frames, written with all tables."""
    out = tmp_path / "run"
    with open_outputs(out, rig=rig, save_points=True, calibration=True) as writer:
        for stamp in STAMPS:
            writer.write(make_result(stamp))
    return out


def test_poses_and_covariance(folder: Path, make_result: Maker) -> None:
    run, ego = Run(str(folder)), make_result(STAMPS[0]).ego
    assert run.trajectory.timestamp_ns.tolist() == STAMPS
    np.testing.assert_allclose(run.trajectory.T_world_imu, [ego.T_world_imu] * 2, atol=1e-8)
    np.testing.assert_allclose(run.covariance, [ego.covariance[:9, :9]] * 2, rtol=1e-8)


def test_tables_have_the_columns_of_their_files(folder: Path, make_result: Maker) -> None:
    run, result = Run(folder), make_result(STAMPS[0])
    for name in ("state", "tracks", "points", "stereo", "calibration", "timing"):
        header = (folder / f"{name}.csv").read_text().partition("\n")[0]
        assert getattr(run, name).dtype.names == tuple(header.split(",")), name
    assert run.tracks["timestamp_ns"].tolist() == STAMPS
    assert run.tracks["track_id"].tolist() == [3, 3]
    assert run.tracks["state"].tolist() == ["confirmed"] * 2
    assert np.isnan(run.tracks["std_vz"]).all()
    np.testing.assert_allclose(run.tracks["x"], 10.0)
    assert run.points[:4]["label"].tolist() == ["dynamic", "static", "static", "unknown"]
    assert run.points[:4]["track_id"].tolist() == [3, -1, -1, -1]
    np.testing.assert_allclose(run.points[:4]["u"], result.points.pixels[:, 0], atol=5e-4)
    assert run.stereo["accepted"].tolist() == [1, 0, 1, 0]
    assert run.state["health"].tolist() == ["degraded"] * 2
    assert run.state["standing"].dtype == np.int64
    np.testing.assert_allclose(run.state["vx"], 3.0)
    assert np.isnan(run.state["accel_bias_x"]).all()
    np.testing.assert_allclose(run.calibration["std_cam0_lens_fx"], 0.5)
    assert run.timing["timestamp_ns"].dtype == np.int64


def test_rows_of_one_object_are_rows(folder: Path) -> None:
    rows = Run(folder).tracks
    assert len(rows[rows["track_id"] == 3]) == 2
    assert len(rows[rows["track_id"] == 4]) == 0


def test_tables_without_rows(tmp_path: Path, rig: StereoRig) -> None:
    out = tmp_path / "empty"
    with open_outputs(out, rig=rig, calibration=True):
        pass
    run = Run(out)
    assert len(run.tracks) == 0
    assert run.tracks["vx"].tolist() == []
    assert run.calibration.dtype.names in ((), None)  # not even a header


def test_what_is_missing_is_said(folder: Path, tmp_path: Path) -> None:
    for path, problem in (
        (tmp_path / "none", "no such folder"),
        (tmp_path, "is not a run"),
        (folder / "state.csv", "is not a folder"),
    ):
        with pytest.raises(InputError, match=f"{path}: {problem}"):
            Run(path)
    (folder / "points.csv").unlink()
    (folder / "covariance.csv").unlink()
    with pytest.raises(InputError, match=r"points\.csv: no such file; .*--save-points"):
        _ = Run(folder).points
    with pytest.raises(InputError, match=r"covariance\.csv: no such file"):
        _ = Run(folder).covariance
    with pytest.raises(InputError, match=r"run\.json: no such file"):
        _ = Run(folder).summary


def test_a_broken_row_is_named(folder: Path) -> None:
    path = folder / "tracks.csv"
    path.write_text(path.read_text().replace("-4.0000", "fast", 1))
    with pytest.raises(InputError, match=r"tracks\.csv, row 2: is not a number"):
        _ = Run(folder).tracks


def test_summary_and_settings(folder: Path) -> None:
    settings = Settings.model_validate({"tracker": {"max_features": 77}})
    told = {"ended": "finished", "settings": settings.model_dump(mode="json")}
    (folder / RUN_JSON).write_text(json.dumps(told))
    run = Run(folder)
    assert run.summary["ended"] == "finished"
    assert run.settings == settings
    for text, problem in (("{", "is no JSON"), ("[]", "holds no keys")):
        (folder / RUN_JSON).write_text(text)
        with pytest.raises(InputError, match=rf"run\.json: {problem}"):
            _ = Run(folder).summary


def test_a_data_frame_is_made_of_the_rows(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=lambda rows: rows))
    run = Run(folder)
    frame: object = run.to_pandas("tracks")
    assert isinstance(frame, np.ndarray)
    np.testing.assert_array_equal(frame["vx"], run.tracks["vx"])
    with pytest.raises(InputError, match=r"wheels\.csv: no such file"):
        run.to_pandas("wheels")


def test_without_pandas_it_says_what_to_install(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match="pip install 'ovmot\\[pandas\\]'"):
        Run(folder).to_pandas("tracks")


def test_a_data_frame_of_pandas(folder: Path) -> None:
    pytest.importorskip("pandas", reason="pandas is not installed (it comes with evo)")
    frame = Run(folder).to_pandas("tracks")
    assert list(frame["state"]) == ["confirmed"] * 2
    assert frame["timestamp_ns"].tolist() == STAMPS
    assert frame.groupby("track_id")["vx"].mean()[3] == pytest.approx(-4.0)
