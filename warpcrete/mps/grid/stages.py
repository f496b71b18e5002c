"""One time step of a flow on a grid, as a list of stages for each thread.

1. Sort particles into cells, compute how full the cells are, and transfer velocities from particles to faces.
2. Compute shear rates, apparent viscosities and wall friction, and solve for the velocities.
3. Solve for the pressure increment, and remove the divergence of the velocities.
4. Adapt the driving force, measure the speed, break the thixotropic structure, and disperse crowded particles.
5. Extrapolate the velocities beyond the concrete, move the particles, and advance the clock.
"""

from typing import Any

import warp as wp

from ...core.device.arrays import Kernel
from ...core.device.launching import Stage, parameter_names
from ...core.device.scan import scan_stages
from ...kernels.common.reductions import BLOCK
from ...kernels.mps.grid.advection import advect_kernel
from ...kernels.mps.grid.bins import bin_kernels, lift_kernel
from ...kernels.mps.grid.cells import STRIP
from ...kernels.mps.grid.filling import fill_kernel
from ...kernels.mps.grid.forces import momentum_kernel, viscosity_kernels
from ...kernels.mps.grid.levels import level_kernels
from ...kernels.mps.grid.pace import speed_kernels
from ...kernels.mps.grid.pressure import crowd_kernels, drive_kernels, pressure_kernels
from ...kernels.mps.grid.resident_multigrid import resident_multigrid
from ...kernels.mps.grid.serial_multigrid import serial_multigrid
from ...kernels.mps.grid.structure import break_kernel
from ...kernels.mps.grid.transfer import extend_kernel, gather_kernel
from ...kernels.mps.grid.walls import side_kernel, wall_kernel
from ...kernels.mps.resident_solver import resident_blocks
from ...kernels.mps.structs import DENSITY, PRESSURE, VISCOSITY
from .systems import CHUNKS, System

# Number of layers of cells beyond the concrete, in air and walls, to which velocities are extrapolated.
EXTRAPOLATED_CELLS = 3
# Two tolerances of the solve that disperses crowded particles. The first tolerance is a fraction of the initial
# residual. The second tolerance is a fraction of the residual that arises if every cell must lose its whole volume in
# one step.
DISPERSION_TOLERANCES = 0.1, 1e-5


class GridStep:
    """Stages of a time step for one CPU thread, or for the GPU.

    The work of a stage is divided into one share for each thread. `parts` are the numbers of the shares in this object:
    one share for one of several threads, or all shares for a thread that does the whole step. Share 0 includes the work
    that is not divided. After each stage, the threads wait for one another.
    """

    def __init__(self, flow: Any, parts: range) -> None:
        self.flow, self.parts = flow, parts
        self.layout, self.scalar, self.slots = flow.state.layout, flow.scalar, flow.state.slots
        self.kind = self.layout.kind
        self.barrier = flow.barrier() if len(parts) < flow.threads else []

    def stages(self) -> list[Stage]:
        """Return all stages of a time step in their order."""
        flow, layout, kind, scalar = self.flow, self.layout, self.kind, self.scalar
        serial = not flow.parallel
        viscosity, pressure = viscosity_kernels(scalar, kind), pressure_kernels(scalar, serial, kind)
        velocity, increment = flow.mesh.velocity, flow.mesh.increment
        viscous, projection = flow.viscous, flow.projection
        return [
            *self.gather(),
            *self._cells(viscosity.rates),
            *self._cells(viscosity.viscosity),
            *self._cells((wall_kernel if kind.cut else side_kernel)(scalar, kind)),
            *self._cells(momentum_kernel(scalar, serial, kind), matrix=viscous.matrix, viscous=viscous.arrays),
            *self._complete(viscous),
            *self._solve(viscous, VISCOSITY, velocity, 0.0),
            *self._cells(pressure.divergence, matrix=projection.matrix, projection=projection.arrays),
            *self._complete(projection),
            *self._solve(projection, PRESSURE, increment, flow.scene.tolerance),
            *self._cells(pressure.project),
            *(self._drive() if layout.periodic and layout.mean_velocity_fixed else []),
            *(self._speeds() if flow.adaptive else []),
            *(self._break_structure() if kind.thixotropic else []),
            *([] if flow.full else self._disperse()),
            *self._extrapolate(),
            *self._shared(advect_kernel(scalar, kind), flow.count, velocity=flow.extended[0], good=flow.known_faces[0]),
            *self._alone(flow.clock_kernels.tick, 1),
        ]

    def gather(self) -> list[Stage]:
        """Return the stages that sort particles into cells and transfer their mass and velocity to the grid."""
        flow, kind, scalar, serial = self.flow, self.kind, self.scalar, not self.flow.parallel
        bins = bin_kernels(scalar, serial, kind)
        return [
            *self._alone(bins.clear, self.slots),
            *(self._cells(lift_kernel(scalar, kind), slots=self.slots, after=flow.state.opened)
              if len(self.layout.opens) else []),
            *self._alone(bins.tally, flow.count),
            *self._alone(bins.allot, self.slots),
            *self._shared(bins.sort, flow.count),
            *self._cells(bins.order),
            *([] if serial else self._alone(bins.copy, flow.count)),
            *([] if flow.full else self._cells(fill_kernel(scalar, serial, kind))),
            *self._cells(gather_kernel(scalar, serial, kind)),
        ]  # fmt: skip

    # The following methods make stages from a kernel.

    def _shared(self, kernel: Kernel, count: int, **named: object) -> list[Stage]:
        """Return stages in which the threads share the `count` items of a kernel, and then wait for one another."""
        stages, threads = [], self.flow.threads
        for part in self.parts:
            # The items are divided into strips of STRIP items. This thread processes the strips with the numbers part,
            # part + threads, part + 2 threads, ...
            strips = len(range(part * STRIP, count, threads * STRIP))
            last = (part + (strips - 1) * threads) * STRIP
            tasks = (strips - 1) * STRIP + min(STRIP, count - last) if strips else 0
            stages.append(self.flow.stage(kernel, tasks, worker=part, workers=threads, **named))
        return [*stages, *self.barrier]

    def _cells(self, kernel: Kernel, **named: object) -> list[Stage]:
        return self._shared(kernel, self.slots, **named)

    def _alone(self, kernel: Kernel, tasks: int, **named: object) -> list[Stage]:
        """Return stages in which only the first thread runs a kernel while all other threads wait."""
        return [*([self.flow.stage(kernel, tasks, **named)] if self.parts.start == 0 else []), *self.barrier]

    # The following methods return stages of a step.

    def _break_structure(self) -> list[Stage]:
        """Return stages in which shear and slip reduce the yield stress that the concrete gained at rest."""
        scene = self.flow.scene
        return self._cells(
            break_kernel(self.scalar, self.kind),
            breakdown=scene.breakdown,
            breakdown_strain=scene.breakdown_strain,
            rebuild_rate=scene.rebuild_rate,
        )

    def _extrapolate(self) -> list[Stage]:
        """Return the kernel launches that extrapolate velocities beyond the concrete, each by one cell.

        The first launch reads the velocities on the faces of the grid. Each further launch reads the velocities that
        the launch before it has written. The launches write to the two arrays `flow.extended` in alternation, so that
        the last one writes to the first array.
        """
        flow, stages = self.flow, []
        for turn in range(EXTRAPOLATED_CELLS):
            to = (EXTRAPOLATED_CELLS - 1 - turn) % 2
            stages += self._cells(
                extend_kernel(self.scalar, self.kind), again=int(turn > 0), final=int(turn == EXTRAPOLATED_CELLS - 1),
                before=flow.extended[1 - to], known_before=flow.known_faces[1 - to], after=flow.extended[to],
                known_after=flow.known_faces[to],
            )  # fmt: skip
        return stages

    def _disperse(self) -> list[Stage]:
        """Return stages that move particles out of crowded regions.

        A linear system with the matrix of the pressure system gives a potential; the displacements are along its
        gradient.
        """
        kernels, flow = crowd_kernels(self.scalar, self.kind), self.flow
        return [
            *self._cells(kernels.source, projection=flow.dispersion.arrays),
            *self._solve(flow.dispersion, DENSITY, flow.mesh.potential, DISPERSION_TOLERANCES[0]),
            *self._cells(kernels.disperse),
        ]

    def _speeds(self) -> list[Stage]:
        """Return stages that measure the speed of the concrete, which determines the length of the next step."""
        kernels, flow = speed_kernels(self.scalar, self.kind), self.flow
        if not flow.parallel:
            return self._alone(kernels.speeds, 1)
        blocks, partial = -(-flow.viscous.rows // BLOCK), flow.viscous.arrays.partial
        return [
            flow.stage(kernels.sums, BLOCK * blocks, block=BLOCK, blocks=blocks, partial=partial),
            flow.stage(kernels.speeds_of_sums, BLOCK, block=BLOCK, blocks=blocks, partial=partial),
        ]

    def _drive(self) -> list[Stage]:
        """Return stages that adapt the driving force of a periodic pipe, so that the mean velocity stays constant."""
        kernels, flow = drive_kernels(self.scalar, self.layout.axes), self.flow
        correct = self._alone(kernels.correct, self.slots)
        if not flow.parallel:
            return [*self._alone(kernels.deficit, 1), *correct]
        blocks, partial = -(-self.slots // BLOCK), flow.viscous.arrays.partial
        return [
            flow.stage(kernels.sums, BLOCK * blocks, block=BLOCK, blocks=blocks, partial=partial),
            flow.stage(kernels.deficit_of_sums, BLOCK, block=BLOCK, blocks=blocks, partial=partial),
            *correct,
        ]

    def _complete(self, system: System) -> list[Stage]:
        """Return the stages that prepare a linear system for its solve.

        The stages compute the coarser multigrid levels of the system, and list its rows with unknowns.
        """
        kernels, matrix = level_kernels(self.scalar, not self.flow.parallel), system.matrix
        stages = []
        for level in range(1, len(system.first) - 1):
            rows = system.first[level + 1] - system.first[level]
            stages += self._shared(kernels.coarsen, rows, level=level, matrix=matrix)
        stages += self._shared(kernels.damp, system.first[-1], matrix=matrix)
        if self.flow.parallel:
            stages += scan_stages(matrix.free, matrix.before)
        return [*stages, *self._alone(kernels.list_rows, system.first[-1] if self.flow.parallel else 1, matrix=matrix)]

    def _solve(self, system: System, what: int, x: wp.array, tolerance: float) -> list[Stage]:
        """Return the stage that solves a system by conjugate gradients and adds the solution to the array `x`.

        The solve stops when the norm of its residual is below `tolerance` times the initial norm, or below the norm
        stored in the system. `what` is the number that names the solve in the control flags if the solve fails.
        """
        flow = self.flow
        lower, upper = (CHUNKS * part // flow.threads for part in (self.parts.start, self.parts.stop))
        named = {
            "what": what, "tolerance": tolerance, "maximum": flow.scene.maximum_iterations, "matrix": system.matrix,
            "system": system.arrays, "x": x, "gate": flow.gate, "flags": flow.flags, "parts": CHUNKS, "lower": lower,
            "upper": upper, "workers": flow.threads // len(self.parts),
        }  # fmt: skip
        kernel, tasks, block = serial_multigrid(self.scalar), 1, None
        if flow.parallel:
            block, parties = resident_blocks(flow.device, system.rows, system.matrix.near_capacity, flow.abreast)
            named["parties"] = parties
            kernel, tasks = resident_multigrid(self.scalar, block), block * parties
        return [Stage(kernel, tasks, {name: named[name] for name in parameter_names(kernel)}, flow.device, block=block)]
