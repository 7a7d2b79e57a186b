"""The command line: exit codes, and one line for each mistake."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import numpy as np
import pytest
import yaml

import ovmot
from ovmot.cli import app as cli
from ovmot.datasets.kalibr import write_chain
from ovmot.datasets.text_tables import ns_to_seconds
from ovmot.errors import InputError, OvmotError
from ovmot.outputs.run_writer import RunWriter
from ovmot.settings import describe_settings
from ovmot.types import FrameResult
from ovmot.vio import visual_update
from ovmot.warmup import processes

START_NS = 1_403_636_580_000_000_000
STAMPS = [START_NS + 10**8 * i for i in range(12)]
FAST = [
    "--set", "tracker.max_features=80", "--set", "tracker.fast_threshold=12",
    "--set", "tracker.equalization=none",
]  # fmt: skip


Command = Callable[..., Any]


def whole_rows(path: Path) -> int:
    """Number of rows of a csv file, all whole."""
    text = path.read_text()
    assert text.endswith("\n")
    header, *rows = text.splitlines()
    assert all(row.count(",") == header.count(",") for row in rows)
    return len(rows)


def test_settings_lists_every_key(ovmot_command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    outcome = ovmot_command("settings")
    assert outcome.code == 0
    for key, _, default, _ in describe_settings():
        line = next(line for line in outcome.out.splitlines() if line.startswith(f"{key} "))
        assert f" = {default} " in line


def test_a_run(ovmot_command: Command, painted_euroc: Path, tmp_path: Path) -> None:
    outcome = ovmot_command("run", painted_euroc, "-o", tmp_path / "out", "--save-points", *FAST)
    assert outcome.code == 0, outcome.err
    found = re.match(
        r"(\d+) frames, \d+ moving objects? in [\d.]+ s \([\d.]+ frames/s\) -> ", outcome.out
    )
    assert found is not None
    assert int(found.group(1)) == whole_rows(tmp_path / "out" / "state.csv") >= 6
    assert whole_rows(tmp_path / "out" / "points.csv") > 100
    told = json.loads((tmp_path / "out" / "run.json").read_text())
    assert told["settings"]["tracker"]["max_features"] == 80


def test_given_poses_need_no_pose_on_the_imu(
    ovmot_command: Command, painted_euroc: Path, tmp_path: Path
) -> None:
    chain = tmp_path / "chain.yaml"
    write_chain(chain, ovmot.open(painted_euroc).rig)
    cameras = yaml.safe_load(chain.read_text())
    chain.write_text(
        yaml.safe_dump(
            {n: {k: v for k, v in c.items() if k != "T_cam_imu"} for n, c in cameras.items()}
        )
    )
    poses = tmp_path / "poses.tum"
    poses.write_text("".join(f"{ns_to_seconds(t)} 0 0 0 0 0 0 1\n" for t in STAMPS))
    command = ("run", painted_euroc, "--calibration", chain, "-o", tmp_path / "out", *FAST)
    said = ovmot_command(*command)
    assert said.code == 2
    assert "T_cam_imu': the camera's pose on the IMU is missing" in said.complaint
    said = ovmot_command(*command, "--ego", "poses", poses)
    assert said.code == 0, said.err
    assert "the given poses are those of the left camera" in said.err


def test_ego_poses_from_tum_and_kitti(
    ovmot_command: Command, painted_euroc: Path, tmp_path: Path
) -> None:
    tum, kitti = tmp_path / "poses.tum", tmp_path / "0000.txt"
    tum.write_text("".join(f"{ns_to_seconds(t)} 0 0 0 0 0 0 1\n" for t in STAMPS[2:]))
    kitti.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 12)
    for poses, n in ((tum, 10), (kitti, 12)):
        out = tmp_path / poses.stem
        outcome = ovmot_command("run", painted_euroc, "-o", out, "--ego", "poses", poses, *FAST)
        assert outcome.code == 0, outcome.err
        assert whole_rows(out / "state.csv") == n
        if n == 10:
            assert f"{tum}: frames for which it has no pose: left out (2)" in outcome.complaint


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--set", "tracker.max_feature=80"], "unknown key 'tracker.max_feature'"),
        (["--set", "tracker.max_features=many"], "'tracker.max_features'"),
        (["--set", "tracker.max_features"], "section.key=value"),
        (["--config", "nowhere.yaml"], "nowhere.yaml"),
        (["--format", "rosbag"], "--format rosbag: unknown; known: euroc, kaist, kitti"),
        (["--ego", "filter", "x"], "--ego filter: unknown; write --ego poses FILE"),
        (["--ego", "poses", "nowhere.txt"], "nowhere.txt"),
        (["--calibration", "nowhere.yaml"], "nowhere.yaml"),
        (["--first", "12"], "the sequence has frames 0 to 11"),
        (["--sequence", "0010"], "--sequence 0010"),
    ],
)
def test_a_wrong_argument_is_one_line_and_exit_code_2(
    ovmot_command: Command, painted_euroc: Path, tmp_path: Path, arguments: list[str], message: str
) -> None:
    outcome = ovmot_command("run", painted_euroc, "-o", tmp_path / "out", *arguments)
    assert outcome.code == 2
    assert message in outcome.complaint
    assert outcome.complaint.startswith("ovmot: ")
    assert not (tmp_path / "out").exists()


def test_a_missing_folder(ovmot_command: Command, tmp_path: Path) -> None:
    outcome = ovmot_command("run", tmp_path / "nothing", "-o", tmp_path / "out")
    assert outcome.code == 2
    assert f"{tmp_path / 'nothing'}: no such folder" in outcome.complaint


def test_usage_errors_are_exit_code_2(ovmot_command: Command, tmp_path: Path) -> None:
    assert ovmot_command("run").code == 2
    assert ovmot_command("fly").code == 2
    assert ovmot_command("run", tmp_path, "-o", tmp_path, "--first", "-1").code == 2


@pytest.mark.parametrize("damage", ["truncated", "empty"])
def test_a_broken_image_in_the_middle(
    ovmot_command: Command, painted_euroc: Path, tmp_path: Path, damage: str
) -> None:
    image = painted_euroc / "mav0" / "cam0" / "data" / f"{STAMPS[9]}.png"
    image.write_bytes(image.read_bytes()[:2000] if damage == "truncated" else b"")
    outcome = ovmot_command("run", painted_euroc, "-o", tmp_path / "out", *FAST)
    assert outcome.code == 2
    assert str(image) in outcome.complaint
    assert damage in outcome.complaint
    assert 1 <= whole_rows(tmp_path / "out" / "state.csv") <= 9
    assert json.loads((tmp_path / "out" / "run.json").read_text())["ended"].startswith("failed")


def test_a_broken_imu_row(ovmot_command: Command, painted_euroc: Path, tmp_path: Path) -> None:
    path = painted_euroc / "mav0" / "imu0" / "data.csv"
    rows = path.read_text().splitlines()
    rows[50] = rows[50].rsplit(",", 1)[0] + ",abc"
    path.write_text("\n".join(rows) + "\n")
    outcome = ovmot_command("run", painted_euroc, "-o", tmp_path / "out")
    assert outcome.code == 2
    assert f"{path}, row 51: 'abc' is not a number" in outcome.complaint


def test_what_files_hold_does_not_steer_the_terminal(
    ovmot_command: Command, painted_euroc: Path, tmp_path: Path
) -> None:
    rows = painted_euroc / "mav0" / "imu0" / "data.csv"
    rows.write_text(rows.read_text() + "\x1b]0;title\x07,1,2,3,4,5,6\n")
    outcome = ovmot_command("run", painted_euroc, "-o", tmp_path / "out")
    assert outcome.code == 2
    assert "'?]0;title?' is not a stamp" in outcome.err


@pytest.mark.parametrize("name", ["drive", "drive/drive.db3"])
def test_the_bag_that_is_read_is_not_written_over(tmp_path: Path, name: str) -> None:
    (tmp_path / "drive").mkdir()
    read: Any = SimpleNamespace(kind="bag", root=tmp_path / "drive")
    with pytest.raises(InputError, match="is the bag that is read"):
        cli._bag_output(tmp_path / name, read, None, True)
    folder: Any = SimpleNamespace(kind="euroc", root=tmp_path / "drive")
    cli._bag_output(tmp_path / name, folder, None, True)  # no complaint


def test_an_existing_run(ovmot_command: Command, painted_euroc: Path, tmp_path: Path) -> None:
    arguments = ("run", painted_euroc, "-o", tmp_path / "out", *FAST)
    assert ovmot_command(*arguments).code == 0
    outcome = ovmot_command(*arguments)
    assert outcome.code == 2
    assert "--force" in outcome.complaint
    assert ovmot_command(*arguments, "--force").code == 0


def test_a_numerical_failure_is_exit_code_1(
    ovmot_command: Command, painted_euroc: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise np.linalg.LinAlgError("Matrix is not positive definite")

    monkeypatch.setattr(visual_update, "msckf_update", fail)
    monkeypatch.setattr(visual_update, "_MIN_VIEWS", 1)  # a standing rig ends few features
    outcome = ovmot_command("run", painted_euroc, "-o", tmp_path / "out", *FAST)
    assert outcome.code == 1
    assert re.search(r"broke down at frame \d{19} ns: Matrix is not", outcome.complaint)


def test_an_interruption_is_exit_code_130(
    ovmot_command: Command, painted_euroc: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    true_write = RunWriter.write

    def write(self: RunWriter, result: FrameResult) -> None:
        if self.frames_written == 3:
            raise KeyboardInterrupt
        true_write(self, result)

    monkeypatch.setattr(RunWriter, "write", write)
    outcome = ovmot_command("run", painted_euroc, "-o", tmp_path / "out", *FAST)
    assert outcome.code == 130
    assert "interrupted; what was done until here is written whole" in outcome.complaint
    assert whole_rows(tmp_path / "out" / "state.csv") == 3
    assert json.loads((tmp_path / "out" / "run.json").read_text())["ended"] == "interrupted"


def test_a_full_disk_is_exit_code_1(
    ovmot_command: Command, painted_euroc: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write(self: RunWriter, result: FrameResult) -> None:
        raise OvmotError("state.csv: cannot write any further: No space left on device")

    monkeypatch.setattr(RunWriter, "write", write)
    outcome = ovmot_command("run", painted_euroc, "-o", tmp_path / "out", *FAST)
    assert outcome.code == 1
    assert "No space left on device" in outcome.complaint


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_to_the_real_process(
    painted_euroc: Path, tmp_path: Path, stop: signal.Signals
) -> None:
    """The signal comes while frames are being written."""
    out = tmp_path / "out"
    slow = (
        # a shell's background job starts with the signal ignored
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "import time; from ovmot.outputs.run_writer import RunWriter; w = RunWriter.write\n"
        "def slow(self, result): w(self, result); time.sleep(0.3)\n"
        "RunWriter.write = slow\n"
        "from ovmot.cli.app import main; main()"
    )
    arguments = ["run", str(painted_euroc), "-o", str(out), *FAST]
    process = subprocess.Popen(
        [sys.executable, "-c", slow, *arguments], stderr=subprocess.PIPE, text=True
    )
    state, deadline = out / "state.csv", time.monotonic() + 30.0
    while time.monotonic() < deadline and process.poll() is None:
        if state.exists() and state.read_text().count("\n") >= 3:
            break
        time.sleep(0.02)
    process.send_signal(stop)
    _, err = process.communicate(timeout=30.0)
    assert process.returncode == 130, err
    assert "Traceback" not in err
    assert whole_rows(state) >= 2
    assert json.loads((out / "run.json").read_text())["ended"] == "interrupted"


def test_an_interruption_while_the_command_line_loads() -> None:
    code = (
        "import sys\n"
        "class Stop:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'ovmot.cli.app': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Stop())\n"
        "from ovmot.__main__ import main; main()"
    )
    command = [sys.executable, "-c", code]
    ended = subprocess.run(command, check=False, capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (130, "")


@pytest.mark.parametrize("command", [["run", "-o", "out"], ["doctor"]])
def test_an_interruption_while_the_data_is_listed(
    ovmot_command: Command,
    painted_euroc: Path,
    monkeypatch: pytest.MonkeyPatch,
    command: list[str],
) -> None:
    def stop(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("ovmot.open", stop)
    outcome = ovmot_command(*command, painted_euroc)
    assert (outcome.code, outcome.err) == (130, "ovmot: interrupted; nothing was written\n")


def test_a_folder_whose_name_is_no_text(painted_euroc: Path, tmp_path: Path) -> None:
    """A byte that is not UTF-8, as Python holds it, in what is read, written and printed."""
    data = painted_euroc.rename(tmp_path / "data\udcff")
    out = tmp_path / "out\udcff"
    commands: tuple[list[str | Path], ...] = (["run", data, "-o", out, *FAST], ["doctor", data])
    for command in commands:
        ended = subprocess.run(
            [sys.executable, "-m", "ovmot", *map(os.fsencode, command)],
            check=False,
            capture_output=True,
            text=True,
            errors="replace",
        )
        assert "Traceback" not in ended.stderr
    assert json.loads((out / "run.json").read_text())["ended"] == "finished"


def test_the_first_run_compiles_beside_what_it_begins_with(
    ovmot_command: Command, painted_euroc: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A mistake in the input does not wait for it."""
    done: list[str] = []
    opened = ovmot.open

    class Noted(AbstractContextManager["Noted"]):
        def __enter__(self) -> Self:
            done.append("begin")
            return self

        def wait(self, on_progress: Callable[[int, int], None]) -> None:
            on_progress(1, 2)
            done.append("wait")

        def __exit__(self, *_: object) -> None:
            done.append("end")

    def noted(*arguments: Any) -> Any:
        done.append("open")
        return opened(*arguments)

    monkeypatch.setattr(processes, "needs_warm_up", lambda: True)
    monkeypatch.setattr(processes, "WarmUp", Noted)
    monkeypatch.setattr(ovmot, "open", noted)
    run = ovmot_command("run", painted_euroc, "-o", tmp_path / "out", *FAST)
    assert run.code == 0
    assert "compiles" in run.err
    assert done == ["begin", "open", "wait", "end"]
    done.clear()
    assert ovmot_command("run", tmp_path / "none", "-o", tmp_path / "no").code == 2
    assert done == ["begin", "open", "end"]


def test_a_key_near_to_the_one_that_was_meant(ovmot_command: Command) -> None:
    told = ovmot_command("config", "--set", "tracker.max_feature=80")
    assert told.code == 2
    assert (
        "unknown key 'tracker.max_feature'; did you mean 'tracker.max_features'?" in told.complaint
    )
