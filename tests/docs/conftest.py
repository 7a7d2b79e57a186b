"""A short street and a run of it, which the pages' commands and programs are tried on."""

from pathlib import Path

import pytest

import ovmot


@pytest.fixture(scope="session")
def docs_street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """2.5 s of the demo's street as a EuRoC folder with its truth, pictures of 320x140."""
    folder = tmp_path_factory.mktemp("docs") / "street"
    ovmot.simulate("demo", seed=3, duration_s=2.5, size=(320, 140)).write(folder, "asl")
    return folder


@pytest.fixture(scope="session")
def docs_run(docs_street: Path) -> Path:
    """The run of it, with its points."""
    out = docs_street.parent / "run"
    options = ovmot.RunOptions(out, save_points=True)
    ovmot.run_sequence(ovmot.open(docs_street), ovmot.Settings(), options)
    return out
