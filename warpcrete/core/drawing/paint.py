"""Colours that represent quantities, from Matplotlib's colour maps."""

import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

COLOUR_STEPS, STEPS_PER_DECADE = 2048, 128
"""A recording rounds a quantity that colours walls to one of a fixed set of discrete values, evenly spaced on a
logarithmic scale. The first constant is the number of these values, and the second is their number in each decade."""
SMALLEST_VALUE = 1e-6
"""Smallest value that the colour of a wall can show, in the displayed unit; smaller values are shown as zero."""
COLOURS = 256
"""Number of discrete colours to which a colour map is reduced."""
CONCRETE = ("#c9c6be", "#d9b26a", "#c9632f", "#8a1f2d", "#3d0c1f")
"""Colours of the colour map `concrete`, from grey for concrete at rest to dark red for concrete that is sheared fast.
The colours become steadily darker, so that the map can also be read in black and white."""
ENDS = {"viridis": ("dark violet", "yellow"), "concrete": ("grey", "dark red")}
"""Words for the colours at the lower and at the upper end of each colour map that bodies and surfaces use."""


def palette_colours(values: np.ndarray, upper: float, lower: float = 0.0, name: str = "viridis") -> np.ndarray:
    """Return the colours of `values`, shape (n,), on the colour map `name` as RGB bytes, shape (n, 3).

    The colour map covers the range from `lower` to `upper`; values outside get the colour of the nearer end. The
    default map, viridis, is perceptually uniform.
    """
    scaled = np.clip((values - lower) / max(upper - lower, 1e-300), 0, 1)
    return _palette(name)[((COLOURS - 1) * scaled).astype(int)]


def packed(colours: np.ndarray) -> np.ndarray:
    """Return colours, given as RGB bytes of shape (n, 3), as one 32-bit integer per colour, shape (n,).

    The highest byte is red, followed by green, blue and the opacity, which is 255.
    """
    red, green, blue = colours.astype(np.uint32).T
    return red << 24 | green << 16 | blue << 8 | np.uint32(255)


def colour_map(name: str) -> Any:
    """Return the colour map called `name`: this package's own map `concrete`, or a colour map of Matplotlib."""
    from matplotlib import colormaps
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list(name, CONCRETE, COLOURS) if name == "concrete" else colormaps[name]


@functools.cache
def _palette(name: str) -> np.ndarray:
    return (255 * colour_map(name)(np.arange(COLOURS))[:, :3]).astype(np.uint8)


@dataclass(frozen=True)
class Paint:
    """Colour scale of a quantity on walls, such as worn depth, whose maximum is unknown until the run ends.

    A recording rounds each value to one of a fixed set of discrete values, and stores one colour for each of them.
    These discrete values stay the same when the upper end of the scale grows. Only their colours are then written
    again, so earlier frames are also shown with the new scale.
    """

    label: str
    """Title of the colour scale, with the unit of the displayed values."""
    palette: str
    upper: float
    """Upper end of the colour scale, in the unit of the displayed values. It is 0 if all values so far are 0. The lower
    end is always 0."""

    def colours(self) -> np.ndarray:
        """Return the colour of each discrete value to which recordings round, as RGB bytes (COLOUR_STEPS, 3)."""
        values = SMALLEST_VALUE * 10 ** (np.arange(COLOUR_STEPS) / STEPS_PER_DECADE)
        values[0] = 0.0
        return palette_colours(values, self.upper if self.upper > 0 else np.inf, name=self.palette)

    def steps(self, values: np.ndarray) -> np.ndarray:
        """Return the index of the discrete value nearest to each value, with the shape of `values`.

        `values` are in the displayed unit, and each index stands for a colour. Between neighbouring vertices, the
        viewer interpolates the indices, which are logarithms of the values. Large differences of the indices would
        therefore give wrong colours. To limit them, all values that have the first colour of the scale get the same
        index.
        """
        least = max(SMALLEST_VALUE, self.upper / COLOURS)
        place = STEPS_PER_DECADE * np.log10(np.maximum(values, least) / SMALLEST_VALUE)
        return np.clip(np.rint(place), 0, COLOUR_STEPS - 1).astype(np.int32)


def rounded_up(value: float) -> float:
    """Return the smallest 1, 2 or 5 times a power of ten that is not below the positive number `value`."""
    decade = 10.0 ** math.floor(math.log10(value))
    return next(decade * each for each in (1, 2, 5, 10) if decade * each >= value * (1 - 1e-12))
