"""Solid bodies described by closed meshes: removal of internal cavities."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .meshes import signed_distance

if TYPE_CHECKING:  # Do not import trimesh at run time, because the import takes half a second.
    import trimesh


def without_cavities(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """Return a closed mesh without the surfaces of its internal cavities, and with all normals outward.

    A hollow stone is treated as solid, because a clump of spheres touches other bodies only with its outer surface.
    """
    import trimesh

    skins = []
    for faces in _connected(mesh.faces, len(mesh.vertices)):
        skin = trimesh.Trimesh(mesh.vertices, mesh.faces[faces], process=False)
        skin.remove_unreferenced_vertices()
        if skin.volume < 0:
            skin.invert()
        skins.append(skin)
    if len(skins) == 1:
        return skins[0]
    outer = [
        skin for skin in skins
        if not any(other is not skin and other.volume > skin.volume
                   and bool(np.all(signed_distance(other, np.asarray(skin.vertices)) < 0)) for other in skins)
    ]  # fmt: skip
    joined = trimesh.util.concatenate(outer)
    assert isinstance(joined, trimesh.Trimesh)
    return joined


def _connected(faces: np.ndarray, corners: int) -> list[np.ndarray]:
    """Return the face indices of each connected component of a mesh with `corners` corners.

    Faces with a common corner are connected.
    """
    label = np.arange(corners)
    while True:
        lowest = label[faces].min(axis=1)
        after = label.copy()
        for column in faces.T:
            np.minimum.at(after, column, lowest)
        after = after[after]
        if np.array_equal(after, label):
            break
        label = after
    own = label[faces[:, 0]]
    return [np.flatnonzero(own == one) for one in np.unique(own)]
