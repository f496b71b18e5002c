"""Conversion of a state (all data of a scene that change during a run) to and from checkpoints, and its hash."""

import hashlib

import numpy as np

from ...core.device.arrays import DeviceArray, host_copy, zeros
from ...core.records import Record, SavedState
from ..scene.bodies import BodyTable, placed_bodies
from .bonding import bond_kinds, bond_rows
from .model import Model
from .pairs import listed_pairs
from .state import NUMBERS, State, pair_bytes

EMPTY = {("spheres", "force"), ("spheres", "moment")}
"""Arrays of a state that contain only zeros between two steps, as pairs of struct name and array name.

Checkpoints need not store these arrays.
"""


def state_dict(state: State) -> SavedState:
    """Return all data of a state that the next step depends on.

    The data are the arrays by struct and name, the control flags, and the attributes listed in NUMBERS.
    """
    numbers = {name: getattr(state, name) for name in NUMBERS}
    stored: SavedState = {"numbers": numbers, "flags": host_copy(state.flags)}
    for struct, name, array in state.arrays():
        if (struct, name) not in EMPTY:
            listed = struct == "pairs" and name in pair_bytes(state.model)
            used = min(max(state.pair_total, 1), len(array)) if listed else 0
            stored.setdefault(struct, {})[name] = host_copy(array[:used] if used else array)
    return stored


def restore_state(model: Model, stored: Record) -> State:
    """Create a state from the data `stored`, which :func:`state_dict` has returned."""
    scene = model.scene
    table = BodyTable.empty()
    if scene.fill is not None:
        table.templates = tuple(scene.fill.templates)
    state = State(model, BodyTable.empty())
    state.templates = table.joined(placed_bodies(scene)).templates
    for name, value in stored["numbers"].items():
        setattr(state, name, value)
    state.flags.assign(stored["flags"])
    for struct, name, array in list(state.arrays()):
        if (struct, name) in EMPTY:
            made = zeros(state.sphere_count, dtype=array.dtype, device=model.device)
        else:
            data = stored[struct][name]
            if data.size == 0:
                made = zeros(data.shape[: array.ndim], dtype=array.dtype, device=model.device)
            else:
                made = DeviceArray(data, dtype=array.dtype, ndim=array.ndim, device=model.device)
        setattr(getattr(state, struct), name, made)
    return state


def state_hash(state: State) -> str:
    """Return the SHA-256 hash of bodies, contacts, bonds, walls and times, in the order of permanent numbers.

    Two states with the same hash will move identically, bit for bit. The hash does not depend on the order of bodies in
    memory, on listed pairs that do not touch, or on broken bonds that cannot form again.
    """
    digest = hashlib.sha256()
    features = state.model.features
    order = np.argsort(state.bodies.id.numpy())
    for name in ("position", "rounding", "velocity", "spin", "orientation", "angular_momentum", "size", "mass"):
        digest.update(np.ascontiguousarray(getattr(state.bodies, name).numpy()[order]).tobytes())
    i, j, place = listed_pairs(state)
    ids = state.spheres.id.numpy()
    position = state.spheres.position.numpy()
    reach = position[i, 3] + position[j, 3]
    kept = np.linalg.norm(position[i, :3] - position[j, :3], axis=1) < reach
    bond = state.pairs.bond.numpy()[place] if features.bonds else np.zeros(len(place), np.int32)
    # If contacts cannot form bonds during a run, a pair with a broken bond behaves like a pair without a bond. The
    # broken bond is stored until the next rebuild of the neighbour lists, whose time may vary. The hash must therefore
    # treat pairs with and without a stored broken bond alike.
    if not features.healing:
        bond = np.maximum(bond, 0)
    kept |= bond > 0
    low, high = np.minimum(ids[i], ids[j])[kept], np.maximum(ids[i], ids[j])[kept]
    ranks = np.lexsort([high, low])
    digest.update(np.stack([low, high])[:, ranks].astype(np.int32).tobytes())
    chosen = place[kept][ranks]
    if features.history:
        digest.update(np.ascontiguousarray(state.pairs.history.numpy()[chosen, :3]).tobytes())
    if features.pair_law.rolls:
        digest.update(state.pairs.rolling.numpy()[chosen].tobytes())
    if features.bonds:
        bond = bond[kept][ranks]
        digest.update(np.ascontiguousarray(bond_kinds(bond)).tobytes())
        # For a pair without an intact bond, `bond_rows` returns row 0, which may belong to another bond. Hash zeros for
        # such a pair.
        loads = state.pairs.load.numpy()[bond_rows(np.maximum(bond, 0))]
        loads[bond <= 0] = 0.0
        digest.update(loads.tobytes())
    by_sphere = np.argsort(ids)
    slots = state.slots
    for array in (slots.history, slots.rolling, slots.normal, slots.overlap, slots.wall):
        if len(array) == 0:
            continue
        digest.update(np.ascontiguousarray(array.numpy()[by_sphere]).tobytes())
    for name in ("position_exact", "velocity_exact", "orientation", "spin", "impulse", "travel", "work"):
        digest.update(getattr(state.walls, name).numpy().tobytes())
    # Hash the simulated time, and the sizes of the next and the last step.
    digest.update(state.scenes.clock.numpy()[0, :3].tobytes())
    return digest.hexdigest()
