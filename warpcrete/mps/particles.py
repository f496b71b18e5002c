"""Solver of the implicit moving particle method, with its neighbour lists and working arrays.

The module `stages.py` contains the stages of a time step.
"""

import math
from typing import Any

import numpy as np
import warp as wp

from ..core.device.arrays import host_copy
from ..core.device.device import MEMORY_FRACTION, default_threads, memory_free, parallel
from ..core.device.launching import Arguments, Launcher, Step, launch
from ..core.errors import CapacityError
from ..core.records import SavedState
from ..kernels.common.control import FAILED, HALTED, OVERFLOW, STALE
from ..kernels.common.reductions import BLOCK
from ..kernels.mps.conjugate_gradient import OUTCOME
from ..kernels.mps.lists import list_kernels
from ..kernels.mps.structs import DENSITY, PRESSURE, VISCOSITY
from .coarse import LEAST, WIDTH, CoarseGrid
from .common.allocation import allocate
from .common.stepping import Stepping
from .stages import step_by_one_thread, step_stages
from .state import DENSITY_REACH, OPERATOR_REACH, FluidState, flow_numbers

# Skin of the neighbour lists, in particle spacings: the lists contain all pairs up to the range of the differential
# operators plus this skin. Positions are relative to the piston and change slowly, so lists last about eighty steps.
SKIN = 0.1
# Fraction of the density error that one step removes. The density error is the relative excess of a particle's density
# sum.
CORRECTION = 0.2
HISTORY = 256  # Maximum number of iterations whose residuals a solve stores.


class MovingParticles(Stepping):
    """Object that advances the particles of a flow in time; on a CPU, each thread works on its own range of particles.

    The structs in `kernels/mps/structs.py` give meaning, unit and shape of the arrays.
    """

    flags: wp.array
    """Control flags of the flow on the device, such as the number of completed steps, shape (FLAGS,)."""
    particles: Any
    """Position, velocity and pressure of each fluid particle: arrays in a struct `Particles`."""
    lists: Any
    """Neighbour lists, which hold the numbers of the particles near each particle, in a struct `Lists`."""
    fields: Any
    """Working arrays of a time step, such as the apparent viscosity at each particle, in a struct `Fields`."""
    matrix: Any
    """Coefficients of the linear systems, with one row for each particle, in a struct `Matrix`."""
    viscous: Any
    """Linear system for the velocities of the particles, a struct `Solve` whose unknowns are vectors."""
    projection: Any
    """Linear system for the increment of the pressure in a step, a struct `NumberSolve`."""
    shifting: Any
    """Linear system whose solution moves particles out of crowded regions, a struct `NumberSolve`. The solve starts
    with the density error of each particle, times the fraction CORRECTION, as the residual."""

    def __init__(self, state: FluidState, *, threads: int | None = None) -> None:
        scene = state.scene
        self.state, self.scene, self.device = state, scene, state.device
        self.parallel = parallel(self.device)
        self.scalar, self.structs = state.scalar, state.structs
        self.count = state.count
        self.threads = 1 if self.parallel else max(1, min(threads or default_threads(), self.count // 256))
        self._launcher = Launcher(self.threads, self.device)
        self.flags, self.particles, self.grains = state.flags, state.particles, state.grain_arrays
        self.blocks = -(-self.count // BLOCK)
        self.gate, self.barrier = self._launcher.gate, self._launcher.barrier
        self.fields = self._fields()
        self.coarse = self._coarse()
        self.matrix = self._matrix()
        self.viscous = self._solve(self.structs.VectorSolve)
        self.projection = self._solve(self.structs.NumberSolve)
        self.shifting = self._solve(self.structs.NumberSolve)
        self.lists = allocate(self.structs.Lists, self.device, wall_position=state.layout.wall)
        self.points = wp.zeros(self.count + len(state.layout.wall), dtype=wp.vec3f, device=self.device)
        """Positions of fluid and wall particles for the hash grid [m], shape (n + wall particles,)."""
        self.flow = flow_numbers(state, skin=SKIN, correction=CORRECTION)
        self._list_capacity_factor = 1.0
        self._step: Step | None = None
        self._reserve()
        flat = scene.dimensions == 2
        self.grid = wp.HashGrid(64, 1 if flat else 64, 128, device=self.device)
        self.theory = scene.theory()
        self.time = 0.0
        self.steps = 0
        self.rebuilds = 0
        self.build()

    def _fields(self) -> Any:
        """Return the working arrays, except for those whose sizes depend on the neighbour lists."""
        struct = self.structs.Fields
        sizes = dict.fromkeys(struct.vars, self.count) | {"wall_scale": 1, "event_flags": 2, "pair_weight": 0}
        return allocate(struct, self.device, **sizes)

    def _matrix(self) -> Any:
        """Allocate the coefficients of the linear systems, without the arrays that are as long as neighbour lists."""
        struct = self.structs.Matrix
        sizes = dict.fromkeys(("diagonal", "drag", "free"), self.count)
        matrix = allocate(struct, self.device, **sizes)
        matrix.position = self.particles.position
        if self.grains is not None:
            assert self.state.grains is not None
            matrix.grain_rows, matrix.grains = int(self.state.grains.first[-1]), self.grains
        if self.coarse is not None:
            matrix.coarse = self.coarse.arrays
        return matrix

    def _coarse(self) -> CoarseGrid | None:
        """Return the coarse grid of cubes that preconditions the linear solves, or None if it would save no time.

        The result is None for flows with rigid grains, which are larger than the cubes. It is also None for short
        columns of concrete, for which the diagonal preconditioner is as fast.
        """
        layout, reach = self.state.layout, self._list_reach[0]
        if self.grains is not None or layout.height < LEAST * WIDTH * layout.spacing:
            return None
        return CoarseGrid(self.structs, layout, self.scene.radius, reach, self.device)

    def _solve(self, struct: Any) -> Any:
        """Return new working arrays for the solve of one linear system."""
        bodies = 0 if self.state.grains is None else self.state.grains.count
        cubes = 0 if self.coarse is None else self.coarse.count
        sizes = {
            "load": cubes, "lift": 2 * cubes, "change": cubes, "inner": cubes,
            "partial": 3 * (self.blocks + -(-bodies // BLOCK) if self.parallel else self.threads), "outcome": OUTCOME,
            "stop_norm": 1, "history": HISTORY, "direction": self.count * (2 if self.parallel else 1),
            "preconditioned": self.count if self.parallel else 0,
        }  # fmt: skip
        return allocate(struct, self.device, **dict.fromkeys(struct.vars, self.count) | sizes)

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of fluid particles and of wall particles."""
        return {"particles": self.count, "wall particles": len(self.points) - self.count}

    @property
    def holdings(self) -> dict[str, Any]:
        """Objects that hold the flow's device arrays; the keys name them in a forecast, which states their memory."""
        solves = self.viscous, self.projection, self.shifting
        return {"particles": self.particles, "neighbours": self.lists, "matrix": self.matrix, "solves": solves}

    @property
    def wet_area(self) -> float:
        """Area of the pipe's wall that concrete covers [m2]; in two dimensions, the length of both walls [m]."""
        around = 2.0 if self.scene.dimensions == 2 else 2 * math.pi * self.scene.radius
        return around * self.state.layout.height

    # The following methods build the neighbour lists.

    @property
    def _list_reach(self) -> tuple[float, float]:
        """Ranges of the neighbour lists, including the skin [m], for differential operators and for the density sum."""
        return (OPERATOR_REACH + SKIN) * self.state.layout.spacing, (DENSITY_REACH + SKIN) * self.state.layout.spacing

    def _reserve(self) -> None:
        """Allocate neighbour lists with room for 1.6 times as many neighbours as in the initial lattice.

        The additional room is for crowded regions. If a list still overflows, `build` allocates longer lists.
        """
        d, n = self.scene.dimensions, self.count
        ball = math.pi if d == 2 else 4 / 3 * math.pi
        near, whole = (ball * (reach / self.state.layout.spacing) ** d for reach in self._list_reach)
        near, far, wall = (
            int(self._list_capacity_factor * 1.6 * x) + 8 for x in (near, max(whole - near, 4.0), 0.55 * whole)
        )
        self._check_memory(near, far, wall)
        for name, capacity in (("near", near), ("far", far), ("wall", wall)):
            setattr(self.lists, f"{name}_capacity", capacity)
            allocate(self.structs.Lists, self.device, self.lists, **{f"{name}_count": n, name: n * capacity})
        allocate(self.structs.Fields, self.device, self.fields, pair_weight=n * near)
        allocate(self.structs.Matrix, self.device, self.matrix, coefficient=n * near)
        for name in ("near_capacity", "near_count", "near"):
            setattr(self.matrix, name, getattr(self.lists, name))
        self._launcher.invalidate_graphs()
        self._step = None

    def _check_memory(self, near: int, far: int, wall: int) -> None:
        """Raise :class:`CapacityError` if the neighbour lists do not fit in the free memory of the device.

        `near`, `far` and `wall` are the numbers of entries of the three lists of a particle. The estimate adds a tenth
        for all other arrays of the particles.
        """
        size = wp.types.type_size_in_bytes(self.scalar)
        needed = 1.1 * self.count * ((4 + 2 * size) * near + 4 * (far + wall))
        free = memory_free(self.device)
        if needed > MEMORY_FRACTION * free:
            raise CapacityError(
                f"particles = {self.count}: need about {needed / 2**30:.3g} GiB on {self.device}, which has "
                f"{free / 2**30:.3g} GiB free; use a coarser spacing, or a device with more memory"
            )

    def build(self) -> None:
        """Rebuild the neighbour lists at the current positions, and allocate longer lists if one overflows.

        The lists contain all pairs within a range plus a skin, so they stay valid until a particle has moved by about
        half the skin relative to the piston.
        """
        place, search = list_kernels(self.scalar, self.scene.dimensions, not self.parallel)
        near_reach, whole_reach = self._list_reach
        launch(
            place, len(self.points), self.device, flow=self.flow, particles=self.particles, lists=self.lists,
            points=self.points, fields=self.fields,
        )  # fmt: skip
        self.grid.build(self.points, whole_reach)
        if self.coarse is not None:
            self.coarse.gather(self.particles.position.numpy())
        while True:
            launch(
                search, self.count, self.device, flow=self.flow, near_reach=near_reach, whole_reach=whole_reach,
                grid=self.grid.id, points=self.points, flags=self.flags, lists=self.lists,
            )  # fmt: skip
            flags = self.flags.numpy()
            over = int(flags[int(OVERFLOW)])
            flags[int(OVERFLOW)] = flags[int(STALE)] = 0
            flags[int(HALTED)] = int(flags[int(FAILED)] != 0)
            self.flags.assign(flags)
            if over == 0:
                break
            self._list_capacity_factor *= max(1.25, 1.1 * over / 1000)
            self._reserve()
        self.fields.event_flags.zero_()
        self.rebuilds += 1

    # The following methods provide the stages of a step and the state for checkpoints.

    @property
    def _kernel_arrays(self) -> Arguments:
        return {
            "flags": self.flags,
            "flow": self.flow,
            "particles": self.particles,
            "grains": self.grains,
            "fields": self.fields,
            "lists": self.lists,
            "points": self.points,
            "matrix": self.matrix,
            "viscous": self.viscous,
            "projection": self.projection,
            "shifting": self.shifting,
            "gate": self.gate,
            "count": self.count,
            "blocks": self.blocks,
        }

    @property
    def step(self) -> Step:
        """Stages of one time step (kernel launches and barriers) with the current arrays, one list for each thread."""
        if self._step is None:
            self._step = step_stages(self)
        return self._step

    def _single_thread_step(self) -> Step:
        return step_by_one_thread(self)

    def solves(self) -> dict[int, Any]:
        return {VISCOSITY: self.viscous, PRESSURE: self.projection, DENSITY: self.shifting}

    def state_arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays on which the next step depends.

        The arrays include the positions at which the neighbour lists were last built. A restored flow rebuilds the
        lists from these positions, so their order and the bits of all sums are the same.
        """
        lists = {"built": host_copy(self.fields.position_at_build), "late": host_copy(self.fields.event_flags)}
        return self.state.state_dict() | lists

    def state_dict(self) -> SavedState:
        """Return the arrays and numbers that a checkpoint needs to continue the flow at the next step."""
        return {"arrays": self.state_arrays(), "numbers": {"steps": self.steps, "rebuilds": self.rebuilds}}

    def load_state_dict(self, found: SavedState) -> None:
        """Restore the flow from a `state_dict`, with the same neighbour lists."""
        arrays, numbers = found["arrays"], found["numbers"]
        self.particles.position.assign(arrays["built"])
        self.build()
        self.state.load_state_dict(arrays)
        self.fields.event_flags.assign(arrays["late"])
        self.steps, self.rebuilds = int(numbers["steps"]), int(numbers["rebuilds"])
        self.time = self.steps * self.scene.time_step
