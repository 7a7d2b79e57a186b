"""Every command in the docs can be typed as it stands: all are parsed, most are run.

`ovmot` commands run in this process, in an empty folder, on a simulated street; the names in the
pages (DATA, OUT, chain.yaml, ...) are made when a command reads them. NOT_RUN and NOT_OURS say
what is not run, and why.
"""

import re
import shutil
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import typer
from doc_blocks import PAGES, ROOT, Command, all_commands, blocks_of, commands_of, page_name
from doc_desk import Desk

from ovmot.cli import app as cli

NOT_OURS = {
    "sudo": "needs root",
    "source": "changes the shell",
    "pip": "installs; tried by the wheel's own tests",
    "roscore": "ROS; see make test-ros",
    "rosbag": "ROS; see make test-ros",
    "roslaunch": "ROS; see make test-ros",
    "rostopic": "ROS; see make test-ros",
    "rosservice": "ROS; see make test-ros",
    "rosmsg": "ROS; see make test-ros",
    "eval": "sets the shell's variables; see tests/ros",
    "ln": "into a workspace of ROS; see make test-ros",
    "cd": "into a workspace of ROS; see make test-ros",
    "catkin_make": "ROS; see make test-ros",
    "/usr/bin/python3": "makes a virtual environment",
    "evo_ape": "another tool; tests compare with it in tests/evaluation",
    "evo_traj": "another tool; tests compare with it in tests/evaluation",
    "dask": "another tool; tests/batch uses it",
    "jupyter": "opens a browser; the notebook is run in test_notebook.py",
    ".ci/run": "runs these tests",
}
NOT_RUN = {
    r"ovmot ros2? ": "needs a ROS master; see make test-ros",
    r"ovmot (demo|warmup)": "minutes; the demo is tried by the wheel's own tests",
    r"ovmot batch ": "takes minutes; tests/batch runs plans",
    r"ovmot .*\$DATA": "real data",
    r"ovmot run kitti/": "real data",
    r"ovmot .*runs/": "the benchmarks' own streets, minutes each",
    r"ovmot .*--scene (?!demo)\w+ .*--(path|format)": "rendered in tests/sim and tests/datasets",
    r"ovmot .*estimator_config.yaml": "read in tests/datasets/test_openvins_config.py",
    r"ovmot calibrate (RUN|DATA) (?!--as-is)": "see tests/test_run_calibration.py",
    r"ovmot run drive/": "the folder's form of the bag before it",
}
"""Patterns of `ovmot` commands that are parsed alone."""

MAKE_TARGETS = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.M)


def why_not_run(command: Command) -> str | None:
    return next((why for form, why in NOT_RUN.items() if re.match(form, command.text)), None)


@pytest.mark.parametrize("command", all_commands(), ids=lambda c: f"{c.where}-{c.words[0]}")
def test_command_can_be_parsed(command: Command) -> None:
    """Options and arguments of `ovmot` exist; targets of `make` and files of `python` too."""
    program, *rest = command.words
    if program == "ovmot":
        parse(rest)
    elif program == "make":
        assert [w for w in rest if "=" not in w and w not in MAKE_TARGETS] == []
    elif program == "python" and rest[0] == "-m":
        assert find_spec(rest[1]) is not None, command.text
    elif program == "python":
        assert (ROOT / rest[0]).is_file(), command.text
    else:
        assert program in NOT_OURS, f"{command.where}: add {program} to NOT_OURS"


def parse(words: list[str]) -> None:
    """Raises a `ClickException` where the command line does not take these words."""
    group: Any = typer.main.get_command(cli.app)
    context = group.make_context("ovmot", words[:1])
    command = group.get_command(context, words[0])
    assert command is not None, f"no command {words[0]}"
    command.make_context(words[0], words[1:], parent=context)


def run_blocks() -> list[Path]:
    """Pages with a command that is run."""
    return [
        page
        for page in PAGES
        if any(
            command.words[0] == "ovmot" and why_not_run(command) is None
            for block in blocks_of(page)
            if block.language == "bash"
            for command in commands_of(block)
        )
    ]


@pytest.mark.slow
@pytest.mark.xdist_group("docs")
@pytest.mark.parametrize("page", run_blocks(), ids=page_name)
def test_commands_of_a_page_run(
    page: Path, desk: Desk, ovmot_command: Callable[..., object]
) -> None:
    """Block after block, in the order of the page; each command ends well.

    A command that the page has twice is run once. Streets are small and short, and a run of a page
    may replace the one before.
    """
    done: set[str] = set()
    for block in blocks_of(page):
        for command in commands_of(block) if block.language == "bash" else []:
            if command.words[0] != "ovmot" or why_not_run(command) or command.text in done:
                continue
            done.add(command.text)
            desk.provide(command.words[1:])
            outcome = ovmot_command(*_small(command.words[1:], desk.folder))
            # the doctor's 1 says that something is wrong in the data, which is its answer
            allowed = (0, 1) if command.words[1] == "doctor" else (0,)
            assert outcome.code in allowed, f"{command.where}: {command.text}\n{outcome.err}"  # type: ignore[attr-defined]


def _small(words: tuple[str, ...], folder: Path) -> list[str]:
    """The words, and what makes the command quick and lets it replace what is there."""
    name, *rest = words
    if name == "simulate":
        shutil.rmtree(folder / rest[0], ignore_errors=True)
        return [*words, "--duration", "2.5", "--size", "320x140"]
    if name == "run":
        return [*words, "--threads", "1", *([] if "--force" in words else ["--force"])]
    if name == "calibrate" and "--force" not in words:
        return [*words, "--force"]
    if name == "doctor" and "--fix" in words:
        (folder / words[words.index("--fix") + 1]).unlink(missing_ok=True)
    return list(words)
