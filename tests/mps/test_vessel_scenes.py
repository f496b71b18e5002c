"""Tests of the scenes of vessels: what they refuse, and the sizes of mould, bars and volumes."""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from warpcrete import scenes
from warpcrete.core.errors import SceneError
from warpcrete.geometry.walls import PlaneWall, Prescribed
from warpcrete.mps.free import probes
from warpcrete.mps.free.layout import free_layout
from warpcrete.mps.free.simulation import FreeSimulation
from warpcrete.standards import FUNNEL, L_BOX
from warpcrete.verification.vessels import tilted_vessel

OWN = {"concrete": "own", "density": 2300.0, "viscosity": 20.0, "yield_stress": 30.0}


@pytest.mark.parametrize(
    ("name", "given", "field"),
    [
        ("funnel", {"spacing": 0.05}, "spacing"), ("funnel", {"outlet_width": 0.0}, "outlet_width"),
        ("funnel", {"step_error": 0.0}, "time_step"), ("lbox", {"bars": 4}, "bars"),
        ("lbox", {"bars": 3}, "spacing"), ("lbox", {"length": 0.1}, "length"),
        ("lbox", {"column_height": 0.1}, "column_height"), ("lbox", {"surfaces": "wet"}, "surfaces"),
        ("lbox", {"surfaces": "slips"}, "slip_viscosity"), ("lbox", {"opening": 0.02}, "opening"),
        ("lbox", {"spacing": 0.04}, "spacing"), ("lbox", {"bars": 3, "spacing": 0.006, "width": 0.08}, "width"),
    ],
)  # fmt: skip
def test_what_funnel_and_box_refuse(name, given, field):
    with pytest.raises(SceneError, match=field):
        getattr(scenes, name)(**OWN | given)


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"axial": True, "depth": 0.1}, "depth"), ({"sides": {"above": "open"}}, "sides"),
        ({"sides": {"top": "wet"}}, "sides"), ({"depth": -1.0}, "depth"), ({"sides": {"front": "wall"}}, "sides"),
        ({"axial": True, "sides": {"left": "open"}}, "sides"), ({"outline": ()}, "outline"),
        ({"outline": ((2.0, 2.0), (3.0, 2.0), (3.0, 3.0))}, "outline"), ({"blocks": (((0.1, 0.1),),)}, "blocks"),
        ({"test": L_BOX}, "dimensions"), ({"test": FUNNEL}, "dimensions"),
        ({"sides": {"bottom": "open"}, "time_step": 0.01, "step_error": 0.0}, "time_step"),
        ({"walls": (PlaneWall(name="p", point=(0, 0, 0), normal=(0, 0, 1)),)}, "walls"),
        ({"depth": 0.1, "walls": (PlaneWall(name="p", point=(0, 0, 0), normal=(0, 0, 1),
                                            motion=Prescribed(velocity=(1, 0, 0))),)}, "motion"),
    ],
)  # fmt: skip
def test_what_a_vessel_refuses(given, field):
    with pytest.raises(SceneError, match=field):
        tilted_vessel(**given)


def test_a_mould_is_a_cone():
    """Faces in the mould's wall are open in part, and all that it shuts opens in the end."""
    layout = free_layout(scenes.slump(**OWN, spacing=0.01))
    assert layout.geometry is not None and layout.opened is not None
    cut = (layout.geometry.part > 0) & (layout.geometry.part < 1)
    assert cut.sum() > 30 and np.all((layout.opened.part == 0) | (layout.opened.part == 1))
    differ = layout.geometry.room != layout.opened.room
    assert differ.sum() > 50 and np.all(layout.opens[differ] < 3.1)
    # The mould of 0.3 m is lifted in 3 s, and opens a row of cells when its rim is at their middles. The first row lies
    # below the floor.
    row = np.arange(layout.opens.shape[0])[:, None] + 0 * layout.opens
    assert layout.opens[differ] == pytest.approx(np.maximum(row[differ] - 0.5, 0.0) * 0.01 / 0.1)


def test_the_front_in_an_l_box_is_counted_from_the_gate(monkeypatch):
    """Concrete deeper than half a cell ends in the cell whose middle is at 0.305 m; the gate is at 0.1 m."""
    across = np.arange(0.005, 0.7, 0.01)
    depth = np.where(across < 0.1, 0.5, np.where(across < 0.31, 0.02, 0.001))
    monkeypatch.setattr(probes, "surface", lambda flow: (across, depth))
    monkeypatch.setattr(probes, "bases", lambda flow: 0 * depth)
    monkeypatch.setattr(probes, "reach", lambda flow: 0.7)
    layout = SimpleNamespace(spacing=0.01, mass=np.ones(1))
    particles = SimpleNamespace(mass=SimpleNamespace(numpy=lambda: np.ones(1)))
    flow: Any = SimpleNamespace(state=SimpleNamespace(layout=layout, particles=particles, cells=lambda name: depth))
    found = L_BOX.measure(probes.specimen(flow), {"column_width": 0.1, "length": 0.7, "width": 0.2})
    assert found["front"] == pytest.approx(0.31 - 0.1) and found["near_depth"] == 0.5 and found["far_depth"] == 0.001


@pytest.mark.parametrize("bars, middles", [(2, [0.0355]), (3, [0.0, 0.053])])
def test_bars_of_an_l_box_leave_the_gaps_of_the_standard(bars, middles):
    """EN 12350-10: bars of 12 mm leave gaps of 59 mm (two bars) or 41 mm (three, one of them in the middle plane)."""
    walls = scenes.lbox(bars=bars, bar_diameter=0.012, spacing=0.008).walls
    found = sorted(float(np.ptp(wall.vertices[:, 1]) / 2 + wall.vertices[:, 1].min()) for wall in walls)
    assert found == pytest.approx(middles, abs=1e-9)


@pytest.mark.parametrize(
    "name, given, litres",
    [
        ("slump", {"spacing": 0.0125}, 1e3 * math.pi / 12 * 0.3 * (0.01 + 0.02 + 0.04)),
        ("jring", {"spacing": 0.012}, 1e3 * math.pi / 12 * 0.3 * (0.01 + 0.02 + 0.04)),
        ("lcpc", {"spacing": 0.025}, 6.0),
        ("lbox", {"spacing": 0.025}, 12.0),
        ("funnel", {"spacing": 0.015}, 75 * (0.45 * (0.515 + 0.065) / 2 + 0.15 * 0.065)),
    ],
)
def test_the_reported_volume_is_that_of_the_whole_vessel(name, given, litres):
    """Halves and quarters that are simulated count fully; round and slanted walls cut particles (0.94 % at most)."""
    simulation = FreeSimulation(getattr(scenes, name)(**given), device="cpu")
    simulation.flow = simulation.place_flow()
    found = simulation.sizes()["volume"]
    assert found["unit"] == "m3" and 1e3 * found["value"] == pytest.approx(litres, rel=0.01)


@pytest.mark.parametrize("name", ["slump", "jring", "lcpc", "lbox", "funnel"])
def test_a_vessel_refuses_a_slip_layer_with_a_thickness(name):
    """The thickness would not change the vessel: cells represent all of it."""
    with pytest.raises(SceneError, match=r"^slip_thickness = 0\.004: must be 0, because a slip layer in a vessel"):
        getattr(scenes, name)(concrete="no1", slip_thickness=4e-3)


def test_half_of_a_funnel_is_computed():
    """The front side is a mirror, so the depth is half of the funnel's breadth."""
    scene = scenes.funnel(breadth=0.075)
    assert scene.sides["front"] == "mirror" and scene.depth == 0.0375
