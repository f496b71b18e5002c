"""Read the sieve curve, the sizes and the shape of the coarse aggregate from the entries of a mix."""

import re
from collections.abc import Mapping, Sequence

from ..core.errors import between, one_of, refuse, suggested
from ..core.inputs.amounts import amount, bare_number, is_amount

SHAPES = {"spheres": "spheres", "round": "spheres", "rounded": "spheres", "crushed": "reference",
          "angular": "reference", "reference": "reference"}  # fmt: skip
"""Words that a mix may use for the shape of stones, each mapped to the name of a shape in scenes of discrete elements.
Instead of a word, a mix may state the ratio of longest to shortest width. The stones are then elongated clumps of
spheres."""
SMALLEST = 4e-3
"""Diameter of the smallest coarse aggregate that is assumed if only the largest is stated [m]."""
FINEST, COARSEST = 1e-3, 0.3
"""Smallest and largest diameter of coarse aggregate that a mix may state [m]. Finer grains belong to the mortar."""
SIZE_NUMBERS = {
    "#1": (37.5e-3, 90e-3), "#2": (37.5e-3, 63e-3), "#3": (25e-3, 50e-3), "#357": (4.75e-3, 50e-3),
    "#4": (19e-3, 37.5e-3), "#467": (4.75e-3, 37.5e-3), "#5": (12.5e-3, 25e-3), "#56": (9.5e-3, 25e-3),
    "#57": (4.75e-3, 25e-3), "#6": (9.5e-3, 19e-3), "#67": (4.75e-3, 19e-3), "#7": (4.75e-3, 12.5e-3),
    "#78": (2.36e-3, 12.5e-3), "#8": (2.36e-3, 9.5e-3), "#89": (1.18e-3, 9.5e-3),
}  # fmt: skip
"""Smallest and largest nominal size of coarse aggregate [m] by its size number (ASTM C33, grading requirements for
coarse aggregates)."""
UNIT = r"(?:mm|cm|in\b|inch(?:es)?\b|[\"\u201d\u2033])"
"""Pattern of a unit in which the name of an ingredient may state a size of stones."""
SIZE = r"(?<![0-9/])(?<![0-9][.,])(?:(?:[1-3][ -])?[0-9]+/[0-9]+|[0-9]+(?:[.,][0-9]+)?|(?<![^\s(])\.[0-9]+)"
"""Pattern of a size without its unit, such as '20', '9.5', '3/4' or '1 1/2'."""
NO_AMOUNT = rf"(?!\s*(?:[-\u2013/]|to\b)\s*[0-9]|[.,][0-9]|\s*{UNIT})(?!(?<=\b[1-3])\s+[0-9]+/[0-9])"
"""Pattern that follows a number and fails if this number is part of a range, a decimal, a fraction or an amount with a
unit, such as '5-20', '9.5', '1 1/2' or '20 mm'. Such a number is no size number."""
MARKED = re.compile(rf"(?:\bsize\s+)?(?:#|\b(?:no|number|size)\b\.?)\s*([0-9]+)s?\b{NO_AMOUNT}", re.IGNORECASE)
"""Pattern of a size number with a mark in the name of an ingredient, such as '#57', 'No. 57' or 'number 57'. The number
in 'size 20 mm' is no size number."""
BLEND = re.compile(r"#\s*([0-9]+)\s*[/-]\s*([0-9]+)\b")
"""Pattern of two size numbers after one mark, as in '#57/67'."""
RANGE = re.compile(rf"({SIZE})\s*({UNIT})?\s*([-\u2013/]|to\b)\s*((?:[1-3][ -])?[0-9]+(?:[/.,][0-9]+)?)\s*({UNIT})")
"""Pattern of the smallest and the largest size with their unit in the name of an ingredient, such as '5-20 mm'."""
SIEVES = re.compile(
    r"(?<![0-9./,#])(?!(?:1/2|3/4|[1357]/8)\b)([0-9]+(?:[.,][0-9]+)?)\s*[/-]\s*([0-9]+(?:[.,][0-9]+)?)"
    r"(?![0-9/]|\s*(?:in|\"|[u\u00b5\u03bc]m))"
)
"""Pattern of two sieve openings in millimetres in the name of an ingredient, such as '4/16'. It does not match a
fraction of an inch, such as '3/8'."""
LARGEST = re.compile(rf"{SIZE}\s*{UNIT}")
"""Pattern of a size with its unit in the name of an ingredient, such as '20 mm' or '3/4 in'."""
STONES = r"\s+(?:(?:crushed|coarse|washed)\s+)*(?:stone|rock|limestone|granite|gravel|aggregate)s?\b"
"""Pattern of the words for stones that may follow a size number."""
UNMARKED = re.compile(rf"(?<![0-9.,/\u2013-])\b([0-9]{{2,3}})s?{STONES}", re.IGNORECASE)
"""Pattern of a number of two or three digits before a word for stones, as in '57 stone'. The number is a size number
only if it is one of `SIZE_NUMBERS`. A single digit is no size number, because '8 gravel' may mean 8 mm."""
NUMBER_OF_STONES = re.compile(rf"([0-9]+)s?{STONES}", re.IGNORECASE)
"""Pattern of a size number before a word for stones at the start of a text that states the size of stones."""


def size_numbers(name: str) -> list[str]:
    """Return the size numbers (ASTM C33) in the name of an ingredient, such as ['#57'] for 'No. 57 stone'.

    A number with a mark, such as '#58', is included even if ASTM C33 has no such number.
    """
    name = BLEND.sub(_marked_twice, name)
    plain = (f"#{digits}" for digits in UNMARKED.findall(name))
    return [*(f"#{digits}" for digits in MARKED.findall(name)), *(each for each in plain if each in SIZE_NUMBERS)]


def _marked_twice(blend: re.Match[str]) -> str:
    """Return the text of a match of :data:`BLEND` with "#" before both numbers: '#57/#67' for '#57/67'.

    The text is returned unchanged if one of the numbers is unknown.
    """
    numbers = [f"#{each}" for each in blend.groups()]
    return "/".join(numbers) if all(each in SIZE_NUMBERS for each in numbers) else blend[0]


def is_size_number(name: str) -> bool:
    """Return whether a name consists of a known size number with a mark, such as '#57' or 'No. 57'."""
    return MARKED.fullmatch(name.strip()) is not None and size_numbers(name)[0] in SIZE_NUMBERS


def sizes_with_unit(name: str) -> tuple[float, float] | None:
    """Return the smallest and the largest size of stones [m] that a name states with a unit.

    The name may state a range ('gravel 5-20 mm') or only the largest size ('3/4 in rock', 'aggregate 20 mm'). The
    result is None if the name states no size with a unit.
    """
    name = " ".join(name.lower().split())
    ranges = [span for texts in RANGE.findall(name) if (span := _range(*texts)) is not None]
    if ranges:
        return min(low for low, _ in ranges), max(high for _, high in ranges)
    texts = [span[0] for span in LARGEST.finditer(name) if is_amount(span[0], "m")]
    sizes = [size for each in texts if 2 * SMALLEST <= (size := amount("mix parts", each, "m")) <= COARSEST]
    return (SMALLEST, max(sizes)) if sizes else None


def _range(low: str, unit: str, joint: str, high: str, last: str) -> tuple[float, float] | None:
    """Return the smallest and the largest size [m] from a match of :data:`RANGE`; None if it is no range of sizes.

    Metric ranges may begin with the larger size, as in '19.0 to 4.75 mm'. In inches, '1-1/2 in' and '3/4 in' are
    single sizes.
    """
    ends, metric = (f"{low} {unit or last}", f"{high} {last}"), last in ("mm", "cm")
    if (joint == "/" and not metric) or not all(is_amount(each, "m") for each in ends):
        return None
    first, second = (amount("mix parts", each, "m") for each in ends)
    if first > second and metric and f"#{low}" not in SIZE_NUMBERS:
        first, second = second, first
    return _possible(first, second)


def _possible(low: float, high: float) -> tuple[float, float] | None:
    """Return the sizes `low` and `high` of stones [m], with :data:`SMALLEST` as the lower one if `low` is below 1 mm.

    A lower size below 1 mm is a size of sand. The result is None if stones cannot have these sizes.
    """
    if not max(low, FINEST) < high <= COARSEST or high < 2 * SMALLEST:
        return None
    return low if low >= FINEST else SMALLEST, high


def named_sizes(name: str) -> tuple[float, float] | None:
    """Return the smallest and the largest size of stones [m] that the name of an ingredient states, or None.

    The name may state sizes with a unit (see :func:`sizes_with_unit`), which take precedence, a size number ('#67
    stone'), or two sieves in millimetres ('gravel 4/16').
    """
    if (stated := sizes_with_unit(name)) is not None:
        return stated
    sizes = [SIZE_NUMBERS[number] for number in size_numbers(name) if number in SIZE_NUMBERS]
    if sizes:
        return min(low for low, _ in sizes), max(high for _, high in sizes)
    if (sieves := SIEVES.search(name)) is not None:
        low, high = (1e-3 * float(each.replace(",", ".")) for each in sieves.groups())
        return _possible(low, high)
    return None


def sizes_by_number(field: str, text: str) -> tuple[float, float] | None:
    """Return the smallest and the largest size [m] that belong to the size number in a text, such as '#57 stone'.

    The result is None if the text contains no size number. `field` is the name of the entry or option, for error
    messages. Raises :class:`warpcrete.SceneError` for an unknown number.
    """
    number = MARKED.match(text.strip()) or NUMBER_OF_STONES.match(text.strip())
    if number is None:
        return None
    if (stated := sizes_with_unit(text)) is not None:
        return stated
    one_of(field, f"#{number[1]}", SIZE_NUMBERS)
    return SIZE_NUMBERS[f"#{number[1]}"]


def read_sieve(given: object) -> tuple[tuple[float, float], ...]:
    """Return a sieve curve as pairs of opening [m] and mass fraction that passes.

    `given` maps the openings of the sieves [mm] to the mass fractions that pass them, which may also be percentages.
    Raises :class:`warpcrete.SceneError` if these values do not form a sieve curve.
    """
    example = "for example {4: 0, 8: 0.4, 16: 1}: opening [mm] and share of the mass that passes"
    if not isinstance(given, Mapping) or len(given) < 2:
        refuse("mix sieve", given, "must have two or more openings, each with the share that passes", example)
    opened = {
        amount("mix sieve: opening", f"{key} mm" if bare_number(key) else key, "m"): value
        for key, value in given.items()
    }
    widest = max(opened)
    if widest > COARSEST:
        problem = f"must be at most {1e3 * COARSEST:g} mm"
        refuse("mix sieve: opening", f"{1e3 * widest:g} mm", problem, "openings without a unit are in mm")
    if len({isinstance(value, str) for value in opened.values()}) > 1:
        refuse("mix sieve", dict(given), "must have shares that are either all with %, or all without", example)
    passing = [amount("mix sieve: passing", value, "1") for value in opened.values()]
    if passing[-1] == 100:
        passing = [value / 100 for value in passing]
    openings = list(opened)
    if len(openings) < len(given) or openings != sorted(openings) or openings[0] <= 0:
        refuse("mix sieve", given, "must have increasing openings above 0", example)
    if passing != sorted(passing):
        fall = next(k for k in range(1, len(passing)) if passing[k] < passing[k - 1])
        refuse("mix sieve", given, f"falls from {passing[fall - 1]:g} at {1e3 * openings[fall - 1]:g} mm to "
               f"{passing[fall]:g} at {1e3 * openings[fall]:g} mm: a wider opening must not have a smaller "
               "share", example)  # fmt: skip
    if passing[0] != 0 or passing[-1] != 1:
        refuse("mix sieve", given, "must have shares that rise from 0 to 1, or from 0 to 100 %", example)
    if openings[0] < FINEST:
        problem = f"begins below {1e3 * FINEST:g} mm, but sand is simulated as part of the mortar"
        refuse("mix sieve", given, problem, "give the curve of the coarse aggregate alone, without sand")
    return tuple(zip(openings, passing, strict=True))


def read_sizes(given: object) -> tuple[float, float]:
    """Return the smallest and the largest size of a mix's stones [m].

    If the entry is a single amount, it is the largest size, and the smallest is :data:`SMALLEST`. A text such as '#57'
    is a size number of ASTM C33, and so are 'No. 57', '57 stone' and '#57 stone'. Raises
    :class:`warpcrete.SceneError` if the entry is not an amount, a size number or a pair of possible sizes.
    """
    if given is None:
        hint = "write '20 mm', or put a size number of ASTM C33 in quotes, as in '#57', because # starts a comment"
        refuse("mix sizes", given, "is empty", hint)
    if isinstance(given, str) and (sizes := sizes_by_number("mix sizes", given)) is not None:
        return sizes
    if isinstance(given, str | int | float) and not isinstance(given, bool):
        if ends := re.fullmatch(r"([0-9.]+)\s*(?:-|\u2013|/|to)\s*([0-9.]+)\s*mm", str(given).strip()):
            refuse("mix sizes", given, "is a range", f"write [{ends[1]} mm, {ends[2]} mm]")
        largest = amount("mix sizes", given, "m")
        hint = "write millimetres as in '20 mm'"
        if bare_number(given) and f"#{largest:g}" in SIZE_NUMBERS:
            hint += f", or a size number of ASTM C33 as in '#{largest:g}'"
        between("largest of mix sizes", largest, 2 * SMALLEST, COARSEST, "m", hint)
        return SMALLEST, largest
    if not isinstance(given, Sequence) or isinstance(given, str) or len(given) != 2:
        problem = "must be the largest size, or the smallest and the largest"
        refuse("mix sizes", given, problem, "for example '20 mm' or [5 mm, 20 mm]")
    low, high = (amount("mix sizes", each, "m") for each in given)
    between("largest of mix sizes", high, FINEST, COARSEST, "m", "write millimetres as in '20 mm'")
    between(
        "smallest of mix sizes",
        low,
        FINEST,
        high,
        "m",
        "write the smaller size first; finer grains belong to the mortar and are left out",
    )
    return low, high


def example_size(given: object) -> str:
    """Return a text such as '20 mm' that an error message suggests for the entry `sizes`.

    `given` is the size of the largest stone, which the user has stated under another name. A number without a unit
    is taken as metres if stones can have that size, and as millimetres otherwise. The result is '20 mm' if the value is
    not a possible size in either unit.
    """
    if not is_amount(given, "m") and (not bare_number(given) or isinstance(given, bool)):
        return "20 mm"
    size = amount("mix sizes", given, "m")
    if 2 * SMALLEST <= size <= COARSEST:
        return f"{1e3 * size:g} mm" if bare_number(given) else str(given)
    is_millimetres = bare_number(given) and 2 * SMALLEST <= 1e-3 * size <= COARSEST
    return f"{size:g} mm" if is_millimetres else "20 mm"


def read_shape(given: object) -> str:
    """Return the name of the stones' shape in scenes of discrete elements, such as 'spheres'.

    Raises :class:`warpcrete.SceneError` if the entry is neither a known word nor a possible ratio of widths.
    """
    if isinstance(given, int | float) and not isinstance(given, bool):
        between("mix shape", given, 1, 20)
        return f"shape-{given:g}" if given > 1 else "spheres"
    if not isinstance(given, str) or given not in SHAPES:
        hint = suggested(given, SHAPES) or "or give the ratio of longest to shortest width, 1 to 20"
        refuse("mix shape", given, f"must be one of {', '.join(SHAPES)}", hint)
    return SHAPES[given]
