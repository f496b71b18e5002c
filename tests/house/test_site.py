"""The pages of the documentation: links, lengths, beginnings and ends, and docstrings of public names."""

import ast
import importlib
import inspect
import pkgutil
import re
from pathlib import Path

import pytest

import warpcrete

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "notebooks"
OUTER = [ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
WRITTEN = "reference/generated/"
"""Folder of the pages that are written from the program when the site is built."""
LONGEST = 1500
"""Words that a page may have, except a page of the theory manual."""
INTERNAL = ("warpcrete.kernels", "warpcrete.cli", "warpcrete.scenes", "warpcrete.__main__")
"""Packages whose names are not public, or that have a reference of their own."""
PUBLISHED = re.compile(r"^https://github\.com/warpcrete/warpcrete/(blob|raw)/main/")
LINK = re.compile(r"\]\(([^)\s]+)\)")


def pages() -> dict[str, str]:
    """Return the text of every page without its blocks of code, by its path below `notebooks`."""
    found = {}
    for path in sorted(PAGES.rglob("*.md")):
        name = path.relative_to(PAGES).as_posix()
        if not name.startswith((WRITTEN, "_site/")):
            found[name] = without_code(path.read_text(encoding="utf-8"))
    return found


def without_code(text: str) -> str:
    """Return a Markdown text without its fenced blocks."""
    return re.sub(r"^(`{3,}).*?^\1", "", text, flags=re.S | re.M)


def words(text: str) -> int:
    """Return the number of words of a page; numbers are none, but words in tables are."""
    return sum(re.search("[A-Za-z]", word) is not None for word in text.split())


def anchors(text: str) -> set[str]:
    """Return the targets that the headings of a page make."""
    heads = re.findall(r"^#+ (.*)$", text, re.M)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in heads}


TEXTS = pages()


@pytest.mark.parametrize("name", TEXTS)
def test_a_page_is_short_and_says_what_it_answers(name):
    text = TEXTS[name]
    head, first = text.strip().split("\n\n")[:2]
    assert head.startswith("# ") and "?" in first, f"{name} must start with the question that it answers"
    assert "## Not covered" in text, f"{name} must end with what it does not cover"
    assert name.startswith("theory/") or words(text) <= LONGEST, f"{name} has {words(text)} words"


@pytest.mark.parametrize(
    "path", [*OUTER, *(PAGES / name for name in TEXTS)], ids=lambda p: p.relative_to(ROOT).as_posix()
)
def test_links_lead_somewhere(path):
    for target in LINK.findall(without_code(path.read_text(encoding="utf-8"))):
        target = PUBLISHED.sub("", target)  # README links to the published repository, because PyPI shows it as well
        if re.match(r"[a-z]+:", target):
            continue
        place, _, anchor = target.partition("#")
        to = (path.parent / place).resolve() if place else path
        if WRITTEN in to.as_posix():
            continue  # These pages exist only in a built site; the build checks links to them.
        assert to.exists(), f"{path.name}: {target}"
        if anchor:
            assert anchor in anchors(without_code(to.read_text(encoding="utf-8"))), f"{path.name}: {target}"


def test_every_page_is_in_a_table_of_contents():
    listed = {"index.md"}
    for name in TEXTS:
        folder = (PAGES / name).parent
        for block in re.findall(r"```\{toctree\}\n(.*?)```", (PAGES / name).read_text(encoding="utf-8"), re.S):
            entries = [line for line in block.splitlines() if line and not line.startswith(":")]
            listed |= {(folder / f"{entry}.md").resolve().relative_to(PAGES).as_posix() for entry in entries}
    assert not set(TEXTS) - listed


def test_names_that_guides_import_are_listed_as_stable():
    stable = {("warpcrete", name) for name in warpcrete.__all__}
    listed = (PAGES / "reference" / "stability.md").read_text(encoding="utf-8")
    for module, names in re.findall(r"^\| `(warpcrete\.[\w.]+)` \| (.*) \|$", listed, re.M):
        stable |= {(module, name) for name in re.findall(r"`(\w+)`", names)}
    for path in sorted((PAGES / "how-to").glob("*.md")):
        for block in re.findall(r"^```python\n(.*?)^```", path.read_text(encoding="utf-8"), re.S | re.M):
            for line in ast.walk(ast.parse(block)):
                if isinstance(line, ast.ImportFrom) and (line.module or "").startswith("warpcrete"):
                    assert {(line.module, each.name) for each in line.names} <= stable, f"{path.name}: {line.module}"
                if isinstance(line, ast.Import):
                    assert not [each.name for each in line.names if each.name.startswith("warpcrete.")], path.name


def test_stable_names_exist():
    """Modules of `warpcrete.kernels` load Warp, so that names in them are looked for in their source."""
    listed = (PAGES / "reference" / "stability.md").read_text(encoding="utf-8")
    table = re.findall(r"^\| `(warpcrete\.[\w.]+)` \| (.*) \|$", listed, re.M)
    assert len(table) > 10
    for module, names in table:
        for name in re.findall(r"`(\w+)`", names):
            if module.startswith("warpcrete.kernels."):
                source = ROOT.joinpath(*module.split(".")[1:]).with_suffix(".py").read_text(encoding="utf-8")
                assert re.search(rf"\b(def|class) {name}\b", source), (module, name)
            else:
                assert hasattr(importlib.import_module(module), name), (module, name)


def test_exported_names_exist_and_are_those_of_the_reference():
    for path in sorted((ROOT / "warpcrete").rglob("*.py")):
        if "\n__all__ = [" not in path.read_text(encoding="utf-8"):
            continue
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        module = importlib.import_module(name)
        assert not [each for each in module.__all__ if not hasattr(module, each)], name
    page = (PAGES / "reference" / "python.md").read_text(encoding="utf-8")
    listed = re.search(r":nosignatures:\n\n(.*?)```", page, re.S)[1].split()
    assert sorted([*listed, "__version__", "scenes"]) == sorted(warpcrete.__all__)
    assert set(dir(warpcrete)) == set(warpcrete.__all__)


def public_names() -> list[tuple[str, object]]:
    """Return all public classes, functions, methods and properties, with those that modules define themselves."""
    found: list[tuple[str, object]] = []
    for info in pkgutil.walk_packages(warpcrete.__path__[:1], "warpcrete."):
        if info.name.startswith(INTERNAL):
            continue
        module = importlib.import_module(info.name)
        found.append((info.name, module))
        for name, value in vars(module).items():
            if name.startswith("_") or getattr(value, "__module__", None) != info.name:
                continue
            if inspect.isfunction(value) or inspect.isclass(value):
                found.append((f"{info.name}.{name}", value))
            if inspect.isclass(value):
                found += [(f"{info.name}.{name}.{each}", getattr(value, each)) for each, member in vars(value).items()
                          if not each.startswith("_") and getattr(member, "__name__", "") != "<lambda>"
                          and (inspect.isroutine(member) or isinstance(member, property))]  # fmt: skip
    return found


def test_every_public_name_has_a_docstring():
    """Count a docstring that a method inherits, because it is the interface's."""
    assert not [name for name, value in public_names() if not inspect.getdoc(value)]


@pytest.mark.parametrize(
    "path", [*OUTER, *(PAGES / name for name in TEXTS)], ids=lambda p: p.relative_to(ROOT).as_posix()
)
def test_no_list_item_is_inside_another(path):
    """Find items that a re-wrapped paragraph has swallowed, so that a reader sees their dash or number as text."""
    text = without_code(path.read_text(encoding="utf-8"))
    assert not re.findall(r"[.;] - [A-Za-z*`].*|[.)] [2-9]\. [A-Z*`].*", text)
    # A plus sign at the start of a line makes an item of a wrapped formula, although items here begin with a dash.
    assert not re.findall(r"^ *\+ .*", text, re.M)


def test_tables_in_outputs_of_notebooks_are_shown_as_tables():
    """MyST-NB reads outputs as CommonMark by default, which has no tables."""
    texts = [path.read_text(encoding="utf-8") for path in PAGES.glob("*.ipynb")]
    configuration = (PAGES / "conf.py").read_text(encoding="utf-8")
    assert any('"|---' in text or '"| --- ' in text for text in texts)
    assert re.search(r'^nb_render_markdown_format = "myst"', configuration, re.M)
