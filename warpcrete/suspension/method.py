"""Method record of mortars with aggregates, through which the program runs, draws and reports such scenes."""

from dataclasses import replace
from functools import partial

from ..mps.free.forecast import forecast
from ..mps.free.method import METHOD as FREE_FLOWS
from .display import SuspensionDisplay
from .simulation import SuspensionSimulation

METHOD = replace(
    FREE_FLOWS,
    name="suspension",
    simulation=SuspensionSimulation,
    display=SuspensionDisplay,
    forecast=partial(forecast, make=SuspensionSimulation),
)
