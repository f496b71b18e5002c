"""Robustness of discrete element scenes with extreme parameters.

Each scene must either stay within bounds or stop with an error message that gives the reason. The basic scene is a cup
with spheres of two sizes. Its floor is a piston that moves upwards at full speed from the start, and a loaded plate
lies on top of the spheres.
"""

import itertools
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..core.errors import InstabilityError
from ..dem.laws import Contact, damping_ratio
from ..dem.measure.quantities import free_energy
from ..dem.scene.scene import Bodies, Bonds, Hydration, Scene, TimeStep
from ..dem.simulation import ElementSimulation
from ..geometry.axis import Axis, Line
from ..geometry.walls import Driven, PipeWall, PlaneWall, Prescribed

STEPS = 2000
# Limit for the energy that a run gains without work being done, divided by the energy scale of the instability check. A
# run that gains more is not acceptable.
ENERGY = 0.1
RADIUS = 0.03


@dataclass(frozen=True)
class Outcome:
    """Result of running one scene with extreme parameters."""

    name: str
    stopped: str
    """Message of the error that stopped the run; empty if the run was completed."""
    deepest: float
    """Largest overlap, divided by the overlap at which a sphere lies completely inside the sphere or wall that it
    touches."""
    growth: float
    """Largest energy that the run gained without work being done, divided by the energy scale of the instability
    check."""
    steps: int
    expected_outcome: str = ""
    """Required result of the run: "run" if it must be completed, otherwise a regular expression that the message of the
    error must match. An empty text accepts a completed and a stopped run."""

    @property
    def acceptable(self) -> bool:
        """Return whether the result is acceptable.

        In a completed run, `deepest` must be at most 1, and `growth` at most `ENERGY`. The message of a stopped run
        must name time, body, quantity and possible remedies. The result must also agree with `expected_outcome`.
        """
        if self.stopped:
            named = all(word in self.stopped for word in ("t = ", "body ", "usual cures: "))
            return named and bool(re.search(self.expected_outcome, self.stopped.split("usual cures")[0]))
        return self.deepest <= 1.0 and self.growth <= ENERGY and self.expected_outcome in ("", "run")


def cup(*, modulus=1e6, ratio=2.0, density=2500.0, velocity=0.3, gravity=9.81, restitution=0.5, friction=0.3,
        load=1e3, dt_fraction=0.8, bonds: Bonds | None = None, hydration: Hydration | None = None, count=80,
        origin=(0.0, 0.0, 0.0), **changes) -> Scene:  # fmt: skip
    """Return the scene of a cup that holds `count` spheres of two sizes under a loaded plate.

    The floor of the cup moves upwards at `velocity` [m/s]. `modulus` [Pa], `friction` and `restitution` belong to the
    contact law. `ratio` is the size of the large spheres divided by that of the small spheres, and `load` is the
    pressure of the plate [Pa]. The time step is `dt_fraction` times the estimated stable step. `changes` replace
    arguments of the scene.
    """
    random = np.random.default_rng(0)
    large = 0.012
    layer = 1.04 * large
    line = (np.arange(3) - 1) * layer
    points = np.array([(x, y, (k + 0.55) * layer) for k in range(-(-count // 9)) for x in line for y in line]).reshape(
        -1, 3
    )[:count]
    points = points + random.normal(scale=1e-2 * layer, size=points.shape)
    sizes = np.where(np.arange(count) % 2 == 0, large, large / ratio)
    top = float(points[:, 2].max(initial=0.0)) + 0.55 * layer
    area = math.pi * RADIUS**2
    shift = np.array(origin)
    settings = dict(
        name="cup",
        duration=1.0,
        gravity=(0.0, 0.0, -gravity),
        contact=Contact(effective_modulus=modulus, friction=friction, normal_damping_ratio=damping_ratio(restitution)),
        bonds=bonds,
        hydration=hydration,
        bodies=(Bodies(positions=points + shift, sizes=sizes, density=density),),
        walls=(
            PlaneWall(name="piston", point=tuple(shift), normal=(0, 0, 1),
                      motion=Prescribed(velocity=(0, 0, velocity))),
            PlaneWall(name="plate", point=tuple(shift + [0, 0, top]), normal=(0, 0, -1),
                      motion=Driven(direction=(0, 0, -1), force=load * area, mass=max(density, 100.0) * area * 0.02)),
            PipeWall(name="pipe", axis=Axis(tuple(shift - [0, 0, 1.0]), (0, 0, 1), (Line(4.0),)), radius=RADIUS),
        ),
        time_step=TimeStep(safety=dt_fraction),
    )  # fmt: skip
    return Scene(**(settings | changes))


def outcome(name: str, scene: Scene, device: str, precision: str, steps: int = STEPS) -> Outcome:
    """Run a scene for a number of steps, check for instability twenty times on the way, and return the outcome."""
    simulation = ElementSimulation(scene, device=device, precision=precision)
    stopped = ""
    try:
        simulation.prepare()
        simulation.watch(simulation.sampler.sample())
        for _ in range(20):
            if scene.bodies and len(scene.bodies[0].positions):
                simulation.stepper.take(steps // 20)
            simulation.watch(simulation.sampler.sample())
    except InstabilityError as error:
        stopped = str(error)
    rows = simulation.rows if hasattr(simulation, "sampler") else []
    deepest = growth = 0.0
    if rows:
        series = simulation.sampler.series()
        free = free_energy(series)
        growth = float(np.max(free - np.minimum.accumulate(free)) / max(simulation.watch.scale, 1e-300))
        deepest = float(np.max(series["deepest_overlap"]))
    steps_taken = simulation.stepper.steps if hasattr(simulation, "stepper") else 0
    return Outcome(name, stopped, deepest, growth, steps_taken, expected_outcome(name, precision))


# Scenes that must stop with an error, each with a pattern for the error message. If the pattern begins with `float32:`,
# the scene must stop only in single precision.
MUST_STOP = {
    "time step 3 of the estimate": "speed|energy|radius",
    "modulus 10000": "overlap",
    "two coincident centres": "overlap",
    "all bodies in one spot": "overlap",
    "100 kPa on 1e5 Pa": "overlap|radius",
    "1 km from the origin": "float32:rounded",
}
EITHER = ("friction 10", "time step 2 of the estimate")


def expected_outcome(name: str, precision: str) -> str:
    """Return the result that the run of the extreme scene `name` must have in the precision `precision`.

    The result "run" means that the run must be completed. Any other text is a regular expression: the run must stop,
    and its error message must match the expression. An empty text means that either outcome is acceptable.
    """
    if name.startswith("corner") or name in EITHER:
        return ""
    only, _, reason = MUST_STOP.get(name, "run").rpartition(":")
    return reason if only in ("", precision) else "run"


AXES: dict[str, tuple[float, float]] = {
    "modulus": (1e4, 1e9),
    "ratio": (1.0, 50.0),
    "density": (1.0, 1e4),
    "velocity": (0.0, 10.0),
    "gravity": (0.0, 981.0),
    "restitution": (0.0, 1.0),
    "friction": (0.0, 10.0),
}


def scenes(large: bool = False) -> Iterator[tuple[str, Callable[[], Scene], int]]:
    """Yield name, scene and number of steps of every case.

    There are three kinds of cases: scenes in which a single parameter has an extreme value, scenes in which every
    parameter of `AXES` has its lowest or highest value, and special scenes. `large` adds a scene of a million spheres.
    """
    yield "all parameters at their middle", cup, STEPS
    for fraction in (0.01, 0.1, 0.5, 1.0, 1.2, 1.5, 2.0, 3.0):
        yield f"time step {fraction:g} of the estimate", lambda fraction=fraction: cup(dt_fraction=fraction), STEPS
    for name, values in AXES.items():
        for value in values:
            yield f"{name} {value:g}", lambda name=name, value=value: cup(**{name: value}), STEPS
    for corner in itertools.product(*AXES.values()):
        label = ", ".join(f"{name} {value:g}" for name, value in zip(AXES, corner))
        yield f"corner: {label}", lambda corner=corner: cup(**dict(zip(AXES, corner))), 600
    soft = Bonds(effective_modulus=2e4, gap=2e-3)
    stiff = Hydration(fraction=0.2, bonds=Bonds(effective_modulus=1e9, tensile_strength=1e6, cohesion=5e5))
    yield "bonds of 2e4 Pa beside bonds of 1e9 Pa", lambda: cup(modulus=1e5, bonds=soft, hydration=stiff), STEPS
    yield "one sphere", lambda: cup(count=1), STEPS
    yield "no body", lambda: cup(count=0), STEPS
    yield "two coincident centres", lambda: _moved(cup(), 1), STEPS
    yield "all bodies in one spot", lambda: _moved(cup(), 80), STEPS
    yield "one file of spheres in a pipe 0.5 % wider", _blocked, STEPS
    yield "100 kPa on 1e5 Pa", lambda: cup(modulus=1e5, load=1e5), 20 * STEPS
    yield "1 km from the origin", lambda: cup(origin=(1000.0, 0.0, 0.0)), STEPS
    yield "10 m from the origin", lambda: cup(origin=(10.0, 0.0, 0.0)), STEPS
    if large:
        yield "a million spheres", _million, 20


def _moved(scene: Scene, count: int) -> Scene:
    """Return the scene with its first `count` bodies all moved to the position of the next body."""
    bodies = scene.bodies[0]
    places = bodies.positions.copy()
    places[:count] = places[min(count, len(places) - 1)]
    return replace(scene, bodies=(replace(bodies, positions=places),))


def _blocked() -> Scene:
    """Return a scene of ten spheres in single file between piston and plate, in a pipe hardly wider than they are."""
    size = 2 * RADIUS / 1.005
    z = (np.arange(10) + 0.5) * size
    base = cup()
    top = PlaneWall(name="plate", point=(0, 0, 10 * size), normal=(0, 0, -1), motion=base.walls[1].motion)
    return replace(
        base,
        bodies=(Bodies(positions=np.stack([0 * z, 0 * z, z], 1), sizes=size),),
        walls=(base.walls[0], top, base.walls[2]),
    )


def _million() -> Scene:
    count = 100
    line = np.arange(count) * 0.0105
    points = np.stack(np.meshgrid(line, line, line, indexing="ij"), -1).reshape(-1, 3)
    points += np.random.default_rng(0).normal(scale=3e-4, size=points.shape)
    points -= points.min(0) - 0.005
    floor = PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1))
    return Scene(name="million", duration=1.0, bodies=(Bodies(positions=points, sizes=0.01),), walls=(floor,))


def matrix(device: str, precision: str, *, large: bool = False) -> list[Outcome]:
    """Run all scenes with extreme parameters and return the results; `large` adds a scene of a million spheres."""
    return [outcome(name, make(), device, precision, steps) for name, make, steps in scenes(large)]


def table(outcomes: list[Outcome]) -> str:
    """Return a Markdown table of the results of all scenes.

    Scenes in which every parameter is extreme (corners of the parameter space) are numerous. Their results are
    therefore summarised, with one line for each kind of result.
    """
    lines = ["| scene | deepest overlap | unexplained energy | outcome |", "|---|---|---|---|"]
    corners = [o for o in outcomes if o.name.startswith("corner")]
    for o in outcomes:
        if o not in corners:
            end = f"stopped: {o.stopped}" if o.stopped else f"within bounds after {o.steps} steps"
            lines.append(f"| {o.name} | {o.deepest:.2f} | {o.growth:.1e} | {end} |")
    ended = [o for o in corners if not o.stopped]
    cut = [o for o in corners if o.stopped]
    if corners:
        lines.append(
            f"| {len(ended)} of {len(corners)} corners of {', '.join(AXES)} "
            f"| up to {max(o.deepest for o in ended):.2f} | up to {max(o.growth for o in ended):.1e} | within bounds |"
        )
    for reason in ("overlap", "energy", "speed", "rounded", "not a finite"):
        these = [o for o in cut if reason in o.stopped.split("usual cures")[0]]
        cut = [o for o in cut if o not in these]
        if these:
            lines.append(f"| {len(these)} corners, for example {these[0].name[8:]} | | | stopped: {these[0].stopped} |")
    return "\n".join(lines) + "\n"
