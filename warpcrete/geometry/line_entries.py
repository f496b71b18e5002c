"""Entries of a pipeline file: their names, units and meaning."""

from __future__ import annotations

TEXTS = {
    "name": "Name of the line",
    "source": "Source of the data",
    "concrete": "Name of a concrete, or the path of its file relative to this file",
}
"""Entries of a pipeline file that hold text, with their meaning."""
AMOUNTS = {
    "recorded": ("Pa", "Pressure measured at the pump"),
    "diameter": ("m", "Inner diameter of the first part"),
    "flow": ("m3/s", "Volume flow"),
    "largest_stone": ("m", "Size of the largest aggregate of the concrete"),
}
"""Entries of a pipeline file that hold positive numbers, with their units and meaning."""
KEYS = ("name", "source", "recorded", "diameter", "flow", "concrete", "largest_stone", "begin", "parts")
PARTS = {
    "straight": {
        "length": ("m", "Length of its axis"),
        "rise": ("m", "Height gained; only checked against the direction of the line"),
        "diameter": ("m", "Inner diameter; only checked against the part before it"),
    },
    "bend": {
        "angle": ("degrees", "Angle of the bend; default: such that it ends in the direction 'to'"),
        "radius": ("m", "Radius of its centreline"),
        "to": ("", "Direction in which the bend leads"),
    },
    "reducer": {"to": ("m", "Inner diameter behind it"), "length": ("m", "Length of its axis")},
    "hose": {
        "points": ("m", "Points of its axis relative to its start: distance ahead, to the left, up"),
        "layer": ("1", "Resistance of its slip layer divided by that of a pipe"),
    },
    "bore": {
        "file": (
            "",
            "Mesh file, relative to this file; the bore begins at the origin of the mesh and leads along its x axis",
        ),
        "scale": ("1", "Factor from the unit of the mesh to metres, 0.001 for mm"),
        "length": ("m", "Length along the line"),
        "outlet": ("m", "Inner diameter behind it"),
    },
}
"""Kinds of pipeline parts, each with its entries, their units and meaning. A part given as a single value states its
first entry."""
LIMITED_AS = {
    "largest_stone": "size_max",
    "recorded": "pressure",
    "to": "diameter",
    "outlet": "diameter",
    "radius": "bend_radius",
}
"""Names of quantities whose limits (:mod:`warpcrete.core.inputs.limits`) apply to pipeline entries of another name."""
MOST_PARTS, MOST_POINTS = 2000, 500
"""Largest numbers of parts in a line and of points in a hose; the longest lines ever pumped have some hundred parts."""
BEGINS = {"level": (1.0, 0.0, 0.0), "up": (0.0, 0.0, 1.0), "down": (0.0, 0.0, -1.0)}
WAYS = ("up", "down", "left", "right", "level", "back")
