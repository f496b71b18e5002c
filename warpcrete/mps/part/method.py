"""Interface through which the program finds, runs, draws and reports flows through parts of a pump line."""

from ...core.run.method import Method
from ..common.stepping import run_abreast
from .display import PartDisplay
from .forecast import forecast
from .pictures import plot_part
from .quantities import QUANTITIES, report
from .simulation import PartSimulation

METHOD = Method(
    name="mps",
    simulation=PartSimulation,
    list_quantities=lambda: QUANTITIES,
    display=PartDisplay,
    picture="flow.png",
    show=plot_part,
    report=report,
    forecast=forecast,
    run_many=run_abreast,
)
