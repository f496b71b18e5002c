"""Colours of quantities, by maps of matplotlib's."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

STEPS, A_DECADE = 2048, 128
"""Of the values that paint tells apart, in all and from one to ten times it."""
LEAST = 1e-6
"""The smallest of them, as read; what is less is shown as nothing."""
COLOURS = 256
"""Of a palette."""


def on_palette(values: np.ndarray, upper: float, lower: float = 0.0, name: str = "viridis") -> np.ndarray:
    """RGB bytes (n, 3) of values from `lower` to `upper`, on a map of matplotlib's, the perceptually even viridis."""
    scaled = np.clip((values - lower) / max(upper - lower, 1e-300), 0, 1)
    return _palette(name)[((COLOURS - 1) * scaled).astype(int)]


def packed(colours: np.ndarray) -> np.ndarray:
    """RGB bytes (n, 3) as one number each, (n,): red highest, then green, blue, and full opacity."""
    red, green, blue = colours.astype(np.uint32).T
    return red << 24 | green << 16 | blue << 8 | np.uint32(255)


@functools.cache
def _palette(name: str) -> np.ndarray:
    from matplotlib import colormaps

    return (255 * colormaps[name](np.arange(COLOURS))[:, :3]).astype(np.uint8)


@dataclass(frozen=True)
class Paint:
    """Colours of a quantity on walls, of which nobody knows beforehand how far it will grow.

    Recordings hold steps of the values, whatever the scale, and the colours of all steps once: when the scale grows
    these alone are written anew, and earlier frames show the scale of later ones.
    """

    label: str
    """With the unit in which values are read."""
    palette: str
    upper: float
    """End of the scale, which begins at 0, as read; 0: there is nothing to show yet."""

    @property
    def unit(self) -> str:
        """Of the label."""
        return self.label.rpartition("[")[2].rstrip("]")

    def colours(self) -> np.ndarray:
        """RGB bytes of all steps, shape (STEPS, 3)."""
        values = LEAST * 10 ** (np.arange(STEPS) / A_DECADE)
        values[0] = 0.0
        return on_palette(values, self.upper if self.upper > 0 else np.inf, name=self.palette)

    def steps(self, values: np.ndarray) -> np.ndarray:
        """The nearest step of each value as read, shape as `values`; of all that have the first colour, on this scale
        and on every larger one, the same: between corners whose steps lie far apart pictures show what neither has.
        """
        least = max(LEAST, self.upper / COLOURS)
        place = A_DECADE * np.log10(np.maximum(values, least) / LEAST)
        return np.clip(np.rint(place), 0, STEPS - 1).astype(np.int32)


def rounded_up(value: float) -> float:
    """The least of 1, 2 and 5 times powers of ten that is not below a value above 0."""
    decade = 10.0 ** math.floor(math.log10(value))
    return next(decade * each for each in (1, 2, 5, 10) if decade * each >= value * (1 - 1e-12))
