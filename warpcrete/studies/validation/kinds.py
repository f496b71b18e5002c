"""Kinds of measurements with which predictions are compared, each with its quantity and SI unit."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Kind:
    """Kind of measurement: a label that says what is measured, the SI unit, and the required dimensions."""

    label: str
    unit: str
    test: tuple[str, ...] = ()
    """Entries of a case's section `test`, all of which the prediction needs."""


KINDS = {
    "pipe": Kind("friction of straight pipe", "Pa/m", ("diameter",)),
    "ratio": Kind("friction relative to another concrete", "1", ("diameter", "reference")),
    "line": Kind("friction of a whole line", "Pa", ("line",)),
    "fitting": Kind("friction of a bend relative to straight pipe", "1", ("diameter", "part")),
    "layer": Kind("wall stress of the slip layer", "Pa", ("speed",)),
    "profile": Kind("share of the layer in the velocity", "1", ("diameter",)),
    "slump": Kind("slump", "m"),
    "spread": Kind("spread", "m"),
    "funnel": Kind("time of the V-funnel", "s"),
}
"""Kinds of measurements whose value is compared with a prediction. The keys are the names that cases state as their
kind."""
BLOCKING = "blocking"
"""Kind of case that says whether concrete blocked: its measured value is 1 if it did, and 0 if not."""
TESTS = {name: kind.test for name, kind in KINDS.items()} | {BLOCKING: ("bore",)}
"""Entries of the section `test` of a case, by its kind."""
AMOUNTS = {"diameter": "m", "bore": "m", "speed": "m/s"}
"""SI unit of those entries of the section `test` that are amounts."""
UNITS = {name: kind.unit for name, kind in KINDS.items()} | {BLOCKING: "1"}
"""SI unit of the measured values for each kind of case."""
