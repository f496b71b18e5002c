"""The implicit moving particle method: one step as a list of stages, and what carries many steps.

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
import weakref
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import numpy as np
import warp as wp

from .batch import default_threads
from .errors import CapacityError, ConvergenceError, InstabilityError
from .fluid_state import CUTOFF, WIDE, FluidState, flow_numbers, lattice_number
from .interrupts import put_off
from .kernels.conjugate_gradient import AFTER, BEFORE, ITERATIONS, OUTCOME, parallel_solver, serial_solver
from .kernels.mps_lists import list_kernels
from .kernels.mps_literal import LAPLACIAN, literal_kernels
from .kernels.mps_motion import advance_kernel, finish, shift_kernel
from .kernels.mps_operators import divergence_kernel, geometry_kernel, gradient_kernel, momentum_kernel
from .kernels.mps_rigid import rigid_kernels
from .kernels.mps_types import (
    DENSITY,
    FAILED,
    HALTED,
    LOST,
    OVERFLOW,
    PRESSURE,
    STALE,
    STEPS,
    VISCOSITY,
    mps_types,
    span,
)
from .kernels.sums import BLOCK, parallel_scale, serial_scale
from .kernels.threads import barrier
from .memory import SHARE, memory_free
from .stages import Stage

SKIN = 0.1  # of the lists, over the spacing: the column moves as a whole, so lists last for some eighty steps
CORRECTION = 0.2  # share of the density's error that one step takes away
VELOCITY_ERROR = 1e-6  # of the viscosity solve: residual over that which a change by the piston's speed would make
LOOPED = 8  # iterations of a GPU from one look at whether to go on to the next; an even number
HISTORY = 256  # iterations whose residual is kept
GRAPH_STEPS = {"cpu": 8, "cuda": 16}
GRAIN_ARRAYS = ("turn", "middle", "middle_rounding")
"""Of grains, what the next step depends on."""
WHAT = {VISCOSITY: "viscosity", PRESSURE: "pressure", DENSITY: "density"}


class Solve:
    """Working arrays of one system of equations."""

    def __init__(self, count: int, value, partials: int, device) -> None:
        def zeros(n, dtype):
            return wp.zeros(n, dtype=dtype, device=device)

        self.residual, self.direction, self.product = zeros(count, value), zeros(count, value), zeros(count, value)
        self.partial, self.numbers = zeros(partials, wp.float64), zeros(3, wp.float64)
        self.outcome, self.history = zeros(OUTCOME, wp.float64), zeros(HISTORY, wp.float64)
        self.going = zeros(1, wp.int32)


class MovingParticles:
    """Carries a state forward. `threads` (CPU only) each own a range of particles."""

    def __init__(self, state: FluidState, *, threads: int | None = None) -> None:
        scene = state.scene
        self.state, self.scene, self.device = state, scene, state.device
        self.is_cuda = bool(self.device.is_cuda)
        self.scalar = state.scalar
        n = state.count
        self.threads = 1 if self.is_cuda else max(1, min(threads or default_threads(), n // 256))
        self._pool = ThreadPoolExecutor(self.threads) if self.threads > 1 else None
        if self._pool is not None:
            weakref.finalize(self, self._pool.shutdown, wait=False)
        t = mps_types(self.scalar, scene.dimensions)
        device = self.device

        def zeros(dtype, rows=n):
            return wp.zeros(rows, dtype=dtype, device=device)

        self.fluid_inverse, self.whole_inverse = zeros(t.mat), zeros(t.mat)
        self.free = zeros(wp.int32)
        self.inverse_number, self.crowding, self.predicted = (zeros(self.scalar) for _ in range(3))
        self.wall_weight, self.traction = zeros(self.scalar), zeros(self.scalar)
        """Area of wall that a particle stands for over its volume, but for a factor [1/m]; the wall's stress [Pa]."""
        self.viscosity, self.compliance = zeros(self.scalar), zeros(self.scalar)
        """Apparent [Pa s]; velocity from the wall to the particle over the wall's stress [m/s/Pa]."""
        self.diagonal, self.drag = zeros(self.scalar), zeros(self.scalar)
        self.increment, self.potential = zeros(self.scalar), zeros(self.scalar)
        self.moved, self.built = zeros(t.vec), zeros(t.vec)
        self.wall_scale = wp.zeros(1, dtype=wp.float64, device=device)
        self.late = wp.zeros(2, dtype=wp.int32, device=device)
        self.gate = wp.zeros(2, dtype=wp.int32, device=device)
        self.blocks = -(-n // BLOCK)
        partials = 3 * (self.blocks if self.is_cuda else self.threads)
        self.viscous = Solve(n, t.vec, partials, device)
        self.projection = Solve(n, self.scalar, partials, device)
        self.spreading = Solve(n, self.scalar, partials, device)
        self.spreading.residual = self.crowding
        self.points = wp.zeros(n + state.wall_count, dtype=wp.vec3f, device=device)
        self.flow = flow_numbers(state, skin=SKIN, correction=CORRECTION)
        self._room = 1.0
        self._reserve()
        flat = scene.dimensions == 2
        self.grid = wp.HashGrid(64, 1 if flat else 64, 128, device=device)
        self.theory = scene.theory()
        self.time = 0.0
        self.steps = 0
        self.rebuilds = 0
        self.build()

    @property
    def wet_area(self) -> float:
        """Area of the pipe's wall that the column covers [m2], or length [m] of both walls in two dimensions."""
        around = 2.0 if self.scene.dimensions == 2 else 2 * math.pi * self.scene.radius
        return around * self.state.layout.height

    # Lists.

    @property
    def _list_reach(self) -> tuple[float, float]:
        """Of near and of all neighbours [m]."""
        near = LAPLACIAN if self.scene.literal else CUTOFF
        return (near + SKIN) * self.state.layout.spacing, (max(near, WIDE) + SKIN) * self.state.layout.spacing

    def _reserve(self) -> None:
        """Rows of lists for what the lattice has, and as much again in crowds."""
        d = self.scene.dimensions
        ball = math.pi if d == 2 else 4 / 3 * math.pi
        near, whole = (ball * (reach / self.state.layout.spacing) ** d for reach in self._list_reach)
        near, far, wall = (int(self._room * 1.6 * x) + 8 for x in (near, max(whole - near, 4.0), 0.55 * whole))
        n, device = self.state.count, self.device
        self.capacity = near, far, wall
        self._check_memory()
        self.near_count, self.far_count, self.near_wall = (wp.zeros(n, dtype=wp.int32, device=device) for _ in range(3))
        self.near, self.far, self.wall = (wp.zeros(n * c, dtype=wp.int32, device=device) for c in self.capacity)
        self.pair_weight = wp.zeros(n * near, dtype=self.scalar, device=device)
        self.pair_coefficient = wp.zeros(n * near, dtype=self.scalar, device=device)
        self._graphs: dict[int, list[Any]] = {}
        self._stages = None

    def _check_memory(self) -> None:
        """Raise :class:`CapacityError` if the lists will not fit; what else a particle has is a tenth of them."""
        near, far, wall = self.capacity
        size = wp.types.type_size_in_bytes(self.scalar)
        needed = 1.1 * self.state.count * ((4 + 2 * size) * near + 4 * (far + wall))
        free = memory_free(self.device)
        if needed > SHARE * free:
            raise CapacityError(
                f"particles = {self.state.count}: need about {needed / 2**30:.3g} GiB on {self.device}, which has "
                f"{free / 2**30:.3g} GiB free; take a coarser spacing, or a device with more memory"
            )

    def build(self) -> None:
        """Build the lists anew for the places as they are."""
        state = self.state
        place, search = list_kernels(self.scalar, self.scene.dimensions, not self.is_cuda)
        wp.launch(
            place,
            dim=len(self.points),
            inputs=[self.flow, state.position, state.wall_position, self.points, self.built],
            device=self.device,
        )
        self.grid.build(self.points, self._list_reach[1])
        while True:
            near, far, wall = self.capacity
            wp.launch(
                search,
                dim=state.count,
                inputs=[
                    self.flow, *self._list_reach, self.grid.id, near, far, wall, self.points, state.flags,
                    self.near_count, self.near, self.far_count, self.far, self.near_wall, self.wall,
                ],
                device=self.device,
            )  # fmt: skip
            flags = state.flags.numpy()
            over = int(flags[int(OVERFLOW)])
            flags[int(OVERFLOW)] = flags[int(STALE)] = 0
            flags[int(HALTED)] = int(flags[int(FAILED)] != 0)
            state.flags.assign(flags)
            if over == 0:
                break
            self._room *= max(1.25, 1.1 * over / 1000)
            self._reserve()
        self.late.zero_()
        self.rebuilds += 1

    # Stages.

    @property
    def stages(self) -> list[list[Stage]]:
        """Stages of one step, a list for each thread."""
        if self._stages is None:
            rows = [self.state.count * k // self.threads for k in range(self.threads + 1)]
            self._stages = [self._part(k, rows[k], rows[k + 1]) for k in range(self.threads)]
        return self._stages

    def _part(self, part: int, first: int, end: int) -> list[Any]:
        s, scene, d = self.state, self.scene, self.scene.dimensions
        serial, scalar = not self.is_cuda, self.scalar
        two_phase = s.grains is not None
        near, far, wall = self.capacity
        rows = -(-(end - first) // span(serial))
        own = [self.flow, first, end]
        meet = [Stage(barrier, 1, [self.gate, self.threads], self.device)] if self.threads > 1 else []
        lists = [s.flags, self.near_count, self.near]

        def stage(kernel, arguments) -> list[Any]:
            return [Stage(kernel, rows, arguments, self.device), *meet]

        stages = stage(
            geometry_kernel(scalar, d, serial, two_phase),
            [*own, near, far, wall, *lists, self.far_count, self.far, self.near_wall, self.wall, s.group, s.position,
             s.wall_position, s.velocity, s.pressure, self.pair_weight, self.fluid_inverse, self.whole_inverse,
             self.inverse_number, self.free, self.crowding, self.wall_weight, self.viscosity, self.compliance,
             self.predicted],
        )  # fmt: skip
        wanted = self.wet_area / s.layout.volume
        if serial:
            if part == 0:
                alone = serial_scale(scalar)
                stages.append(Stage(alone, 1, [s.count, wanted, self.wall_weight, self.wall_scale], self.device))
            stages += meet
        else:
            gather, divide = parallel_scale(scalar)
            stages.append(self._blocks(gather, [s.count, self.wall_weight, self.viscous.partial]))
            stages.append(self._blocks(divide, [self.blocks, wanted, self.viscous.partial, self.wall_scale], 1))
        weights, source, project = literal_kernels(scalar, d, serial)
        if scene.literal:
            number = lattice_number(d, LAPLACIAN)
            stages += stage(
                weights,
                [*own, near, LAPLACIAN * s.layout.spacing, number, *lists, s.position, self.pair_weight,
                 self.inverse_number, self.predicted],
            )  # fmt: skip
        stages += stage(
            momentum_kernel(scalar, d, serial, two_phase),
            [*own, near, *lists, s.density, s.position, s.velocity, self.pair_weight, self.inverse_number,
             self.fluid_inverse, self.wall_weight, self.wall_scale, self.viscosity, self.compliance, self.predicted,
             self.pair_coefficient, self.diagonal, self.drag, self.traction, self.viscous.residual],
        )  # fmt: skip
        size = math.sqrt(s.count)
        rate = scene.concrete.density / scene.time_step
        stages += self._solve(
            self.viscous,
            True,
            VISCOSITY,
            s.velocity,
            part,
            first,
            end,
            0.0,
            VELOCITY_ERROR * rate * scene.velocity * size,
        )
        stages += stage(
            source,
            [*own, near, wall, *lists, self.near_wall, self.wall, self.free, s.position, s.wall_position, s.velocity,
             self.pair_weight, self.pair_coefficient, self.diagonal, self.projection.residual, self.increment],
        ) if scene.literal else stage(
            divergence_kernel(scalar, d, serial, two_phase),
            [*own, near, wall, *lists, self.near_wall, self.wall, s.density, self.free, s.position, s.wall_position,
             s.velocity, self.pair_weight, self.inverse_number, self.whole_inverse, self.pair_coefficient,
             self.diagonal, self.projection.residual, self.increment, self.potential],
        )  # fmt: skip
        stages += self._solve(
            self.projection, False, PRESSURE, self.increment, part, first, end, scene.tolerance,
            1e-4 * scene.tolerance * rate * scene.velocity / scene.radius * size,
        )  # fmt: skip
        stages += stage(
            project,
            [*own, near, wall, *lists, self.near_wall, self.wall, s.position, s.wall_position, self.increment,
             s.velocity, s.pressure],
        ) if scene.literal else stage(
            gradient_kernel(scalar, d, serial, two_phase),
            [*own, near, *lists, s.density, s.position, self.pair_weight, self.fluid_inverse, self.predicted,
             self.increment, s.velocity, s.pressure],
        )  # fmt: skip
        if not scene.literal:
            stages += self._solve(self.spreading, False, DENSITY, self.potential, part, first, end, 0.1, 1e-7 * size)
            stages += stage(
                shift_kernel(scalar, d, serial),
                [*own, near, *lists, s.position, self.pair_weight, self.fluid_inverse, self.potential, self.moved],
            )
        velocities, places = rigid_kernels(scalar, d)
        g = s.grain_arrays
        if two_phase and part == 0:
            arguments = [self.flow, s.flags, g["first"], s.position, s.velocity, self.moved, g["spin"], g["step"]]
            stages.append(Stage(velocities, g["count"], arguments, self.device))
        if two_phase:
            stages += meet
        stages += stage(
            advance_kernel(scalar, d, serial),
            [*own, 1.5 * s.layout.height, s.flags, s.velocity, self.moved, self.built, s.rounding, s.position,
             self.late],
        )  # fmt: skip
        if two_phase and part == 0:
            arguments = [
                self.flow, s.flags, g["first"], g["offset"], g["step"], g["spin"], g["middle"], g["middle_rounding"],
                g["turn"], s.position,
            ]  # fmt: skip
            stages.append(Stage(places, g["count"], arguments, self.device))
        if two_phase:
            stages += meet
        if part == 0:
            stages.append(Stage(finish, 1, [s.flags, self.late], self.device))
        return stages + meet

    def _blocks(self, kernel, arguments: list[Any], blocks: int | None = None) -> Stage:
        stage = Stage(kernel, BLOCK * (self.blocks if blocks is None else blocks), arguments, self.device)
        stage.block = BLOCK
        return stage

    def _solve(
        self, solve: Solve, vector: bool, what: int, x, part: int, first: int, end: int, tolerance: float, enough: float
    ) -> list[Any]:
        s, d = self.state, self.scene.dimensions
        near, most = self.capacity[0], self.scene.most_iterations
        matrix = [self.near_count, self.near, s.position, self.free, self.pair_coefficient, self.diagonal, self.drag]
        if not self.is_cuda:
            kernel = serial_solver(self.scalar, d, vector)
            arguments = [
                self.flow, part, self.threads, first, end, near, what, tolerance, enough, most, self.gate, s.flags,
                *matrix, solve.residual, solve.direction, solve.product, x, solve.partial, solve.outcome,
                solve.history,
            ]  # fmt: skip
            return [Stage(kernel, 1, arguments, self.device)]
        begin, ready, multiply, update, direct = parallel_solver(self.scalar, d, vector)
        diagonal = [self.free, self.diagonal, self.drag]
        b, r, p, q, numbers = self.blocks, solve.residual, solve.direction, solve.product, solve.numbers
        going, partial = solve.going, solve.partial
        body = []
        for now in (0, 1) * (LOOPED // 2):
            body += [
                self._blocks(multiply, [self.flow, b, near, *matrix, going, p, q, partial]),
                self._blocks(update, [self.flow, b, now, *diagonal, going, numbers, p, q, r, x, partial]),
                self._blocks(
                    direct,
                    [self.flow, b, now, most, what, s.flags, partial, going, numbers, p, q, solve.outcome,
                     solve.history],
                ),
            ]  # fmt: skip
        return [
            self._blocks(begin, [self.flow, b, *diagonal, r, p, partial]),
            self._blocks(ready, [b, tolerance, enough, s.flags, partial, numbers, solve.outcome, going], 1),
            Loop(going, body),
        ]

    # Stepping.

    def advance(self, steps: int) -> None:
        """Take steps. Raises :class:`ConvergenceError` or :class:`InstabilityError`."""
        goal = self.steps + steps
        while self.steps < goal:
            count = goal - self.steps
            largest = GRAPH_STEPS["cuda" if self.is_cuda else "cpu"]
            sizes = [largest] * min(count // largest, 4) or [1 << (count.bit_length() - 1)]
            self._replay(sizes)
            flags = self.state.flags.numpy()
            self.steps = int(flags[int(STEPS)])
            self.time = self.steps * self.scene.time_step
            if flags[int(FAILED)]:
                self._fail(int(flags[int(FAILED)]))
            if flags[int(STALE)]:
                self.build()

    def _fail(self, what: int) -> None:
        if what == LOST:
            raise InstabilityError(
                f"t = {self.time:.6g} s: a particle left the column or is not a number; usual cure: a smaller time step"
            )
        solve = {VISCOSITY: self.viscous, PRESSURE: self.projection, DENSITY: self.spreading}[what]
        outcome = solve.outcome.numpy()
        count = int(outcome[int(ITERATIONS)])
        history = [float(outcome[int(BEFORE)]), *map(float, solve.history.numpy()[:count])]
        raise ConvergenceError(
            self.time, WHAT[what], count, history, float(outcome[int(AFTER)]), self.scene.most_iterations
        )

    def memory(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """All that the next step depends on: arrays and numbers."""
        arrays = {name: getattr(self.state, name).numpy() for name in FluidState.PARTICLE_ARRAYS}
        # The lists are those of the places for which they were built: sums keep their order.
        arrays |= {"built": self.built.numpy(), "flags": self.state.flags.numpy(), "late": self.late.numpy()}
        grains = self.state.grain_arrays
        arrays |= {f"grain_{name}": grains[name].numpy() for name in GRAIN_ARRAYS if grains}
        return arrays, {"steps": self.steps, "rebuilds": self.rebuilds}

    def restore(self, arrays: dict[str, np.ndarray], numbers: dict[str, Any]) -> None:
        """Go on from a `memory`."""
        state = self.state
        state.position.assign(arrays["built"])
        self.build()
        for name in FluidState.PARTICLE_ARRAYS:
            getattr(state, name).assign(arrays[name])
        state.flags.assign(arrays["flags"])
        self.late.assign(arrays["late"])
        for name in GRAIN_ARRAYS if state.grain_arrays else ():
            state.grain_arrays[name].assign(arrays[f"grain_{name}"])
        self.steps, self.rebuilds = int(numbers["steps"]), int(numbers["rebuilds"])
        self.time = self.steps * self.scene.time_step

    def outcomes(self) -> dict[str, dict[str, float]]:
        """Iterations and residuals of each solve in the last step."""
        found = {}
        for what, solve in ((VISCOSITY, self.viscous), (PRESSURE, self.projection), (DENSITY, self.spreading)):
            outcome = solve.outcome.numpy()
            found[WHAT[what]] = {
                "iterations": float(outcome[int(ITERATIONS)]),
                "before": float(outcome[int(BEFORE)]),
                "after": float(outcome[int(AFTER)]),
            }
        return found

    def _replay(self, sizes: list[int]) -> None:
        for size in set(sizes) - set(self._graphs):
            self._graphs[size] = self._capture(size)

        def replay(part: int) -> None:
            for size in sizes:
                wp.capture_launch(self._graphs[size][part])

        if self._pool is None:
            replay(0)
            return
        # All threads must set out, or those that did wait for ever at the first barrier.
        with put_off():
            running = [self._pool.submit(replay, part) for part in range(self.threads)]
            wait(running)
        for one in running:
            one.result()

    def _capture(self, size: int) -> list[Any]:
        for part in self.stages:
            for stage in part:
                for one in stage.body if isinstance(stage, Loop) else [stage]:
                    wp.load_module(one.kernel.module, device=self.device, block_dim=one.block)
        graphs = []
        for part in self.stages:
            with wp.ScopedCapture(device=self.device) as capture:
                for _ in range(size):
                    for stage in part:
                        stage()
            graphs.append(capture.graph)
        return graphs


class Loop:
    """Stages that repeat on the device while a flag is set (CUDA)."""

    def __init__(self, condition, body: list[Stage]) -> None:
        self.condition, self.body = condition, body

    def __call__(self) -> None:
        for stage in self.body:
            stage.record()
        wp.capture_while(self.condition, self._once)

    def _once(self) -> None:
        for stage in self.body:
            stage()
