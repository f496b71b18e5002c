"""Meaning of the colours of a recording, as a picture and as a text."""

import io
from typing import Any

import numpy as np

from ..core.drawing.display import Display
from ..core.drawing.paint import ENDS, Paint, colour_map

SIZE, DENSITY = (9.0, 0.55), 100
"""Size of the legend's picture [in], and its resolution [dots per inch]."""


def legend_title(display: Display) -> str:
    """Return the title of the legend: the coloured quantity with its unit, or the names of the coloured categories."""
    scale = display.scale()
    return capitalised(scale[0] if scale is not None else ", ".join(display.categories()))


def capitalised(title: str) -> str:
    """Return `title` with a capital first letter and no other change."""
    return title[:1].upper() + title[1:]


def meaning(display: Display) -> str:
    """Return a sentence that explains the colours of the bodies; empty if they need no explanation."""
    scale = display.scale()
    if scale is not None:
        label, lower, upper = scale
        first, last = ENDS[display.palette]
        return f"Colours: {label} from {lower:.3g} ({first}) to {upper:.3g} and above ({last}), on {display.palette}."
    categories = display.categories()
    if categories:
        return "Colours: " + ", ".join(f"{name} RGB {tuple(map(int, c))}" for name, c in categories.items()) + "."
    return ""


def paint_meaning(paint: Paint) -> str:
    """Return a sentence that explains the colours of walls that show a quantity, such as the worn depth."""
    if not paint.upper > 0:
        return f"Colours: {paint.label}, zero everywhere so far, on {paint.palette}."
    return f"Colours: {paint.label} from 0 to {paint.upper:.3g} and above, on {paint.palette}."


def legend(display: Display) -> bytes | None:
    """Return the legend as a PNG, or None if the colours need no explanation.

    The legend is a colour bar with values, or a patch of colour for each category.
    """
    scale, categories = display.scale(), display.categories()
    if scale is not None:
        return _bar(scale[1], scale[2], display.palette)
    if not categories:
        return None
    figure, axes = _blank()
    axes.axis("off")
    for number, (name, colour) in enumerate(categories.items()):
        axes.add_patch(_patch(number / len(categories), colour))
        axes.text(number / len(categories) + 0.09, 0.4, name, va="center", fontsize=11)
    return _png(figure)


def paint_legend(paint: Paint) -> bytes | None:
    """Return a PNG with the colour bar of walls that show a quantity, or None while there are no values to show."""
    return _bar(0.0, paint.upper, paint.palette) if paint.upper > 0 else None


def _bar(lower: float, upper: float, palette: str) -> bytes:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    figure, axes = _blank()
    bar = ScalarMappable(Normalize(lower, upper), colour_map(palette))
    figure.colorbar(bar, cax=axes, orientation="horizontal", extend="max", extendfrac=0.02)
    axes.tick_params(labelsize=10)
    return _png(figure)


def _blank() -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE, dpi=DENSITY, facecolor=np.full(3, 250 / 255))
    return figure, figure.add_axes((0.03, 0.46, 0.94, 0.46))


def _png(figure: Any) -> bytes:
    out = io.BytesIO()
    figure.savefig(out, format="png", facecolor=figure.get_facecolor())
    return out.getvalue()


def _patch(left: float, colour: np.ndarray) -> object:
    from matplotlib.patches import Rectangle

    return Rectangle((left, 0.0), 0.08, 0.9, facecolor=np.asarray(colour) / 255, edgecolor="none")
