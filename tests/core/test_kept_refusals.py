"""Messages with which wrong arguments of Python functions and wrong entries of files are refused, kept (see `kept`).

The cases lie on both sides of a limit. A case that is allowed has the word "accepted" as its message, and the result of
its function if this is a text.
"""

import warnings
from dataclasses import replace

import kept
import numpy as np
import trimesh
from tubes import bent, tube

from warpcrete import scenes
from warpcrete.core.errors import PlausibilityWarning, WarpcreteError
from warpcrete.core.inputs.limits import LIMITS, check_limit, check_velocity, check_whole
from warpcrete.dem.engine.model import build_model
from warpcrete.dem.laws import Contact, HertzMindlin
from warpcrete.dem.laws.base import damping_ratio
from warpcrete.dem.pumping.components import fractions_of
from warpcrete.dem.scene import clumps
from warpcrete.dem.scene.containers import Fill, PipeContainer
from warpcrete.dem.scene.scene import AxisDrive, Bodies, PressureProbe, Scene
from warpcrete.dem.scene.settings import Bonds, Hydration, Rest
from warpcrete.dem.scene.sizes import SieveCurve, Uniform
from warpcrete.dem.scene.slices import Stations
from warpcrete.geometry.axis import Arc, Axis, Line
from warpcrete.geometry.bores import Bores
from warpcrete.geometry.lines import line_of
from warpcrete.geometry.pumps import pump_of
from warpcrete.geometry.walls import Driven, MeshWall, PipeWall, PlaneWall, Prescribed, Stops
from warpcrete.mix.mix import mix_of
from warpcrete.mix.stones import read_shape
from warpcrete.mps.scene import Aggregates as Grains
from warpcrete.scenes import modules
from warpcrete.studies.calibration.calibrate import calibrate
from warpcrete.studies.calibration.targets import task_of
from warpcrete.studies.cases import MAX_CASES, cases_of
from warpcrete.studies.lines.elements import Elements
from warpcrete.studies.lines.folder import check_known
from warpcrete.studies.lines.pipeline import pipeline_pressure
from warpcrete.studies.lines.theory_line import check_settings
from warpcrete.studies.validation.cases import read_cases
from warpcrete.suspension.aggregates import Aggregates
from warpcrete.theory.pipe import CONCRETES, after_rest, kaplan, measured_layer, steady, steady_of_stress
from warpcrete.theory.pipe import Line as PipeLine
from warpcrete.theory.segregated import Segregated
from warpcrete.theory.suspension import thickening

STRAIGHT = Axis((0, 0, 0), (0, 0, 1), (Line(0.4),))
SPHERE = clumps.sphere()
BOX = trimesh.creation.box((0.1, 0.1, 0.1))
FLOOR = PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1))


def told(make, folder):
    """Return the warnings of a call, and the message of its refusal or the word "accepted" with a returned text."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", PlausibilityWarning)
        try:
            made = make()
            found = f"accepted: {made}" if isinstance(made, str) else "accepted"
        except WarpcreteError as error:
            found = str(error)
    said = [str(each.message) for each in caught if each.category is PlausibilityWarning]
    return " | ".join([*said, found]).replace(str(folder), "FOLDER")


def compare(name, cases, folder="\0"):
    kept.compare(f"refusals-{name}", "\n".join(f"{called}: {told(make, folder)}" for called, make in cases.items()))


def test_kept_refusals_of_shapes():
    corners = BOX.vertices

    def mesh(vertices=corners, faces=BOX.faces):
        return MeshWall(name="wall", vertices=vertices, faces=faces)

    def pipe(**moves):
        return PipeWall(name="pipe", axis=STRAIGHT, radius=0.1, motion=Prescribed(**moves))

    def clump(centres, radii):
        return clumps.clump("stone", np.array(centres), np.array(radii))

    cases = {
        "axis without direction": lambda: Axis((0, 0, 0), (0, 0, 0), (Line(1.0),)),
        "axis without pieces": lambda: Axis((0, 0, 0), (0, 0, 1), ()),
        "axis that bends straight on": lambda: Axis((0, 0, 0), (0, 0, 1), (Arc(0.2, 1.0, (0, 0, 3)),)).segments(),
        "axis that bends almost straight on": lambda: Axis((0, 0, 0), (0, 0, 1), (Arc(0.2, 1.0, (1e-3, 0, 3)),)),
        "no bore": lambda: Bores((0.0, 0.1), (0.05, 0.0)),
        "pipe that turns": lambda: pipe(spin=(0, 0, 1)),
        "pipe that moves": lambda: pipe(velocity=(0, 0, 1)),
        "mesh": mesh,
        "mesh of words": lambda: mesh(vertices=[["a", "b", "c"]]),
        "mesh in a plane": lambda: mesh(vertices=corners[:, :2]),
        "mesh without end": lambda: mesh(vertices=np.where(corners > 0, np.inf, corners)),
        "mesh without faces": lambda: mesh(faces=np.zeros((0, 3))),
        "mesh of squares": lambda: mesh(faces=np.zeros((2, 4))),
        "mesh with a corner too many": lambda: mesh(faces=np.minimum(BOX.faces + 1, 8)),
        "mesh with a corner below 0": lambda: mesh(faces=BOX.faces - 1),
        "clump": lambda: clump([[0, 0, 0], [0, 0, 1]], [1, 0.5]),
        "clump of words": lambda: clump([["a", 0, 0]], [1]),
        "clump of nothing": lambda: clump(np.zeros((0, 3)), []),
        "clump with a centre too many": lambda: clump(np.zeros((2, 3)), [1]),
        "clump without end": lambda: clump([[0, 0, np.nan]], [1]),
        "clump without size": lambda: clump([[0, 0, 0], [0, 0, 1]], [1, 0]),
        "clump of half a sphere": lambda: clumps.from_mesh(BOX, 1.5),
        "clump of true": lambda: clumps.from_mesh(BOX, True),
        "clump of too many spheres": lambda: clumps.from_mesh(BOX, 501),
        "coarse clump": lambda: clumps.from_mesh(BOX, 2, resolution=3),
        "clump of a plate": lambda: clumps.from_mesh(trimesh.creation.box((1, 1, 0.01)), 2, resolution=8),
        "clump of more spheres than a plate has": lambda: clumps.from_mesh(BOX, 400, resolution=4),
        "openings of words": lambda: SieveCurve(("a", "b"), (0, 1)),
        "openings without end": lambda: SieveCurve((0.004, np.inf), (0, 1)),
        "one opening": lambda: SieveCurve((0.004,), (0,)),
        "openings and shares": lambda: SieveCurve((0.004, 0.008), (0, 0.5, 1)),
        "openings that repeat": lambda: SieveCurve((0.004, 0.004), (0, 1)),
        "opening of nothing": lambda: SieveCurve((0.0, 0.004), (0, 1)),
        "shares from above 0": lambda: SieveCurve((0.004, 0.008), (0.1, 1)),
        "shares to below 1": lambda: SieveCurve((0.004, 0.008), (0, 0.9)),
        "shares that fall": lambda: SieveCurve((0.004, 0.008, 0.016, 0.02), (0, 0.6, 0.5, 1)),
        "shares that stay": lambda: SieveCurve((0.004, 0.008, 0.016, 0.02), (0, 0.5, 0.5, 1)),
        "one edge": lambda: Stations(axis=STRAIGHT, bores=Bores((0.0,), (0.05,)), edges=(0.0,)),
        "edges that repeat": lambda: Stations(axis=STRAIGHT, bores=Bores((0.0,), (0.05,)), edges=(0.0, 0.1, 0.1)),
        "shares of shapes": lambda: fractions_of("2,1,x"),
        "pump of 9 bar": lambda: pump_of("9 bar"),
        "pump in bar without unit": lambda: pump_of(85),
        "pump without pressure": lambda: pump_of({"power": "90 kW"}),
        "aggregates in a plane": lambda: Aggregates(np.zeros((2, 2)), np.ones(2), 2650.0),
        "aggregates with a radius too many": lambda: Aggregates(np.zeros((2, 3)), np.ones(3), 2650.0),
        "aggregates without size": lambda: Aggregates(np.zeros((2, 3)), np.array([1.0, 0.0]), 2650.0),
        "aggregates nowhere": lambda: Aggregates(np.full((1, 3), np.nan), np.ones(1), 2650.0),
    }  # fmt: skip
    compare("shapes", cases)


def test_kept_refusals_of_scenes():
    one = Bodies(positions=np.array([[0, 0, 0.1]]), sizes=0.01, group="front")
    plain = Scene(name="own", duration=0.1, bodies=(one,), walls=(FLOOR,))
    fill = dict(container=PipeContainer(STRAIGHT, 0.05, 0.3), sizes=Uniform(0.01, 0.02), templates=(SPHERE,))

    def changed(**changes):
        return lambda: replace(plain, **changes)

    stones = dict(aggregate_fraction=0.1, aggregate_smallest=0.02, aggregate_largest=0.02, spacing=0.005)
    mortar = scenes.slump(**stones, lift_time=0.0)
    part = scenes.part(**stones, diameter=0.1, unit="bend-level")
    drive, bonds = AxisDrive(group="front", axis=STRAIGHT, force=1.0), Bonds()
    cases = {
        "scene": changed(),
        "positions of words": lambda: Bodies(positions=[["a"]], sizes=0.01),
        "positions in a plane": lambda: Bodies(positions=np.zeros((2, 2)), sizes=0.01),
        "positions without end": lambda: Bodies(positions=np.full((1, 3), np.inf), sizes=0.01),
        "a size too many": lambda: Bodies(positions=np.zeros((2, 3)), sizes=(0.01, 0.01, 0.01)),
        "no size": lambda: Bodies(positions=np.zeros((2, 3)), sizes=(0.01, 0.0)),
        "seed below 0": changed(seed=-1),
        "seed of true": changed(seed=True),
        "half a seed": changed(seed=0.5),
        "precision": changed(precision="float16"),
        "two walls of one name": changed(walls=(FLOOR, FLOOR)),
        "pressure on no wall": changed(pressure=PressureProbe(wall="piston", area=0.01)),
        "two drives of one group": changed(drives=(drive, drive)),
        "drive": changed(drives=(drive,)),
        "drive of no group": changed(drives=(AxisDrive(group="back", axis=STRAIGHT, force=1.0),)),
        "bonds of no group": changed(group_bonds={"back": bonds}),
        "rest at no wall": changed(rest=Rest(at=0.1, duration=600.0, wall="piston")),
        "rest": changed(rest=Rest(at=0.1, duration=600.0, wall="floor"), bonds=bonds),
        "hydration without bonds": changed(hydration=Hydration(fraction=0.1)),
        "hydration": changed(hydration=Hydration(fraction=0.1), bonds=bonds),
        "segregation without a pipe": changed(segregation=True),
        "damping of all": changed(local_damping=0.995),
        "contacts of no material": lambda: build_model(
            replace(plain, contacts={("aggregate", "steel"): Contact()}), "cpu", "float64"
        ),
        "filling": lambda: Fill(**fill, solid_fraction=0.8),
        "filling beyond what fits": lambda: Fill(**fill, solid_fraction=0.81),
        "filling of nothing": lambda: Fill(**fill, solid_fraction=0.009),
        "filling to both": lambda: Fill(**fill, solid_fraction=0.5, pressure=1e3),
        "filling to neither": lambda: Fill(**fill),
        "filling without pressure": lambda: Fill(**fill, pressure=0.0),
        "filling without shapes": lambda: Fill(**fill | {"templates": ()}, solid_fraction=0.5),
        "filling without shares": lambda: Fill(**fill, solid_fraction=0.5, fractions=(0.0,)),
        "filling with a share too many": lambda: Fill(**fill, solid_fraction=0.5, fractions=(0.5, 0.5)),
        "filling of stones as thick as the pipe": lambda: Fill(
            **fill | {"sizes": Uniform(0.01, 0.1)}, solid_fraction=0.5
        ),
        "flow with aggregates in a plane": lambda: scenes.stretch(aggregate_largest=0.06, aggregate_smallest=0.055),
        "coarse flow with aggregates": lambda: scenes.stretch(spacing=0.02, length=0.3),
        "mortar with aggregates in a plane": lambda: replace(mortar, depth=0.0, round=False, sides={}, walls=()),
        "part without aggregates": lambda: replace(part, aggregate_fraction=0.0),
        "part with wide aggregates": lambda: replace(part, gravity=0.0, aggregate_diameters=(0.02, 0.07)),
        "part with narrow aggregates": lambda: replace(part, aggregate_diameters=(0.014, 0.02)),
    }
    compare("scenes", cases)


def test_kept_refusals_of_limits():
    cases = {}
    for name, limit in LIMITS.items():
        unit = "" if limit.unit == "1" else limit.unit
        ends = [limit.low, limit.high, *(limit.usual or ())]
        for value in sorted({factor * end for end in ends for factor in (1 - 1e-6, 1.0, 1 + 1e-6)}):
            cases[f"{name} {value:.9g}"] = lambda name=name, value=value, unit=unit: check_limit(name, value, unit)
    for velocity in (2.9, 3.1, 4.9, 5.1, 9.9, 10.1):
        cases[f"velocity {velocity}"] = lambda velocity=velocity: check_velocity("flow", 0.1, velocity)
    for power in (31, 32, 53, 54, 63, 64):
        cases[f"seed {power}"] = lambda power=power: check_whole("seed", 2**power - 1)
        cases[f"count {power}"] = lambda power=power: check_whole("strokes", 2**power - 1)
    compare("limits", cases)


def test_kept_refusals_of_entries(tmp_path):
    mix = dict(parts={"cement": "400 kg/m3", "water": "180 kg/m3", "sand": "800 kg/m3", "gravel": "950 kg/m3"},
               slump="200 mm")  # fmt: skip
    line = dict(diameter="125 mm", parts=[{"straight": "10 m"}])
    slump = dict(scene="slump", quantity="spread", value="500 mm", uncertainty="5%")
    targets = dict(vary={"yield_stress": [20, 150]}, targets=[slump])
    case = "{id: a, kind: slump, source: smith, measured: 200 mm}"

    def mixed(**changes):
        return lambda: mix_of(mix | changes, tmp_path)

    def sought(*more, **changes):
        return lambda: task_of(targets | {"targets": [slump | changes, *more]}, modules())

    def measured(*entries, head="sources: {smith: Smith 2020}"):
        path = tmp_path / "cases.yaml"

        def read():
            path.write_text("\n".join((head, "cases:", *(f"- {each}" for each in entries))), encoding="utf-8")
            return read_cases(path)

        return read

    def layer(flows, pressures):
        return lambda: measured_layer(CONCRETES["no1"], PipeLine(radius=0.0625, length=10.0), flows, pressures)

    cases = {
        "line of words": lambda: line_of("straight"),
        "line without diameter": lambda: line_of({"parts": line["parts"]}),
        "line without parts": lambda: line_of({"diameter": "125 mm", "parts": []}),
        "no folder of a line": lambda: check_known(tmp_path),
        "mix": mixed(),
        "layer of words": mixed(layer="thin"),
        "empty layer": mixed(layer={}),
        "pairs of three": mixed(layer={"points": [[1, 2, 3]], "diameter": "125 mm", "length": "10 m"}),
        "sieve of words": mixed(sieve="4: 0"),
        "sieve of one opening": mixed(sieve={4: 0}),
        "sieve of two kinds of shares": mixed(sieve={4: "0 %", 8: 1}),
        "sieve of per cent": mixed(sieve={4: 0, 8: 60, 16: 100}),
        "sieve with sand": mixed(sieve={0.99: 0, 8: 1}),
        "sieve of rocks": mixed(sieve={4: 0, 301: 1}),
        "sizes of three": mixed(sizes=["4 mm", "8 mm", "16 mm"]),
        "sizes of words": mixed(sizes={"4 mm": 1}),
        "size below twice the smallest": mixed(sizes="7.9 mm"),
        "size": mixed(sizes="8 mm"),
        "thickener of words": mixed(thickener="yes"),
        "denied thickener": mixed(parts=mix["parts"] | {"viscosity modifier": "1 kg/m3"}, thickener=False),
        "water and binder": mixed(water_binder=0.45),
        "other water and binder": mixed(water_binder=0.9),
        "little water": mixed(parts=mix["parts"] | {"water": "40 kg/m3", "gravel": "1300 kg/m3"}),
        "too full": mixed(parts=mix["parts"] | {"gravel": "1250 kg/m3"}, air="2 %"),
        "rather full": mixed(parts=mix["parts"] | {"gravel": "1080 kg/m3"}, air="2 %"),
        "two slumps": mixed(slump="40 mm", spread="650 mm"),
        "targets": sought(),
        "target of words": lambda: task_of(targets | {"targets": ["slump"]}, modules()),
        "target of words as value": sought(value=True),
        "target below 0": sought(value=-0.1),
        "range on no scale": lambda: task_of(
            targets | {"vary": {"yield_stress": {"low": 20, "high": 150, "scale": "square"}}}, modules()
        ),
        "range from 0 on a logarithmic scale": lambda: task_of(
            targets | {"vary": {"yield_stress": {"low": 0, "high": 150, "scale": "log"}}}, modules()
        ),
        "range on a linear scale": lambda: task_of(
            targets | {"vary": {"yield_stress": {"low": 0, "high": 150, "scale": "linear"}}}, modules()
        ),
        "no trials": lambda: calibrate(targets, out=tmp_path / "x", trials=3, device="cpu"),
        "no batch": lambda: calibrate(targets, out=tmp_path / "x", batch=0, device="cpu"),
        "repeats below 0": lambda: calibrate(targets, out=tmp_path / "x", repeat=-1, device="cpu"),
        "seeds and repeats": lambda: cases_of({}, {"seed": [1, 2]}, repeat=2),
        "seeds": lambda: cases_of({}, {"seed": [1, 2]}),
        "repeats without seed": lambda: cases_of({}, {"spacing": [0.1]}, repeat=2, seeded=False),
        "values that repeat": lambda: cases_of({}, {"spacing": [0.1, 0.1]}),
        "most repeats": lambda: cases_of({}, {}, repeat=MAX_CASES),
        "too many repeats": lambda: cases_of({}, {}, repeat=MAX_CASES + 1),
        "no repeat": lambda: cases_of({}, {}, repeat=0),
        "cases": measured(case),
        "no cases": measured(head="sources: {smith: Smith 2020}"),
        "cases of one name": measured(case, case),
        "case of words": measured("slump"),
        "case without source": measured("{id: a, kind: slump, measured: 200 mm}"),
        "case without value": measured(case.replace("200 mm", "0 mm")),
        "case of an unknown source": measured(case.replace("smith", "jones")),
        "layer of pressures": layer((0.005, 0.01), (3e5, 3.8e5)),
        "layer of one flow": layer((0.005, 0.005), (1.5e5, 2.5e5)),
        "layer of a pressure too many": layer((0.005, 0.01), (1.5e5, 2.5e5, 3e5)),
        "layer of no pressure": layer((0.005, 0.01), (1.5e5, np.nan)),
        "layer of falling pressures": layer((0.005, 0.01), (2.5e5, 1.5e5)),
    }
    compare("entries", cases, tmp_path)


def test_kept_refusals_of_numbers():
    """Numbers on both sides of the limits that functions of Python check, beside those that scenes declare."""
    mortar, line, inf = CONCRETES["no1"], PipeLine(radius=0.0625, length=10.0), np.inf
    one = Bodies(positions=np.array([[0, 0, 0.1]]), sizes=0.01)
    apart = Segregated(mortar, line, 0.4, 0.1)
    limits = {
        "restitution": (damping_ratio, (-1e-9, 0.0, 1.0, 1.001)),
        "poisson": (lambda x: HertzMindlin.of(1e9, x), (-1e-9, 0.0, 0.5, 0.501)),
        "stops": (lambda x: Stops(count=x, stroke_time=1.0, pause=0.0), (0, 1, True, 1.0, 1_000_000, 1_000_001)),
        "stroke time": (lambda x: Stops(count=1, stroke_time=x, pause=0.0), (0.0, 1e-9)),
        "pause": (lambda x: Stops(count=1, stroke_time=1.0, pause=x), (-1e-9, 0.0, inf)),
        "ramp": (lambda x: Prescribed(ramp_time=x), (-1e-9, 0.0, 2.0)),
        "start": (lambda x: Prescribed(start_time=x), (-1e-9, 0.0, 2.0)),
        "driving force": (lambda x: Driven(direction=(0, 0, 1), force=x, mass=1.0), (-1e9, np.nan)),
        "driven mass": (lambda x: Driven(direction=(0, 0, 1), force=1.0, mass=x), (0.0, 1e-9)),
        "driven damping": (lambda x: Driven(direction=(0, 0, 1), force=1.0, mass=1.0, damping=x), (-1e-9, 0.0)),
        "driven start": (lambda x: Driven(direction=(0, 0, 1), force=1.0, mass=1.0, start_time=x), (-1e-9, 0.0)),
        "direction": (lambda x: Driven(direction=(0, 0, x), force=1.0, mass=1.0), (0.0, 1e-9)),
        "angle": (lambda x: Arc(0.2, x, (0, 0, 1)), (0.0, 1e-6, np.pi, 3.15)),
        "facets": (lambda x: STRAIGHT.tube(0.05, x), (2, 3)),
        "shape": (clumps.elongated, (0.999, 1.0, 20.0, 20.001)),
        "drive": (lambda x: AxisDrive(group="", axis=STRAIGHT, force=x), (-1e9, inf)),
        "duration": (lambda x: Scene(name="own", duration=x, bodies=(one,)), (-1e-9, 0.0)),
        "interval": (lambda x: Scene(name="own", duration=1.0, bodies=(one,), sample_interval=x), (0.0, 1e-9)),
        "seeds": (lambda x: Elements(seeds=x), (0, 1, 100, 101)),
        "stiffer": (lambda x: Elements(stiffer=x), (0.99, 1, 1000, 1001)),
        "coarse": (lambda x: Elements(coarse=x), (0.99, 1, 20, 20.1)),
        "height": (lambda x: pipeline_pressure(2e4, 1e4, x, 2.0), (-1e-9, 0.0, 0.5)),
        "distance": (lambda x: pipeline_pressure(2e4, 1e4, 2.0, x), (-1e-9, 0.0, 0.5)),
        "line flow": (lambda x: check_settings(x, 1.0), (0.0, 1e-9)),
        "layer factor": (lambda x: check_settings(1.0, x), (0.999, 1.0)),
        "shape of stones": (read_shape, (0.99, 1, 1.5, 20, 20.1, True, "rounded", "round")),
        "fraction": (lambda x: thickening(x, 2.5, 0.6), (-1e-9, 0.0, 0.59, 0.6)),
        "stress": (lambda x: steady_of_stress(mortar, line, x), (-1e-9, 0.0)),
        "flow": (lambda x: steady(mortar, line, x), (-1e-9, 0.0)),
        "kaplan": (lambda x: kaplan(mortar, line, x), (-1e-9, 0.0)),
        "rest": (lambda x: after_rest(mortar, x, 0.1), (-1e-9, 0.0, 0.5)),
        "thixotropy": (lambda x: after_rest(mortar, 10.0, x), (-1e-9, 0.0, 0.5)),
        "rise": (lambda x: PipeLine(rise=x), (-1.001, -1, 1, 1.001)),
        "layer": (lambda x: PipeLine(radius=0.05, slip_thickness=x), (-1e-9, 0.0, 0.0499, 0.05)),
        "segregated stress": (apart.of_stress, (-1e-9, 0.0)),
        "segregated flow": (apart.steady, (-1e-9, 0.0)),
        "segregation": (lambda x: Segregated(mortar, line, 0.4, x), (-0.67, -0.66, 1.33, 1.34)),
        "aggregate": (lambda x: Segregated(mortar, line, x, 0.0), (0.0, 1e-9, 0.59, 0.6)),
        "grains": (lambda x: Grains(fraction=x, mortar=mortar), (0.0, 1e-9, 0.6, 0.61)),
        "roundness": (lambda x: Grains(fraction=0.1, mortar=mortar, roundness=x), (0.49, 0.5, 1.0, 1.01)),
        "grain": (lambda x: Grains(fraction=0.1, mortar=mortar, sizes=((x, 0.01, 1.0),)), (0.0, 0.01, 0.011)),
        "share": (lambda x: Grains(fraction=0.1, mortar=mortar, sizes=((0.01, 0.01, x),)), (-0.1, 0.0, 1.0, 1.1)),
    }
    cases = {
        f"{name} {value}": lambda make=make, value=value: make(value)
        for name, (make, values) in limits.items()
        for value in values
    }
    compare("numbers", cases)


def test_kept_refusals_of_meshes(tmp_path):
    """Parts whose bore is a mesh that leads up, through a bend, or to a narrower pipe."""
    up, elbow = Axis((0, 0, 0), (0, 0, 1), (Line(0.2),)), Axis((0, 0, 0), (1, 0, 0), (Arc(0.3, np.pi / 2, (0, 0, 1)),))
    files = {name: str(bent(tmp_path / f"{name}.stl", axis, 0.05, 24)) for name, axis in (("up", up), ("elbow", elbow))}
    files["narrow"] = str(tube(tmp_path / "narrow.stl", [0.05, 0.05, 0.04, 0.04], length=0.2))

    def made(file, **given):
        scene = scenes.part(unit="mesh", wall=files[file], **{"diameter": 0.1, **given})
        (end,), (way,) = scene.axis.at([scene.axis.length])
        return " ".join(f"{round(each, 2) + 0.0:g}" for each in (scene.axis.length, *end, *way, *scene.bores.radii))

    def pushed(**given):
        return scenes.part_dem(unit="mesh", wall=files["narrow"], wall_scale=1e-3, **given)

    cases = {
        "up": lambda: made("up"),
        "elbow": lambda: made("elbow"),
        "narrow": lambda: made("narrow", wall_scale=1e-3),
        "narrow of another scale": lambda: made("narrow"),
        "diameter": lambda: made("up", diameter=0.102),
        "outlet": lambda: made("up", outlet_diameter=0.09),
        "slip layer": lambda: made("up", slip_thickness=1e-3, slip_viscosity=900.0),
        "no mesh": lambda: scenes.part(unit="mesh"),
        "pushed with a diameter": lambda: pushed(diameter=0.102),
        "pushed with an outlet": lambda: pushed(diameter=0.1, outlet_diameter=0.08),
    }
    compare("meshes", cases, tmp_path)
