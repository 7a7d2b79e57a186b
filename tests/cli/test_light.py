"""The command line before a command runs: names, help, completion, versions; no library loaded."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from typing import Any, get_args

import pytest

import ovmot
from ovmot.cli import names
from ovmot.cli.version import version_lines

Command = Callable[..., Any]
# Pydantic is not among them: newer versions of Typer load it themselves
HEAVY = ("numpy", "scipy", "cv2", "numba", "matplotlib", "av", "rosbags", "yaml")
COMMANDS = (
    "run", "simulate", "evaluate", "demo", "batch", "doctor", "calibrate", "ros", "ros2",
    "settings", "config", "warmup",
)  # fmt: skip


def test_names_are_those_of_the_registries() -> None:
    assert tuple(ovmot.DATASETS) == names.FORMATS
    assert tuple(ovmot.PRESETS) == names.PRESET_FORMATS
    assert tuple(ovmot.WRITERS) == names.WRITER_FORMATS
    assert names.SCENES == ovmot.SCENES
    assert get_args(names.View) == get_args(ovmot.View)


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help_is_whole_and_shows_no_value_where_none_is_given(
    ovmot_command: Command, command: str
) -> None:
    told = ovmot_command(*command.split(), "--help")
    assert told.code == 0
    assert "<bool>" not in told.out
    assert "list[" not in told.out.partition("Options:")[2]
    if not command:
        listed = re.findall(r"^  (\w+)  +\S.*[^.]\.$", told.out, re.MULTILINE)
        assert set(COMMANDS) <= set(listed)  # each with one whole sentence


def test_help_and_completion_load_no_library() -> None:
    code = (
        "import sys\nfrom ovmot.cli.app import app\n"
        "try:\n    app()\nexcept SystemExit:\n    pass\n"
        f"print('loaded:', *(m for m in {HEAVY} if m in sys.modules))\n"
    )
    for arguments, extra, expected in (
        (["run", "--help"], {}, "--save-points"),
        ([], {"COMP_WORDS": "ovmot run --format e", "COMP_CWORD": "3"}, "euroc"),
    ):
        if extra:
            extra |= {"_OVMOT_COMPLETE": "complete_bash"}
        ended = subprocess.run(
            [sys.executable, "-c", code.replace("app()", "app(prog_name='ovmot')"), *arguments],
            check=True, capture_output=True, text=True, env={**os.environ, **extra},
        )  # fmt: skip
        *_, loaded = ended.stdout.splitlines()
        assert expected in ended.stdout
        assert loaded == "loaded:"


def test_version(ovmot_command: Command) -> None:
    told = ovmot_command("--version")
    assert told.code == 0
    assert told.out.splitlines() == version_lines()
    first, packages, processor = told.out.splitlines()
    assert first.startswith(f"ovmot {ovmot.__version__}")
    assert re.search(r"Python 3\.\d+\.\d+.*, numpy \d.*numba \d", packages)
    assert processor.startswith("Linux ")
