"""Create bonds between bodies, change the properties of bonds, and store the forces and moments of bonds.

The forces and moments of a bond (its load) are stored in a row of the array `pairs.load`. The integer `pairs.bond` of a
listed pair encodes the kind of the bond and the number of this row. A bond keeps its row until it breaks, even if the
neighbour lists are rebuilt.

In a half list (CPU), a pair whose spheres belong to different threads is computed by both threads. Every bond therefore
has two rows, one for each thread. If contacts can form bonds during the run (healing), any listed pair may become
bonded, so every entry of the list has a row of its own.
"""

import numpy as np

from ...core.device.launching import launch
from ...core.errors import CapacityError
from ...kernels.dem.bond_parallel import KIND_BITS, MOST_KINDS, MOST_ROWS
from ...kernels.dem.bonding import bond_kernels
from ..scene.scene import Bonds
from .model import Model
from .pairs import listed_pairs
from .state import State


def make_bonds(model: Model, state: State, bonds: Bonds, kind: int, group: int = -1) -> int:
    """Create bonds, without force or moment, between all unbonded pairs whose gap is at most `bonds.gap` [m].

    If `group` is not -1, only pairs inside the body group of this number are bonded. Returns the number of bonds of
    this `kind` afterwards. The neighbour list must be up to date and must contain all pairs up to the gap. Raises
    :class:`CapacityError` if the number of bonds exceeds the range of the 32-bit bond indices.
    """
    make, _ = bond_kernels(model.scalar)
    before = state.pairs.bond.numpy().copy()
    launch(
        make, state.sphere_count, model.device, kind=kind, healing=model.features.healing, gap=bonds.gap, group=group,
        bodies=state.bodies, spheres=state.spheres, pairs=state.pairs,
    )  # fmt: skip
    if not model.features.healing:
        _number(state, before)
    return int(np.count_nonzero(_kinds(state) == kind))


def reassign_bonds(model: Model, state: State, old: int, new: int, fraction: float, seed: int) -> int:
    """Change a random `fraction` of the bonds of kind `old` to kind `new`; kinds differ in stiffness and strength.

    Returns the number of bonds of kind `new` afterwards.
    """
    _, reassign = bond_kernels(model.scalar)
    launch(
        reassign, state.sphere_count, model.device, old_kind=old, new_kind=new, fraction=fraction,
        seed=seed & 0xFFFFFFFF, spheres=state.spheres, pairs=state.pairs,
    )  # fmt: skip
    return int(np.count_nonzero(_kinds(state) == new))


def bond_kinds(bond: np.ndarray) -> np.ndarray:
    """Return the kind of bond that each value of the array `pairs.bond` encodes.

    Values of 0 (no bond) and negative values (broken, see `kernels/dem/bond_parallel.py`) are returned unchanged.
    """
    return np.where(bond > 0, bond & MOST_KINDS, bond)


def bond_rows(bond: np.ndarray) -> np.ndarray:
    """Return the row of the array `pairs.load` that each positive value of the array `pairs.bond` encodes."""
    return bond >> int(KIND_BITS)


def _kinds(state: State) -> np.ndarray:
    """Return the bond kind of every listed pair, each pair once; 0 means no bond, a negative value a broken bond."""
    return bond_kinds(state.pairs.bond.numpy()[listed_pairs(state)[2]])


def _number(state: State, before: np.ndarray) -> None:
    """Assign a row of the array `pairs.load` to every bond, in the order of the neighbour list.

    The row stores the force and the moment of the bond. `before` contains the values of `pairs.bond` before the new
    bonds were made. Existing bonds keep their force and moment; new bonds start with zero.
    """
    i, j, place = listed_pairs(state)
    bond = state.pairs.bond.numpy().copy()
    held = bond[place] > 0
    i, j, place = i[held], j[held], place[held]
    apart = 2 if state.model.features.half_list else 1
    count = apart * len(place)
    if count > MOST_ROWS:
        state.pairs.bond.assign(before)
        raise CapacityError(
            f"bonds = {len(place)}: one scene can hold at most {MOST_ROWS // apart} bonds; use fewer or larger "
            "aggregates"
        )
    row = apart * np.arange(len(place), dtype=bond.dtype)
    load = np.zeros((count, 8), dtype=state.pairs.load.numpy().dtype)
    kept = before[place] > 0
    for copy in range(apart):
        load[row[kept] + copy] = state.pairs.load.numpy()[bond_rows(before[place[kept]])]
    bond[place] = bond_kinds(bond[place]) | (row << int(KIND_BITS))
    if apart > 1:
        _number_copies(state, bond, np.minimum(i, j), np.maximum(i, j), place)
    state.batch.reserve_loads(state.index, count)
    state.pairs.bond.assign(bond)
    if count:
        state.pairs.load[:count].assign(load)


def _number_copies(state: State, bond: np.ndarray, low: np.ndarray, high: np.ndarray, place: np.ndarray) -> None:
    """Assign a second row of `pairs.load` to each bond between spheres of two CPU threads, and store the row in `bond`.

    The array `pairs.load` contains the forces and moments of bonds. A pair of spheres from two CPU threads has two
    entries in the neighbour list, one for each thread. If the first entry has row k, the second entry gets row k + 1.
    `low` and `high` are the sphere indices of all bonds, and `place` is the first list entry of each bond.
    """
    start, other = state.pairs.start.numpy(), state.pairs.other.numpy()[: state.pair_total]
    # `place` contains the first list entry of each bonded pair, so all other bonded entries are second entries.
    copies = np.flatnonzero(bond[: len(other)] > 0)
    copies = copies[~np.isin(copies, place)]
    i = np.searchsorted(start, copies, "right") - 1
    j = np.where(other[copies] >= 0, other[copies], -1 - other[copies])
    n = np.int64(state.sphere_count)
    order = np.argsort(low * n + high)
    first = place[order[np.searchsorted(low[order] * n + high[order], np.minimum(i, j) * n + np.maximum(i, j))]]
    bond[copies] = bond_kinds(bond[copies]) | ((bond_rows(bond[first]) + 1) << int(KIND_BITS))
