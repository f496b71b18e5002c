"""Installation: what wheels and sdists contain, how packages are found, and what the metadata states."""

import ast
import email
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest
from click.testing import CliRunner
from link_folders import link_folders
from ruamel.yaml import YAML

import warpcrete
from warpcrete.cli import cli

ROOT = Path(__file__).parents[2]
PROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
REPOSITORY = re.search(r'^Source = "(.+)"$', PROJECT, re.M)[1]
DATA = {"measured": (".json", ".yaml"), "schemas": (".json",)}
"""Folders of the package that hold data, and the endings of their files."""


def git(*arguments: str) -> str:
    """Return the output of a Git command; skip the test outside a checkout."""
    if not shutil.which("git"):
        pytest.skip("needs Git, which lists the files of the repository")
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, encoding="utf-8")
    if not (ROOT / ".git").exists() or done.returncode:
        pytest.skip("needs a Git checkout, whose files are compared; an sdist or a plain copy of the files is none")
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Unpacked folders of an sdist and of the wheel that is built from it, and the names of the files in both."""
    pytest.importorskip("hatchling", reason="needs hatchling, the build backend, which the extra [test] installs")
    folder = tmp_path_factory.mktemp("built")
    # Build a copy, so that no files are written into the checkout. Links, as editors need them, must not get in.
    ignored = shutil.ignore_patterns(".git", "build", "dist", ".venv*", "__pycache__", ".pytest_cache", ".hypothesis")
    shutil.copytree(ROOT, folder / "source", symlinks=True, ignore=ignored)
    link_folders(folder / "source")
    build = [sys.executable, "-m", "build", "--no-isolation", "-o", str(folder), str(folder / "source")]
    done = subprocess.run(build, capture_output=True, text=True, encoding="utf-8")
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    (wheel,), (sdist,) = folder.glob("*.whl"), folder.glob("*.tar.gz")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "wheel")
        wheel_names = archive.namelist()
    with tarfile.open(sdist) as archive:
        members = archive.getmembers()
        assert all(member.isfile() for member in members), "an sdist with links cannot be unpacked on Windows"
        archive.extractall(folder / "sdist")
    (unpacked,) = (folder / "sdist").iterdir()
    sdist_names = [member.name.partition("/")[2] for member in members]
    return {"wheel": folder / "wheel", "sdist": unpacked}, {"wheel": wheel_names, "sdist": sdist_names}


def run_in(folder: Path, *arguments: str) -> subprocess.CompletedProcess:
    """Run Python with the packages of `folder`, which need not be installed, outside the checkout."""
    environment = os.environ | {"PYTHONPATH": str(folder)}
    return subprocess.run([sys.executable, *arguments], cwd=folder.parent, env=environment, capture_output=True,
                          text=True, encoding="utf-8")  # fmt: skip


def test_no_link_is_committed():
    """Git for Windows writes a committed link as a text file."""
    assert not [line for line in git("ls-files", "--stage").splitlines() if line.startswith("120000")]


@pytest.mark.thorough
def test_wheel_contains_the_package_and_nothing_else(built):
    names = {name for name in built[1]["wheel"] if ".dist-info" not in name}
    sources = {room: [*(ROOT / room).rglob("*.py")] for room in ("warpcrete", "kernels", "scenes")}
    wanted = {path.relative_to(ROOT).as_posix() for path in sources["warpcrete"]}
    for room in ("kernels", "scenes"):
        wanted |= {f"warpcrete/{path.relative_to(ROOT).as_posix()}" for path in sources[room]}
    for room, endings in DATA.items():
        found = [path for path in (ROOT / "warpcrete" / room).rglob("*") if path.suffix in endings]
        assert found
        wanted |= {path.relative_to(ROOT).as_posix() for path in found}
    assert names == wanted | {"warpcrete/py.typed"}, "the marker says that the package has types"
    assert any(name.endswith("licenses/LICENSE") for name in built[1]["wheel"])


def test_sdist_contains_every_file_of_the_repository(built):
    names = set(built[1]["sdist"])
    room = {"CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "LICENSE", "README.md", "pyproject.toml", ".ci/run",
            ".github/workflows/ci.yml", "kernels/__init__.py", "scenes/__init__.py", "notebooks/01_pump_concrete.ipynb",
            "tests/conftest.py", "tests/gpu.json"}  # fmt: skip
    assert room <= names
    tracked, new = (
        {name for name in git("ls-files", *kind).splitlines() if (ROOT / name).is_file()}
        for kind in (("--cached",), ("--others", "--exclude-standard"))
    )
    # A checkout may hold further files, such as the run folder of the README's first command.
    assert tracked <= names and names - {"PKG-INFO"} <= tracked | new


PLACES = """
import pickle, warpcrete, warpcrete.kernels.dem.structs as structs
from warpcrete import scenes
assert structs.__name__ == "warpcrete.kernels.dem.structs" and scenes.__name__ == "warpcrete.scenes"
assert pickle.loads(pickle.dumps(scenes.tube())) == scenes.tube()
print(warpcrete.__file__, structs.__file__, scenes.__file__, sep="\\n")
"""


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["wheel", "sdist"])
def test_kernels_and_scenes_are_found_without_installing(built, kind):
    """Find both packages under the same names, in the wheel inside the package and in the sdist beside it."""
    folder = built[0][kind]
    done = run_in(folder, "-c", PLACES)
    assert done.returncode == 0, done.stderr
    inside = folder / "warpcrete" if kind == "wheel" else folder
    wanted = [folder / "warpcrete/__init__.py", inside / "kernels/dem/structs.py", inside / "scenes/__init__.py"]
    assert [Path(line) for line in done.stdout.splitlines()] == wanted
    listed = run_in(folder, "-m", "warpcrete", "list")
    assert listed.returncode == 0 and listed.stdout == CliRunner().invoke(cli, ["list"]).output


@pytest.mark.thorough
def test_tests_are_collected_in_an_sdist(built):
    done = run_in(built[0]["sdist"], "-m", "pytest", "-q", "--collect-only", str(built[0]["sdist"] / "tests/house"),
                  "-p", "no:cacheprovider")  # fmt: skip
    assert done.returncode == 0 and "test_packaging.py::test_no_link_is_committed" in done.stdout, done.stdout


@pytest.mark.parametrize("name", ["kernels", "warpcrete.warpcrete"])
def test_packages_refuse_another_name(name):
    """A second copy of a package would have classes of its own, and compile its kernels again."""
    done = run_in(ROOT, "-c", f"import {name}")
    # With the links for editors inside the package, Python does not find the second name at all.
    refusals = f"imported as {name!r}", f"No module named {name!r}"
    assert done.returncode != 0 and any(refusal in done.stderr for refusal in refusals)


def test_links_for_editors_lead_to_the_folders(tmp_path):
    for name in ("kernels", "scenes", "warpcrete"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(name, encoding="utf-8")
    link_folders(tmp_path)
    link_folders(tmp_path)  # The links exist already.
    for name in ("kernels", "scenes"):
        assert (tmp_path / "warpcrete" / name / "__init__.py").read_text(encoding="utf-8") == name
        assert f"/warpcrete/{name}" in (ROOT / ".gitignore").read_text(encoding="utf-8").splitlines()


def test_one_version_is_told_everywhere():
    written = re.search(r'^version = "(.+)"$', PROJECT, re.M)
    cited = re.search(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.M)
    recipe = re.search(r'^  version: "(.+)"$', (ROOT / ".github/conda/recipe.yaml").read_text(encoding="utf-8"), re.M)
    assert written[1] == cited[1] == recipe[1]
    try:
        installed = importlib.metadata.version("warpcrete")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("needs an installed package: without installation no metadata states a version to compare")
    told = CliRunner().invoke(cli, ["--version"]).output
    assert warpcrete.__version__ == installed == told.split()[-1]
    assert "__version__" in dir(warpcrete)


def test_metadata_names_every_tested_python_and_links_that_work_on_an_index(built):
    (path,) = built[0]["wheel"].glob("*.dist-info/METADATA")
    metadata = email.message_from_string(path.read_text(encoding="utf-8"))
    jobs = YAML(typ="safe").load(ROOT / ".github/workflows/ci.yml")["jobs"]
    tested = jobs["test"]["strategy"]["matrix"]["python"]
    classified = [line.rpartition(" ")[2] for line in metadata.get_all("Classifier") if ":: Python :: 3." in line]
    assert classified == tested and metadata["Requires-Python"] == f">={tested[0]}"
    assert {line.partition(",")[0] for line in metadata.get_all("Project-URL")} >= {"Source", "Issues", "Changelog"}
    links = re.findall(r"\]\((.+?)\)", metadata.get_payload())
    assert len(links) > 10
    for link in links:
        assert link.startswith("https://"), f"{link} does not work on a package index"
        if place := re.fullmatch(rf"{REPOSITORY}/(?:blob|raw)/main/([^#]+)(?:#.*)?", link):
            assert (ROOT / place[1]).is_file(), f"{link} leads to a missing file"


def test_conda_recipe_has_the_dependencies_of_the_package():
    """Names differ for two packages of conda-forge; `conda` users get the same lowest versions."""
    needed = re.search(r"^dependencies = \[\n(.*?)^\]", PROJECT, re.M | re.S)[1]
    needed = set(re.findall(r'"(.+?)"', needed))
    renamed = {"usd-core": "openusd", "matplotlib": "matplotlib-base"}
    recipe = YAML(typ="safe").load(ROOT / ".github/conda/recipe.yaml")
    wanted = {re.sub(r"^([\w.-]+?)(>=.*)$", lambda m: f"{renamed.get(m[1], m[1])} {m[2]}", each) for each in needed}
    found = set(recipe["requirements"]["run"])
    assert found - {"python >=${{ python_min }}"} == wanted and len(wanted) == 10


NEWER = {
    "typing": ("LiteralString", "Never", "NotRequired", "Required", "Self", "TypeVarTuple", "Unpack", "assert_never",
               "assert_type", "override", "reveal_type"),
    "enum": ("StrEnum", "ReprEnum", "verify"),
    "datetime": ("UTC",),
    "contextlib": ("chdir",),
    "itertools": ("batched",),
}  # fmt: skip
"""Names that these modules of the standard library do not have in Python 3.10, the oldest version of the package."""


def imports_too_new(source: str) -> list[str]:
    """Return what a source text imports from the standard library that Python 3.10 does not have."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and not node.level:
            names = [each.name for each in node.names]
            found += ["tomllib"] if node.module == "tomllib" else []
            found += [f"{node.module}.{name}" for name in names if name in NEWER.get(node.module or "", ())]
        if isinstance(node, ast.Import):
            found += [each.name for each in node.names if each.name == "tomllib"]
    return found


def test_modules_import_nothing_that_the_oldest_python_lacks():
    assert 'requires-python = ">=3.10"' in PROJECT
    assert imports_too_new("from typing import Any, Self") == ["typing.Self"]
    paths = [path for folder in ("warpcrete", "kernels", "scenes") for path in (ROOT / folder).rglob("*.py")]
    found = {path: imports_too_new(path.read_text(encoding="utf-8")) for path in paths}
    assert not {path: names for path, names in found.items() if names}
