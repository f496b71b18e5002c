"""The house rules: import directions, what a step may do, what errors say."""

import ast
import functools
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
METHODS = sorted(path.parent.name for path in (ROOT / "warpcrete").glob("*/method.py") if path.parent.name != "core")
"""Every method is a folder with this file, and may have kernels in a folder of its name."""
LAYERS = {"kernels.common": 0, "core": 1, "geometry": 2, "theory": 2, "mix": 2.5, "standards": 2.5, "scenes": 4,
          "methods": 4, "verification": 5, "record": 5, "studies": 6, "cli": 7, "": 8}  # fmt: skip
ABOVE = {"suspension": ("mps", "dem")}
"""Methods that stand above other methods and use them."""
LAYERS |= {f"kernels.{name}": 2 for name in METHODS if (ROOT / "kernels" / name).is_dir()} | dict.fromkeys(METHODS, 3)
LAYERS |= {name: 3.5 for name in ABOVE} | {f"kernels.{name}": 2.5 for name in ABOVE}
"""Packages of the house, and how high they stand: each imports from lower ones only. The package itself is on top."""
INSIDE = {
    "core": {"": 0, "inputs": 1, "device": 1, "drawing": 2, "run": 3},
    "dem": {"laws": 0, "scene": 1, "pumping": 2, "engine": 2, "measure": 3, "": 4},
    "mps": {"common": 0, "grid": 1, "": 2, "free": 2, "part": 2},
    "studies": {"": 0, "calibration": 1, "lines": 1, "reproduction": 1, "tradeoffs": 1, "validation": 2},
    "suspension": {"": 0, "part": 1, "stretch": 1},
}
"""Subpackages of a package and how high they stand; those at the same height do not import each other."""
ALONE = {("scenes", "methods"), ("record", "verification")}
ALONE |= {
    (one, f"kernels.{other}")
    for one in [*METHODS, "geometry"]
    for other in METHODS
    if other not in (one, *ABOVE.get(one, ()))
}
ALONE |= {(f"kernels.{name}", package) for name in METHODS for package in ("core", "geometry")}
"""Pairs of a package and a lower package that it must not import.

A method does not import the kernels of another method, except of the methods that `ABOVE` names for it. `geometry` does
not import the kernels of any method. The kernels of a method import neither `core` nor `geometry`.
"""


def modules() -> dict[str, Path]:
    """Every module of the project by its name below `warpcrete`, the package itself as ``."""
    found = {}
    for folder, prefix in (("warpcrete", ""), ("kernels", "kernels"), ("scenes", "scenes")):
        for path in (ROOT / folder).rglob("*.py"):
            parts = [part for part in (prefix, *path.relative_to(ROOT / folder).with_suffix("").parts) if part]
            if parts[-1] == "__init__":
                parts.pop()
            found[".".join(parts)] = path
    return found


MODULES = modules()


def package_of(module: str) -> str:
    """The package of the house that a module belongs to."""
    parts = module.split(".")
    return ".".join(parts[:2]) if parts[0] == "kernels" and len(parts) > 1 else parts[0]


@functools.cache
def imports(module: str) -> frozenset[str]:
    """Modules of the project that a module imports, wherever the statement stands."""
    path = MODULES[module]
    here = module.split(".") if module else []
    if path.name != "__init__.py":
        here = here[:-1]
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = ["warpcrete", *here[: len(here) - node.level + 1]] if node.level else []
            base = ".".join([*base, *([node.module] if node.module else [])])
            names = [f"{base}.{alias.name}" for alias in node.names]
        for name in names:
            assert name.split(".")[0] not in ("kernels", "scenes"), f"{module}: {name} must be warpcrete.{name}"
            if name.split(".")[0] == "warpcrete":
                target = name.partition(".")[2]
                while target and target not in MODULES:
                    target = target.rpartition(".")[0]
                found.add(target)
    return frozenset(found - {module})


@pytest.mark.parametrize("package", LAYERS)
def test_imports_point_one_way(package):
    own = [module for module in MODULES if package_of(module) == package]
    assert own or package == ""
    for module in own:
        for target in imports(module):
            other = package_of(target)
            if other in (package, "kernels"):
                continue
            allowed = LAYERS[other] < LAYERS[package] and (package, other) not in ALONE
            assert allowed, f"{module} imports {target}"


@pytest.mark.parametrize("package", INSIDE)
def test_imports_inside_a_package_point_one_way(package):
    def part(module):
        name = module.split(".")[1] if module.count(".") else ""
        return name if (ROOT / "warpcrete" / package / name).is_dir() else ""

    heights = INSIDE[package]
    own = [module for module in MODULES if module.startswith(f"{package}.")]
    assert {part(module) for module in own} == set(heights)
    for module in own:
        for target in imports(module):
            if target.startswith(f"{package}.") and part(target) != part(module):
                assert heights[part(target)] < heights[part(module)], f"{module} imports {target}"


def test_each_package_says_what_it_may_import_and_where_to_start_reading():
    for module, path in MODULES.items():
        if path.name == "__init__.py":
            words = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
            assert "import" in words and re.search(r"\b([Ss]tart|begin)\s+with\b", words), module


def test_no_module_imports_itself_in_a_circle():
    waiting = {module: {target for target in imports(module) if target} for module in MODULES}
    # A package's __init__ gathers what its own modules hold; to import one of them is not to import the package.
    for module, targets in waiting.items():
        targets -= {target for target in targets if module.startswith(f"{target}.")}
    while free := [module for module, targets in waiting.items() if not targets & waiting.keys()]:
        for module in free:
            del waiting[module]
    assert not waiting, f"in circles, or above one: {sorted(waiting)}"


def test_no_package_imports_itself_in_a_circle():
    """Every folder is a package of its own here, and so is the list of methods."""

    def folder(module):
        whole = MODULES[module].name == "__init__.py" or module == "methods"
        return module if whole else module.rpartition(".")[0]

    waiting = {}
    for module in MODULES:
        found = {
            target for target in imports(module) if not module.startswith(f"{target}.") or folder(target) != target
        }
        waiting.setdefault(folder(module), set()).update(folder(target) for target in found if target)
    waiting = {package: targets - {package} for package, targets in waiting.items()}
    assert "mps.grid" in waiting["mps"]
    while free := [package for package, targets in waiting.items() if not targets & waiting.keys()]:
        for package in free:
            del waiting[package]
    assert not waiting, f"in circles, or above one: {sorted(waiting)}"


def test_no_part_of_the_program_asks_which_method_it_has():
    """The scene's type says it, in one place; no result is known by its keys, but by Eq. 13, which is of a plateau, and
    by what says what two papers print."""
    words = ("FluidScene", "FluidSimulation", "ElementSimulation", "slip_velocity", "plateau_pressure")
    of_papers = ("studies.lines.pipeline", "studies.reproduction.papers", "studies.reproduction.report")
    for module, path in MODULES.items():
        if package_of(module) in ("core", "record", "studies", "cli", "methods") and module not in of_papers:
            for word in words:
                assert word not in path.read_text(encoding="utf-8"), f"{path.name} names {word}"


def calls_without_encoding(source: str) -> list[str]:
    """Calls that read or write text in the encoding of the locale."""
    found = []
    if not re.search(r"read_text|write_text|open\(|text=|universal_newlines", source):
        return found  # spares the parser
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        named = {each.arg for each in node.keywords}
        modes = [
            each.value for each in ast.walk(node) if isinstance(each, ast.Constant) and isinstance(each.value, str)
        ]
        binary = any(re.fullmatch("[rwax+]*b[rwax+]*", mode) for mode in modes)
        opens = (
            name == "open"
            and not binary
            and not (
                isinstance(node.func, ast.Attribute) and ast.unparse(node.func.value) in ("os", "tarfile", "Image")
            )
        )
        if "encoding" not in named and (
            (name in ("read_text", "write_text") and not ast.unparse(node.func).startswith("formatter."))
            or opens
            or named & {"text", "universal_newlines"}
        ):
            found.append(ast.unparse(node))
    return found


def test_text_is_read_and_written_as_utf_8():
    assert calls_without_encoding("path.open('w'); open(x); p.read_text(); run(c, text=True); p.write_text(s)")[4]
    assert not calls_without_encoding("path.open('wb'); open(x, encoding='utf-8'); os.open(p, 1)")
    for path in (*MODULES.values(), *(ROOT / "tests").rglob("*.py")):
        assert not calls_without_encoding(path.read_text(encoding="utf-8")), path


POSIX = {
    "os": {"O_CLOEXEC", "O_DIRECTORY", "O_NOFOLLOW", "O_NONBLOCK", "chown", "fchmod", "fork", "getloadavg", "getpgid",
           "getuid", "killpg", "mkfifo", "nice", "posix_fadvise", "posix_fallocate", "pread", "pwrite",
           "sched_getaffinity", "setsid", "statvfs", "sysconf", "uname", "WNOHANG"},
    "signal": {"SIGALRM", "SIGCHLD", "SIGHUP", "SIGKILL", "SIGPIPE", "SIGQUIT", "SIGUSR1", "alarm", "pthread_sigmask"},
}  # fmt: skip
"""Names that these modules lack on Windows."""
POSIX_MODULES = {"fcntl", "grp", "posix", "pty", "pwd", "resource", "syslog", "termios", "tty"}


def names_missing_on_windows(source: str) -> list[str]:
    """Names of POSIX that are used without `hasattr(module, name)` or a `try` that catches their absence."""
    if not any(name in source for name in POSIX_MODULES.union(*POSIX.values())):
        return []  # spares the parser
    tree = ast.parse(source)
    caught: dict[str, set[ast.AST]] = {"AttributeError": set(), "ImportError": set()}
    for block in ast.walk(tree):
        for handler in block.handlers if isinstance(block, ast.Try) else []:
            for name in caught:
                if handler.type is not None and name in ast.unparse(handler.type):
                    caught[name] |= {node for statement in block.body for node in ast.walk(statement)}
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            module, name = node.value.id, node.attr
            tested = {f"hasattr({module}, {name!r})", f'hasattr({module}, "{name}")'}
            if name in POSIX.get(module, ()) and node not in caught["AttributeError"]:
                found += [] if any(test in source for test in tested) else [f"{module}.{name}"]
        elif isinstance(node, ast.Import | ast.ImportFrom) and node not in caught["ImportError"]:
            names = [node.module] if isinstance(node, ast.ImportFrom) else [alias.name for alias in node.names]
            found += [name for name in names if name in POSIX_MODULES]
    return found


def test_no_module_needs_posix():
    assert names_missing_on_windows("import fcntl, os; os.open(p, os.O_CLOEXEC)") == ["fcntl", "os.O_CLOEXEC"]
    guarded = "try:\n    import fcntl\nexcept ImportError:\n    pass\nos.nice(1) if hasattr(os, 'nice') else 0"
    assert not names_missing_on_windows(guarded)
    for module, path in MODULES.items():
        assert not names_missing_on_windows(path.read_text(encoding="utf-8")), module


PARSERS = {"json.load", "json.loads", "csv.reader", "csv.DictReader", "yaml.load", "yaml.safe_load", "YAML"}
OWN_FILES = {"record.loading": "csv.reader", "studies.tradeoffs.explain": "json.loads",
             "core.run.checkpoint": "json.loads", "studies.lines.folder": "json.loads",
             "studies.lines.line_folder": "json.loads", "record.run_folder": "json.loads"}  # fmt: skip
"""Modules that parse what the program itself has written, or holds in memory."""


def test_files_of_users_are_parsed_in_one_place():
    for module, path in MODULES.items():
        source = path.read_text(encoding="utf-8")
        if not any(parser.partition(".")[0] in source for parser in PARSERS):
            continue
        calls = [n.func for n in ast.walk(ast.parse(source)) if isinstance(n, ast.Call)]
        used = {ast.unparse(call) for call in calls} & PARSERS
        if module not in ("core.inputs.text_files", "core.inputs.yaml_files"):
            assert used <= {OWN_FILES.get(module)}, f"{module} uses {used}"


def test_every_array_says_what_it_is():
    """Meaning, unit and shape: a comment for each member of a struct of arrays, a docstring for each typed array."""
    counted = 0
    for path in (ROOT / "kernels").rglob("structs.py"):
        above = ""
        for line in path.read_text(encoding="utf-8").splitlines():
            if ": wp.array" in line and "def " not in line:
                counted += 1
                name = line.split(":")[0].strip()
                group = ("near_count", "near", "far_count", "wall_count")
                assert "#" in line or above.startswith("#") or name in group, f"{path}: {line.strip()}"
            above = line.strip()
    for module in ("dem.engine.state", "dem.engine.model", "dem.engine.batch_arrays", "mps.state", "mps.particles"):
        for node in ast.walk(ast.parse(MODULES[module].read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                for statement, after in zip(node.body, [*node.body[1:], None]):
                    typed = isinstance(statement, ast.AnnAssign) and ast.unparse(statement.annotation)
                    if typed and re.search(r"\bwp\.array|\bDeviceArray\b", typed):
                        counted += 1
                        said = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
                        assert said, f"{module}: {ast.unparse(statement)}"
    assert counted > 90


def test_kernel_factories_are_short():
    """Lines of code, without docstrings, comments and blank lines."""
    for path in (ROOT / "kernels").rglob("*.py"):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.FunctionDef):
                source = path.read_text(encoding="utf-8").splitlines()[node.lineno - 1 : node.end_lineno]
                written = sum(bool(line.strip()) and not line.strip().startswith("#") for line in source)
                texts = [each.value.value for each in ast.walk(node)
                         if isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant)
                         and isinstance(each.value.value, str)]  # fmt: skip
                said = sum(len([line for line in text.splitlines() if line.strip()]) for text in texts)
                assert written - said < 110, f"{path.name}: {node.name} has {written - said} lines"


def test_kernels_evaluate_their_annotations():
    for path in [*(ROOT / "kernels").rglob("*.py"), *(ROOT / "warpcrete/dem/laws").glob("*.py")]:
        assert "from __future__ import annotations" not in path.read_text(encoding="utf-8"), path.name


def test_heavy_packages_load_only_when_used():
    code = (
        "import sys, warpcrete, warpcrete.cli; warpcrete.scenes.pipe();"
        "print([m for m in ('rerun', 'pxr', 'matplotlib', 'tqdm') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8")
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


def test_public_names_exist():
    import warpcrete

    assert len([name for name in warpcrete.__all__ if not name.startswith("__")]) <= 20
    for name in warpcrete.__all__:
        assert getattr(warpcrete, name) is not None


def test_a_second_step_compiles_nothing(device):
    import warp as wp

    from warpcrete import Simulation, scenes

    small = dict(diameter=0.06, length=0.05, travel=0.01, size_min=8e-3, size_max=12e-3, settle=0.1)
    first = Simulation(scenes.pipe(**small), device=device)
    first.prepare()
    first.stepper.advance(0.01)
    counted = 0
    load = wp.Module.load

    def counting(self, *arguments, **options):
        nonlocal counted
        before = dict(self.execs)
        result = load(self, *arguments, **options)
        counted += len(self.execs) - len(before)
        return result

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(wp.Module, "load", counting)
        first.stepper.advance(0.02)
        # Another velocity, stiffness and friction: numbers, not structure.
        other = Simulation(scenes.pipe(velocity=0.5, modulus=2e5, friction=0.2, **small), device=device)
        other.prepare()
        other.stepper.advance(0.01)
    assert counted == 0


def test_error_messages_name_field_value_and_range():
    from warpcrete import SceneError, scenes

    with pytest.raises(SceneError, match=r"^diameter = -1\.0: must be a finite number above 0 m$"):
        scenes.pipe(diameter=-1)
    with pytest.raises(
        SceneError, match=r"^unit = 'x': must be one of vertical, horizontal, bend-to-horizontal, bend-to-vertical$"
    ):
        scenes.pipe(unit="x")


def test_unstable_fixed_step_is_refused_and_a_stable_one_is_not(start):
    import math

    from warpcrete import SceneError
    from warpcrete.dem.scene.scene import Bodies, Contact, Scene, TimeStep

    # Two touching spheres: k_n and the normal dashpot. That either may yet touch a wall, where k_s = k_n/2 moves and
    # turns it (3.5 k_s), asks for less, since the estimate has a factor of 2 in hand for stiffness.
    radius, beta = 0.01, 0.5
    mass = 2500 * 4 / 3 * math.pi * radius**3
    k = 1e5 * math.pi * radius / mass
    c = 2 * beta * math.sqrt(k)
    limit = 2 / (c + math.sqrt(c**2 + 4 * k))

    def scene(dt):
        return Scene(
            name="pair", duration=1.0, gravity=(0, 0, 0), contact=Contact(normal_damping_ratio=beta),
            bodies=(Bodies(positions=[[0, 0, 0], [0.0199, 0, 0]], sizes=2 * radius),), time_step=TimeStep(fixed=dt),
        )  # fmt: skip

    assert start(scene(0.999 * limit)).dt == 0.999 * limit
    with pytest.raises(SceneError, match="above the largest stable time step"):
        start(scene(1.001 * limit))


def test_python_files_and_their_lines_are_short():
    """Ruff accepts a long line if only a `type: ignore` comment, a URL or a text without spaces makes it too long."""
    for path in (*MODULES.values(), *(ROOT / "tests").rglob("*.py")):
        lines = path.read_text(encoding="utf-8").splitlines()
        assert len(lines) <= 450, f"{path.relative_to(ROOT)} has {len(lines)} lines"
        long = [number for number, line in enumerate(lines, 1) if len(line) > 120]
        assert not long or "# ruff: noqa: E501  (rows of tables)" in lines, f"{path.relative_to(ROOT)}: {long}"


def test_the_changelog_is_wrapped():
    lines = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").splitlines()
    assert not [number for number, line in enumerate(lines, 1) if len(line) > 120]
