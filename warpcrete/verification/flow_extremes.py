"""Robustness of flows with extreme parameters.

Each flow must stay within bounds, be refused before it starts, or stop with an error message that gives the reason. The
basic flow is a column of concrete no. 1 of Xu, Li & Jiang 2021 in a channel or a tube, ten particles across. In some
scenes a single parameter is extreme, in other scenes several parameters are extreme at once.
"""

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ..core.errors import ConvergenceError, InstabilityError, SceneError
from ..core.records import SceneArguments
from ..mps.scene import Aggregates, FluidScene
from ..mps.simulation import FluidSimulation
from ..theory.pipe import CONCRETES, Concrete

FEW, STEPS, LONG = 10, 100, 2000
SAMPLES = 20
BALANCE, VOLUME, SPEED, CLOSEST = 0.2, 0.015, 4.0, 0.3
"""Bounds that an acceptable flow must keep, in the order of the names:

- largest unbalanced part of the piston's force, divided by the force, after the first tenth of the steps,
- largest relative change of the volume,
- largest speed, divided by the theoretical maximum,
- smallest distance of two particles, divided by their initial spacing.
"""
PAPER = CONCRETES["no1"]
ACROSS = 10


Case = tuple[str, Callable[[], FluidScene], int]


@dataclass(frozen=True)
class FlowOutcome:
    """Result of running one flow with extreme parameters."""

    name: str
    stopped: str
    """Message of the error that stopped the flow; empty if the flow was completed."""
    refused: bool
    """True if the scene was refused before the flow started."""
    balance: float
    volume: float
    speed: float
    closest: float
    steps: int
    expected_outcome: str = ""
    """Required result: `run` if the flow must run to its end, or a part of the message with which it must stop. An
    empty text accepts both."""

    @property
    def acceptable(self) -> bool:
        """Return whether the result is acceptable.

        A completed flow must keep the bounds :data:`BALANCE`, :data:`VOLUME`, :data:`SPEED` and :data:`CLOSEST`. The
        message of a stopped flow must name time, quantity and possible remedies, and the message of a refused scene
        must name the field. The result must also agree with `expected_outcome`.
        """
        if self.stopped:
            words = (" = ", ": ") if self.refused else ("t = ", "usual cure")
            return (
                self.expected_outcome != "run"
                and all(word in self.stopped for word in words)
                and self.expected_outcome in self.stopped
            )
        within = self.balance <= BALANCE and self.volume <= VOLUME and self.speed <= SPEED and self.closest >= CLOSEST
        return within and self.expected_outcome in ("", "run")


def column(
    dimensions: int = 2, *, diameter: float = 0.1, spacing: float | None = None, length: float | None = None,
    flow: float = 1.5e-3, time_step: float = 5e-4, gravity: float = 9.81, aggregates: float = 0.0, **concrete: float,
) -> FluidScene:  # fmt: skip
    """Return the scene of a column of concrete in a channel or, with `dimensions` = 3, in a tube.

    `aggregates` is the volume fraction of coarse aggregate. `concrete` holds constants that replace those of concrete
    no. 1 of Xu, Li & Jiang 2021. Lengths are in m, and `flow` in m3/s.
    """
    constants = {
        name: getattr(PAPER, name) for name in ("density", "viscosity", "yield_stress", "slip_viscosity", "slip_yield")
    }
    mixed = Concrete(name="own", **{**constants, **concrete})
    grains = Aggregates(fraction=aggregates, mortar=mixed, sizes=((2e-3, 5e-3, 1.0),)) if aggregates else None
    return FluidScene(
        name="column", concrete=mixed, dimensions=dimensions, radius=diameter / 2,
        spacing=spacing or diameter / ACROSS, length=length or (2.0 if dimensions == 2 else 1.2) * diameter,
        velocity=flow / (math.pi * (diameter / 2) ** 2), time_step=time_step, gravity=gravity, aggregates=grains,
        duration=1.0, sample_interval=time_step,
    )  # fmt: skip


def outcome(name: str, make: Callable[[], FluidScene], device: str, precision: str, steps: int = STEPS) -> FlowOutcome:
    """Run a flow for a number of steps, measure it and check for instability in between, and return the outcome.

    `make` returns the scene of the flow.
    """
    stopped, refused = "", False
    top = math.nan
    rows: list[dict[str, float]] = []
    closest, steps_taken = math.inf, 0
    try:
        simulation = FluidSimulation(make(), device=device, precision=precision, threads=1)
        top = simulation.top_speed
        simulation.prepare()
        for _ in range(SAMPLES):
            simulation.flow.take(max(steps // SAMPLES, 1))
            steps_taken = simulation.flow.steps
            rows.append(simulation.measure())
            simulation.watch_row(rows[-1])
        closest = _closest(simulation)
    except SceneError as error:
        stopped, refused = str(error), True
    except (InstabilityError, ConvergenceError) as error:
        stopped = str(error)
    late = rows[len(rows) // 10 :]
    largest = {
        key: max((abs(row[key]) for row in late), default=0.0)
        for key in ("force_balance_error", "volume_error", "fastest")
    }
    return FlowOutcome(
        name, stopped, refused, largest["force_balance_error"], largest["volume_error"], largest["fastest"] / top,
        closest, steps_taken, MUST.get(name, "" if name.startswith("corner") else "run"),
    )  # fmt: skip


def _closest(simulation: FluidSimulation) -> float:
    """Return the distance of the two nearest particles, divided by the initial particle spacing."""
    x = simulation.state.particles.position.numpy().astype(float)
    order = np.argsort(x[:, -1], kind="stable")
    x, reach = x[order], simulation.state.layout.spacing
    best = math.inf
    for shift in range(1, len(x)):
        apart = x[shift:, -1] - x[:-shift, -1]
        near = apart < min(best, reach)
        if not near.any():
            break
        best = min(best, float(np.linalg.norm(x[shift:][near] - x[:-shift][near], axis=1).min()))
    return best / reach


MUST: dict[str, str] = {
    f"{d}D: {name}": reason
    for d in (2, 3)
    for name, reason in (
        ("spacing of 2 across", "at least 4 are needed"),
        ("time step 0.1 s", "half a particle"),
        ("a column one spacing long", "must be at least 8 times"),
        ("aggregate 0.6", "does not fit"),
        ("no slip for 1 s", ""),
        ("a concrete that shears, for 1 s", ""),
    )
}
"""Flows that must be refused or must stop, by name, each with an excerpt from the expected error message. With an empty
excerpt, the flow may stop with any error, or run to its end."""
AXES: dict[str, tuple[float, float]] = {
    "viscosity": (0.1, 1e5),
    "yield_stress": (0.0, 1e4),
    "slip_viscosity": (1.0, 1e7),
    "slip_yield": (0.0, 1e4),
    "density": (500.0, 8000.0),
    "flow": (1e-6, 1e-1),
    "gravity": (0.0, 981.0),
}
"""Lowest and highest value of each parameter. The cases of the verification are scenes in which one parameter has an
extreme value, and scenes in which all parameters have extreme values (the corners of the parameter space)."""


def scenes() -> Iterator[Case]:
    """Yield name, scene and number of steps of every case.

    There are three kinds of cases: flows in which a single parameter has an extreme value, flows in which all
    parameters of `AXES` have extreme values, and special flows.
    """
    for d in (2, 3):
        yield from _singles(f"{d}D: ", d)
    for corner in itertools.product(*AXES.values()):
        label = ", ".join(f"{name} {value:g}" for name, value in zip(AXES, corner))
        values: SceneArguments = dict(zip(AXES, corner))
        # A scene is refused if its piston moves by more than half a particle spacing per step.
        step = min(5e-4, 0.3 * 0.01 * math.pi * 0.05**2 / values["flow"])
        yield f"corner: {label}", lambda values=values, step=step: column(2, time_step=step, **values), STEPS


def _singles(prefix: str, d: int) -> Iterator[Case]:
    def case(name: str, **changes: object) -> Case:
        return prefix + name, lambda: column(d, **changes), STEPS

    yield case("all parameters at their middle")
    for name, values in AXES.items():
        for value in values:
            step = {"time_step": 2e-5} if (name, value) == ("flow", 1e-1) else {}
            yield case(f"{name} {value:g}", **{name: value}, **step)
    yield case("spacing of 4 across", spacing=0.025, length=0.2)
    yield case("spacing of 20 across", spacing=0.005)
    yield case("spacing of 2 across", spacing=0.05)
    for step in (1e-6, 2e-3, 1e-2, 0.1):
        yield case(f"time step {step:g} s", time_step=step)
    for diameter in (0.01, 2.0):
        flow = 1.5e-3 * (diameter / 0.1) ** 2
        yield case(f"diameter {diameter:g} m", diameter=diameter, flow=flow, time_step=5e-4 * min(1.0, diameter / 0.1))
    yield case("a column eight spacings long", length=0.08)
    yield case("a column one spacing long", length=0.01)
    yield case("no slip, Newtonian", slip_viscosity=1e7, slip_yield=0.0, yield_stress=0.0, viscosity=20.0)
    shears = dict(viscosity=30.0, yield_stress=40.0, slip_viscosity=1000.0, slip_yield=20.0, density=2350.0)
    for name, changes in (
        ("no slip for 1 s", dict(slip_viscosity=1e6, slip_yield=0.0)),
        ("a concrete that shears, for 1 s", shears),
    ):
        yield prefix + name, lambda changes=changes: column(d, **changes), LONG
    yield case("slip only", slip_viscosity=1.0, slip_yield=0.0)
    if d == 2:
        tall = dict(diameter=2.0, spacing=0.25, length=1000.0, flow=1.5e-3 * 400)
        yield prefix + "a column of 1 km", lambda: column(d, **tall), FEW
        for fraction in (0.05, 0.35, 0.6):
            yield case(f"aggregate {fraction:g}", spacing=1e-3, diameter=0.04, length=0.06, flow=2e-4,
                       time_step=2e-4, aggregates=fraction)  # fmt: skip


def matrix(device: str, precision: str) -> list[FlowOutcome]:
    """Run all flows with extreme parameters and return the results."""
    return [outcome(name, make, device, precision, steps) for name, make, steps in scenes()]


def table(outcomes: list[FlowOutcome]) -> str:
    """Return a Markdown table of the results of all flows.

    Flows in which every parameter is extreme (corners of the parameter space) are numerous. Their results are therefore
    summarised, with one line for each kind of result.
    """
    lines = ["| flow | unbalanced | volume | fastest over theory | nearest | outcome |", "|---|---|---|---|---|---|"]
    corners = [o for o in outcomes if o.name.startswith("corner")]
    for o in outcomes:
        if o not in corners:
            verb = "refused" if o.refused else "stopped"
            end = f"{verb}: {o.stopped}" if o.stopped else f"within bounds after {o.steps} steps"
            figures = f"{o.balance:.2g} | {o.volume:.1g} | {o.speed:.2f} | {o.closest:.2f}"
            lines.append(f"| {o.name} | {'- | - | - | -' if o.stopped else figures} | {end} |")
    ended = [o for o in corners if not o.stopped]
    if ended:
        figures = " | ".join((
            f"up to {max(o.balance for o in ended):.2g}", f"up to {max(o.volume for o in ended):.1g}",
            f"up to {max(o.speed for o in ended):.2f}", f"{min(o.closest for o in ended):.2f} or more",
        ))  # fmt: skip
        which = f"{len(ended)} of {len(corners)} corners of {', '.join(AXES)}"
        lines.append(f"| {which} | {figures} | within bounds |")
    cut = [o for o in corners if o.stopped]
    for reason in ("did not converge", "fastest", "forces do not balance", "left the vessel", "pressure", ""):
        these = [o for o in cut if reason in o.stopped]
        cut = [o for o in cut if o not in these]
        if these:
            example = f"for example {these[0].name[8:]}"
            lines.append(f"| {len(these)} corners, {example} | | | | | stopped: {these[0].stopped} |")
    return "\n".join(lines) + "\n"
