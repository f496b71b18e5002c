"""Notebooks: stored outputs equal fresh ones, numbers in texts come from the run, and browser services can open them.

`python tests/house/test_notebooks.py [NAME ...]` runs notebooks and stores what they come to.
"""

import ast
import os
import re
import sys
import tempfile
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat", reason="needs nbformat, which reads notebooks")

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
EACH = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
REPOSITORY = re.search(r'^Source = "(.+)"$', (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.M)[1]
TOLERANCE = 0.01
"""Relative difference that a number may have from the stored one, beside a unit in its last place: in double precision
and on one thread they differ by 0.004 at most."""
TOLERANCES = {"01_pump_concrete": 0.04, "07_flow": 0.07}
"""The same of a packing, which parts by rounding (measured 0.016), and of a surface, whose steps do (0.057)."""
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?(?![\w.]*\w)")
COMPILING = "compiling kernels"
"""First words of the line that a run prints while it compiles kernels, which later runs find in the cache."""
SHOWING = ("Markdown", "print")
"""Functions that show a text."""
LINK = re.compile(r"\]\(([^)\s]+)\)")
PASSING = re.compile(r"(?:/[\w.-]+){2,}|\b[0-9a-f]{16,}\b")
"""Folders and hashes, which are others each time or on each machine."""


def executed(path, folder):
    """Return a notebook with fresh outputs, run in a folder on a CPU, where the stored outputs are from."""
    NotebookClient = pytest.importorskip("nbclient", reason="needs nbclient, which runs notebooks").NotebookClient
    pytest.importorskip("ipykernel", reason="needs a kernel that runs the cells of notebooks")
    notebook = nbformat.read(path, as_version=4)
    settings = {"kernel_name": "python3", "resources": {"metadata": {"path": str(folder)}}, "record_timing": False}
    NotebookClient(notebook, timeout=900, **settings).execute(env=os.environ | {"CUDA_VISIBLE_DEVICES": ""})
    return notebook


def texts(cell) -> list[str]:
    """Return what a cell prints and shows, pictures by their kind, without lines about the compilation of kernels."""
    found = []
    for output in cell.outputs:
        printed = "".join(line for line in output.get("text", "").splitlines(True) if not line.startswith(COMPILING))
        if "text" in output and not printed:
            continue
        data = output.get("data", {"text/plain": printed})
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


@pytest.mark.thorough
@EACH
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


def cells_of(path, kind: str) -> list:
    """Return the cells of a notebook that are of the kind "code" or "markdown"."""
    return [cell for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == kind]


@EACH
def test_stored_outputs_are_small_and_complete(path):
    """Every cell has run, in order and without an error."""
    assert path.stat().st_size < 400_000
    cells = cells_of(path, "code")
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    assert not any(output.output_type == "error" for cell in cells for output in cell.outputs)


@EACH
def test_a_notebook_begins_with_a_question_and_ends_with_a_picture_and_a_sentence(path):
    head = cells_of(path, "markdown")[0].source.partition("\n")[0]
    assert head.startswith("# ") and head.endswith("?")
    *shown, answer = cells_of(path, "code")[-1].outputs
    assert nbformat.read(path, as_version=4).cells[-1].cell_type == "code"
    assert any("image/png" in output.get("data", ()) for output in shown)
    sentence = answer.data["text/markdown"]
    assert sentence.endswith(".") and NUMBER.search(sentence)


def numbers(text: str) -> set[float]:
    """Return the numbers in a text, without those in code, addresses of links and years of publications."""
    text = re.sub(r"`[^`]*`|\]\([^)]*\)|\(\d{4}\)", " ", text)
    return {float(word) for word in NUMBER.findall(text)}


def typed_texts(source: str) -> list[str]:
    """Return the parts of f-strings, and of texts that `Markdown` or `print` show, that the code itself contains."""
    tree = ast.parse(re.sub(r"^(\s*)%.*$", r"\1pass", source, flags=re.M))
    formats = {node.format_spec for node in ast.walk(tree) if isinstance(node, ast.FormattedValue)}
    shown = [node.values for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) and node not in formats]
    shown += [node.args for node in ast.walk(tree) if getattr(getattr(node, "func", None), "id", "") in SHOWING]
    found = [part.value for parts in shown for part in parts if isinstance(part, ast.Constant)]
    return [text for text in found if isinstance(text, str)]


@EACH
def test_numbers_in_texts_come_from_the_run(path):
    """Sentences about results contain no typed number, and other texts only numbers that the code uses as well.

    A text may state a number in another unit than the code, which differs by a power of ten.
    """
    code = [cell.source for cell in cells_of(path, "code")]
    typed = [text for source in code for text in typed_texts(source) if numbers(text)]
    assert not typed
    used = {float(word) for source in code for word in re.findall(r"\d+\.?\d*(?:e[-+]?\d+)?", source)}
    factors = [10.0**power for power in (-6, -3, -2, 0, 2, 3, 6)]
    for cell in cells_of(path, "markdown"):
        for number in numbers(cell.source):
            assert any(abs(number - f * each) < 1e-9 * abs(number) for each in used for f in factors), (number, cell)


def test_typed_numbers_are_found():
    assert numbers("of 46 m and 2.5e3 Pa (2019), `length=3` and [a page](x/7.md), m3") == {46.0, 2500.0}
    code = 'if a:\n    %pip install b\nMarkdown(f"{x / 3:.1f} of 46 m")\nprint("at 5 L/s", 7)\nopen("8 m")'
    assert typed_texts(code) == [" of 46 m", "at 5 L/s"]


@EACH
def test_a_browser_service_opens_a_notebook_and_installs_the_package(path):
    """Both badges lead to this notebook; its first cell installs the package only where it is missing."""
    name = f"notebooks/{path.name}"
    owner = REPOSITORY.removeprefix("https://github.com/")
    links = LINK.findall(cells_of(path, "markdown")[0].source)
    assert f"https://colab.research.google.com/github/{owner}/blob/main/{name}" in links
    assert f"https://mybinder.org/v2/gh/{owner}/main?labpath={name.replace('/', '%2F')}" in links
    first = cells_of(path, "code")[0]
    assert not first.outputs
    condition, install = first.source.splitlines()[-2:]
    assert re.fullmatch(r'if find_spec\("(warpcrete|optuna)"\) is None:', condition)
    extra = "[calibrate]" if "optuna" in condition else ""
    assert install == f'    %pip install --quiet "warpcrete{extra} @ git+{REPOSITORY}"'


@EACH
def test_links_work_wherever_a_notebook_is_opened(path):
    """Links lead to existing pages of the published repository, because services show a notebook alone."""
    outputs = [output.get("data", {}) for cell in cells_of(path, "code") for output in cell.outputs]
    written = [cell.source for cell in cells_of(path, "markdown")]
    for target in LINK.findall("\n".join([*written, *(each.get("text/markdown", "") for each in outputs)])):
        assert target.startswith("https://"), target
        if page := re.fullmatch(rf"{REPOSITORY}/blob/main/([^#]+)", target):
            assert (ROOT / page[1]).is_file(), target


def test_binder_installs_what_the_notebooks_need():
    """Binder builds one environment for all notebooks, from the root of the repository."""
    assert (ROOT / ".binder/requirements.txt").read_text(encoding="utf-8").split("\n")[-2] == ".[calibrate,notebook]"


if __name__ == "__main__":
    for each in NOTEBOOKS:
        if not sys.argv[1:] or each.stem in sys.argv[1:]:
            with tempfile.TemporaryDirectory() as folder:
                nbformat.write(executed(each, folder), each)
            print(each.stem)
