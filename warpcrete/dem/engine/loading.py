"""Compile all kernels of a batch in parallel before its first launch."""

from ...core.device.arrays import Kernel
from ...core.device.launching import Stage, load
from ...kernels.dem import probes
from ...kernels.dem.bonding import bond_kernels
from ...kernels.dem.motion import sync_kernel
from .batch import Batch
from .device_rebuild import DeviceRebuild
from .neighbors import NeighborLists
from .stable_step import StableStep
from .stages import step_stages


def load_kernels(lists: NeighborLists, estimate: StableStep) -> None:
    """Compile all kernels that a run will launch, or load them from the cache.

    A run launches kernels for time steps, neighbour lists, stable step estimates, measurements and bonds.
    """
    batch = lists.batch
    if batch.sphere_count:
        steps = [stage for part in step_stages(batch) for stage in part]
        rebuild = DeviceRebuild(lists).stages() if DeviceRebuild.possible(batch) else []
        others = [*_others(batch), *batch.subcycles.kernels(), *rebuild]
        load([*steps, *lists.kernels(), *estimate.kernels(), *others], batch.device)


def _others(batch: Batch) -> list[Stage | Kernel]:
    """Return the kernels for measurements, for bonds, and for copying the motion of spheres to their bodies."""
    f, scalar = batch.features, batch.scalar
    launches: list[Stage | Kernel] = [
        probes.body_probe(scalar),
        probes.wall_probe(scalar),
        probes.contact_probe(scalar, f.pair_law, f.wall_law, f.half_list, f.history, f.bonds),
        *probes.column_kernels(),
    ]
    if f.bonds:
        launches += bond_kernels(scalar)
    return launches if f.clumps else [*launches, batch.stage(sync_kernel(scalar), batch.sphere_count)]
