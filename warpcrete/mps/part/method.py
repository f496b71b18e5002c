"""Flows through parts of a line, as the rest of the program sees them."""

from ...core.method import Method
from ..stepping import run_abreast
from .display import PartDisplay
from .forecast import forecast
from .pictures import draw, plot_part
from .quantities import QUANTITIES, report
from .simulation import PartSimulation

METHOD = Method(
    name="mps",
    simulation=PartSimulation,
    quantities=QUANTITIES,
    display=PartDisplay,
    picture="flow.png",
    draw=draw,
    show=plot_part,
    report=report,
    forecast=forecast,
    run_many=run_abreast,
)
