"""The mortar of a concrete whose constants a user states, by homogenisation."""

import pytest

from warpcrete import SceneError, scenes
from warpcrete.theory.suspension import concrete_of_mortar

SCENES = {
    "slump": dict(spacing=0.008), "jring": dict(spacing=0.006), "funnel": dict(spacing=0.007), "lbox": {},
    "tube": dict(length=0.2, spacing=0.008), "channel": {}, "stretch": {}, "part": dict(spacing=0.0075),
}  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_mortar_and_aggregates_together_have_the_stated_constants(name):
    given = dict(density=2300.0, viscosity=40.0, yield_stress=60.0, aggregate_fraction=0.3, **SCENES[name])
    as_mortar, scene = (getattr(scenes, name)(**given, constants_of=of) for of in ("mortar", "concrete"))
    whole = concrete_of_mortar(scene.concrete, scene.simulated_fraction, scene.aggregate_density)
    assert (whole.density, whole.viscosity, whole.yield_stress) == pytest.approx((2300.0, 40.0, 60.0))
    assert as_mortar.concrete.viscosity == 40.0 and scene.concrete.viscosity == pytest.approx(40.0 * 0.5**1.5)
    assert scene.concrete.slip_viscosity == as_mortar.concrete.slip_viscosity
    again = getattr(scenes, name)(**scene.parameters)
    assert again == scene and again.concrete == scene.concrete


def test_stones_below_the_size_of_the_cells_belong_to_the_mortar():
    sizes = "4:0,8:0.4,16:0.7,40:1"
    scene = scenes.lbox(aggregate_fraction=0.3, aggregate_sizes=sizes, spacing=0.005, constants_of="concrete")
    assert 0.05 < scene.simulated_fraction < 0.2
    assert scene.whole_concrete.viscosity == pytest.approx(scenes.lbox().concrete.viscosity)


def test_a_concrete_lighter_than_its_aggregates_is_refused():
    with pytest.raises(SceneError, match=r"density = 900\.0: is too small for a concrete of which 0\.4 of the volume"):
        scenes.lbox(density=900.0, aggregate_fraction=0.4, constants_of="concrete")
    with pytest.raises(SceneError, match="constants_of = 'paste': must be one of mortar, concrete"):
        scenes.lbox(aggregate_fraction=0.4, constants_of="paste")
