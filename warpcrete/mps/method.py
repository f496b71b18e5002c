"""Interface through which the program finds, runs, draws and reports flows in pipes."""

from ..core.run.method import Method
from .common.stepping import run_abreast
from .display import FlowDisplay
from .forecast import forecast
from .pictures import draw, plot_flow
from .quantities import QUANTITIES, expected, report
from .simulation import FluidSimulation

METHOD = Method(
    name="mps",
    simulation=FluidSimulation,
    list_quantities=lambda: QUANTITIES,
    display=FlowDisplay,
    picture="flow.png",
    draw=draw,
    show=plot_flow,
    report=report,
    forecast=forecast,
    run_many=run_abreast,
    expected=expected,
)
