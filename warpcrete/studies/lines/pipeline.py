"""Pressure of a whole pipeline, extrapolated from pressures of short pipe units (Zhan et al. 2019, Eq. 13)."""

from typing import Any

from ...core.errors import RunFolderError, at_least, between, one_of, refuse
from ...core.records import Record
from ...core.run.run import Run
from ...core.units import number, quantity
from ...dem.measure.quantities import WINDOW, past_ramp

STRAIGHT_UNITS = ("vertical", "horizontal")


def pipeline_pressure(vertical: float, horizontal: float, height: float, distance: float) -> float:
    """Return the total pressure [Pa] of a pipeline by Eq. 13 of Zhan et al. (2019).

    The pressure is vertical * height + horizontal * distance. `vertical` and `horizontal` are the pressures per metre
    of vertical and of horizontal pipe [Pa/m], `height` and `distance` the lengths of these pipes [m]. Raises
    :class:`SceneError` for a negative length.
    """
    between("pipeline vertical length", height, 0, float("inf"), "m")
    between("pipeline horizontal length", distance, 0, float("inf"), "m")
    return vertical * height + horizontal * distance


def check_pipeline(scene: Any, other: Record | None, source: object) -> None:
    """Check that Eq. 13 of Zhan et al. (2019) can be applied to a scene and to the result of an earlier run.

    Eq. 13 combines the results of a vertical and of a horizontal pipe. `scene` is the scene of one of these pipes, and
    `other` the result of an earlier run of the other pipe, or None. `source` is the folder from which `other` was read,
    for error messages. Raises :class:`SceneError` if the scene is unsuitable, and :class:`RunFolderError` if the result
    is unsuitable.
    """
    pipe = getattr(scene, "pipe", None)
    if pipe is None:
        problem = "needs a straight pipe of discrete elements (Eq. 13 of Zhan et al. 2019)"
        refuse("pipeline", scene.name, problem, "use the scene pipe")
    one_of("unit", pipe.name, STRAIGHT_UNITS)
    if not past_ramp(scene, pipe.travel):
        problem = f"is too short for a plateau of the pressure, which Eq. 13 needs (ramp {pipe.ramp:g} m)"
        hint = f"set 'travel' to {at_least(pipe.ramp / (1 - WINDOW))} m or more, or reduce 'ramp'"
        refuse("travel", pipe.travel, problem, hint)
    if other is not None:
        if not other.get("finished") or "plateau_pressure" not in other or "concrete_length" not in other:
            raise RunFolderError(
                f"pipeline_other = '{source}': is not a finished run of the scene pipe with a constant pressure at its "
                "end; give the folder of such a run"
            )
        one_of("unit of pipeline_other", other.get("unit"), [u for u in STRAIGHT_UNITS if u != pipe.name])


def pipeline_estimate(run: Run, height: float, distance: float, other: Record | None = None) -> Record | None:
    """Return the pressure of a pipeline by Zhan's Eq. 13 from the plateau pressure of `run`; None without a plateau.

    `height` and `distance` are the lengths of vertical and horizontal pipe in the pipeline [m]. The run, which pumps
    through a vertical or a horizontal pipe, gives the pressure per metre in this direction. The pressure per metre in
    the other direction comes from `other`, the contents of the result.json of a second run. If `other` is None, it is
    estimated from the first run: the weight of the concrete is subtracted for a horizontal pipe, and added for a
    vertical one. The result states this assumption.
    """
    if "plateau_pressure" not in run.result:
        return None
    pipe = run.scene.pipe
    own = number(run.result["plateau_pressure"]) / pipe.concrete_length
    gravity = -run.scene.gravity[2]
    bodies = run.bodies  # type: ignore[attr-defined]
    solids = bodies.mass[[g == "" for g in bodies.group]].sum()
    weight = float(solids) * gravity / (run.scene.pressure.area * pipe.concrete_length)
    upward = pipe.name == "vertical"
    if other is not None:
        rest = number(other["plateau_pressure"]) / number(other["concrete_length"])
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
