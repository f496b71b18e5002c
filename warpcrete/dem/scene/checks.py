"""Checks that apply to every discrete element run, and the warning about a time step that is too coarse."""

import math
import warnings

from ...core.run.checks import with_cures
from ...core.run.run import Run
from ..laws import BinghamMortar, own_laws
from .scene import Scene

LARGEST_ENERGY_ERROR = 0.01
"""Largest relative error of the energy balance that a valid run may have; see `energy_balance`."""
LARGEST_MOMENTUM_ERROR = 0.01
"""Largest error of the momentum balance that a valid run may have, divided by the largest impulse."""
LARGEST_OVERLAP = 2.0
"""Overlap, divided by the smaller radius, at which one sphere lies inside another (is swallowed)."""
OUTFLOW_CHECK = "outflow equals inflow"
"""Name of the check that as much concrete leaves a bend, taper or bore as enters it."""
CURES = {
    "momentum balance": "precision='float64', or TimeStep(safety=0.1)",
    "no body swallowed": "stiffer contacts, or TimeStep(safety=0.1)",
}


def energy_check(run: Run) -> dict[str, tuple[bool, str]]:
    """Return the check of the energy balance by name; it is empty if the run did not sum up dissipated energy.

    A run in which nothing moved has no energy to lose. Its error is NaN, and the check is left out as well.
    """
    error = run.result.get("energy_balance_error")
    if error is None or math.isnan(error):
        return {}
    passed = abs(error) < LARGEST_ENERGY_ERROR
    text = f"error {100 * error:.3g} % of the energy"
    if not passed:
        text += f"; usual cure: {_finer(run.scene, abs(error))}"
        if own := own_laws(run.scene.laws()):
            text += f", or energy() and the losses of {own} are inconsistent with its force()"
    return {"energy balance": (passed, text)}


def _finer(scene: Scene, error: float) -> str:
    """Return the setting of a smaller time step that reduces the `error` to four fifths of the limit, for users.

    The error is assumed to be proportional to the time step. The text contains the option of the command and its
    counterpart in Python.
    """
    factor = 0.8 * LARGEST_ENERGY_ERROR / error
    if scene.time_step.fixed is not None:
        fixed = f"{factor * scene.time_step.fixed:.2g}"
        return f"--time-step {fixed}, in Python TimeStep(fixed={fixed})"
    safety = f"{max(factor * scene.time_step.safety, 1e-3):.2g}"
    return f"--safety {safety}, in Python TimeStep(safety={safety})"


def overlap_words(scene: Scene, overlap: float) -> str:
    """Return a text with the largest overlap, and with the thickness of soft shells if the contact law has them."""
    words, law = f"largest overlap {overlap:.3g} of the smaller radius", scene.contact
    if isinstance(law, BinghamMortar):
        return f"{words}, of which shells of mortar are {2 * law.shell_fraction:.2g} in spheres of equal size"
    own = own_laws([law])
    return f"{words}, including coats that {own} may have" if own else words


@with_cures(CURES)
def check_elements(run: Run) -> dict[str, tuple[bool, str]]:
    """Return the checks of a run whose scene was built in Python, so that no scene function supplies checks.

    The momentum balance is checked only if gravity acts. Without gravity, all impulses may be as small as rounding
    errors.
    """
    result = run.result
    if "largest_overlap" not in result:
        return {}
    overlap, balance = result["largest_overlap"], result["momentum_balance_error"]
    checks = {"no body swallowed": (overlap < LARGEST_OVERLAP, overlap_words(run.scene, overlap))}
    if any(run.scene.gravity):
        text = f"error {100 * balance:.3g} % of the largest impulse"
        checks["momentum balance"] = (balance < LARGEST_MOMENTUM_ERROR, text)
    return checks | energy_check(run)


def warn_of_coarse_step(run: Run) -> None:
    """Warn if the energy balance of a run has too large an error, because the time step is too coarse.

    The cause may also be a wrong contact law, if the law is defined outside this package.
    """
    for passed, text in energy_check(run).values():
        if not passed:
            own = ", or the contact law is wrong" if own_laws(run.scene.laws()) else ""
            warnings.warn(
                f"the time step is too coarse for the impacts in this run{own}: energy balance, {text}", stacklevel=2
            )
