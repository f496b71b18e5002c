"""Pressure of a whole pipeline from unit pressures (Zhan et al. 2019, Eq. 13)."""

from __future__ import annotations

from typing import Any

from .errors import between
from .series import quantity
from .spine import Run


def pipeline_pressure(vertical: float, horizontal: float, height: float, distance: float) -> float:
    """Total pressure [Pa] from pressure per metre of vertical and horizontal pipe [Pa/m] and their lengths [m]."""
    between("pipeline vertical length", height, 0, float("inf"), "m")
    between("pipeline horizontal length", distance, 0, float("inf"), "m")
    return vertical * height + horizontal * distance


def pipeline_estimate(run: Run, height: float, distance: float, other: dict[str, Any] | None = None) -> dict[str, Any]:
    """Eq. 13 with the plateau of `run` for its own direction.

    The other direction comes from `other`, the result.json of a run of the other straight unit; without one it
    is this run's plateau less (or plus) the weight of the concrete, an assumption that the result names.
    """
    unit = run.scene.notes.get("unit")
    own = run.result["plateau_pressure"]["value"] / run.scene.notes["concrete_length"]
    gravity = -run.scene.gravity[2]
    solids = run.bodies.mass[[g == "" for g in run.bodies.group]].sum()
    weight = float(solids) * gravity / (run.scene.notes["pressure_area"] * run.scene.notes["concrete_length"])
    upward = unit == "vertical"
    if other is not None:
        rest = other["plateau_pressure"]["value"] / other["concrete_length"]["value"]
        source = f"plateau of the {other['unit']} run"
    else:
        rest = own - weight if upward else own + weight
        source = "this run's plateau " + ("less" if upward else "plus") + " the weight of the concrete (assumed)"
    vertical, horizontal = (own, rest) if upward else (rest, own)
    return {
        "vertical_length": quantity(height, "m"),
        "horizontal_length": quantity(distance, "m"),
        "vertical_per_metre": quantity(vertical, "Pa/m"),
        "horizontal_per_metre": quantity(horizontal, "Pa/m"),
        "other_direction_from": source,
        "total_pressure": quantity(pipeline_pressure(vertical, horizontal, height, distance), "Pa"),
    }
