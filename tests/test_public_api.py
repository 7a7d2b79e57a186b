"""The names of `ovmot`: what they are, what importing them costs, and that they are typed."""

import ast
import os
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import ovmot
from ovmot.datasets.pose_files import read_tum

SOURCE = Path(ovmot.__file__)
HEAVY = (
    "numpy",
    "scipy",
    "cv2",
    "numba",
    "matplotlib",
    "av",
    "rosbags",
    "pydantic",
    "rich",
    "yaml",
)

USER_PROGRAM = """\
from pathlib import Path
from typing import assert_type

import numpy as np
from numpy.typing import NDArray

import ovmot

Floats = NDArray[np.float64]
sequence = ovmot.open("MH_01_easy", format="euroc", calibration=Path("chain.yaml"))
assert_type(sequence, ovmot.RecordedSequence)
settings = ovmot.load_settings(Path("mine.yaml"), ["tracker.max_features=300"])
assert_type(settings, ovmot.Settings)
camera = ovmot.Camera.from_matrix(np.eye(3), (640, 480), "radtan", [0.0, 0.0, 0.0, 0.0])
rig = ovmot.StereoRig.make(camera, camera, np.eye(4), np.eye(4))
odometry = ovmot.Odometry(rig, sequence.imu_noise, settings)
for event in sequence:
    assert_type(event, ovmot.ImuSample | ovmot.StereoFrame | ovmot.FeatureFrame)
    for frame in odometry.add(event):
        assert_type(frame.T_world_imu, Floats)
        assert_type(frame.covariance, Floats)
        assert_type(frame.tracks, tuple[ovmot.ObjectTrack, ...])
        assert_type(frame.health is ovmot.Health.LOST, bool)
assert_type(odometry.finish(), list[ovmot.FrameResult])
ovmot.run_sequence(sequence, settings, ovmot.RunOptions("out", save_points=True))
run = ovmot.Run("out")
assert_type(run.trajectory.T_world_imu, Floats)
metrics = ovmot.evaluate(run, "MH_01_easy").scalars()
assert_type(metrics, dict[str, float | None])
ovmot.simulate("traffic", seed=1, size=(320, 140)).write("street", format="asl")
try:
    ovmot.evaluate("out", Path("truth.txt"))
except ovmot.InputError as error:
    print(error)
wrong: int = ovmot.open("there")  # the one mistake
"""
MYPY_INI = """\
[mypy]
strict = true
follow_imports = silent
# whose own types are none of the program's: reading them would take longer than all the rest
[mypy-scipy.*,cv2.*,pydantic.*,av.*,matplotlib.*,rosbags.*,rich.*,numba.*,yaml.*]
follow_imports = skip
"""


def typed_names() -> dict[str, str]:
    """The names that type checkers see, and the module that each is from."""
    tree = ast.parse(SOURCE.read_text(encoding="utf-8"))
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    return {
        name.asname or name.name: str(statement.module)
        for statement in block.body
        if isinstance(statement, ast.ImportFrom)
        for name in statement.names
    }


def test_types_and_run_time_know_the_same_names() -> None:
    typed = typed_names()
    assert sorted(typed) == sorted(ovmot.__all__)
    assert len(set(ovmot.__all__)) == len(ovmot.__all__) >= 40
    for name, home in typed.items():
        there = "open_recording" if name == "open" else name
        assert getattr(ovmot, name) is getattr(import_module(home), there), name
    assert set(ovmot.__all__) <= set(dir(ovmot))


def test_no_module_hides_a_public_name() -> None:
    """A submodule, once imported, becomes an attribute of the package."""
    modules = {path.stem for path in SOURCE.parent.iterdir() if not path.name.startswith("_")}
    assert "odometry" in modules
    assert not modules & set(ovmot.__all__)


def test_a_name_that_is_not_there() -> None:
    with pytest.raises(AttributeError, match="module 'ovmot' has no attribute 'slam'"):
        ovmot.slam  # noqa: B018


def test_importing_costs_nothing() -> None:
    """No library is loaded by `import ovmot`; what a name does not need stays out with it too."""
    code = (
        "import sys, time\n"
        "begin = time.perf_counter(); import ovmot; spent = time.perf_counter() - begin\n"
        f"print(spent, *(m for m in {HEAVY} if m in sys.modules))\n"
        "ovmot.InputError\n"
        f"print(*(m for m in {HEAVY} if m in sys.modules))\n"
        "ovmot.Odometry\n"
        "print(*(m for m in ('matplotlib', 'av', 'rosbags') if m in sys.modules))\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    )  # fmt: skip
    bare, error, odometry = ended.stdout.split("\n")[:3]
    spent, *loaded = bare.split()
    assert loaded == []
    assert float(spent) < 1.0  # 10 ms; a library would take more than this on a slow machine
    assert error == ""
    assert odometry == ""


@pytest.mark.slow
def test_a_program_of_a_user_is_checked_strictly(tmp_path: Path) -> None:
    """Its types are those that it asserts, and the one mistake in it is found."""
    (tmp_path / "program.py").write_text(USER_PROGRAM)
    (tmp_path / "mypy.ini").write_text(MYPY_INI)
    ended = subprocess.run(
        [sys.executable, "-m", "mypy", "--no-incremental", "program.py"],
        check=False, capture_output=True, text=True, cwd=tmp_path,
        env={**os.environ, "MYPYPATH": str(SOURCE.parents[1])},
    )  # fmt: skip
    numbered = enumerate(USER_PROGRAM.splitlines(), start=1)
    mistake = next(number for number, line in numbered if line.startswith("wrong"))
    found = ended.stdout.splitlines()
    assert len(found) == 2, ended.stdout + ended.stderr
    assert found[0].startswith(f"program.py:{mistake}: error: Incompatible types in assignment")
    assert '"RecordedSequence"' in found[0]


def test_the_odometry_by_hand_equals_a_run(painted_euroc: Path, tmp_path: Path) -> None:
    """What `ovmot run` writes is what the program of five lines prints."""
    sequence = ovmot.open(str(painted_euroc))
    odometry = ovmot.Odometry(sequence.rig, sequence.imu_noise)
    results = [result for event in sequence for result in odometry.add(event)]
    assert odometry.finish() == odometry.finish() == []
    ovmot.run_sequence(sequence, ovmot.Settings(), ovmot.RunOptions(str(tmp_path / "out")))
    written = read_tum(tmp_path / "out" / "trajectory.tum")
    assert written.timestamp_ns.tolist() == [result.timestamp_ns for result in results]
    assert len(results) >= 6
    poses = np.array([result.T_world_imu for result in results])
    np.testing.assert_allclose(written.T_world_imu, poses, rtol=0.0, atol=2e-9)


def test_the_parts_of_a_result_are_those_of_its_state(painted_euroc: Path) -> None:
    sequence = ovmot.open(painted_euroc)
    odometry = ovmot.Odometry(sequence.rig, sequence.imu_noise)
    result = next(result for event in sequence for result in odometry.add(event))
    assert result.T_world_imu is result.ego.T_world_imu
    assert result.velocity is result.ego.velocity
    assert result.covariance.shape == (15, 15)
    assert result.health is ovmot.Health.TRACKING
    assert result.timestamp_ns in sequence.frame_ns
    odometry.finish()


def test_mistakes_are_one_line(tmp_path: Path) -> None:
    for call in (
        lambda: ovmot.open(str(tmp_path / "none")),
        lambda: ovmot.Run(str(tmp_path)),
        lambda: ovmot.load_settings(str(tmp_path / "none.yaml")),
        lambda: ovmot.load_settings(overrides=["tracker.max=3"]),
        lambda: ovmot.simulate("nowhere"),
        lambda: ovmot.evaluate(str(tmp_path / "none"), str(tmp_path)),
    ):
        with pytest.raises(ovmot.InputError, match=r"^[^\n]+$"):
            call()
