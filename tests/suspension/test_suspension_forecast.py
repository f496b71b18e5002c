"""Forecast of a mortar with aggregates in a vessel."""

import dataclasses
from types import SimpleNamespace

import pytest

from warpcrete import Simulation, scenes
from warpcrete.mps.free.forecast import course_of
from warpcrete.mps.free.scene import FreeScene
from warpcrete.suspension.quantities import in_words

SLUMP = {
    "spacing": 0.01, "aggregate_smallest": 0.03, "aggregate_largest": 0.03, "aggregate_fraction": 0.1, "lift_time": 0.0,
    "duration": 0.1, "sample_interval": 0.05, "concrete": "scc",
}  # fmt: skip


def test_the_fluid_of_a_scene_is_its_mortar_alone():
    scene = scenes.slump(**SLUMP)
    fluid = scene.fluid
    assert type(fluid) is FreeScene and fluid.fluid is fluid
    for field in dataclasses.fields(FreeScene):
        assert getattr(fluid, field.name) == getattr(scene, field.name), field.name


@pytest.mark.thorough
def test_the_steps_of_a_mortar_with_aggregates_are_foreseen_by_the_mortar_alone():
    """Coarser cells do not resolve the aggregates, so that a coarser copy with aggregates was refused."""
    scene = scenes.slump(**SLUMP)
    course = course_of(Simulation(scene, device="cpu"))
    assert course.duration == pytest.approx(0.1) and course.time_step < 0.5 * scene.time_step
    assert course.remarks[0].startswith("the forecast of time and steps is for the mortar alone")
    assert not any("stopped" in remark for remark in course.remarks)


def test_the_text_of_a_scene_names_vessel_mortar_and_aggregates():
    """The text of the aggregates' fields must not hide that of the vessel."""
    text = "'slump': scc (40 Pa, 30 Pa s), three-dimensional, 0.38 m wide, spacing 0.01 m, 10% aggregates>"
    assert repr(scenes.slump(**SLUMP)).endswith(text)


def test_a_forecast_states_number_sizes_and_fraction_of_the_aggregates():
    scene = scenes.slump(**SLUMP | {"aggregate_largest": 0.034})
    spheres = SimpleNamespace(count=12, kind=SimpleNamespace(clumps=False))
    assert in_words(spheres, scene) == "12 spheres of 30 to 34 mm, 10 % of the volume"
    clumps = SimpleNamespace(count=12, spheres=40, kind=SimpleNamespace(clumps=True))
    assert in_words(clumps, scenes.slump(**SLUMP)) == "12 clumps, of 40 spheres, of 30 mm, 10 % of the volume"
