"""Axes of the grid of a part of a pump line, and the test whether the flow has a plane of symmetry."""

from dataclasses import dataclass

import numpy as np

from ...geometry.axis import Axis
from ...geometry.inner_surface import InnerSurface

TOLERANCE_CELLS, TOLERANCE_RADIUS = 0.02, 0.002
"""Largest accepted distance between the wall of a symmetric bore and its mirror image.

The limit is the larger of two lengths: TOLERANCE_CELLS times the width of a cell, and TOLERANCE_RADIUS times the radius
of the bore. The second length accepts a round mesh of 64 facets around in any position.
"""
LEVEL = 1e-3
"""Largest vertical component of a unit vector that counts as horizontal."""
SAMPLES_PER_CELL = 2
"""Number of points per cell width, along the axis and around it, at which the wall is compared with its mirror
image."""


@dataclass(frozen=True)
class Orientation:
    """Axes of the grid of a part, and whether the flow is symmetric about the plane of the first and the last axis."""

    axes: np.ndarray
    """Axes of the grid as rows, in the coordinates of the scene, shape (3, 3).

    The last axis is the direction in which concrete leaves. The first axis lies in the plane of the bends, if they have
    a common plane.
    """
    asymmetry: float
    """Largest distance between the wall and its mirror image [m]; 0 for a round pipe without a mesh."""
    obstacle: str = ""
    """Reason why half of the part does not represent the whole part, or "" if it does."""


def orientation(
    axis: Axis, inner: InnerSurface | None, radius: float, spacing: float, heavy_aggregates: bool = False
) -> Orientation:
    """Return the orientation of the grid in which the flow is symmetric, if there is one.

    The axes follow from the bends of `axis`. Along a straight axis, the grid may be turned by 90 degrees, because the
    flow may be symmetric about either of two planes. `radius` is the radius of the bore, and `spacing` is the width of
    a cell [m]. With `heavy_aggregates`, the plane of symmetry must be vertical, because aggregates settle.
    """
    axes, straight = _axes(axis), len(axis.hinges()) == 0
    turned = np.stack([axes[1], -axes[0], axes[2]])
    if heavy_aggregates and abs(axes[1, 2]) > LEVEL:
        if not straight or abs(turned[1, 2]) > LEVEL:
            return Orientation(axes, 0.0, "aggregates settle across the plane of the pipe's axis")
        axes, straight = turned, False  # The second plane of symmetry is not vertical.
    if inner is None:
        return Orientation(axes, 0.0)
    allowed, apart = max(TOLERANCE_CELLS * spacing, TOLERANCE_RADIUS * radius), spacing / SAMPLES_PER_CELL
    asymmetry = inner.asymmetry(axes[1], apart)
    if asymmetry > allowed and straight and not (heavy_aggregates and abs(turned[1, 2]) > LEVEL):
        other = inner.asymmetry(turned[1], apart)
        if other <= allowed:
            return Orientation(turned, other)
    mirrored = f"the mesh differs from its mirror image in the plane of the pipe's axis by {1e3 * asymmetry:.2g} mm"
    return Orientation(axes, asymmetry, mirrored if asymmetry > allowed else "")


def _axes(axis: Axis) -> np.ndarray:
    """Return the axes of the grid as :attr:`Orientation.axes` describes them, shape (3, 3)."""
    _, out = (a[0] for a in axis.at(axis.length))
    _, into = (a[0] for a in axis.at(0.0))
    across = into - (into @ out) * out
    if np.linalg.norm(across) < 1e-9:
        hinges = axis.hinges()
        across = np.cross(hinges[0], out) if len(hinges) else np.eye(3)[np.argmin(np.abs(out))]
        across = across - (across @ out) * out
    across = across / np.linalg.norm(across)
    return np.stack([across, np.cross(out, across), out])
