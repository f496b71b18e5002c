"""Parameters, scenes and checks of pipe flows, shared by the scenes `channel` and `tube`."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, ClassVar

import numpy as np

from ..core.errors import at_least_and_below, positive, refuse
from ..core.inputs.knobs import Knob, Level, Trading, precisions, scaled
from ..core.inputs.limits import check_velocity, warn
from ..core.inputs.parameters import Above, Needs, OneOf
from ..core.inputs.yaml_files import merged
from ..core.records import Record, SceneArguments
from ..core.run.checks import with_cures
from ..core.run.run import Run
from ..core.units import number
from ..theory.pipe import (
    BELOW_RADIUS,
    MIXES,
    Concrete,
    Line,
    Steady,
    after_rest,
    flow_of_pressure,
    steady,
    steady_of_stress,
)
from ..theory.suspension import SUSPENSIONS, concrete_of_mortar, mortar_of
from .common.mixes import (
    CONSTANTS,
    FACTORS,
    LAW_DEFAULTS,
    ConcreteParameters,
    concrete_of,
    file_aggregates,
    file_constants,
)
from .scene import ENDS, MIN_PARTICLES_ACROSS, Aggregates, FlowSettings, FluidScene

SHEARED: dict[str, Any] = {
    "concrete": "own", "viscosity": 30.0, "yield_stress": 40.0, "slip_viscosity": 1000.0, "slip_yield": 20.0,
    "density": 2350.0, **dict.fromkeys(LAW_DEFAULTS), **dict.fromkeys(FACTORS),
}  # fmt: skip
"""Parameters of a self-compacting concrete that is strongly sheared in the pipe.

In the pipe and at the flow rate of Xu, Li & Jiang 2021, slip carries only 70 % of this concrete's flow.
"""
MIN_SLIP_RATIO = 0.9
"""Minimum ratio of slip velocity to mean velocity for simulating a flow as a column of concrete that a piston pushes
through the pipe. With less slip, the column loses volume and its forces do not balance."""
FLOW = 1500e-6
"""Volume flow of the reference case of Xu, Li & Jiang 2021 [m3/s]."""
NEEDS_AGGREGATES = Needs("aggregates", bool, "is on")


@dataclass(frozen=True, kw_only=True)
class ColumnParameters:
    """Parameters of the pipe and of the piston, and the spacing of the particles."""

    diameter: Annotated[float, "Inner diameter of the pipe, or distance of the planes [m]", Above()] = 0.1
    length: Annotated[float, "Length of the concrete in the pipe [m]"] = 0.3
    flow: Annotated[float | None, "Volume flow through a round pipe of this diameter [m3/s]; default: 1500e-6"] = None
    pressure: Annotated[
        float | None,
        "Pressure on the piston [Pa], instead of the flow; the speed of the piston then follows from theory",
    ] = None
    spacing: Annotated[
        float, "Particle spacing [m]; adjusted so that a whole number of particles fits across the pipe"
    ] = 5e-3


@dataclass(frozen=True, kw_only=True)
class AggregateParameters:
    """Parameters of the coarse aggregate in the two-phase model."""

    common: ClassVar[tuple[str, ...]] = ("aggregates",)

    aggregates: Annotated[
        bool, "Simulate two phases: the coarse aggregate consists of rigid groups of particles in mortar"
    ] = False
    aggregate_fraction: Annotated[
        float | None,
        "Volume fraction of the coarse aggregate; default: the gravel content of the concrete",
        NEEDS_AGGREGATES,
    ] = None
    aggregate_density: Annotated[float, "Density of the coarse aggregate [kg/m3]", Above(), NEEDS_AGGREGATES] = 2630.0
    inclusions: Annotated[
        str,
        "Shape that the formula for the default constants of the mortar assumes for aggregates: discs, spheres, or "
        "auto (discs in two dimensions, spheres in three)",
        OneOf(("auto", *SUSPENSIONS)),
        NEEDS_AGGREGATES,
    ] = "auto"
    mortar_viscosity: Annotated[
        float | None,
        "Plastic viscosity of the mortar [Pa s]; default: calculated from that of the concrete",
        NEEDS_AGGREGATES,
    ] = None
    mortar_yield: Annotated[
        float | None,
        "Yield stress of the mortar [Pa]; default: calculated from that of the concrete",
        NEEDS_AGGREGATES,
    ] = None


@dataclass(frozen=True, kw_only=True)
class FlowParameters(ConcreteParameters, ColumnParameters, AggregateParameters, FlowSettings):
    """Parameters of a column of concrete in a pipe."""

    ends: Annotated[
        str,
        "Ends of the pipe: piston (a piston pushes a column of particles with a free surface), periodic (a stretch of "
        "an endless pipe on a grid, for flows with any amount of shear), auto (piston with 'aggregates', or if by "
        "theory the slip velocity is at least 0.9 of the mean velocity; otherwise periodic)",
        OneOf(("auto", *ENDS)),
    ] = "auto"

    @classmethod
    def implied(cls, values: Mapping[str, object]) -> Mapping[str, Any]:
        """Return the values that these parameters take from the file of the concrete, by name.

        The result contains the flow constants and, for a flow with two phases, the parameters of the aggregate. A run's
        record keeps these values, so that the run can be repeated even if the file changes later.
        """
        return merged(file_constants(values), file_aggregates(values))

    def constants(self) -> Concrete:
        """Return the concrete (density, flow law and slip layer) that these parameters describe."""
        return concrete_of(self.concrete, self.slip_thickness, **{name: getattr(self, name) for name in CONSTANTS})

    def phases(self, concrete: Concrete, dimensions: int) -> tuple[Concrete, Aggregates | None]:
        """Return the concrete as one fluid, and the data of its aggregate and mortar (None for a flow with one phase).

        `concrete` has the constants that the parameters state. If the parameters also state the viscosity or the yield
        stress of the mortar, the same constant of the returned concrete is computed by homogenisation of the mortar and
        its aggregate. Theory then describes the simulated concrete.
        """
        fraction = self.aggregate_fraction
        if not self.aggregates or fraction == 0:
            return concrete, None
        if fraction is None:
            if self.concrete not in MIXES:
                problem = f"must be stated, because concrete {self.concrete!r} has no known gravel content"
                refuse("aggregate_fraction", None, problem, "use the volume fraction of the gravel, for example 0.3")
            fraction = MIXES[self.concrete]["gravel"] / self.aggregate_density
        by_dimension = "discs" if dimensions == 2 else "spheres"
        inclusions = self.inclusions if self.inclusions != "auto" else by_dimension
        mortar = mortar_of(concrete, fraction, self.aggregate_density, inclusions)
        stated = {"viscosity": self.mortar_viscosity, "yield_stress": self.mortar_yield}
        own = {key: value for key, value in stated.items() if value is not None}
        mortar = replace(mortar, **own)
        whole = concrete_of_mortar(mortar, fraction, self.aggregate_density, inclusions)
        concrete = replace(concrete, **{key: getattr(whole, key) for key in own})
        return concrete, Aggregates(fraction=fraction, mortar=mortar, density=self.aggregate_density)

    def volume_flow(self, concrete: Concrete, bulk: float, dimensions: int) -> float:
        """Return the volume flow [m3/s] that the parameters state, or that theory predicts for the stated pressure.

        `bulk` is the pipe's radius minus the thickness of the slip layer [m]. Raises :class:`SceneError` if flow and
        pressure are both stated, or if the volume flow is not positive.
        """
        flow = self.flow
        if self.pressure is not None:
            if flow is not None:
                refuse("flow", flow, "cannot be combined with 'pressure'", "leave out 'flow' or 'pressure'")
            line = Line(radius=bulk, length=self.length, gravity=self.gravity)
            flow = flow_of_pressure(concrete, line, self.pressure, "plane" if dimensions == 2 else "pipe").flow
        elif flow is None:
            flow = FLOW
        positive("flow", flow, "m3/s", "increase the flow, because concrete at rest needs no simulation")
        return flow

    def ends_for(self, concrete: Concrete, bulk: float, flow: float, dimensions: int) -> str:
        """Return the kind of the pipe's ends, "piston" or "periodic"; if `ends` is "auto", choose a kind for the flow.

        `flow` is the volume flow [m3/s], and `bulk` the pipe's radius minus the thickness of the slip layer [m]. If
        concrete slips little, a column of particles on a piston loses volume, and its forces do not balance. The choice
        is therefore "piston" only for flows with much slip or with aggregates. It is "periodic" for flows that need a
        grid because of a rest, a rebuilding structure or adaptive time steps.
        """
        if self.ends != "auto":
            return self.ends
        if self.aggregates:
            return "piston"
        if self.rest or self.step_error or self.rebuild_rate:
            return "periodic"
        return "piston" if _slip_share(concrete, self, bulk, flow, dimensions) >= MIN_SLIP_RATIO else "periodic"


def _slip_share(concrete: Concrete, given: FlowParameters, bulk: float, flow: float, dimensions: int) -> float:
    """Return the theoretical slip velocity, divided by the mean velocity.

    `flow` is the volume flow [m3/s], and `bulk` the pipe's radius minus the thickness of the slip layer [m].
    """
    line = Line(radius=bulk, length=given.length, gravity=given.gravity)
    state = steady(concrete, line, flow, "plane" if dimensions == 2 else "pipe")
    return state.slip_velocity * np.pi * bulk**2 / flow


def column_scene(
    name: str, dimensions: int, given: FlowParameters, paper: Mapping[str, Mapping[str, float]] | None = None
) -> FluidScene:
    """Return the scene of a column of concrete in a pipe.

    `given` holds the parameters of the flow. `paper` maps names of concretes to the results that Xu, Li & Jiang 2021
    print for them; these results are attached to the scene only if it is one of the paper's cases. Raises
    :class:`SceneError` if the pressure is too low to move the concrete, or if the slip layer fills the pipe.
    """
    at_least_and_below("slip_thickness", given.slip_thickness, 0, given.diameter / 2, "m", BELOW_RADIUS)
    concrete, aggregates = given.phases(given.constants(), dimensions)
    bulk = given.diameter / 2 - given.slip_thickness
    area = np.pi * bulk**2
    flow = given.volume_flow(concrete, bulk, dimensions)
    given = replace(given, ends=given.ends_for(concrete, bulk, flow, dimensions))
    check_velocity("flow", flow, flow / area)
    if aggregates is not None and (slip := _slip_share(concrete, given, bulk, flow, dimensions)) < MIN_SLIP_RATIO:
        warn(
            f"aggregates: by theory, the slip velocity is {100 * slip:.0f} % of the mean velocity, but a column of "
            f"particles needs {100 * MIN_SLIP_RATIO:.0f} % to keep its volume and its balance of forces; leave out "
            "'aggregates' to simulate one phase on a grid"
        )
    settings = {f.name: getattr(given, f.name) for f in fields(FlowSettings)}
    return FluidScene(
        name=name,
        concrete=concrete,
        dimensions=dimensions,
        radius=bulk,
        length=given.length,
        velocity=flow / area,
        spacing=given.spacing,
        aggregates=aggregates,
        published=(paper or {}).get(given.concrete, {}) if _is_reference_case(given) else {},
        **settings,
    )


def _is_reference_case(given: FlowParameters) -> bool:
    """Return whether the scene is a case of Xu, Li & Jiang 2021: one phase, and a slip layer without thickness."""
    free = {"concrete", "spacing", "flow", *(f.name for f in fields(FlowSettings))} - {
        "gravity",
        "rest",
        "rebuild_rate",
    }
    other = [f.name for f in fields(given) if f.name not in free and getattr(given, f.name) != f.default]
    return not other and given.flow in (None, FLOW)


ACCURACY = {2: 0.01, 3: 0.02}
"""Accepted relative deviation of pressure and slip velocity from theory in flows with one phase, by number of
dimensions."""
TWO_PHASE_ACCURACY = 0.03
"""Accepted relative deviation of the pressure from theory in flows with two phases. It is larger than with one phase,
because theory treats the two phases as one fluid."""
WALL_ACCURACY = {True: 0.05, False: 0.03}
"""Accepted relative deviation of the wall stress from theory, in flows with two phases (key True) or one phase (key
False).

The wall stress is checked separately, because weight dominates the pressure and would hide an error of the wall stress.
"""
PROFILE_ACCURACY = 0.01
"""Accepted root mean square deviation of the velocity profile from theory, divided by the mean velocity."""


GRID = "--ends periodic if little of the concrete slips"
"""Advice to the user if the concrete is sheared more than a column of particles can represent: simulate the flow on a
grid, which has periodic ends."""
ONE_PHASE = "one phase without --aggregates if little of the concrete slips"
"""Advice that takes the place of GRID for flows with aggregates, which cannot be simulated on a grid."""
CURES = {
    "finished": "a longer --duration, or a shorter --sample-interval",
    "steady": "a larger --steadiness, or a larger --time-step",
    "pressure": f"a smaller --spacing, or {GRID}",
    "wall's stress": f"a smaller --spacing, or {GRID}",
    "volume": "a smaller --tolerance, or a smaller --time-step",
    "balance of forces": "a smaller --tolerance, or a smaller --time-step",
    "restart": "a smaller --spacing, or a shorter --sample-interval",
    "slip velocity": f"a smaller --spacing, or {GRID}",
    "profile": f"a smaller --spacing, or {GRID}",
}


def _cures(run: Run) -> dict[str, str]:
    """Return advice to the user for each acceptance check that a run may fail, by the name of the check.

    The advice for a flow with aggregates does not mention the grid, on which such a flow cannot be simulated.
    """
    if run.scene.aggregates is None:
        return CURES
    return {name: cure.replace(GRID, ONE_PHASE) for name, cure in CURES.items()}


@with_cures(_cures)
def check_flow(run: Run) -> dict[str, tuple[bool, str]]:
    """Return the acceptance checks of a pipe flow by name: whether each one passed, and the measured value as text."""
    result, scene = run.result, run.scene
    two = scene.aggregates is not None
    if "pressure_error" not in result:
        return {"finished": (False, "the run has no measurement after the start")}
    usual = TWO_PHASE_ACCURACY if two else ACCURACY[scene.dimensions]
    limit = usual if scene.tolerated_error is None else scene.tolerated_error
    wall_limit, profile_limit = (
        max(limit if limit > usual else 0.0, each) for each in (WALL_ACCURACY[two], PROFILE_ACCURACY)
    )
    pressure, slip, wall = (result[f"{name}_error"] for name in ("pressure", "slip_velocity", "wall_stress"))
    balance = result["force_balance_error"]
    checks = {
        "pressure": (abs(pressure) < limit, f"{100 * pressure:+.2f} % off theory"),
        "wall's stress": (abs(wall) < wall_limit, f"{100 * wall:+.2f} % off theory"),
        "volume": (abs(result["volume_error"]) < 1e-3, f"largest error {100 * result['volume_error']:+.3f} %"),
        "balance of forces": (abs(balance) < 5e-3, f"{100 * balance:+.2f} % of the piston's force is not balanced"),
    }
    # The closed forms assume the same yield stress everywhere, but the yield stress of thixotropic concrete varies with
    # its structure. Pressure and wall stress are therefore not compared with the closed forms.
    if scene.is_structured:
        checks = {name: checks[name] for name in ("volume", "balance of forces")}
    # The limits for the pressure at the restart assume that the yield stress is largest directly after the rest. This
    # does not hold if thixotropic structure also rebuilds while the concrete flows, so the check is skipped then.
    if scene.gained and not scene.rebuild_rate:
        peak, least = number(result["restart_pressure"]), scene.theory().pressure
        most = plug_restart_state(scene).pressure
        # The rest increased the yield stress of the slip layer, and slip removes this increase again. If all concrete
        # slips as a rigid plug, much of the increase must still exist at the first measurement after the start.
        plug = (
            plug_restart_state(scene).wall_stress
            <= after_rest(scene.concrete, scene.rest, scene.thixotropy).yield_stress
        )
        left = 0.5 * math.exp(-scene.velocity * float(run.series["time"][1]) / scene.breakdown) if plug else 0.0
        checks["restart"] = (
            (least + left * (most - least)) * (1 - limit) < peak < most * (1 + limit),
            f"{peak / 1e3:.4g} kPa; theory: {least / 1e3:.4g} kPa without thixotropic structure, {most / 1e3:.4g} kPa "
            "for a plug with unbroken structure",
        )
    # A run whose scene states a duration may end before the flow is steady, which is no failure. Only other runs must
    # become steady.
    if scene.duration is None:
        checks = {"steady": (result["steady"], f"after {number(result['simulated_time']):g} s"), **checks}
    if not two and not scene.is_structured:
        checks["slip velocity"] = (abs(slip) < limit, f"off theory by {100 * slip:+.2f} % of the mean velocity")
        checks["profile"] = (
            result["profile_error"] < profile_limit,
            f"rms deviation {100 * result['profile_error']:.2f} % of the mean velocity",
        )
    return checks


def plug_restart_state(scene: FluidScene) -> Steady:
    """Return the theoretical state of a flow just after a rest, such as its pressure and its wall stress.

    All concrete is assumed to slip as a rigid plug whose thixotropic structure is unbroken.
    """
    concrete = after_rest(scene.concrete, scene.rest, scene.thixotropy)
    stress = float(concrete.layer_law.stress(scene.velocity))
    return steady_of_stress(
        replace(concrete, yield_stress=max(stress, concrete.yield_stress)), scene.line, stress, scene.form
    )


def flow_trading(dimensions: int) -> Trading:
    """Return the settings that trade a flow's accuracy for run time, and the quantities that measure its accuracy."""
    return Trading(
        lambda given: _knobs(given, dimensions),
        quantities=("pressure", "slip_velocity"),
        closed_form=lambda given: not given.aggregates and not given.rest and not given.rebuild_rate,
        variants=lambda given: _variants(given, dimensions),
        tolerance="tolerated_error",
    )


def _variants(given: FlowParameters, dimensions: int) -> dict[str, SceneArguments]:
    """Return the changed parameters of each variant of a flow, by a description of the variant.

    A trade-off study compares its settings with theory for the flow itself and for these variants, which have other
    concretes, flow rates or pipes. A change of the flow rate changes the ratio of slip velocity to mean velocity. The
    self-compacting concrete is sheared almost everywhere. All variants have the same kind of ends (piston or periodic)
    as the flow itself, because the settings found for the flow are applied to its variants. The result is empty for
    flows with aggregates or with a stated pressure.
    """
    if given.aggregates or given.pressure is not None:
        return {}
    same = {"ends": column_scene("variants", dimensions, given).ends} if given.ends == "auto" else {}
    flow = FLOW if given.flow is None else given.flow
    wider = {"diameter": 1.5 * given.diameter, "length": 1.5 * given.length, "flow": 2.25 * flow}
    variants: dict[str, Record] = {
        "a fifth of the flow": {"flow": flow / 5},
        "twice the flow": {"flow": 2 * flow},
        "a pipe 1.5 times as wide": wider,
        "that pipe at a fifth of the flow": wider | {"flow": 0.45 * flow},
    }
    if given.concrete in MIXES:
        own = dict.fromkeys(CONSTANTS)
        variants |= {f"concrete {name}": own | {"concrete": name} for name in MIXES if name != given.concrete}
    variants["a concrete that shears"] = SHEARED
    return {name: changes | same for name, changes in variants.items()}


def _knobs(given: FlowParameters, dimensions: int) -> Iterator[Knob]:
    spacings = [f for f in (4.0, 2.0, 1.0, 0.5) if f * given.spacing <= given.diameter / MIN_PARTICLES_ACROSS]
    yield scaled("spacing", "spacing", given.spacing, spacings, -(dimensions + 0.5), "m", resolution=True)
    yield scaled("time step", "time_step", given.time_step, (4.0, 2.0, 1.0, 0.5), -0.7, "s")
    tolerances = [f for f in (30.0, 10.0, 1.0, 0.1) if f * given.tolerance <= 0.5]
    yield scaled("tolerance", "tolerance", given.tolerance, tolerances, -0.1)
    yield scaled("regularisation", "regularisation", given.regularisation, (0.03, 0.1, 0.3, 1.0, 3.0), 0.1, "s")
    yield precisions()
    if given.duration is None:
        yield scaled("steadiness", "steadiness", given.steadiness, (30.0, 10.0, 1.0, 0.1), -0.2)
    if given.aggregates:
        yield Knob(
            "phases",
            (
                Level("one phase", {"aggregates": False, "aggregate_fraction": None}, 0.7),
                Level("two phases", {"aggregates": True}),
            ),
            True,
        )
