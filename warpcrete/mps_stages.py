"""One step of the implicit moving particle method, as a list of stages.

A step projects as pressure-correction methods do, with the pressure of the step before in the prediction:

1. geometry: moment matrices, apparent viscosity, predicted pressure (filtered);
2. velocities under viscosity, slip layer, predicted pressure and weight (implicit);
3. the increment of pressure that takes their divergence away;
4. places: along the velocities, then off crowds by a second, loose solve that no velocity feels.

Xu, Li & Jiang 2021, sections 2.1 to 2.5; where their printed scheme does not hold, notebooks/fluid.md says what is
done instead and why.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from .fluid_state import lattice_number
from .kernels.conjugate_gradient import parallel_solver, serial_solver
from .kernels.mps_literal import LAPLACIAN, literal_kernels
from .kernels.mps_motion import advance_kernel, finish, shift_kernel
from .kernels.mps_operators import divergence_kernel, geometry_kernel, gradient_kernel, momentum_kernel
from .kernels.mps_rigid import rigid_kernels
from .kernels.mps_types import DENSITY, PRESSURE, VISCOSITY, span
from .kernels.sums import BLOCK, parallel_scale, serial_scale
from .launching import Loop, Stage, Step, barrier_stage

if TYPE_CHECKING:
    from .mps import MovingParticles, Solve

VELOCITY_ERROR = 1e-6  # of the viscosity solve: residual over that which a change by the piston's speed would make
LEAST_PRESSURE = 1e-4  # of the pressure's tolerance, for residuals over those of the piston's speed across the radius
SPREADING = 0.1, 1e-7  # of the density's solve: residual over that at its start, or mean over the share of density
LOOPED = 8  # iterations of a GPU from one look at whether to go on to the next; an even number


def step_stages(particles: MovingParticles) -> Step:
    """Stages of one step on the arrays that there are now, a list for each thread."""
    p = particles
    meet = barrier_stage(p.threads, p.device)
    rows = [p.state.count * k // p.threads for k in range(p.threads + 1)]
    return [_Part(p, k, rows[k], rows[k + 1], meet).step() for k in range(p.threads)]


class _Part:
    """What one thread does in a step: rows `first` to `end`, and what only the first part does for all."""

    def __init__(self, particles: MovingParticles, part: int, first: int, end: int, meet: list[Stage]) -> None:
        self.p, self.part, self.first, self.end, self.meet = particles, part, first, end, meet
        p = particles
        self.scene, self.device, self.dimensions = p.scene, p.device, p.scene.dimensions
        self.serial = not p.is_cuda
        self.two_phase = p.state.grains is not None
        near, far, wall = p.capacity
        self.rows = [p.flow, first, end]
        self.near = [*self.rows, near, p.state.flags, p.near_count, p.near]
        self.near_wall = [*self.rows, near, wall, p.state.flags, p.near_count, p.near, p.near_wall, p.wall]
        self.all = [
            *self.rows, near, far, wall, p.state.flags, p.near_count, p.near, p.far_count, p.far, p.near_wall, p.wall
        ]  # fmt: skip
        self.kind = p.scalar, self.dimensions, self.serial

    def step(self) -> list[Any]:
        """The whole step."""
        printed = self.scene.literal
        return [
            *self.geometry(),
            *self.wall_scale(),
            *(self.printed_weights() if printed else []),
            *self.momentum(),
            *self.viscosity(),
            *(self.printed_source() if printed else self.divergence()),
            *self.pressure(),
            *(self.printed_projection() if printed else self.projection()),
            *([] if printed else self.spreading()),
            *self.motion(),
            *self.alone(finish, [self.p.state.flags, self.p.late]),
            *self.meet,
        ]

    # Launches.

    def each(self, kernel, arguments: list[Any]) -> list[Stage]:
        """A kernel over the part's rows; then all wait."""
        tasks = -(-(self.end - self.first) // span(self.serial))
        return [Stage(kernel, tasks, arguments, self.device), *self.meet]

    def alone(self, kernel, arguments: list[Any], tasks: int = 1) -> list[Stage]:
        """A kernel that the first part runs for all."""
        return [Stage(kernel, tasks, arguments, self.device)] if self.part == 0 else []

    def blocks(self, kernel, arguments: list[Any], blocks: int | None = None) -> Stage:
        """A kernel in whole blocks of a GPU, over all rows unless a number is given."""
        return Stage(kernel, BLOCK * (blocks or self.p.blocks), arguments, self.device, block=BLOCK)

    # Stages, in their order.

    def geometry(self) -> list[Any]:
        p, s = self.p, self.p.state
        return self.each(
            geometry_kernel(*self.kind, self.two_phase),
            [*self.all, s.group, s.position, s.wall_position, s.velocity, s.pressure, p.pair_weight, p.fluid_inverse,
             p.whole_inverse, p.inverse_number, p.free, p.crowding, p.wall_weight, p.viscosity, p.compliance,
             p.predicted],
        )  # fmt: skip

    def wall_scale(self) -> list[Any]:
        """The factor that makes the wall's areas of all particles that of the wall."""
        p = self.p
        count, wanted = p.state.count, p.wet_area / p.state.layout.volume
        if self.serial:
            alone = serial_scale(p.scalar)
            return [*self.alone(alone, [count, wanted, p.wall_weight, p.wall_scale]), *self.meet]
        gather, divide = parallel_scale(p.scalar)
        partial = p.viscous.partial
        return [
            self.blocks(gather, [count, p.wall_weight, partial]),
            self.blocks(divide, [p.blocks, wanted, partial, p.wall_scale], 1),
        ]

    def momentum(self) -> list[Any]:
        p, s = self.p, self.p.state
        return self.each(
            momentum_kernel(*self.kind, self.two_phase),
            [*self.near, s.density, s.position, s.velocity, p.pair_weight, p.inverse_number, p.fluid_inverse,
             p.wall_weight, p.wall_scale, p.viscosity, p.compliance, p.predicted, p.pair_coefficient, p.diagonal,
             p.drag, p.traction, p.viscous.residual],
        )  # fmt: skip

    def viscosity(self) -> list[Any]:
        enough = VELOCITY_ERROR * self.rate * self.scene.velocity * self.size
        return self.solve(self.p.viscous, True, VISCOSITY, self.p.state.velocity, 0.0, enough)

    def divergence(self) -> list[Any]:
        p, s = self.p, self.p.state
        return self.each(
            divergence_kernel(*self.kind, self.two_phase),
            [*self.near_wall, s.density, p.free, s.position, s.wall_position, s.velocity, p.pair_weight,
             p.inverse_number, p.whole_inverse, p.pair_coefficient, p.diagonal, p.projection.residual, p.increment,
             p.potential],
        )  # fmt: skip

    def pressure(self) -> list[Any]:
        scene, tolerance = self.scene, self.scene.tolerance
        enough = LEAST_PRESSURE * tolerance * self.rate * scene.velocity / scene.radius * self.size
        return self.solve(self.p.projection, False, PRESSURE, self.p.increment, tolerance, enough)

    def projection(self) -> list[Any]:
        p, s = self.p, self.p.state
        return self.each(
            gradient_kernel(*self.kind, self.two_phase),
            [*self.near, s.density, s.position, p.pair_weight, p.fluid_inverse, p.predicted, p.increment, s.velocity,
             s.pressure],
        )  # fmt: skip

    def spreading(self) -> list[Any]:
        """The solve of what moves particles off crowds, and how far that is."""
        p = self.p
        tolerance, enough = SPREADING
        return [
            *self.solve(p.spreading, False, DENSITY, p.potential, tolerance, enough * self.size),
            *self.each(
                shift_kernel(*self.kind),
                [*self.near, p.state.position, p.pair_weight, p.fluid_inverse, p.potential, p.moved],
            ),
        ]

    def motion(self) -> list[Any]:
        """Velocities of grains, then all particles, then grains' places."""
        p, s = self.p, self.p.state
        before, after = [], []
        if self.two_phase:
            velocities, places = rigid_kernels(p.scalar, self.dimensions)
            g = s.grain_arrays
            arguments = [p.flow, s.flags, g["first"], s.position, s.velocity, p.moved, g["spin"], g["step"]]
            before = [*self.alone(velocities, arguments, g["count"]), *self.meet]
            arguments = [
                p.flow, s.flags, g["first"], g["offset"], g["step"], g["spin"], g["middle"], g["middle_rounding"],
                g["turn"], s.position,
            ]  # fmt: skip
            after = [*self.alone(places, arguments, g["count"]), *self.meet]
        advance = self.each(
            advance_kernel(*self.kind),
            [*self.rows, 1.5 * s.layout.height, s.flags, s.velocity, p.moved, p.built, s.rounding, s.position, p.late],
        )
        return [*before, *advance, *after]

    # The scheme as it is printed.

    def printed_weights(self) -> list[Any]:
        p, s = self.p, self.p.state
        weights, _, _ = literal_kernels(*self.kind)
        reach = [LAPLACIAN * s.layout.spacing, lattice_number(self.dimensions, LAPLACIAN)]
        return self.each(weights, [*self.near, *reach, s.position, p.pair_weight, p.inverse_number, p.predicted])

    def printed_source(self) -> list[Any]:
        p, s = self.p, self.p.state
        _, source, _ = literal_kernels(*self.kind)
        return self.each(
            source,
            [*self.near_wall, p.free, s.position, s.wall_position, s.velocity, p.pair_weight, p.pair_coefficient,
             p.diagonal, p.projection.residual, p.increment],
        )  # fmt: skip

    def printed_projection(self) -> list[Any]:
        p, s = self.p, self.p.state
        _, _, project = literal_kernels(*self.kind)
        return self.each(project, [*self.near_wall, s.position, s.wall_position, p.increment, s.velocity, s.pressure])

    # Solves.

    @property
    def size(self) -> float:
        """Norm of as many ones as there are particles."""
        return math.sqrt(self.p.state.count)

    @property
    def rate(self) -> float:
        """Force per volume that changes a velocity by 1 m/s within a step [kg/m3/s]."""
        return self.scene.concrete.density / self.scene.time_step

    def solve(self, solve: Solve, vector: bool, what: int, x, tolerance: float, enough: float) -> list[Any]:
        """Conjugate gradients down to `tolerance` of the residual at the start, or to `enough`; adds to `x`."""
        p, s, most = self.p, self.p.state, self.scene.most_iterations
        near = p.capacity[0]
        fixed = [p.free, p.diagonal, p.drag]
        r, d, q, partial, outcome = solve.residual, solve.direction, solve.product, solve.partial, solve.outcome
        if self.serial:
            kernel = serial_solver(p.scalar, self.dimensions, vector)
            arguments = [
                p.flow, self.part, p.threads, self.first, self.end, near, what, tolerance, enough, most, p.gate,
                s.flags, p.near_count, p.near, s.position, p.pair_coefficient, *fixed, r, d, q, x, partial, outcome,
                solve.history,
            ]  # fmt: skip
            return [Stage(kernel, 1, arguments, self.device)]
        begin, ready, multiply, update, direct = parallel_solver(p.scalar, self.dimensions, vector)
        b, going, numbers = p.blocks, solve.going, solve.numbers
        body = []
        for now in (0, 1) * (LOOPED // 2):
            body += [
                self.blocks(
                    multiply,
                    [p.flow, b, near, p.near_count, p.near, s.position, p.pair_coefficient, *fixed, going, d, q,
                     partial],
                ),
                self.blocks(update, [p.flow, b, now, *fixed, going, numbers, d, q, r, x, partial]),
                self.blocks(
                    direct,
                    [p.flow, b, now, most, what, s.flags, partial, going, numbers, d, q, outcome, solve.history],
                ),
            ]  # fmt: skip
        return [
            self.blocks(begin, [p.flow, b, *fixed, r, d, partial]),
            self.blocks(ready, [b, tolerance, enough, s.flags, partial, numbers, outcome, going], 1),
            Loop(going, body),
        ]
