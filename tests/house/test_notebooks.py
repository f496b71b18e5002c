"""Every notebook runs from top to bottom and comes to what is stored with it, which stays small.

`python tests/house/test_notebooks.py [NAME ...]` runs notebooks and stores what they come to.
"""

import re
import sys
import tempfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.thorough

nbformat = pytest.importorskip("nbformat", reason="a GPU machine may lack what runs notebooks")
NotebookClient = pytest.importorskip("nbclient", reason="needs nbclient, which runs notebooks").NotebookClient
pytest.importorskip("ipykernel", reason="needs a kernel that runs the cells of notebooks")

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
TOLERANCE = 0.01
"""Relative difference that a number may have from the stored one, beside a unit in its last place: in double precision
and on one thread they differ by 0.004 at most."""
TOLERANCES = {"01_pump_concrete": 0.04, "07_flow": 0.07}
"""The same of a packing, which parts by rounding (measured 0.016), and of a surface, whose steps do (0.057)."""
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]*\w)")
PASSING = re.compile(r"(?:/[\w.-]+){2,}|\b[0-9a-f]{16,}\b")
"""Folders and hashes, which are others each time or on each machine."""


def executed(path, folder):
    """Return a notebook with fresh outputs, run in a folder."""
    notebook = nbformat.read(path, as_version=4)
    settings = {"kernel_name": "python3", "resources": {"metadata": {"path": str(folder)}}, "record_timing": False}
    NotebookClient(notebook, timeout=900, **settings).execute()
    return notebook


def texts(cell) -> list[str]:
    """Return what a cell prints and shows, pictures by their kind."""
    found = []
    for output in cell.outputs:
        data = output.get("data", {"text/plain": output.get("text", "")})
        kinds = [kind for kind in ("image/png", "text/markdown", "text/html", "text/plain") if kind in data]
        found.append(kinds[0] if kinds[0] == "image/png" else PASSING.sub("", data[kinds[0]]))
    return found


def differences(stored: str, fresh: str) -> list[float]:
    """Return how far numbers of a text are from stored ones, relative to these, less a unit in the last place."""
    words = [re.sub(r"[\s|-]+", " ", NUMBER.sub("#", text)) for text in (stored, fresh)]
    assert words[0] == words[1]
    found = []
    for old, new in zip(NUMBER.findall(stored), NUMBER.findall(fresh), strict=True):
        digits, _, power = old.partition("e")
        last = 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))
        off = max(0.0, abs(float(new) - float(old)) - 1.001 * last)
        found.append(off / max(abs(float(old)), last))
    return found


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_comes_to_what_is_stored(path, tmp_path):
    """All words, tables and kinds of pictures, and numbers within a tolerance; of cells that tell times, the kinds."""
    stored = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    fresh = [cell for cell in executed(path, tmp_path).cells if cell.cell_type == "code"]
    compared = []
    for old, new in zip(stored, fresh, strict=True):
        before, now = texts(old), texts(new)
        assert len(before) == len(now) and [b == "image/png" for b in before] == [n == "image/png" for n in now]
        if "timed" not in old.metadata.get("tags", ()):
            for one, other in zip(before, now, strict=True):
                compared += differences(one, other)
    assert len(compared) > 5 and max(compared) <= TOLERANCES.get(path.stem, TOLERANCE), max(compared)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_what_is_stored_is_small_and_whole(path):
    """Every cell has run in its turn, and none has a number typed into a sentence about results."""
    assert path.stat().st_size < 400_000
    cells = [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    assert cells[-1].outputs and not any(output.output_type == "error" for cell in cells for output in cell.outputs)


if __name__ == "__main__":
    for each in NOTEBOOKS:
        if not sys.argv[1:] or each.stem in sys.argv[1:]:
            with tempfile.TemporaryDirectory() as folder:
                nbformat.write(executed(each, folder), each)
            print(each.stem)
