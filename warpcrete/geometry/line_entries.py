"""Entries of a pipeline file: their names, units and meaning."""

from __future__ import annotations

TEXTS = {
    "name": "name of the line",
    "source": "origin of its data",
    "concrete": "name of a concrete, or the path of its file beside this one",
}
"""Entries of a pipeline file that hold text, with their meaning."""
AMOUNTS = {
    "recorded": ("Pa", "pressure that was recorded at the pump"),
    "diameter": ("m", "inner diameter of the first part"),
    "flow": ("m3/s", "volume flow"),
    "largest_stone": ("m", "largest stone of the concrete"),
}
"""Entries of a pipeline file that hold positive numbers, with their units and meaning."""
KEYS = ("name", "source", "recorded", "diameter", "flow", "concrete", "largest_stone", "begin", "parts")
PARTS = {
    "straight": {
        "length": ("m", "length of its axis"),
        "rise": ("m", "height that it gains, to check where the line goes"),
        "diameter": ("m", "inner diameter, to check that the parts fit"),
    },
    "bend": {
        "angle": ("degrees", "angle; the default goes all the way that 'to' names"),
        "radius": ("m", "radius of its centreline"),
        "to": ("", "direction in which it leads"),
    },
    "reducer": {"to": ("m", "inner diameter behind it"), "length": ("m", "length of its axis")},
    "hose": {
        "points": ("m", "points along its axis from where it begins: ahead, to the left, up"),
        "layer": ("1", "resistance of its slip layer over that of a pipe"),
    },
    "bore": {
        "file": ("", "mesh file beside this one, which begins at its origin and leads along its x"),
        "scale": ("1", "factor from the unit of the mesh to metres, 0.001 for mm"),
        "length": ("m", "length along the line"),
        "outlet": ("m", "inner diameter behind it"),
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
"""Quantity whose permitted range also applies to an entry of a different name."""
MOST_PARTS, MOST_POINTS = 2000, 500
"""Largest numbers of parts in a line and of points in a hose; the longest lines ever pumped have some hundred parts."""
BEGINS = {"level": (1.0, 0.0, 0.0), "up": (0.0, 0.0, 1.0), "down": (0.0, 0.0, -1.0)}
WAYS = ("up", "down", "left", "right", "level", "back")
