"""Wear of walls: works of sliding and impacts against closed forms, the books of energy, patches, checkpoints."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import kept
import numpy as np
import pytest
from pumping import SMALL, command, small_options
from test_checkpoint import mixed_scene
from test_recordings import columns

from warpcrete import Simulation, scenes
from warpcrete.core.drawing.paint import Paint, palette_colours, rounded_up
from warpcrete.core.run.files import read_json
from warpcrete.core.run.recorder import Recorder
from warpcrete.core.units import quantity
from warpcrete.dem.batch_run import run_batch
from warpcrete.dem.laws import Contact, HertzMindlin, LubricationLayer
from warpcrete.dem.measure.wear import PipePatches, WearMap, WornWall, patches_of
from warpcrete.dem.measure.wear_results import QUANTITIES, covered, plot_wear, report
from warpcrete.dem.scene.scene import Bodies, Scene, Settle, TimeStep, Wear
from warpcrete.geometry.axis import Arc, Axis, Line
from warpcrete.geometry.walls import MeshWall, PipeWall, PlaneWall, Prescribed
from warpcrete.record.rerun import RerunRecorder
from warpcrete.record.usd import UsdRecorder
from warpcrete.record.usd_looks import linear

FLOOR = PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1))
MESH = MeshWall(
    name="floor", vertices=np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]]),
    faces=np.array([[0, 1, 2], [0, 2, 3]]),
)  # fmt: skip
MASS = 2500 * np.pi / 6 * 0.02**3


def sliding(contact, *, wall=FLOOR, height=None, velocity=(0.5, 0.0, 0.0), **changes) -> Scene:
    """A sphere that slides over a floor, at the depth where it rests."""
    stiffness = 1e6 * np.pi * 0.01
    height = 0.01 - MASS * 9.81 / stiffness if height is None else height
    settings = dict(
        name="one", duration=0.02, contact=contact, precision="float64", energy_balance=True, walls=(wall,),
        bodies=(Bodies(positions=[[0.1, 0.2, height]], sizes=0.02, velocities=np.array([velocity], float)),),
        wear=Wear(coefficient=1e-12), time_step=TimeStep(fixed=2e-6), sample_interval=0.005,
    )  # fmt: skip
    return Scene(**(settings | changes))


def test_a_checkpoint_of_wear_does_not_change_with_the_run():
    wall = SimpleNamespace(name="pipe", done=np.ones((2, 3)))
    run: Any = SimpleNamespace(walls=[wall])
    state = WearMap.state_dict(run)
    wall.done[:, 0] += 1.0
    assert np.array_equal(state["pipe"], np.ones((2, 3)))
    WearMap.load_state_dict(run, state)
    wall.done[:, 0] += 1.0
    assert np.array_equal(state["pipe"], np.ones((2, 3)))


@pytest.mark.parametrize("wall", [FLOOR, MESH], ids=["plane", "mesh"])
def test_a_sliding_sphere_works_mu_n_s(device, wall):
    # It slides all the time: friction slows it by mu g and spins it up, so that its surface slows by 3.5 mu g.
    mu, t, v = 0.1, 0.02, 0.5
    contact = Contact(effective_modulus=1e6, friction=mu, normal_damping_ratio=0.5)
    run = Simulation(sliding(contact, wall=wall), device=device).run()
    way = v * t - 0.5 * 3.5 * mu * 9.81 * t**2
    load = MASS * 9.81
    worn = run.wear.main if wall is MESH else run.wear.walls[0]
    work, bumps, load_way = worn.done.sum(0)
    stretched = mu * load / (1e6 * np.pi * 0.01 / 2)  # of the shear spring, before it slips
    assert work == pytest.approx(mu * load * (way - stretched), rel=2e-4)
    assert load_way == pytest.approx(load * way, rel=2e-4)
    assert bumps < 1e-6 * work
    series = run.series
    assert series["floor_sliding_work"][-1] == work
    spring = 0.5 * mu * load * stretched
    assert series["dissipated_energy"][-1] == pytest.approx(work + bumps, rel=1e-9)
    assert run.result["energy_balance_error"] < 1e-3 and spring < work


def test_a_mesh_knows_which_triangle(device):
    contact = Contact(effective_modulus=1e6, friction=0.1)
    worn = Simulation(sliding(contact, wall=MESH), device=device).run().wear.main
    assert worn.done[0, 0] == 0 and worn.done[1, 0] > 0  # x < y lies in the second
    assert worn.depth[1] == pytest.approx(1e-12 * worn.done[1, 2] / 2.0)


@pytest.mark.parametrize(
    "contact",
    [
        Contact(effective_modulus=1e6, friction=0.3, normal_damping_ratio=0.4),
        LubricationLayer(contact=Contact(effective_modulus=1e6, friction=0.1), yield_stress=20.0, viscosity=50.0),
        HertzMindlin(effective_modulus=1e7, effective_shear_modulus=3e6, friction=0.3, restitution=0.6),
    ],
    ids=["linear", "layer", "hertz"],
)
def test_impacts_lose_what_a_straight_one_does(device, contact):
    # An impact at a slant loses across the wall what one straight on does, and the rest of its loss is sliding.
    slant = dict(gravity=(0, 0, 0), height=0.0101, duration=0.02)
    straight = Simulation(sliding(contact, velocity=(0, 0, -0.3), **slant), device=device).run()
    aslant = Simulation(sliding(contact, velocity=(0.4, 0, -0.3), **slant), device=device).run()
    before, after = straight.series["kinetic_energy"][[0, -1]]
    (work, bump, way), (slid, bumped, further) = (run.wear.walls[0].done.sum(0) for run in (straight, aslant))
    assert way == 0.0 < further  # only motion along the wall is a sliding distance
    assert bump == pytest.approx(straight.series["dissipated_energy"][-1], rel=1e-9) and work == 0.0
    assert bump == pytest.approx(before - after, rel=2.5e-3)  # measured: 1.7e-3, of a step a thousandth of the impact
    assert bumped == pytest.approx(bump, rel=1e-6) and slid > 0.1 * bump


def test_patches_of_a_bend_add_up_to_a_torus():
    axis = Axis((0, 0, 0), (0, 0, 1), (Line(0.3), Arc(0.5, np.pi / 2, (1, 0, 0)), Line(0.2)))
    patches = PipePatches(PipeWall(name="pipe", axis=axis, radius=0.075), None)
    straight, bend = 2 * np.pi * 0.075 * 0.5, 2 * np.pi * 0.075 * 0.5 * np.pi / 2
    assert patches.areas.sum() == pytest.approx(straight + bend, rel=1e-9)
    middle = patches.of(np.array([[0.5 - 0.575 * np.sqrt(0.5), 0, 0.3 + 0.575 * np.sqrt(0.5)]]))  # outside of the bend
    station, angle = divmod(int(middle[0]), patches.around)
    assert angle == 0 and patches.along[station] == pytest.approx(0.3 + 0.25 * np.pi / 2, abs=0.02)
    assert patches.areas[middle[0]] == pytest.approx(patches.areas.max())
    vertices, faces, patch = patches.surface()
    assert faces.max() == len(vertices) - 1 and len(patch) == len(vertices)
    centre = patches.of(vertices[patches.around : -patches.around])
    assert np.array_equal(centre, patch[patches.around : -patches.around])


@pytest.mark.parametrize("degrees", [0, 90, 255])
def test_the_worst_patch_of_a_bend_is_told_by_its_angle_in_degrees(degrees):
    """Wear one point of a quarter bend. Its angle is 0 on the outside of the bend, and 180 degrees on the inside."""
    axis = Axis((0, 0, 0), (0, 0, 1), (Arc(0.5, np.pi / 2, (1, 0, 0)),))
    patches = PipePatches(PipeWall(name="pipe", axis=axis, radius=0.075), None)
    worn = WornWall("pipe", patches, np.zeros((len(patches.areas), 3)), 1e-12)
    outside, side = np.array([-np.sqrt(0.5), 0, np.sqrt(0.5)]), axis.frame(0.5 * axis.length)[3][0]
    angle = np.radians(degrees)
    middle = np.array([0.5, 0, 0]) + 0.5 * outside
    point = middle + 0.075 * (np.cos(angle) * outside + np.sin(angle) * side)
    worn.done[patches.of(point[None])[0], 2] = 1.0
    known = SimpleNamespace(wear=SimpleNamespace(main=worn), series={"time": np.array([1.0])},
                            scene=SimpleNamespace(pipe=None, pressure=None))  # fmt: skip
    found = {each.name: each.of(known) for each in QUANTITIES if each.name.startswith("wear_worst")}
    assert found["wear_worst_angle"] == pytest.approx(degrees, abs=1e-9)  # 24 patches, one every 15 degrees
    assert found["wear_worst_along"] == pytest.approx(0.25 * np.pi / 2, abs=0.5 * axis.length / patches.stations)


def test_a_wall_that_speeds_up_is_worn_with_the_square_of_time(device):
    # It slides under a sphere that lags ever more behind: at an even load the way goes with the square of time.
    contact = Contact(effective_modulus=1e6, friction=0.05)
    motion = Prescribed(velocity=(1.0, 0, 0), ramp_time=0.02)
    scene = sliding(contact, velocity=(0, 0, 0), wall=dataclasses.replace(FLOOR, motion=motion))
    worn = Simulation(scene, device=device).run().series["floor_load_way"]
    assert worn[4] / worn[2] == pytest.approx(4.0, rel=5e-3)
    assert worn[-1] == pytest.approx(MASS * 9.81 * 0.5 * (50 - 3.5 * 0.05 * 9.81) * 0.02**2, rel=5e-3)


def test_sums_over_time_begin_with_the_run_and_not_while_the_concrete_settles(device):
    contact = Contact(effective_modulus=1e6, friction=0.1, normal_damping_ratio=0.5)
    simulation = Simulation(sliding(contact, settle=Settle(duration=0.002)), device=device)
    simulation.prepare()
    walls, spheres = simulation.state.walls, simulation.state.spheres
    sums = [walls.impulse, walls.angular_impulse, walls.travel, walls.work, spheres.dissipated_energy, spheres.broken]
    assert simulation.state.time == 0 and simulation.state.steps == 0
    assert not any(each.numpy().any() for each in (*sums, simulation.state.slots.worn))


def thrown(**changes) -> Scene:
    """Stones thrown about a bend, which lose energy on its wall alone, whose springs in shear store none."""
    random = np.random.default_rng(3)
    axis = Axis((0, 0, 0), (0, 0, 1), (Arc(0.2, np.pi / 2, (1, 0, 0)),))
    points, _, normal, side = axis.frame(np.linspace(0.03, 0.28, 12))
    layer = LubricationLayer(contact=Contact(friction=0.0, normal_damping_ratio=0.3), viscosity=500.0)
    return Scene(
        name="thrown", duration=0.1, contacts={("aggregate", "wall"): layer},
        contact=Contact(friction=0.0, normal_damping_ratio=0.0), energy_balance=True, wear=Wear(), sample_interval=0.01,
        bodies=(Bodies(positions=points + 0.02 * normal - 0.01 * side, sizes=0.012,
                       velocities=random.normal(scale=0.3, size=(12, 3))),),
        walls=(PipeWall(name="pipe", axis=axis, radius=0.04),), precision="float64",
    )  # fmt: skip


def test_the_map_adds_up_to_what_is_dissipated(device):
    run = Simulation(thrown(), device=device).run()
    worn = run.wear.walls[0]
    total = worn.done[:, :2].sum()
    assert total == pytest.approx(run.series["dissipated_energy"][-1], rel=1e-9) and total > 1e-3
    assert np.all(worn.done.sum(0) > 0) and np.count_nonzero(worn.done[:, 0]) > 5
    assert worn.mean_depth() == pytest.approx(2e-13 * worn.done[:, 2].sum() / worn.patches.areas.sum())


def worn_scene(seed=0) -> Scene:
    return dataclasses.replace(mixed_scene(seed), wear=Wear(), duration=0.1)


class Cut(Recorder):
    def sample(self, simulation, row):
        simulation.stop_requested = len(simulation.rows) == 14


def same(one, other):
    assert one.result["state_hash"] == other.result["state_hash"]
    for name in one.series:
        assert np.array_equal(one.series[name], other.series[name]), name
    for mine, yours in zip(one.wear.walls, other.wear.walls, strict=True):
        assert np.array_equal(mine.done, yours.done)


def test_a_resumed_run_wears_the_same(device, tmp_path):
    whole = Simulation(worn_scene(), device=device).run()
    path = tmp_path / "checkpoint.npz"
    assert not Simulation(worn_scene(), device=device, checkpoint_path=path, recorders=[Cut()]).run().finished
    second = Simulation(worn_scene(), device=device)
    second.resume(path)
    same(second.run(), whole)
    assert {wall.name for wall in whole.wear.walls if wall.done.any()} == {"floor", "plate", "drum"}


def test_a_scene_in_a_batch_wears_as_alone(device):
    some = [worn_scene(seed) for seed in (0, 1)]
    batched = run_batch([Simulation(scene, device=device, threads=1) for scene in some])
    for scene, run in zip(some, batched, strict=True):
        same(run, Simulation(scene, device=device, threads=1).run())


@pytest.mark.parametrize("case", [dict(unit="bend-to-horizontal"), dict(wall="mesh", facets=24)], ids=["elbow", "mesh"])
def test_counting_wear_changes_nothing_else(device, case):
    plain = Simulation(scenes.pipe(**(SMALL | case)), device=device).run()
    run = Simulation(scenes.pipe(**(SMALL | case), wear=True), device=device).run()
    if device == "cpu":
        assert run.result["state_hash"] == plain.result["state_hash"]
    else:  # a kernel that counts is another to the compiler, which rounds the last digits otherwise
        assert run["end_pressure"] == pytest.approx(plain["end_pressure"], rel=0.03)
    assert not [name for name in plain.result if name.startswith("wear")] and plain.wear is None
    pipe = run.wear.main
    chosen = covered(pipe, run.scene)
    assert np.all(pipe.done[~chosen] == 0)
    part = pipe.patches.areas[chosen].sum() / pipe.patches.areas.sum()
    assert 0.3 < part < 0.95, "the pipe is longer than what concrete reaches"
    assert pipe.name == "pipe" and run["wear_depth_per_hour"] == pytest.approx(
        3600 * pipe.mean_depth(chosen) / run.series["time"][-1]
    )
    assert run["wear_largest_depth_per_hour"] > run["wear_depth_per_hour"]
    assert 0 <= run["wear_worst_angle"] < 360 and 0 < run["wear_worst_along"] < 0.4
    # Dense concrete slides, and hardly ever bumps.
    assert run["wear_impact_energy"] < 0.02 * run["wear_sliding_energy"]


@pytest.mark.thorough
def test_the_command_draws_and_paints_it(tmp_path, whole_pictures):
    from pxr import Usd, UsdGeom

    out = tmp_path / "run"
    options = small_options(unit="bend-to-horizontal")
    done = command("run", "pipe", "--device", "cpu", *options, "--wear", "--usd", "--out", out)
    assert done.returncode == 0, done.stderr
    assert "um/h" in done.stdout and (out / "wear.png").stat().st_size > 10_000
    assert read_json(out / "result.json")["wear_depth_per_hour"]["unit"] == "m/h"
    stage = Usd.Stage.Open(str(out / "scene.usdc"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Run/Walls/pipe"))
    colour = mesh.GetDisplayColorPrimvar()
    codes = colour.GetIndicesAttr().GetTimeSamples()
    first, last = (np.array(colour.ComputeFlattened(code)) for code in (codes[0], codes[-1]))
    assert len(last) == len(mesh.GetPointsAttr().Get()) and colour.GetInterpolation() == "vertex"
    assert np.ptp(first, axis=0).max() == 0 and np.ptp(last, axis=0).max() > 0.3


class Depths(Recorder):
    """Worn depth [nm] of the patches of the pipe at every frame."""

    def __init__(self):
        self.found = []

    def frame(self, simulation):
        self.found.append(1e9 * simulation.sampler.wear.walls[0].depth)


class Half(Recorder):
    def sample(self, simulation, row):
        simulation.stop_requested = len(simulation.rows) == 6


@pytest.fixture(scope="module", params=["whole", "resumed"])
def painted(request, tmp_path_factory):
    folder, depths = tmp_path_factory.mktemp("painted"), Depths()

    def simulation(checkpoint, *more):
        recorders = [depths, RerunRecorder(folder / "run.rrd"), UsdRecorder(folder / "scene.usdc"), *more]
        return Simulation(thrown(), device="cpu", recorders=recorders, checkpoint_path=checkpoint)

    if request.param == "whole":
        run = simulation(None).run()
    else:
        assert not simulation(folder / "checkpoint.npz", Half()).run().finished
        second = simulation(None)
        second.resume(folder / "checkpoint.npz")
        run = second.run()
    found = np.array(depths.found)
    patch = run.wear.walls[0].patches.surface()[2]
    ends = [rounded_up(np.quantile(each[each > 0], 0.99)) for each in found if each.any()]
    assert len(set(ends)) > 2, "the scale grows on the way"
    return folder, found[:, patch], max(ends)


def statics(path, entity, name):
    """Values of what does not change with time of an entity of a recording, in the order in which they were logged."""
    from rerun.chunk import RrdReader

    found = []
    for chunk in RrdReader(str(path)).stream().to_chunks():
        if str(chunk.entity_path) == entity and chunk.is_static:
            batch = chunk.to_record_batch()
            row = next(column for column in batch.schema.names if "RowId" in column)
            for column in (each for each in batch.schema.names if name in each):
                found += zip(batch.column(row).to_pylist(), batch.column(column).to_pylist())
    return [value for _, value in sorted(found) if value]


def on_scale(depth, upper):
    """Colours that a scale from 0 has, 0 to 255, and what they are off by for steps of 2 %, measured."""
    return palette_colours(depth, upper, name="magma_r").astype(float), 7.0


def test_a_recording_has_one_scale_of_wear_for_all_frames(painted):
    """Also the frames that were written before the wear grew as far; and the half of the pipe that the cut shows."""
    folder, depths, upper = painted
    for path in ("/scene/walls/pipe", "/scene/cut/pipe"):
        textures = statics(folder / "run.rrd", path, "albedo_texture_buffer")
        colours = np.array(textures[-1], np.uint8).reshape(-1, 3)
        (places,) = [v for name, v in columns(folder / "run.rrd", path).items() if "texcoords" in name]
        assert len(places) == len(depths) > 5
        for depth, place in zip(depths, places, strict=True):
            texel = (np.array(place)[:, 0] * len(colours)).astype(int)
            expected, off = on_scale(depth, upper)
            assert np.abs(colours[texel] - expected).max() <= off
    assert statics(folder / "run.rrd", "/legend_of_walls", "blob")


def test_usd_has_one_scale_of_wear_and_says_it(painted):
    from pxr import Usd, UsdGeom

    folder, depths, upper = painted
    stage = Usd.Stage.Open(str(folder / "scene.usdc"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Run/Walls/pipe"))
    scale = mesh.GetPrim().GetCustomDataByKey("colours")
    assert scale == {"quantity": "worn depth [nm]", "lower": 0.0, "upper": upper, "palette": "magma_r"}
    assert f"worn depth [nm] from 0 to {upper:.3g} and above" in mesh.GetPrim().GetDocumentation()
    colour = mesh.GetDisplayColorPrimvar()
    for depth, code in zip(depths, colour.GetIndicesAttr().GetTimeSamples(), strict=True):
        screen = np.interp(np.array(colour.ComputeFlattened(code)), linear(np.arange(256)), np.arange(256))
        expected, off = on_scale(depth, upper)
        assert np.abs(screen - expected).max() <= off


def test_paint_tells_values_apart_and_ends_on_round_numbers():
    values = np.geomspace(1e-3, 1e5, 5000)
    paint = Paint("worn depth [nm]", "magma_r", 50.0)
    steps = paint.steps(values)
    assert np.ptp(paint.steps(np.array([0.0, 1e-12, 0.19]))) == 0 and np.all(np.diff(steps) >= 0)
    off = np.abs(paint.colours()[steps].astype(int) - palette_colours(values, 50.0, name="magma_r").astype(int))
    high = np.geomspace(1e-3, 1e9, 5000)
    deep = Paint("worn depth [nm]", "magma_r", 5e8)
    assert np.abs(deep.colours()[deep.steps(high)].astype(int) - palette_colours(high, 5e8, name="magma_r")).max() <= 7
    assert off.max() <= 7 and np.array_equal(paint.colours()[0], palette_colours(np.zeros(1), 1.0, name="magma_r")[0])
    assert [rounded_up(x) for x in (0.011, 0.02, 0.3, 1.0, 5.1, 700)] == pytest.approx([0.02, 0.02, 0.5, 1, 10, 1000])
    assert np.all(Paint("worn depth [nm]", "magma_r", 0.0).colours() == paint.colours()[0])


def test_wear_is_refused_with_nonsense():
    from warpcrete import SceneError

    with pytest.raises(SceneError, match=r"^wear_coefficient = -1"):
        scenes.pipe(wear=True, wear_coefficient=-1)
    with pytest.raises(SceneError, match=r"^wear patch = 0"):
        Wear(patch=0)


def test_wear_of_a_thick_wall_is_that_of_its_inside():
    """A tube of facets with an outer skin, each facet twice: what is worn, and what means go by, faces the axis."""
    axis = Axis((0, 0, 0), (0, 0, 1), (Line(0.3),))
    (inner, faces), (outer, _) = axis.tube(0.05, 24), axis.tube(0.0505, 24)
    both = np.concatenate([faces, faces + len(inner), faces[:, ::-1]])
    single = patches_of(MeshWall(name="pipe", vertices=inner, faces=faces), None)
    thick = patches_of(MeshWall(name="pipe", vertices=np.concatenate([inner, outer]), faces=both), None)
    points = inner[faces].mean(1)
    assert np.array_equal(single.of(points), np.arange(len(faces)))
    assert np.array_equal(thick.of(points), np.arange(len(faces)))
    seen = thick.seen_from(axis)
    assert np.array_equal(np.flatnonzero(seen), np.flatnonzero(single.seen_from(axis)))
    scene = SimpleNamespace(pipe=SimpleNamespace(axis=axis))
    depths = []
    for patches in (single, thick):
        wall = WornWall("pipe", patches, np.zeros((len(patches.areas), 3)), 1e-12)
        wall.done[: len(faces), 2] = 3.0
        depths.append(wall.mean_depth(covered(wall, scene)))
    assert depths[1] == pytest.approx(depths[0], rel=1e-12)


@pytest.mark.parametrize("wall", ["exact", "mesh"])
def test_kept_wear(wall):
    """Results, report and figure of an elbow whose patches are worn by made-up amounts (see `kept`)."""
    given = dict(unit="bend-to-horizontal", length=0.4, diameter=0.1, elbow_radius=0.3, wear=True)
    scene = scenes.pipe(**given, **(dict(wall="mesh", facets=24) if wall == "mesh" else {}))
    worn = []
    for each in scene.walls:
        patches = patches_of(each, 0.03)
        k = np.arange(len(patches.areas))
        done = np.stack([1 + np.sin(0.3 * k), 0.1 + 0.05 * np.cos(0.2 * k), 2 + np.sin(0.05 * k)], 1) * 1e3
        done[k % 7 == 0] = 0.0
        worn.append(WornWall(each.name, patches, done * patches.areas[:, None], 2e-12))
    run = SimpleNamespace(
        wear=SimpleNamespace(walls=worn, main=worn[-1]), scene=scene, result={}, units={},
        series={"time": np.linspace(0, 0.5, 6), "travel": np.linspace(0, 0.1, 6)},
    )  # fmt: skip
    for each in QUANTITIES:
        if (value := each.of(run)) is not None:
            run.result[each.name] = quantity(value, each.unit)
    kept.compare(
        f"wear-{wall}",
        {"result": run.result, "report": list(report(run)), "figure": kept.drawn(plot_wear(run, worn[-1])),
         "names": [each.name for each in worn]},
    )  # fmt: skip
