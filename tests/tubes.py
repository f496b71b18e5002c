"""Mesh files of bores."""

import numpy as np
import trimesh

from warpcrete.geometry.axis import Axis, Line


def tube(path, radii, length=0.25, aside=0.0, lids=False, scale=1e3, begin=0.0, at=None):
    """An STL file of a bore in mm: round, of radii [m] at even places."""
    s = np.linspace(0, length, len(radii)) if at is None else np.array(at)
    points, faces = Axis((begin, aside, 0), (1, 0, 0), (Line(length),)).swept(s, np.array(radii), 64)
    if lids:
        first, last, n = len(points), len(points) - 64, np.arange(64)
        points = np.concatenate([points, [[begin, aside, 0], [begin + length, aside, 0]]])
        fans = [np.stack([n + k, (n + 1) % 64 + k, np.full(64, m)], 1) for k, m in ((0, first), (last, first + 1))]
        faces = np.concatenate([faces, *fans])
    mesh = trimesh.Trimesh(scale * points, faces)
    assert mesh.is_watertight == lids
    mesh.export(path)
    return path


def bent(path, axis, radius=0.05, facets=64, wall=None, lids=False, before=0.0, after=0.0, square=False, aside=0.0):
    """Write a pipe about any axis as an STL file in metres, and return its path.

    It is open at both ends, closed by `lids`, or a body with a `wall` [m] whose outer skin may be `square` (of a
    straight pipe) or lie `aside` [m] of the axis.
    """
    count = 2 + int((axis.length + before + after) / 0.01)
    s = np.linspace(-before, axis.length + after, count)
    points, faces = axis.swept(s, radius, facets)
    k, last = np.arange(facets), len(points) - facets
    following = (k + 1) % facets
    if lids:
        ends, _ = axis.at(s[[0, -1]])
        fans = [
            np.stack([first + k, first + following, 0 * k + len(points) + n], 1) for n, first in ((0, 0), (1, last))
        ]
        points, faces = np.concatenate([points, ends]), np.concatenate([faces, *fans])
    if wall is not None:
        outer, skin = axis.swept(s, radius + wall, facets)
        centres, _, normal, side = axis.frame(s)
        offset = outer - np.repeat(centres, facets, axis=0)
        if square:
            across = np.stack([offset @ normal[0], offset @ side[0]], 1)
            offset = offset * (np.linalg.norm(across, axis=1) / np.abs(across).max(axis=1))[:, None]
        outer = np.repeat(centres, facets, axis=0) + offset + aside * normal[0]
        n = len(points)
        rims = [np.stack([first + k, first + following, n + first + k], 1) for first in (0, last)]
        rims += [np.stack([first + following, n + first + following, n + first + k], 1) for first in (0, last)]
        points, faces = np.concatenate([points, outer]), np.concatenate([faces, skin[:, ::-1] + n, *rims])
    trimesh.Trimesh(points, faces, process=False).export(path)
    return path
