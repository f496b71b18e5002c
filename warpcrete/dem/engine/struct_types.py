"""Protocols that describe the structs of arrays in the arguments of kernels, for type checkers and editors.

`kernels/dem/structs.py` defines most of these structs, with the meaning, unit and shape of every array. In the same
folder, `grid.py` defines `Grid` and `stiffness.py` defines `Estimate`. A test compares these names with the structs.
"""

from typing import Protocol

import warp as wp

from ...core.device.arrays import DeviceArray


class Scenes(Protocol):
    """Arrays with one row for each scene, such as parameters, simulated time, time step and growth of spheres."""

    row: DeviceArray
    clock: DeviceArray
    scale: DeviceArray
    reference_velocity: DeviceArray


class Bodies(Protocol):
    """Arrays with one row for each body, such as positions and velocities."""

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
    """Arrays with one row for each sphere, such as positions and forces."""

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
    """Arrays of wall contacts: a row for each sphere, and a column (slot) for each wall contact that it can have."""

    touching: DeviceArray
    history: DeviceArray
    rolling: DeviceArray
    normal: DeviceArray
    overlap: DeviceArray
    wall: DeviceArray
    worn: DeviceArray
    worn_at: DeviceArray


class Pairs(Protocol):
    """Arrays of the neighbour lists, with the contact history and the bond of each listed pair."""

    start: DeviceArray
    other: DeviceArray
    history: DeviceArray
    rolling: DeviceArray
    bond: DeviceArray
    load: DeviceArray


class Candidates(Protocol):
    """Arrays that list, for each sphere, the triangles of mesh walls near the sphere (mesh candidates)."""

    start: DeviceArray
    face: DeviceArray
    near: DeviceArray
    near_count: DeviceArray
    chosen: DeviceArray


class Walls(Protocol):
    """Arrays with one row for each wall, such as positions and impulses."""

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
    """Arrays of the links of a GPU; a link stands for one pair, which a GPU's neighbour list contains twice."""

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
    """Arrays of the sub-cycled pairs, which have stiff bonds, and of the bodies that these bonds join."""

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
    """Arrays of the cell grid in which neighbours are searched, and the numbers of cells along its axes."""

    dims: wp.vec3i
    per_width: DeviceArray
    held: DeviceArray
    start: DeviceArray
    cell: DeviceArray
    rank: DeviceArray
    point: DeviceArray


class Estimate(Protocol):
    """Arrays for the estimate of the stable step, such as the contact stiffness and damping of each sphere and wall."""

    sums: DeviceArray
    wall_load: DeviceArray
    smallest: DeviceArray
    resolution_step: DeviceArray
    fastest: DeviceArray
