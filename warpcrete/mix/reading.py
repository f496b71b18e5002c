"""Functions that read the description of a mix from a file, convert its entries to SI units and check them."""

import difflib
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from ..core.errors import SceneError, between, one_of, positive, quoted, refuse
from ..core.inputs.amounts import LONGEST, amount, bare_number, customary_unit, is_amount, is_customary
from ..core.inputs.concretes import FACTORS_BELONG, MISPLACED_FACTORS
from ..core.inputs.limits import warn
from ..core.inputs.text_files import errors_located_at
from .entries import CLASSES, GRAVEL, KEYS, LARGEST_NAMES, NO_ENTRIES, NUMBERS, OTHER_NAMES, TOTALS, MixEntries
from .ingredients import (
    MIN_AMOUNT,
    check_volume,
    is_cementitious,
    is_coarse,
    is_ingredient,
    is_thickener,
    mass_per_volume,
    paste_volumes,
    powder_mass,
    sand_and_stone_volumes,
    unusual_stones,
    water_mass,
)
from .measurements import CONCRETE_UNITS, SHEARED, UNITS, Layer, Measured, read_constants, read_layer, read_pairs
from .stones import (
    SIZE_NUMBERS,
    example_size,
    named_sizes,
    read_shape,
    read_sieve,
    read_sizes,
    size_numbers,
    sizes_with_unit,
)

T = TypeVar("T")
PACKING = 0.57
"""Volume fraction of equal spheres in random loose packing (Mahaut et al. 2008); no concrete has more coarse
aggregate."""
BINDER = 3000.0
"""Density of the powder [kg/m3] assumed if the mix states only the ratio of water to binder: cement has 3100, slag 2900
and fly ash 2250 kg/m3."""
USUAL_AIR = 0.02
"""Air content if the mix states none, as a fraction of the concrete's volume."""
DENSEST_PASTE = 0.75
"""Maximum volume fraction of powder in the paste. At the lowest water-binder ratio in use, 0.12, the fraction is
0.74."""
PASTE_TOLERANCE = 0.08
"""Maximum difference between two values of the volume fraction of powder in the paste: one from the ratio of water to
binder, and one from the masses of the ingredients. A larger difference is a contradiction. Up to 0.07 may be due to the
density of the powder, which the ratio does not state."""
DENSITY_TOLERANCE = 0.03
"""Maximum relative difference between two values of the same density, such as a stated density and the sum of all
ingredients. With a larger difference, the mix is refused."""
SHARE_TOLERANCE = 0.25
"""Relative difference between the stated share of coarse aggregate and the share of stones among the ingredients, above
which a warning is given. Coarse sand may count as aggregate, and the densities of rocks differ by some per cent."""
PER_BINDER = re.compile(
    r"([0-9]{1,4}(?:\.[0-9]{1,6})?)\s*(?:((?:fl\.?\s*)?oz\.?)\s*(?:/|per)\s*(?:cwt\.?|100\s*lbs?\.?)|"
    r"m[lL]\s*(?:/|per)\s*100\s*kg)",
    re.IGNORECASE,
)
"""Amount of an admixture per 100 lb or 100 kg of cementitious material, as in "4 oz/cwt" or "250 ml/100 kg".

The groups are the number and the fluid ounce, which is missing in an amount in millilitres.
"""
MORTARS = (1200.0, 2800.0)
"""Smallest and largest density of mortar that is possible [kg/m3]."""


def read(given: Mapping[str, object], folder: Path) -> MixEntries:
    """Read the section `mix` of a concrete's file, and return its entries in SI units.

    Paths in the section are relative to `folder`. Raises :class:`SceneError` if an entry is invalid, or if entries
    contradict each other.
    """
    if not given:
        hint = f"add entries such as 'density: 2350 kg/m3'; possible entries are {', '.join(KEYS)}"
        refuse("mix", given, "is empty", hint)
    if not isinstance(given, Mapping):
        refuse("mix", given, "must consist of 'key: value' lines", "indent them below the name of the section")
    for key in given:
        with errors_located_at(given, key):
            name = re.sub(r"[\W_]+", " ", str(key).casefold()).strip()
            if key not in KEYS and LARGEST_NAMES.fullmatch(name) is not None:
                refuse("mix key", key, "is called 'sizes' in a mix", f"write 'sizes: {example_size(given[key])}'")
            if "moist" in str(key).casefold():
                problem = "is not an entry of a mix"
                refuse("mix key", key, problem, "subtract the surface moisture from the sand, and add it to the water")
            if key in MISPLACED_FACTORS:
                refuse("mix key", key, "is not an entry of a mix", FACTORS_BELONG)
            if name in NO_ENTRIES or (name == "flow" and is_amount(given[key], "m3/s")):
                refuse("mix key", key, "is not an entry of a mix", NO_ENTRIES.get(name, NO_ENTRIES["volume flow"]))
            if (own := OTHER_NAMES.get(name)) is not None:
                refuse("mix key", key, f"is called {own!r} in a mix", f"write '{own}: {given[key]}'")
            if key not in KEYS and is_ingredient(name) and not difflib.get_close_matches(str(key), KEYS, 1, 0.75):
                problem = "is an ingredient, not an entry of a mix"
                refuse("mix key", key, problem, f"write '{key}: {given[key]}' below 'parts:', and indent it")
            one_of("mix key", key, KEYS)
    if "sieve" in given and "sizes" in given:
        refuse("mix sizes", given["sizes"], "cannot be combined with 'sieve'", "leave out 'sizes' or 'sieve'")
    heavy = _number(given, "aggregate_density") or GRAVEL
    with errors_located_at(given, "parts" if "parts" in given else "density"):
        density, summed, masses = _density(given, heavy)
    with errors_located_at(given, "aggregate"):
        unusual = None if "aggregate_density" in given else unusual_stones(masses)
        share = _share(given["aggregate"], heavy, unusual) if "aggregate" in given else None
    with errors_located_at(given, "mortar"):
        mortar = read_constants("mortar", given.get("mortar", {}), {**UNITS, "density": "kg/m3"})
    if mortar.values and share is None:
        problem = "needs 'aggregate', the share of coarse aggregate in the concrete"
        refuse("mix mortar", given["mortar"], problem, "add it, for example 'aggregate: 36 %'")
    if share is not None:
        _check_parts(density, share, heavy, mortar.values.get("density"))
        with errors_located_at(given, "aggregate"):
            _check_share(given["aggregate"], share, masses, heavy)
    spread, t500 = _number(given, "spread"), _number(given, "t500")
    if t500 is not None and (spread is None or spread < 0.5):
        problem = "needs a final spread of 500 mm or more"
        refuse("mix t500", given["t500"], problem, "add the measured spread, for example 'spread: 650 mm'")
    return MixEntries(
        density=density,
        summed=summed,
        share=share,
        aggregate_density=heavy,
        sieve=_entry(given, "sieve", read_sieve),
        sizes=_entry(given, "sizes", read_sizes) or _named_sizes(given, masses),
        shape=_entry(given, "shape", read_shape),
        concrete=_entry(given, "concrete", lambda found: read_constants("concrete", found, CONCRETE_UNITS))
        or Measured(),
        mortar=mortar,
        viscometer_points=_entry(given, "viscometer", lambda found: read_pairs("viscometer", found, SHEARED, folder)),
        slump=_number(given, "slump"),
        spread=spread,
        t500=t500,
        layer=_entry(given, "layer", lambda found: read_layer(found, folder)) or Layer(),
        paste_solids=_paste_solids(given, masses),
        sand_and_stone=_sand_and_stone(given, masses),
        thickener=_thickener(given),
        parts=masses,
        paste_share=_paste_share(given, masses),
        water_binder=_water_binder(given, masses),
        voids=_number(given, "voids"),
        fine_sand=_number(given, "fine_sand"),
        customary=is_customary(given),
    )


def _named_sizes(given: Mapping[str, object], masses: Mapping[str, float]) -> tuple[float, float] | None:
    """Return the smallest and the largest size of the stones [m] that the names of the ingredients state.

    Such names are '#67 stone' and 'gravel 4/16'. If the names state several ranges of sizes, the result covers all of
    them. It is None if the mix has a sieve curve, or if no name states sizes.
    """
    if "sieve" in given:
        return None
    stones = [name for name in masses if is_coarse(name) or unusual_stones({name: 0.0}) is not None]
    for number in (number for name in stones if sizes_with_unit(name) is None for number in size_numbers(name)):
        if number not in SIZE_NUMBERS:
            warn(
                f"mix parts: {number} is no size number of ASTM C33 ({', '.join(SIZE_NUMBERS)}); correct it, or state "
                "the sizes of the stones as 'sizes'"
            )
    sizes = [span for name in stones if (span := named_sizes(name)) is not None]
    return (min(low for low, _ in sizes), max(high for _, high in sizes)) if sizes else None


def _entry(given: Mapping[str, object], name: str, read: Callable[[Any], T]) -> T | None:
    """Return the entry `name`, converted by the function `read`; None if the mix has no such entry.

    If `read` raises an error, the error message states the line of the entry in the file.
    """
    if name not in given:
        return None
    with errors_located_at(given, name):
        return read(given[name])


def _paste_solids(given: Mapping[str, object], masses: Mapping[str, float]) -> float | None:
    """Return the volume fraction of powder in the paste, from the ingredients or from the ratio of water to binder."""
    ratio = _number(given, "water_binder")
    powder, liquid = paste_volumes(masses)
    fraction = powder / (powder + liquid) if powder > 0 and liquid > 0 else None
    if fraction is not None and fraction > DENSEST_PASTE:
        refuse("mix parts", f"{water_mass(masses):.4g} kg/m3 of water", "is too little for the powder: "
               f"{100 * fraction:.3g} % of the paste would be solid, and {100 * DENSEST_PASTE:g} % is the most that "
               "flows",
               "check the amount of water and its unit")  # fmt: skip
    if ratio is None:
        return fraction
    stated = 1 / (1 + ratio * BINDER / 1000)
    if fraction is not None and abs(stated - fraction) > PASTE_TOLERANCE:
        refuse("mix water_binder", ratio, f"contradicts 'parts': it means {stated:.3f} m3 of powder in a cubic metre "
               f"of paste, but the ingredients give {fraction:.3f} m3",
               "leave out 'water_binder', which follows from 'parts'")  # fmt: skip
    return fraction or stated


def _sand_and_stone(given: Mapping[str, object], masses: Mapping[str, float]) -> float | None:
    """Return the volume fraction of sand and stones in the concrete; None if the ingredients do not determine it."""
    powder, liquid = paste_volumes(masses)
    air = _number(given, "air")
    rest = 1 - powder - liquid - (USUAL_AIR if air is None else air)
    return max(rest, 0.0) if powder > 0 and liquid > 0 else None


def _paste_share(given: Mapping[str, object], masses: Mapping[str, float]) -> float | None:
    """Return the volume fraction of powder and liquid in the concrete; None if the ingredients do not determine it."""
    powder, liquid = paste_volumes(masses)
    return powder + liquid if powder > 0 and liquid > 0 else None


def _water_binder(given: Mapping[str, object], masses: Mapping[str, float]) -> float | None:
    """Return the mass ratio of water to powder, stated or calculated from the ingredients; None if unknown."""
    powder, water = powder_mass(masses), water_mass(masses)
    return _number(given, "water_binder") or (water / powder if powder > 0 and water > 0 else None)


def _thickener(given: Mapping[str, Any]) -> bool:
    """Return whether the mix contains a viscosity-modifying admixture.

    The entry `thickener` or the name of an ingredient states this. Raises :class:`SceneError` if the entry is false
    although an ingredient is such an admixture.
    """
    parts = given.get("parts")
    named = parts is not None and any(is_thickener(str(name)) for name in parts)
    if "thickener" not in given:
        return named
    with errors_located_at(given, "thickener"):
        said = given["thickener"]
        if not isinstance(said, bool):
            refuse("mix thickener", said, "must be true or false")
        if named and not said:
            problem = "contradicts 'parts', which contains a viscosity-modifying admixture"
            refuse("mix thickener", said, problem, "leave out 'thickener', or correct 'parts'")
    return said


def _number(given: Mapping[str, object], name: str) -> float | None:
    """Return the numeric entry `name` of a mix in its SI unit, or None if the mix does not state it."""
    if given.get(name) is None:
        return None
    entry = NUMBERS[name]
    with errors_located_at(given, name):
        _check_single(name, given[name])
        number = amount(f"mix {name}", given[name], entry.unit)
        between(f"mix {name}", number, entry.low, entry.high, entry.unit, entry.hint)
    return number


def _check_ingredient(name: str, value: object) -> None:
    """Raise :class:`SceneError` if an item of `parts` is another entry of the mix or the sum of all ingredients."""
    plain = re.sub(r"[\W_]+", " ", name.casefold()).strip()
    if plain in TOTALS:
        refuse(
            f"mix parts: {name}", value, "is a sum, not an ingredient", "remove it; the program adds up the ingredients"
        )
    if (own := OTHER_NAMES.get(plain, plain)) in NUMBERS or own in ("sizes", "sieve", "shape"):
        refuse(f"mix parts: {name}", value, f"is the entry {own!r} of a mix, not an ingredient",
               f"move it out of 'parts', as '{own}: ...'")  # fmt: skip


def _check_single(name: str, value: object) -> None:
    """Raise :class:`SceneError` if the entry is a consistency class, such as 'S3', or a range instead of one value.

    The message suggests the measured value, or the middle of the class or range.
    """
    text = value.strip() if isinstance(value, str) and len(value) <= LONGEST else ""
    if (ends := CLASSES.get(text.upper())) is not None and name in ("slump", "spread"):
        own = "spread" if len(text) > 2 else "slump"
        refuse(f"mix {name}", value, f"is a class of EN 206, with a {own} of {ends[0]} to {ends[1]} mm",
               f"write the measured {own}, or the middle of the class, as in '{own}: {sum(ends) / 2:g} mm'"
               )  # fmt: skip
    if re.fullmatch(r"F[1-6]", text, re.IGNORECASE) and name in ("slump", "spread"):
        refuse(f"mix {name}", value, "is a flow table class of EN 206, from which slump and spread do not follow",
               "measure the slump, and write it as in 'slump: 180 mm'")  # fmt: skip
    two = re.fullmatch(r"[0-9][^a-zA-Z]*[a-zA-Z%]*\s*(to|-|\u2013)\s*[0-9].*", text) is not None
    if two and not is_amount(text, NUMBERS[name].unit):
        hint = "write the measured value, or the middle of the range"
        refuse(f"mix {name}", value, "is a range, but must be one value", hint)


def _density(given: Mapping[str, object], heavy: float) -> tuple[float, bool, dict[str, float]]:
    """Return the concrete's density [kg/m3], whether it is the sum of the ingredients, and the ingredients.

    The ingredients map names to masses in a cubic metre of concrete [kg/m3]; the mapping is empty if the mix lists no
    ingredients. `heavy` is the density of the coarse aggregate [kg/m3].
    """
    own, air = _number(given, "density"), _number(given, "air")
    if "parts" not in given:
        if "volume" in given:
            with errors_located_at(given, "volume"):
                refuse("mix volume", given["volume"], "has no effect without 'parts', the ingredients in this volume",
                       "add the ingredients of the load as 'parts', or leave out 'volume'")  # fmt: skip
        if own is None:
            raise SceneError(
                "mix density: must be stated in a mix without 'parts'; add 'density: 2350 kg/m3' (147 lb/ft3) for "
                "usual concrete, or list the ingredients as 'parts'"
            )
        return own, False, {}
    parts = given["parts"]
    if not isinstance(parts, Mapping) or not parts:
        problem = "must list the ingredients of a cubic metre of concrete"
        refuse("mix parts", parts, problem, "for example {cement: 340 kg/m3, water: 170 kg/m3}")
    masses, load = {}, _number(given, "volume")
    for name, value in _by_volume(parts, load).items():
        with errors_located_at(parts, name):
            _check_ingredient(str(name), value)
            if value is None and str(name)[:1].isdigit():
                problem = "is an amount without a name; a comma inside braces separates entries"
                before = ["", *parts.values()][list(parts).index(name)]
                number = f"{before}{name}" if bare_number(before) else str(name)
                hint = f"write {number} without a comma, or one ingredient per line"
                refuse("mix parts", str(name), problem, hint)
            masses[str(name)] = mass_per_volume(str(name), value, load)
            hint = "give the mass in a cubic metre, and leave out ingredients without mass"
            between(f"mix parts: {name}", masses[str(name)], MIN_AMOUNT, 5000, "kg/m3", hint)
    _check_units(parts)
    total = sum(masses.values())
    if own is not None and abs(total / own - 1) > DENSITY_TOLERANCE:
        problem = f"contradicts 'parts', which add up to {total:.5g} kg/m3"
        refuse("mix density", own, problem, "correct 'parts', or leave out 'density'")
    if own is None:
        between(
            "sum of mix parts",
            total,
            1000,
            5000,
            "kg/m3",
            "list all ingredients of a cubic metre, including aggregates; if they are the ingredients of a whole load, "
            "add its volume as 'volume'",
        )
    check_volume(masses, heavy, air)
    return (total, True, masses) if own is None else (own, False, masses)


def _check_units(parts: Mapping[str, object]) -> None:
    """Warn about ingredients without a unit beside ingredients in customary US units."""
    unit = customary_unit(parts.values(), "kg/m3")
    bare = [name for name, value in parts.items() if bare_number(value)]
    if unit is None or not bare:
        return
    with errors_located_at(parts, bare[0]):
        stated = ", ".join(f"{name}: {parts[name]}" for name in bare)
        warn(
            f"mix parts: {stated}: without a unit, this is in kg/m3, but other ingredients are in {unit}; "
            f"did you mean '{parts[bare[0]]} {unit}'?"
        )


def _by_volume(parts: Mapping[str, object], load: float | None) -> dict[str, Any]:
    """Return the ingredients, with amounts of admixtures per 100 lb or 100 kg converted to amounts per volume.

    An amount such as "4 oz/cwt" refers to the cementitious material, which is cement with slag, ash and the like. The
    amount is converted only if the mass of this material is known; other texts stay as they are. `load` is the volume
    of the concrete in which the ingredients are contained [m3], or None for a cubic metre.
    """
    dosed = {name: ingredients for name, value in parts.items()
             if isinstance(value, str) and (ingredients := PER_BINDER.fullmatch(value.strip()))}  # fmt: skip
    ingredients, binder = dict(parts), 0.0
    for name, value in parts.items() if dosed else ():
        if is_cementitious(str(name)):
            with errors_located_at(parts, name):
                binder += mass_per_volume(str(name), value, load)
    pounds = binder / amount("binder", "1 lb/yd3", "kg/m3")
    if binder > 0:
        ingredients |= {name: f"{float(text[1]) * pounds / 100:.6g} oz/yd3" if text[2] else
                  f"{float(text[1]) * binder / 100:.6g} ml/m3" for name, text in dosed.items()}  # fmt: skip
    return ingredients


def _share(given: object, heavy: float, unusual: str | None) -> float:
    """Return the volume fraction of coarse aggregate in the concrete, from the entry `aggregate` of a mix.

    An amount in kg/m3 is divided by the density `heavy` of the stones [kg/m3]. `unusual` is the name of stones whose
    density differs from `heavy`, or None. Raises :class:`SceneError` if the stones cannot fit into the volume, or if an
    amount in kg/m3 belongs to such stones.
    """
    if is_amount(given, "kg/m3") and unusual is not None:
        refuse(
            "mix aggregate",
            given,
            f"is a mass, so the density of {quoted(unusual)} must be stated",
            "add 'aggregate_density', as in 'aggregate_density: 1250 kg/m3', or state a share of the volume",
        )
    if is_amount(given, "kg/m3"):
        share = amount("mix aggregate", given, "kg/m3") / heavy
    else:
        share = amount("mix aggregate", given, "m3/m3")
        if share > 1:
            problem = "must be a share of the volume below 1, or an amount with a unit"
            refuse("mix aggregate", given, problem, "for example '36 %', '360 l/m3', '950 kg/m3' or '1600 lb/yd3'")
    positive("mix aggregate", share)
    if share >= PACKING:
        problem = f"is {share:.3g} of the volume, more than the share {PACKING} that loosely packed stones fill"
        refuse("mix aggregate", given, problem, "give the coarse aggregate without sand")
    return share


def _check_share(stated: object, share: float, masses: Mapping[str, float], heavy: float) -> None:
    """Warn if the stated volume fraction of coarse aggregate, `share`, contradicts the ingredients.

    `stated` is the entry `aggregate` of the mix, and `heavy` the density of the stones [kg/m3].
    """
    _, stones = sand_and_stone_volumes(masses, heavy)
    if stones > 0 and abs(share / stones - 1) > SHARE_TOLERANCE:
        warn(
            f"mix aggregate: {stated} is {100 * share:.3g} % of the volume, but the stones in 'parts' fill "
            f"{100 * stones:.3g} %; correct one of the two"
        )


def _check_parts(density: float, share: float, heavy: float, own: float | None) -> None:
    """Raise :class:`SceneError` if the densities of concrete, coarse aggregate and mortar contradict each other.

    `share` is the volume fraction of coarse aggregate, `heavy` its density, and `own` the stated density of the mortar,
    or None [kg/m3].
    """
    rest = (density - share * heavy) / (1 - share)
    words = (
        f"implies a density of the mortar of {rest:.4g} kg/m3, if aggregate of {heavy:g} kg/m3 fills {share:.3g} of "
        "the volume"
    )
    if not MORTARS[0] <= rest <= MORTARS[1]:
        problem = f"{words}, but mortars have {MORTARS[0]:g} to {MORTARS[1]:g} kg/m3"
        refuse("mix density", density, problem, "check 'density', 'aggregate' and 'aggregate_density'")
    if own is not None and abs(rest / own - 1) > DENSITY_TOLERANCE:
        problem = f"{words}, but the density of the mortar is given as {own:g} kg/m3"
        refuse("mix density", density, problem, "correct or leave out one of the two densities")
