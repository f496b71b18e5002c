"""Interface of the discrete element method to the rest of the program."""

from ..core.run.method import Method
from .batch_run import run_batch
from .forecast import forecast
from .measure.display import ElementDisplay
from .measure.quantities import quantities, report
from .measure.wear_results import plot_wear
from .pictures import draw, plot_aggregates
from .scene.checks import check_elements
from .simulation import ElementSimulation

METHOD = Method(
    name="dem",
    simulation=ElementSimulation,
    list_quantities=quantities,
    display=ElementDisplay,
    picture="pressure.png",
    draw=draw,
    show=plot_aggregates,
    report=report,
    forecast=forecast,
    run_many=run_batch,
    check=check_elements,
    more_pictures=lambda run: {"wear.png": plot_wear(run)},
)
