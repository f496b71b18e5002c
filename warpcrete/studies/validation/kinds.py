"""Kinds of measurements that predictions are compared with: what is measured, and its SI unit."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Kind:
    """Kind of measurement."""

    label: str
    unit: str


KINDS = {
    "pipe": Kind("friction of straight pipe", "Pa/m"),
    "ratio": Kind("friction relative to another concrete", "1"),
    "line": Kind("friction of a whole line", "Pa"),
    "layer": Kind("wall stress of the slip layer", "Pa"),
    "profile": Kind("share of the layer in the velocity", "1"),
    "slump": Kind("slump", "m"),
    "spread": Kind("spread", "m"),
    "funnel": Kind("time of the V-funnel", "s"),
}
"""Kinds of measurements by name."""
