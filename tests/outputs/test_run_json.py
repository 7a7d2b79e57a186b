import json
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import ovmot
from ovmot.errors import OvmotError
from ovmot.outputs.run_json import InputIdentity, RunSummary, reserve_run_json, write_run_json
from ovmot.settings import EpipolarSettings, Settings
from ovmot.types import ImuNoise


def summary(ended: str = "finished") -> RunSummary:
    return RunSummary(
        settings=Settings(epipolar=EpipolarSettings(threshold_px=2.25)),
        options={"ego": "filter", "first": 0, "last": None},
        imu_noise=ImuNoise(1e-4, 2e-5, 3e-3, 4e-4),
        source=InputIdentity("données/seq", "euroc", 161, 3200, 1_403_636_584_763_555_584, None),
        counts={"frames_in": 161, "frames_written": np.int64(146)},  # type: ignore[dict-item]
        warnings={"IMU gap longer than 0.1 s": 2},
        not_started_because="not at rest: gyroscope varies by 0.1 rad/s",
        ended=ended,
        wall_seconds=4.56789,
    )


def test_content(tmp_path: Path) -> None:
    write_run_json(tmp_path, summary("failed: a.png: broken image"))
    data = json.loads((tmp_path / "run.json").read_text(encoding="utf-8"))
    assert data["ended"] == "failed: a.png: broken image"
    assert data["input"] == {
        "path": "données/seq",
        "kind": "euroc",
        "n_frames": 161,
        "n_imu_samples": 3200,
        "first_timestamp_ns": 1_403_636_584_763_555_584,
        "last_timestamp_ns": None,
    }
    assert data["counts"] == {"frames_in": 161, "frames_written": 146}
    assert data["warnings"] == [{"message": "IMU gap longer than 0.1 s", "count": 2}]
    assert data["not_started_because"] == "not at rest: gyroscope varies by 0.1 rad/s"
    assert data["settings"]["epipolar"] == {"threshold_px": 2.25, "scale": "angle"}
    assert data["versions"]["ovmot"] == ovmot.__version__
    assert data["versions"]["numpy"] == np.__version__
    assert data["versions"]["opencv"] == cv2.__version__
    assert {"python", "platform"} <= set(data["versions"])
    assert data["wall_seconds"] == 4.568
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]


def test_a_path_that_is_no_text_comes_back(tmp_path: Path) -> None:
    strange = "data/\udcff"  # a byte of a name that is not UTF-8, as Python holds it
    found = summary()
    write_run_json(tmp_path, replace(found, source=replace(found.source, path=strange)))
    assert json.loads((tmp_path / "run.json").read_text())["input"]["path"] == strange


def test_settings_can_be_read_back(tmp_path: Path) -> None:
    write_run_json(tmp_path, summary())
    data = json.loads((tmp_path / "run.json").read_text(encoding="utf-8"))
    assert Settings.model_validate(data["settings"]) == summary().settings


def test_full_disk_keeps_the_old_file(
    tmp_path: Path, full_disk: Callable[[int], AbstractContextManager[None]]
) -> None:
    (tmp_path / "run.json").write_text("old")
    with full_disk(100), pytest.raises(OvmotError, match=r"run\.json: cannot be written"):
        write_run_json(tmp_path, summary())
    assert (tmp_path / "run.json").read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]


def test_with_room_reserved_a_full_disk_does_not_matter(
    tmp_path: Path,
) -> None:
    """The room is that of the file itself: nothing is opened anew, and nothing more is needed."""
    write_run_json(tmp_path, summary("running"))
    assert reserve_run_json(tmp_path)
    reserved = tmp_path / "run.json.part"
    assert reserved.stat().st_blocks * 512 > 4 * (tmp_path / "run.json").stat().st_size
    inode = reserved.stat().st_ino
    write_run_json(tmp_path, summary("failed: no space left on device"))
    assert (tmp_path / "run.json").stat().st_ino == inode
    assert json.loads((tmp_path / "run.json").read_text())["ended"].startswith("failed: no space")
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]


def test_without_room_nothing_is_reserved(
    tmp_path: Path, full_disk: Callable[[int], AbstractContextManager[None]]
) -> None:
    with full_disk(100):
        assert not reserve_run_json(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_an_unknown_ending_is_refused() -> None:
    with pytest.raises(ValueError, match="not a way for a run to end"):
        summary("done")
