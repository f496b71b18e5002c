"""What the colours of a recording mean, as a picture and in words."""

from __future__ import annotations

import io

import numpy as np

from ..core.display import Display

SIZE, DENSITY = (9.0, 0.55), 100
"""Of the picture [in], and dots per inch."""


def legend_title(display: Display) -> str:
    """What colours show, with the unit."""
    scale = display.scale()
    title = scale[0] if scale is not None else ", ".join(display.things())
    return title[:1].upper() + title[1:]


def meaning(display: Display) -> str:
    """What colours show, in a sentence."""
    scale = display.scale()
    if scale is not None:
        label, lower, upper = scale
        return f"Colours: {label} from {lower:.3g} (dark violet) to {upper:.3g} and above (yellow), on viridis."
    things = display.things()
    if things:
        return "Colours: " + ", ".join(f"{name} RGB {tuple(map(int, c))}" for name, c in things.items()) + "."
    return ""


def legend(display: Display) -> bytes | None:
    """A bar of the colours with their values as PNG, or a patch for each thing; None where there is nothing to say."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    scale, things = display.scale(), display.things()
    if scale is None and not things:
        return None
    figure = Figure(figsize=SIZE, dpi=DENSITY, facecolor=np.full(3, 250 / 255))
    axes = figure.add_axes((0.03, 0.46, 0.94, 0.46))
    if scale is not None:
        _, lower, upper = scale
        bar = ScalarMappable(Normalize(lower, upper), "viridis")
        figure.colorbar(bar, cax=axes, orientation="horizontal", extend="max", extendfrac=0.02)
        axes.tick_params(labelsize=10)
    else:
        axes.axis("off")
        for number, (name, colour) in enumerate(things.items()):
            axes.add_patch(_patch(number / len(things), colour))
            axes.text(number / len(things) + 0.09, 0.4, name, va="center", fontsize=11)
    out = io.BytesIO()
    figure.savefig(out, format="png", facecolor=figure.get_facecolor())
    return out.getvalue()


def _patch(left: float, colour: np.ndarray) -> object:
    from matplotlib.patches import Rectangle

    return Rectangle((left, 0.0), 0.08, 0.9, facecolor=np.asarray(colour) / 255, edgecolor="none")
