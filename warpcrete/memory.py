"""How much memory a run takes, checked before it is taken."""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import warp as wp

from .errors import CapacityError
from .kernels.probes import BODY_COLUMNS, CONTACT_COLUMNS
from .kernels.types import types
from .model import Model
from .state import BodyTable, State, pair_types

LISTED = 8  # pairs a sphere in a half list of a dense packing, room for growth included; twice that in a full one
SHARE = 0.9  # of what is free that a run may take


def bytes_per_body(model: Model, table: BodyTable) -> tuple[float, float]:
    """Memory of a body without its spheres, and of a sphere with its listed pairs [B]; `table` has a body or more."""
    one = BodyTable(
        *(getattr(table, name)[:1] for name in ("position", "orientation", "velocity", "spin", "size", "template")),
        table.density[:1], table.material[:1], table.group[:1], table.templates,
    )  # fmt: skip
    one = replace(one, template=np.zeros(1, int), templates=(min(table.templates, key=lambda t: len(t.radii)),))
    state = State(model, one)
    spheres = state.sphere_count

    def size(names) -> int:
        arrays = [getattr(state, name) for name in names]
        return sum(a.size * wp.types.type_size_in_bytes(a.dtype) for a in arrays)

    listed = LISTED if model.features.half_list else 2 * LISTED
    pair = sum(wp.types.type_size_in_bytes(dtype) for dtype, used in pair_types(model).values() if used)
    scalar = wp.types.type_size_in_bytes(model.scalar)
    # Besides the state: the list before (for history), row starts and grid, the estimate's sums, the probes' rows.
    listing = 2 * listed * pair + 8 * 4 + 3 * scalar + 24
    estimate = 4 * wp.types.type_size_in_bytes(types(model.scalar).mat33)
    probes = 8 * int(CONTACT_COLUMNS) + listed * scalar
    if model.features.half_list:
        listing += 4 * listed + 4  # what a search finds, and where
    if model.features.analytic:
        listing += 4 * scalar  # room to the walls
    body = size(State.BODY_ARRAYS) + 3 * 4 + 8 * int(BODY_COLUMNS) + 2 * 8 + 4 * 4
    return float(body), size(State.SPHERE_ARRAYS) / spheres + listing + estimate + probes


def memory_needed(model: Model, table: BodyTable) -> float:
    """Estimate of all that a run with these bodies takes on the device [B]."""
    if len(table) == 0:
        return 0.0
    body, sphere = bytes_per_body(model, table)
    counts = np.array([len(t.radii) for t in table.templates])[table.template]
    return body * len(table) + sphere * float(counts.sum())


def memory_free(device) -> float:
    """Memory that is free on a device [B]."""
    if device.is_cuda:
        return float(device.free_memory)
    try:
        with open("/proc/meminfo") as file:
            for line in file:
                if line.startswith("MemAvailable"):
                    return 1024.0 * float(line.split()[1])
    except OSError:
        pass
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        return float("inf")


def check_memory(model: Model, table: BodyTable) -> None:
    """Raise :class:`CapacityError` if the bodies do not fit the device's free memory."""
    needed, free = memory_needed(model, table), memory_free(model.device)
    if needed > SHARE * free:
        fitting = int(len(table) * SHARE * free / needed)
        raise CapacityError(
            f"bodies = {len(table)}: need about {needed / 2**30:.3g} GiB on {model.device}, which has "
            f"{free / 2**30:.3g} GiB free; about {fitting} of them would fit: choose a smaller container or larger "
            "aggregates, single precision, or a device with more memory"
        )
