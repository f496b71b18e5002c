"""Result quantities of mortar with aggregates in a stretch of pipe."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ...core.run.method import Quantity
from ...core.run.run import Run
from ...core.units import number
from ..quantities import aggregate_lines
from .scene import StretchScene

LATE = 0.5
"""Fraction of the simulated time, counted back from its end, over which velocities are averaged."""


@dataclass(frozen=True)
class RunData:
    """Scene and series, with two rows or more, from which the quantities of a run are computed."""

    scene: StretchScene
    series: dict[str, np.ndarray]
    fraction: float
    """Volume fraction of the placed aggregates. It differs from the scene's fraction, because only whole aggregates are
    placed."""

    def mean(self, name: str) -> float | None:
        """Return the mean of a column over the last half of the run, or None if there is no such column."""
        if name not in self.series:
            return None
        time = self.series["time"]
        late = (time > 0) & (time >= (1 - LATE) * time[-1])
        return float(self.series[name][late].mean())

    @property
    def wall_stress(self) -> float:
        """Mean shear stress at the wall that balances the pressure gradient [Pa]."""
        if self.scene.mean_velocity is None:
            return self.scene.wall_stress
        return self.scene.radius / self.scene.ways * (self.mean("gradient") or 0.0)

    def change(self, name: str) -> float:
        """Return the change of a column of the time series from its first row to its last row."""
        return float(self.series[name][-1] - self.series[name][0])


def _fixed(value: Callable[[RunData], float | None]) -> Callable[[RunData], float | None]:
    """Return a function that calls `value` if the driving force keeps the mean velocity constant, else returns None."""
    return lambda k: None if k.scene.mean_velocity is None else value(k)


def _pressure(k: RunData, gradient: float | None) -> float | None:
    """Return the pressure difference over the stretch [Pa], which balances friction and the weight of the concrete.

    `gradient` is the pressure gradient that balances the friction [Pa/m].
    """
    if gradient is None:
        return None
    return k.scene.length * (gradient + k.scene.density_with(k.fraction) * k.scene.gravity)


def _pressure_words(run: Run) -> str:
    ours, theory = (number(run.result[name]) / 1e3 for name in ("pressure", "pressure_theory"))
    return f"{ours:.4g} kPa   (mortar without aggregates by theory, with the same weight: {theory:.4g})"


def _gradient_words(run: Run) -> str:
    ours, theory = (number(run.result[name]) / 1e3 for name in ("gradient", "gradient_theory"))
    return f"{ours:.4g} kPa/m   (mortar without aggregates by theory: {theory:.4g})"


def _flow_words(run: Run) -> str:
    if run.scene.mean_velocity is not None:
        return f"{3600 * number(run.result['flow']):.4g} m3/h"
    ours, alone = (3600 * number(run.result[name]) for name in ("flow", "flow_alone"))
    averaged = LATE * float(run.series["time"][-1])
    return f"{ours:.4g} m3/h, mean of the last {averaged:.3g} s   (mortar without aggregates: {alone:.4g} m3/h)"


def _stress_words(run: Run) -> str:
    ours, given = (number(run.result[name]) for name in ("wall_stress", "wall_stress_theory"))
    return f"{ours:.4g} Pa   (from the pressure gradient: {given:.4g} Pa)"


def _slip_words(run: Run) -> str:
    slip, flow = number(run.result["slip_velocity"]), number(run.result["flow"])
    part = slip * np.pi * run.scene.radius**2 / flow
    return f"{1e3 * slip:.3g} mm/s, {100 * part:.3g} % of the flow"


def _migration_words(run: Run) -> str:
    start, end = (float(run.series["aggregate_radius"][k]) for k in (0, -1))
    return f"{start:.4f} to {end:.4f} radii of the pipe"


QUANTITIES = (
    Quantity("pressure", "Pa", _fixed(lambda k: _pressure(k, k.mean("gradient"))), "pressure", _pressure_words, True,
             meaning="Pressure difference over the stretch, which balances friction and weight; only at a constant "
                     "flow"),
    Quantity("pressure_theory", "Pa", _fixed(lambda k: _pressure(k, k.scene.gradient)),
             meaning="Theoretical pressure difference for mortar without aggregates, but with the same weight"),
    Quantity("gradient", "Pa/m", _fixed(lambda k: k.mean("gradient")), "friction", _gradient_words, True,
             meaning="Friction per length, without weight; only at a constant flow"),
    Quantity("gradient_theory", "Pa/m", _fixed(lambda k: k.scene.gradient),
             meaning="Theoretical friction per length of the mortar without aggregates"),
    Quantity("flow", "m3/s", lambda k: k.mean("flow"), "flow", _flow_words, True,
             meaning="Volume flow, as a mean over the last half of the run"),
    Quantity("flow_alone", "m3/s", lambda k: k.scene.mortar_alone.flow,
             meaning="Theoretical volume flow of the mortar without aggregates"),
    Quantity("wall_stress", "Pa", lambda k: k.mean("wall_stress"), "wall's stress", _stress_words, True,
             meaning="Mean shear stress on the wall"),
    Quantity("wall_stress_theory", "Pa", lambda k: k.wall_stress,
             meaning="Shear stress on the wall that balances the pressure gradient"),
    Quantity("relative_viscosity", "1", lambda k: k.mean("relative_viscosity"), "viscosity in the core",
             lambda run: f"{run.result['relative_viscosity']:.3g} times that of the mortar", True,
             meaning="Apparent viscosity of the core, divided by that of the mortar"),
    Quantity("slip_velocity", "m/s", lambda k: k.mean("slip_velocity"), "apparent slip", _slip_words, True,
             meaning="Apparent slip velocity, which a layer of mortar at the wall causes"),
    Quantity("aggregate_velocity", "m/s", lambda k: k.mean("aggregate_velocity"), "speed of aggregates", None, True,
             meaning="Mean velocity of the aggregates along the pipe"),
    Quantity("migration", "1", lambda k: k.change("aggregate_radius"), "distance from axis", _migration_words, True,
             meaning="Change of the mean distance of the aggregates from the axis during the run, divided by the "
                     "radius of the pipe"),
    Quantity("smallest_gap", "1", lambda k: float(k.series["smallest_gap"][1:].min()),
             meaning="Smallest gap between aggregates, or between aggregate and wall, during the run"),
)  # fmt: skip
"""Results of a stretch of pipe; velocities are means over the last half of the run."""


def report(run: Run) -> Iterator[tuple[str, str]]:
    """Yield a report line on the fraction of the aggregates that is simulated, if they have a sieve curve."""
    yield from aggregate_lines(run)
