"""Parts of a line by discrete elements: bores, packing inside them, stations along the way, lines put together."""

import dataclasses
import json
import math
import sys
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from warpcrete import SceneError, Simulation, load, scenes
from warpcrete.cli.main import cli
from warpcrete.dem.laws import Contact, LubricationLayer
from warpcrete.dem.packing import pack
from warpcrete.dem.pictures import plot_stations
from warpcrete.dem.scene import Bodies, Scene, Stations
from warpcrete.dem.stations import (
    COLUMNS,
    FINEST,
    FRONT,
    _front,
    body_stresses,
    losses,
    measured,
    stresses_along,
)
from warpcrete.geometry.axis import Arc, Axis, Line
from warpcrete.geometry.bores import Bores
from warpcrete.geometry.curves import through
from warpcrete.geometry.meshes import enclosed
from warpcrete.geometry.walls import PipeWall
from warpcrete.mps.mixes import concrete_of
from warpcrete.studies.line_elements import Packed, WallLaw
from warpcrete.studies.line_run import run_line
from warpcrete.studies.lines import friction, layered, line_of

SMALL = dict(diameter=0.08, straight=0.1, size_min=12e-3, size_max=20e-3, travel=0.04, settle=0.1, gravity=0.0,
             flow=1e-3, plug_ball=14e-3)  # fmt: skip
COURSES = {
    "straight": dict(unit="horizontal"),
    "bend": dict(unit="bend-to-vertical", elbow_radius=0.12),
    "reducer": dict(unit="vertical", outlet_diameter=0.06, taper=0.1),
    "bend and reducer": dict(unit="bend-level", elbow_radius=0.12, outlet_diameter=0.06, taper=0.1),
}
AROUND = """
diameter: 80 mm
parts:
  - straight: 0.1
  - bend: {to: up, radius: 0.12, angle: 60}
  - bend: {to: left, radius: 0.12, angle: 45}
  - reducer: {to: 60 mm, length: 0.1}
  - straight: 0.1
"""


def test_volumes_and_surfaces_of_bores():
    """A cone between two cylinders: V = pi h (a^2 + a b + b^2) / 3, its side pi (a + b) sqrt(h^2 + (a - b)^2)."""
    bores = Bores((1.0, 1.4), (0.1, 0.07))
    cone = math.pi * 0.4 * (0.01 + 0.007 + 0.0049) / 3
    assert bores.volume(0.8, 1.7) == pytest.approx(math.pi * (0.2 * 0.01 + 0.3 * 0.0049) + cone, rel=1e-12)
    assert bores.surface(1.0, 1.4) == pytest.approx(math.pi * 0.17 * math.hypot(0.4, 0.03), rel=1e-12)
    halves = bores.spread(np.array([0.0, 0.5, 1.0]), 2.0)
    assert bores.volume(0, halves[1]) == pytest.approx(0.5 * bores.volume(0, 2.0), rel=1e-5)
    assert list(halves[[0, 2]]) == [0, 2]
    with pytest.raises(SceneError, match=r"^bores"):
        Bores((1.0, 0.5), (0.1, 0.1))


def test_a_pipe_that_bends_in_two_planes_is_a_closed_surface_of_its_volume():
    import trimesh

    axis = Axis((0, 0, 0), (1, 0, 0), (Line(0.2), Arc(0.2, 1.0, (0, 0, 1)), Arc(0.15, 1.2, (0, 1, 0)), Line(0.2)))
    _, tangents, normals, sides = axis.frame(np.linspace(0, axis.length, 200))
    for one, other in ((tangents, normals), (tangents, sides), (normals, sides)):
        assert np.abs(np.einsum("ij,ij->i", one, other)).max() < 1e-12
    assert np.abs(np.diff(sides, axis=0)).max() < 0.03  # no jump: 200 places along two arcs of 2.2 rad
    bores = Bores((0.3, 0.5), (0.05, 0.03))
    vertices, faces = bores.mesh(axis, facets=64)
    last = len(vertices) - 64
    around = np.stack([np.arange(64), (np.arange(64) + 1) % 64], axis=1)
    caps = [np.insert(around + first, 2, len(vertices) + k, axis=1) for k, first in enumerate((0, last))]
    closed = np.concatenate([vertices, [vertices[:64].mean(0), vertices[last:].mean(0)]])
    ways = [np.concatenate([faces, one, other[:, ::-1]]) for one, other in (caps, caps[::-1])]
    (mesh,) = [m for m in (trimesh.Trimesh(closed, way) for way in ways) if m.is_winding_consistent]
    assert mesh.is_watertight and -mesh.volume == pytest.approx(bores.volume(0, axis.length), rel=2e-3)


@pytest.mark.parametrize("course", COURSES)
def test_nothing_lies_outside_the_true_wall_at_the_start(course):
    """Cones and bends included: every centre inside, and as full everywhere."""
    scene: Any = scenes.part_dem(**SMALL | COURSES[course])
    bodies, report = pack(scene.fill, contact=scene.contact, seed=0, device="cpu")
    wall = next(wall for wall in scene.walls if wall.name == "pipe")
    assert enclosed(wall, scene.pipe.axis, bodies.position).all() and report.bodies > 150
    s, half = scene.pipe.axis.along(bodies.position), scene.pipe.axis.length / 2
    bores = scene.stations.bores
    parts = [bodies.volume[here].sum() for here in (s < half, s >= half)]
    fractions = np.array(parts) / [bores.volume(0, half), bores.volume(half, 2 * half)]
    assert fractions == pytest.approx(report.solid_fraction, rel=0.04)  # measured up to 1.5 %


@pytest.mark.thorough
@pytest.mark.parametrize("course", COURSES)
def test_every_part_is_pushed_through_and_measured(device, course):
    scene = scenes.part_dem(**SMALL | COURSES[course] | {"straight": 0.18, "slices": 3.0})
    run = Simulation(scene, device=device).run()
    for name, (passed, found) in sys.modules["warpcrete.scenes.part_dem"].check(run).items():
        assert passed, f"{name}: {found}"
    table = run.tables["stations"].columns
    full = np.isfinite(table["pressure"])
    assert np.count_nonzero(full) >= 3
    assert np.all(np.diff(table["axial_stress"][full]) < 0)
    assert np.all((table["solid_fraction"][full] > 0.5) & (table["solid_fraction"][full] < 0.8))
    assert run["momentum_balance_error"] < 1e-3
    assert len(plot_stations(run).axes) == 4
    assert ("middle_loss" in run.result) == (course != "straight") and ("gradient" in run.result) == (
        course == "straight"
    )


def two_spheres(device, apart=0.019, **changes) -> Any:
    """Two spheres on the axis of a pipe along x, and slices round their middle; what is measured, and the overlap."""
    axis = Axis((0, 0, 0), (1, 0, 0), (Line(1.0),))
    scene = Scene(
        name="pair", duration=1.0, gravity=(0, 0, 0), contact=Contact(effective_modulus=1e5, normal_damping_ratio=0.0),
        bodies=(Bodies(positions=[[0.5 - apart / 2, 0, 0], [0.5 + apart / 2, 0, 0]], sizes=0.02, **changes),),
        walls=(PipeWall(name="pipe", axis=axis, radius=0.05),),
        stations=Stations(axis=axis, bores=Bores((0.0,), (0.05,)), edges=(0.0, 0.5, 1.0)),
    )  # fmt: skip
    simulation = Simulation(scene, device=device, precision="float64")
    simulation.prepare()
    return simulation


def test_stress_of_one_contact(device):
    """f l / V: k_n = E pi r^2 / L times the overlap, half of the branch in each slice."""
    simulation = two_spheres(device)
    found = measured(simulation.scene.stations, simulation.model, simulation.state, 0.0)
    force = 1e5 * math.pi * 1e-4 / 0.02 * 0.001
    exact = force * 0.0095 / (math.pi * 0.05**2 * 0.5)
    # The front is where 98 % of the solids lie behind, so only the first slice counts as full.
    named = dict(zip(COLUMNS, found[0], strict=True))
    assert named["axial_stress"] == pytest.approx(exact, rel=1e-12) and np.isnan(found[1]).all()
    assert named["pressure"] == pytest.approx(exact / 3, rel=1e-12) and named["wall_stress"] == 0
    # The first sphere lies in the slice but for its cap beyond the middle, and so does the other's cap.
    assert named["solid_fraction"] == pytest.approx(math.pi / 6 * 8e-6 / (math.pi * 0.05**2 * 0.5), rel=1e-12)


def test_stress_on_the_wall_of_one_sphere_that_slides(device):
    """A layer drags by eta pi r^2 v; the wall's push times the arm to it, over three volumes, is pressure."""
    contact = Contact(effective_modulus=1e5, friction=0.0, normal_damping_ratio=0.0)
    axis = Axis((0, 0, 0), (1, 0, 0), (Line(1.0),))
    scene = Scene(
        name="slide", duration=1.0, gravity=(0, 0, 0), contact=contact,
        contacts={("aggregate", "wall"): LubricationLayer(contact=contact, viscosity=100.0)},
        bodies=(Bodies(positions=[[0.25, 0.041, 0], [0.8, 0, 0]], sizes=0.02, velocities=[[0.2, 0, 0], [0, 0, 0]]),),
        walls=(PipeWall(name="pipe", axis=axis, radius=0.05),),
        stations=Stations(axis=axis, bores=Bores((0.0,), (0.05,)), edges=(0.0, 0.5, 1.0)),
    )  # fmt: skip
    simulation: Any = Simulation(scene, device=device, precision="float64")
    simulation.prepare()
    found = dict(zip(COLUMNS, measured(simulation.scene.stations, simulation.model, simulation.state, 0.0)[0]))
    assert found["wall_stress"] == pytest.approx(100 * math.pi * 1e-4 * 0.2 / (2 * math.pi * 0.05 * 0.5), rel=1e-9)
    push = 1e5 * math.pi * 1e-4 / 0.01 * 0.001
    assert found["pressure"] == pytest.approx(push * 0.009 / 3 / (math.pi * 0.05**2 * 0.5), rel=1e-9)
    assert found["axial_stress"] == pytest.approx(0.0, abs=1e-9) and found["velocity_0.9R"] == pytest.approx(0.2)


def along(stations, simulation):
    """Stresses along a pipe by those of its bodies, shape (slices, 2) [Pa]."""
    bodies, unit = simulation.state.bodies, 0.1
    stress = FINEST * unit * body_stresses(simulation.model, simulation.state, unit).numpy()
    s, size = stations.axis.along(bodies.position.numpy()), bodies.size.numpy().astype(float)
    return stresses_along(stations, stress, s, stations.axis.at(s)[1], size, bodies.group.numpy() == 0, 0.0)


def test_stress_of_two_bodies_that_touch(device):
    """Half of force times branch each, in whichever direction they lie; a wall's push goes to one body whole."""
    contact = Contact(effective_modulus=1e5, friction=0.0, normal_damping_ratio=0.0)
    way, reach = np.array([2.0, -1.0, 2.0]) / 3, 0.019
    scene = Scene(
        name="touch", duration=1.0, gravity=(0, 0, 0), contact=contact,
        bodies=(Bodies(positions=[[0.5, 0, 0], (np.array([0.5, 0, 0]) + reach * way).tolist()], sizes=0.02),),
        walls=(PipeWall(name="pipe", axis=Axis((0, 0, 0), (1, 0, 0), (Line(1.0),)), radius=0.05),),
    )  # fmt: skip
    simulation: Any = Simulation(scene, device=device, precision="float64")
    simulation.prepare()
    unit = 1e5 * 0.02**3
    found = FINEST * unit * body_stresses(simulation.model, simulation.state, unit).numpy()
    push = 1e5 * math.pi * 0.01**2 / 0.02 * 0.001  # of Zhan's spring, E pi r^2 / (r_i + r_j) times the overlap
    tensor = push * reach * np.outer(way, way)
    expected = [tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[1, 2], tensor[2, 0]]
    assert found == pytest.approx(np.array([expected, expected]) / 2, rel=1e-9)
    again = FINEST * 8 * unit * body_stresses(simulation.model, simulation.state, 8 * unit).numpy()
    assert again == pytest.approx(found, rel=1e-9)


def test_velocity_profile_goes_by_rings(device):
    simulation = two_spheres(device, velocities=[[0.3, 0, 0], [0.3, 0, 0]])
    found = dict(zip(COLUMNS, measured(simulation.scene.stations, simulation.model, simulation.state, 0.0)[0]))
    assert found["velocity"] == pytest.approx(0.3) and found["velocity_0.1R"] == pytest.approx(0.3)
    assert np.isnan(found["velocity_0.9R"])


@pytest.mark.parametrize("wall", ["exact", "mesh"])
def test_a_column_at_rest_bears_what_stands_on_it(device, wall):
    """Without friction on the wall the stress along the pipe is the weight above and the plate's force, per area."""
    frictionless = dict(concrete="zhan-table1", bonds=False, friction=0.0, wall_friction=0.0, modulus=1e6)
    given = dict(SMALL, **frictionless, settle=2.0, unit="vertical", straight=0.15, plug="plate", slices=1.5)
    given |= {"gravity": 9.81, "plug_pressure": 200.0}
    scene: Any = scenes.part_dem(**given)
    if wall == "mesh":
        pipe = scenes.part_dem(**given | {"outlet_diameter": 0.0800001, "taper": 0.05, "straight": 0.125}).walls[-1]
        scene = dataclasses.replace(scene, walls=(*scene.walls[:-1], pipe))
    simulation: Any = Simulation(scene, device=device)
    simulation.prepare()
    found = measured(scene.stations, simulation.model, simulation.state, 0.0)
    state, area = simulation.state, math.pi * 0.04**2
    z, mass = state.bodies.position.numpy()[:, 2], state.bodies.mass.numpy()
    full = np.isfinite(found[:, 1])
    above = [200 + 9.81 * mass[z > place - scene.stations.origin].sum() / area for place in scene.stations.places[full]]
    assert full.sum() >= 3
    # Of twelve packings 0.6 to 2.2 %: stones are counted by their centres.
    assert found[full, 1] == pytest.approx(above, rel=0.03)
    by_bodies = along(scene.stations, simulation)
    assert np.array_equal(np.isfinite(by_bodies[:, 0]), full)
    # Of twelve packings 1.7 % along the pipe, and 8 % of the mean normal stress of one slice, 1.7 % of all together.
    assert by_bodies[full, 1] == pytest.approx(found[full, 1], rel=0.025)
    assert by_bodies[full, 0] == pytest.approx(found[full, 0], rel=0.12)
    assert by_bodies[full].sum(axis=0) == pytest.approx(found[full, :2].sum(axis=0), rel=0.025)
    solids = state.bodies.size.numpy() ** 3 * math.pi / 6
    lower = scene.stations.edges[-2]
    inside = z + scene.stations.origin < lower
    assert found[full, 3].mean() == pytest.approx(solids[inside].sum() / (area * lower), rel=0.03)


@pytest.mark.thorough
def test_gradient_is_what_rubs_on_the_wall(device):
    """4 tau / d, tau from the wall's forces and the gradient from contacts; and the piston bears it, too."""
    run = Simulation(scenes.part_dem(**SMALL | dict(unit="horizontal", straight=0.2, travel=0.1)), device=device).run()
    table = run.tables["stations"].columns
    full = np.isfinite(table["axial_stress"])
    place, stress, shear = (table[name][full] for name in ("place", "axial_stress", "wall_stress"))
    rubbed = np.concatenate([[0.0], np.cumsum(0.5 * (shear[1:] + shear[:-1]) * np.diff(place))]) * 4 / 0.08
    assert stress[0] - stress == pytest.approx(rubbed, abs=0.04 * stress[0])
    assert run["wall_stress"] * 4 / 0.08 == pytest.approx(run["gradient"], rel=0.1)
    ahead = stress[0] + place[0] * 4 / 0.08 * shear[0]
    assert run["end_pressure"] == pytest.approx(ahead, rel=0.06)


def test_losses_of_a_middle_where_friction_rises_with_pressure():
    """sigma' = -(a + b sigma) all along but for a middle that takes twice as much."""
    axis, d = Axis((0, 0, 0), (1, 0, 0), (Line(3.0),)), 0.1
    stations = Stations(
        axis=axis, bores=Bores((0.0,), (d / 2,)), edges=tuple(np.linspace(0, 1.3, 27)), middle=(0.4, 0.9)
    )
    a, b = 4000.0, 0.8
    way = stations.places + np.clip(stations.places - 0.4, 0, 0.5)
    stress = (20e3 + a / b) * np.exp(-b * way) - a / b
    table = {"axial_stress": stress, "wall_stress": d / 4 * (a + b * stress), "bulk_density": 0 * stress + 1500,
             "velocity": 1 + 0 * stress, "solid_fraction": 0.6 + 0 * stress, "radius": d / 2 + 0 * stress}  # fmt: skip
    found = losses(stations, table, (0.0, 0.0, -9.81))
    assert found["middle_ratio"] == pytest.approx(2.0, rel=0.03) and found["flux_ratio"] == pytest.approx(1.0)
    exact = np.exp(-b * 0.4) - np.exp(-b * 1.4)
    assert found["middle_loss"] == pytest.approx((20e3 + a / b) * exact, rel=0.02)
    upright = dataclasses.replace(stations, axis=Axis((0, 0, 0), (0, 0, 1), (Line(3.0),)))
    heavy = table | {"axial_stress": stress + 1500 * 9.81 * (3 - stations.places)}
    assert losses(upright, heavy, (0.0, 0.0, -9.81))["middle_loss"] == pytest.approx(found["middle_loss"], rel=1e-6)


@pytest.mark.thorough
def test_a_line_bends_in_two_planes_and_goes_through_a_checkpoint(device, tmp_path):
    (tmp_path / "line.yaml").write_text(AROUND)
    given = dict(SMALL, line=str(tmp_path / "line.yaml"), plug_layers=3)
    for name in ("diameter", "straight"):
        given.pop(name)
    scene = scenes.part_dem(**given)
    whole = Simulation(scene, device=device).run()
    assert whole.finished and whole["momentum_balance_error"] < 1e-3

    def cut(phase, fraction, figures):
        if phase == "running" and fraction > 0.4:
            first.stop_requested = True

    path = tmp_path / "checkpoint.npz"
    first = Simulation(scene, device=device, progress=cut, checkpoint_path=path, checkpoint_every=1e9)
    assert not first.run().finished
    again = Simulation(scene, device=device)
    again.resume(path)
    resumed = again.run()
    assert resumed.result["state_hash"] == whole.result["state_hash"]
    for name, column in whole.tables["stations"].columns.items():
        assert np.array_equal(column, resumed.tables["stations"].columns[name], equal_nan=True), name


def test_short_stretches_are_told():
    told = [scenes.part_dem(**SMALL | COURSES["bend"] | {"straight": length}).remarks for length in (0.1, 0.3)]
    assert "too short for their losses" in told[0][-1] and not any("too short" in text for text in told[1])


def test_a_scene_without_stations_has_no_code_or_memory_for_them(device):
    simulation = two_spheres(device)
    plain: Any = Simulation(dataclasses.replace(simulation.scene, stations=None), device=device)
    plain.prepare()
    plain.measure()
    assert "pair pushes" not in plain.state._scratch and plain.sampler.log is None
    assert "stations" not in plain.sampler.state_dict()


@pytest.mark.parametrize(
    "changes, told",
    [
        (dict(outlet_diameter=0.02), r"^size_max = 0\.02: must be below the pipe's diameter, 0\.02 m"),
        (dict(unit="bend-level", elbow_radius=0.03), r"^elbow_radius = 0\.03: must exceed the pipe's radius"),
        (dict(ramp=0.1), r"^ramp = 0\.1: must not exceed the travel, 0\.04 m"),
        (dict(taper=0.2), r"^taper = 0\.2: means nothing unless outlet_diameter is given"),
        (dict(line="burj-khalifa"), r"^diameter = 0\.08: means nothing unless line is not given"),
        (dict(unit="up"), r"^unit = 'up': must be one of vertical"),
    ],
)
def test_parts_that_cannot_be_are_refused_in_one_line(changes, told):
    with pytest.raises(SceneError, match=told):
        scenes.part_dem(**SMALL | changes)


@pytest.mark.parametrize(
    "parts, told",
    [
        ("[{bend: {to: up, radius: 0.2}}, {straight: 1}]", "must begin and end straight: part 1 is a bend"),
        ("[{straight: 0.2}, {bend: {to: left, radius: 0.2}}, {bend: {to: left, radius: 0.2}}, {straight: 1}]",
         "comes back past the plane in which it begins"),
    ],
)  # fmt: skip
def test_lines_that_cannot_be_pushed_through_are_refused(tmp_path, parts, told):
    (tmp_path / "line.yaml").write_text(f"diameter: 0.1\nparts: {parts}\n")
    with pytest.raises(SceneError, match=told):
        scenes.part_dem(line=str(tmp_path / "line.yaml"))


def test_a_line_is_put_together_from_its_end():
    """Walls that take a + b sigma: the pressure grows as an exponential, a bend of ratio two as twice its length."""
    parts = [{"straight": 1}, {"bend": {"to": "left", "radius": 0.5}}, {"straight": 2}]
    line = line_of({"diameter": 0.1, "parts": parts})
    a, b = 100.0, 0.03
    law = WallLaw(0.1, a, b, 1e3, 1e9)
    columns = {"axial_stress": np.array([1e3, 3e3, np.nan]), "wall_stress": np.array([130, 190, 0.0])}
    fitted = WallLaw.of(0.1, columns, 1e5)
    assert (fitted.start, fitted.slope, fitted.measured) == pytest.approx((100.0, 0.03, 3e3))
    packed = Packed({0.1: law}, {line.parts[1].alike: 2.0}, 1500.0)
    found = packed.course(line)
    length = 1 + 2 + math.pi / 2 * 0.5 * 2
    exact = a / b * (math.exp(4 * b / 0.1 * length) - 1)
    assert sum(map(sum, found)) == pytest.approx(exact, rel=0.02)
    assert all(weight == 0 for _, weight in found)
    flat = Packed({0.1: WallLaw(0.1, a - 10 * b, b, 5.0, 10.0)}, {}, 1500.0)
    upright = line_of({"diameter": 0.1, "begin": "up", "parts": [{"straight": 2}]})
    ((friction, weight),) = flat.course(upright)
    assert friction == pytest.approx(4 * a / 0.1 * 2, rel=1e-4) and weight == pytest.approx(1500 * 9.81 * 2)


@pytest.mark.thorough
def test_line_by_elements_runs_each_kind_once_and_takes_it_again(tmp_path):
    (tmp_path / "line.yaml").write_text(
        "diameter: 80 mm\nflow: 3.6 m3/h\nconcrete: zhan\nparts:\n  - straight: 0.4\n"
        "  - bend: {to: up, radius: 0.12}\n  - straight: 0.2\n"
    )
    command = ["line", str(tmp_path / "line.yaml"), "--method", "dem", "--device", "cpu", "--quiet"]
    first = CliRunner().invoke(cli, [*command, "--out", str(tmp_path / "one")], catch_exceptions=False)
    assert first.exit_code in (0, 3), first.output
    record = json.loads((tmp_path / "one" / "line-dem.json").read_text())
    assert len(record["wall_time"]) == 3 and len(record["parts"]) == 3
    friction = [part["friction"]["value"] for part in record["parts"]]
    weight = [part["weight"]["value"] for part in record["parts"]]
    assert min(friction) > 0 and weight[0] == 0 and weight[2] > 0
    assert record["pressure"]["value"] == pytest.approx(sum(friction) + sum(weight))
    part = load(next((tmp_path / "one" / "parts").glob("straight-80-pressed*")))
    assert "axial_stress" in part.tables["stations"].columns
    again = CliRunner().invoke(cli, [*command, "--out", str(tmp_path / "two"), "--known", str(tmp_path / "one")])
    second = json.loads((tmp_path / "two" / "line-dem.json").read_text())
    # Tables hold nine digits.
    assert second["pressure"]["value"] == pytest.approx(record["pressure"]["value"], rel=1e-7), again.output
    assert second["wall_time"] == {}


def test_line_by_elements_refuses(tmp_path):
    (tmp_path / "line.yaml").write_text("diameter: 0.1\nflow: 0.002\nconcrete: zhan\nparts: [{straight: 1}]\n")
    for more, told in (
        (["--seeds", "0"], "seeds = 0"),
        (["--coarse", "0.5"], "coarse = 0.5"),
        (["--concrete", "nothing"], "concrete = 'nothing'"),
        (["--coarse", "6"], "size_max = 0.12: must be below the pipe's diameter"),
        (["--theory"], "theory: means nothing"),
    ):
        command = ["line", str(tmp_path / "line.yaml"), "--method", "dem", "--out", str(tmp_path / "out"), *more]
        done = CliRunner().invoke(cli, command)
        assert done.exit_code != 0 and told in str(done.exception) + done.output, done.output
        assert not (tmp_path / "out").exists()


def test_a_hose_through_points_of_a_circle_is_that_circle():
    angle = np.linspace(0, 1.2, 5)
    points = 2.0 * np.stack([np.sin(angle), 0 * angle, 1 - np.cos(angle)], axis=1)
    pieces = through(points, np.array([1.0, 0.0, 0.0]))
    axis = Axis((0, 0, 0), (1, 0, 0), tuple(pieces))
    assert axis.length == pytest.approx(2.4, rel=1e-9) and all(isinstance(piece, Arc) for piece in pieces)
    assert axis.at(axis.length)[0][0] == pytest.approx(points[-1], abs=1e-9)
    twisted = np.array([[0, 0, 0], [1, 0.1, 0.2], [2, 0.5, 0.1], [2.5, 1.2, -0.6]], dtype=float)
    axis = Axis((0, 0, 0), (1, 0, 0), tuple(through(twisted, np.array([1.0, 0.0, 0.0]))))
    # It passes every point, though its arcs lie in many planes.
    assert np.linalg.norm(axis.nearest(twisted) - twisted, axis=1).max() < 1e-9


def test_a_hose_counts_its_length_its_bends_and_its_layer():
    points = [[1, 0, -0.2], [2, 0.5, -1], [2.2, 1.5, -1.5]]
    line = line_of({"diameter": 0.1, "parts": [{"straight": 1}, {"hose": {"points": points, "layer": 0.5}}]})
    hose = line.parts[1]
    assert hose.rise == -1.5 and 1.0 < hose.curving < 1.125 and hose.length > 3.0
    assert line.axis.at(line.axis.length)[0][0] == pytest.approx([3.2, 1.5, -1.5], abs=1e-9)
    concrete = concrete_of("no1")
    straight = dataclasses.replace(hose, curving=1.0, layer=1.0)
    plain = friction(straight, concrete, 0.002)
    assert friction(hose, concrete, 0.002) < hose.curving * plain
    assert friction(hose, layered(concrete, 2.0), 0.002) == pytest.approx(hose.curving * plain, rel=1e-9)
    found = run_line(line, concrete, 0.002, simulate=False)
    assert found.losses[1].weight == pytest.approx(-1.5 * 9.81 * concrete.density)


@pytest.mark.parametrize(
    "said, told",
    [
        ({"points": [[0, 1, 0], [0, 2, 0]]}, "lead 90 degrees away from where the line goes"),
        ({"points": [[1, 0, 0], [1.1, 0.02, 0], [1.15, 0.12, 0], [1.15, 1, 0]]}, "bend it to a radius of"),
        ({"points": [[1, 0, 0], [1.01, 0, 0]]}, "half a diameter apart"),
        ({"points": [[1, 0]]}, "must each be three lengths"),
        ({"points": "there"}, "must be a list of points"),
        ({"points": [[1, 0, "2 bar"]]}, "must be a number with one of m"),
        ({"points": [[1, 0, 0]], "layer": 0}, "layer = 0"),
    ],
)
def test_hoses_that_do_not_fit_are_refused(said, told):
    with pytest.raises(SceneError, match=told):
        line_of({"diameter": 0.1, "parts": [{"straight": 1}, {"hose": said}]})


def test_a_hose_that_meets_the_line_is_refused():
    points = [[1, 0.2, 0], [1.5, 1, 0], [1, 1.8, 0], [0, 1, 0], [-0.5, -0.5, 0]]
    with pytest.raises(SceneError, match="the line crosses itself"):
        line_of({"diameter": 0.1, "parts": [{"straight": 2}, {"hose": {"points": points}}]})


def test_shapes_from_files_are_written_down_whole(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    import trimesh

    trimesh.creation.icosphere(2).export("stone.stl")
    scene = scenes.part_dem(**SMALL | COURSES["straight"] | {"shapes": "stone.stl"})
    assert scene.parameters["shapes"] == str(tmp_path / "stone.stl"), "to be found from elsewhere, too"


def test_the_front_is_looked_for_among_the_farthest():
    """As among all, also where what lies far counts for nothing or for nearly all."""
    rng = np.random.default_rng(3)
    s, plain = rng.random(500), rng.random(500) + 0.5
    for volume in (
        plain,
        np.where(s > 0.8, 0.0, plain),
        np.where(s > 0.5, 1e3 * plain, plain),
        np.where(s < 0.9, 0, plain),
    ):
        for few in (3, 500):
            order = np.argsort(s[:few])
            total = np.cumsum(volume[:few][order])
            for part in (0.02, 0.5, FRONT):
                behind = part * total[-1]
                exact = s[:few][order][np.searchsorted(total, behind)]
                assert _front(s[:few], volume[:few], behind) == exact
