"""Lines of the report of a mortar with aggregates."""

import dataclasses
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from warpcrete import scenes
from warpcrete.mps.free.quantities import expected
from warpcrete.mps.free.scene import FreeScene
from warpcrete.mps.part.quantities import QUANTITIES as PART_QUANTITIES
from warpcrete.suspension import pictures, quantities
from warpcrete.suspension.part.quantities import OF_THEORY, SuspensionData
from warpcrete.suspension.part.quantities import QUANTITIES as WITH_AGGREGATES
from warpcrete.suspension.stretch.quantities import QUANTITIES, RunData
from warpcrete.theory.suspension import concrete_of_mortar


def test_the_parts_of_aggregates_and_mortar_that_remain_are_told(monkeypatch):
    """With 20 % of aggregates, half of which remain, 65 % of the concrete are 68.75 % of the mortar."""
    monkeypatch.setattr(quantities, "report", lambda run: iter([("first", "line")]))
    run = SimpleNamespace(
        series={"aggregates_inside": np.array([1.0, 0.9, 0.5]), "inside": np.array([1.0, 0.95, 0.65])},
        result={"aggregates": {"fraction": 0.2}},
    )
    words = "50.0 % of their volume remains, and 68.8 % of the mortar"
    assert list(quantities.report_aggregates(run)) == [("first", "line"), ("aggregates left", words)]
    run.result["aggregates"] |= {"count": 4, "count_whole": 16}
    words = "16, 20 % of the volume; 4 of them are simulated, the others are mirror images"
    assert list(quantities.report_aggregates(run))[1] == ("aggregates in all", words)
    run.result["aggregates"] = {"fraction": 0.2}
    run.series.pop("aggregates_inside")
    assert list(quantities.report_aggregates(run)) == [("first", "line")]


def test_quantities_with_a_theoretical_value_name_the_mortar_of_the_theory():
    named = {each.name for each in WITH_AGGREGATES if each.meaning.endswith("; theory of mortar without aggregates")}
    parts = {each.name for each in PART_QUANTITIES}
    assert named == OF_THEORY == {name for name in parts if name.endswith("_theory")} | {"middle_ratio"}


@pytest.mark.parametrize("rows", [20, 18])
def test_the_error_of_a_mean_is_that_of_the_means_of_five_blocks(rows):
    """Ten rows of the last half have the block means 1 to 5 kPa. Their deviation is sqrt(2.5) kPa, and that of the
    mean of all five sqrt(2.5 / 5) kPa. Nine rows are too few."""
    late = np.ravel([[mean - 0.5, mean + 0.5] for mean in (4.0, 1.0, 5.0, 2.0, 3.0)])[: rows // 2]
    series = {"time": 0.1 * np.arange(rows), "pressure": np.concatenate([np.full(rows - len(late), 100.0), late])}
    nothing: Any = None
    part, stretch = SuspensionData(nothing, series), RunData(nothing, series, 0.3)
    assert part.final("pressure") == stretch.mean("pressure") == pytest.approx(late.mean())
    assert part.error("pressure") == (pytest.approx(math.sqrt(0.5)) if rows == 20 else None)
    assert part.at_end("pressure") == late[-1]


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


def test_the_pressure_over_a_stretch_contains_the_weight_of_the_placed_aggregates():
    """A quarter of aggregates of 2600 kg/m3 were placed in mortar of 2200 kg/m3, instead of the wanted fifth."""
    scene: Any = SimpleNamespace(
        mean_velocity=0.5, radius=0.04, ways=2, length=0.2, gravity=9.81, gradient=2000.0, density=2280.0,
        density_with=lambda fraction: 2200 + 400 * fraction,
    )  # fmt: skip
    known = RunData(scene, {"time": np.arange(4.0), "gradient": np.array([0.0, 0.0, 1400.0, 1600.0])}, 0.25)
    found = {each.name: each.of for each in QUANTITIES}
    weight = 0.2 * 2300 * 9.81
    assert found["pressure"](known) == pytest.approx(0.2 * 1500 + weight, rel=1e-12)
    assert found["pressure_theory"](known) == pytest.approx(0.2 * 2000 + weight, rel=1e-12)
    assert found["wall_stress_theory"](known) == pytest.approx(0.04 / 2 * 1500, rel=1e-12)
    scene.mean_velocity = None  # A given pressure gradient has no pressure to find.
    assert found["pressure"](known) is None and found["pressure_theory"](known) is None


def test_the_figure_of_a_vessel_shows_the_aggregates_inside(monkeypatch):
    """Three aggregates, one of which has left the vessel; about an axis, circles lie at their distance from it."""
    from matplotlib.collections import EllipseCollection
    from matplotlib.figure import Figure

    def empty(run):
        figure = Figure()
        figure.subplots(2, 1)
        return figure

    monkeypatch.setattr(pictures, "plot_free", empty)
    bodies = SimpleNamespace(
        position=np.array([[0.03, 0.04, 0.1], [0.0, 0.06, 0.2], [1e6, 0.0, 0.0]]), size=np.array([0.02, 0.03, 0.02]),
        inside=np.array([True, True, False]),
    )  # fmt: skip
    run: Any = SimpleNamespace(scene=SimpleNamespace(about_axis=True, round=True), bodies=bodies)
    axes = pictures.plot_with_aggregates(run).axes[0]
    (circles,) = (each for each in axes.collections if isinstance(each, EllipseCollection))
    assert circles.get_offsets() == pytest.approx(np.array([[50.0, 100.0], [60.0, 200.0]]))
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["2 simulated aggregates"]
    del run.bodies
    assert not pictures.plot_with_aggregates(run).axes[0].collections
