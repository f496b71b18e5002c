"""Rows of the verification of flows, suspensions and many bodies, kept (see `kept`).

Its cases take minutes, so the thorough tests run them. Here the same functions get coarse grids, few steps, or runs
that are made up.
"""

from dataclasses import replace
from types import SimpleNamespace

import kept
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from warpcrete.core.errors import SceneError
from warpcrete.dem.scene.bodies import placed_bodies
from warpcrete.mps.common.mixes import CONCRETE_CONSTANTS
from warpcrete.verification import (
    Case,
    Row,
    assemblies,
    contacts,
    extremes,
    flow_extremes,
    spreading,
    stability,
    starting,
    suspensions,
    suspensions_gaps,
    suspensions_many,
    vessels,
)
from warpcrete.verification.figure import draw

SOLVED = 1e-4
"""Tolerance of numbers that iterative solves leave, relative to the largest number of a line."""


@pytest.fixture
def few_steps(monkeypatch):
    """Flows on grids take at most two steps at a time."""
    for kind in (vessels.GridFlow, suspensions.GridFlow, suspensions.SuspensionFlow):
        if "take" in vars(kind) or kind is vessels.GridFlow:
            take = kind.take
            monkeypatch.setattr(kind, "take", lambda self, steps, take=take: take(self, min(steps, 2)))


def test_flows_between_walls_that_cut_cells_are_kept(monkeypatch, few_steps):
    cylinders, pipe = vessels.between_cylinders, vessels.round_pipe
    asked = []

    def coarse(device, precision, cells, *more):
        asked.append((cells, *more))
        return (cylinders if more == () or isinstance(more[0], tuple) else pipe)(device, precision, cells // 2, *more)

    monkeypatch.setattr(vessels, "between_cylinders", coarse)
    monkeypatch.setattr(vessels, "round_pipe", coarse)
    rows = [*vessels.cylinders("cpu", "float64"), *vessels.cylinders_with_layers("cpu", "float64")]
    rows += vessels.pipe_in_space("cpu", "float64")
    gradients = [vessels.pipe_gradient(each) for each in (0.0, 76.0, 760.0)]
    kept.compare("verified-cylinders", {"rows": rows, "asked": asked, "gradients": gradients}, SOLVED)


def test_a_tilted_vessel_is_kept(monkeypatch):
    tilted = vessels.tilted_vessel
    monkeypatch.setattr(vessels, "tilted_vessel", lambda **given: tilted(duration=0.02, spacing=0.02, **given))
    kept.compare("verified-vessel", {"rows": vessels.rest("cpu", "float64"), "scene": tilted(depth=0.05)}, SOLVED)


def test_single_spheres_in_mortar_are_kept(monkeypatch, few_steps):
    found = {
        "settling": suspensions.settling(3, 0.25, 0.4, "cpu", "float64"),
        "sheared": suspensions.sheared(3, 8, (0.25, 0.1, 0.3), "cpu", "float64"),
        "approaching": suspensions_gaps.approaching(3, 0.5, (0.3, 0.2, 0.1), "cpu", "float64"),
        "falling": suspensions.falling_in_bingham(0.13, 1e4, "cpu", "float64"),
        "particles": suspensions.mortar_state((4, 4, 4), 0.01, "cpu", "float64").particle_spacing,
        "wall": suspensions_gaps.approaching_wall(3, 0.5, (0.3, 0.2, 0.1), "cpu", "float64"),
        "resistance": [suspensions_gaps.approach_resistance(gap) for gap in (0.05, 0.5, 3.0)],
        "wall resistance": [suspensions_gaps.wall_resistance(gap) for gap in (0.05, 0.5, 3.0)],
    }
    asked = []

    def made_up(name, count):
        def function(*given):
            asked.append((name, *given))
            values = tuple(len(asked) + 0.1 * k for k in range(count))
            return values if count > 1 else values[0]

        monkeypatch.setattr(suspensions if hasattr(suspensions, name) else suspensions_gaps, name, function)

    counts = {"settling": 1, "sheared": 2, "approaching": 1, "approaching_wall": 1, "falling_in_bingham": 1}
    for name, count in counts.items():
        made_up(name, count)
    cases = [*suspensions.CASES, *suspensions_gaps.CASES]
    rows = [row for case in cases for row in case.run("cpu", "float64")]
    kept.compare("verified-spheres", {**found, "rows": rows, "asked": asked}, SOLVED)


def test_suspensions_of_many_spheres_are_kept(monkeypatch, few_steps):
    suspension, asked = suspensions_many.suspension, []

    def small(fraction, seed, device, precision, **given):
        asked.append({"fraction": fraction, "seed": seed, **given})
        return suspension(fraction, seed, device, precision, **given | {"across": 3, "wide": 3, "long": 3})

    monkeypatch.setattr(suspensions_many, "suspension", small)
    monkeypatch.setattr(suspensions_many, "SEEDS", 1)
    rows = [row for case in suspensions_many.CASES[1:] for row in case.run("cpu", "float64")]
    viscosities = [suspensions_many.high_frequency_viscosity(fraction) for fraction in (0.1, 0.4)]
    kept.compare("verified-suspensions", {"rows": rows, "asked": asked, "curve": viscosities}, 1e-3)


def test_power_and_momentum_of_a_suspension_are_balanced(monkeypatch):
    """Moving walls, weight, contacts and yield stress; also keep each term."""
    suspension, balance, steps = suspensions_many.suspension, suspensions_many.step_with_balance, []

    def small(*given, **settings):
        return suspension(*given, **settings | {"across": 3, "wide": 3, "long": 3})

    def noted(flow):
        steps.append(balance(flow))
        return steps[-1]

    monkeypatch.setattr(suspensions_many, "suspension", small)
    monkeypatch.setattr(suspensions_many, "step_with_balance", noted)
    rows = suspensions_many.balance_case("cpu", "float64")
    assert all(row.passed for row in rows), rows
    kept.compare("verified-balance", {"steps": steps}, 1e-3)


def made_run(scene, recorders):
    """A run of a scene that is made up: its series rise, and its bodies form a column."""
    rng = np.random.default_rng(4)
    time = np.linspace(0, scene.duration, 21)
    series = {
        name: value * (1 + 0.2 * time)
        for name, value in {
            "time": 1.0, "broken_tension": 40.0, "broken_shear": 30.0, "floor_force_z": -1.3, "pipe_force_z": -0.7,
        }.items()
    } | {"time": time}  # fmt: skip
    for recorder in recorders:
        recorder.loads = (2.0 + time).tolist()
    count = 90
    bodies = SimpleNamespace(
        position=rng.uniform([-0.02, -0.02, 0], [0.02, 0.02, 0.13], (count, 3)) * (scene.contact.friction + 1),
        mass=np.full(count, 2e-3), volume=np.full(count, 8e-7),
    )  # fmt: skip
    safety = scene.time_step.safety
    result = {"energy_balance_error": -1e-4 * safety, "momentum_balance_error": 1e-8 * safety, "steps": 100}
    return SimpleNamespace(series=series, result=result, bodies=bodies)


def test_verification_with_many_bodies_is_kept(monkeypatch):
    scenes = []

    def simulation(scene, *, device, precision, recorders=()):
        assert (device, precision) == ("cpu", "float64")
        scenes.append(scene)
        return SimpleNamespace(run=lambda: made_run(scene, recorders))

    monkeypatch.setattr(assemblies, "ElementSimulation", simulation)
    rows = [row for case in assemblies.CASES[1:] for row in case.run("cpu", "float64")]
    gauge = assemblies._WallGauge(0.03)
    position = np.array([[0.027, 0, 0.1, 4e-3], [0, 0.02, 0, 5e-3], [0, -0.026, 0.2, 6e-3]])
    known = SimpleNamespace(
        state=SimpleNamespace(spheres=SimpleNamespace(position=SimpleNamespace(numpy=lambda: position))),
        scene=scenes[-1],
    )
    monkeypatch.setattr(assemblies, "ElementSimulation", SimpleNamespace)
    gauge.sample(known, {})
    kept.compare(
        "verified-assemblies",
        {"rows": rows, "scenes": scenes, "gauge": gauge.loads, "curves": dict(assemblies.REPOSE.curves)},
    )


def test_the_momenta_of_a_cloud_are_compared(monkeypatch):
    """After the collisions, which are made up, all speeds have fallen to a third, and one body is faster by 1 %."""
    scenes = []

    def begun(scene, device, precision):
        scenes.append(scene)
        table = placed_bodies(scene)
        order = np.random.default_rng(1).permutation(len(table))
        arrays = {
            "id": order, "mass": 1e-3 * (1 + table.template), "position": table.position, "velocity": table.velocity,
            "angular_momentum": 1e-8 * table.spin,
        }  # fmt: skip
        arrays = {name: values[np.argsort(order)] if name == "id" else values for name, values in arrays.items()}

        def advance(until):
            assert until == 0.05
            arrays["velocity"] = arrays["velocity"] / 3
            arrays["velocity"][7] *= 1.01
            arrays["angular_momentum"] = arrays["angular_momentum"] / 2

        bodies = SimpleNamespace(
            **{name: SimpleNamespace(numpy=lambda name=name: arrays[name]) for name in arrays if name != "id"},
            id=SimpleNamespace(numpy=lambda: arrays["id"]),
        )
        return SimpleNamespace(state=SimpleNamespace(bodies=bodies), advance=advance)

    monkeypatch.setattr(assemblies, "start", begun)
    rows = {precision: assemblies.cloud("cpu", precision) for precision in ("float32", "float64")}
    kept.compare("verified-cloud", {"rows": rows, "scenes": scenes[:1]})


def test_spreading_is_kept(monkeypatch):
    asked = []

    def simulation(scene, *, device, precision):
        assert (device, precision) == ("cpu", "float64")
        asked.append(scene)
        time = np.linspace(0, scene.duration, 21)
        series = {"time": time, "spread": 0.2 + 0.1 * np.sqrt(time), "top": 0.05 / (1 + time)}
        run = SimpleNamespace(series=series, result={"volume_error": 2e-3})
        return SimpleNamespace(run=lambda: run, scene=scene, flow="flow")

    across = np.linspace(0.0025, 0.4, 60)
    monkeypatch.setattr(spreading, "FreeSimulation", simulation)
    monkeypatch.setattr(spreading, "surface", lambda flow: (across, 0.04 * np.sqrt(np.maximum(0.3 - across, 0))))
    rows = [row for case in spreading.CASES for row in case.run("cpu", "float64")]
    kept.compare("verified-spreading", {"rows": rows, "scenes": asked, "shorter": replace(asked[0], duration=1.0)})


def numbers_of(scene):
    """Return the numbers of a scene in which extreme scenes differ."""
    bodies = scene.bodies[0]
    return {
        "bodies": [bodies.positions, bodies.sizes, bodies.density], "gravity": scene.gravity, "bonds": scene.bonds,
        "step": scene.time_step.safety, "hydration": scene.hydration, "contact": scene.contact,
        "walls": [[wall.name, getattr(wall, "point", None), wall.motion] for wall in scene.walls],
    }  # fmt: skip


def test_extreme_scenes_are_kept():
    """Names, numbers of steps and outcomes of all scenes, and those scenes that differ by more than a number."""
    cases = list(extremes.scenes())
    listed = [
        [name, steps, *(extremes.expected_outcome(name, each) for each in ("float32", "float64"))]
        for name, _, steps in cases
        if not name.startswith("corner") or name == cases[40][0]
    ]
    chosen = (
        "all parameters at their middle", "bonds of 2e4 Pa beside bonds of 1e9 Pa", "two coincident centres",
        "all bodies in one spot", "one file of spheres in a pipe 0.5 % wider", "1 km from the origin", cases[40][0],
    )  # fmt: skip
    made = {name: numbers_of(make()) for name, make, _ in cases if name in chosen}
    assert len(made) == len(chosen)
    flows = []
    for name, make, steps in flow_extremes.scenes():
        if not name.startswith("corner") or name.endswith("flow 0.1, gravity 981"):
            try:
                scene = make()
                own = [getattr(scene.concrete, each) for each in CONCRETE_CONSTANTS]
                more = scene.time_step, scene.spacing, scene.length, scene.velocity, scene.gravity
                flows.append([name, steps, [*more, *own]])
            except SceneError as error:
                flows.append([name, str(error)])
    kept.compare("verified-extremes", {"listed": listed, "made": made, "flows": flows[:45] + flows[-3:]})


@pytest.mark.parametrize("module", [extremes, flow_extremes])
def test_outcomes_of_extreme_scenes_are_judged_and_told(module):
    """A bound that is exceeded, an error that does not say enough, and an outcome that was not expected, are wrong."""
    if module is extremes:
        within = module.Outcome("a", "", 1.0, module.ENERGY, 100, "run")
        wrong = [replace(within, deepest=1.01), replace(within, growth=0.11), replace(within, expected_outcome="speed")]
        stopped = replace(
            within, stopped="t = 1 s, body 3: speed; usual cures: a smaller step", expected_outcome="spe+"
        )
        words = ("t = ", "body ", "usual cures: ", "speed")
        corners = [
            replace(within, name="corner: 1"), replace(within, name="corner: 2", deepest=0.5, growth=0.0),
            *(replace(stopped, name=f"corner: {k}", stopped=f"{why}; usual cures: speed")
              for k, why in enumerate(("overlap", "energy of body", "overlap", "not a finite number"))),
        ]  # fmt: skip
    else:
        within = module.FlowOutcome("a", "", False, 0.2, 0.015, 4.0, 0.3, 100, "run")
        wrong = [
            replace(within, balance=0.21), replace(within, volume=0.016), replace(within, speed=4.1),
            replace(within, closest=0.29), replace(within, expected_outcome="did not"),
        ]  # fmt: skip
        stopped = replace(within, stopped="t = 1 s: pressure; usual cure: a smaller step", expected_outcome="pressure")
        words = ("t = ", "usual cure", "pressure")
        refused = replace(stopped, stopped="pressure = 1: wrong", refused=True)
        assert refused.acceptable and not replace(refused, stopped="pressure is wrong").acceptable
        wrong.append(replace(stopped, expected_outcome="run"))
        corners = [
            replace(within, name="corner: 1"), replace(within, name="corner: 2", closest=0.9, balance=0.0, speed=1.0),
            *(replace(stopped, name=f"corner: {k}", stopped=why)
              for k, why in enumerate(("did not converge", "fastest", "did not converge", "left the vessel", "other"))),
            replace(refused, name="b"),
        ]  # fmt: skip
    assert within.acceptable and stopped.acceptable and replace(within, expected_outcome="").acceptable
    assert not any(each.acceptable for each in wrong)
    for word in words:
        assert not replace(stopped, stopped=stopped.stopped.replace(word, "")).acceptable
    kept.compare(f"verified-outcomes-{module.__name__.rpartition('.')[2]}", module.table([within, stopped, *corners]))


def test_the_figure_of_the_verification_is_kept():
    """All curves are made up, and one row fails."""
    x = np.linspace(1, 70, 8)
    curves = {
        "oblique impact": {"angle": x, "tangential": x / 100, "spin": -10 * x},
        "oblique impact, normalised": {name: [x / 6, x / 7, x / 8, x / 9] for name in ("speed", "angle")},
        "stability limit": {
            "linear": np.geomspace(1, 1e9, len(stability.FRACTIONS)),
            "lubrication layer, spheres": [np.inf] * 15,
        },
    }
    results = []
    for name, own in curves.items():
        case = Case(name, "source", lambda device, precision: [], "group")
        case.curves.update({label: np.array(each) for label, each in own.items()})
        rows = [Row("a", 1.001, 1.0, 0.01), Row("b", 1.1, 1.0, 0.01), Row("c", 1.0, 1.0, 0.0), Row("d", 2.0, 2.0, 0.1)]
        results.append((case, rows))
    whole = draw(results)
    FigureCanvasAgg(whole).draw()
    for axes in whole.axes:
        for text in (axes.title, axes.xaxis.label):
            ends = text.get_window_extent()
            assert ends.x0 >= 0 and ends.x1 <= whole.bbox.width, text
    kept.compare("verified-figure", {"all": kept.drawn(whole), "one": kept.drawn(draw(results[:1]))})


def test_starts_from_rest_are_kept(monkeypatch):
    asked = []
    monkeypatch.setattr(starting, "worst", lambda *given: asked.append(given) or (1e-3 * len(asked), 2e-3 * len(asked)))
    rows = [row for case in starting.CASES for row in case.run("cpu", "float32")]
    kept.compare("verified-starts", {"rows": rows, "asked": asked})


@pytest.mark.parametrize("dimensions", [2, 3])
def test_the_nearest_particles_are_found_whatever_their_order(dimensions):
    x = np.random.default_rng(dimensions).uniform(0, 1, (60, dimensions))
    particles = SimpleNamespace(position=SimpleNamespace(numpy=lambda: x))
    state = SimpleNamespace(particles=particles, layout=SimpleNamespace(spacing=0.25))
    apart = np.linalg.norm(x[:, None] - x[None], axis=2)[np.triu_indices(60, 1)]
    assert flow_extremes._closest(SimpleNamespace(state=state)) == pytest.approx(apart.min() / 0.25, rel=1e-12)


def test_a_spin_in_the_wrong_direction_is_not_taken_for_the_right_one():
    """The cases of rolling compare the velocity along x and the spin about y with theory, both with their signs."""
    arrays = {"velocity": [[-1.5, 2.0, 3.0]], "spin": [[4.0, -5.0, 6.0]]}
    bodies = SimpleNamespace(**{k: SimpleNamespace(numpy=lambda v=v: np.array(v)) for k, v in arrays.items()})
    assert contacts._speed_and_spin(SimpleNamespace(state=SimpleNamespace(bodies=bodies))) == (-1.5, -5.0)
