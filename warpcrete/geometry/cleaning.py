"""Cleaning of triangle meshes: merge coincident corners, then remove repeated triangles and triangles without area."""

import itertools

import numpy as np

COINCIDENT = 1e-6
"""Distance below which two corners of a mesh are merged, divided by the largest coordinate of the mesh. In STL files,
coordinates in single precision have a relative accuracy of 6e-8."""


def default_tolerance(vertices: np.ndarray) -> float:
    """Return the distance [m] below which :func:`clean` merges two corners of a mesh."""
    return COINCIDENT * float(np.abs(vertices).max(initial=0.0))


def clean(
    vertices: np.ndarray, faces: np.ndarray, tolerance: float | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Merge coincident corners of a mesh, then remove repeated triangles and triangles without area.

    If several triangles have the same three corners, in any order, only the first of these triangles is kept. The
    arrays of a mesh without such faults are returned bitwise unchanged.

    Args:
        vertices: Corners [m], shape (v, 3).
        faces: Corner indices of each triangle, shape (f, 3).
        tolerance: Distance below which two corners are merged, and height below which a triangle has no area [m]; the
            default is :func:`default_tolerance` of the mesh.

    Returns:
        The corners still in use [m], shape (w, 3); the remaining triangles, shape (g, 3); and the number of each
        remaining triangle in `faces`, increasing, shape (g,).
    """
    if tolerance is None:
        tolerance = default_tolerance(vertices)
    merged = merged_corners(vertices, tolerance)[faces]
    a, b, c = (vertices[merged[:, k]] for k in range(3))
    longest = np.sqrt(np.max([np.sum((q - p) ** 2, axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0))
    flat = np.linalg.norm(np.cross(b - a, c - a), axis=1) <= tolerance * longest
    origin = np.flatnonzero(~flat)
    _, first = np.unique(np.sort(merged[origin], axis=1), axis=0, return_index=True)
    origin = origin[np.sort(first)]
    used, corners = np.unique(merged[origin], return_inverse=True)
    return vertices[used], corners.reshape(-1, 3).astype(faces.dtype), origin


def merged_corners(vertices: np.ndarray, tolerance: float) -> np.ndarray:
    """Return for each corner the lowest index of all corners at the same place, shape (v,).

    Corners whose coordinates all differ by less than half the `tolerance` [m] are always merged. Corners with a
    coordinate that differs by more than the tolerance are merged only if a chain of close corners connects them.
    """
    lowest = np.arange(len(vertices))
    if tolerance <= 0 or len(vertices) == 0:
        return lowest
    # Two corners close together may lie in different cells of a grid, on either side of a border between cells. Eight
    # grids are therefore used, which are shifted by half a cell along none, some or all axes. In at least one of these
    # grids both corners lie in the same cell.
    places = (vertices - vertices.min(axis=0)) / tolerance
    grids = [_cells(places + np.array(shift)) for shift in itertools.product((0.0, 0.5), repeat=3)]
    while True:
        before = lowest.copy()
        for cell in grids:
            least = np.full(cell.max() + 1, len(vertices))
            np.minimum.at(least, cell, lowest)
            lowest = least[cell]
        if np.array_equal(lowest, before):
            return lowest


def _cells(places: np.ndarray) -> np.ndarray:
    """Return, for each point in `places` (n, 3), the index of the unit cube that contains it.

    The cubes have edges of length 1 along the axes. Only cubes that contain a point have an index.
    """
    number = np.zeros(len(places), np.int64)
    for axis in np.floor(places).astype(np.int64).T:
        _, column = np.unique(axis, return_inverse=True)
        _, number = np.unique(number * (int(column.max()) + 1) + column, return_inverse=True)
    return number
