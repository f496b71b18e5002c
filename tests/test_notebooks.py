"""Every notebook runs from top to bottom, and what is stored with it stays small."""

from pathlib import Path

import pytest

pytestmark = pytest.mark.thorough

nbformat = pytest.importorskip("nbformat", reason="a GPU machine may lack what runs notebooks")
NotebookClient = pytest.importorskip("nbclient").NotebookClient
pytest.importorskip("ipykernel")

NOTEBOOKS = sorted((Path(__file__).parent.parent / "notebooks").glob("*.ipynb"))

EXPECTED = {
    "01_pump_concrete": (3, 1.1, 10.0),  # a rougher pipe needs more pressure
    "02_trade": (1, 0.0, 1.0),  # an error that was found, over what was promised
    "03_calibrate": (1, 0.98, 1.02),  # a stress that was held out, over what was measured
    "04_line": (1, 1.055, 1.07),  # pressure with a reducer, over that without
    "05_own_pipe": (2, 1.21, 1.24),  # pressure of a dented pipe, over that of a sound one
    "06_mix": (3, 0.106, 0.111),  # band of the pressure with a slip layer that was measured, over that with a guess
    "07_flow": (2, 0.70, 0.71),  # spread of a stiff concrete, over that of a soft one
}
"""Pictures, and the range of the last number that is printed."""


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_notebook_runs(path, tmp_path):
    notebook = nbformat.read(path, as_version=4)
    NotebookClient(notebook, timeout=300, kernel_name="python3", resources={"metadata": {"path": tmp_path}}).execute()
    outputs = [o for cell in notebook.cells if cell.cell_type == "code" for o in cell.outputs]
    pictures = [o for o in outputs if "image/png" in o.get("data", {})]
    pictured, lower, upper = EXPECTED[path.stem]
    assert len(pictures) >= pictured
    assert lower < float(outputs[-1]["text"].split()[-1]) <= upper


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_stored_outputs_are_small(path):
    assert path.stat().st_size < 400_000
