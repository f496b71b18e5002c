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
