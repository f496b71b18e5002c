"""Entries of a mix: their names, meanings, units and ranges, and their values in SI units."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from .ingredients import is_plasticizer, sand_and_stone_masses, sand_and_stone_volumes
from .measurements import Layer, Measured


@dataclass(frozen=True)
class Entry:
    """Numeric entry of a mix: its meaning, its unit and its possible range."""

    help: str
    unit: str
    low: float
    high: float
    hint: str = ""


NUMBERS = {
    "density": Entry(
        "Density of the concrete; not needed if 'parts' lists all ingredients",
        "kg/m3",
        1000,
        5000,
        "write a unit other than kg/m3 behind the number, as in '2.35 t/m3'",
    ),
    "volume": Entry("Volume of the whole load, if 'parts' states the masses in the load", "m3", 1e-3, 1e4),
    "air": Entry("Air content, as a share of the volume", "m3/m3", 0, 0.3, "write a percentage with %, as in '2 %'"),
    "aggregate_density": Entry("Density of the coarse aggregate", "kg/m3", 1000, 8000),
    "slump": Entry("Slump of the Abrams cone", "m", 0.01, 0.29, "write the unit, as in '180 mm' or '7 in', and give "
                                                                "'spread' instead for softer concrete"),
    "spread": Entry("Spread of the Abrams cone, without jolts", "m", 0.35, 1.2,
                    "write the unit, as in '650 mm' or '26 in', and give 'slump' instead for stiffer concrete"),
    "t500": Entry("Time until the spread reaches 500 mm", "s", 0.5, 120),
    "water_binder": Entry(
        "Mass of water divided by mass of all powder (cement, ash, slag, filler); not needed with 'parts'",
        "1",
        0.12,
        1.2,
        "write the ratio as in 0.5, or as '50 %'",
    ),
    "voids": Entry("Void content of the compacted mixture of sand and stones", "m3/m3", 0.1, 0.5,
                   "write a percentage with %, as in '24 %'"),
    "fine_sand": Entry("Share of the sand's mass that is finer than 0.3 mm", "1", 0, 1,
                       "write a percentage with %, as in '18 %'"),
}  # fmt: skip
"""Entries of a mix that are single numbers, by name, each with its meaning, unit and possible range."""
OTHERS = {
    "parts": "Mass of every ingredient in a cubic metre [kg/m3], or an amount with a unit; volumes for liquids only",
    "aggregate": "Coarse aggregate: its share of the volume, or its mass in a cubic metre, with a unit",
    "sieve": "Sieve curve of the coarse aggregate: openings [mm], and the share of the mass that passes each",
    "sizes": "Size of the largest coarse aggregate [m], or smallest and largest size; instead of 'sieve'",
    "shape": "Shape of the coarse aggregate: a word, or the ratio of longest to shortest width",
    "concrete": "Measured properties of the concrete",
    "mortar": "Measured properties of the mortar",
    "viscometer": "Points of a viscometer: pairs of shear rate and stress, or the path of a CSV file",
    "layer": "Slip layer: its yield stress and viscosity, or points measured in a pipe or with a tribometer",
    "thickener": "True if the concrete contains a viscosity-modifying admixture that 'parts' does not list",
}
"""Names of the entries of a mix that are not single numbers, each with its meaning."""
KEYS = ("density", "air", "parts", "volume", "aggregate", "aggregate_density", "sieve", "sizes", "shape", "concrete",
        "mortar", "viscometer", "slump", "spread", "t500", "water_binder", "thickener", "layer", "voids",
        "fine_sand")  # fmt: skip
LARGEST_NAMES = re.compile(
    r"(d ?max|size max|stone|(largest|max|maximum|nominal)( .*)? (size|stone|aggregate|grain))( size)?"
)
"""Pattern of wrong names that users may write for the size of the largest stone. The error message suggests the entry
`sizes`."""
CLASSES = {"S1": (10, 40), "S2": (50, 90), "S3": (100, 150), "S4": (160, 210), "S5": (220, 290),
           "SF1": (550, 650), "SF2": (660, 750), "SF3": (760, 850)}  # fmt: skip
"""Smallest and largest value of each class of slump (S) and of spread (SF) in EN 206 [mm]. The class S5 has no upper
limit; 290 mm is the largest slump that a mix may have."""
OTHER_NAMES = {
    **dict.fromkeys(
        ("w c", "w b", "w cm", "wc", "wb", "water cement", "water cement ratio", "water binder ratio", "w c ratio"),
        "water_binder",
    ),
    **dict.fromkeys(("slump flow", "slumpflow", "flow"), "spread"),
    **dict.fromkeys(("consistency", "consistence", "consistency class", "consistence class", "slump class"), "slump"),
    **dict.fromkeys(("air content", "entrained air"), "air"),
    **dict.fromkeys(("unit weight", "bulk density"), "density"),
}
"""Wrong names that users may write for entries of a mix, each mapped to the correct name, which the error message
states. The wrong names are in lower case, with single spaces between words."""
NO_ENTRIES = {
    **dict.fromkeys(("strength", "strength class", "compressive strength", "cube strength", "cylinder strength", "fc",
                     "grade", "class", "exposure", "exposure class"),
                    "leave it out, because the flow of fresh concrete does not follow from it; state 'slump' or "
                    "'spread' instead"),
    **dict.fromkeys(("yield stress", "viscosity", "plastic viscosity", "flow index", "quadratic viscosity"),
                    "it belongs to the entry 'concrete', as in 'concrete: {yield_stress: 50 Pa, viscosity: 30 Pa s}'"),
    **dict.fromkeys(("slip viscosity", "slip yield", "slip layer"),
                    "it belongs to the entry 'layer', as in 'layer: {yield_stress: 20 Pa, viscosity: 900 Pa s/m}'"),
    **dict.fromkeys(("pump flow", "volume flow", "velocity", "diameter", "length", "pressure"),
                    "it describes a line, not a concrete; write it in the file of the line"),
}  # fmt: skip
"""Corrections for words that users write as entries of a mix although a mix has no such entry. The words are in lower
case, with single spaces between them."""
TOTALS = ("total", "sum", "total mass", "total weight", "batch weight", "total batch weight", "batch total")
"""Names under which delivery notes state the sum of all ingredients."""
GRAVEL = 2650.0
"""Density of coarse aggregate if the mix states none [kg/m3]."""
SIMILAR_DENSITY = 0.15
"""Largest relative difference between the densities of sand and stones for which the share of sand is a mass fraction.
With a larger difference, it is a volume fraction, because rules of practice state mass fractions for aggregate of one
density. Common rocks, with 2,500 to 3,000 kg/m3, lie within this limit."""


@dataclass(frozen=True)
class MixEntries:
    """Entries of a mix in SI units; an entry that is missing in the file is None."""

    density: float
    """Density of the concrete [kg/m3]."""
    summed: bool
    """True if the mix states no density. The density is then the sum of the masses of the ingredients in a cubic
    metre."""
    share: float | None
    """Volume fraction of coarse aggregate in the concrete; None if the mix does not state it."""
    aggregate_density: float
    """Density of the coarse aggregate [kg/m3], stated or assumed (:data:`GRAVEL`)."""
    sieve: tuple[tuple[float, float], ...] | None
    """Openings of the sieves [m], each with the mass fraction of the aggregate that passes the sieve."""
    sizes: tuple[float, float] | None
    """Smallest and largest size of the coarse aggregate [m]; None if the mix states no sizes."""
    shape: str | None
    """Name of the stones' shape in scenes of discrete elements, such as 'spheres'; None if the mix states no shape."""
    concrete: Measured
    mortar: Measured
    viscometer_points: tuple[list[float], list[float]] | None
    """Points measured with a viscometer: shear rates [1/s] and stresses [Pa]; None if the mix states none."""
    slump: float | None
    """Slump of the concrete [m]."""
    spread: float | None
    """Diameter at rest of the concrete from a slump cone (spread) [m]."""
    t500: float | None
    """Time from lifting the slump cone until the spread reaches 500 mm [s]."""
    layer: Layer
    paste_solids: float | None = None
    """Volume fraction of powder in the paste, which consists of powder, water and admixtures, without air."""
    sand_and_stone: float | None = None
    """Volume fraction of sand and stones together in the concrete."""
    thickener: bool = False
    """True if the concrete contains a viscosity-modifying admixture."""
    parts: Mapping[str, float] = field(default_factory=dict)
    """Mass of each ingredient in a cubic metre of concrete [kg/m3], by the ingredient's name."""
    paste_share: float | None = None
    """Volume fraction of powder, water and admixtures together in the concrete."""
    water_binder: float | None = None
    """Mass of water divided by the mass of all powder, stated or calculated from the ingredients; None if it is
    unknown."""
    voids: float | None = None
    """Volume fraction of voids in compacted sand and stones."""
    fine_sand: float | None = None
    """Fraction of the sand's mass in grains smaller than 0.3 mm."""
    customary: bool = False
    """True if the mix states amounts in US units. Texts for the user then contain both US and metric units."""

    @property
    def largest(self) -> float | None:
        """Diameter of the largest stone [m]; None if the mix states neither a sieve curve nor sizes."""
        if self.sieve is not None:
            return self.sieve[-1][0]
        return self.sizes[1] if self.sizes is not None else None

    @property
    def sand_mass(self) -> float:
        """Mass of sand in a cubic metre of concrete [kg]; 0 if the ingredients do not determine it."""
        sand, _ = sand_and_stone_masses(self.parts)
        if sand == 0 and self.share is not None and self.sand_and_stone is not None:
            return max(self.sand_and_stone - self.share, 0.0) * GRAVEL
        return sand

    @property
    def sand_share(self) -> float | None:
        """Share of sand in the aggregate, which consists of sand and stones; None if unknown.

        The share is a mass fraction if the ingredients state the masses of sand and stones. It is a volume fraction if
        sand and stones have different densities, as in lightweight and heavy concrete, or if the names of the
        ingredients do not distinguish sand from stones.
        """
        sand, stone = sand_and_stone_masses(self.parts)
        fine, coarse = sand_and_stone_volumes(self.parts, self.aggregate_density)
        if fine > 0 and coarse > 0:
            similar = abs(stone / coarse / (sand / fine) - 1) < SIMILAR_DENSITY
            return sand / (sand + stone) if similar else fine / (fine + coarse)
        if self.share is None or self.sand_and_stone is None or self.share >= self.sand_and_stone:
            return None
        return 1 - self.share / self.sand_and_stone

    @property
    def plasticizer(self) -> bool:
        """True if one of the ingredients is a plasticizer."""
        return any(is_plasticizer(name) for name in self.parts)
