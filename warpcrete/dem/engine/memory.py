"""Estimate the device memory that a run needs, and check that it is free before arrays are allocated."""

from dataclasses import fields

import numpy as np

from ...core.device.arrays import bytes_of
from ...core.device.device import MEMORY_FRACTION, memory_free
from ...core.device.footprint import footprint
from ...core.errors import CapacityError
from ...kernels.dem.linking import EXTRA_MASKS
from ...kernels.dem.probes import BODY_COLUMNS, CONTACT_COLUMNS, LANES
from ..scene.bodies import BodyTable
from .links import rows_of
from .model import Model
from .neighbors import MOST_KEPT
from .state import State, pair_bytes
from .stepper_protocol import SceneStepper

BONDS_PER_SPHERE = 4  # Assumed number of bonded pairs per sphere in a dense packing, with a reserve.
PAIRS_PER_SPHERE = (
    # Assumed number of neighbour list entries per sphere in a dense packing on a CPU, whose list contains each pair
    # once, with a reserve. The list of a GPU contains each pair twice.
    8
)


def bytes_per_body(model: Model, table: BodyTable) -> tuple[float, float]:
    """Return the device memory [B] of a body without its spheres, and of a sphere with its neighbours and bonds.

    `table` contains the bodies of the run, at least one.
    """
    first = {field.name: getattr(table, field.name)[:1] for field in fields(table) if field.name != "templates"}
    first["template"] = np.zeros(1, int)
    one = BodyTable(**first, templates=(min(table.templates, key=lambda t: len(t.radii)),))
    state = State(model, one)

    def size(*structs: str) -> int:
        arrays = [array for struct, _, array in state.arrays() if struct in structs]
        return sum(a.size * bytes_of(a.dtype) for a in arrays)

    listed = PAIRS_PER_SPHERE if model.features.half_list else 2 * PAIRS_PER_SPHERE
    pair = sum(pair_bytes(model).values())
    scalar = bytes_of(model.scalar)
    # `listing` is the memory per sphere for neighbour lists and bonds [B]. Its terms here are: the current and the
    # previous neighbour list (2 * listed * pair); eight 32-bit integers, such as the index of the sphere's first list
    # entry; the sphere's centre (3 * scalar); and its part of the cell grid (24). The terms for bonds follow below.
    listing = 2 * listed * pair + 8 * 4 + 3 * scalar + 24
    # Add memory for the forces and moments of bonds. On a CPU, a bond between spheres of two threads has two copies of
    # its force and moment. If contacts can form bonds during the run (healing), the memory of a listed pair already
    # includes a force and a moment.
    if model.features.bonds and not model.features.healing:
        listing += (2 if model.features.half_list else 1) * BONDS_PER_SPHERE * 8 * scalar
    estimate = 4 * 6 * scalar
    probes = 8 * int(CONTACT_COLUMNS) + listed * scalar
    if model.features.half_list:
        # Add memory for the list of neighbours that the search finds, and for the position at which each sphere's
        # neighbours begin in this list.
        listing += 4 * listed + 4
    else:
        # Add memory for the buffer in which the neighbour search stores the neighbours of each sphere.
        listing += 4 * MOST_KEPT
        # Add memory for the links of a GPU. A link represents one pair, which has two list entries. Near links are the
        # links whose spheres may touch soon.
        # - Memory per link: the pair in the list of all links and again in the list of near links, its scene, its
        #   state, its index at both list entries, and its forces and moments.
        # - Memory per sphere: its position at the last selection of near links, and bits that mark touching neighbours.
        listing += listed * (24 + 2 * rows_of(model.features) * scalar) + 4 * scalar + 4 * int(EXTRA_MASKS)
    if model.features.subcycling and model.scene.hydration is not None:
        # Add memory for the sub-cycled bonds. Assume at most three bonded pairs per sphere. The fraction
        # `hydration.fraction` of these pairs is stiff and therefore sub-cycled.
        listing += 3 * model.scene.hydration.fraction * (44 * scalar + 80) + 30 * scalar
    if model.features.analytic:
        # Add memory for the position of each sphere at the last check of its distance from the walls.
        listing += 4 * scalar
    if model.features.meshes:
        # Add memory for the near candidates of each sphere, which are the triangles that may touch the sphere soon.
        listing += 4 * scalar + 4
    body = size("bodies") + 3 * 4 + 8 * int(BODY_COLUMNS) + 2 * 8 + 4 * 4
    return float(body), size("spheres", "slots") / state.sphere_count + listing + estimate + probes


def memory_needed(model: Model, table: BodyTable) -> float:
    """Return an estimate of the device memory [B] that a run needs for all bodies in the body table `table`."""
    if len(table) == 0:
        return 0.0
    body, sphere = bytes_per_body(model, table)
    sums = 8 * (LANES + 1) * (int(BODY_COLUMNS) + int(CONTACT_COLUMNS))
    return body * len(table) + sphere * float(table.sphere_counts.sum()) + sums


def memory_of_batch(stepper: SceneStepper) -> int:
    """Return the device memory of a stepper's batch [B].

    Finding all arrays of a batch takes a tenth of a second, so the batch keeps the result until its arrays change.
    """
    batch = stepper.batch
    if batch.memory_by_version[0] != batch.version:
        batch.memory_by_version = batch.version, footprint(stepper=stepper)["stepper"]
    return batch.memory_by_version[1]


def check_memory(model: Model, table: BodyTable) -> None:
    """Raise :class:`CapacityError` if the bodies in `table` do not fit into the device's free memory."""
    needed, free = memory_needed(model, table), memory_free(model.device)
    if needed > MEMORY_FRACTION * free:
        fitting = int(len(table) * MEMORY_FRACTION * free / needed)
        raise CapacityError(
            f"bodies = {len(table)}: need about {needed / 2**30:.3g} GiB on {model.device}, which has "
            f"{free / 2**30:.3g} GiB free; about {fitting} bodies would fit: choose a smaller container, larger "
            "aggregates, single precision, or a device with more memory"
        )
