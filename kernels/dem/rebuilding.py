"""Kernels with which a GPU decides, without the host, when to rebuild its neighbour lists."""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import FAILED, OVERFLOW, STALE, STEPS
from .structs import array_structs


@functools.cache
def rebuilding_kernels(scalar) -> SimpleNamespace:
    """Return two kernels of one thread each, ``needs_rebuild`` and ``fit``, for a scene that is not part of a batch.

    ``needs_rebuild`` decides if the device must rebuild the neighbour lists now. The host handles failed scenes, and
    the rebuilds that include a sorting of the bodies. ``fit`` decides if the arrays have room for the new lists. If
    not, the host rebuilds the lists with larger arrays.
    """
    Scenes = array_structs(scalar).Scenes

    @wp.kernel(module="unique", enable_backward=False)
    def needs_rebuild(flags: wp.array2d(dtype=wp.int32), scenes: Scenes, requested: wp.array(dtype=wp.int32)):
        every = scenes.row[0].sort_every
        # Only the host can sort the bodies, so the host does the rebuilds that include sorting.
        sorts = every > 0 and flags[0, STEPS] % wp.max(every, 1) == 0
        fails = flags[0, FAILED] != 0 or flags[0, OVERFLOW] != 0
        requested[0] = wp.where(flags[0, STALE] != 0 and not fails and not sorts, 1, 0)

    @wp.kernel(module="unique", enable_backward=False)
    def fit(
        scanned: wp.array(dtype=wp.int32), room: wp.int32, face_scanned: wp.array(dtype=wp.int32), face_room: wp.int32,
        fits: wp.array(dtype=wp.int32), built: wp.array(dtype=wp.int32),
    ):  # fmt: skip
        """Set `fits` to 1 if the results of a neighbour search fit into the arrays, else to 0.

        If they fit, also add 1 to the number of rebuilds in `built`. `scanned` contains running sums of the numbers of
        neighbours of the spheres, and `face_scanned` contains running sums of the numbers of nearby mesh faces. The
        last element of each array is the total number of entries. The lists have space for `room` and `face_room`
        entries. An empty `face_scanned` means that the scene has no meshes.
        """
        wanted = scanned[scanned.shape[0] - 1]
        holds = wanted >= 0 and wanted <= room
        if face_scanned.shape[0] > 0:
            faces = face_scanned[face_scanned.shape[0] - 1]
            holds = holds and faces >= 0 and faces <= face_room
        fits[0] = wp.where(holds, 1, 0)
        if holds:
            built[0] = built[0] + 1

    return SimpleNamespace(needs_rebuild=needs_rebuild, fit=fit)
