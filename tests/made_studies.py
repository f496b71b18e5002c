"""Results of runs and trades that are made up, so that studies of them take no time."""

import contextlib
import importlib
import io

import numpy as np

from warpcrete.studies.tradeoffs.points import COMBINED, GIVEN, REFERENCE
from warpcrete.studies.tradeoffs.state import Trade

FAILED = {"balance": {"passed": False, "found": "9 %"}, "finished": {"passed": True, "found": "1 s"}}


def printed(report, found):
    """Return what a report prints, without the name of the folder, and the exit code if it ends the program."""
    code = None
    with contextlib.redirect_stdout(io.StringIO()) as text:
        try:
            report(found)
        except SystemExit as ended:
            code = ended.code
    return [*text.getvalue().replace(str(found.folder), "FOLDER").splitlines(), code]


def measured(k, **more):
    """Return the content of a result.json that depends only on the number of the run."""
    speed = {
        "packing_time": {"value": 1.0 + k, "unit": "s"},
        "settling_time": {"value": 0.25, "unit": "s"},
        "wall_time": {"value": 10.0 + k**2, "unit": "s"},
        "memory": {"value": 1e7 + 1e6 * k, "unit": "B"},
    }
    pressure = 2e4 + 700 * np.sin(1.0 + k)
    return {
        "finished": True,
        "steps": 1000 + 10 * k,
        "spheres": 50 + k,
        "speed": speed,
        "checks": {},
        "peak_pressure": {"value": pressure, "unit": "Pa"},
        "end_pressure": {"value": 0.8 * pressure, "unit": "Pa"},
        "coordination_number": 5 + 0.1 * k,
    } | more


def made_trade(folder, **more):
    """Return a trade of the pipe with results for the scene as given, single knobs, all knobs, and a failed run."""
    pipe = importlib.import_module("warpcrete.scenes.pipe")
    record = {
        "scene": "pipe",
        "parameters": {"seed": 2},
        "quantities": ["peak_pressure", "end_pressure"],
        "knobs": ["time step", "coarse-graining"],
        "repeat": 3,
        "seeded": True,
        "device": "cpu",
        "threads": 2,
        "provenance": {"device_name": "cpu", "processor": "a processor"},
    } | more
    trade = Trade(folder, pipe, record)
    trade.point(GIVEN, {})
    trade.point(REFERENCE, {knob.name: len(knob.levels) - 1 for knob in trade.knobs})
    for knob in trade.knobs:
        for level in range(len(knob.levels)):
            trade.point(knob.name, {knob.name: level})
    trade.point(COMBINED, {knob.name: 0 for knob in trade.knobs})
    for number, point in enumerate(trade.points):
        for seed in trade.seeds:
            point.results[seed] = measured(3 * number + seed, checks=FAILED if number == 2 else {})
    trade.points[3].results[99] = measured(40)  # a fresh seed, which is no part of the comparison
    failed = trade.points[4]
    failed.failures[3] = "failed: it burst"
    trade.judge()
    return trade
