"""Settings ("knobs") that trade accuracy of a free-surface flow for run time."""

import math
from collections.abc import Iterable, Iterator

from ...core.inputs.knobs import Knob, precisions, scaled
from ...core.records import SceneArguments
from .scene import FreeConcrete


def free_knobs(
    given: FreeConcrete, spacing: float, fall: float, coarsest: float, factors: Iterable[float], power: float
) -> Iterator[Knob]:
    """Yield the parameters that trade accuracy for run time, each with the values that a study tries.

    The parameters are the cell width, the time step (or the allowed error of a step), the regularisation and the
    precision. The cell widths are `spacing` [m] multiplied by each of `factors`, up to `coarsest` [m]. If all time
    steps are equal, a cell width is left out if concrete that has fallen by `fall` [m] crosses a cell of this width in
    one step. The run time is assumed to be proportional to the cell width to the power `power`.
    """
    finest = 0.0 if given.step_error else given.time_step * math.sqrt(2 * given.gravity * fall)
    usable = [f for f in factors if finest < f * spacing <= coarsest]
    yield scaled("spacing", "spacing", spacing, usable, power, "m", resolution=True)
    if given.step_error:
        yield scaled("step error", "step_error", given.step_error, (10.0, 3.0, 1.0, 0.3), -0.2)
    else:
        yield scaled("time step", "time_step", given.time_step, (1.0, 0.5, 0.25), -0.8, "s")
    yield scaled("regularisation", "regularisation", given.regularisation, (0.01, 0.1, 1.0), 0.1, "s")
    yield precisions()


def free_variants(given: FreeConcrete) -> dict[str, SceneArguments]:
    """Return variants of a flow with half and twice the yield stress or viscosity, as changes of its parameters."""
    variants = {}
    for name, words in (("yield_stress", "yield stress"), ("viscosity", "viscosity")):
        value = getattr(given.make_concrete(False), name)
        variants |= {f"half the {words}": {name: value / 2}, f"twice the {words}": {name: value * 2}}
    return variants
