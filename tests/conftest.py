"""Fixtures that tests of several folders share."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def data_root() -> Path:
    """The folder with real and rendered sequences; the test skips where it is missing."""
    repository = Path(__file__).resolve().parents[1]
    root = Path(os.environ.get("OVMOT_DATA", repository.parent / "shared" / "data"))
    if not root.is_dir():
        pytest.skip(f"no data in {root}; set OVMOT_DATA to run this test")
    return root
