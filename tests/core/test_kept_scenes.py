"""Scenes as their functions make them, with what follows from them before the first step, kept (see `kept`)."""

import re

import kept
import numpy as np
import pytest
from click.testing import CliRunner

from warpcrete import scenes
from warpcrete.cli.main import cli
from warpcrete.core.device.device import find_device
from warpcrete.dem.engine.model import build_model
from warpcrete.dem.scene.bodies import placed_bodies
from warpcrete.dem.scene.scene import Scene
from warpcrete.mps.free.layout import free_layout
from warpcrete.mps.free.quantities import start_volume
from warpcrete.mps.free.scene import FreeScene
from warpcrete.mps.layout import layout
from warpcrete.mps.part.layout import part_layout
from warpcrete.mps.part.scene import PartScene
from warpcrete.suspension.stretch.layout import stretch_layout
from warpcrete.suspension.stretch.scene import StretchScene

VARIANTS = {
    "channel": (
        {"spacing": 0.01},
        {"spacing": 0.01, "ends": "piston", "aggregates": True},
        {"rest": 600.0, "ends": "periodic", "thixotropy": 0.1, "concrete": "no2", "flow_index": 1.2},
    ),
    "tube": ({"spacing": 0.02, "slip_viscosity": 1e7}, {"diameter": 0.15, "flow": 2e-3, "ends": "piston"}),
    "part": (
        {"spacing": 0.0125, "straight": 0.2, "diameter": 0.1},
        {
            "unit": "bend-level",
            "spacing": 0.0125,
            "straight": 0.2,
            "diameter": 0.1,
            "outlet_diameter": 0.08,
            "taper": 0.2,
        },
        {"unit": "bend-to-vertical", "spacing": 0.0125, "straight": 0.2, "diameter": 0.1, "gravity": 0.0},
    ),
    "slump": (
        {"spacing": 0.02},
        {"spacing": 0.02, "top_diameter": 0.1, "mould_height": 0.2, "lift_time": 3.0, "concrete": "no3"},
    ),
    "jring": ({"spacing": 0.0118}, {"spacing": 0.0118, "bars": 12, "lift_time": 0.0}),
    "funnel": ({"spacing": 0.016},),
    "lcpc": ({"spacing": 0.02},),
    "lbox": ({"spacing": 0.02},),
    "stretch": (
        {"spacing": 5e-3, "length": 0.06},
        {"spacing": 5e-3, "length": 0.06, "surfaces": "slips", "concrete": "no2", "gravity": 0.0},
    ),
    "pipe": (
        {},
        {"unit": "bend-to-vertical", "shapes": "reference", "wall": "mesh", "facets": 12},
        {"unit": "horizontal", "bonds": True, "hydration": 0.1, "plug": "plate"},
        {"unit": "bend-to-horizontal", "strokes": 3, "pause": 0.5, "stroke": 0.2, "ramp": 0.05, "rest": 600.0},
        {"diameter": 0.1, "size_min": 4e-3, "size_max": 16e-3, "plug_layers": 3, "stop_when_blocked": True},
    ),
    "part-dem": ({}, {"unit": "bend-level", "outlet_diameter": 0.1, "taper": 0.3, "wear": True}),
    "slump-dem": ({}, {"law": "plastic", "top_diameter": 0.1, "mould_height": 0.2}),
    "funnel-dem": ({"law": "bonds"},),
    "lbox-dem": ({},),
    "jring-dem": ({"law": "mortar"},),
    "lcpc-dem": ({"law": "linear"},),
}
CASES = [(name, place) for name, given in VARIANTS.items() for place in range(len(given))]
NOT_NEWS = re.compile(r"^(parameters|vessel\.test|test|published)\b|\.(concrete|bulk_law|layer_law)\.")
"""Lines of parameters and of standard tests, which are kept once, by another test."""


def of_elements(scene):
    """Return the arrays and settings with which a run of discrete elements begins."""
    model = build_model(scene, find_device("cpu"), "float64")
    placed = placed_bodies(scene)
    placed.material, placed.group = sorted(set(placed.material)), sorted(set(placed.group))
    found = {"placed": placed, "features": model.features, "skin": getattr(model, "skin", None)}
    found["drawn"] = {wall.name: wall.drawn() for wall in scene.walls}
    found["speeds"] = {wall.name: wall.top_speed() for wall in scene.walls}
    if scene.fill is not None:
        container = scene.fill.container
        found["container"] = [container.sample(20, np.random.default_rng(1)), container.pilot().volume]
        found["sizes"] = scene.fill.sizes.sample(30, np.random.default_rng(1))
        found["closed"] = [[wall.name, wall.origin, wall.drawn()] for wall in container.walls("aggregate")]
    if scene.stations is not None:
        stations = scene.stations
        found["stations"] = [stations.places, stations.volumes, stations.surfaces, stations.straights]
    if scene.pipe is not None:
        found["begun"] = [scene.pipe.begun(x) for x in (0.0, 0.1, 0.25, 0.45, 0.9)]
    return found


def of_flow(scene):
    """Return the cells or particles of a flow, and its results by theory."""
    if isinstance(scene, FreeScene):
        return {"layout": free_layout(scene), "volume": start_volume(scene), "extent": scene.extent}
    if isinstance(scene, PartScene):
        s = np.linspace(0, scene.axis.length, 9)
        return {
            "layout": part_layout(scene),
            "bore": scene.bore(s),
            "weight": scene.weight(s),
            "theory": [scene.theory(float(x)) for x in s[::4]],
            "friction": [scene.friction_loss(0.0, float(x)) for x in s[1:]],
        }
    if isinstance(scene, StretchScene):
        begun, aggregates = stretch_layout(scene)
        radius = np.linspace(0, scene.radius, 5)
        return {
            "layout": begun,
            "aggregates": aggregates,
            "step": scene.time_step,
            "alone": scene.velocity_alone(radius),
        }
    return {"layout": layout(scene), "theory": scene.theory(), "restart": scene.restart() if scene.gained else None}


@pytest.mark.parametrize("name, place", CASES, ids=[f"{name}-{place}" for name, place in CASES])
def test_a_scene_is_kept(name, place):
    module = scenes.modules()[name]
    scene = module.scene(**VARIANTS[name][place])
    lines = [line for line in kept.described(scene) if not NOT_NEWS.search(line)]
    more = list(kept.described(of_elements(scene) if isinstance(scene, Scene) else of_flow(scene), "begin"))
    if place:
        before = module.scene(**VARIANTS[name][0])
        same = set(kept.described(before))
        lines = [line for line in lines if line not in same]
    given = module.scene.parameters(**VARIANTS[name][place])
    knobs = [
        [knob.name, knob.chosen, [[level.label, level.changes, level.converted] for level in knob.levels]]
        for knob in module.trading.knobs(given)
    ]
    variants = module.trading.variants(given) if place == 0 else {}
    settled = list(kept.described({"knobs": knobs, "variants": variants}))
    kept.compare(f"scene-{name}-{place}", "\n".join([*lines, *more, *settled]))


@pytest.mark.parametrize("name", VARIANTS)
def test_what_the_help_of_a_scene_shows_is_kept(name):
    """Compare the options of the short and of the complete help page, in their order."""
    pages = [CliRunner().invoke(cli, ["run", name, option]).output for option in ("--help", "--help-all")]
    options = [re.findall(r"^  (?:-\w, )?--([\w-]+)", page, re.M) for page in pages]
    kept.compare(f"help-{name}", "\n".join(["short:", *options[0], "all:", *options[1]]))
