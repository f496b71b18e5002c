"""Parser for amounts with units, such as `30 m3/h`, `125 mm` or `4 1/2 in`, which it converts to numbers in SI units.

One parser serves files, the command and parameters in Python. The schemas of files use the same patterns.
"""

import functools
import math
import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from typing import cast

import numpy as np

from ..errors import refuse, suggested
from ..narrowing import is_number
from ..written_numbers import WrittenNumber

NUMBERS = (int, float, np.integer, np.floating)
INCH, FOOT, YARD = 0.0254, 0.3048, 0.9144
"""Lengths of inch, foot and yard [m]."""
GALLON = 231 * INCH**3
"""Volume of the US gallon [m3]."""
POUND = 0.45359237
"""Mass of the avoirdupois pound [kg]."""
PSI = POUND * 9.80665 / INCH**2
"""One pound-force per square inch (psi) [Pa]."""
UNITS = {
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "um": 1e-6, "in": INCH, "inch": INCH, "inches": INCH,
          "in.": INCH, '"': INCH, "\u201d": INCH, "\u2033": INCH, "ft": FOOT, "ft.": FOOT, "feet": FOOT, "foot": FOOT,
          "'": FOOT, "\u2019": FOOT, "\u2032": FOOT, "yd": YARD},
    "m2": {"m2": 1.0, "m²": 1.0, "cm2": 1e-4, "mm2": 1e-6, "in2": INCH**2, "ft2": FOOT**2},
    "m3": {"m3": 1.0, "m³": 1.0, "l": 1e-3, "L": 1e-3, "cm3": 1e-6, "yd3": YARD**3, "yd³": YARD**3, "cy": YARD**3,
           "ft3": FOOT**3, "gal": GALLON, "fl oz": GALLON / 128, "floz": GALLON / 128, "oz": GALLON / 128},
    "m3/s": {"m3/s": 1.0, "m3/h": 1 / 3600, "m³/h": 1 / 3600, "m3/hr": 1 / 3600, "m³/s": 1.0, "m3/min": 1 / 60,
             "m³/min": 1 / 60, "l/s": 1e-3, "L/s": 1e-3, "l/min": 1e-3 / 60, "L/min": 1e-3 / 60, "l/h": 1e-3 / 3600,
             "L/h": 1e-3 / 3600, "cm3/s": 1e-6, "yd3/h": YARD**3 / 3600, "yd³/h": YARD**3 / 3600,
             "yd3/hr": YARD**3 / 3600, "yd³/hr": YARD**3 / 3600, "cy/h": YARD**3 / 3600, "cy/hr": YARD**3 / 3600,
             "yd3/min": YARD**3 / 60, "yd³/min": YARD**3 / 60, "cy/min": YARD**3 / 60, "ft3/min": FOOT**3 / 60,
             "gal/min": GALLON / 60, "gpm": GALLON / 60},
    "Pa": {"Pa": 1.0, "bar": 1e5, "kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "mbar": 100.0, "N/mm2": 1e6, "N/mm²": 1e6,
           "psi": PSI, "PSI": PSI, "ksi": 1e3 * PSI},
    "Pa/s": {"Pa/s": 1.0, "Pa/min": 1 / 60},
    "W": {"W": 1.0, "kW": 1e3, "hp": 550 * FOOT * POUND * 9.80665},
    "kg": {"kg": 1.0, "t": 1e3, "g": 1e-3, "lb": POUND, "lbs": POUND},
    "Pa/m": {"Pa/m": 1.0, "kPa/m": 1e3, "MPa/m": 1e6, "bar/m": 1e5, "MPa/100m": 1e4},
    "degrees": {"degrees": 1.0, "deg": 1.0, "°": 1.0, "rad": 180 / math.pi},
    "kg/m3": {"kg/m3": 1.0, "t/m3": 1e3, "kg/m³": 1.0, "t/m³": 1e3, "g/cm3": 1e3, "g/m3": 1e-3, "kg/l": 1e3,
              "kg/L": 1e3, "lb/ft3": POUND / FOOT**3, "lb/ft³": POUND / FOOT**3, "pcf": POUND / FOOT**3,
              "lb/yd3": POUND / YARD**3, "lb/yd³": POUND / YARD**3, "lb/cy": POUND / YARD**3,
              "lbs/yd3": POUND / YARD**3, "lbs/yd³": POUND / YARD**3, "lbs/cy": POUND / YARD**3,
              "pcy": POUND / YARD**3, "lbs/ft3": POUND / FOOT**3, "lbs/ft³": POUND / FOOT**3},
    "m3/m3": {"m3/m3": 1.0, "%": 1e-2, "l/m3": 1e-3, "L/m3": 1e-3, "l/m³": 1e-3, "L/m³": 1e-3, "ml/m3": 1e-6,
              "gal/yd3": GALLON / YARD**3, "gal/yd³": GALLON / YARD**3, "gal/cy": GALLON / YARD**3,
              "oz/yd3": GALLON / 128 / YARD**3, "oz/yd³": GALLON / 128 / YARD**3, "oz/cy": GALLON / 128 / YARD**3,
              "fl oz/yd3": GALLON / 128 / YARD**3, "fl oz/cy": GALLON / 128 / YARD**3, "ft3/yd3": 1 / 27},
    "1": {"1": 1.0, "%": 1e-2},
    "s": {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0, "hr": 3600.0, **dict.fromkeys(("second", "seconds"), 1.0),
          **dict.fromkeys(("minute", "minutes"), 60.0), **dict.fromkeys(("hour", "hours"), 3600.0)},
    "1/s": {"1/s": 1.0, "Hz": 1.0},
    "m/s": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "m/min": 1 / 60, "ft/s": FOOT, "ft/min": FOOT / 60},
    "m/s2": {"m/s2": 1.0, "m/s²": 1.0},
    "N": {"N": 1.0, "mN": 1e-3, "kN": 1e3},
    "N/m": {"N/m": 1.0, "mN/m": 1e-3, "kN/m": 1e3, "N/mm": 1e3},
    "m2/N": {"m2/N": 1.0, "m²/N": 1.0, "1/Pa": 1.0},
    "Pa s": {"Pa s": 1.0, "Pa.s": 1.0, "Pa·s": 1.0, "Pas": 1.0, "mPa s": 1e-3},
    "Pa s/m": {"Pa s/m": 1.0, "Pa.s/m": 1.0, "Pa·s/m": 1.0},
    "Pa s2": {"Pa s2": 1.0, "Pa s²": 1.0, "Pa.s2": 1.0, "Pa·s²": 1.0},
    "Pa s2/m2": {"Pa s2/m2": 1.0, "Pa s²/m²": 1.0, "Pa.s2/m2": 1.0, "Pa·s²/m²": 1.0},
}  # fmt: skip
"""Accepted unit names, by internal unit: `UNITS[internal][written]` is the factor that converts a value in the written
unit to the internal unit. Gallons and fluid ounces (oz/yd3) are US units."""


def accepted_units(unit: str) -> Mapping[str, float]:
    """Return the units in which an amount may be written, each with its factor to the internal unit `unit`.

    A unit that :data:`UNITS` does not list, such as the unit of a parameter in a user's own contact law, has no
    alternatives: the result contains only this unit itself.
    """
    return UNITS.get(unit) or {unit: 1.0}


CUSTOMARY = {
    *(name for name, factor in UNITS["m"].items() if factor in (INCH, FOOT, YARD)),
    *(name for unit in ("m3/s", "m3", "kg", "kg/m3", "m3/m3") for name in UNITS[unit]
      if name.startswith(("yd", "cy", "ft", "gal", "gpm", "fl", "oz", "lb", "pc"))),
    *("psi", "PSI", "ksi", "hp"),
}  # fmt: skip
"""Names of the customary US units of lengths, volumes, masses, flows, pressures and powers."""
DECIMAL = r"(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
"""Pattern of a number without sign, with an optional decimal point and an optional exponent: `12`, `0.5` or `1e-3`."""
COMMA = r"(?:0,[0-9]+|[0-9]{1,3},(?:[0-9]{1,2}|[0-9]{4,})|[0-9]{4,},[0-9]+)"
"""Pattern of a number whose comma can only be a decimal comma: `12,5` or `0,125`. In `1,234` the comma may also
separate thousands."""
PROPER = r"[0-9]{1,2}/(?:2|4|8|16|32|64)"
"""Pattern of a fraction as on tape measures, such as `3/8`: the denominator is a power of 2 up to 64."""
FRACTION = rf"(?:[0-9]{{1,4}}(?:\s+|\s?-\s?))?{PROPER}"
"""Pattern of a number written with a fraction, such as `4 1/2` or `4-1/2`, without sign and unit."""
LONGEST = 100
"""Maximum length of the text of an amount, in characters."""


def _names(factors: tuple[float, ...]) -> str:
    """Return a regular expression for the names of all units of length whose size in metres is in `factors`."""
    return _alternatives(name for name, factor in UNITS["m"].items() if factor in factors)


def _alternatives(names: Iterable[str]) -> str:
    """Return a regular expression that matches any one of the `names`; it tries longer names first."""
    return "|".join(_escaped(name) for name in sorted(names, key=len, reverse=True))


def _escaped(name: str) -> str:
    """Return a regular expression that matches `name`, valid both in Python and in JSON schemas (ECMA 262)."""
    return "".join(f"\\{each}" if each in ".^$*+?()[]{}|" else each for each in name)


@functools.cache
def patterns(unit: str) -> tuple[str, ...]:
    """Return regular expressions for the texts that :func:`amount` accepts in `unit`.

    The caller must strip spaces from both ends of a text before matching. The groups of the first expression are the
    number and its unit. For lengths there are two more expressions: the groups of the second expression are a number
    with a fraction and its unit (inch or foot), and the groups of the third expression are feet and inches.
    """
    simple = rf"([-+]?(?:{COMMA}|{DECIMAL}))\s*({_alternatives(accepted_units(unit))})?"
    if unit != "m":
        return (simple,)
    inches, feet = _names((INCH,)), _names((FOOT,))
    below_twelve = rf"(?:1[01]|[0-9])(?:\.[0-9]{{1,6}}|\s+{PROPER})?"
    return (
        simple,
        rf"([-+]?{FRACTION})\s*({inches}|{feet})",
        rf"([-+]?[0-9]{{1,5}})\s*(?:{feet})[\s-]{{0,3}}({below_twelve}|{PROPER})\s*(?:{inches})",
    )


@functools.cache
def _compiled(unit: str) -> tuple[re.Pattern[str], ...]:
    return tuple(re.compile(each) for each in patterns(unit))


def _decimal(text: str) -> float:
    """Return the number in a text with a decimal point or an unambiguous decimal comma."""
    return float(text.replace(",", "."))


def _mixed(text: str) -> float:
    """Return the signed number in a text such as `1/2` or `4 1/2`.

    Return NaN for a mixed number whose fraction is not below 1, such as `4 3/2`.
    """
    sign = -1.0 if text.startswith("-") else 1.0
    *whole, fraction = re.split(r"[\s-]+", text.lstrip("+-"))
    upper, lower = (int(each) for each in fraction.split("/"))
    if whole and upper >= lower:
        return math.nan
    return sign * (sum(int(each) for each in whole) + upper / lower)


def _plain_digits(text: str) -> str:
    """Return a text in which decimal digits of all scripts, such as Arabic ones, are replaced by 0 to 9."""
    return "".join(str(unicodedata.decimal(each)) if each.isdecimal() else each for each in text)


def _parsed(text: str, unit: str) -> float:
    """Return a text as a number in `unit`, or NaN if the text is not an amount in that unit."""
    text = text if text.isascii() else _plain_digits(text)
    forms = [pattern.fullmatch(text) for pattern in _compiled(unit)]
    if forms[0]:
        return _decimal(forms[0][1]) * accepted_units(unit)[forms[0][2] or unit]
    if len(forms) > 1 and forms[1]:
        return _mixed(forms[1][1]) * UNITS["m"][forms[1][2]]
    if len(forms) > 1 and forms[2]:
        feet, inches = forms[2][1], forms[2][2]
        more = INCH * (_mixed(inches) if "/" in inches else float(inches))
        return FOOT * int(feet) + (-more if feet.startswith("-") else more)
    return math.nan


def bare_number(value: object) -> bool:
    """Return whether `value` is a number, or a text that holds a number without a unit."""
    if not isinstance(value, str):
        return isinstance(value, NUMBERS)
    text = _plain_digits(value.strip()) if len(value) <= LONGEST else ""
    return re.fullmatch(f"[-+]?(?:{COMMA}|{DECIMAL})", text) is not None


def is_amount(value: object, unit: str) -> bool:
    """Return whether `value` is a text with a number and a unit that :func:`amount` accepts in `unit`."""
    return (
        isinstance(value, str)
        and len(value) <= LONGEST
        and not bare_number(value)
        and math.isfinite(_parsed(value.strip(), unit))
    )


def is_customary(value: object) -> bool:
    """Return whether `value` is an amount in a customary US unit, or a list or mapping that contains such an amount."""
    if isinstance(value, Mapping):
        return any(map(is_customary, cast("Mapping[object, object]", value).values()))
    if isinstance(value, str):
        return len(value) <= LONGEST and _customary().fullmatch(value.strip()) is not None
    return isinstance(value, Sequence) and any(map(is_customary, cast("Sequence[object]", value)))


@functools.cache
def _customary() -> re.Pattern[str]:
    return re.compile(rf"[-+]?\.?[0-9](?:.*[0-9.])?\s*(?:{_alternatives(CUSTOMARY)})")


def unit_names(unit: str) -> list[str]:
    """Return one name of each unit in which an amount may be written, without synonyms; `unit` is its internal unit."""
    factors: dict[float, str] = {}
    for name, factor in accepted_units(unit).items():
        factors.setdefault(factor, name)
    return list(factors.values())


def customary_unit(values: Iterable[object], unit: str) -> str | None:
    """Return the first customary US unit in which one of the `values` is written; None if there is none.

    `unit` is the internal unit.
    """
    units = (written_unit([value], unit) for value in values if is_customary(value))
    return next((each for each in units if each is not None), None)


def written_unit(values: Iterable[object], unit: str) -> str | None:
    """Return the unit in which all `values` are written; None if they have no unit or different units.

    `unit` is the internal unit. Synonyms count as one unit: the result for "5 m³/h" is "m3/h".
    """
    factors: set[float | None] = set()
    for value in values:
        text = value.strip() if isinstance(value, str) and len(value) <= LONGEST else ""
        form = _compiled(unit)[0].fullmatch(text if text.isascii() else _plain_digits(text))
        factors.add(accepted_units(unit)[form[2]] if form and form[2] else None)
    factor = factors.pop() if len(factors) == 1 else None
    return next((name for name in unit_names(unit) if accepted_units(unit)[name] == factor), None)


def amount(field: str, value: object, unit: str) -> float:
    """Convert a number or a text such as "125 mm" to a number in the internal unit `unit`.

    A text may have any of the :func:`accepted_units` of `unit`. A number without a unit counts as a number in `unit`.
    The result for a text with a unit is a :class:`WrittenNumber`, so that messages quote the text. Lengths may be
    fractions of inches ("4 1/2 in") and feet with inches ("6 ft 3 in"). A decimal comma is accepted if it cannot
    separate thousands. Raises :class:`SceneError` about the parameter `field` for an unknown unit, or if
    `value` is not a finite number.
    """
    number, more = math.nan, ""
    if isinstance(value, str):
        text = value.strip() if len(value) <= LONGEST else ""
        number = _parsed(text, unit)
        if not math.isfinite(number):
            more = _advice(text, unit)
    elif is_number(value):
        with suppress(OverflowError):
            number = float(value)
    if not math.isfinite(number):
        names = unit_names(unit) if unit in UNITS else []
        units = f"with one of the units {', '.join(names)}" if len(names) > 1 else f"with the unit {unit}"
        if unit == "1":
            units = "without a unit, or with %"
        if not names:
            units = f"in {unit}"
        problem = f"must be a number {units}{more and f'; {more}'}"
        refuse(field, value, problem, "" if unit == "1" else f"a number without a unit is in {unit}")
    return WrittenNumber(number + 0.0, value.strip()) if isinstance(value, str) and not bare_number(value) else number


def listed(text: str) -> list[str]:
    """Return the texts that commas or semicolons separate in `text`, without brackets around the list."""
    return [each.strip() for each in re.split("[,;]", text.strip("[]() "))]


OTHER_QUANTITIES = {
    "m3/s": ("m/s", "this is a velocity; multiply it by the area of the bore, 0.785 times its diameter squared"),
    "m/s": ("m3/s", "this is a flow; divide it by the area of the bore, 0.785 times its diameter squared"),
}
"""Advice for users who wrote the unit of another quantity by mistake. The key is the required unit; the value is a pair
of the wrong unit and the advice."""


def _advice(text: str, unit: str) -> str:
    """Return a sentence on what may be wrong with a text that is not an amount in `unit`, or an empty text."""
    other, conversion = OTHER_QUANTITIES.get(unit, ("", ""))
    if other and is_amount(text, other):
        return conversion
    if text.endswith((",", ";")):
        rest = text[:-1].rstrip()
        if math.isfinite(_parsed(rest, unit)):
            return f"leave out the {'comma' if text.endswith(',') else 'semicolon'} at the end"
        return _advice(rest, unit)
    if re.match(r"[-+]?[0-9]{1,3}(?:[.,][0-9]{3})+[.,][0-9]*(?![0-9.,])", text):
        return "leave out separators of thousands"
    if match := re.match(r"[-+]?([0-9]{1,3}),([0-9]{3})(?![0-9])", text):
        return (
            f"the comma in {match[0]} may separate decimals or thousands; write {match[1]}.{match[2]} or "
            f"{match[1]}{match[2]}"
        )
    if len(pieces := listed(text)) > 1 and all(math.isfinite(_parsed(each, unit)) for each in pieces):
        return f"this is a list of {len(pieces)} numbers, but must be one number"
    if re.match(r"[-+]?[0-9]+(?:[\s-]+[0-9]+)?/[0-9]", text):
        return ("write fractions of inches or feet as '4 1/2 in', in halves to sixty-fourths" if unit == "m"
                else "write a decimal number instead of a fraction")  # fmt: skip
    if unit == "m" and (bore := re.fullmatch(r"DN\s*([0-9]{2,4})", text, re.IGNORECASE)):
        return f"write the inner diameter, as in '{bore[1]} mm'"
    match = re.fullmatch(rf"[-+]?(?:{COMMA}|{DECIMAL})\s*(.*)", text)
    return _suggested_unit(match[1], unit) if match and match[1] else ""


WORDS_OF_UNITS: Mapping[str, Mapping[str, str]] = {
    "m3/s": dict.fromkeys(("m3", "m³", "cbm", "cbm/h", "m^3/h", "m3/hour", "m3h", "m³h"), "m3/h"),
    "m": {"millimeter": "mm", "millimetre": "mm", "centimeter": "cm", "centimetre": "cm", "meter": "m", "metre": "m"},
    "s": {"m": "min", "mins": "min", "sec": "s", "secs": "s", "hrs": "h"},
    "degrees": dict.fromkeys(("grad", "degree", "grade"), "degrees"),
    "Pa": {"N/m2": "Pa", "N/m²": "Pa", "bars": "bar"},
    "kg/m3": {"g/cm³": "g/cm3"},
}  # fmt: skip
"""Words that users write instead of a unit, by internal unit, each with the unit that is meant."""


def _suggested_unit(written: str, unit: str) -> str:
    """Return the question "did you mean ...?" with the accepted unit that is most similar to `written`, or nothing.

    `unit` is the internal unit. A synonym such as "Pas" is suggested in its usual spelling.
    """
    words = WORDS_OF_UNITS.get(unit, {})
    if (similar := words.get(written) or words.get(written.lower())) is not None:
        return f"did you mean {similar!r}?"
    if len(written) > 1 and unit.startswith(written):
        return f"did you mean {unit!r}?"
    near = re.search(r"'(.*)'", suggested(written, accepted_units(unit)))
    if near is None:
        return ""
    if near[1][:3] == written[:3]:
        return f"did you mean {near[1]!r}?"
    factor = accepted_units(unit)[near[1]]
    return f"did you mean {next(name for name in unit_names(unit) if accepted_units(unit)[name] == factor)!r}?"
