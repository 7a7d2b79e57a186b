"""Every example runs from beginning to end."""

import importlib.util
import json
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
    printed = capfd.readouterr().out
    assert "ate_yaw_m" in printed
    assert "object_recall" in printed
    out = tmp_path / "out"
    assert (out / "overlay.mp4").stat().st_size > 10_000
    assert (out / "map.png").stat().st_size > 10_000
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["poses"] >= 20
    assert metrics["distance_m"] > 1.0
    assert metrics["ate_yaw_m"] < 0.05
