"""The option `--method suspension`, which simulates a scene as a mortar with aggregates."""

import pytest

from warpcrete import SceneError, scenes
from warpcrete.cli.scene_commands import by_method
from warpcrete.suspension.part.scene import PartSuspensionScene
from warpcrete.suspension.scene import USUAL_CELLS, SuspensionScene
from warpcrete.suspension.stretch.scene import StretchScene


@pytest.mark.parametrize("name", ["slump", "funnel", "lbox", "jring", "tube", "channel", "part", "pipe"])
def test_the_defaults_of_a_suspension_fit_together(name):
    target = scenes.by_method(name, "suspension")
    scene = scenes.modules()[target].scene(**scenes.suspended(name, bend=False))
    assert isinstance(scene, (SuspensionScene, PartSuspensionScene, StretchScene)) and scene.aggregate_fraction == 0.2
    assert scene.aggregate_diameters[0] == scene.aggregate_diameters[1] >= 0.99 * USUAL_CELLS * scene.spacing


def test_given_parameters_replace_those_of_the_method():
    words = ["run", "slump", "--precision=float32", "--method", "suspension", "--aggregate-fraction", "0.1"]
    concrete = ["--constants-of", "concrete"]
    assert by_method(words[1:]) == ["slump", *concrete, "--precision=float32", "--aggregate-fraction", "0.1"]
    added = ["--aggregate-fraction", "0.2", *concrete]
    assert by_method(["--quiet", "lbox", "--method=suspension"]) == ["--quiet", "lbox", *added]


def test_a_pipe_becomes_a_part_of_the_same_unit():
    found = by_method(["pipe", "--method", "suspension", "--unit", "horizontal"])
    assert found[0] == "part" and found[-2:] == ["--unit", "horizontal"] and found.count("--unit") == 1
    pipe, part = (scenes.modules()[name].scene.parameters for name in ("pipe", "part"))
    values = scenes.suspended("pipe")
    assert all(getattr(pipe(), name) == values[name] for name in (*scenes.PIPE_AS_PART, "elbow_radius"))
    assert part(**scenes.suspended("pipe", bend=False)).unit == "vertical"
    assert "--elbow-radius" not in found
    assert "--elbow-radius" not in by_method(["pipe", "--method", "suspension", "--out", "bend-run"])
    bend = by_method(["pipe", "--method", "suspension", "--unit=bend-to-vertical"])
    assert bend[bend.index("--elbow-radius") + 1] == "0.5"


def test_scenes_without_aggregates_refuse_the_method():
    with pytest.raises(SceneError, match="method = 'suspension': must be one of mps, dem for scene 'lcpc'"):
        scenes.by_method("lcpc", "suspension")


def test_aggregates_are_four_cells_wide_unless_stated():
    def sizes(**given):
        return scenes.lbox(aggregate_fraction=0.1, spacing=0.01, **given).aggregate_diameters

    assert sizes() == pytest.approx((0.04, 0.04))
    assert sizes(aggregate_largest=0.06) == pytest.approx((0.04, 0.06))
    assert sizes(aggregate_largest=0.035) == pytest.approx((0.035, 0.035))
    assert sizes(aggregate_smallest=0.05) == pytest.approx((0.05, 0.05))
