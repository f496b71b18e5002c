"""One step of the implicit moving particle method, as a list of stages.

A step is a pressure-correction scheme whose predictor uses the pressure of the previous step:

1. Geometry: moment matrices, apparent viscosity, and the filtered pressure of the previous step.
2. Velocities: an implicit solve with viscosity, slip layer, predicted pressure and weight, in which grains are rigid
   bodies.
3. Pressure: the increment of the pressure that removes the divergence of these velocities.
4. Positions: particles move with their velocities. A further solve, with a loose tolerance, then moves them out of
   crowded regions without changing any velocity.

Xu, Li & Jiang 2021 describe the method in sections 2.1 to 2.5. Where the printed scheme fails,
notebooks/theory/particles.md describes and explains the changes.
"""

from __future__ import annotations

import functools
import math
from typing import Any

from ..core.device.arrays import Kernel
from ..core.device.launching import Stage, Step, struct_arguments
from ..kernels.common.reductions import BLOCK, parallel_scale, serial_scale
from ..kernels.mps.coarse import coarse_kernels, serial_coarse_kernel
from ..kernels.mps.conjugate_gradient import serial_solver
from ..kernels.mps.moments import geometry_kernel
from ..kernels.mps.motion import advance_kernel, finish, shift_kernel
from ..kernels.mps.operators import divergence_kernel, gradient_kernel, momentum_kernel
from ..kernels.mps.resident_solver import resident_blocks, resident_solver
from ..kernels.mps.rigid import bodies_kernel, places_kernel, velocities_kernel
from ..kernels.mps.structs import DENSITY, PRESSURE, VISCOSITY, span
from ..kernels.mps.two_level import resident_two_level, serial_two_level
from .common.stepping import ABSOLUTE_PRESSURE_FACTOR, VELOCITY_ERROR

DENSITY_TOLERANCES = 0.1, 1e-7
"""Two tolerances of the density solve, which moves particles out of crowded regions. The solve stops when its residual,
divided by the initial residual, falls below the first tolerance. It also stops when the root mean square of its
residual falls below the second tolerance."""


def step_stages(particles: Any) -> Step:
    """Return the stages of one step of :class:`MovingParticles` on its current arrays, one list for each thread."""
    return [part.step() for part in step_parts(particles)]


def step_by_one_thread(particles: Any) -> Step:
    """Return the stages of one step for a single thread that does the work of all threads."""
    return [StepPart(particles, range(particles.threads), []).step()]


def step_parts(particles: Any) -> list[StepPart]:
    """Return the parts of a time step, one for each thread."""
    barrier_stages = particles.barrier()
    return [StepPart(particles, range(part, part + 1), barrier_stages) for part in range(particles.threads)]


class StepPart:
    """Stages of a time step for one thread.

    The particles are divided into one range for each thread. `parts` are the numbers of the ranges that this thread
    works on: one range, or all ranges if this thread does the work of all threads. The part with range 0 also does
    the work that is not divided.
    """

    def __init__(self, particles: Any, parts: range, barrier_stages: list[Stage]) -> None:
        self.p, self.parts, self.barrier_stages = particles, parts, barrier_stages
        self.scene, self.dimensions = particles.scene, particles.scene.dimensions
        self.serial = not particles.parallel
        self.two_phase = particles.grains is not None
        self.kind = particles.scalar, self.dimensions, self.serial

    def step(self) -> list[Stage]:
        """Return all stages of a time step in their order."""
        return [
            *self.geometry(),
            *self.wall_scale(),
            *self.momentum(),
            *self.bodies(),
            *self.viscosity(),
            *self.over_rows(divergence_kernel(*self.kind, self.two_phase)),
            *self.pressure(),
            *self.over_rows(gradient_kernel(*self.kind, self.two_phase)),
            *self.shifting(),
            *self.motion(),
            *self.finish(),
        ]

    # The following methods make stages from a kernel.

    def over_rows(self, kernel: Kernel, **named: object) -> list[Stage]:
        """Return stages that run a kernel over this thread's ranges of particles, followed by a barrier."""
        p, stages = self.p, []
        for part in self.parts:
            first, end = p.count * part // p.threads, p.count * (part + 1) // p.threads
            tasks = -(-(end - first) // span(self.serial))
            stages.append(p.stage(kernel, tasks, first=first, end=end, **named))
        return [*stages, *self.barrier_stages]

    def by_first_thread(self, kernel: Kernel, tasks: int = 1, **named: object) -> list[Stage]:
        """Return stages in which only the first thread runs a kernel, followed by a barrier of all threads."""
        return [*([self.p.stage(kernel, tasks, **named)] if self.parts.start == 0 else []), *self.barrier_stages]

    def in_blocks(self, kernel: Kernel, number: int | None = None, **named: object) -> Stage:
        """Return a stage that launches a kernel on a GPU as `number` full thread blocks.

        By default there are enough blocks for one thread per particle.
        """
        return self.p.stage(kernel, BLOCK * (number or self.p.blocks), block=BLOCK, **named)

    # The following methods return the stages of a step, in the order of the step.

    def geometry(self) -> list[Stage]:
        """Return the stages that compute the particles' apparent viscosities and the moments of neighbour positions."""
        kernel = geometry_kernel(*self.kind, self.two_phase, self.scene.concrete.bulk_law.name)
        return self.over_rows(kernel, **struct_arguments(kernel, particle=self.p.particles))

    def wall_scale(self) -> list[Stage]:
        """Return the stages that scale the wall area which each particle represents.

        After scaling, these areas add up to the area of the pipe's wall that the concrete covers.
        """
        p = self.p
        weights = {"weight": p.fields.wall_weight}
        result = {"wanted": p.wet_area / p.state.layout.volume, "factor": p.fields.wall_scale}
        if self.serial:
            return self.by_first_thread(serial_scale(p.scalar), **weights, **result)
        gather, divide = parallel_scale(p.scalar)
        partial = p.viscous.partial
        return [
            self.in_blocks(gather, partial=partial, **weights),
            self.in_blocks(divide, 1, partial=partial, **result),
        ]

    def momentum(self) -> list[Stage]:
        """Return the stages that assemble the equations for the velocities."""
        return self.over_rows(momentum_kernel(*self.kind, self.two_phase, self.scene.concrete.layer_law.name))

    def bodies(self) -> list[Stage]:
        """Return the stage that prepares the rigid grains for the velocity solve."""
        if not self.two_phase:
            return []
        return self.by_first_thread(bodies_kernel(self.p.scalar, self.dimensions), self.p.state.grains.count)

    def viscosity(self) -> list[Stage]:
        """Return the stages that solve for the velocities."""
        absolute = VELOCITY_ERROR * self.rate * self.scene.velocity * self.size
        return [
            *self.coarse_matrix(True),
            *self.solve(self.p.viscous, VISCOSITY, self.p.particles.velocity, 0.0, absolute),
        ]

    def pressure(self) -> list[Stage]:
        """Return the stages that solve for the increment of the pressure."""
        scene, tolerance = self.scene, self.scene.tolerance
        absolute = ABSOLUTE_PRESSURE_FACTOR * tolerance * self.rate * scene.velocity / scene.radius * self.size
        solve = self.solve(self.p.projection, PRESSURE, self.p.fields.increment, tolerance, absolute)
        return [*self.coarse_matrix(False), *solve]

    def shifting(self) -> list[Stage]:
        """Return the stages that solve for the density correction and move particles out of crowded regions."""
        tolerance, error = DENSITY_TOLERANCES
        return [
            *self.solve(self.p.shifting, DENSITY, self.p.fields.potential, tolerance, error * self.size),
            *self.over_rows(shift_kernel(*self.kind)),
        ]

    def motion(self) -> list[Stage]:
        """Return the stages that update grain velocities, then particle positions, then grain positions."""
        advance = self.over_rows(advance_kernel(*self.kind))
        if not self.two_phase:
            return advance
        p, grains = self.p, self.p.state.grains.count
        before = self.by_first_thread(velocities_kernel(p.scalar, self.dimensions), grains)
        after = self.by_first_thread(places_kernel(p.scalar, self.dimensions), grains)
        return [*before, *advance, *after]

    def finish(self) -> list[Stage]:
        """Return the stage that counts the step and marks neighbour lists that are out of date."""
        return self.by_first_thread(finish, event_flags=self.p.fields.event_flags)

    # The following methods return the linear solves.

    def coarse_matrix(self, vector: bool) -> list[Stage]:
        """Return the launches that compute the coarse matrix of the preconditioner.

        `vector` is True for the solve for velocities, and False for the solve for the pressure. The density solve also
        uses the coarse matrix of the pressure.
        """
        coarse = self.p.coarse
        if coarse is None:
            return []
        p, kind = self.p, (self.p.scalar, self.dimensions, vector)
        if self.serial:
            begin, end = (coarse.count * part // p.threads for part in (self.parts.start, self.parts.stop))
            return [p.stage(serial_coarse_kernel(*kind), 1, begin=begin, end=end), *self.barrier_stages]
        kernels = coarse_kernels(*kind)
        return [p.stage(kernels.pairs, p.count), p.stage(kernels.sums, coarse.count * 3**self.dimensions)]

    @property
    def size(self) -> float:
        """Square root of the number of particles, by which an rms value is multiplied to obtain a norm."""
        return math.sqrt(self.p.count)

    @property
    def rate(self) -> float:
        """Density divided by the time step [kg/m3/s]: force per volume that changes a velocity by 1 m/s in one step."""
        return self.scene.concrete.density / self.scene.time_step

    def solve(self, system: Any, what: int, x: object, tolerance: float, absolute: float) -> list[Stage]:
        """Return the stage of a conjugate-gradient solve that adds its solution to the array `x`.

        The solve stops when the norm of its residual is below `tolerance` times the initial norm, or below `absolute`.
        The preconditioner is the diagonal of the matrix, combined with the coarse grid if there is one. `what` is the
        number that names the solve in the control flags if the solve fails.
        """
        p, maximum = self.p, self.scene.maximum_iterations
        vector = what == VISCOSITY
        rigid = vector and self.two_phase
        kind = p.scalar, self.dimensions, vector
        serial, resident = (functools.partial(solver, *kind) for solver in (serial_two_level, resident_two_level))
        if p.coarse is None:
            serial, resident = (functools.partial(s, *kind, rigid) for s in (serial_solver, resident_solver))
        system.stop_norm.fill_(absolute)
        if self.serial:
            lower, upper = self.parts.start, self.parts.stop
            chunks = {"parts": p.threads, "lower": lower, "upper": upper, "workers": p.threads // (upper - lower)}
            return [p.stage(serial(), 1, what=what, maximum=maximum, system=system, x=x, tolerance=tolerance, **chunks)]
        width, parties = resident_blocks(p.device, p.count, p.matrix.near_capacity, p.abreast)
        named = {"what": what, "maximum": maximum, "system": system, "x": x, "parties": parties, "tolerance": tolerance}
        return [p.stage(resident(width=width), width * parties, block=width, **named)]
