"""Steady flow of a yield stress fluid with a slip layer through a pipe: pressure, flow rate and velocity profile.

P is the pressure difference over a length L, R the radius of the pipe, tau_w the shear stress at the wall, rho the
density and g the gravity along the pipe. The theory comes in three forms. Each form combines a flow law with a balance
of forces:

- `pipe`: round pipe. The flow law is Buckingham-Reiner with slip (Xu, Li & Jiang 2021, Eq. 12), and the pressure is P =
  rho g L + 2 tau_w L / R.
- `plane`: channel between planes 2 R apart, which two-dimensional simulations represent. The pressure is P = rho g L +
  tau_w L / R. The flow rate is the mean velocity times pi R^2, which is the paper's convention.
- `paper`: the equations that the paper prints for two dimensions (Eqs. 23-26). They pair the flow law of the round pipe
  with the force balance of the channel. This form agrees with neither of the others and only serves comparison with the
  paper's figures.

The bulk is a Bingham fluid by default. In the slip layer, the shear stress is tau = tau_L0 + eta_L V_L (Eq. 8), with
the layer's yield stress tau_L0, its viscosity eta_L and the slip velocity V_L. Both may follow one of the other laws of
:mod:`.laws` instead. The radius of the bulk is the radius of the pipe minus the thickness of the layer.
"""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from ..core.errors import SceneError, at_least_and_below, between, one_of, refuse
from ..core.inputs.concretes import concrete
from ..core.inputs.parameters import Above, Declared, Within
from .fits import StraightLine, straight_line
from .laws import BINGHAM, FlowLaw

FORMS = ("pipe", "plane", "paper")


@dataclass(frozen=True, kw_only=True)
class Concrete(Declared):
    """Yield stress fluid with a slip layer at the wall; both obey Bingham's law unless more constants are given."""

    name: str = "concrete"
    density: Annotated[float, "Density [kg/m3]", Above()]
    viscosity: Annotated[
        float,
        "Plastic viscosity mu_b [Pa s], or consistency k [Pa s^n] with a flow index",
        Above(hint=("use a small viscosity, because sheared concrete without viscosity has no finite velocity")),
    ]
    yield_stress: Annotated[float, "Yield stress tau_b [Pa]", Within(0)]
    slip_viscosity: Annotated[
        float,
        "Viscosity eta_L of the slip layer divided by its thickness [Pa s/m]",
        Above(hint="use a very large value, such as 1e9, for a wall without slip"),
    ]
    slip_yield: Annotated[float, "Yield stress tau_L0 of the slip layer [Pa]", Within(0)]
    flow_index: Annotated[
        float,
        "Flow index n of the Herschel-Bulkley law tau_b + k g^n; concrete with n > 1 is shear-thickening",
        Above(),
    ] = 1.0
    quadratic_viscosity: Annotated[
        float,
        "Coefficient c of the modified Bingham law tau_b + mu_b g + c g^2 [Pa s2]",
        Within(0, hint="use flow_index below 1 for shear-thinning concrete"),
    ] = 0.0
    slip_flow_index: Annotated[float, "Flow index n of the slip layer, whose stress is tau_L0 + eta_L V^n", Above()] = (
        1.0
    )
    slip_quadratic_viscosity: Annotated[
        float,
        "Coefficient c of the slip layer [Pa s2/m2], whose stress is tau_L0 + eta_L V + c V^2",
        Within(0, hint="use slip_flow_index below 1 for a shear-thinning layer"),
    ] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for part in ("", "slip_"):
            index, square = f"{part}flow_index", f"{part}quadratic_viscosity"
            if getattr(self, index) != 1 and getattr(self, square) > 0:
                problem = f"cannot be combined with {square}, because they belong to different laws"
                refuse(index, getattr(self, index), problem, "leave out one of the two")

    @property
    def words(self) -> str:
        """Name, yield stress and viscosity as text, such as "no1 (300 Pa, 397 Pa s)".

        The constants are stated because they may differ from those of the shipped concrete of the same name.
        """
        return f"{self.name} ({self.yield_stress:.3g} Pa, {self.viscosity:.3g} Pa s{self.bulk_law.words})"

    @property
    def bulk_law(self) -> FlowLaw:
        """Flow law of the concrete inside the slip layer (the bulk), with shear rates in [1/s]."""
        return FlowLaw(self.yield_stress, self.viscosity, self.flow_index, self.quadratic_viscosity)

    @property
    def layer_law(self) -> FlowLaw:
        """Flow law of the slip layer, with slip velocities [m/s] in place of shear rates."""
        return FlowLaw(self.slip_yield, self.slip_viscosity, self.slip_flow_index, self.slip_quadratic_viscosity)


CONCRETES = {name: Concrete(name=name, **concrete(name).flow) for name in ("no1", "no2", "no3")}
"""Concretes of Xu, Li & Jiang 2021, Tables 1 to 3, by name; their slumps are 13, 18 and 22 cm.

Their slip layer has zero thickness.
"""

SLIP_VISCOSITY_BY_THICKNESS = {
    "no1": {2e-3: 889.0, 4e-3: 885.0, 6e-3: 882.0},
    "no2": {2e-3: 839.0, 4e-3: 834.0, 6e-3: 831.0},
    "no3": {2e-3: 914.0, 4e-3: 908.0, 6e-3: 902.0},
}
"""Slip viscosity eta_L [Pa s/m] by name of the concrete and thickness of the layer [m] (Xu et al. 2021, Table 3).

The yield stress of the slip layer does not depend on the thickness.
"""

MIXES = {
    "no1": dict(cement=323, sand=912, gravel=946, water=171, superplasticizer=0.808, viscosity_modifier=0.646),
    "no2": dict(cement=338, sand=890, gravel=936, water=179, superplasticizer=0.845, viscosity_modifier=0.676),
    "no3": dict(cement=360, sand=872, gravel=913, water=191, superplasticizer=0.900, viscosity_modifier=0.720),
}
"""Masses of the ingredients of the three concretes of Xu et al. 2021 [kg/m3]. The masses of superplasticizer and
viscosity modifier were calculated from Table 1 of the paper, which states them in per cent of the cement."""

BELOW_RADIUS = "use 0 for no slip layer, or less than the radius of the pipe"
"""Advice in the error message for a slip layer that is as thick as the radius of the pipe or thicker."""


@dataclass(frozen=True, kw_only=True)
class Line(Declared):
    """Straight pipe with a slip layer at its wall."""

    radius: Annotated[float, "Radius R [m]; half the distance of the planes in the form `plane`", Above()] = 0.05
    length: Annotated[float, "Length of the pipe [m]", Above()] = 0.3
    slip_thickness: Annotated[float, "Thickness of the slip layer [m]", Within(0)] = 0.0
    rise: Annotated[
        float, "Height gained per length of pipe: 1 for upward, 0 for level, -1 for downward flow", Within(-1, 1)
    ] = 1.0
    gravity: Annotated[float, "Gravitational acceleration [m/s2]", Within(0)] = 9.81

    def __post_init__(self) -> None:
        super().__post_init__()
        at_least_and_below("slip_thickness", self.slip_thickness, 0, self.radius, "m", BELOW_RADIUS)


@dataclass(frozen=True)
class Steady:
    """Steady state of the flow of concrete through a pipe."""

    form: str
    flow: float
    """Volume flow Q [m3/s]."""
    pressure: float
    """Pressure at the lower end of the pipe, where concrete enters [Pa]."""
    wall_stress: float
    """Shear stress tau_w at the wall [Pa]."""
    slip_velocity: float
    """Slip velocity V_L at the wall [m/s]."""
    plug_radius: float
    """Radius of the plug, the unsheared concrete in the middle of the pipe [m]."""


def _bulk(concrete: Concrete, line: Line, stress, form: str):
    """Return the part of the mean velocity over the pipe's cross-section that is due to shear of the bulk [m/s].

    The rest of the mean velocity is the slip velocity. `stress` is the shear stress tau at the wall [Pa], a number or
    an array, and `form` is the form of the theory. Let x be the yield stress divided by tau, and mu the plastic
    viscosity. If the slip layer has no thickness, the result for a Bingham fluid is

    - R tau / (4 mu) (1 - 4 x / 3 + x^4 / 3) in a pipe of radius R,
    - R tau / (3 mu) (1 - 3 x / 2 + x^3 / 2) in a channel of half width R.

    For all other flow laws, the method :meth:`~.laws.FlowLaw.mean_velocity` computes the result.
    """
    inner = line.radius - line.slip_thickness
    own = np.asarray(stress, float) * inner / line.radius
    if (law := concrete.bulk_law).name != BINGHAM:
        return (inner / line.radius) ** (1 if form == "plane" else 2) * law.mean_velocity(own, inner, form)
    with np.errstate(divide="ignore"):
        x = np.where(own > concrete.yield_stress, concrete.yield_stress / np.where(own > 0, own, 1.0), 1.0)
    # If the wall stress is just above the yield stress, x is nearly 1, and the polynomials of the docstring subtract
    # nearly equal numbers. The factored forms below avoid this loss of digits.
    rest = (1 - x) ** 2
    if form == "plane":
        return inner / line.radius * inner * own / (3 * concrete.viscosity) * rest * (1 + 0.5 * x)
    section = (inner / line.radius) ** 2
    return section * inner * own / (4 * concrete.viscosity) * rest * (3 + 2 * x + x**2) / 3


def least_stress(concrete: Concrete, line: Line) -> float:
    """Return the wall stress [Pa] above which concrete moves: either its slip layer slips or its bulk is sheared."""
    return min(concrete.slip_yield, concrete.yield_stress * line.radius / (line.radius - line.slip_thickness))


def steady_of_stress(concrete: Concrete, line: Line, stress: float, form: str = "pipe") -> Steady:
    """Return the steady state at a wall `stress` [Pa]; up to `least_stress` nothing moves."""
    one_of("form", form, FORMS)
    between("stress", stress, 0, np.inf, "[Pa]")
    slip = float(concrete.layer_law.rate(stress))
    bulk = float(_bulk(concrete, line, stress, form))
    ways = 2 if form == "pipe" else 1
    pressure = concrete.density * line.gravity * line.rise * line.length + ways * stress * line.length / line.radius
    inner = line.radius - line.slip_thickness
    plug = min(inner, line.radius * concrete.yield_stress / stress) if stress > 0 else inner
    return Steady(form, np.pi * line.radius**2 * (slip + bulk), pressure, stress, slip, plug)


@functools.lru_cache(maxsize=1024)
def steady(concrete: Concrete, line: Line, flow: float, form: str = "pipe") -> Steady:
    """Return the steady state at the volume flow `flow` [m3/s]; its pressure is the one that a pump must deliver.

    Concrete at rest can bear any wall stress up to `least_stress`. The result for zero flow has this largest stress.
    `form` is the form of the theory, one of :data:`FORMS`.
    """
    between("flow", flow, 0, np.inf, "m3/s")
    low = least_stress(concrete, line)
    if flow == 0:
        return steady_of_stress(concrete, line, low, form)
    flow_at, high = _flow_at(concrete, line, form), 2 * low + 1.0
    while flow_at(high) < flow:
        high *= 2
        if high > 1e30:
            refuse("flow", flow, "needs a wall stress beyond the range of floating-point numbers", "use a smaller flow")
    low, high = _narrowed(lambda stress: flow_at(stress) - flow, low, high)
    for _ in range(200):  # Bisect until no floating-point number lies between the bounds.
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        if flow_at(middle) < flow:
            low = middle
        else:
            high = middle
    return steady_of_stress(concrete, line, high, form)


def _flow_at(concrete: Concrete, line: Line, form: str) -> Callable[[float], float]:
    """Return the function that gives the volume flow [m3/s] at a wall stress [Pa].

    The returned function gives the flow of :func:`steady_of_stress`. If the bulk is a Bingham fluid, it computes the
    formula of :func:`_bulk` with Python's numbers instead of arrays of NumPy. The operations have the same order, so
    the result has the same bits, but it takes a fifth of the time.
    """
    layer = concrete.layer_law
    if concrete.bulk_law.name != BINGHAM:
        return lambda stress: steady_of_stress(concrete, line, stress, form).flow
    one_of("form", form, FORMS)
    radius, inner, yields = line.radius, line.radius - line.slip_thickness, concrete.yield_stress
    slip_yield, slip_viscosity, area = concrete.slip_yield, concrete.slip_viscosity, np.pi * line.radius**2
    plane, simple_layer = form == "plane", layer.name == BINGHAM
    scale = (inner / radius if plane else (inner / radius) ** 2) * inner
    divisor = (3 if plane else 4) * concrete.viscosity

    def flow_at(stress: float) -> float:
        slip = max(stress - slip_yield, 0.0) / slip_viscosity if simple_layer else float(layer.rate(stress))
        own = stress * inner / radius
        if own <= yields:
            return area * slip
        x = yields / own
        sheared = scale * own / divisor * (1 - x) ** 2
        sheared = sheared * (1 + 0.5 * x) if plane else sheared * (3 + 2 * x + x * x) / 3
        return area * (slip + sheared)

    return flow_at


def _narrowed(excess: Callable[[float], float], low: float, high: float) -> tuple[float, float]:
    """Narrow an interval around the root of an increasing function to a few floating-point numbers.

    `excess` is negative at `low` and not negative at `high`, and also at the two ends that are returned. The Illinois
    method approaches the root from one side only, so one end of the interval may stay far away. Therefore evaluate the
    function also closely below and above the estimate of the root, and move both ends there.
    """
    at_low, at_high, last = excess(low), excess(high), math.nan
    if not at_low < 0 <= at_high:
        return low, high
    for step in (1e-6, 4e-15):
        estimate = high
        for _ in range(60):
            trial = high - at_high * (high - low) / (at_high - at_low)
            if not low < trial < high:
                break
            value = excess(trial)
            if value < 0:
                low, at_low, at_high = trial, value, at_high / (2 if last < 0 else 1)
            else:
                high, at_high, at_low = trial, value, at_low / (2 if last >= 0 else 1)
            last, moved, estimate = value, abs(trial - estimate), trial
            if moved <= step * trial:
                break
        for probe in (estimate * (1 - step), estimate * (1 + step)):
            if low < probe < high:
                value = excess(probe)
                if value < 0:
                    low, at_low = probe, value
                else:
                    high, at_high = probe, value
    return low, high


def scaled(concrete: Concrete, yield_factor: float, viscosity_factor: float) -> Concrete:
    """Return the concrete at another age or temperature, by multiplying its constants by stated factors.

    `yield_factor` multiplies the yield stresses of bulk and slip layer, and `viscosity_factor` all their viscosities.
    Flow indices do not change. Users must know the factors, because they depend on cement and admixtures.
    """
    if yield_factor == viscosity_factor == 1.0:
        return concrete
    stresses = ("yield_stress", "slip_yield")
    viscosities = ("viscosity", "quadratic_viscosity", "slip_viscosity", "slip_quadratic_viscosity")
    changes = {name: yield_factor * getattr(concrete, name) for name in stresses}
    return replace(concrete, **changes, **{name: viscosity_factor * getattr(concrete, name) for name in viscosities})


def after_rest(concrete: Concrete, rest: float, thixotropy: float) -> Concrete:
    """Return the concrete after `rest` [s], when the yield stresses of bulk and slip layer have grown by A_thix t.

    Here A_thix is the `thixotropy` [Pa/s] and t the duration of the rest. The linear growth was proposed by Roussel
    (2006) and holds for some tens of minutes at most. In Roussel's classes, A_thix is below 0.1 for a concrete that
    hardly stiffens and above 0.5 for one that stiffens strongly. These values were measured on bulk concrete; that the
    slip layer stiffens equally is an assumption.
    """
    between("rest", rest, 0, np.inf, "s")
    between("thixotropy", thixotropy, 0, np.inf, "Pa/s")
    gained = thixotropy * rest
    return replace(concrete, yield_stress=concrete.yield_stress + gained, slip_yield=concrete.slip_yield + gained)


def restart(
    concrete: Concrete, line: Line, rest: float, thixotropy: float, flow: float = 0.0, form: str = "pipe"
) -> Steady:
    """Return the :class:`Steady` state in which concrete starts to move after a rest, with unbroken structure.

    `rest` is the duration of the rest [s], and `thixotropy` is the growth rate of the yield stresses [Pa/s]. With zero
    `flow` the state has the smallest pressure at which concrete moves. In a round pipe this pressure is rho g H + 4
    (tau_L0 + A_thix t) L / d, if the slip layer yields before the bulk. Here rho is the density, g gravity, and H the
    rise of the pipe, L its length and d its diameter; tau_L0 is the yield stress of the layer, A_thix the thixotropy
    and t the duration of the rest. With a `flow` [m3/s], a piston drives this flow at once, so that the pressure
    includes the viscous stress. In both cases the pressure falls to its steady value as shear breaks the structure.
    """
    return steady(after_rest(concrete, rest, thixotropy), line, flow, form)


def flow_of_pressure(concrete: Concrete, line: Line, pressure: float, form: str = "pipe") -> Steady:
    """Return the steady state that a `pressure` [Pa] at the lower end of the pipe drives.

    `form` is one of :data:`FORMS`. Raises :class:`SceneError` if nothing flows at this pressure.
    """
    one_of("form", form, FORMS)
    weight = concrete.density * line.gravity * line.rise * line.length
    ways = 2 if form == "pipe" else 1
    stress = (pressure - weight) * line.radius / (ways * line.length)
    if not stress > least_stress(concrete, line):
        least = weight + ways * least_stress(concrete, line) * line.length / line.radius
        raise SceneError(
            f"pressure = {pressure!r}: nothing flows below {least:.6g} Pa, of which {weight:.6g} Pa carry the weight "
            f"of the concrete (yield stress of the concrete {concrete.yield_stress:g} Pa, of its slip layer "
            f"{concrete.slip_yield:g} Pa); increase the pressure"
        )
    return steady_of_stress(concrete, line, stress, form)


def velocity(concrete: Concrete, line: Line, state: Steady, radius: Sequence[float] | np.ndarray) -> np.ndarray:
    """Return the velocity [m/s] at distances `radius` [m] from the axis or middle plane.

    The shear stress grows linearly from the middle to the wall in a pipe as in a channel, so both have the same
    profile. With Bingham's law the profile is a parabola outside the plug, the middle part that is not sheared. Raises
    :class:`SceneError` for distances that lie in the slip layer or beyond the wall.
    """
    r = np.abs(np.asarray(radius, float))
    inner = line.radius - line.slip_thickness
    if np.any(r > inner):
        refuse("radius", float(r.max()), f"must be at most {inner:g} m, the radius of the bulk")
    sheared = np.maximum(r, state.plug_radius)
    gradient = state.wall_stress / line.radius
    if (law := concrete.bulk_law).name != BINGHAM:
        # Let the edge be the place where the slip layer begins. The velocity minus the velocity at the edge is the
        # integral of the shear rate over the radius. The stress is proportional to the radius, so this is the integral
        # over the stress, divided by the gradient of the stress.
        at_wall, at_place = law.integrals(gradient * inner)[0], law.integrals(gradient * sheared)[0]
        return state.slip_velocity + np.where(state.plug_radius < inner, (at_wall - at_place) / (gradient or 1.0), 0.0)
    gained = gradient * (inner**2 - sheared**2) / 2 - concrete.yield_stress * (inner - sheared)
    return state.slip_velocity + np.where(state.plug_radius < inner, gained, 0.0) / concrete.viscosity


def layer_share(concrete: Concrete, line: Line, flow: float) -> float:
    """Return the slip velocity at the wall of a round pipe divided by the velocity on its axis, at a `flow` [m3/s]."""
    state = steady(concrete, line, flow)
    return state.slip_velocity / float(velocity(concrete, line, state, [0.0])[0])


def kaplan(concrete: Concrete, line: Line, flow: float) -> Steady:
    """Return the steady state of Kaplan's two-regime model of a round pipe with a thin slip layer.

    If the wall stress is below the bulk's yield stress, the concrete slips as a rigid plug. Otherwise it slips and is
    sheared. For the sheared part, the x^4 term of the Buckingham-Reiner law, with x = yield stress / wall stress, is
    left out (Kaplan, de Larrard & Sedran 2005). Raises :class:`SceneError` for other laws than Bingham's.
    """
    for law, part in ((concrete.bulk_law, ""), (concrete.layer_law, "slip_")):
        if law.name != BINGHAM:
            name, value = ("flow_index", law.index) if law.index != 1 else ("quadratic_viscosity", law.quadratic)
            problem = "cannot be used with Kaplan's model, which holds for Bingham's law only"
            refuse(part + name, value, problem, "use warpcrete.theory.pipe.steady")
    between("flow", flow, 0, np.inf, "m3/s")
    mean, radius = flow / (np.pi * line.radius**2), line.radius
    slip = mean
    stress = concrete.slip_yield + concrete.slip_viscosity * mean
    if stress > concrete.yield_stress:
        drag = radius / (4 * concrete.viscosity)
        slip = (mean - drag * concrete.slip_yield + radius / (3 * concrete.viscosity) * concrete.yield_stress) / (
            1 + drag * concrete.slip_viscosity
        )
        # Kaplan's law for the flow by shear gives negative values if the wall stress is just above the yield stress.
        # The concrete then slips as a rigid plug.
        if mean > slip:
            stress = concrete.slip_yield + concrete.slip_viscosity * slip
        else:
            slip = mean
    weight = concrete.density * line.gravity * line.rise * line.length
    plug = min(radius, radius * concrete.yield_stress / stress) if stress > 0 else radius
    return Steady("kaplan", flow, weight + 2 * stress * line.length / radius, stress, slip, plug)


def measured_layer(concrete: Concrete, line: Line, flows: Sequence[float], pressures: Sequence[float]) -> StraightLine:
    """Fit a straight line for wall stress as a function of slip velocity to flows [m3/s] and pressures [Pa] of a pipe.

    The slope of the line is eta_L [Pa s/m], and its offset is tau_L0 [Pa]. The part of each flow that is due to shear
    of the bulk is calculated and subtracted. The rest gives the slip velocity V (Xu, Li & Jiang 2021, Eq. 12), and the
    pressure gives the wall stress. If the layer has a flow index n, the line is fitted to the stress as a function of
    V^n. If the layer has a coefficient c, the line is fitted to the stress minus c V^2, as a function of V. `concrete`
    supplies n, c and the constants of the bulk, and `line` the dimensions of the pipe and the thickness of the layer.
    Applied to the constants of a layer of zero thickness, the function reproduces Table 3 of the paper. Raises
    :class:`SceneError` for fewer than two different flows, or if the points imply an impossible layer: a viscosity that
    is not positive or a negative yield stress.
    """
    q, p = np.asarray(flows, float), np.asarray(pressures, float)
    if q.shape != p.shape or q.ndim != 1 or len(q) < 2 or np.ptp(q) == 0:
        refuse("flows", q.tolist(), "must be two or more different flows, each with a pressure")
    if not (np.all(np.isfinite(q)) and np.all(np.isfinite(p))):
        refuse("pressures", p.tolist(), "must be finite numbers")
    stress = (p - concrete.density * line.gravity * line.rise * line.length) * line.radius / (2 * line.length)
    slip = q / (np.pi * line.radius**2) - _bulk(concrete, line, stress, "pipe")
    bent = np.sign(slip) * np.abs(slip) ** concrete.slip_flow_index if concrete.slip_flow_index != 1 else slip
    fit = straight_line(bent, stress - concrete.slip_quadratic_viscosity * slip * np.abs(slip))
    if fit.slope <= 0 or fit.offset < 0:
        raise SceneError(
            f"fit: the points give a slip layer with a viscosity of {fit.slope:.4g} Pa s/m and a yield stress of "
            f"{fit.offset:.4g} Pa, but the viscosity must be above 0 and the yield stress at least 0; check length, "
            "rise and diameter of the pipe, and the viscosity and yield stress of the concrete"
        )
    return fit
