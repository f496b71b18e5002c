"""Steady pipe flow of concrete whose aggregate fraction differs between the axis and the wall.

The concrete is a yield stress fluid of two zones, the inner and the outer half of the radius. Each zone has the
viscosity and yield stress of the concrete with the zone's own aggregate fraction
(:func:`~warpcrete.theory.suspension.thickening`); the slip layer is unchanged. Shear stress and velocity are continuous
between the zones, so their contributions to the flow add up in closed form.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..core.errors import between, refuse
from .laws import BINGHAM
from .pipe import Concrete, Line, Steady
from .suspension import SUSPENSIONS, power_thickening, thickening

STEPS = 200
"""Maximum number of bisections in the search for a root. The search ends earlier if no floating-point number lies
between the bounds."""


@dataclass(frozen=True)
class Segregated:
    """Concrete in a pipe, with one aggregate fraction in the inner and another in the outer half of the radius."""

    concrete: Concrete
    """Concrete with its aggregate evenly distributed."""
    line: Line
    fraction: float
    """Volume fraction of aggregate in the whole concrete."""
    index: float
    """Segregation index of the aggregate.

    It is the aggregate fraction in the outer half of the radius minus the aggregate fraction in the inner half; the
    difference is divided by the aggregate fraction of the whole concrete. Simulation runs report this index as
    `segregation`.
    """

    def __post_init__(self) -> None:
        densest = SUSPENSIONS["spheres"][1]
        if not 0 < self.fraction < densest:
            problem = f"must be above 0 and below the densest packing, {densest:g}"
            refuse("aggregate", self.fraction, problem, "usual values are 0.3 to 0.45 of the volume")
        least = max(-4.0, -4 / 3 * (densest / self.fraction - 1))
        most = min(4 / 3, 4 * (densest / self.fraction - 1))
        if not least < self.index < most:
            refuse("segregation", self.index, f"must be between {least:.3g} and {most:.3g} for a share "
                                              f"{self.fraction:g} of "
                                              "aggregate, so that every zone has an aggregate content between 0 and "
                                              "the "
                                              "densest packing",
                   "simulations give about -0.1 to 0.1")  # fmt: skip

    @property
    def shares(self) -> tuple[float, float]:
        """Volume fractions of aggregate in the inner and the outer half of the pipe's radius.

        The inner half of the radius covers a quarter of the pipe's cross-section.
        """
        return self.fraction * (1 - 0.75 * self.index), self.fraction * (1 + 0.25 * self.index)

    @property
    def zones(self) -> tuple[Concrete, Concrete]:
        """Concretes in the inner and the outer half of the radius, with the constants for their aggregate fractions."""
        even = thickening(self.fraction, *SUSPENSIONS["spheres"])
        halves = []
        for share in self.shares:
            thick = thickening(share, *SUSPENSIONS["spheres"])
            own = self.concrete
            factors = (thick[0], share), (even[0], self.fraction)
            linear, square = ([power_thickening(*each, n) for each in factors] for n in (own.flow_index, 2.0))
            halves.append(replace(own, viscosity=own.viscosity * linear[0] / linear[1],
                                 yield_stress=own.yield_stress * thick[1] / even[1],
                                 quadratic_viscosity=own.quadratic_viscosity * square[0] / square[1]))  # fmt: skip
        return halves[0], halves[1]

    def of_stress(self, stress: float) -> Steady:
        """Return the steady state at a wall `stress` [Pa]."""
        between("stress", stress, 0, np.inf, "[Pa]")
        concrete, line = self.concrete, self.line
        slip = float(concrete.layer_law.rate(stress))
        edge, flow, plug = line.radius - line.slip_thickness, np.pi * line.radius**2 * slip, line.radius
        border = min(0.5 * line.radius, edge)
        for zone, low, high in zip(self.zones, (0.0, border), (border, edge), strict=True):
            begin = max(low, line.radius * zone.yield_stress / stress) if stress > 0 else high
            if begin < high:
                # The flow by shear is the integral of pi r^2 times the shear rate over the radius r. The shear rate is
                # (stress r / R - yield stress) / viscosity. Here `stress` is the shear stress at the wall, and R is the
                # radius of the pipe.
                if (law := zone.bulk_law).name == BINGHAM:
                    rise = stress / line.radius * (high**4 - begin**4) / 4
                    rise -= zone.yield_stress * (high**3 - begin**3) / 3
                    flow += np.pi / zone.viscosity * rise
                else:
                    slope = stress / line.radius
                    flow += np.pi * float(law.stream(slope * high, slope * begin)) / slope**3
                plug = min(plug, begin)
        weight = concrete.density * line.gravity * line.rise * line.length
        pressure = weight + 2 * stress * line.length / line.radius
        return Steady("pipe", float(flow), pressure, stress, slip, min(plug, edge))

    def steady(self, flow: float) -> Steady:
        """Return the steady state of a volume `flow` [m3/s]; its pressure is the one that a pump must deliver."""
        between("flow", flow, 0, np.inf, "m3/s")
        low, high = 0.0, 1.0
        while self.of_stress(high).flow <= flow:
            low, high = high, 2 * high
            if high > 1e30:
                problem = "needs a wall stress beyond the range of floating-point numbers"
                refuse("flow", flow, problem, "use a smaller flow")
        for _ in range(STEPS):
            middle = 0.5 * (low + high)
            if not low < middle < high:
                break
            low, high = (middle, high) if self.of_stress(middle).flow <= flow else (low, middle)
        return self.of_stress(low)


def segregation_table(
    concrete: Concrete, line: Line, fraction: float, indices: Sequence[float], flows: Sequence[float]
) -> str:
    """Return a text table of pump pressures by flow [m3/s] and segregation index, for one `fraction` of aggregate."""
    lines = [
        f"fraction of aggregate {fraction:g}; segregation is the fraction in the outer half of the radius minus that "
        "in the inner half, over the mean",
        f"{'segregation':>12s}{'inner':>8s}{'outer':>8s}{'flow [m3/s]':>14s}{'pressure [Pa]':>15s}"
        f"{'wall stress [Pa]':>18s}{'friction over even':>20s}",
    ]
    for flow in flows:
        even = Segregated(concrete, line, fraction, 0.0).steady(flow).wall_stress
        for index in indices:
            apart = Segregated(concrete, line, fraction, index)
            state = apart.steady(flow)
            over = f"{state.wall_stress / even:.4g}" if even > 0 else "-"
            lines.append(
                f"{index:12.4g}{apart.shares[0]:8.3g}{apart.shares[1]:8.3g}{flow:14.5g}{state.pressure:15.6g}"
                f"{state.wall_stress:18.5g}{over:>20s}"
            )
    return "\n".join(lines)
