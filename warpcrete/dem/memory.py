"""How much memory a run takes, checked before it is taken."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import warp as wp

from ..core.device import MEMORY_FRACTION, memory_free
from ..core.errors import CapacityError
from ..kernels.dem.linking import MORE
from ..kernels.dem.probes import BODY_COLUMNS, CONTACT_COLUMNS, LANES
from .bodies import BodyTable
from .links import rows_of
from .model import Model
from .neighbors import MOST_KEPT
from .state import State, pair_bytes

BONDED = 4  # pairs a sphere that are bonded, in a dense packing, room for growth included
LISTED = 8  # pairs a sphere in a half list of a dense packing, room for growth included; twice that in a full one


def bytes_per_body(model: Model, table: BodyTable) -> tuple[float, float]:
    """Memory of a body without its spheres, and of a sphere with its listed pairs [B]; `table` has a body or more."""
    one = BodyTable(
        *(getattr(table, name)[:1] for name in ("position", "orientation", "velocity", "spin", "size", "template")),
        table.density[:1], table.material[:1], table.group[:1], table.templates,
    )  # fmt: skip
    one = replace(one, template=np.zeros(1, int), templates=(min(table.templates, key=lambda t: len(t.radii)),))
    state = State(model, one)

    def size(*structs: str) -> int:
        arrays = [array for struct, _, array in state.arrays() if struct in structs]
        return sum(a.size * wp.types.type_size_in_bytes(a.dtype) for a in arrays)

    listed = LISTED if model.features.half_list else 2 * LISTED
    pair = sum(pair_bytes(model).values())
    scalar = wp.types.type_size_in_bytes(model.scalar)
    # Besides the state: the list before (for history), row starts and grid, the estimate's sums, the probes' rows.
    listing = 2 * listed * pair + 8 * 4 + 3 * scalar + 24
    if model.features.bonds and not model.features.healing:  # else with the list; half lists have two rows for each
        listing += (2 if model.features.half_list else 1) * BONDED * 8 * scalar
    estimate = 4 * 6 * scalar
    probes = 8 * int(CONTACT_COLUMNS) + listed * scalar
    if model.features.half_list:
        listing += 4 * listed + 4  # what a search finds, and where
    else:
        listing += 4 * MOST_KEPT  # what a search finds
        # Links, each two entries of a list: the pair, its scene and state, the pair again where near; its place at both
        # entries; what it gives; where a sphere was when near ones were chosen, and bits of what touches it.
        listing += listed * (24 + 2 * rows_of(model.features) * scalar) + 4 * scalar + 4 * int(MORE)
    if model.features.subcycling and model.scene.hydration is not None:
        # Three pairs a sphere at most, as many of them stiff as are hydrated; bodies that have some.
        listing += 3 * model.scene.hydration.fraction * (44 * scalar + 80) + 30 * scalar
    if model.features.analytic:
        listing += 4 * scalar  # where it was last clear of walls
    body = size("bodies") + 3 * 4 + 8 * int(BODY_COLUMNS) + 2 * 8 + 4 * 4
    return float(body), size("spheres", "slots") / state.sphere_count + listing + estimate + probes


def memory_needed(model: Model, table: BodyTable) -> float:
    """Estimate of all that a run with these bodies takes on the device [B]."""
    if len(table) == 0:
        return 0.0
    body, sphere = bytes_per_body(model, table)
    sums = 8 * (LANES + 1) * (int(BODY_COLUMNS) + int(CONTACT_COLUMNS))
    return body * len(table) + sphere * float(table.sphere_counts.sum()) + sums


def check_memory(model: Model, table: BodyTable) -> None:
    """Raise :class:`CapacityError` if the bodies do not fit the device's free memory."""
    needed, free = memory_needed(model, table), memory_free(model.device)
    if needed > MEMORY_FRACTION * free:
        fitting = int(len(table) * MEMORY_FRACTION * free / needed)
        raise CapacityError(
            f"bodies = {len(table)}: need about {needed / 2**30:.3g} GiB on {model.device}, which has "
            f"{free / 2**30:.3g} GiB free; about {fitting} of them would fit: choose a smaller container or larger "
            "aggregates, single precision, or a device with more memory"
        )
