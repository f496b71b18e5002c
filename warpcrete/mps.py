"""The implicit moving particle method: what carries a state forward, its lists and working arrays.

What a step is made of stands in `mps_stages.py`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp

from .errors import CapacityError, ConvergenceError, InstabilityError
from .fluid_state import CUTOFF, WIDE, FluidState, flow_numbers
from .kernels.conjugate_gradient import AFTER, BEFORE, ITERATIONS, OUTCOME
from .kernels.mps_lists import list_kernels
from .kernels.mps_literal import LAPLACIAN
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
)
from .kernels.sums import BLOCK
from .launching import Launcher, Step, default_threads, graph_sizes
from .memory import SHARE, memory_free
from .mps_stages import step_stages
from .spine import Course

SKIN = 0.1  # of the lists, over the spacing: the column moves as a whole, so lists last for some eighty steps
CORRECTION = 0.2  # share of the density's error that one step takes away
HISTORY = 256  # iterations whose residual is kept
LARGEST_GRAPH = {"cpu": 8, "cuda": 16}
LAUNCH = 4  # largest graphs from one look at the flags to the next
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
        self._launcher = Launcher(self.threads, self.device)
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
        """Rows of lists for what the lattice has, and more than half as much again for crowds."""
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
        self._launcher.void()
        self._stages: Step | None = None

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

    # Stepping.

    @property
    def stages(self) -> Step:
        """Stages of one step, a list for each thread."""
        if self._stages is None:
            self._stages = step_stages(self)
        return self._stages

    def advance(self, steps: int) -> None:
        """Take steps. Raises :class:`ConvergenceError` or :class:`InstabilityError`."""
        goal = self.steps + steps
        while self.steps < goal:
            count = goal - self.steps
            largest = LARGEST_GRAPH["cuda" if self.is_cuda else "cpu"]
            sizes = graph_sizes(min(count, LAUNCH * largest), largest)
            self._launcher.replay(self.stages, sizes, lambda: bool(self.state.flags.numpy()[int(HALTED)]))
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

    def advancing(self, until: float) -> Course:
        """Course: whole steps up to the one that ends nearest to `until` [s]."""
        self.advance(math.floor(until / self.scene.time_step + 0.5) - self.steps)
        yield from ()

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
