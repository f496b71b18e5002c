"""Calibrations of tests: targets, and runs of a round that take the values of closed forms."""

import importlib
import math
import zlib

import numpy as np

from warpcrete.methods import method_of
from warpcrete.scenes import modules
from warpcrete.studies.calibration.targets import task_of

SEARCH = importlib.import_module("warpcrete.studies.calibration.calibrate")
SLUMP = {"scene": "slump", "parameters": {"concrete": "own", "density": 2350.0}}
FUNNEL = {"scene": "funnel", "parameters": {"concrete": "own", "density": 2350.0}}
TUBE = {"scene": "tube", "parameters": {"concrete": "own", "density": 2350.0, "viscosity": 40.0, "yield_stress": 60.0}}
RANGES = {"viscosity": (10.0, 100.0), "yield_stress": (20.0, 150.0), "slip_viscosity": (300.0, 3000.0),
          "slip_yield": (0.0, 100.0)}  # fmt: skip


def tube(flow, free=()):
    held = {name: value for name, value in TUBE["parameters"].items() if name not in free}
    return {"scene": "tube", "parameters": held | {"flow": flow}}


def task(vary, *targets):
    return {"vary": {name: list(RANGES[name]) for name in vary}, "targets": list(targets)}


def asked(target, quantity, value, uncertainty="3%", **more):
    return {**target, "quantity": quantity, "value": value, "uncertainty": uncertainty, **more}


def one_pressure():
    raw = task(("slip_viscosity",), asked(tube(1.5e-3), "pressure", 9000.0))
    raw["targets"][0]["parameters"]["slip_yield"] = 10.0
    return raw


def by_closed_form(scatter):
    """Return a stand-in for the runs of a round: values of closed forms, times a random scatter set by the seed.

    Coarse runs are up to a tenth wrong, by an error that changes smoothly with the parameters.
    """

    def run_round(found, scenes, place, trials, where, tell, part):
        for trial in trials:
            values = found.task.values(trial.units)
            for target in found.task.targets:
                module = scenes[target.scene]
                scene = module.scene(**found.task.parameters(target, values, module))
                random = np.random.default_rng([trial.seed, zlib.crc32(target.label.encode())])
                expected = method_of(scene).expected(scene).get(target.quantity, math.nan)
                wrong = (
                    0.1 * math.sin(2 + 2 * sum(trial.units)) if trial.coarse and target.key in found.coarsened else 0
                )
                trial.values[target] = expected * (1 + scatter * random.normal()) * (1 + wrong)
        return True

    return run_round


def truth_of(raw, values):
    """Return the closed-form value of each target of a task at the given parameter values."""
    here = task_of(raw, modules())
    found = []
    for target in here.targets:
        module = modules()[target.scene]
        scene = module.scene(**here.parameters(target, values, module))
        found.append(method_of(scene).expected(scene)[target.quantity])
    return found
