"""A short street and a run of it, which the pages' commands and programs are tried on."""

from pathlib import Path

import pytest
from doc_desk import Desk

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


@pytest.fixture
def desk(
    tmp_path: Path, docs_street: Path, docs_run: Path, monkeypatch: pytest.MonkeyPatch
) -> Desk:
    """An empty folder, the present one, in which names of the pages are made when needed."""
    monkeypatch.chdir(tmp_path)
    return Desk(tmp_path, docs_street, docs_run)
