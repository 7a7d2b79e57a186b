"""Every program and every YAML file in the pages works as it stands."""

import re
from pathlib import Path

import pytest
import yaml
from doc_blocks import PAGES, ROOT, Block, blocks_of
from doc_desk import Desk

import ovmot
from ovmot.batch.plan import read_plan

OTHERS_YAML = {"aprilgrid.yaml": "Kalibr's file"}
PROGRAMS = [block for page in PAGES for block in blocks_of(page) if block.language == "python"]


def test_there_are_programs() -> None:
    assert len(PROGRAMS) >= 6


@pytest.fixture(scope="module")
def long_street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """6 s, for the program that puts a fault at the fifth second."""
    folder = tmp_path_factory.mktemp("docs") / "long"
    ovmot.simulate("demo", seed=3, duration_s=6.2, size=(320, 140)).write(folder, "asl")
    return folder


@pytest.mark.slow
@pytest.mark.xdist_group("docs")
@pytest.mark.parametrize("block", PROGRAMS, ids=lambda block: block.name)
def test_program_runs(block: Block, desk: Desk, request: pytest.FixtureRequest) -> None:
    """In a folder with the data and the run that it names."""
    if "frame_ns[50]" in block.text:
        desk.street = request.getfixturevalue("long_street")
    named = re.findall(r"ovmot\.(?:open|Run)\(\"(\w+)\"", block.text)
    desk.provide(tuple(named))
    exec(compile(block.text, block.name, "exec"), {"__name__": "docs"})


def yaml_block(page: str, start: str) -> str:
    """The block of a page that begins so."""
    found = [b.text for b in blocks_of(ROOT / "docs" / page) if b.text.startswith(start)]
    assert len(found) == 1, f"{page}: {start}"
    return found[0]


def test_the_chain_written_by_hand_is_read(docs_street: Path, tmp_path: Path) -> None:
    """The chain of own-data.md is that rig: two equal cameras, half a metre apart."""
    chain = tmp_path / "chain.yaml"
    chain.write_text(yaml_block("own-data.md", "# chain.yaml"))
    rig = ovmot.open(docs_street, calibration=chain).rig
    assert (rig.cameras[0].width, rig.cameras[0].height) == (320, 200)
    baseline = rig.T_imu_cam1[:3, 3] - rig.T_imu_cam0[:3, 3]
    assert baseline == pytest.approx([0.0, -0.5, 0.0], abs=1e-9)


def test_the_smallest_scene_can_be_simulated(tmp_path: Path) -> None:
    scene = tmp_path / "mine.yaml"
    scene.write_text(yaml_block("simulator.md", "duration_s: 10"))
    assert len(ovmot.simulate(scene)) == pytest.approx(100, abs=1)


def test_the_plan_of_many_runs_is_read(tmp_path: Path) -> None:
    plan = tmp_path / "plan.yaml"
    plan.write_text(yaml_block("batch.md", "sequences:"))
    assert set(read_plan(plan).sequences) == {"mh01", "jam", "walk"}


def test_no_fenced_yaml_is_forgotten() -> None:
    """Those of other programs are named; the others are read above."""
    for page in PAGES:
        for block in blocks_of(page):
            if block.language == "yaml":
                assert yaml.safe_load(block.text)
                name = block.text.split("\n")[0].removeprefix("# ")
                assert name in OTHERS_YAML or name == "chain.yaml", block.name
