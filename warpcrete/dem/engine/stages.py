"""Kernel launches (stages) of one time step: contacts, walls, meshes, motion of walls and bodies, simulated time."""

import math
from itertools import pairwise

import warp as wp

from ...core.device.launching import Arguments, Stage, struct_arguments
from ...kernels.common.types import SPAN
from ...kernels.dem.analytic_walls import wall_kernel
from ...kernels.dem.clock import clock_kernel
from ...kernels.dem.clump_motion import clump_kernel
from ...kernels.dem.contacts import contact_kernel
from ...kernels.dem.links import link_kernel
from ...kernels.dem.mesh_contacts import mesh_kernel
from ...kernels.dem.motion import sphere_kernel
from ...kernels.dem.near import CHOICE_BLOCK, near_kernels
from ...kernels.dem.surfaces import surface_kernel
from ...kernels.dem.wall_motion import advance_kernel
from ...kernels.dem.warps import WARP
from .batch import Batch
from .links import rows_of

MANY_SPHERES = 200_000
"""Minimum number of spheres for which a GPU uses one thread per sphere to build neighbour lists. With fewer spheres,
several threads share a sphere, so that they keep the GPU busy."""
NEAR_LINK_INTERVAL = 20
"""Number of steps between two selections of the near links, which are the pairs of spheres that may touch soon.

This number equals the default number of steps between two estimates of the stable step.
"""
NEAR_MARGIN = 0.25
"""Largest gap between a sphere and a triangle that is listed as a near candidate, divided by the skin of the lists.

A sphere tests only its near candidates for contact, until it has moved by this gap. With a small fraction, near
candidates are selected often; with a large fraction, many candidates are tested: in a reducer, CPU steps with the
fractions 0.1, 0.5 and 1 take 5, 9 and 15 % longer than with 0.25.
"""
THREADS_PER_LINK = 0.5
"""Number of GPU threads that compute contact forces between spheres, divided by the number of all links.

A link is a listed pair of spheres; only near links, whose spheres may touch soon, are computed. If there are more near
links than threads, some threads compute several links.
"""
WALL_LANE_BITS = 3
"""Exponent k of the largest number 2^k of GPU threads that share the planes and pipes near one sphere; 2^3 = 8."""
WALL_THREADS = 100_000
"""Largest total number of GPU threads for wall contacts, if several threads share the walls of each sphere.

More threads would not hide more memory latency: for 100,000 spheres, eight threads per sphere took a tenth longer than
one thread per sphere.
"""
LANE_BITS = 2
"""Exponent k of the number 2^k of GPU threads that together move one clump; 2^2 = 4.

Several threads share a clump if the scene has few spheres, or if the forces of each contact take more than two rows of
memory. Otherwise a single thread moves a clump.
"""


def tasks(batch: Batch, bodies: int) -> int:
    """Return the number of tasks (threads of a launch) of a kernel for `bodies` bodies or spheres.

    A CPU task computes `SPAN` bodies or spheres with vector instructions; a GPU task computes one body or sphere.
    """
    return -(-bodies // SPAN) if batch.features.half_list else bodies


def warp_width(device: wp.Device) -> int:
    """Return the number of threads that execute the same instructions together (a CUDA warp, or 1)."""
    return WARP if device.is_cuda else 1


def step_stages(batch: Batch) -> list[list[Stage]]:
    """Return the kernel launches (stages) of one step on the batch's current arrays, one list for each CPU thread."""
    if not batch.features.half_list:
        return [_full_step(batch)]
    b, f = batch, batch.features
    meet = b.barrier()
    step: list[list[Stage]] = []
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


def near_stages(batch: Batch) -> list[Stage]:
    """Return the launches that select a GPU's near links (pairs that may touch soon); empty for half lists (CPU)."""
    b = batch
    if b.features.half_list:
        return []
    near = near_kernels(b.scalar)
    whole = -(-len(b.links.link) // CHOICE_BLOCK) * CHOICE_BLOCK
    return [
        b.stage(near.record_positions, max(b.sphere_count, b.count, 2), every=NEAR_LINK_INTERVAL),
        b.stage(near.choose_near, whole, block=CHOICE_BLOCK, every=NEAR_LINK_INTERVAL),
    ]


def _full_step(batch: Batch) -> list[Stage]:
    """Return the launches of one GPU step.

    The kernels for walls run on a side stream, at the same time as the kernels for bodies.
    """
    b, f, n = batch, batch.features, batch.sphere_count
    width = warp_width(b.device)
    stages = near_stages(b)
    if f.analytic:
        surfaces = surface_kernel(b.scalar, f.wall_law, f.dissipation, f.wear, width)
        bits = wall_lane_bits(b)
        threads = -(-(n << bits) // width) * width
        stages.append(b.stage(surfaces, threads, count=n, lane_bits=bits, on_side_stream=True))
    if f.meshes:
        stages.append(_meshes(b, 0, 0, n, on_side_stream=True))
    kernel = link_kernel(b.scalar, f.pair_law, f.history, f.bonds, f.healing, f.subcycling, f.dissipation, f.mixed)
    # Round the number of threads up to a multiple of the warp width.
    threads = -(-math.ceil(THREADS_PER_LINK * len(b.links.link)) // width) * width
    stages += [b.stage(kernel, threads, threads=threads), _motion(b, 0, b.body_count)]
    if f.walls:
        stages.append(b.stage(advance_kernel(b.scalar, f.strokes), b.wall_count, on_side_stream=True))
    stages += [
        *(b.subcycles.stages(0) if f.subcycling else ()),
        b.stage(clock_kernel(b.scalar, f.growth), b.count, joins_side_stream=True),
        *([b.structure.stage()] if b.structure is not None else []),
    ]
    return stages


def wall_lane_bits(batch: Batch) -> int:
    """Return the base-2 logarithm of the number of GPU threads that check one sphere against all planes and pipes."""
    most = int(batch.rows["analytic"].max())
    # With one or two walls, several threads per sphere would not be faster than one thread.
    if warp_width(batch.device) == 1 or most <= 2:
        return 0
    bits = min((most - 1).bit_length(), WALL_LANE_BITS)
    return min(bits, max((WALL_THREADS // max(batch.sphere_count, 1)).bit_length() - 1, 0))


def _half_contacts(batch: Batch, part: int, first: int, last: int) -> list[Stage]:
    """Return the launches of CPU thread `part` for the contact forces on the spheres from `first` to `last` - 1."""
    b, f = batch, batch.features
    contacts = contact_kernel(b.scalar, f.pair_law, f.history, f.bonds, f.healing, f.subcycling, f.dissipation, f.mixed)
    stages = [b.stage(contacts, tasks(b, last - first), first=first, last=last)]
    if f.analytic:
        walls = wall_kernel(b.scalar, f.wall_law, f.dissipation, f.wear)
        stages.append(b.stage(walls, tasks(b, last - first), first=first, last=last, part=part))
    if f.meshes:
        stages.append(_meshes(b, part, first, last))
    return stages


def _meshes(batch: Batch, part: int, first: int, last: int, *, on_side_stream: bool = False) -> Stage:
    b, f = batch, batch.features
    kernel = mesh_kernel(b.scalar, f.wall_law, f.half_list, f.dissipation, f.wear)
    named: Arguments = {
        "first": first,
        "last": last,
        "part": part,
        "near_margin": NEAR_MARGIN,
        **struct_arguments(kernel, wall=b.walls, slot=b.slots),
    }
    return b.stage(kernel, tasks(b, last - first), on_side_stream=on_side_stream, **named)


def _motion(batch: Batch, first: int, last: int) -> Stage:
    """Return the launch that moves the bodies from `first` to `last` - 1 after all forces have been computed."""
    b, f = batch, batch.features
    named: Arguments = {"first": first, "last": last}
    rows = 0 if f.half_list else rows_of(f)
    count = tasks(b, last - first)
    if f.clumps:
        width = warp_width(b.device)
        kernel = clump_kernel(
            b.scalar, f.drives, f.growth, f.meshes, f.half_list, f.subcycling, f.dissipation, rows, width
        )
        bits = LANE_BITS if width > 1 and (b.sphere_count < MANY_SPHERES or rows > 2) else 0
        if not f.half_list:
            count = -(-(count << bits) // width) * width
        named |= {"subcycled": b.subcycles.arrays, "lane_bits": bits}
    else:
        kernel = sphere_kernel(b.scalar, f.drives, f.growth, f.meshes, f.rotation, f.half_list, f.dissipation, rows)
    return b.stage(kernel, count, joins_side_stream=True, **named)
