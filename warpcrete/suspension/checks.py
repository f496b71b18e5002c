"""Acceptance checks that all simulations of mortar with aggregates in pipes share."""

from collections.abc import Mapping

from ..core.units import number

OVERLAP = 0.05
"""Largest accepted overlap of two aggregates, or of an aggregate and a wall, divided by the radius of the aggregate."""


def steadiness(result: Mapping[str, object]) -> tuple[bool, str]:
    """Return whether the flow became steady, and the simulated time of the run as text."""
    return bool(result["steady"]), f"after {number(result['simulated_time']):g} s"


def no_overlap(result: Mapping[str, object]) -> tuple[bool, str]:
    """Return whether no aggregates overlapped by more than `OVERLAP`, and the smallest gap as text."""
    gap = number(result["smallest_gap"])
    return gap > -OVERLAP, f"smallest gap {gap:+.4f} radii"
