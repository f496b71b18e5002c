"""Checks, remarks and accuracy settings of discrete element tests of fresh concrete in a vessel."""

from collections.abc import Iterator

from ...core.inputs.knobs import Knob, Level, precisions, scaled
from ...core.run.checks import with_cures
from ...core.run.run import Run
from ..scene.checks import energy_check, overlap_words
from .vessels import VesselParameters

COARSER = (2.0, 1.5, 1.25, 1.0)


def vessel_knobs(given: VesselParameters, narrowest: float) -> Iterator[Knob]:
    """Yield parameters that trade accuracy for computing time: time step, precision, grain size and stiffness.

    Grains are no larger than a quarter of the `narrowest` passage [m].
    """
    if given.time_step is None:
        yield scaled("time step", "safety", given.safety, (2.0, 1.5, 1.0, 0.5), -1.0)
    yield precisions()
    levels = [
        Level(f"x {f:g}", {"size_min": f * given.size_min, "size_max": f * given.size_max}, f**-4, f"x {f:g}")
        for f in COARSER
        if f == 1.0 or f * given.size_max <= narrowest / 4
    ]
    if len(levels) > 1:
        yield Knob("coarse-graining", tuple(levels), True)
    if given.contact is not None:
        return
    stiffness = [
        Level(f"{f * given.stiffness:.4g} Pa", {"modulus": f * given.stiffness}, f**0.5, f"x {f:g}")
        for f in (0.25, 0.5)
    ]
    as_given = Level(f"{given.stiffness:.4g} Pa", {"modulus": given.modulus}, 1.0, "x 1")
    yield Knob("stiffness", (*stiffness, as_given), True)


BALANCED = 0.01
"""Largest error of the momentum balance that a valid run may have, divided by the largest impulse on the concrete."""
FEWEST = 200
"""Minimum number of grains that represent concrete in a vessel; with fewer, the outcome depends on single grains."""
STRAYS = 0.05
"""Largest fraction of the grains that may roll away from the heap in a valid run."""
CURES = {
    "momentum balance": "--precision float64, or a smaller --safety",
    "no grain swallowed": "a larger --modulus, or a smaller --safety",
    "enough grains": "a smaller --size-max",
    "at rest": "a longer --duration",
    "one heap": "a larger --settle, or a smaller --size-max",
    "light is seen": "a longer --duration",
}


@with_cures(CURES)
def check_vessel(run: Run) -> dict[str, tuple[bool, str]]:
    """Return the checks of a run in a vessel by name, each as a tuple (True if passed, text with measured values)."""
    result, test = run.result, run.scene.vessel.test
    balance, overlap, grains = result["momentum_balance_error"], result["largest_overlap"], result["bodies"]
    checks = {
        "momentum balance": (balance < BALANCED, f"{100 * balance:.3g} % of the largest impulse"),
        "no grain swallowed": (overlap < 2.0, overlap_words(run.scene, overlap)),
        "enough grains": (grains >= FEWEST, f"{grains}; at least {FEWEST} are needed to represent concrete"),
    }
    if test.on_plate:
        strays = result["strays"]
        checks["one heap"] = (strays < STRAYS, f"{100 * strays:.2g} % of the grains have left the heap")
    return checks | test.judge(run) | energy_check(run)


def vessel_remarks(given: VesselParameters, what: str) -> tuple[str, ...]:
    """Return remarks on simplifications of a scene; `what` names the surfaces along which concrete may slide freely."""
    texts = []
    if given.law == "mortar":
        texts.append(
            "law mortar: slump differs by up to a quarter from the closed form at yield stresses of 20 to 500 Pa; at "
            "1000 Pa a cone remains standing (with law plastic it slumps)"
        )
    if given.law == "plastic":
        texts.append(
            "law plastic: spread lies between the closed forms at yield stresses of 200 to 2000 Pa; heaps with a lower "
            "yield stress stop too early"
        )
    if given.contact is not None and not given.is_gripped:
        texts.append(
            "plate and mould have the same contact law as grains have between them, because "
            f"{type(given.contact).__name__} has no parameter for friction"
        )
    elif given.mould_grip_or_default == 0:
        texts.append(f"concrete slides freely along {what}; use --mould-grip 1 for friction there")
    if given.bulk_density is None:
        texts.append(
            f"only the grains have mass, {given.packed * given.density:.4g} kg/m3 in the full vessel; --bulk-density "
            "adds the mortar's mass to them"
        )
    return tuple(texts)
