"""Quantities and report text that describe the blockage of a pipe."""

import math
from collections.abc import Callable
from typing import Any

from ...core.run.method import Quantity
from ...core.run.run import Run
from ...core.units import number
from .blockage import STANDING_RATIO


def _of(name: str) -> Callable[[Any], float | None]:
    return lambda known: known.blockage.found.get(name) if known.blockage is not None else None


BLOCKED = "the pipe was blocked"

QUANTITIES = (
    Quantity("blocked", "1", lambda known: None if known.blockage is None else float(bool(known.blockage.found)),
             compared=True, rare=True,
             meaning="1 if the pipe was blocked, otherwise 0"),
    Quantity("blockage_window", "m", lambda known: None if known.blockage is None else known.blockage.window,
             meaning="Piston travel during which part of the concrete stands still before the pipe counts as blocked"),
    Quantity("slowest_advance", "1", lambda known: None if known.blockage is None else _finite(known.blockage.slowest),
             meaning="Advance of the slowest part of the concrete at the last check, divided by the advance of the "
                     "piston"),
    Quantity("blocked_at", "m", _of("at"),
             meaning="Arc length of the blockage along the axis of the pipe", only_if=BLOCKED),
    Quantity("blocked_time", "s", _of("time"),
             meaning="Time at which the blockage was detected", only_if=BLOCKED),
    Quantity("blocked_from_travel", "m", _of("travel"),
             meaning="Travel of the piston at which a part of the concrete stopped", only_if=BLOCKED),
    Quantity("blocked_pressure", "Pa", _of("pressure"),
             meaning="Pressure on the piston when the blockage was detected", only_if=BLOCKED),
    Quantity("blocked_pressure_before", "Pa", _of("pressure_before"),
             meaning="Pressure on the piston when a part of the concrete stopped", only_if=BLOCKED),
    Quantity("blocked_solid_fraction", "1", _of("solid_fraction"),
             meaning="Solid fraction at the blockage", only_if=BLOCKED),
    Quantity("blocked_chains", "1", _of("chains"),
             meaning="Number of networks of strong contacts that span the pipe at the blockage", only_if=BLOCKED),
)  # fmt: skip
"""Results of a run that describe whether, when and how the pipe was blocked by concrete.

The result `blocked` is 1 or 0, so its mean over runs with different seeds estimates the probability of a blockage.
"""


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def not_blocked_words(run: Run) -> str:
    """Return a phrase that says that the pipe of `run` was not blocked, and how reliable this statement is."""
    window, slowest = number(run.result["blockage_window"]), run.result.get("slowest_advance")
    travel = float(run.series["travel"][-1])
    if travel < 2 * window:
        return (
            f"not blocked, but the piston has moved only {travel:.3g} m; concrete counts as blocked if it stands "
            f"still while the piston moves by {window:.3g} m"
        )
    if slowest is None:
        return f"not blocked within {travel:.3g} m of travel; at the end too few aggregates were left to tell"
    if number(slowest) < STANDING_RATIO:
        return (
            f"not blocked within {travel:.3g} m of travel, but at the end part of the concrete moved only "
            f"{number(slowest):.2f} times as far as the piston; move the piston further"
        )
    return (
        f"not blocked within {travel:.3g} m of travel; at the end every part of the concrete moved at least "
        f"{number(slowest):.2f} times as far as the piston"
    )


def blocked_words(run: Run) -> str:
    """Return a phrase that says where the pipe of `run` was blocked, with the evidence for the blockage."""
    evidence = {
        name: number(run.result[f"blocked_{name}"])
        for name in ("at", "from_travel", "pressure", "pressure_before", "solid_fraction", "chains")
    }
    ending = " spans" if evidence["chains"] == 1 else "s span"
    spans = f"{evidence['chains']:.0f} force chain{ending}" if evidence["chains"] else "no force chain spans"
    travel = evidence["from_travel"]
    since = f"a piston travel of {travel:.3g} m" if travel > 0 else "the piston began to move"
    return (
        f"at {evidence['at']:.3g} m along the pipe: part of the concrete has stood still since {since}, while "
        f"the pressure rose from {evidence['pressure_before'] / 1e3:.3g} to {evidence['pressure'] / 1e3:.3g} kPa; "
        f"{spans} the section there, at a solid fraction of {evidence['solid_fraction']:.2f}"
    )
