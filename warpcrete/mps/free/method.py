"""Interface through which the program finds, runs, draws and reports free-surface flows."""

from ...core.run.method import Method
from ..common.stepping import run_abreast
from .display import FreeDisplay
from .forecast import forecast
from .pictures import plot_free
from .quantities import expected, quantities, report
from .simulation import FreeSimulation

METHOD = Method(
    name="mps",
    simulation=FreeSimulation,
    list_quantities=quantities,
    display=FreeDisplay,
    picture="flow.png",
    show=plot_free,
    report=report,
    forecast=forecast,
    run_many=run_abreast,
    expected=expected,
)
