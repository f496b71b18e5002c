"""Interface through which the program finds, runs, draws and reports flows of mortar with aggregates."""

from dataclasses import replace
from functools import partial

from ..mps.free.forecast import forecast
from ..mps.free.method import METHOD as FREE_FLOWS
from ..mps.free.quantities import quantities
from .display import SuspensionDisplay
from .pictures import plot_with_aggregates
from .quantities import QUANTITIES, in_words, report_aggregates
from .simulation import SuspensionSimulation

METHOD = replace(
    FREE_FLOWS,
    name="suspension",
    simulation=SuspensionSimulation,
    list_quantities=lambda: (*quantities(), *QUANTITIES),
    display=SuspensionDisplay,
    show=plot_with_aggregates,
    report=report_aggregates,
    forecast=partial(
        forecast,
        make=SuspensionSimulation,
        features_of=lambda simulation: {"aggregates": in_words(simulation.flow.aggregates, simulation.scene)},
    ),
)
