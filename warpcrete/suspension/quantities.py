"""Result quantities of mortar with aggregates in a vessel, in addition to the quantities of all free-surface flows."""

from collections.abc import Iterator

from ..core.run.method import Quantity
from ..core.run.run import Run
from ..core.units import number
from ..mps.free.quantities import RunData, report
from .aggregates import BodyState
from .scene import SphereFields


def mortar_part(concrete: float, aggregates: float, fraction: float) -> float:
    """Return the fraction of all mortar that lies in a region.

    `concrete` and `aggregates` are the fractions of all concrete and of all aggregates in the region, and `fraction` is
    the volume fraction of the aggregates in the concrete.
    """
    return (concrete - fraction * aggregates) / (1 - fraction)


def _last(known: RunData, name: str) -> float | None:
    return float(known.series[name][-1]) if name in known.series else None


def _both(run: Run) -> str:
    aggregates, mortar = (100 * float(run.series[f"{what}_passed"][-1]) for what in ("aggregates", "mortar"))
    return f"{aggregates:.1f} % of the aggregates, {mortar:.1f} % of the mortar"


QUANTITIES = (
    Quantity(
        "aggregates_passed",
        "1",
        lambda k: _last(k, "aggregates_passed"),
        "passed the bars",
        _both,
        True,
        meaning="Fraction of the aggregates that has passed the bars",
    ),
    Quantity(
        "mortar_passed",
        "1",
        lambda k: _last(k, "mortar_passed"),
        "",
        None,
        True,
        meaning="Fraction of the mortar that has passed the bars",
    ),
)
"""Results of tests in which concrete flows through a ring of bars (J-ring)."""


def in_words(bodies: BodyState, scene: SphereFields) -> str:
    """Return number, sizes and volume fraction of the aggregates of a simulation as text."""
    clumps = f" clumps, of {bodies.spheres} spheres," if bodies.kind.clumps else " spheres"
    smallest, largest = (f"{1e3 * size:.3g}" for size in scene.diameters)
    sizes = smallest if smallest == largest else f"{smallest} to {largest}"
    return f"{bodies.count}{clumps} of {sizes} mm, {100 * scene.simulated_fraction:.3g} % of the volume"


def aggregate_lines(run: Run) -> Iterator[tuple[str, str]]:
    """Yield report lines on the number of aggregates, and on the simulated fraction of those with a sieve curve."""
    entry = run.result.get("aggregates", {})
    if "count_whole" in entry:
        count, whole = entry["count"], entry["count_whole"]
        mirrored = f"; {count} of them are simulated, the others are mirror images" if whole > count else ""
        yield "aggregates in all", f"{whole}, {100 * entry['fraction']:.3g} % of the volume{mirrored}"
    if "stated_fraction" in entry:
        part = entry["fraction"] / entry["stated_fraction"]
        smallest = 1e3 * number(entry["smallest"])
        yield "simulated", f"{100 * part:.0f} % of the stated aggregates; those below {smallest:.3g} mm count as mortar"


def report_aggregates(run: Run) -> Iterator[tuple[str, str]]:
    """Yield the report of a free-surface flow, with lines about its aggregates.

    If only a part of the aggregates is simulated, a line states which. If concrete may leave through an open side, a
    line states which fractions of the aggregates and of the mortar remain.
    """
    yield from report(run)
    yield from aggregate_lines(run)
    if "aggregates_inside" in run.series:
        aggregates, fraction = float(run.series["aggregates_inside"][-1]), run.result["aggregates"]["fraction"]
        mortar = mortar_part(float(run.series["inside"][-1]), aggregates, fraction)
        yield (
            "aggregates left",
            f"{100 * aggregates:.1f} % of their volume remains, and {100 * mortar:.1f} % of the mortar",
        )
