"""Entry of mortars with aggregates in the list of methods, through which the program runs, draws and reports them."""

from dataclasses import replace

from ..mps.free.method import METHOD as FREE_FLOWS
from .display import SuspensionDisplay
from .simulation import SuspensionSimulation

METHOD = replace(FREE_FLOWS, name="suspension", simulation=SuspensionSimulation, display=SuspensionDisplay)
