"""A line as one pipe: what its file says of a run, where it is no straight pipe, and where it may not lead."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.amounts import amount
from ..core.errors import refuse
from ..core.text_files import within
from .axis import Axis, Line
from .bores import Bores
from .lines import PipeLine, line_file
from .mesh_parts import WAYS, Way, bore_of

LONGEST = 10_000
"""Diameters, of a pipe that is run."""


def said_by_line(values: Mapping[str, Any]) -> dict[str, Any]:
    """Flow [m3/s] and concrete that the file of the `line` among a scene's parameters has; nothing without one, or
    where both are given, as in a run's record.
    """
    if values.get("line") is None or ("flow" in values and "concrete" in values):
        return {}
    given, _ = line_file(values["line"])
    with within(given, "flow"):
        found = {"flow": amount("flow", given["flow"], "m3/s")} if "flow" in given else {}
    return found | ({"concrete": str(given["concrete"])} if "concrete" in given else {})


def said_by_mesh(values: Mapping[str, Any], ways: Sequence[Way] = WAYS) -> dict[str, Any]:
    """Return unit and inlet diameter [m] for the mesh `wall` among a scene's parameters, if they name no other unit.

    The mesh may lead in one of the directions `ways` at its origin.
    """
    wall, unit = values.get("wall"), values.get("unit", "mesh")
    if wall is None or unit != "mesh" or values.get("line") is not None:
        return {}
    if "diameter" in values:
        return {"unit": unit}
    scale = values.get("wall_scale", 1.0)
    if not isinstance(wall, (str, Path)) or not isinstance(scale, (int, float)) or not 0 < scale < math.inf:
        return {"unit": unit}  # the rules of these parameters say what is wrong
    return {
        "unit": unit,
        "diameter": float(f"{bore_of(('wall', 'wall_scale'), Path(wall), scale, ways=ways).ends[0]:.6g}"),
    }


def ends(line: PipeLine) -> np.ndarray:
    """Arc lengths at which its parts begin, and at which it ends, shape (parts + 1,) [m]."""
    return np.concatenate([[0.0], np.cumsum([part.length for part in line.parts])])


def check_straight_ends(line: PipeLine, name: Any) -> None:
    """Refuse a line, given by this `name`, that does not begin and end with a straight part."""
    for place in (0, -1):
        if line.parts[place].kind != "straight":
            refuse("line", name, f"must begin and end straight: part {line.parts[place].number} is a "
                   f"{line.parts[place].kind}", "put a straight part there")  # fmt: skip


def joined(axis: Axis) -> Axis:
    """The same axis with its straight pieces in a row as one."""
    pieces = list(axis.pieces[:1])
    for piece in axis.pieces[1:]:
        if isinstance(piece, Line) and isinstance(pieces[-1], Line):
            pieces[-1] = Line(pieces[-1].length + piece.length)
        else:
            pieces.append(piece)
    return replace(axis, pieces=tuple(pieces))


def check_return(axis: Axis, bores: Bores, begin: float = 0.0, aside: float = math.inf) -> None:
    """Refuse a pipe that comes back past the plane across it at the arc length `begin` [m], as far as it is less than
    `aside` [m] beside the axis there, or past the endless plane across its end; or one too long to run at all.
    """
    if axis.length > LONGEST * 2 * bores.largest:
        refuse("line", f"{axis.length:.6g} m", f"is longer than {LONGEST:,} diameters", "cut it: the command line adds "
               "up a line's parts")  # fmt: skip
    s = np.linspace(0, axis.length, max(400, math.ceil(8 * axis.length / bores.largest)))
    points, tangents = axis.at(s)
    start = axis.at(begin)[0]
    reach = bores.largest
    ahead = (points - start) @ tangents[0]
    beside = np.linalg.norm(points - start - ahead[:, None] * tangents[0], axis=1) < aside + reach
    if np.any(ahead[(s > begin + 2 * reach) & beside] < reach):
        refuse("line", f"{axis.length:.3g} m", "comes back past the plane in which it begins",
               "cut it, or turn it less")  # fmt: skip
    behind = (points[-1] - points) @ tangents[-1]
    if np.any(behind[s < axis.length - 2 * reach] < reach):
        refuse("line", f"{axis.length:.3g} m", "comes back past the plane in which it ends", "cut it, or turn it less")
