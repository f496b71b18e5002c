"""Entries of a pipeline file: their names, units and meaning."""

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
KEYS = ("name", "source", "recorded", "diameter", "flow", "concrete", "largest_stone", "pump", "begin",
        "bend_factor", "parts")  # fmt: skip
BEND_FACTOR = {
    "factor": "Friction of a bend without a factor of its own, divided by the friction of equally long straight pipe",
    "low": "Smallest possible factor of a bend",
    "high": "Largest possible factor of a bend",
}
"""Entries of `bend_factor` in a pipeline file, with their meaning. A single number instead of these entries is the
factor."""
PARTS = {
    "straight": {
        "length": ("m", "Length of the pipe's axis"),
        "rise": ("m", "Height gained; only checked against the direction of the line"),
        "diameter": ("m", "Inner diameter; only checked against the part before it"),
    },
    "bend": {
        "to": ("", "Direction in which the bend leads"),
        "angle": ("degrees", "Angle of the bend; default: the angle after which the line leads in the direction 'to'"),
        "radius": ("m", "Radius of the bend's centreline; default: 0.5 m, or two diameters if these are larger"),
    },
    "reducer": {"to": ("m", "Inner diameter behind the reducer"), "length": ("m", "Length of its axis; default: 1 m")},
    "hose": {
        "length": ("m", "Length of a hose that leads straight on; instead of points"),
        "points": ("m", "Points of the hose's axis relative to its start: distance ahead, to the left, up"),
        "layer": ("1", "Resistance of the hose's slip layer divided by the resistance of the slip layer in a pipe"),
    },
    "valve": {"length": ("m", "Length of the valve's axis; default: four diameters")},
    "bore": {
        "file": (
            "",
            "Mesh file, relative to this file; the bore begins at the origin of the mesh and leads along its x axis",
        ),
        "scale": ("1", "Factor from the unit of the mesh to metres, 0.001 for mm"),
        "length": ("m", "Length along the line"),
        "outlet": ("m", "Inner diameter behind the bore"),
    },
}
"""Kinds of pipeline parts, each with its entries, their units and their meaning. If a pipeline file states a single
value for a part instead of entries, it is the value of the first entry listed here."""
WITHOUT_ENTRIES = ("valve",)
"""Kinds of pipeline parts all of whose entries are optional, so that a file may contain just the name of the part."""
PART_HINTS = {
    **dict.fromkeys(("pipe", "level", "horizontal", "length"), "write 'straight: 10 m'"),
    **dict.fromkeys(
        ("vertical", "riser", "rise", "up"),
        "write 'bend: up' and then 'straight: 10 m', or 'begin: up' for a line that starts upwards",
    ),
    "down": "write 'bend: down' and then 'straight: 10 m'",
    **dict.fromkeys(("elbow", "curve", "arc"), "write 'bend: up', or 'bend: {to: up, angle: 45}'"),
    **dict.fromkeys(("taper", "cone", "reduction"), "write 'reducer: {to: 100 mm, length: 1 m}'"),
    **dict.fromkeys(("rubber", "tip", "end_hose", "flexible"), "write 'hose: 5 m'"),
}
"""Corrections for words that users write instead of a kind of part."""
STATED = {
    "factor": (
        "1",
        "Friction of the part divided by the friction of equally long straight pipe, instead of the program's model",
    ),
    "equivalent": ("m", "Length of straight level pipe with the friction of the part, instead of the program's model"),
}
"""Entries of a pipeline file that state the friction of a part; they are allowed for every kind of part."""
PARTS = {kind: {**entries, **STATED} for kind, entries in PARTS.items()}
LIMITED_AS = {
    "largest_stone": "size_max",
    "to": "diameter",
    "outlet": "diameter",
    "radius": "bend_radius",
    "equivalent": "length",
}
"""Names of pipeline entries, each with the name of the quantity whose limits (:mod:`warpcrete.core.inputs.limits`)
apply to the entry."""
MOST_PARTS, MOST_POINTS = 2000, 500
"""Largest number of parts in a pipeline, and largest number of points in a hose. The longest pipelines ever used for
concrete have some hundred parts."""
BEGINS = {"level": (1.0, 0.0, 0.0), "up": (0.0, 0.0, 1.0), "down": (0.0, 0.0, -1.0)}
OTHER_BEGINS = {"horizontal": "level", "vertical": "up", "upwards": "up", "downwards": "down"}
"""Words that users write instead of the directions in :data:`BEGINS`, each with the direction that it stands for."""
WAYS = ("up", "down", "left", "right", "level", "back")
BEND_RADIUS, BEND_DIAMETERS = 0.5, 2.0
"""Default radius of a bend: the larger of BEND_RADIUS [m] and BEND_DIAMETERS times the pipe's diameter. The rule of the
Japan Society of Civil Engineers (JSCE) gives an equivalent length of straight pipe for bends with radii of 0.5 and 1 m;
BEND_RADIUS is the smaller of the two."""
HOSE_FACTOR = 2.0
"""Ratio of a hose's friction to the friction of straight pipe of the same length, for a hose whose length is known, but
not its course. The Architectural Institute of Japan (AIJ) counts a hose as straight pipe of twice its length."""
REDUCER_LENGTH = 1.0
"""Default length of a reducer [m]."""
VALVE_DIAMETERS = 4.0
"""Default length of a valve, divided by its inner diameter."""
FACTORS = (0.1, 100.0)
"""Smallest and largest accepted value of a part's entry `factor`, the friction of the part divided by the friction of
straight pipe."""
