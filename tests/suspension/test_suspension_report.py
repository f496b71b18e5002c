"""Lines of the report of a mortar with aggregates."""

import dataclasses
from types import SimpleNamespace

import numpy as np

from warpcrete import scenes
from warpcrete.mps.free.quantities import expected
from warpcrete.mps.free.scene import FreeScene
from warpcrete.suspension import quantities
from warpcrete.theory.suspension import concrete_of_mortar


def test_the_parts_of_aggregates_and_mortar_that_remain_are_told(monkeypatch):
    """With 20 % of aggregates, half of which remain, 65 % of the concrete are 68.75 % of the mortar."""
    monkeypatch.setattr(quantities, "report", lambda run: iter([("first", "line")]))
    run = SimpleNamespace(
        series={"aggregates_inside": np.array([1.0, 0.9, 0.5]), "inside": np.array([1.0, 0.95, 0.65])},
        result={"aggregates": {"fraction": 0.2}},
    )
    words = "50.0 % of their volume remains, and 68.8 % of the mortar"
    assert list(quantities.report_aggregates(run)) == [("first", "line"), ("aggregates", words)]
    run.series.pop("aggregates_inside")
    assert list(quantities.report_aggregates(run)) == [("first", "line")]


def test_closed_forms_of_a_slump_are_those_of_the_whole_concrete():
    """The constants of a scene with aggregates are those of its mortar, which alone would spread further."""
    given = dict(
        viscosity=20.0, yield_stress=60.0, density=2200.0, concrete="own", slip_viscosity=900.0, slip_yield=20.0
    )
    sizes = dict(aggregate_smallest=0.025, aggregate_largest=0.025, aggregate_fraction=0.25)
    scene = scenes.slump(spacing=0.00625, lift_time=0.0, **given, **sizes)
    whole = concrete_of_mortar(scene.concrete, 0.25, scene.aggregate_density)
    assert expected(scene) == expected(FreeScene(**fields_of(scene) | {"concrete": whole}))
    assert expected(scene)["spread"] < 0.95 * expected(scenes.slump(spacing=0.00625, lift_time=0.0, **given))["spread"]


def fields_of(scene):
    """Return the values of the fields that a scene without aggregates has."""
    return {each.name: getattr(scene, each.name) for each in dataclasses.fields(FreeScene) if each.init}
