"""Predictions of standard tests by flow simulations instead of closed forms."""

from collections.abc import Sequence

from ...core.units import number
from ...methods import method_of
from ...mix.rheology import FLATTEST
from ...mps.common.mixes import CONCRETE_CONSTANTS
from ...scenes import modules
from ...theory.bands import Band
from .cases import Case
from .comparison import Comparison, compare
from .predictions import mix_of_case

SIMULATED = {"slump": ("slump", "slump", {}), "spread": ("slump", "spread", {}),
             "funnel": ("funnel", "funnel_time", {"surfaces": "sticks"})}  # fmt: skip
"""Simulations that predict three kinds of measurements. Each entry holds the name of the scene, the quantity of its
result that is compared with the measurement, and parameters of the scene."""


def representatives(cases: Sequence[Case]) -> list[Case]:
    """Return the cases to simulate: from each group of cases, the one with the median of the measured values."""
    found = []
    for kind in SIMULATED:
        own = [case for case in cases if case.kind == kind]
        for group in sorted({case.group for case in own}):
            members = sorted((case for case in own if case.group == group), key=lambda case: case.measured[0])
            found.append(members[len(members) // 2])
    return found


def simulate(case: Case, held_out: bool, *, device: str | None = None, spacing: float | None = None) -> Comparison:
    """Predict a case by simulating its standard test as a flow.

    `held_out` is stored in the result. `spacing` is the edge length of the cells [m], by default that of the scene. The
    simulated value is multiplied by the relative band of the closed form to get its uncertainty band, but a slump's
    band ends at the largest slump of a cone (:data:`FLATTEST`). Raises :class:`WarpcreteError` if the run fails, and
    KeyboardInterrupt if it is interrupted.
    """
    scene, quantity, more = SIMULATED[case.kind]
    concrete = mix_of_case(case).concrete
    own = {name: getattr(concrete, name) for name in CONCRETE_CONSTANTS}
    settings = {"concrete": "own", **own, **more, **({} if spacing is None else {"spacing": spacing})}
    given = modules()[scene].scene(**settings)
    run = method_of(given).simulation(given, device=device).run()
    if not run.finished:
        raise KeyboardInterrupt
    value = number(run.result[quantity])
    form = compare(case)
    low, high = (value * end / form.band.value for end in (form.band.low, form.band.high))
    if case.kind == "slump":
        high = max(value, min(high, FLATTEST))
    return Comparison(case, held_out, form.measured, Band(value, low, high, form.band.shares), True)
