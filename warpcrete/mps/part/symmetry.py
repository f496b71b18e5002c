"""Axes of the grid of a part of a pump line, and the test whether a bore from a mesh has a plane of symmetry."""

from dataclasses import dataclass

import numpy as np

from ...geometry.axis import Axis
from ...geometry.inner_surface import InnerSurface

TOLERANCE_CELLS, TOLERANCE_RADIUS = 0.02, 0.002
"""Largest accepted distance between the wall of a symmetric bore and its mirror image.

The limit is the larger of two lengths: TOLERANCE_CELLS times the width of a cell, and TOLERANCE_RADIUS times the radius
of the bore. The second length accepts a round mesh of 64 facets around in any position.
"""
SAMPLES_PER_CELL = 2
"""Number of points per cell width, along the axis and around it, at which the wall is compared with its mirror
image."""


@dataclass(frozen=True)
class Orientation:
    """Axes of the grid of a part, and whether the bore is symmetric about the plane of the first and the last axis."""

    axes: np.ndarray
    """Axes of the grid as rows, in the coordinates of the scene, shape (3, 3).

    The last axis is the direction in which concrete leaves. The first axis lies in the plane of the bends, if they have
    a common plane.
    """
    asymmetry: float
    """Largest distance between the wall and its mirror image [m]; 0 for a round pipe without a mesh."""
    is_symmetric: bool
    """True if the asymmetry is so small that half of the bore represents the whole bore."""


def orientation(axis: Axis, inner: InnerSurface | None, radius: float, spacing: float) -> Orientation:
    """Return the orientation of the grid in which the bore is symmetric, if there is one.

    The axes follow from the bends of `axis`. Along a straight axis, the grid may be turned by 90 degrees, because a
    mesh may be symmetric about either of two planes. `radius` is the radius of the bore, and `spacing` is the width of
    a cell [m].
    """
    axes = _axes(axis)
    if inner is None:
        return Orientation(axes, 0.0, True)
    allowed, apart = max(TOLERANCE_CELLS * spacing, TOLERANCE_RADIUS * radius), spacing / SAMPLES_PER_CELL
    one = inner.asymmetry(axes[1], apart)
    if one > allowed and len(axis.hinges()) == 0:
        turned = np.stack([axes[1], -axes[0], axes[2]])
        other = inner.asymmetry(turned[1], apart)
        if other <= allowed:
            return Orientation(turned, other, True)
    return Orientation(axes, one, one <= allowed)


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
