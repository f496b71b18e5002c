"""The house rules: import directions, packaging, what a step may do, what errors say."""

import ast
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
ALLOWED = {"kernels": {"kernels"}, "warpcrete": {"kernels", "warpcrete"}, "scenes": {"kernels", "warpcrete", "scenes"}}


def imported_rooms(path: Path, room: str):
    """Rooms (top-level folders) of the house that a file imports."""
    for node in ast.walk(ast.parse(path.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            if node.level:
                base = {"kernels": "warpcrete.kernels", "scenes": "warpcrete.scenes", "warpcrete": "warpcrete"}[room]
                base += ".verification" if path.parent.name == "verification" else ""
                base = ".".join(base.split(".")[: len(base.split(".")) - node.level + 1])
                names = [f"{base}.{node.module}"] if node.module else [f"{base}.{a.name}" for a in node.names]
            else:
                names = [node.module or ""]
        for name in names:
            parts = name.split(".")
            if parts[0] == "warpcrete":
                yield parts[1] if len(parts) > 1 and parts[1] in ("kernels", "scenes") else "warpcrete"
            elif parts[0] in ALLOWED:
                yield f"{name} (must be warpcrete.{name})"


@pytest.mark.parametrize("room", ALLOWED)
def test_imports_point_one_way(room):
    # Packages inside warpcrete/ import as one level deeper; kernels and scenes are links there.
    inner = [] if room != "warpcrete" else list((ROOT / room / "verification").glob("*.py"))
    for path in [*(ROOT / room).glob("*.py"), *inner]:
        wrong = set(imported_rooms(path, room)) - ALLOWED[room]
        assert not wrong, f"{path.name} imports {wrong}"


def test_kernels_refuse_another_name():
    done = subprocess.run([sys.executable, "-c", "import kernels"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode != 0 and "imported as 'kernels'" in done.stderr


def test_kernels_evaluate_their_annotations():
    for path in (ROOT / "kernels").glob("*.py"):
        assert "from __future__ import annotations" not in path.read_text(), path.name


def test_heavy_packages_load_only_when_used():
    code = (
        "import sys, warpcrete, warpcrete.cli; warpcrete.scenes.pipe();"
        "print([m for m in ('rerun', 'pxr', 'matplotlib', 'tqdm') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


def test_public_names_exist():
    import warpcrete

    assert len(warpcrete.__all__) <= 12
    for name in warpcrete.__all__:
        assert getattr(warpcrete, name) is not None


def test_wheel_holds_the_package_and_nothing_else(tmp_path):
    # From a copy, so that no build folder of the checkout gets in.
    import shutil

    source = tmp_path / "source"
    shutil.copytree(
        ROOT,
        source,
        symlinks=True,
        ignore=shutil.ignore_patterns(".git", "build", "dist", "*.egg-info", ".venv*", ".gpu"),
    )
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "-o", str(tmp_path), str(source)]
    done = subprocess.run(build, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    (wheel,) = tmp_path.glob("*.whl")
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info" not in name}
    wanted = {
        f"{target}/{path.name}"
        for room, target in (
            ("warpcrete", "warpcrete"),
            ("kernels", "warpcrete/kernels"),
            ("scenes", "warpcrete/scenes"),
            ("warpcrete/verification", "warpcrete/verification"),
        )
        for path in (ROOT / room).glob("*.py")
    }
    assert names == wanted
    assert any(name.endswith("licenses/LICENSE") for name in zipfile.ZipFile(wheel).namelist())


def test_a_second_step_compiles_nothing(device):
    import warp as wp

    from warpcrete import Simulation, scenes

    small = dict(diameter=0.06, length=0.05, travel=0.01, size_min=8e-3, size_max=12e-3, settle=0.1)
    first = Simulation(scenes.pipe(**small), device=device)
    first.prepare()
    first.stepper.advance(0.01)
    counted = 0
    load = wp._src.context.Module.load

    def counting(self, *arguments, **options):
        nonlocal counted
        before = dict(self.execs)
        result = load(self, *arguments, **options)
        counted += len(self.execs) - len(before)
        return result

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(wp._src.context.Module, "load", counting)
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
    with pytest.raises(SceneError, match=r"^unit = 'x': must be one of vertical, horizontal, elbow-up, elbow-down$"):
        scenes.pipe(unit="x")


def test_unstable_fixed_step_is_refused_and_a_stable_one_is_not(start):
    import math

    from warpcrete import SceneError
    from warpcrete.dem.scene import Bodies, Contact, Scene, TimeStep

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
    with pytest.raises(SceneError, match="above the stable step"):
        start(scene(1.001 * limit))
