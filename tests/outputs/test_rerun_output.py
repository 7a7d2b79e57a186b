"""Recordings for Rerun, written and read by its own SDK; they skip where it is missing."""

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from run_folders import result_at

from ovmot.cameras.rig import StereoRig
from ovmot.errors import InputError
from ovmot.outputs import rerun_output
from ovmot.outputs.rerun_output import RerunOutput
from ovmot.types import FeatureFrame

pytestmark = pytest.mark.rerun


def without_sdk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)


def test_without_the_sdk_there_is_one_clear_line(
    tmp_path: Path, painted_rig: StereoRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    without_sdk(monkeypatch)
    with pytest.raises(InputError, match=r"pip install 'ovmot\[rerun\]'"):
        RerunOutput(tmp_path / "run.rrd", painted_rig)
    assert not list(tmp_path.iterdir())


@pytest.fixture
def sdk() -> Any:
    return pytest.importorskip("rerun", reason="pip install 'ovmot[rerun]'")


def written(path: Path, rig: StereoRig, n: int = 15) -> Path:
    output = RerunOutput(path, rig)
    for k in range(n):
        output.write(result_at(k, rig))
    output.close()
    output.close()
    return path


def test_a_recording_holds_the_run(sdk: Any, tmp_path: Path, painted_rig: StereoRig) -> None:
    path = written(tmp_path / "deep" / "run.rrd", painted_rig)
    names = entity_names(path)
    for entity in (
        "/world/rig", "/world/rig/cam0", "/world/rig/cam1", "/world/rig/cam0/image",
        "/world/path", "/world/points/static", "/world/points/dynamic",
        "/world/objects/boxes", "/world/objects/trails",
        "/plots/speed/rig", "/plots/speed/object_1", "/plots/speed/object_2",
        "/plots/sigma/x", "/plots/ms/track", "/log",
    ):  # fmt: skip
        assert entity in names, entity
    assert "/plots/speed/object_9" not in names  # it is tentative


def entity_names(path: Path) -> set[str]:
    """The entities of a recording, as the SDK's own command line lists them."""
    printed = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", str(path)],
        check=True, capture_output=True, text=True,
    ).stdout  # fmt: skip
    return set(re.findall(r" - (/[\w/]+) - ", printed))


def test_a_file_is_not_overwritten_unasked(
    sdk: Any, tmp_path: Path, painted_rig: StereoRig
) -> None:
    path = written(tmp_path / "run.rrd", painted_rig, 1)
    with pytest.raises(InputError, match="is there already"):
        RerunOutput(path, painted_rig)
    RerunOutput(path, painted_rig, replace=True).close()
    with pytest.raises(InputError, match="is no name of a Rerun recording"):
        RerunOutput(tmp_path / "run.txt", painted_rig)
    with pytest.raises(InputError, match="cannot be written"):
        RerunOutput(path / "below.rrd", painted_rig)


def test_the_viewer_is_asked_for_on_this_machine_alone(
    sdk: Any, painted_rig: StereoRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[list[str]] = []

    class NoDisplay:
        def __init__(self, command: list[str], **_: object) -> None:
            started.append(command)

        def poll(self) -> int:
            return 1

        def terminate(self) -> None:
            pass

    monkeypatch.setattr(rerun_output, "_listens", lambda: False)
    monkeypatch.setattr(subprocess, "Popen", NoDisplay)
    with pytest.raises(InputError, match=r"does not start here .*--rerun FILE\.rrd"):
        RerunOutput("viewer", painted_rig)
    (command,) = started
    assert command[command.index("--bind") + 1] == "127.0.0.1"


def test_a_run_without_objects_and_images(sdk: Any, tmp_path: Path, painted_rig: StereoRig) -> None:
    output = RerunOutput(tmp_path / "run.rrd", painted_rig)
    result = result_at(0, painted_rig)
    features = FeatureFrame(result.timestamp_ns, np.empty(0, np.int64), np.empty((0, 4)))
    output.write(replace(result, tracks=(), frame=features))
    output.close()
    assert "/world/rig" in entity_names(tmp_path / "run.rrd")
