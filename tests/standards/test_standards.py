"""A standard test of one's own: a record in one file, whose scene is measured, ended and reported like the others."""

import copy
import dataclasses
import inspect
import pickle
from types import SimpleNamespace

import numpy as np
import pytest
from test_free_flows import vessel

from warpcrete import SceneError, scenes
from warpcrete.core.run.method import Quantity, report_of
from warpcrete.core.units import number
from warpcrete.dem.measure.display import ElementDisplay
from warpcrete.dem.measure.sampling import unit_of
from warpcrete.methods import METHODS, method_of
from warpcrete.mps.free.simulation import FreeSimulation
from warpcrete.standards import J_RING, TESTS, ClosedForm, Outcome, Specimen, StandardTest
from warpcrete.theory.vessels import funnel_time


@pytest.fixture
def channel():
    """Concrete that spreads along a channel."""
    yield StandardTest(
        name="channel-spread",
        dimensions=("length",),
        columns={"front": "m"},
        measure=lambda concrete, size: {"front": concrete.front()},
        quantities=(Quantity("channel_spread", "m", lambda k: k.last("front"), "spread length", None, True),),
        forms=(ClosedForm("channel_spread", "theory", "level", lambda k: k.size["length"]),),
    )
    del TESTS["channel-spread"]


def test_a_test_of_one_s_own_needs_nothing_but_its_record(device, channel):
    outline = ((0.0, 0.0), (0.1, 0.0), (0.1, 0.1), (0.0, 0.1))
    scene = vessel(test=channel, dimensions={"length": 0.4}, outline=outline, duration=0.1, sample_interval=0.05)
    run = FreeSimulation(scene, device=device).run()
    method = method_of(scene)
    assert run.units["front"] == "m" and 0.1 < run["channel_spread"] < 0.4
    assert number(run.result["channel_spread_theory"]) == method.expected(scene)["channel_spread"] == 0.4
    assert dict(report_of(method.quantities, run))["spread length"].endswith("mm   (level: 400 mm)")
    assert "slump" not in run.result
    assert {"channel_spread", "channel_spread_theory", "slump"} <= {each.name for each in METHODS[0].quantities}
    with pytest.raises(SceneError, match="dimensions"):
        vessel(test=channel)


def test_elements_in_a_test_of_one_s_own_are_plotted_in_its_units(channel):
    """A column in seconds has no other unit for display, and a test without a column of the heap has no plot of it."""
    scene = scenes.slump_dem()
    for columns, curves, labels in (
        ({"front": "m"}, None, []),
        ({"front": "m", "wait": "s", "force": "Pa"}, {"front": "front", "wait": "wait", "force": "thrust"},
         [("front [mm]", 2000.0), ("wait [s]", 2.0), ("thrust [kPa]", 0.002)]),
    ):  # fmt: skip
        test = dataclasses.replace(channel, columns=columns, curves=curves)
        own = dataclasses.replace(scene.vessel, test=test, dimensions={"length": 0.4})
        simulation = SimpleNamespace(scene=dataclasses.replace(scene, vessel=own), unit=lambda n: unit_of(n, ()))
        plots = {plot.title: plot.curves for plot in ElementDisplay.plots(SimpleNamespace(simulation=simulation))}
        assert [(each.label, each.value(dict.fromkeys(columns, 2.0))) for each in plots.get("Shape", ())] == labels


def test_the_blocking_step_is_that_over_the_bars():
    """Fill a ring of 300 mm up to the outer edge of its bars of 18 mm with 80 mm of concrete, and 30 mm outside."""
    edge = 0.159

    def height_around(inner, outer):
        inside = min(max(edge**2 - inner**2, 0.0) / (outer**2 - inner**2), 1.0)
        return 0.03 + 0.05 * inside

    concrete = Specimen(top=lambda radius: 0.08, spread=lambda: 0.6, height_around=height_around,
                        depth=lambda *_: 0.0, front=lambda: 0.0, screen=lambda *_: 0.0, inside=1.0)  # fmt: skip
    size = {"top_diameter": 0.1, "base_diameter": 0.2, "mould_height": 0.3, "ring_diameter": 0.3, "bar_diameter": 0.018}
    row = J_RING.measure(concrete, size)
    (step,) = [each for each in J_RING.quantities if each.name == "blocking_step"]
    found = step.of(Outcome(J_RING, size, {name: np.array([value]) for name, value in row.items()}))
    assert found == pytest.approx(0.05, abs=1e-12)


def test_a_record_stays_itself(channel):
    """Processes of a study send scenes to each other."""
    assert copy.deepcopy(channel) is pickle.loads(pickle.dumps(channel)) is channel


@pytest.mark.parametrize("test", TESTS.values(), ids=list(TESTS))
def test_a_closed_form_belongs_to_a_result(test):
    names = {each.name for each in test.quantities}
    assert {form.quantity for form in test.forms} <= names
    assert test.outflow is None or (test.outflow.time in names and test.outflow.column in test.columns)
    assert set(test.curves or ()) <= set(test.columns)


@pytest.mark.parametrize("law", [{}, {"flow_index": 0.7}, {"quadratic_viscosity": 2.0}])
def test_the_time_of_a_funnel_by_theory_has_the_law_of_the_concrete(law, monkeypatch):
    """The dimensions are those of EN 12350-9: an outlet of 65 x 75 mm, 515 mm at the top, heights of 150 and 450 mm."""
    given = {"density": 2300.0, "viscosity": 30.0, "yield_stress": 20.0}
    scene, arguments = scenes.funnel(concrete="own", **given, **law), inspect.signature(funnel_time)

    def spy(*values, **named):
        told.update(arguments.bind(*values, **named).arguments)
        return 4.5

    told = {}
    monkeypatch.setattr("warpcrete.standards.funnel.funnel_time", spy)
    assert method_of(scene).expected(scene)["funnel_time"] == 4.5
    exact = arguments.bind((0.0325, 0.2575), (0.15, 0.6), 0.075, 30.0, 20.0, 2300.0, 9.81, flow_index=1.0,
                           quadratic_viscosity=0.0).arguments | law  # fmt: skip
    assert {name: pytest.approx(value, rel=1e-12) for name, value in exact.items()} == told
