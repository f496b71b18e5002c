"""How runs are shown: legends, cuts, chains, profiles and frames of recordings; looks and words of USD scenes."""

import functools
import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from pumping import SMALL, TINY
from test_recordings import columns

from warpcrete import Simulation, scenes
from warpcrete.core.device.recorder_thread import RecorderThread
from warpcrete.core.drawing.display import DrawnWall
from warpcrete.core.drawing.paint import palette_colours
from warpcrete.core.run.frames import LONGEST_FRAME_INTERVAL, MINIMUM_FRAMES, Frames
from warpcrete.core.run.recorder import Recorder
from warpcrete.dem.measure.probes import largest_forces, pair_forces
from warpcrete.geometry.axis import Axis, Line
from warpcrete.record.blueprint import MIN_PLAY_TIME, blueprint, cut_walls, spheres_behind_cut
from warpcrete.record.legend import legend, legend_title, meaning, paint_legend
from warpcrete.record.rerun import RerunRecorder
from warpcrete.record.usd import UsdRecorder
from warpcrete.record.usd_looks import CLEAR, linear, wall_look
from warpcrete.theory.pipe import velocity

TUBE = dict(spacing=0.02, duration=0.012, sample_interval=4e-3)


class StationArrays(Recorder):
    """Recorder that keeps what displays show at every frame."""

    def __init__(self, *colourings):
        self.colourings, self.found, self.times = colourings, [], []

    def frame(self, simulation):
        self.times.append(simulation.stepper.time)
        for colouring in self.colourings:
            self.found.append(self.look(simulation.display(colouring), simulation))

    def look(self, display, simulation):
        forces = display._largest_forces()[np.argsort(simulation.state.bodies.id.numpy())]
        return SimpleNamespace(
            display=display, scale=display.scale(), colours=display.body_colours().copy(), forces=forces,
            network=display.network(), profile=display.profiles()[0].curves[0].read(), table=simulation.state.table(),
        )  # fmt: skip


@pytest.fixture(scope="module")
def pumped(tmp_path_factory):
    """A short pipe, with chains."""
    folder = tmp_path_factory.mktemp("pumped")
    seen = StationArrays(None, "speed")
    recorders = [seen, RerunRecorder(folder / "run.rrd", network=True),
                 UsdRecorder(folder / "scene.usdc", velocities=False)]  # fmt: skip
    scene = scenes.pipe(**SMALL | dict(shapes="spheres", travel=0.01))
    run = Simulation(scene, device="cpu", recorders=recorders).run()
    return folder, seen, run


def test_aggregates_are_coloured_by_force_on_the_scale_that_the_legend_has(pumped):
    _, seen, _ = pumped
    last = seen.found[-2]
    assert last.display.colouring == "force"
    label, lower, upper = last.scale
    assert label.endswith("[N]") and lower == 0 and last.forces.max() > 0.2 * upper
    from matplotlib import colormaps

    expected = colormaps["viridis"](np.clip(last.forces / upper, 0, 1))[:, :3]
    assert last.colours / 255 == pytest.approx(expected, abs=0.02)
    assert seen.found[-1].scale[0] == "speed [cm/s]"
    assert legend_title(last.display).endswith("[N]") and f"{upper:.3g} and above" in meaning(last.display)
    assert legend(last.display)[:4] == b"\x89PNG"


def test_chains_are_as_wide_as_contacts_press(pumped):
    """In proportion up to the scale's end, in the colours of the scale; every force is that of some body's contact."""
    _, seen, _ = pumped
    found = seen.found[-2]
    _, _, upper = found.scale
    lines = [each for each in found.network.values() if len(each.ends)]
    force, radii = (np.concatenate([getattr(each, name) for each in lines]) for name in ("forces", "radii"))
    between = (force > 0.1 * upper) & (force < 0.9 * upper)
    assert between.sum() > 10
    assert radii[between] / force[between] == pytest.approx(radii[between][0] / force[between][0], rel=1e-5)
    assert radii[force > upper] == pytest.approx(radii.max()) and radii[force <= 0] == pytest.approx(radii.min())
    assert force.max() == pytest.approx(found.forces.max(), rel=1e-6)
    ends = np.concatenate([each.ends for each in lines])
    assert np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).max() < 2 * found.table.size.max()


@pytest.mark.parametrize("hydration", [0.0, 0.3])
def test_all_bonds_are_drawn_and_hydrated_ones_apart(hydration):
    """The bonds of the plug are the second kind without hydration, and the third kind with it."""
    scene = scenes.pipe(**TINY | dict(travel=0.0005, ramp=0.0002, settle=0.0, plug="balls", hydration=hydration))
    simulation = Simulation(scene, device="cpu", threads=1)
    run = simulation.run()
    lines = {name: len(each.ends) for name, each in simulation.display().network().items()}
    hydrated = lines.get("hydrated bonds", 0)
    assert ("hydrated bonds" in lines) == (hydration > 0)
    assert hydrated == run.series["hydrated_bonds"][-1] and (hydrated > 0) == (hydration > 0)
    assert lines["bonds"] + hydrated == run.series["bonds"][-1] > hydrated


@pytest.mark.parametrize("threads", [1, 2])
def test_load_of_each_body_is_its_largest_contact_force(device, threads):
    scene = scenes.pipe(**TINY | dict(shapes="reference", travel=0.001, ramp=0.0005, settle=0.0))
    simulation = Simulation(scene, device=device, threads=threads)
    simulation.run()
    model, state = simulation.model, simulation.state
    i, j, force = pair_forces(model, state)
    body = state.spheres.body.numpy()
    expected = np.zeros(state.body_count)
    for sphere in (i, j):
        np.maximum.at(expected, body[sphere], force)
    assert np.count_nonzero(expected) > 50
    assert np.array_equal(largest_forces(model, state).numpy(), expected)
    assert np.array_equal(largest_forces(model, state).numpy(), expected)  # from zero anew


def test_displays_of_one_moment_read_it_once(device):
    """Copies from a GPU hold up the run."""
    simulation, reads = Simulation(scenes.pipe(**SMALL | dict(travel=0.004, settle=0.0)), device=device), []
    simulation.prepare()
    displays = [simulation.display("speed"), simulation.display("force")]
    later = RecorderThread(in_thread=True)

    def job(display, time, steps):
        display.snapshot_value("read", lambda: reads.append(simulation.stepper.steps))
        display.centres()

    for number in range(3):
        for display in displays:
            display.draw(later, functools.partial(job, display))
        later.wait()
        simulation.stepper.advance(1e-3 * (number + 1))
    later.close()
    # Each reads the first one itself; of every later moment one does for both.
    assert len(reads) == 4 and reads[:2] == [0, 0] and 0 < reads[2] < reads[3]


def test_a_recording_has_chains_profile_zero_and_legend(pumped):
    folder, seen, _ = pumped
    chains = columns(folder / "run.rrd", "/scene/network/contacts") | columns(
        folder / "run.rrd", "/scene/network/bonds"
    )
    (radii,) = [value for name, value in chains.items() if "radii" in name.lower()]
    assert len(radii) == len(seen.times) and len(set(np.concatenate([np.ravel(r) for r in radii if r]))) > 10
    bars = columns(folder / "run.rrd", "/profile/velocity/aggregates")
    assert len(bars["time"]) == len(seen.times)
    for entity in ("/pressure/zero", "/energy/zero"):
        zero = columns(folder / "run.rrd", entity)
        assert zero["time"] == [0.0]
        (values,) = [value for name, value in zero.items() if "scalars" in name.lower()]
        assert np.ravel(values) == [0.0]
    from rerun.chunk import RrdReader

    names = {str(c.entity_path) for c in RrdReader(str(folder / "run.rrd")).stream().to_chunks() if c.is_static}
    assert {"/legend", "/scene/cut/pipe", "/scene/walls/pipe"} <= names


def test_a_profile_is_the_mean_velocity_of_rings(pumped):
    """The expected mean is computed from the bodies.

    This value is the mean velocity along the vertical pipe, weighted by volume, of the bodies in the middle of the
    concrete.
    """
    _, seen, run = pumped
    found = seen.found[-2]
    place, speed = found.profile
    t = found.table
    low, high = np.quantile(t.position[:, 2], (0.2, 0.8))
    amid = (t.position[:, 2] >= low) & (t.position[:, 2] <= high)
    ring = np.linalg.norm(t.position[:, :2], axis=1) // (run.scene.pipe.radius / 10)
    for k, (middle, mean) in enumerate(zip(place, speed)):
        number = round(1e-3 * middle / run.scene.pipe.radius * 10 - 0.5)
        these = amid & (ring == number)
        expected = np.average(t.velocity[these][:, 2], weights=t.size[these] ** 3.0)
        assert mean == pytest.approx(100 * expected, rel=1e-4, abs=1e-6), k
    assert len(place) > 5 and place.max() < 1e3 * run.scene.pipe.radius


@pytest.fixture(scope="module")
def clumps():
    """A short pipe of clumps, after its run."""
    scene = scenes.pipe(**TINY | dict(shapes="reference", travel=0.002, ramp=0.001))
    simulation = Simulation(scene, device="cpu", threads=1)
    simulation.run()
    return simulation


@pytest.mark.parametrize("colouring", ["force", "speed", "size"])
def test_colours_as_one_number_each_are_the_same_colours(colouring, clumps):
    display = clumps.display(colouring)
    red, green, blue = display.colours().astype(np.int64).T
    expected = ((red * 256 + green) * 256 + blue) * 256 + 255
    assert display.packed_colours().dtype == np.uint32 and np.array_equal(display.packed_colours(), expected)
    assert len(np.unique(expected)) > 3 and np.array_equal(
        display.body_colours()[display.fields()["body"]], display.colours()
    )


def test_a_flow_s_profile_stands_beside_theory():
    simulation = Simulation(scenes.channel(spacing=0.01), device="cpu", threads=1)
    run = simulation.run()
    ours, theory = (curve.read() for curve in simulation.display().profiles()[0].curves)
    assert np.array_equal(ours[0], theory[0]) and ours[1] == pytest.approx(theory[1], rel=0.03)
    scene = run.scene
    inner = scene.radius - scene.line.slip_thickness
    exact = velocity(scene.concrete, scene.line, scene.theory(), np.minimum(1e-3 * theory[0], inner))
    assert theory[1] == pytest.approx(100 * exact) and simulation.display().cut is None


def bars(path, entity):
    """Places and values of a profile in a recording, one pair a frame; places are logged where they change."""
    held, places, found = columns(path, f"/profile/{entity}"), np.zeros(0), []
    for values, abscissa in zip(held["BarChart:values"], held["BarChart:abscissa"], strict=True):
        places = np.array(abscissa[0]["buffer"]) if abscissa else places
        found.append((places, np.array(values[0]["buffer"])))
        assert len(places) == len(found[-1][1])
    return found


def test_stress_along_a_column_at_rest_is_what_stands_on_it(tmp_path):
    """Without friction, of the weight above and the plate's force, by the bodies themselves; in kPa over m."""
    given = dict(concrete="zhan-table1", bonds=False, friction=0.0, wall_friction=0.0, modulus=1e6, settle=2.0,
                 unit="vertical", diameter=0.08, straight=0.15, size_min=12e-3, size_max=20e-3, slices=1.5,
                 plug="plate", plug_pressure=200.0, flow=5e-6, travel=2e-5, ramp=0.0)  # fmt: skip
    simulation = Simulation(scenes.part_dem(**given), device="cpu", recorders=[RerunRecorder(tmp_path / "run.rrd")])
    run = simulation.run()
    along, mean = (bars(tmp_path / "run.rrd", f"pressure/{name}") for name in ("axial", "mean"))
    assert len(along) == len(mean) == len(run.series["time"])  # as short as this, each row has a frame
    z, mass = simulation.state.bodies.position.numpy()[:, 2], simulation.state.bodies.mass.numpy()
    for number, ((left, stress), (right, _)) in enumerate(zip(along, mean)):
        place = 0.5 * (left + right)  # bars stand side by side
        slices = np.arange(6)[number == len(along) - 1 :][: len(place)]  # the piston is past the edge of the first
        assert place == pytest.approx(0.05 * slices + 0.025) and len(place) >= 4
        above = [200 + 9.81 * mass[z > s].sum() / (np.pi * 0.04**2) for s in place]
        assert 1e3 * stress == pytest.approx(above, rel=0.02)  # measured 1.4 %: stones are counted by their centres
    last = simulation.sampler.log.samples[-1]
    assert 1e3 * mean[-1][1] == pytest.approx(last[np.isfinite(last[:, 0]), 0])


def test_stress_along_a_pipe_is_shown_where_rows_do_not_have_it(tmp_path):
    """The stress in a column at rest is shown too.

    The stress is measured for recordings only. The measurement does not change the run.
    """
    given = dict(concrete="zhan-table1", bonds=False, friction=0.0, wall_friction=0.0, modulus=1e6, settle=2.0,
                 unit="vertical", diameter=0.08, length=0.32, size_min=12e-3, size_max=20e-3, plug="plate",
                 plug_pressure=200.0, velocity=1e-3, travel=2e-5, ramp=0.0)  # fmt: skip
    simulation = Simulation(scenes.pipe(**given), device="cpu", recorders=[RerunRecorder(tmp_path / "run.rrd")])
    run = simulation.run()
    assert run.result["state_hash"] == Simulation(scenes.pipe(**given), device="cpu").run().result["state_hash"]
    assert not run.tables and simulation.sampler.log is None
    along, mean = (bars(tmp_path / "run.rrd", f"pressure/{name}") for name in ("axial", "mean"))
    assert len(along) == len(mean) == len(run.series["time"])
    z, mass = simulation.state.bodies.position.numpy()[:, 2], simulation.state.bodies.mass.numpy()
    for number, ((left, stress), (right, _)) in enumerate(zip(along, mean)):
        place = 0.5 * (left + right)
        slices = np.arange(8)[number > 0 :][: len(place)]  # the piston is past the edge of the first
        assert place == pytest.approx(0.04 * slices + 0.02, abs=1e-4) and len(place) >= 6
        above = [200 + 9.81 * mass[z > s].sum() / (np.pi * 0.04**2) for s in place]
        assert 1e3 * stress == pytest.approx(above, rel=0.035)  # measured 2.8 %: stones are up to half a slice long


def test_a_pipe_that_is_not_round_has_no_stress_along_it(tmp_path):
    """Slices of it have volumes that nobody knows."""
    axis = Axis((0, 0, 0), (0, 0, 1), (Line(0.5),))
    vertices, faces = axis.tube(0.043, 6)
    trimesh.Trimesh(vertices, faces, process=False).export(tmp_path / "hexagon.stl")
    round_, odd = (
        scenes.pipe(**SMALL | dict(unit="vertical", wall=wall)) for wall in ("mesh", str(tmp_path / "hexagon.stl"))
    )
    assert odd.stations is None and round_.stations is not None and not round_.stations.each_row


def test_pressure_along_an_upright_part_is_weight_and_friction(tmp_path):
    """Both fall in proportion to what is ahead; at the start it is what the series has."""
    paste = dict(concrete="own", density=2300.0, viscosity=20.0, yield_stress=0.0, slip_viscosity=900.0, slip_yield=0.0)
    scene = scenes.part(unit="vertical", straight=0.2, spacing=0.0125, **paste)
    run = Simulation(scene, device="cpu", threads=1, recorders=[RerunRecorder(tmp_path / "run.rrd")]).run()
    ours, theory = (bars(tmp_path / "run.rrd", f"pressure/{name}") for name in ("this_run", "theory"))
    assert len(ours) == len(theory) > 5
    (left, pressure), (right, expected) = ours[-1], theory[-1]
    place, length = 0.5 * (left + right), 0.4
    exact = (scene.theory(0.0).pressure + 2300 * 9.81) * (length - place)
    assert 1e3 * expected == pytest.approx(exact, rel=1e-6)
    assert 1e3 * ours[0][1] == pytest.approx(2300 * 9.81 * (length - place))  # friction comes with flow
    inner = (place > 0.0625) & (place < length - 0.0625)
    assert pressure[inner] == pytest.approx(expected[inner], abs=2e-3 * expected[0])  # measured 1.5e-3
    at_start = np.polyval(np.polyfit(place[inner], pressure[inner], 1), 0.0)
    assert 1e3 * at_start == pytest.approx(run.series["pressure"][-1], rel=1e-3)


def test_a_cut_leaves_what_lies_behind_the_axis():
    simulation = Simulation(scenes.tube(**TUBE), device="cpu", threads=1)
    simulation.prepare()
    display = simulation.display()
    kept = spheres_behind_cut(display)
    assert kept.sum() == pytest.approx(len(kept) / 2, rel=0.2) and np.all(display.centres()[kept, 1] >= 0)
    (whole,), (half,) = display.walls(), cut_walls(display)
    assert isinstance(half, DrawnWall) and len(half.faces) == len(whole.faces) / 2
    assert -1e-8 < half.vertices[half.faces][..., 1].min() < 1e-8
    plane = Simulation(scenes.channel(**TUBE), device="cpu", threads=1)
    plane.prepare()
    assert spheres_behind_cut(plane.display()) is None and cut_walls(plane.display()) == []


def test_bars_of_colours_span_the_scale(monkeypatch):
    """A bar spans the scale from its lower end, which need not be zero, to its upper end.

    A bar of walls starts at zero.
    """
    monkeypatch.setattr("warpcrete.record.legend._png", lambda figure: figure)
    found: Any = legend(
        SimpleNamespace(scale=lambda: ("speed [m/s]", 0.23, 0.71), categories=lambda: {}, palette="concrete")
    )
    painted: Any = paint_legend(SimpleNamespace(upper=3.3, palette="magma"))
    for figure, span in ((found, (0.23, 0.71)), (painted, (0.0, 3.3))):
        (axes,) = figure.axes
        assert axes.get_xlim() == pytest.approx(span)
        ticks = {place: float(text.get_text()) for place, text in zip(axes.get_xticks(), axes.get_xticklabels())}
        shown = {place: value for place, value in ticks.items() if span[0] <= place <= span[1]}
        assert list(shown) == pytest.approx(list(shown.values()))
        assert max(shown) - min(shown) > 0.6 * (span[1] - span[0])


def test_things_have_a_legend_where_colours_tell_them_apart():
    simulation = Simulation(scenes.channel(spacing=5e-3, aggregates=True), device="cpu", threads=1)
    simulation.prepare()
    display = simulation.display()
    assert display.scale() is None and legend_title(display) == "Coarse aggregate, mortar"
    assert legend(display)[:4] == b"\x89PNG" and "mortar RGB" in meaning(display)


def times(frames, end, step):
    """Return the times of all frames of a run that checks at every step whether a frame is due."""
    found = []
    for k in range(1, round(end / step) + 1):
        if frames.due(k * step):
            found.append(k * step)
            frames.schedule_next(k * step)
    return np.array(found)


def test_frames_are_as_many_as_it_takes_to_play():
    assert np.allclose(times(Frames(None, 4.0), 4.0, 0.01), LONGEST_FRAME_INTERVAL * np.arange(1, 101))
    assert len(times(Frames(None, 0.3), 0.3, 0.002)) == MINIMUM_FRAMES
    asked = times(Frames(0.1, 0.3), 0.3, 0.002)
    assert asked == pytest.approx([0.1, 0.2, 0.3])
    longer = times(Frames(None, 0.03), 2.0, 1e-3)  # than was expected
    assert longer[:MINIMUM_FRAMES] == pytest.approx(1e-3 * np.arange(1, MINIMUM_FRAMES + 1)) and len(longer) < 160
    assert np.diff(longer).max() < LONGEST_FRAME_INTERVAL + 2e-3


@pytest.mark.parametrize("ends", ["piston", "periodic"])
def test_frames_of_a_flow_change_nothing_of_it(ends):
    """They lie between its samples, where its steps are all the same; a flow that is steady soon has some to play."""
    found = []
    for recorders in ([], [StationArrays()]):
        simulation = Simulation(scenes.tube(ends=ends, **TUBE), device="cpu", threads=1, recorders=recorders)
        found.append(simulation.run().result["state_hash"])
    seen = recorders[0].times
    assert found[0] == found[1] and seen == sorted(set(seen)) and seen[-1] == pytest.approx(TUBE["duration"])
    between = [t for t in seen if abs(t / 4e-3 - round(t / 4e-3)) > 1e-6]
    assert len(between) >= 12 if ends == "piston" else not between


def test_usd_has_looks_light_and_words(pumped):
    from pxr import Usd, UsdGeom, UsdLux, UsdShade

    folder, seen, _ = pumped
    stage = Usd.Stage.Open(str(folder / "scene.usdc"))
    words = stage.GetRootLayer().documentation
    assert "Metres, Z up" in words and "largest contact force per aggregate [N]" in words
    assert stage.GetDefaultPrim().GetDocumentation() == words
    looks = {}
    for path in ("/Run/Walls/pipe", "/Run/Walls/piston", "/Run/Aggregates/Prototypes/Template_0/Sphere_0"):
        material, _ = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(path)).ComputeBoundMaterial()
        shader, _, _ = material.ComputeSurfaceSource()
        assert shader.GetIdAttr().Get() == "UsdPreviewSurface"
        looks[path.split("/")[3]] = {each.GetBaseName(): each.Get() for each in shader.GetInputs()}, shader
    assert looks["pipe"][0]["opacity"] < 0.3 and looks["piston"][0]["opacity"] == 1
    assert looks["piston"][0]["metallic"] > looks["pipe"][0]["metallic"] == 0
    source = looks["Prototypes"][1].GetInput("diffuseColor").GetConnectedSources()[0][0].source
    assert UsdShade.Shader(source.GetPrim()).GetInput("varname").Get() == "displayColor"
    lights = [prim for prim in stage.Traverse() if prim.HasAPI(UsdLux.LightAPI)]
    assert {prim.GetTypeName() for prim in lights} == {"DomeLight", "DistantLight"}
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath("/Run/Aggregates"))
    codes = instancer.GetPositionsAttr().GetTimeSamples()
    assert len(codes) == len(seen.times)
    assert not instancer.GetOrientationsAttr().HasAuthoredValue()  # of balls
    assert not instancer.GetVelocitiesAttr().HasAuthoredValue()
    colour = UsdGeom.PrimvarsAPI(instancer).GetPrimvar("displayColor")
    for code, found in zip(codes, seen.found[::2], strict=True):
        assert np.array(colour.ComputeFlattened(code)) == pytest.approx(linear(found.colours), abs=1e-6)


def test_colours_of_usd_are_light():
    """IEC 61966-2-1: 0 and 1 stay, a screen's middle grey of 188 is half the light."""
    assert linear(np.array([0, 10, 188, 255])) == pytest.approx([0, 0.003035, 0.5029, 1], abs=2e-4)


def test_notes_of_usd_are_readable(pumped):
    from pxr import Sdf

    notes = Sdf.Layer.FindOrOpen(str(pumped[0] / "scene.usdc")).customLayerData
    assert (
        json.loads(json.dumps(dict(notes)))["title"]
        == "warpcrete: pipe vertical, diameter 80 mm, concrete zhan, 5.43 m3/h"
    )


@pytest.mark.parametrize(
    "alpha, moves, opacity", [(10, False, CLEAR), (200, False, 200 / 255), (10, True, CLEAR), (255, True, 1.0)]
)
def test_clear_walls_of_usd_stay_visible(alpha, moves, opacity):
    from pxr import Usd

    wall = DrawnWall("wall", np.eye(3), np.array([[0, 1, 2]]), moves, (10, 20, 30, alpha))
    assert wall_look(Usd.Stage.CreateInMemory(), wall, "wall")[2] == pytest.approx(opacity)


@pytest.mark.parametrize("duration, speed", [(0.1 * MIN_PLAY_TIME, 0.1), (10 * MIN_PLAY_TIME, 1.0)])
def test_a_short_run_plays_slowly_and_a_long_one_in_its_own_time(duration, speed):
    simulation = Simulation(scenes.channel(ends="periodic"), device="cpu")
    simulation.prepare()
    shown = blueprint(simulation.display(), network=False, legend=False, duration=duration)
    assert shown.time_panel.playback_speed == pytest.approx(speed)


def test_a_scale_may_begin_above_zero():
    """Viridis between 3 and 5: its ends, and its middle for 4."""
    values = np.array([2.0, 3.0, 4.0, 5.0, 6.0])
    assert np.array_equal(palette_colours(values, 5.0, 3.0), palette_colours(np.array([0.0, 0.0, 0.5, 1.0, 1.0]), 1.0))


@pytest.mark.parametrize("palette, low, high", [("viridis", "dark violet", "yellow"), ("concrete", "grey", "dark red")])
def test_the_words_of_a_scale_name_the_colours_at_its_ends(palette, low, high):
    """Dark violet has more blue than green, yellow little blue; grey has no colour, and dark red most of red."""
    display: Any = SimpleNamespace(scale=lambda: ("speed [m/s]", 0.25, 2.0), palette=palette)
    assert meaning(display) == f"Colours: speed [m/s] from 0.25 ({low}) to 2 and above ({high}), on {palette}."
    lowest, highest = palette_colours(np.array([0.25, 2.0]), 2.0, 0.25, palette).astype(int)
    if palette == "viridis":
        assert lowest[2] > lowest[0] > lowest[1] + 50 and min(highest[:2]) > highest[2] + 150
    else:
        assert np.ptp(lowest) < 15 and highest[0] > 1.5 * max(highest[1:])
