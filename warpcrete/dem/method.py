"""Interface of the discrete element method to the rest of the program."""

from ..core.method import Method
from .batch_run import run_batch
from .display import ElementDisplay
from .forecast import forecast
from .pictures import draw, plot_aggregates
from .quantities import QUANTITIES, report
from .simulation import ElementSimulation
from .worn import plot_wear

METHOD = Method(
    name="dem",
    simulation=ElementSimulation,
    quantities=QUANTITIES,
    display=ElementDisplay,
    picture="pressure.png",
    draw=draw,
    show=plot_aggregates,
    report=report,
    forecast=forecast,
    run_many=run_batch,
    more_pictures=lambda run: {"wear.png": plot_wear(run)},
)
