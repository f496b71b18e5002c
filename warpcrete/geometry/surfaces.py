"""Triangle meshes of all walls of a batch, as flat corner, face and adjacency arrays."""

from __future__ import annotations

import numpy as np


class Surfaces:
    """Flat corner, face and adjacency arrays over all mesh walls."""

    def __init__(self) -> None:
        self._corners: list[np.ndarray] = []
        self._faces: list[np.ndarray] = []
        self._across: list[np.ndarray] = []
        self._ring: list[np.ndarray] = []
        self._owner: list[np.ndarray] = []
        self._corner_count = 0
        self._face_count = 0

    @property
    def face_count(self) -> int:
        """Faces of the meshes so far."""
        return self._face_count

    def add(self, vertices: np.ndarray, faces: np.ndarray, wall: int) -> int:
        """Add a mesh; returns the number of its first face."""
        first_corner, first_face = self._corner_count, self._face_count
        edges: dict[tuple[int, int], list[tuple[int, int]]] = {}
        for f, face in enumerate(faces.tolist()):
            for e in range(3):
                a, b = face[e], face[(e + 1) % 3]
                edges.setdefault((min(a, b), max(a, b)), []).append((f, e))
        across = np.full((len(faces), 6), -1, dtype=np.int32)
        rings: list[list[int]] = [[] for _ in vertices]
        lowest = np.full(len(vertices), len(faces))
        np.minimum.at(lowest, faces.ravel(), np.repeat(np.arange(len(faces)), 3))
        for (a, b), members in edges.items():
            rings[a].append(b)
            rings[b].append(a)
            if len(members) == 2:  # an edge of three or more faces keeps them all as borders
                for (f, e), (g, h) in (members, members[::-1]):
                    across[f, e] = first_corner + faces[g][(h + 2) % 3]
                    across[f, e + 3] = first_face + g
        for v, neighbours in enumerate(rings):
            self._ring.append(np.array([lowest[v], *(first_corner + n for n in neighbours)], dtype=np.int32))
        self._corners.append(vertices)
        self._faces.append(faces + first_corner)
        self._across.append(across)
        self._owner.append(np.full(len(faces), wall, dtype=np.int32))
        self._corner_count += len(vertices)
        self._face_count += len(faces)
        return first_face

    def corners(self) -> np.ndarray:
        return np.concatenate([np.empty((0, 3)), *self._corners])

    def faces(self) -> np.ndarray:
        return np.concatenate([np.empty((0, 3), np.int32), *self._faces]).astype(np.int32)

    def across(self) -> np.ndarray:
        return np.concatenate([np.empty((0, 6), np.int32), *self._across]).astype(np.int32)

    def owner(self) -> np.ndarray:
        return np.concatenate([np.empty(0, np.int32), *self._owner]).astype(np.int32)

    def ring(self) -> np.ndarray:
        return np.concatenate([np.empty(0, np.int32), *self._ring]).astype(np.int32)

    def ring_start(self) -> np.ndarray:
        return np.concatenate([[0], np.cumsum([len(r) for r in self._ring])]).astype(np.int32)
