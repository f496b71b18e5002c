"""Sorting of bodies in memory along a space-filling curve, so that spatial neighbours are neighbours in memory."""

from collections.abc import Iterable

import numpy as np
import warp as wp

from ...core.device.arrays import DeviceArray, Kernel, array_scan, clone, full, radix_sort_pairs, zeros
from ...core.device.launching import launch
from ...kernels.dem.sorting import order_kernels, permute_kernels
from .batch import Batch
from .state import OF_BATCH, struct_of

SORTED = {"bodies": ("first", *OF_BATCH["bodies"]), "spheres": ("scene", "body", "force", "moment"), "slots": ()}
"""Names of the arrays that keep their order when bodies are re-sorted, by the name of their struct.

These arrays are recomputed afterwards, do not depend on the order of bodies, or contain only zeros. All other arrays of
the structs named here are permuted.
"""


def sort_bodies(batch: Batch, due: np.ndarray, old_place: DeviceArray, new_place: DeviceArray) -> None:
    """Re-sort the bodies of all scenes marked in `due`, shape (scenes,), along a Morton curve.

    Writes two arrays of shape (spheres,): `old_place` maps the new index of each sphere to its old index, and
    `new_place` maps the old index to the new index.
    """
    b, device, kernels, permute = batch, batch.device, order_kernels(batch.scalar), permute_kernels(batch.scalar)
    bodies = b.body_count
    key = zeros(2 * bodies, dtype=wp.int64, device=device)
    order = zeros(2 * bodies, dtype=wp.int32, device=device)
    sort = DeviceArray(due.astype(np.int32), dtype=wp.int32, device=device)
    lowest = full((b.count, 3), 2**30, dtype=wp.int32, device=device)
    launch(kernels.corner, bodies, device, scenes=b.scenes, bodies=b.bodies, lowest=lowest)
    launch(
        kernels.keys, bodies, device, scenes=b.scenes, bodies=b.bodies, sort=sort, lowest=lowest, key=key, value=order
    )
    radix_sort_pairs(key, order, bodies, end_bit=30 + int(b.count).bit_length())
    order = order[:bodies]
    count = zeros(bodies + 1, dtype=wp.int32, device=device)
    start = zeros(bodies + 1, dtype=wp.int32, device=device)
    launch(kernels.counts, bodies, device, bodies=b.bodies, order=order, count=count)
    array_scan(count, start, inclusive=False)
    launch(
        kernels.place_spheres, bodies, device, scenes=b.scenes, order=order, old_first=clone(b.bodies.first),
        new_start=start, bodies=b.bodies, spheres=b.spheres, old_place=old_place,
    )  # fmt: skip
    launch(kernels.invert, b.sphere_count, device, order=old_place, inverse=new_place)
    for struct in SORTED:
        for array in _moved(b, struct):
            kernel, by = permute[array.dtype, array.ndim == 2], order if struct == "bodies" else old_place
            launch(kernel, array.shape, device, source=clone(array), order=by, target=array)
    b.split()


def sorting_kernels(batch: Batch) -> list[Kernel]:
    """Return all kernels that a re-sorting launches, so that they can be compiled before the run."""
    order: Iterable[Kernel] = vars(order_kernels(batch.scalar)).values() if batch.body_count > 1 else ()
    moved = {(a.dtype, a.ndim == 2) for struct in SORTED for a in _moved(batch, struct)}
    return [*order, *(permute_kernels(batch.scalar)[kind] for kind in moved)]


def _moved(batch: Batch, struct: str) -> list[DeviceArray]:
    """Return the arrays of the struct named `struct` that must be permuted when bodies are re-sorted."""
    names = struct_of(batch.structs, struct).vars
    arrays: list[DeviceArray] = [getattr(getattr(batch, struct), name) for name in names if name not in SORTED[struct]]
    return [array for array in arrays if array.size]
