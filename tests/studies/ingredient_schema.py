"""Part of the JSON schema of a mix that checks the names of ingredients, derived from the words the program knows."""

import re
from collections.abc import Iterable
from typing import Any

from warpcrete.mix.entries import NUMBERS, OTHER_NAMES, TOTALS
from warpcrete.mix.ingredients import DENSITIES, LIQUIDS, POWDERS, VARIABLE

SHORTEST = 4
"""Smallest number of letters of a known word whose misspellings the schema refuses."""
NO_INGREDIENTS = (*TOTALS, *OTHER_NAMES, *(name.replace("_", " ") for name in NUMBERS), "sizes", "sieve", "shape")
"""Names of sums and of other entries of a mix, which the program refuses as ingredients."""


def parts_schema(amount: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of the entry `parts`, whose values have the schema `amount`.

    Editors complete the known words. Other names stay valid, because the program accepts trade names; but a name that
    is one letter away from a known word is not valid, and neither is an abbreviation or the name of another entry.
    """
    return {
        "type": "object",
        "minProperties": 1,
        "properties": {word: {**amount, "description": _described(word)} for word in DENSITIES},
        "additionalProperties": amount,
        "propertyNames": {"not": {"anyOf": [{"pattern": each} for each in (_misspelt(), _short(), _other_entries())]}},
    }


def _described(word: str) -> str:
    """Return what an ingredient with the name `word` is, with its density."""
    kind = "powder" if word in POWDERS else "liquid" if word in LIQUIDS else "aggregate or fibres"
    return f"{kind}, {DENSITIES[word]:g} kg/m3"


def _any_case(text: str) -> str:
    """Return a regular expression for a word with a small or a capital first letter."""
    return f"[{text[0]}{text[0].upper()}]{text[1:]}"


def _words(words: Iterable[str]) -> str:
    return "|".join(_any_case(word) for word in words)


def _misspelt() -> str:
    """Return a regular expression for single words with one wrong, missing, surplus or transposed letter."""
    found: dict[str, None] = {}
    for word in (word for word in DENSITIES if len(word) >= SHORTEST):
        for k in range(1, len(word)):
            found[f"{_any_case(word[:k])}[a-z]{{0,2}}{word[k + 1 :]}"] = None
            found[f"{_any_case(word[:k])}{word[k : k + 2][::-1]}{word[k + 2 :]}"] = None
    return f"^(?!(?:{_words((*DENSITIES, *VARIABLE))})$)(?:{'|'.join(found)})$"


def _short() -> str:
    """Return a regular expression for names of one or two letters that are no known word."""
    known = ("".join(f"[{each}{each.upper()}]" for each in word) for word in (*DENSITIES, *VARIABLE) if len(word) < 3)
    return f"^(?!(?:{'|'.join(known)})$)[A-Za-z]{{1,2}}$"


def _other_entries() -> str:
    """Return a regular expression for the names of other entries of a mix."""
    names = [r"[\W_]+".join(_any_case(word) for word in re.split(" ", name)) for name in NO_INGREDIENTS]
    return rf"^[\W_]*(?:{'|'.join(names)})[\W_]*$"
