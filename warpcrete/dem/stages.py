"""One step of the discrete element method: contacts, walls, meshes, the walls' motion, the bodies', the clock."""

from __future__ import annotations

from itertools import pairwise

import warp as wp

from ..core.launching import Stage, members
from ..kernels.common.types import SPAN
from ..kernels.dem.analytic_walls import wall_kernel
from ..kernels.dem.clock import clock_kernel
from ..kernels.dem.contacts import contact_kernel
from ..kernels.dem.mesh_contacts import mesh_kernel
from ..kernels.dem.motion import clump_kernel, sphere_kernel
from ..kernels.dem.wall_motion import advance_kernel
from .batch import Batch

WAYS = 4
"""Sums of a sphere's contacts on a GPU, before they are one; threads that form them, of few spheres."""
MANY = 200_000
"""Spheres from which on a thread each keeps a GPU busy: four took a fifth longer for a million, a quarter less for a
tenth of that."""


def tasks(batch: Batch, bodies: int) -> int:
    """Tasks of a kernel over so many bodies."""
    return -(-bodies // SPAN) if batch.features.half_list else bodies


def step_stages(batch: Batch) -> list[list[Stage]]:
    """Stages of one step on the arrays that the batch holds now, a list for each thread."""
    b, f = batch, batch.features
    meet = b.barrier()
    step = []
    chunks = zip(pairwise(b.sphere_chunks.tolist()), pairwise(b.body_chunks.tolist()))
    for part, (spheres, bodies) in enumerate(chunks):
        stages = _contacts(b, part, *spheres)
        stages += meet
        if part == 0 and f.walls:
            stages.append(b.stage(advance_kernel(b.scalar), b.wall_count))
        stages.append(_motion(b, *bodies))
        stages += meet
        if f.subcycling:
            stages += b.subcycles.stages(part)
        if part == 0:
            stages.append(b.stage(clock_kernel(b.scalar, f.growth), b.count))
        stages += meet
        step.append(stages)
    return step


def _contacts(batch: Batch, part: int, first: int, last: int) -> list[Stage]:
    """Forces on a chunk of spheres: by each other, by planes and pipes, by meshes."""
    b, f = batch, batch.features
    chunk = {"first": first, "last": last, "part": part}
    together = f.analytic and not f.half_list
    # In double precision four threads and one round apart.
    ways = WAYS if b.device.is_cuda and b.scalar is wp.float32 else 1
    lanes = ways if last - first < MANY else 1
    contacts = contact_kernel(
        b.scalar,
        f.pair_law,
        f.wall_law,
        f.half_list,
        f.history,
        f.bonds,
        f.healing,
        f.subcycling,
        together,
        f.dissipation,
        ways,
        lanes,
    )
    stages = [b.stage(contacts, lanes * tasks(b, last - first), **chunk)]
    if f.analytic and not together:
        stages.append(b.stage(wall_kernel(b.scalar, f.wall_law, f.dissipation), tasks(b, last - first), **chunk))
    if f.meshes:
        meshes = mesh_kernel(b.scalar, f.wall_law, f.half_list, f.dissipation)
        stages.append(b.stage(meshes, tasks(b, last - first), **chunk, **members(meshes, wall=b.walls, slot=b.slots)))
    return stages


def _motion(batch: Batch, first: int, last: int) -> Stage:
    """Motion of a chunk of bodies."""
    b, f = batch, batch.features
    if f.clumps:
        kernel = clump_kernel(b.scalar, f.drives, f.growth, f.meshes, f.half_list, f.subcycling, f.dissipation)
        return b.stage(kernel, tasks(b, last - first), first=first, last=last, subcycled=b.subcycles.arrays)
    else:
        kernel = sphere_kernel(b.scalar, f.drives, f.growth, f.meshes, f.rotation, f.half_list, f.dissipation)
    return b.stage(kernel, tasks(b, last - first), first=first, last=last)
