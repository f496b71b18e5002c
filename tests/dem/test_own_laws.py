"""Mistakes in a contact law of a user's own: each must give one clear line before the run."""

import dataclasses
import hashlib
import importlib
import sys

import pytest
from test_contact_choice import guide_law
from test_contacts import two_spheres

import warpcrete
from warpcrete.core.device.device import find_device
from warpcrete.core.errors import SceneError
from warpcrete.dem.engine.model import build_model
from warpcrete.dem.laws import Contact
from warpcrete.geometry.walls import PlaneWall

MISTAKES = {
    "energy of the wrong sign": (
        "return stored -",
        "return -stored +",
        r"Sticky\.energy\(\) = .*return the opposite sign",
    ),
    "energy without the spring": ("return stored -", "return -", r"Sticky\.energy\(\) = .*must be .* J there"),
    "no energy": (
        ', "energy": energy',
        "",
        r"must also return the function 'energy'; write @wp\.func def energy\(p, touch",
    ),
    "two values": (
        ", slip_loss + damping * speed * speed * dt",
        "",
        r"Sticky\.force\(\) = '2 values': must return 3 values",
    ),
    "plain field": (
        'damping: Annotated[float, "of the normal dashpot [N s/m]", Within(0)]',
        "damping: float",
        r"line \d+: .*`damping` is not an attribute of 'p'.*Annotated\[float",
    ),
    "postponed annotations": (
        "from dataclasses",
        "from __future__ import annotations\nfrom dataclasses",
        r"must be in a file without 'from __future__ import annotations'.*; remove this line",
    ),
    "packing without reach": (
        "friction=0.0, pull=0.0)",
        "friction=0.0, pull=0.0, reach=0.0)",
        r"Sticky\.frictionless\(\) = 'begins to push two spheres apart .*must begin at 0\.0005",
    ),
    "pulls": (
        "shear - push *",
        "shear + push *",
        r"Sticky\.force\(\) = 'a pull of .*or make the spring stiffer",
    ),
    "drives": (
        "spring - damping * speed",
        "spring + damping * speed",
        r"a normal dashpot of -.*must resist the motion",
    ),
    "pushes sideways": (
        "push * touch.normal",
        "push * t.vec3(scalar(1.0), scalar(0.0), scalar(0.0))",
        r"N along the contact plane': must be along touch\.normal",
    ),
    "shear backwards": ("return shear - push", "return -shear - push", r"because body b drags body a along"),
    "history not kept": (
        "has_history = True",
        "has_history = False\n    has_shear = True",
        r"has_history = False: must be True, because force\(\) returns a new history",
    ),
    "history as a method": (
        "has_history = True",
        "def has_history(self):\n        return True\n",
        r"has_history = 'a method': must be a value or a property",
    ),
    "stiffness too small": (
        "tangent = scalar(1.5)",
        "tangent = scalar(0.1)",
        r"k_n = .*must be at least the slope of force",
    ),
    "negative stiffness": (
        "p.shear_stiffness, p.damping, scalar",
        "p.shear_stiffness, -p.damping, scalar",
        r"stiffness\(\) = 'c_n = -.* N s/m': must not be negative",
    ),
    "dashpot not told": (
        "p.shear_stiffness, p.damping, scalar",
        "p.shear_stiffness, scalar(0.0), scalar",
        r"c_n = 0 N s/m .*must be at least .* the value that follows from force",
    ),
    "energy at the gap 0": ("return stored -", "return scalar(0.1) + stored -", r"J at the gap 0': must be 0 J there"),
    "not a number": (
        "return stored -",
        "return wp.log(-inside) + stored -",
        r"energy\(\) = -inf: must be a finite number",
    ),
    "plain number": (
        "wp.pow(deepest, scalar(0.5))",
        "wp.pow(deepest, 0.5)",
        r"compiled by Warp, which says .*; use only functions|write scalar",
    ),
    "unknown field of touch": (
        "-touch.gap, scalar(0.0))\n            depth",
        "-touch.overlap, scalar(0.0))\n            depth",
        r"`overlap` is not an attribute of 'touch'.*must be one of normal, gap",
    ),
    "stiffness of three": (
        "return t.vec4(tangent, p.shear_stiffness, p.damping, scalar(0.0))",
        "return t.vec3(tangent, p.shear_stiffness, p.damping)",
        r"stiffness\(\) = 'vec3. as value 1': must return a vec4",
    ),
    "stiffness as a tuple": (
        "return t.vec4(tangent, p.shear_stiffness, p.damping, scalar(0.0))",
        "return tangent, p.shear_stiffness, p.damping, scalar(0.0)",
        r"stiffness\(\) = 'several values': must return 1 value",
    ),
    "nothing returned": (
        'return {"force"',
        'made = {"force"',
        r"device_functions\(\) = None: must return a dictionary",
    ),
    "not a Warp function": (
        "@wp.func\n        def energy",
        "def energy",
        r"Sticky\.energy = .*must be a Warp function; write @wp\.func",
    ),
    "one argument less": (
        "def energy(p: P, touch: Touch, history: t.vec3)",
        "def energy(p: P, touch: Touch)",
        r"energy\(\) = 'p, touch': must take 3 arguments: p, touch, history",
    ),
    "no class method": (
        "@classmethod\n    def device_functions(cls, ",
        "def device_functions(self, ",
        r"write @classmethod above",
    ),
    "no dataclass": (
        "@dataclass(frozen=True, kw_only=True)\nclass",
        "class",
        r"in a class without a @dataclass decorator of its own; write @dataclass",
    ),
    "frictionless returns nothing": (
        "return replace(self, friction",
        "replace(self, friction",
        r"frictionless\(\) = None: must return a contact law",
    ),
    "unknown parameter for packing": (
        "friction=0.0, pull=0.0)",
        "friction=0.0, pul=0.0)",
        r"frictionless\(\): fails with TypeError: .*'pul'",
    ),
    "words": (
        'Annotated[float, "coefficient of friction", Within(0)] = 0.3',
        'Annotated[str, "kind"] = "dry"',
        r"friction = 'a text': must be restricted to a list of words",
    ),
    "help text left out": (
        'Annotated[float, "coefficient of friction", Within(0)]',
        "Annotated[float, Within(0)]",
        r"friction = Within.*must have a text with the meaning and unit",
    ),
    "stress of nothing": (
        "return self.stiffness * 0.01",
        "return 0 * self.stiffness * 0.01",
        r"stress_scale = 0\.0: must be a finite number above 0 Pa",
    ),
}
"""Changes to the law of the guide, each with a pattern of the message."""


@pytest.fixture
def sticky(tmp_path, monkeypatch):
    """Function that imports the guide's law after one change to its text."""
    guide_law(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))

    def changed(old="", new=""):
        text = (tmp_path / "sticky.py").read_text(encoding="utf-8")
        assert old in text
        # Each changed law has a file of its own, as Python imports a file once.
        name = f"sticky_{hashlib.sha256((old + new).encode()).hexdigest()[:8]}"
        (tmp_path / f"{name}.py").write_text(text.replace(old, new, 1), encoding="utf-8")
        importlib.invalidate_caches()
        monkeypatch.delitem(sys.modules, name, raising=False)
        return importlib.import_module(name).Sticky

    return changed


def model(contact, precision="float64", **more):
    return build_model(two_spheres(contact=contact, **more), find_device("cpu"), precision)


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_in_a_law_gives_one_clear_line(sticky, mistake):
    old, new, message = MISTAKES[mistake]
    with pytest.raises(SceneError, match=message) as found:
        model(sticky(old, new)())
    assert "\n" not in str(found.value)


def test_a_right_law_is_taken(sticky):
    law = sticky()
    for pull in (0.0, 0.05):
        model(law(pull=pull))
        model(law(pull=pull), "float32")


def test_a_law_that_is_defined_again_can_run(sticky):
    """Running a cell of a notebook again defines an equal law, whose kernels Warp merges with those of the first."""
    for law in (sticky(), sticky()):
        scene = dataclasses.replace(two_spheres(contact=law()), duration=1e-4)
        moved = warpcrete.Simulation(scene, device="cpu", threads=1, precision="float64").run().bodies.position
        assert moved == pytest.approx(scene.bodies[0].positions, abs=1e-9)  # They touch without overlap.


def test_laws_of_one_name_from_two_files_are_told_apart(sticky):
    """A law with one more parameter and the same name may act on walls, but not between bodies."""
    law, other = (
        sticky(),
        sticky("    has_history", '    more: Annotated[float, "no effect [N]"] = 0.0\n\n    has_history'),
    )
    floor = PlaneWall(name="floor", point=(0, 0, -1), normal=(0, 0, 1))
    scene = dataclasses.replace(two_spheres(contact=law()), duration=1e-4)
    scene = dataclasses.replace(scene, walls=(floor,), contacts={("aggregate", "wall"): other()})
    warpcrete.Simulation(scene, device="cpu", threads=1, precision="float64").run()
    bodies = (*scene.bodies, dataclasses.replace(scene.bodies[0], material="other"))
    mixed = dataclasses.replace(scene, bodies=bodies, contacts={("aggregate", "other"): other()})
    with pytest.raises(SceneError, match=r"contacts = 'sticky_\w+\.Sticky, sticky_\w+\.Sticky': must be one type"):
        build_model(mixed, find_device("cpu"), "float64")


def test_a_wall_law_with_another_reach_is_refused(sticky):
    """The guide's law reaches half as far at a wall, so the wall's law must begin to push at 0.25 mm."""
    law, floor = sticky(), PlaneWall(name="floor", point=(0, 0, -1), normal=(0, 0, 1))

    def on_wall(other):
        scene = dataclasses.replace(two_spheres(contact=law()), walls=(floor,), contacts={("aggregate", "wall"): other})
        return build_model(scene, find_device("cpu"), "float64")

    on_wall(law(pull=0.1))
    for other in (law(reach=0.002), Contact()):
        with pytest.raises(SceneError, match=r"begins to push .* apart at .*give both laws the same reach"):
            on_wall(other)
