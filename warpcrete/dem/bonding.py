"""Making bonds in a scene, and giving some of them other properties."""

from __future__ import annotations

import numpy as np

from ..core.launching import launch
from ..kernels.dem.bonding import bond_kernels
from .model import Model
from .probes import listed_pairs
from .scene import Bonds
from .state import State


def make_bonds(model: Model, state: State, bonds: Bonds, kind: int, group: int = -1) -> int:
    """Bond, without load, every listed pair within `bonds.gap` that is not bonded (inside `group` only, if given).

    Returns the number of pairs that are bonded afterwards. The list must be fresh and reach as far as the gap.
    """
    make, _ = bond_kernels(model.scalar)
    launch(
        make, state.sphere_count, model.device, kind=kind, gap=bonds.gap, group=group, bodies=state.bodies,
        spheres=state.spheres, pairs=state.pairs,
    )  # fmt: skip
    return int(np.count_nonzero(_bonds(state) == kind))


def reassign_bonds(model: Model, state: State, old: int, new: int, fraction: float, seed: int) -> int:
    """Give a random `fraction` of the bonds of kind `old` the properties of kind `new`; returns how many have them."""
    _, reassign = bond_kernels(model.scalar)
    launch(
        reassign, state.sphere_count, model.device, old_kind=old, new_kind=new, fraction=fraction,
        seed=seed & 0xFFFFFFFF, spheres=state.spheres, pairs=state.pairs,
    )  # fmt: skip
    return int(np.count_nonzero(_bonds(state) == new))


def _bonds(state: State) -> np.ndarray:
    """Bond state of every listed pair, each pair once."""
    return state.pairs.bond.numpy()[listed_pairs(state)[2]]
