"""Steady flow of a Bingham fluid with a slip layer through a pipe: pressure, flow, velocity profile.

Three forms of the same theory, each a law of flow and a balance of forces:

- `pipe`: round pipe; Buckingham and Reiner's flow with slip (Xu, Li & Jiang 2021, Eq. 12), P = rho g L + 2 tau_w L / R;
- `plane`: channel between planes 2 R apart, as two-dimensional simulations have it, P = rho g L + tau_w L / R; its flow
  is the mean velocity times pi R^2, the paper's convention;
- `paper`: what the paper prints for two dimensions (Eqs. 23-26): the round pipe's flow with the channel's balance. It
  agrees with neither; kept to compare with the paper's figures.

The slip layer obeys tau = tau_L0 + eta_L V_L (Eq. 8). Bulk concrete fills the radius less the layer's thickness.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from ..core.concretes import concrete
from ..core.errors import SceneError, between, one_of, refuse
from ..core.parameters import Above, Declared, Within
from .fits import StraightLine, straight_line

FORMS = ("pipe", "plane", "paper")


@dataclass(frozen=True, kw_only=True)
class Concrete(Declared):
    """A Bingham fluid and its slip layer."""

    name: str = "concrete"
    density: Annotated[float, "Density [kg/m3]", Above()]
    viscosity: Annotated[
        float, "Plastic viscosity mu_b [Pa s]", Above(hint=("without viscosity the velocity has no profile"))
    ]
    yield_stress: Annotated[float, "Yield stress tau_b [Pa]", Within(0)]
    slip_viscosity: Annotated[
        float,
        "Viscosity eta_L of the slip layer divided by its thickness [Pa s/m]",
        Above(hint="give a very large value for a wall without slip"),
    ]
    slip_yield: Annotated[float, "Yield stress tau_L0 of the slip layer [Pa]", Within(0)]


CONCRETES = {name: Concrete(name=name, **concrete(name).flow) for name in ("no1", "no2", "no3")}
"""Xu, Li & Jiang 2021, Tables 1 to 3 (slip layer of no thickness); slumps 13, 18 and 22 cm."""

THICKER_LAYERS = {
    "no1": {2e-3: 889.0, 4e-3: 885.0, 6e-3: 882.0},
    "no2": {2e-3: 839.0, 4e-3: 834.0, 6e-3: 831.0},
    "no3": {2e-3: 914.0, 4e-3: 908.0, 6e-3: 902.0},
}
"""eta_L [Pa s/m] for slip layers of some thickness [m] (Table 3); tau_L0 is that of no thickness."""

MIXES = {
    "no1": dict(cement=323, sand=912, gravel=946, water=171, superplasticizer=0.808, viscosity_modifier=0.646),
    "no2": dict(cement=338, sand=890, gravel=936, water=179, superplasticizer=0.845, viscosity_modifier=0.676),
    "no3": dict(cement=360, sand=872, gravel=913, water=191, superplasticizer=0.900, viscosity_modifier=0.720),
}
"""Their proportions (Table 1): kg/m3, the last two in % of cement."""


@dataclass(frozen=True, kw_only=True)
class Line(Declared):
    """A stretch of straight pipe."""

    radius: Annotated[float, "Radius R [m]; half the distance of the planes in the form `plane`", Above()] = 0.05
    length: Annotated[float, "Length L [m]", Above()] = 0.3
    slip_thickness: Annotated[float, "Thickness of the slip layer [m]", Within(0)] = 0.0
    rise: Annotated[float, "Height gained per length: 1 for an upright pipe, 0 for a level one", Within(-1, 1)] = 1.0
    gravity: Annotated[float, "Gravitational acceleration [m/s2]", Within(0)] = 9.81

    def __post_init__(self) -> None:
        super().__post_init__()
        between("slip_thickness", self.slip_thickness, 0, np.nextafter(self.radius, 0), "m", "use less than the radius")


@dataclass(frozen=True)
class Steady:
    """A steady state."""

    form: str
    flow: float
    """Q [m3/s]"""
    pressure: float
    """At the lower end [Pa]."""
    wall_stress: float
    """tau_w [Pa]"""
    slip_velocity: float
    """V_L [m/s]"""
    plug_radius: float
    """Within which nothing is sheared [m]."""


def _bulk(concrete: Concrete, line: Line, stress, form: str):
    """Mean velocity that shear in the bulk adds, over the whole section [m/s]; `stress` at the wall [Pa]."""
    inner = line.radius - line.slip_thickness
    own = np.asarray(stress, float) * inner / line.radius
    with np.errstate(divide="ignore"):
        x = np.where(own > concrete.yield_stress, concrete.yield_stress / np.where(own > 0, own, 1.0), 1.0)
    # Near x = 1 the polynomials are differences of nearly equal numbers: in their factored forms nothing cancels.
    rest = (1 - x) ** 2
    if form == "plane":
        return inner / line.radius * inner * own / (3 * concrete.viscosity) * rest * (1 + 0.5 * x)
    section = (inner / line.radius) ** 2
    return section * inner * own / (4 * concrete.viscosity) * rest * (3 + 2 * x + x**2) / 3


def least_stress(concrete: Concrete, line: Line) -> float:
    """Wall stress above which something flows [Pa]: the layer slips, or the bulk is sheared before it does."""
    return min(concrete.slip_yield, concrete.yield_stress * line.radius / (line.radius - line.slip_thickness))


def steady_of_stress(concrete: Concrete, line: Line, stress: float, form: str = "pipe") -> Steady:
    """The state in which the wall bears `stress` [Pa]; up to `least_stress` nothing moves."""
    one_of("form", form, FORMS)
    between("stress", stress, 0, np.inf, "[Pa]")
    slip = max(stress - concrete.slip_yield, 0.0) / concrete.slip_viscosity
    bulk = float(_bulk(concrete, line, stress, form))
    ways = 2 if form == "pipe" else 1
    pressure = concrete.density * line.gravity * line.rise * line.length + ways * stress * line.length / line.radius
    inner = line.radius - line.slip_thickness
    plug = min(inner, line.radius * concrete.yield_stress / stress) if stress > 0 else inner
    return Steady(form, np.pi * line.radius**2 * (slip + bulk), pressure, stress, slip, plug)


@functools.lru_cache(maxsize=1024)
def steady(concrete: Concrete, line: Line, flow: float, form: str = "pipe") -> Steady:
    """The state at a flow of `flow` [m3/s]; its pressure is what a pump must give.

    At rest the wall may bear any stress up to `least_stress`: the answer for no flow is that limit.
    """
    between("flow", flow, 0, np.inf, "[m3/s]")
    low = least_stress(concrete, line)
    high = 2 * low + 1.0
    while steady_of_stress(concrete, line, high, form).flow < flow:
        high *= 2
        if high > 1e30:
            refuse("flow", flow, "needs a wall stress beyond the range of numbers")
    for _ in range(200):  # until there is no number between
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        if steady_of_stress(concrete, line, middle, form).flow < flow:
            low = middle
        else:
            high = middle
    return steady_of_stress(concrete, line, high if flow > 0 else low, form)


def rested(concrete: Concrete, rest: float, thixotropy: float) -> Concrete:
    """The concrete after `rest` [s]: yield stresses of bulk and slip layer have grown by A_thix t (Roussel 2006).

    A_thix, `thixotropy` [Pa/s], is below 0.1 for a concrete that hardly stiffens and above 0.5 for one that stiffens
    strongly (his classes). It was measured on concrete; that the layer grows as fast is an assumption. The law is
    linear for some tens of minutes at most.
    """
    between("rest", rest, 0, np.inf, "s")
    between("thixotropy", thixotropy, 0, np.inf, "Pa/s")
    gained = thixotropy * rest
    return replace(concrete, yield_stress=concrete.yield_stress + gained, slip_yield=concrete.slip_yield + gained)


def restart(
    concrete: Concrete, line: Line, rest: float, thixotropy: float, flow: float = 0.0, form: str = "pipe"
) -> Steady:
    """The :class:`Steady` state that concrete which has stood is in as it starts to move, its structure still whole.

    With no flow that is the limit below which nothing moves: a plug of length L in a round pipe of diameter d takes
    rho g H + 4 (tau_L0 + A_thix t) L / d, as long as its layer bears less than its bulk. A piston that starts at once
    with `flow` [m3/s] drags the layer as well. Either pressure falls to the steady one as shear breaks the structure.
    """
    return steady(rested(concrete, rest, thixotropy), line, flow, form)


def restart_table(concrete: Concrete, line: Line, rest: float, thixotropy: float, flow: float) -> str:
    """What a restart after `rest` [s] takes by every form, beside the steady pressure at `flow` [m3/s]; text."""
    grown = rested(concrete, rest, thixotropy)
    lines = [
        f"after {rest:g} s at rest with a growth rate of {thixotropy:g} Pa/s: yield stress {grown.yield_stress:g} Pa; "
        f"slip layer {grown.slip_yield:g} Pa",
        f"{'form':8s}{'moves from [Pa]':>16s}{'per metre [Pa/m]':>18s}{f'at {flow:.5g} m3/s [Pa]':>24s}"
        f"{'over steady':>13s}",
    ]
    for form in FORMS:
        least = restart(concrete, line, rest, thixotropy, form=form).pressure
        peak = restart(concrete, line, rest, thixotropy, flow, form).pressure
        over = peak / steady(concrete, line, flow, form).pressure
        lines.append(f"{form:8s}{least:16.6g}{least / line.length:18.6g}{peak:24.6g}{over:13.4g}")
    return "\n".join(lines)


def flow_of_pressure(concrete: Concrete, line: Line, pressure: float, form: str = "pipe") -> Steady:
    """The state that `pressure` [Pa] at the lower end drives. Raises :class:`SceneError` where nothing flows."""
    one_of("form", form, FORMS)
    weight = concrete.density * line.gravity * line.rise * line.length
    ways = 2 if form == "pipe" else 1
    stress = (pressure - weight) * line.radius / (ways * line.length)
    if not stress > least_stress(concrete, line):
        least = weight + ways * least_stress(concrete, line) * line.length / line.radius
        raise SceneError(
            f"pressure = {pressure!r}: nothing flows below {least:.6g} Pa (weight {weight:.6g} Pa, yield stress "
            f"{concrete.yield_stress:g} Pa, slip yield {concrete.slip_yield:g} Pa); raise the pressure"
        )
    return steady_of_stress(concrete, line, stress, form)


def velocity(concrete: Concrete, line: Line, state: Steady, radius: Sequence[float] | np.ndarray) -> np.ndarray:
    """Velocity [m/s] at distances `radius` [m] from the axis or middle plane, inside the bulk.

    The same parabola in pipe and channel: shear stress grows linearly from the middle in both.
    """
    r = np.abs(np.asarray(radius, float))
    inner = line.radius - line.slip_thickness
    if np.any(r > inner):
        refuse("radius", float(r.max()), f"must be at most {inner:g} m, the radius of the bulk")
    sheared = np.maximum(r, state.plug_radius)
    gradient = state.wall_stress / line.radius
    gained = gradient * (inner**2 - sheared**2) / 2 - concrete.yield_stress * (inner - sheared)
    return state.slip_velocity + np.where(state.plug_radius < inner, gained, 0.0) / concrete.viscosity


def kaplan(concrete: Concrete, line: Line, flow: float) -> Steady:
    """Kaplan's two regimes (Kaplan, de Larrard & Sedran 2005): slip alone while the wall bears less than the yield
    stress of the bulk, then slip and shear, with x^4 of Buckingham and Reiner's law left out. Round pipe, thin layer.
    """
    between("flow", flow, 0, np.inf, "[m3/s]")
    mean, radius = flow / (np.pi * line.radius**2), line.radius
    slip = mean
    stress = concrete.slip_yield + concrete.slip_viscosity * mean
    if stress > concrete.yield_stress:
        drag = radius / (4 * concrete.viscosity)
        slip = (mean - drag * concrete.slip_yield + radius / (3 * concrete.viscosity) * concrete.yield_stress) / (
            1 + drag * concrete.slip_viscosity
        )
        # Between the yield stress and where the linearised bulk begins to flow, slip is all there is.
        if mean > slip:
            stress = concrete.slip_yield + concrete.slip_viscosity * slip
        else:
            slip = mean
    weight = concrete.density * line.gravity * line.rise * line.length
    plug = min(radius, radius * concrete.yield_stress / stress) if stress > 0 else radius
    return Steady("kaplan", flow, weight + 2 * stress * line.length / radius, stress, slip, plug)


def slip_constants(
    concrete: Concrete, line: Line, flows: Sequence[float], pressures: Sequence[float]
) -> tuple[float, float]:
    """eta_L [Pa s/m] and tau_L0 [Pa] from flows [m3/s] and pressures [Pa] measured in a round pipe (Eq. 12).

    What the bulk's shear gives of each flow is taken off; a straight line goes through the rest. `concrete` gives
    viscosity, yield stress and density, `line` the layer's thickness; Table 3 follows from the constants of no
    thickness in this way.
    """
    found = _slip_line(concrete, line, flows, pressures)
    return found.slope, found.offset


def measured_layer(concrete: Concrete, line: Line, flows: Sequence[float], pressures: Sequence[float]) -> StraightLine:
    """The same with standard errors, for a layer that there can be. Raises :class:`SceneError` for points that ask for
    another.
    """
    found = _slip_line(concrete, line, flows, pressures)
    if found.slope <= 0 or found.offset < 0:
        raise SceneError(
            f"fit: the points give a slip layer of {found.slope:.4g} Pa s/m and {found.offset:.4g} Pa, which is "
            "impossible; check length, rise and diameter, and the viscosity and yield stress of the shear that is "
            "subtracted from the flows"
        )
    return found


def _slip_line(concrete: Concrete, line: Line, flows: Sequence[float], pressures: Sequence[float]) -> StraightLine:
    """Stress of the wall over slip velocity."""
    q, p = np.asarray(flows, float), np.asarray(pressures, float)
    if q.shape != p.shape or q.ndim != 1 or len(q) < 2 or np.ptp(q) == 0:
        refuse("flows", q.tolist(), "must be two or more different flows, with a pressure for each")
    if not (np.all(np.isfinite(q)) and np.all(np.isfinite(p))):
        refuse("pressures", p.tolist(), "must be finite numbers")
    stress = (p - concrete.density * line.gravity * line.rise * line.length) * line.radius / (2 * line.length)
    return straight_line(q / (np.pi * line.radius**2) - _bulk(concrete, line, stress, "pipe"), stress)


def table(concrete: Concrete, line: Line, flows: Sequence[float] = (), pressures: Sequence[float] = ()) -> str:
    """Pressure and slip velocity at given flows, or flow at given pressures, by every form and by Kaplan; text.

    A form in which a pressure moves nothing says so in its line; :class:`SceneError` where none flows.
    """
    lines = [
        f"{concrete.name}: density {concrete.density:g} kg/m3, viscosity {concrete.viscosity:g} Pa s, yield stress "
        f"{concrete.yield_stress:g} Pa; slip layer {concrete.slip_viscosity:g} Pa s/m, {concrete.slip_yield:g} Pa",
        f"{'form':8s}{'flow [m3/s]':>14s}{'pressure [Pa]':>15s}{'wall stress [Pa]':>18s}{'slip [m/s]':>12s}"
        f"{'plug radius [m]':>17s}",
    ]

    def line_of(s: Steady) -> str:
        return (
            f"{s.form:8s}{s.flow:14.5g}{s.pressure:15.6g}{s.wall_stress:18.5g}{s.slip_velocity:12.5g}"
            f"{s.plug_radius:17.4g}"
        )

    for flow in flows:
        lines += [line_of(steady(concrete, line, flow, form)) for form in FORMS]
        lines.append(line_of(kaplan(concrete, line, flow)))
    for pressure in pressures:
        standing = []
        for form in FORMS:
            try:
                lines.append(line_of(flow_of_pressure(concrete, line, pressure, form)))
            except SceneError as error:
                standing.append(error)
                lines.append(f"{form:8s}{0:14.5g}{pressure:15.6g}   {str(error).partition(': ')[2].partition(' (')[0]}")
        if len(standing) == len(FORMS):
            raise standing[-1]
    return "\n".join(lines)
