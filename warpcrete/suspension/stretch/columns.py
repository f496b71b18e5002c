"""Prescribed flow of mortar with aggregates in stretches of endless straight pipes and channels."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any

from ...core.errors import refuse
from ...core.inputs.knobs import Knob, Trading, precisions, scaled
from ...core.inputs.limits import check_velocity
from ...core.inputs.parameters import Above, Needs
from ...core.run.run import Run
from ...mps.column import FlowParameters, check_flow, flow_trading
from ...theory.pipe import Line, steady
from ..aggregates import MIN_CELLS
from ..scene import USED_BY_AGGREGATES, AggregateParameters
from .checks import check_stretch
from .scene import Courant, StretchScene, StretchSettings

REMARKS = (
    "the ends of the stretch are connected: what leaves one end enters the other",
    "the driving force adapts to keep the mean velocity constant; results are means over the last half of the run",
)
DEPTH_REMARK = "no aggregate crosses the two planes of symmetry that limit the depth of the channel"
DEPTH_SIZES = 4.0
"""Depth of a channel with aggregates, in diameters of the largest aggregate."""
DURATION = 1.0
"""Simulated time of a flow with aggregates unless the user states it [s]."""
UNUSED = ("time_step", "step_error", "steadiness", "rest", "rebuild_rate", "tolerated_error", "slip_thickness")
"""Parameters of a column of concrete that have no effect in flows with aggregates. Values other than the defaults are
therefore refused in a scene with aggregates."""
ANY_AGGREGATES = Needs("aggregate_fraction", bool, "is above 0", ("aggregates",), refused=False)
"""Rule for a parameter that applies to both models of aggregates: rigid bodies on a grid, and groups of particles."""


@dataclass(frozen=True, kw_only=True)
class ColumnWithAggregates(FlowParameters, AggregateParameters):
    """Parameters of a column of concrete with coarse aggregate, which may consist of rigid bodies on a grid."""

    aggregate_fraction: Annotated[  # pyright: ignore[reportIncompatibleVariableOverride]
        float | None,
        "Volume fraction of the coarse aggregate. Without 'aggregates', each aggregate is a rigid body on a grid. "
        "With 'aggregates', each is a rigid group of particles, the constants describe the concrete, and the default "
        "is the gravel content of the concrete",
    ] = None
    aggregate_density: Annotated[float, "Density of the coarse aggregate [kg/m3]", Above(), ANY_AGGREGATES] = 2630.0
    courant: Annotated[Courant, USED_BY_AGGREGATES] = 0.5

    @property
    def suspended(self) -> bool:
        """True if the aggregates are simulated one by one."""
        return bool(self.aggregate_fraction) and not self.aggregates


def suspended_column(name: str, dimensions: int, given: ColumnWithAggregates) -> StretchScene:
    """Return a stretch of an endless pipe (3 dimensions) or channel (2) with aggregates and a given flow.

    Raises :class:`SceneError` for parameters that cannot be simulated.
    """
    for field in fields(given):
        if field.name in UNUSED and getattr(given, field.name) != field.default:
            refuse(field.name, getattr(given, field.name), "has no effect with aggregates that are simulated one by "
                                                           "one",
                   f"leave out {field.name!r}")  # fmt: skip
    if given.ends == "piston":
        problem = "cannot be combined with aggregates that are simulated one by one"
        refuse("ends", given.ends, problem, "use 'ends' = periodic")
    concrete, radius = given.constants(), given.diameter / 2
    flow = given.volume_flow(concrete, radius, dimensions)
    velocity = flow / (math.pi * radius**2)
    check_velocity("flow", flow, velocity)
    line, form = Line(radius=radius, length=given.length, gravity=0.0), "plane" if dimensions == 2 else "pipe"
    shared = {f.name: getattr(given, f.name) for f in fields(StretchSettings) if hasattr(given, f.name)}
    depth = DEPTH_SIZES * given.coarsest if dimensions == 2 else 0.0
    stretch = StretchScene(
        name=name,
        concrete=concrete,
        radius=radius,
        length=given.length,
        gradient=steady(concrete, line, flow, form).pressure / given.length,
        mean_velocity=velocity,
        depth=depth,
        spacing=given.spacing,
        slips=True,
        remarks=REMARKS + ((DEPTH_REMARK,) if depth else ()),
        **AggregateParameters.aggregates(given),
        **shared | {"duration": given.duration or DURATION},
    )
    mixed = given.with_mortar(stretch)
    return replace(mixed, gradient=steady(mixed.concrete, line, flow, form).pressure / given.length)


def check_column(run: Run) -> dict[str, tuple[bool, str]]:
    """Return the acceptance checks of a straight pipe or channel, with or without aggregates, by name."""
    return check_stretch(run) if isinstance(run.scene, StretchScene) else check_flow(run)


def column_trading(dimensions: int) -> Trading:
    """Return the settings that trade the accuracy of a flow with or without aggregates for run time."""
    plain = flow_trading(dimensions)
    return replace(
        plain,
        knobs=lambda given: stretch_knobs(given) if given.suspended else plain.knobs(given),
        closed_form=lambda given: not given.suspended and plain.closed_form(given),
        variants=lambda given: {} if given.suspended else plain.variants(given),
    )


def stretch_knobs(given: Any) -> Iterator[Knob]:
    """Yield the settings that a trade-off study varies in a stretch of pipe or channel with aggregates.

    `given` is an instance of :class:`ColumnWithAggregates`, or holds the parameters of the scene `stretch`.
    """
    coarsest = min(given.diameters[0] / MIN_CELLS, given.diameter / 8)
    factors = [f for f in (1.3, 1.0, 0.75, 0.5) if f * given.spacing <= coarsest]
    yield scaled("spacing", "spacing", given.spacing, factors, -4.0, "m", resolution=True)
    yield scaled("courant", "courant", given.courant, [f for f in (2.0, 1.0, 0.5) if f * given.courant <= 1], -0.8)
    yield scaled("regularisation", "regularisation", given.regularisation, (0.1, 1.0, 10.0), 0.1, "s")
    yield precisions()
