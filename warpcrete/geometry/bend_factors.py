"""Friction factor of all bends of a pipeline, read from the entry `bend_factor` of the pipeline's file."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from ..core.errors import between, one_of, refuse
from ..core.inputs.amounts import amount
from ..core.inputs.text_files import errors_located_at
from .line_entries import BEND_FACTOR, FACTORS
from .pipe_line import Part

EXAMPLE = "for example 'bend_factor: 1.5', or 'bend_factor: {factor: 1.5, low: 1.2, high: 1.9}'"


def with_bend_factor(parts: Sequence[Part], given: object) -> tuple[Part, ...]:
    """Return the parts of a pipeline with the friction factor of the entry `bend_factor` in all bends.

    The entry `given` is a number, or a mapping with the keys :data:`BEND_FACTOR`, which also states the range of the
    factor. A bend with a factor of its own keeps that factor. Raises :class:`SceneError` for a wrong key or value.
    """
    entries = given if isinstance(given, Mapping) else {"factor": given}
    found = {}
    for key, value in entries.items():
        with errors_located_at(entries, key):
            one_of("bend_factor's key", key, BEND_FACTOR)
            found[key] = amount(f"bend_factor: {key}", value, "1")
            # The measuring errors of pressure gauges may exceed the friction of the bends. The range of a fitted factor
            # may therefore begin at 0.
            smallest = 0.0 if key == "low" else FACTORS[0]
            between(f"bend_factor: {key}", found[key], smallest, FACTORS[1], "", "a factor is the friction of a bend "
                    "divided by the friction of straight pipe of the same length")  # fmt: skip
    if "factor" not in found or len(found) == 2:
        refuse("bend_factor", dict(entries), "must have 'factor', and both or none of 'low' and 'high'", EXAMPLE)
    factor = found["factor"]
    span = None if len(found) == 1 else (found["low"], found["high"])
    if span is not None and not span[0] <= factor <= span[1]:
        refuse("bend_factor", dict(entries), "'factor' must lie between 'low' and 'high'", EXAMPLE)
    return tuple(
        replace(part, factor=factor, factor_range=span) if part.kind == "bend" and part.factor is None else part
        for part in parts
    )
