"""Every example runs from beginning to end."""

import importlib.util
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


@pytest.mark.slow
def test_demo_tracks_its_street(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    spec = importlib.util.spec_from_file_location("demo", EXAMPLES / "demo.py")
    assert spec is not None and spec.loader is not None
    demo = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(demo)
    demo.main(tmp_path, duration_s=3.0)
    assert "trajectory error" in capfd.readouterr().out
    assert (tmp_path / "out" / "overlay.mp4").stat().st_size > 10_000
    ate_m, distance_m, frames = demo.trajectory_error(tmp_path / "data", tmp_path / "out")
    assert frames >= 20
    assert distance_m > 1.0
    assert ate_m < 0.05
