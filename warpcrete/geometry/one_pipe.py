"""Pipelines that a scene simulates as one pipe: parameters from their file or mesh, and checks of their shape."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..core.errors import refuse
from ..core.inputs.amounts import amount
from ..core.inputs.parameters import Needs
from ..core.inputs.text_files import errors_located_at
from ..core.records import SceneArguments
from .axis import Axis, Line
from .bores import Bores
from .lines import line_file
from .mesh_parts import WAYS, Way, bore_of
from .pipe_line import PipeLine

IN_BENDS = Needs("unit", lambda unit: unit.startswith("bend"), "is a bend", refused=False)
"""Rule for scene parameters that are dimensions of a bend: they have an effect only if the parameter `unit` names a
bend."""

MAX_LENGTH_RATIO = 10_000
"""Largest length of a simulated pipe divided by the pipe's diameter."""


def parameters_from_line(values: Mapping[str, object]) -> SceneArguments:
    """Return the flow [m3/s] and the concrete stated in the file of the pipeline `line`, which is a scene parameter.

    `values` are the parameters of the scene. The result is empty if `values` contains no line, or contains both the
    flow and the concrete, as in the record of a run.
    """
    if values.get("line") is None or ("flow" in values and "concrete" in values):
        return {}
    given, _ = line_file(values["line"])
    with errors_located_at(given, "flow"):
        parameters = {"flow": amount("flow", given["flow"], "m3/s")} if "flow" in given else {}
    return parameters | ({"concrete": str(given["concrete"])} if "concrete" in given else {})


def parameters_from_mesh(values: Mapping[str, object], ways: Sequence[Way] = WAYS) -> SceneArguments:
    """Return the parameters that follow from the mesh `wall` of a scene: `unit` and the inlet's `diameter` [m].

    `values` holds the parameters that the user set. The parameter `unit` is the kind of pipe, here "mesh". The result
    is empty without a mesh, or if `values` names another unit. `ways` are the directions in which the bore may begin at
    the mesh's origin.
    """
    wall, unit = values.get("wall"), values.get("unit", "mesh")
    if wall is None or unit != "mesh" or values.get("line") is not None:
        return {}
    if "diameter" in values:
        return {"unit": unit}
    scale = values.get("wall_scale", 1.0)
    if not isinstance(wall, (str, Path)) or not isinstance(scale, (int, float)) or not 0 < scale < math.inf:
        return {"unit": unit}  # Leave wrong values to the checks of the scene's parameters, which report them later.
    return {
        "unit": unit,
        "diameter": float(f"{bore_of(('wall', 'wall_scale'), Path(wall), scale, ways=ways).ends[0]:.6g}"),
    }


def ends(line: PipeLine) -> np.ndarray:
    """Return the arc lengths [m] where the parts of a pipeline begin, then its length [m], shape (parts + 1,)."""
    return np.concatenate([[0.0], np.cumsum([part.length for part in line.parts])])


def check_straight_ends(line: PipeLine, name: object) -> None:
    """Refuse a pipeline that a scene cannot simulate as a whole: it must begin and end straight and have no valve.

    `name` is the name of the pipeline in the message.
    """
    for part in line.parts:
        if part.kind == "valve":
            refuse("line", name, f"has a valve (part {part.number}), which a scene cannot simulate",
                   "simulate the line with 'warpcrete line', or replace the valve by a straight pipe or a bore from a "
                   "mesh")  # fmt: skip
    for place in (0, -1):
        if line.parts[place].kind != "straight":
            refuse("line", name, f"must begin and end with a straight part, but part {line.parts[place].number} is a "
                   f"{line.parts[place].kind}", "add a part 'straight' at this end")  # fmt: skip


def joined(axis: Axis) -> Axis:
    """Return an axis of the same shape whose successive straight pieces are joined into one piece."""
    pieces = list(axis.pieces[:1])
    for piece in axis.pieces[1:]:
        if isinstance(piece, Line) and isinstance(pieces[-1], Line):
            pieces[-1] = Line(pieces[-1].length + piece.length)
        else:
            pieces.append(piece)
    return replace(axis, pieces=tuple(pieces))


def check_return(axis: Axis, bores: Bores, begin: float = 0.0, aside: float = math.inf) -> None:
    """Refuse a pipe that crosses the plane of its own inlet or outlet twice, or is too long to be simulated.

    The inlet plane crosses the pipe at right angles at the arc length `begin` [m] and extends `aside` [m] from the
    axis. The outlet plane crosses the end of the pipe at right angles and has no limit.
    """
    if axis.length > MAX_LENGTH_RATIO * 2 * bores.largest:
        hint = "shorten the line, or use 'warpcrete line', which simulates its parts one by one"
        refuse("line", f"{axis.length:.6g} m", f"is longer than {MAX_LENGTH_RATIO:,} diameters", hint)
    s = np.linspace(0, axis.length, max(400, math.ceil(8 * axis.length / bores.largest)))
    points, tangents = axis.at(s)
    start = axis.at(begin)[0]
    reach = bores.largest
    ahead = (points - start) @ tangents[0]
    beside = np.linalg.norm(points - start - ahead[:, None] * tangents[0], axis=1) < aside + reach
    if np.any(ahead[(s > begin + 2 * reach) & beside] < reach):
        problem = "crosses the plane of its inlet again"
        refuse("line", f"{axis.length:.3g} m", problem, "shorten the line, or reduce the angles of its bends")
    behind = (points[-1] - points) @ tangents[-1]
    if np.any(behind[s < axis.length - 2 * reach] < reach):
        problem = "crosses the plane of its outlet before its end"
        refuse("line", f"{axis.length:.3g} m", problem, "shorten the line, or reduce the angles of its bends")
