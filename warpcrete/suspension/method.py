"""Record through which the program finds, runs, draws and reports flows of mortar with aggregates."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from ..core.run.run_loop import Run
from ..mps.free.forecast import forecast
from ..mps.free.method import METHOD as FREE_FLOWS
from ..mps.free.quantities import report
from .display import SuspensionDisplay
from .simulation import SuspensionSimulation


def _report(run: Run) -> Iterator[tuple[str, str]]:
    """Yield the report of a free-surface flow, and the fractions of aggregates and mortar still in the vessel."""
    yield from report(run)
    if "aggregates_inside" in run.series:
        aggregates, fraction = float(run.series["aggregates_inside"][-1]), run.result["aggregates"]["fraction"]
        mortar = (float(run.series["inside"][-1]) - fraction * aggregates) / (1 - fraction)
        yield "aggregates", f"{100 * aggregates:.1f} % of their volume remains, and {100 * mortar:.1f} % of the mortar"


METHOD = replace(
    FREE_FLOWS,
    name="suspension",
    simulation=SuspensionSimulation,
    display=SuspensionDisplay,
    report=_report,
    forecast=partial(forecast, make=SuspensionSimulation),
)
