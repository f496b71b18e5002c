"""Triangle meshes of all walls of a batch, as flat arrays of corners, faces and adjacency."""

import numpy as np

from ..kernels.common.walls import BORDER, SHARED


class Surfaces:
    """Flat arrays of the corners, faces and adjacency of all mesh walls."""

    def __init__(self) -> None:
        self._corners: list[np.ndarray] = []
        self._faces: list[np.ndarray] = []
        self._across: list[np.ndarray] = []
        self._rings: list[list[np.ndarray]] = []
        self._shared: list[list[np.ndarray]] = []
        self._owner: list[np.ndarray] = []
        self._corner_count = 0
        self._face_count = 0
        self._shared_count = 0

    @property
    def face_count(self) -> int:
        """Number of faces of all meshes added so far."""
        return self._face_count

    def add(self, vertices: np.ndarray, faces: np.ndarray, wall: int) -> int:
        """Add the mesh of the wall with the index `wall`, and return the index of its first face.

        The mesh must have no coincident corners and no repeated faces.
        """
        first_corner, first_face = self._corner_count, self._face_count
        ends = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1).astype(np.int64)
        far = np.roll(faces, -2, axis=1).ravel()
        edges, edge, uses = np.unique(ends @ [len(vertices), 1], return_inverse=True, return_counts=True)
        # The side k of a face f has the number 3 * f + k. Sort these numbers so that sides on the same edge of the mesh
        # follow one another.
        order = np.argsort(edge, kind="stable")
        begin = np.concatenate([[0], np.cumsum(uses)[:-1]])
        across = np.full((len(faces), 6), int(BORDER), dtype=np.int64)
        one, two = order[begin[uses == 2]], order[begin[uses == 2] + 1]
        for side, beyond in ((one, two), (two, one)):
            across[side // 3, side % 3] = first_corner + far[beyond]
            across[side // 3, side % 3 + 3] = first_face + beyond // 3
        shared = []
        for row, (start, count) in enumerate(zip(begin[uses > 2], uses[uses > 2])):
            sides = order[start : start + count]
            across[sides // 3, sides % 3] = int(SHARED) - self._shared_count - row
            shared.append(np.concatenate([[sides.min() // 3], first_corner + far[sides]]))
        self._corners.append(vertices)
        self._faces.append(faces + first_corner)
        self._across.append(across)
        self._rings.append(_rings(len(vertices), faces, np.stack(np.divmod(edges, len(vertices)), 1), first_corner))
        self._shared.append(shared)
        self._owner.append(np.full(len(faces), wall, dtype=np.int32))
        self._corner_count += len(vertices)
        self._face_count += len(faces)
        self._shared_count += len(shared)
        return first_face

    def corners(self) -> np.ndarray:
        """Return the corners of all meshes [m], shape (corners, 3)."""
        return np.concatenate([np.empty((0, 3)), *self._corners])

    def faces(self) -> np.ndarray:
        """Return the corner indices of the faces of all meshes, shape (faces, 3)."""
        return np.concatenate([np.empty((0, 3), np.int32), *self._faces]).astype(np.int32)

    def across(self) -> np.ndarray:
        """Return the neighbours of each face across its three edges, shape (faces, 6).

        Each edge joins the face to a neighbouring face. The first three columns contain, for each edge, the index of
        the neighbour's corner opposite the edge. The last three columns contain the indices of the neighbours. If an
        edge has no neighbour, the corner is replaced by the code `BORDER`. If three or more faces share an edge, the
        corner is replaced by the code ``SHARED - k``, where k is the number of the edge's list in :meth:`ring`.
        """
        across = np.concatenate([np.empty((0, 6), np.int64), *self._across])
        return np.where(across <= int(SHARED), across - self._corner_count, across).astype(np.int32)

    def owner(self) -> np.ndarray:
        """Return the index of the wall to which each face belongs, shape (faces,)."""
        return np.concatenate([np.empty(0, np.int32), *self._owner]).astype(np.int32)

    def ring(self) -> np.ndarray:
        """Return an array of the adjacency lists of all corners, then of all edges shared by three or more faces.

        - The list of a corner contains the lowest index of the faces at the corner, then the other ends of the edges at
          the corner.
        - The list of an edge contains the lowest index of the faces at the edge, then the corners of these faces
          opposite the edge.

        Faces are numbered within their mesh.
        """
        return np.concatenate([np.empty(0, np.int32), *self._rows()]).astype(np.int32)

    def ring_start(self) -> np.ndarray:
        """Return the index in `ring` at which each adjacency list begins, shape (lists + 1,).

        `ring` contains all lists end to end. The last number of the result is the length of `ring`.
        """
        return np.concatenate([[0], np.cumsum([len(row) for row in self._rows()])]).astype(np.int32)

    def _rows(self) -> list[np.ndarray]:
        return [row for rows in (*self._rings, *self._shared) for row in rows]


def _rings(count: int, faces: np.ndarray, edges: np.ndarray, first_corner: int) -> list[np.ndarray]:
    """Return an adjacency list for each of the `count` corners of a mesh.

    A list contains the lowest index of the faces at the corner, followed by the corners at the other ends of the
    `edges` at this corner. In the lists, corners are numbered from `first_corner`, and faces from 0.
    """
    lowest = np.full(count, len(faces))
    np.minimum.at(lowest, faces.ravel(), np.repeat(np.arange(len(faces)), 3))
    here = np.concatenate([np.arange(count), edges.ravel()])
    entries = np.concatenate([lowest, first_corner + edges[:, ::-1].ravel()])
    order = np.argsort(here, kind="stable")
    return np.split(entries[order], np.cumsum(np.bincount(here, minlength=count))[:-1])
