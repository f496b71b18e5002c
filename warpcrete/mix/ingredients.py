"""Ingredients of a cubic metre of concrete: their names, their densities, and a check that they fill the volume."""

import re
from collections.abc import Mapping

from ..core.errors import quoted, refuse, suggested
from ..core.inputs.amounts import POUND, YARD, amount, is_amount, unit_names
from ..core.inputs.limits import warn
from .stones import is_size_number, named_sizes, size_numbers, sizes_with_unit

HEAVY = {**dict.fromkeys(("barite", "baryte", "barytes"), 4200.0), **dict.fromkeys(("magnetite", "hematite"), 4900.0)}
"""Densities of heavy rocks [kg/m3]. An ingredient with such a word in its name, such as "barite sand", has the density
of this rock."""
DENSITIES = {
    **dict.fromkeys(("cement", "clinker", "cem", "opc", "type", "binder", "powder"), 3100.0),
    **dict.fromkeys(("slag", "ggbs", "ggbfs"), 2900.0),
    **dict.fromkeys(("limestone", "filler", "lime", "marble", "quartz", "metakaolin", "pozzolan", "trass"), 2700.0),
    **dict.fromkeys(("ash", "flyash", "pfa", "silica", "microsilica", "fume"), 2250.0),
    **dict.fromkeys(("water", "ice"), 1000.0),
    **dict.fromkeys(("sand", "gravel", "aggregate", "aggregates", "stone", "stones", "grit", "chippings", "granite",
                     "basalt", "crushed", "coarse", "fine", "pebbles", "rock"), 2650.0),
    **dict.fromkeys(("superplasticizer", "superplasticiser", "plasticizer", "plasticiser", "admixture", "admixtures",
                     "retarder", "accelerator", "entrainer", "stabilizer", "stabiliser", "modifier", "vma", "pce",
                     "sp", "latex", "agent", "hrwr", "hrwra", "mrwr", "wr", "wra", "wrda", "aea", "reducer"), 1100.0),
    **dict.fromkeys(("steel", "fibres", "fibers", "fibre", "fiber"), 7850.0),
    **HEAVY,
}  # fmt: skip
"""Usual densities of ingredients [kg/m3]. The keys are words by which the name of an ingredient is recognised."""
COARSE = ("gravel", "stone", "stones", "rock", "grit", "chippings", "granite", "basalt", "coarse", "pebbles")
"""Words that mean coarse aggregate. If the mix states a density of coarse aggregate, ingredients with such a word in
their names have this density."""
LIGHT = ("lightweight", "light", "expanded", "pumice", "perlite")
"""Words for light aggregate, whose density differs from product to product."""
MIXED_WITH_SAND = ("gravel", "stone", "stones", "chippings", "pebbles")
"""Words for stones that do not name a kind of rock. Together with "sand", as in "sand and gravel", they mean a mixture
of sand and stones."""
VARIABLE = (*LIGHT, "clay", "recycled", "polypropylene", "pp", "pva",
          "synthetic", "polymer", "plastic", "glass", "basaltic", "pigment", "rubber")  # fmt: skip
"""Words in the names of ingredients whose density varies so much that their volume cannot be calculated."""
MIN_AMOUNT = 0.01
"""Smallest amount of an ingredient [kg/m3] that is accepted. Even admixtures usually amount to 0.1 kg/m3 or more, so an
amount below the limit is probably a mistake."""
POWDERS = ("cement", "clinker", "cem", "opc", "type", "binder", "powder", "slag", "ggbs", "ggbfs", "limestone",
           "filler", "lime", "marble", "quartz", "metakaolin", "pozzolan", "trass", "ash", "flyash", "pfa", "silica",
           "microsilica", "fume")  # fmt: skip
"""Words in the names of ingredients that are powder, whose grains are finer than sand and belong to the paste."""
WATERS = ("water", "ice")
"""Words in the names of ingredients that are water."""
LIQUIDS = (*WATERS, "superplasticizer", "superplasticiser", "plasticizer", "plasticiser", "admixture",
           "admixtures", "retarder", "accelerator", "entrainer", "stabilizer", "stabiliser", "modifier", "vma", "pce",
           "sp", "latex", "agent", "hrwr", "hrwra", "mrwr", "wr", "wra", "wrda", "aea", "reducer")  # fmt: skip
"""Words in the names of ingredients that are liquids of the paste: water and dissolved admixtures."""
CEMENTS = ("cement", "clinker", "cem", "opc", "type", "binder")
"""Words in the names of ingredients that are cement."""
CEMENTITIOUS = (*CEMENTS, "slag", "ggbs", "ggbfs", "metakaolin", "pozzolan", "trass", "ash", "flyash", "pfa", "silica",
                "microsilica", "fume")  # fmt: skip
"""Words in the names of ingredients that are cementitious material, for which dosages of admixtures per 100 lb hold."""
GENERAL = ("type", "powder", "binder")
"""Words that tell only that an ingredient is powder. Another known word in its name, such as "limestone" in "limestone
powder", says which kind of powder it is."""
ROCKS = ("limestone", "marble", "quartz")
"""Words for rocks. An ingredient with such a word in its name is powder. However, it is aggregate if the name also says
that the rock is crushed, or states a grain size or a size number such as '#57'."""
PLASTICIZERS = ("superplasticizer", "superplasticiser", "plasticizer", "plasticiser", "pce", "sp", "hrwr", "hrwra",
                "mrwr", "wr", "wra", "wrda")  # fmt: skip
"""Words in the names of ingredients that are plasticizers, which make concrete flow more easily. The abbreviations
stand for water reducers, of high range (HRWR) or medium range (MRWR)."""
THICKENERS = ("vma", "stabilizer", "stabiliser", "modifier")
"""Words in the names of ingredients that are viscosity-modifying admixtures."""
UNKNOWN_MASS = 20.0
"""Mass in a cubic metre [kg/m3] up to which an ingredient with an unknown name counts as an admixture and is ignored. A
larger mass may be powder, so the volume of the paste cannot be calculated."""
DENSEST = 8000.0
"""Largest possible density of an ingredient whose density is unknown [kg/m3]; steel has 7850 kg/m3."""
POSSIBLE_VOLUMES = (0.88, 1.05)
"""Smallest and largest possible volume of all ingredients together, without air, in a cubic metre of concrete [m3/m3].
The upper limit exceeds 1, because the assumed densities of ingredients differ from their true densities."""
USUAL_AIR = (-0.02, 0.06)
"""Smallest and largest air content, calculated from the ingredients [m3/m3], that cause no warning. True contents are
usually 1 to 3 %. The calculated content may be negative, because the densities of the ingredients are uncertain."""
VOLUME_WARNING, VOLUME_ERROR = 0.03, 0.07
"""Two limits on the difference between one cubic metre and the volume of all ingredients with the stated air [m3/m3]. A
difference above the first limit causes a warning, and a difference above the second one an error."""
MOIST_SAND = "if the sand was weighed moist, move its surface water to 'water' (notebooks/how-to/pump-pressure.md)"
"""Advice if the ingredients do not fill the volume of the concrete."""


def _words(name: str) -> list[str]:
    """Return the words of an ingredient's name in lower case."""
    return [word for word in re.split(r"[^a-z]+", name.casefold()) if word]


def is_thickener(name: str) -> bool:
    """Return whether the name of an ingredient means a viscosity-modifying admixture.

    A "stabilizer" is such an admixture, but a "hydration stabilizer" is a retarder. A viscosity reducer does not count
    either.
    """
    words = _words(name)
    if "hydration" in words or any(word.startswith("reduc") for word in words):
        return False
    return any(word in THICKENERS or word.startswith("viscosity") for word in words)


def is_plasticizer(name: str) -> bool:
    """Return whether an ingredient is a plasticizer or superplasticizer."""
    words = _words(name)
    reduces_water = "water" in words and any(word.startswith("reduc") for word in words)
    return reduces_water or any(word in PLASTICIZERS for word in words)


def powder_mass(parts: Mapping[str, float]) -> float:
    """Return the mass of powder (cement, ash, slag, filler) among the ingredients [kg/m3]."""
    return sum(mass for name, mass in parts.items() if _noun(name) in POWDERS)


def is_cementitious(name: str) -> bool:
    """Return whether the ingredient called `name` is cement, or slag, ash or another powder that reacts with it."""
    return _noun(name) in CEMENTITIOUS


def cement_mass(parts: Mapping[str, float]) -> float:
    """Return the mass of cement among the ingredients [kg/m3]."""
    return sum(mass for name, mass in parts.items() if _noun(name) in CEMENTS)


def water_mass(parts: Mapping[str, float]) -> float:
    """Return the mass of water among the ingredients [kg/m3]."""
    return sum(mass for name, mass in parts.items() if _noun(name) in WATERS)


def sand_and_stone_masses(parts: Mapping[str, float]) -> tuple[float, float]:
    """Return the masses of sand and of coarse aggregate among the ingredients [kg/m3].

    Both are 0 if the name of an ingredient tells that it is aggregate, but not whether it is sand or coarse.
    """
    sand, stone = 0.0, 0.0
    for name, mass in parts.items():
        words = _words(name)
        if DENSITIES.get(_noun(name)) != DENSITIES["sand"] and not any(word in HEAVY for word in words):
            continue
        stony = is_coarse(name)
        if "sand" in words and any(word in MIXED_WITH_SAND for word in words):
            return 0.0, 0.0
        if "sand" in words or ("fine" in words and not stony):
            sand += mass
        elif stony:
            stone += mass
        else:
            return 0.0, 0.0
    return sand, stone


def unusual_stones(parts: Mapping[str, float]) -> str | None:
    """Return the name of an ingredient that is light or heavy coarse aggregate, or None if there is none."""
    for name in parts:
        words, noun = _words(name), _noun(name)
        is_aggregate = noun == "" or DENSITIES[noun] == DENSITIES["sand"] or noun in HEAVY
        if "sand" not in words and is_aggregate and any(word in (*LIGHT, *HEAVY) for word in words):
            return name
    return None


def sand_and_stone_volumes(parts: Mapping[str, float], coarse: float) -> tuple[float, float]:
    """Return the volumes of sand and of coarse aggregate in a cubic metre of concrete [m3].

    `coarse` is the stated or assumed density of the coarse aggregate [kg/m3]. Both volumes are 0 if the masses of sand
    and stones are unknown, or if the density of sand or of stones is unknown. Recycled aggregate counts with the usual
    density.
    """
    sand, stone = 0.0, 0.0
    if sand_and_stone_masses(parts) == (0.0, 0.0):
        return 0.0, 0.0
    for name, mass in parts.items():
        fine, large = sand_and_stone_masses({name: mass})
        if fine == large == 0:
            continue
        density = DENSITIES["sand"] if "recycled" in _words(name) else _density(name, coarse)
        if density is None:
            return 0.0, 0.0
        sand, stone = sand + fine / density, stone + large / density
    return sand, stone


def _density(name: str, coarse: float) -> float | None:
    """Return the density of an ingredient [kg/m3], or None if it is unknown or varies too much.

    `coarse` is the stated or assumed density of coarse aggregate [kg/m3]. If it differs from the usual density, the mix
    states it, and all coarse aggregate has it. Otherwise, the density follows from the ingredient's name.
    """
    if coarse != DENSITIES["gravel"] and is_coarse(name):
        return coarse
    if any(word in VARIABLE for word in _words(name)) or not (noun := _noun(name)):
        return None
    heavy = [word for word in _words(name) if word in HEAVY]
    return DENSITIES[(heavy or [noun])[0]]


def is_ingredient(name: str) -> bool:
    """Return whether the program recognises an ingredient by a word in its name, such as "cement"."""
    return _noun(name) != ""


def is_coarse(name: str) -> bool:
    """Return whether the name of an ingredient means coarse aggregate.

    The name contains a word such as "gravel", or it is aggregate with a range of sizes that does not begin with 0:
    "aggregate 4/16" is coarse, "aggregate 0/4" is not.
    """
    if any(word in COARSE for word in _words(name)):
        return True
    rock = _noun(name) in ("aggregate", "aggregates", "crushed") and "sand" not in _words(name)
    return rock and named_sizes(name) is not None and re.search(r"\b0\s*(?:mm\s*)?(?:[-\u2013/]|to\b)", name) is None


def _noun(name: str) -> str:
    """Return the word that tells what an ingredient is: usually the last word of its name that the program knows.

    The result is empty if the program knows no word of the name. It is "sand" for limestone sand, "fume" for silica
    fume, and "filler" for a powder of stone. Limestone that is crushed or has a size ("limestone 8/16", "#57
    limestone") is aggregate, and so is an ingredient called "#57". The words "type", "powder" and "binder" mean cement
    only if the name contains no other known word, as in "Type I/II".
    """
    words = _words(name)
    if words[-1:] == ["agent"] and any(word.startswith(("expan", "swell")) for word in words):
        return "powder"
    known = [word for word in words if word in DENSITIES]
    if not known and is_size_number(name):
        return "aggregate"
    if (known[-1:] == ["powder"] or words[-1:] == ["flour"]) and any(word in (*COARSE, "sand") for word in words):
        return "filler"
    noun = ([word for word in known if word not in (*GENERAL, "water")] or known or [""])[-1]
    sieves = re.search(r"\d\s*[/-]\s*[1-9](?!.*[u\u00b5\u03bc]m\b)", name) is not None
    stony = "crushed" in known or sieves or size_numbers(name) != [] or sizes_with_unit(name) is not None
    return "aggregate" if noun in ROCKS and stony and "powder" not in known else noun


def paste_volumes(parts: Mapping[str, float]) -> tuple[float, float]:
    """Return the volumes of powder and of liquid in a cubic metre of concrete [m3], without air.

    `parts` are the ingredients [kg/m3]. Both volumes are 0 if the mix has no water. They are also 0 if the mix has a
    large amount of an ingredient that the program does not know, because that ingredient may be powder.
    """
    powder, liquid, water = 0.0, 0.0, False
    for name, mass in parts.items():
        noun = _noun(name)
        if noun in POWDERS:
            powder += mass / DENSITIES[noun]
        elif noun in LIQUIDS:
            liquid += mass / DENSITIES[noun]
            water = water or noun in WATERS
        elif not noun and mass > UNKNOWN_MASS and not any(word in VARIABLE for word in _words(name)):
            return 0.0, 0.0
    return (powder, liquid) if water else (0.0, 0.0)


def mass_per_volume(name: str, value: object, load: float | None = None) -> float:
    """Return the mass of an ingredient in a cubic metre of concrete [kg/m3].

    `value` is a number [kg/m3], or a text with a unit of mass per volume. For liquids it may also be a volume per
    volume, such as "33 gal/yd3". If the volume of a whole `load` of concrete [m3] is given, `value` may also be the
    mass or the liquid volume in this load, such as "900 kg". Raises :class:`SceneError` for other texts.
    """
    field = f"mix parts: {name}"
    _check_stated(name, value)
    whole = is_amount(value, "kg") or is_amount(value, "m3")
    if whole and load is None:
        problem = f"must be a number with one of the units {', '.join(unit_names('kg/m3'))}"
        refuse(field, value, f"{problem}, because the volume of the load is unknown",
               "or add the volume of the load, as in 'volume: 8 yd3'")  # fmt: skip
    liquid = is_amount(value, "m3") or (is_amount(value, "m3/m3") and not str(value).rstrip().endswith("%"))
    if liquid:
        noun = _noun(name)
        volume = amount(field, value, "m3") / load if whole and load else amount(field, value, "m3/m3")
        trade_name = not noun and volume * DENSITIES["admixture"] <= UNKNOWN_MASS
        if noun not in LIQUIDS and not trade_name:
            problem = "is a volume, which is accepted for water and liquid admixtures only"
            refuse(field, value, problem, "give its mass, for example '340 kg/m3' or '570 lb/yd3'")
        return DENSITIES["admixture" if trade_name else noun] * volume
    if load and not whole and isinstance(value, str) and not is_amount(value, "kg/m3") and value.strip()[-1:].isalpha():
        units = (", ".join(unit_names(each)) for each in ("kg", "kg/m3"))
        refuse(field, value, "must be a number with one of the units {} for the whole load, or with one of the units "
               "{} for a volume of concrete".format(*units),
               "write numbers without a comma" if "," in value else "")  # fmt: skip
    return amount(field, value, "kg") / load if whole and load else amount(field, value, "kg/m3")


def _check_stated(name: str, value: object) -> None:
    """Refuse an ingredient without an amount, or with an amount in sacks, in per cent or per 100 lb of cement."""
    field, text = f"mix parts: {name}", value if isinstance(value, str) else ""
    admixture = _noun(name) in LIQUIDS and _noun(name) not in WATERS
    if value is None or isinstance(value, bool) or (admixture and text and not re.search(r"\d", text)):
        hints = []
        if admixture:
            hints = [
                "state the amount, as in '3 kg/m3' or '80 oz/yd3'; if you do not know it, state a usual amount, "
                "because it has little effect on the pump pressure"
            ]
        if value is None:
            hints.append("a comma inside braces {...} begins another ingredient: put a name with a comma in quotes")
        refuse(field, value, "has no amount", "; ".join(hints))
    if (sacks := re.fullmatch(r"([0-9]+(?:\.[0-9]+)?)[\s-]*(?:sack|bag)s?(?:/yd3|/cy)?", text.strip())) is not None:
        hint = f"a US sack of cement has 94 lb: write '{94 * float(sacks[1]):g} lb/yd3' if they are per cubic yard"
        refuse(field, value, "is a number of sacks, but must be a mass per volume of concrete", hint)
    if (per := re.search(r"\bcwt\b|(?:/|\bper)\s*100\s*(lb|kg)", text)) is not None:
        of, masses, volume, units = (
            ("kg", "kilograms", "metre", {"ml": "ml/m3", "g": "g/m3", "": "kg/m3"})
            if per[1] == "kg"
            else ("lb", "pounds", "yard", {"oz": "oz/yd3", "": "lb/yd3"})
        )
        unit = next(full for short, full in units.items() if re.search(rf"[0-9.]\s*(fl\.?\s*)?{short}\b", text, re.I))
        hint = (f"multiply it by the {masses} of cement, slag and ash in a cubic {volume}, divide by 100, and write "
                f"{unit}")  # fmt: skip
        refuse(field, value, f"is an amount per 100 {of} of cement, but must be an amount per volume of concrete", hint)
    if "%" in text:
        hint = "give its mass in a cubic metre, as in '120 kg/m3'"
        if admixture:
            hint = "multiply it by the kilograms of cement in a cubic metre, divide by 100, and write kg/m3"
        refuse(field, value, "is a percentage, but must be a mass per volume of concrete", hint)


def density_of(name: str) -> float | None:
    """Return the usual density of an ingredient [kg/m3], or None if it is unknown or varies too much.

    Sand or gravel of a heavy rock, such as "barite sand", has the density of this rock. An unknown name causes a
    warning. Raises :class:`SceneError` for a name that is probably misspelt.
    """
    if (density := _density(name, DENSITIES["gravel"])) is not None or any(word in VARIABLE for word in _words(name)):
        return density
    if re.fullmatch(r"[A-Za-z]{1,2}", name.strip()):
        hint = "write the name, such as 'cement', 'fly ash', 'water', 'sand' or 'gravel'"
        refuse("mix parts", name, "is an abbreviation that is not known", hint)
    suggestion = suggested(name, DENSITIES)
    if suggestion:
        refuse("mix parts", name, "is not a known ingredient", suggestion)
    warn(
        f"mix parts: {quoted(name)} is not a known ingredient: it is taken neither for powder nor for aggregate, so "
        "the slip layer may be wrong, and the total volume cannot be checked; use a name such as 'cement', 'sand', "
        "'gravel' or 'superplasticizer'"
    )
    return None


def check_volume(parts: Mapping[str, float], coarse: float, air: float | None) -> None:
    """Check that ingredients [kg/m3] and `air` [m3/m3] fill one cubic metre.

    A mix whose volume is impossible is refused, and one whose volume is unlikely causes a warning. `coarse` is the
    density of the coarse aggregate [kg/m3].
    """
    filled, complete, unknown = 0.0, True, 0.0
    for name, mass in parts.items():
        if (density_of(name) is None) or (density := _density(name, coarse)) is None:
            complete, unknown = False, unknown + mass
        else:
            filled += mass / density
    if 0 <= POSSIBLE_VOLUMES[1] - filled < unknown / DENSEST:
        problem = (
            f"contain {unknown:.4g} kg/m3 of unknown density, for which there is no room, because the other "
            f"parts fill {filled:.3f} m3 of 1 m3"
        )
        refuse("mix parts", ", ".join(parts), problem, "check the masses, and remove entries that are no ingredients")
    if air is not None:
        gap = 1 - filled - air
        words = f"fill {filled + air:.3f} m3 instead of 1 m3, including {100 * air:.3g} % of air"
        if gap < -VOLUME_ERROR or (complete and gap > VOLUME_ERROR):
            refuse("mix parts", ", ".join(parts), words, "list all ingredients of a cubic metre, in kg/m3")
        if gap < -VOLUME_WARNING or (complete and gap > VOLUME_WARNING):
            warn(f"mix parts: {words}; check the masses and the air content{f'; {MOIST_SAND}' if gap > 0 else ''}")
        return
    words = f"fill {filled:.3f} m3 of a cubic metre"
    if filled > POSSIBLE_VOLUMES[1] or (complete and filled < POSSIBLE_VOLUMES[0]):
        hint = "list all ingredients of a cubic metre, in kg/m3"
        if complete and water_mass(parts) == 0:
            hint += ", including the water"
        if POSSIBLE_VOLUMES[0] < filled * POUND / YARD**3 < POSSIBLE_VOLUMES[1]:
            hint += ", or write units behind the numbers, as in '564 lb/yd3'"
        refuse("mix parts", ", ".join(parts), f"{words} without air", hint)
    if 1 - filled < USUAL_AIR[0] or (complete and 1 - filled > USUAL_AIR[1]):
        room = f"{100 * (1 - filled):.2g} %"
        left = f"which leaves {room} of air; check the masses and the moisture of the sand, or state 'air: {room}'"
        left += f"; {MOIST_SAND}"
        warn(f"mix parts: {words}, {left if filled < 1 else 'and leave no room for air; check the masses'}")
