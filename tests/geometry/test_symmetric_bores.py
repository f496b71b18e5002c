"""Half of a part represents the whole only if its bore is symmetric, also if the bore is a mesh."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from tubes import bent, tube

from warpcrete import scenes
from warpcrete.geometry.axis import Arc, Axis, Line
from warpcrete.mps.part.forecast import dimensions
from warpcrete.mps.part.layout import Frame, bore_distance, part_room
from warpcrete.mps.part.scene import SIMULATED_WHOLE
from warpcrete.mps.part.simulation import PartSimulation

FLOW = {"concrete": "no1", "flow": 0.0055, "gravity": 0.0, "unit": "horizontal", "diameter": 0.125, "straight": 0.15,
        "spacing": 0.0156}  # fmt: skip
BEND = Axis((0, 0, 0), (1, 0, 0), (Line(0.1), Arc(0.2, np.pi / 4, (0, 1, 0)), Line(0.1)))
HEAVY = {"gravity": 9.81, "viscosity": 50, "yield_stress": 20, "density": 2200, "aggregate_fraction": 0.1,
         "aggregate_smallest": 0.048, "aggregate_largest": 0.048, "duration": 0.1, "sample_interval": 0.05}  # fmt: skip
SHORT = {"concrete": "no1", "flow": 1.5e-3, "straight": 0.3, "spacing": 0.0115}


def bulged(path, towards, height=0.006):
    """Push the middle of a pipe's wall outward, on the side to which the vector `towards` points; in metres."""
    mesh = trimesh.load_mesh(path)
    points = np.array(mesh.vertices)
    low, high = points.min(0), points.max(0)
    along = np.exp(-((4 * (points[:, 0] - 0.5 * (low + high)[0]) / np.ptp(points[:, 0])) ** 2))
    away = (points - 0.5 * (low + high)) * [0, 1, 1]
    way = away / np.maximum(np.linalg.norm(away, axis=1), 1e-12)[:, None]
    side = np.maximum(way @ (np.array(towards) / np.linalg.norm(towards)), 0.0) ** 2
    trimesh.Trimesh(points + height * (along * side)[:, None] * way, mesh.faces, process=False).export(path)
    return str(path)


def straight_tube(path):
    return tube(path, [0.0625] * 31, length=0.3, scale=1.0)


def pressure(**given):
    return float(PartSimulation(scenes.part(**FLOW, **given), device="cpu").run()["pressure"])


def test_half_of_a_round_mesh_needs_the_pressure_of_the_whole_and_of_the_pipe_by_formula(tmp_path):
    path = str(straight_tube(tmp_path / "tube.stl"))
    scene = scenes.part(**FLOW, wall=path)
    assert scene.is_half and scene.simulated_share == 0.5 and dimensions(scene) == "three, half of the part"
    assert scene.orientation.asymmetry < 1e-3 * scene.spacing
    assert not scenes.part(**FLOW, wall=path, symmetry="whole").is_half
    half, whole, formula = pressure(wall=path), pressure(wall=path, symmetry="whole"), pressure()
    assert half == pytest.approx(whole, rel=1e-3)  # measured: 0.01 %
    assert half == pytest.approx(formula, rel=5e-3)  # the mesh is a polygon with 0.2 % less area


def test_a_bulge_on_one_side_is_simulated_where_it_lies(tmp_path):
    """A bulge is symmetric about one of two planes through a straight axis, or about neither of them."""
    beside, above, between = (
        scenes.part(**FLOW, wall=bulged(straight_tube(tmp_path / f"{name}.stl"), towards))
        for name, towards in (("beside", (0, 1, 0)), ("above", (0, 0, 1)), ("between", (0, 1, 0.6)))
    )
    assert beside.is_half and above.is_half and not between.is_half
    assert abs(beside.orientation.axes[1]) == pytest.approx([0, 0, 1])
    assert abs(above.orientation.axes[1]) == pytest.approx([0, 1, 0])
    assert not any(SIMULATED_WHOLE in each for scene in (beside, above) for each in scene.remarks)
    reason = "the mesh differs from its mirror image in the plane of the pipe's axis by 5.2 mm"
    assert reason + SIMULATED_WHOLE in between.remarks
    assert dimensions(between) == f"three, because {reason}"
    assert part_room(between).cells[1] > 1.8 * part_room(beside).cells[1]
    results = [PartSimulation(scene, device="cpu").run()["pressure"] for scene in (beside, above)]
    assert results[0] == pytest.approx(results[1], rel=1e-3)
    # The asymmetric bulge is found on the side of the simulated pipe on which it lies.
    s = np.full(2, 0.15)
    sides = np.array([[0.0, 1.0, 0.6], [0.0, -1.0, -0.6]]) / np.hypot(1, 0.6)
    places = between.axis.at(s)[0] + 0.065 * sides
    assert (bore_distance(between)(Frame(between).to_grid(places)) > 0).tolist() == [True, False]


@pytest.mark.parametrize("depth", [0.5e-3, 4e-3])
def test_a_dent_on_one_side_is_not_mirrored_away(tmp_path, depth):
    """A dent of a few per cent of a cell lies where the mesh has it, and its mirror image does not appear."""
    aside, between, level = (
        scenes.part(**FLOW | given, wall=bulged(straight_tube(tmp_path / f"{name}.stl"), towards, -depth))
        for name, towards, given in (("aside", (0, 1, 0), {}), ("between", (0, 1, 1), {}), ("level", (0, 1, 0), HEAVY))
    )
    assert aside.is_half and abs(aside.orientation.axes[1]) == pytest.approx([0, 0, 1])
    # Both planes through the axis mirror the second dent away, and the third one lies beside the only vertical plane.
    for scene, towards in ((between, (0, 1, 1)), (level, (0, 1, 0))):
        assert not scene.is_half and "differs from its mirror image" in scene.orientation.obstacle
        dent, beside = np.array(towards), np.cross((1, 0, 0), towards)
        sides = np.stack([dent, -dent, beside, -beside]) / np.linalg.norm(dent)
        edge = scene.axis.at(np.full(4, 0.15))[0] + (0.0625 - 0.3 * depth) * sides
        assert (bore_distance(scene)(Frame(scene).to_grid(edge)) > 0).tolist() == [False, True, True, True]
    bend = scenes.part(wall=bulged(bent(tmp_path / "bend.stl", BEND), (0, 0, 1), -depth), **SHORT)
    assert not bend.is_half


def test_a_remark_on_symmetry_follows_the_scene(tmp_path):
    """A whole pipe that the user asks for needs no remark, and a copy of a scene has only one."""
    path = bulged(straight_tube(tmp_path / "tube.stl"), (0, 1, 1))
    scene = scenes.part(**FLOW, wall=path)
    again = replace(scene, spacing=0.012)
    whole = scenes.part(**FLOW, wall=path, symmetry="whole")
    assert [sum(SIMULATED_WHOLE in each for each in one.remarks) for one in (scene, again, whole)] == [1, 1, 0]


@pytest.mark.parametrize("facets", [64, 37])
def test_a_bent_mesh_is_symmetric_about_the_plane_of_its_bend(tmp_path, facets):
    """The axis measured from a mesh is moved into one plane, unless it bends in space."""
    scene = scenes.part(wall=str(bent(tmp_path / "bend.stl", BEND, facets=facets)), **SHORT)
    assert scene.axis.is_plane and scene.is_half
    assert abs(scene.orientation.axes[1]) == pytest.approx([0, 0, 1], abs=2e-3)
    pushed = scenes.part(wall=bulged(tmp_path / "bend.stl", (0, 0, 1)), **SHORT)
    assert not pushed.is_half and dimensions(pushed) == "three, because the axis does not lie in one plane"


def test_an_axis_in_space_stays_what_it_is():
    space = Axis((0, 0, 0), (1, 0, 0), (Line(0.1), Arc(0.2, 1.5, (0, 1, 0)), Arc(0.2, 0.8, (0, 0, 1)), Line(0.1)))
    assert space.flattened(5e-4) is space
    nearly = Axis(
        (0, 0, 0), (1, 0, 0), (Line(0.1), Arc(0.2, 1.5, (0, 1, 1e-4)), Arc(0.2, 0.8, (1, 0, 1e-3)), Line(0.1))
    )
    flat = nearly.flattened(5e-4)
    assert not nearly.is_plane and flat.is_plane and flat.length == nearly.length
    s = np.linspace(0, flat.length, 50)
    assert flat.at(s)[0] == pytest.approx(nearly.at(s)[0], abs=5e-4)
    assert nearly.flattened(1e-9) is nearly
