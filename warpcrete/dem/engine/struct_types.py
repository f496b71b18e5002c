"""Types of the structs of arrays that kernels take, for type checkers and editors.

`kernels/dem/structs.py` defines most of these structs, with the meaning, unit and shape of every array. In the same
folder, `grid.py` defines `Grid` and `stiffness.py` defines `Estimate`. A test compares these names with the structs.
"""

from __future__ import annotations

from typing import Protocol

import warp as wp

from ...core.device.arrays import DeviceArray


class Scenes(Protocol):
    """Values that exist once per scene."""

    row: DeviceArray
    clock: DeviceArray
    scale: DeviceArray
    reference_velocity: DeviceArray


class Bodies(Protocol):
    """Arrays of bodies."""

    id: DeviceArray
    scene: DeviceArray
    shape: DeviceArray
    group: DeviceArray
    size: DeviceArray
    mass: DeviceArray
    inertia: DeviceArray
    position: DeviceArray
    rounding: DeviceArray
    velocity: DeviceArray
    spin: DeviceArray
    orientation: DeviceArray
    angular_momentum: DeviceArray
    first: DeviceArray


class Spheres(Protocol):
    """Arrays of spheres."""

    id: DeviceArray
    scene: DeviceArray
    body: DeviceArray
    material: DeviceArray
    offset: DeviceArray
    position: DeviceArray
    velocity: DeviceArray
    spin: DeviceArray
    built: DeviceArray
    clear: DeviceArray
    force: DeviceArray
    moment: DeviceArray
    touching: DeviceArray
    dissipated_energy: DeviceArray
    broken: DeviceArray


class Slots(Protocol):
    """Contacts of spheres with walls."""

    touching: DeviceArray
    history: DeviceArray
    rolling: DeviceArray
    normal: DeviceArray
    overlap: DeviceArray
    wall: DeviceArray
    worn: DeviceArray
    worn_at: DeviceArray


class Pairs(Protocol):
    """Neighbour list with contact history and bonds."""

    start: DeviceArray
    other: DeviceArray
    history: DeviceArray
    rolling: DeviceArray
    bond: DeviceArray
    load: DeviceArray


class Candidates(Protocol):
    """Triangles of mesh walls near each sphere."""

    start: DeviceArray
    face: DeviceArray


class Walls(Protocol):
    """Arrays of walls."""

    scene: DeviceArray
    table: DeviceArray
    rest_position: DeviceArray
    position_exact: DeviceArray
    velocity_exact: DeviceArray
    position: DeviceArray
    orientation: DeviceArray
    normal: DeviceArray
    velocity: DeviceArray
    spin: DeviceArray
    force: DeviceArray
    moment: DeviceArray
    impulse: DeviceArray
    angular_impulse: DeviceArray
    travel: DeviceArray
    work: DeviceArray
    moved: DeviceArray
    step_force: DeviceArray


class Links(Protocol):
    """Pairs as a GPU evaluates them."""

    link: DeviceArray
    scene: DeviceArray
    state: DeviceArray
    later_touching: DeviceArray
    end: DeviceArray
    result: DeviceArray | None
    near: DeviceArray
    near_count: DeviceArray
    near_list_exceeded: DeviceArray
    near_position: DeviceArray
    near_time: DeviceArray


class Subcycled(Protocol):
    """Pairs with stiff bonds, and the bodies that these pairs join."""

    rounds: DeviceArray
    stable: DeviceArray
    pair_scene: DeviceArray
    lower: DeviceArray
    higher: DeviceArray
    ends: DeviceArray
    lower_offset: DeviceArray
    higher_offset: DeviceArray
    law: DeviceArray
    entry: DeviceArray
    copy: DeviceArray
    held: Pairs
    active: DeviceArray
    lost: DeviceArray
    outcome: DeviceArray
    body_scene: DeviceArray
    body_number: DeviceArray
    place: DeviceArray
    start: DeviceArray
    ref: DeviceArray
    mass: DeviceArray
    inertia: DeviceArray
    position: DeviceArray
    rounding: DeviceArray
    orientation: DeviceArray
    velocity: DeviceArray
    spin: DeviceArray
    angular_momentum: DeviceArray
    other_force: DeviceArray
    other_torque: DeviceArray
    force: DeviceArray
    torque: DeviceArray
    member: DeviceArray


class Grid(Protocol):
    """Cell grid of the neighbour search."""

    dims: wp.vec3i
    per_width: DeviceArray
    held: DeviceArray
    start: DeviceArray
    cell: DeviceArray
    rank: DeviceArray
    point: DeviceArray


class Estimate(Protocol):
    """Sums of the stable step estimate."""

    sums: DeviceArray
    wall_load: DeviceArray
    smallest: DeviceArray
    resolution_step: DeviceArray
    fastest: DeviceArray
