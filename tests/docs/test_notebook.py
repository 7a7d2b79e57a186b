"""The notebook runs from its first cell to its last, in an empty folder."""

from pathlib import Path

import pytest
from doc_blocks import ROOT

NOTEBOOK = ROOT / "examples" / "from_data_to_plots.ipynb"


@pytest.mark.slow
def test_the_notebook_runs(tmp_path: Path) -> None:
    nbformat = pytest.importorskip("nbformat", reason="make install-docs")
    nbclient = pytest.importorskip("nbclient", reason="make install-docs")
    pytest.importorskip("ipykernel", reason="make install-docs")
    pytest.importorskip("pandas", reason="make install-docs")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    nbformat.validate(notebook)
    assert all(not cell.get("outputs") for cell in notebook.cells)  # none are committed
    client = nbclient.NotebookClient(
        notebook,
        timeout=600,
        kernel_name="python3",
        resources={"metadata": {"path": str(tmp_path)}},
    )
    client.execute()
    shown = [
        kind for cell in notebook.cells for out in cell.get("outputs", [])
        for kind in out.get("data", {})
    ]  # fmt: skip
    assert shown.count("image/png") == 4
    assert shown.count("text/html") >= 3
    assert (tmp_path / "notebook_data" / "run" / "tracks.csv").stat().st_size > 1000
