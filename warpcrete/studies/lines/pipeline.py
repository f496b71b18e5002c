"""Pressure of a whole pipeline, extrapolated from pressures of short pipe units (Zhan et al. 2019, Eq. 13)."""

from typing import Any

from ...core.errors import RunFolderError, at_least, between, one_of, refuse
from ...core.run.run import Run
from ...core.units import number, quantity
from ...dem.measure.quantities import WINDOW, past_ramp

STRAIGHT_UNITS = ("vertical", "horizontal")


def pipeline_pressure(vertical: float, horizontal: float, height: float, distance: float) -> float:
    """Return the total pressure [Pa] from pressures per metre of pipe [Pa/m] and the lengths of pipe [m].

    Zhan et al. (2019), Eq. 13, adds `vertical` times `height` and `horizontal` times `distance`. Raises
    :class:`SceneError` for a negative length.
    """
    between("pipeline vertical length", height, 0, float("inf"), "m")
    between("pipeline horizontal length", distance, 0, float("inf"), "m")
    return vertical * height + horizontal * distance


def check_pipeline(scene: Any, other: dict[str, Any] | None, source: Any) -> None:
    """Refuse a scene or a second result to which Eq. 13 of Zhan et al. (2019) cannot be applied.

    Eq. 13 combines the results of a vertical and of a horizontal pipe. `scene` is the scene of one of these pipes, and
    `other` the result of a run with the other pipe. `source` is the place from which `other` was read, for error
    messages. Raises :class:`SceneError` for the scene and :class:`RunFolderError` for the result.
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


def pipeline_estimate(
    run: Run, height: float, distance: float, other: dict[str, Any] | None = None
) -> dict[str, Any] | None:
    """Return the pressure of a pipeline by Zhan's Eq. 13 from the plateau pressure of `run`; None without a plateau.

    `height` and `distance` are the lengths of vertical and horizontal pipe in the pipeline [m]. The run pumps through a
    vertical or a horizontal pipe and gives the pressure per metre in this direction. `other` is the content of the
    result.json of a run in the other direction, and gives the pressure per metre in that direction. Without `other`,
    the weight of the concrete is subtracted or added instead, and the result states this assumption.
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
