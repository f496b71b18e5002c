"""One step of the discrete element method: contacts, walls, meshes, the walls' motion, the bodies', the clock."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

from ..core.launching import Stage, block_size, members
from ..kernels.common.types import SPAN
from ..kernels.dem.analytic_walls import wall_kernel
from ..kernels.dem.clock import clock_kernel
from ..kernels.dem.contacts import contact_kernel
from ..kernels.dem.links import WARP, gather_kernel, link_kernel, surface_kernel
from ..kernels.dem.mesh_contacts import mesh_kernel
from ..kernels.dem.motion import clump_kernel, sphere_kernel
from ..kernels.dem.wall_motion import advance_kernel
from .batch import Batch

MANY = 200_000
"""Spheres from which on a thread each keeps a GPU busy while lists are built."""
MANY_LINKS = 1_000_000
"""Pairs of lists from which on a GPU has threads enough if each looks at four."""


def tasks(batch: Batch, bodies: int) -> int:
    """Tasks of a kernel over so many bodies."""
    return -(-bodies // SPAN) if batch.features.half_list else bodies


def warp_width(device: Any) -> int:
    """Threads that go through the same instructions together."""
    return WARP if device.is_cuda else 1


def step_stages(batch: Batch) -> list[list[Stage]]:
    """Stages of one step on the arrays that the batch holds now, a list for each thread."""
    if not batch.features.half_list:
        return [_full_step(batch)]
    b, f = batch, batch.features
    meet = b.barrier()
    step = []
    chunks = zip(pairwise(b.sphere_chunks.tolist()), pairwise(b.body_chunks.tolist()))
    for part, (spheres, bodies) in enumerate(chunks):
        stages = _half_contacts(b, part, *spheres)
        stages += meet
        if part == 0 and f.walls:
            stages.append(b.stage(advance_kernel(b.scalar, f.strokes), b.wall_count))
        stages.append(_motion(b, *bodies))
        stages += meet
        if f.subcycling:
            stages += b.subcycles.stages(part)
        if part == 0:
            stages.append(b.stage(clock_kernel(b.scalar, f.growth), b.count))
            if b.structure is not None:
                stages.append(b.structure.stage())
        stages += meet
        step.append(stages)
    return step


def _full_step(batch: Batch) -> list[Stage]:
    """Stages of a GPU: walls, from contacts to their own motion, beside the contacts of spheres."""
    b, f, n = batch, batch.features, batch.sphere_count
    width = warp_width(b.device)
    stages = []
    if f.walls:
        surfaces = surface_kernel(b.scalar, f.wall_law, f.analytic, f.dissipation, f.wear, width)
        stages.append(b.stage(surfaces, -(-n // width) * width, last=n, beside=True))
    if f.meshes:
        stages.append(_meshes(b, 0, 0, n, beside=True))
    if f.walls:
        stages.append(b.stage(advance_kernel(b.scalar, f.strokes), b.wall_count, beside=True))
    links = len(b.links.link)
    candidates = 4 if links >= MANY_LINKS else 1
    kernel = link_kernel(b.scalar, f.pair_law, f.history, f.bonds, f.healing, f.subcycling, f.dissipation, width)
    stages += [
        # Blocks by the spheres: kernels are compiled before there are links.
        b.stage(kernel, -(-links // (width * candidates)) * width, candidates=candidates, block=block_size(n)),
        *([b.stage(gather_kernel(b.scalar, f.dissipation), n)] if f.clumps else []),
        _motion(b, 0, b.body_count),
        *(b.subcycles.stages(0) if f.subcycling else ()),
        b.stage(clock_kernel(b.scalar, f.growth), b.count),
        *([b.structure.stage()] if b.structure is not None else []),
    ]
    return stages


def _half_contacts(batch: Batch, part: int, first: int, last: int) -> list[Stage]:
    """Forces on a chunk of spheres of a CPU: by each other, by planes and pipes, by meshes."""
    b, f = batch, batch.features
    contacts = contact_kernel(b.scalar, f.pair_law, f.history, f.bonds, f.healing, f.subcycling, f.dissipation, f.mixed)
    stages = [b.stage(contacts, tasks(b, last - first), first=first, last=last)]
    if f.analytic:
        walls = wall_kernel(b.scalar, f.wall_law, f.dissipation, f.wear)
        stages.append(b.stage(walls, tasks(b, last - first), first=first, last=last, part=part))
    if f.meshes:
        stages.append(_meshes(b, part, first, last))
    return stages


def _meshes(batch: Batch, part: int, first: int, last: int, *, beside: bool = False) -> Stage:
    b, f = batch, batch.features
    kernel = mesh_kernel(b.scalar, f.wall_law, f.half_list, f.dissipation, f.wear)
    named = {"first": first, "last": last, "part": part, **members(kernel, wall=b.walls, slot=b.slots)}
    return b.stage(kernel, tasks(b, last - first), beside=beside, **named)


def _motion(batch: Batch, first: int, last: int) -> Stage:
    """Motion of a chunk of bodies, when all forces are there."""
    b, f = batch, batch.features
    named: dict[str, Any] = {"first": first, "last": last}
    if f.clumps:
        kernel = clump_kernel(b.scalar, f.drives, f.growth, f.meshes, f.half_list, f.subcycling, f.dissipation)
        named["subcycled"] = b.subcycles.arrays
    else:
        kernel = sphere_kernel(b.scalar, f.drives, f.growth, f.meshes, f.rotation, f.half_list, f.dissipation)
    return b.stage(kernel, tasks(b, last - first), meets=True, **named)
