"""Implicit moving particles, as the rest of the program sees them."""

from ..core.method import Method, run_in_turn
from .display import FlowDisplay
from .forecast import forecast
from .pictures import draw, plot_flow
from .quantities import QUANTITIES, report
from .simulation import FluidSimulation

METHOD = Method(
    name="mps",
    simulation=FluidSimulation,
    quantities=QUANTITIES,
    display=FlowDisplay,
    picture="flow.png",
    draw=draw,
    show=plot_flow,
    report=report,
    forecast=forecast,
    run_many=run_in_turn,
)
