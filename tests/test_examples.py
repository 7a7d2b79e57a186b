"""Every example runs from beginning to end, the five lines of the README among them."""

import importlib.util
import json
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import ovmot
from ovmot.cli.demo import demo
from ovmot.segmentation.motion_tests import MOTION_TESTS

REPOSITORY = Path(__file__).resolve().parents[1]


def example(name: str) -> Any:
    """The module of an example."""
    spec = importlib.util.spec_from_file_location(name, REPOSITORY / "examples" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module: ModuleType = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A EuRoC folder, named as a sequence of theirs: 2.5 s of the demo's street, with its truth."""
    folder = tmp_path_factory.mktemp("street") / "MH_01_easy"
    ovmot.simulate("demo", seed=3, duration_s=2.5, size=(320, 140)).write(str(folder), "asl")
    return folder


@pytest.fixture(scope="module")
def street_run(street: Path) -> Path:
    """The run of it, by the filter."""
    out = street.parent / "run"
    ovmot.run_sequence(ovmot.open(street), ovmot.Settings(), ovmot.RunOptions(str(out)))
    return out


def test_the_five_lines_of_the_readme(
    street: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As they are written there, in the folder that holds the sequence."""
    readme = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    found = re.search(r"^    import ovmot\n(?:    .*\n)+", readme, re.MULTILINE)
    assert found is not None
    program = re.sub(r"^    ", "", found.group(), flags=re.MULTILINE)
    assert len(program.splitlines()) == 5
    assert program.replace("\n", "\n    ").strip() in (ovmot.__doc__ or "")
    monkeypatch.chdir(street.parent)
    exec(compile(program, "README.md", "exec"), {})
    printed = capsys.readouterr().out
    assert printed.count("]] (") >= 20  # a pose and its tracks
    assert "ObjectTrack(track_id=0" in printed


def test_own_rig(tmp_path: Path) -> None:
    """A simulated drive, seen by the example's rig: it ends where the rig did."""
    own_rig = example("own_rig")
    sequence = ovmot.simulate("demo", seed=3, duration_s=2.5, rig=own_rig.my_rig())
    sequence.write(tmp_path / "data", "asl")
    mav = tmp_path / "data" / "mav0"
    results = own_rig.main(mav / "cam0/data", mav / "cam1/data", mav / "imu0/data.csv")
    assert len(results) >= 20
    first = sequence.frame_ns.tolist().index(results[0].timestamp_ns)
    true = sequence.T_world_imu[-1, :3, 3] - sequence.T_world_imu[first, :3, 3]
    moved = results[-1].T_world_imu[:3, 3] - results[0].T_world_imu[:3, 3]
    assert np.linalg.norm(true) > 0.5
    assert np.linalg.norm(moved) == pytest.approx(np.linalg.norm(true), rel=0.05)


def test_euroc_folder(street: Path, capsys: pytest.CaptureFixture[str]) -> None:
    length = example("euroc_folder").main(str(street))
    assert 0.3 < length < 3.0
    printed = capsys.readouterr().out
    assert "of 25 frames" in printed
    assert "object 0, confirmed" in printed


def test_poses_from_file(street: Path) -> None:
    """With the true poses; the car ahead drives off at some metres a second."""
    fastest = example("poses_from_file").main(
        str(street), str(street / "mav0/state_groundtruth_estimate0/data.csv")
    )
    assert len(fastest) >= 1
    assert 1.0 < max(fastest.values()) < 12.0


def test_read_run(street: Path, street_run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = example("read_run").main(str(street_run), str(street))
    assert found["frames"] >= 20
    assert found["seconds"] == pytest.approx(0.1 * (found["frames"] - 1), abs=1e-6)
    assert 0.0 < found["last_sigma_m"] < 0.2
    assert found["ate_m"] < 0.05
    assert found["objects"] >= 1.0
    assert "warning: frames before the start" in capsys.readouterr().out


@pytest.fixture
def same_motion_tests() -> Iterator[None]:
    """What an example adds to the tests by name goes again."""
    before = dict(MOTION_TESTS)
    yield
    MOTION_TESTS.clear()
    MOTION_TESTS.update(before)


@pytest.mark.usefixtures("same_motion_tests")
def test_motion_test(street: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The function decides: with a threshold below the noise, much of what rests moves as well."""
    motion_test = example("motion_test")
    usual = motion_test.main(str(street))
    assert usual > 10
    monkeypatch.setattr(motion_test, "MOST_PX", 0.1)
    assert motion_test.main(str(street)) > 2 * usual


@pytest.mark.slow
def test_demo_tracks_its_street(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    demo(tmp_path, duration=3.0)
    printed = capfd.readouterr().out
    assert "ate_yaw_m" in printed
    assert "object_recall" in printed
    out = tmp_path / "out"
    assert (out / "overlay.mp4").stat().st_size > 10_000
    assert (out / "report.html").stat().st_size > 100_000
    assert (out / "map.png").stat().st_size > 10_000
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["poses"] >= 20
    assert metrics["distance_m"] > 1.0
    assert metrics["ate_yaw_m"] < 0.05
