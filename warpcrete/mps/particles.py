"""The implicit moving particle method: what carries a state forward, its lists and working arrays.

What a step is made of stands in `stages.py`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp

from ..core.device import MEMORY_FRACTION, default_threads, memory_free, parallel
from ..core.errors import CapacityError
from ..core.launching import Launcher, Size, Stage, Step, launch, parameter_names
from ..kernels.common.control import FAILED, HALTED, OVERFLOW, STALE
from ..kernels.common.reductions import BLOCK
from ..kernels.mps.conjugate_gradient import OUTCOME
from ..kernels.mps.lists import list_kernels
from ..kernels.mps.paper_scheme import LAPLACIAN
from ..kernels.mps.structs import DENSITY, PRESSURE, VISCOSITY
from .coarse import LEAST, WIDTH, CoarseGrid
from .stages import step_by_one_thread, step_stages
from .state import CUTOFF, WIDE, FluidState, flow_numbers
from .stepping import Stepping

SKIN = 0.1  # of the lists, over the spacing: the column moves as a whole, so lists last for some eighty steps
CORRECTION = 0.2  # part of the density's error that one step takes away
HISTORY = 256  # iterations whose residual is kept


class MovingParticles(Stepping):
    """Carries a state forward. `threads` (CPU only) each own a range of particles.

    Its arrays, with meaning, unit and shape, are those of the structs in `kernels/mps/structs.py`.
    """

    flags: wp.array
    """The state's."""
    particles: Any
    """The state's struct `Particles`."""
    lists: Any
    """Neighbours, a struct `Lists`."""
    fields: Any
    """Working arrays of a step, a struct `Fields`."""
    matrix: Any
    """Of the equations that are solved, a struct `Matrix`."""
    viscous: Any
    """System of the velocities, a struct `Solve` of vectors."""
    projection: Any
    """System of the pressure's increment, a struct `Solve` of numbers."""
    shifting: Any
    """System of what moves particles off crowds, likewise; its residual is the density's error."""

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
        self.lists = self.structs.Lists()
        self.lists.wall_position = self._array(self.structs.Lists, "wall_position", state.layout.wall)
        self.points = wp.zeros(self.count + len(state.layout.wall), dtype=wp.vec3f, device=self.device)
        """Where all particles are, for the grid, shape (n + wall particles,) [m]."""
        self.flow = flow_numbers(state, skin=SKIN, correction=CORRECTION)
        self._room = 1.0
        self._step: Step | None = None
        self._reserve()
        flat = scene.dimensions == 2
        self.grid = wp.HashGrid(64, 1 if flat else 64, 128, device=self.device)
        self.theory = scene.theory()
        self.time = 0.0
        self.steps = 0
        self.rebuilds = 0
        self.build()

    def _array(self, struct: Any, name: str, value: Any) -> wp.array:
        """Array of a struct: host data, or a shape for zeros."""
        dtype = struct.vars[name].type.dtype
        if isinstance(value, int):
            return wp.zeros(value, dtype=dtype, device=self.device)
        return wp.array(value, dtype=dtype, device=self.device)

    def _fields(self) -> Any:
        """Working arrays, but for those that go with the lists."""
        struct = self.structs.Fields
        fields = struct()
        sizes = {"wall_scale": 1, "late": 2, "pair_weight": 0}
        for name in struct.vars:
            setattr(fields, name, self._array(struct, name, sizes.get(name, self.count)))
        return fields

    def _matrix(self) -> Any:
        """Coefficients of the equations that are solved, but for what goes with the lists."""
        struct = self.structs.Matrix
        matrix = struct()
        for name in ("diagonal", "drag", "free"):
            setattr(matrix, name, self._array(struct, name, self.count))
        matrix.position = self.particles.position
        if self.grains is not None:
            assert self.state.grains is not None
            matrix.bound, matrix.grains = int(self.state.grains.first[-1]), self.grains
        if self.coarse is not None:
            matrix.coarse = self.coarse.arrays
        return matrix

    def _coarse(self) -> CoarseGrid | None:
        """That of the solves; rigid grains, which are larger than its cubes, and the printed scheme have none."""
        layout, reach = self.state.layout, self._list_reach[0]
        if self.grains is not None or self.scene.paper_scheme or layout.height < LEAST * WIDTH * layout.spacing:
            return None
        return CoarseGrid(self.structs, self.scalar, layout, self.scene.radius, reach, self.device)

    def _solve(self, struct: Any) -> Any:
        """Working arrays of one system of equations."""
        solve = struct()
        bodies = 0 if self.state.grains is None else self.state.grains.count
        cubes = 0 if self.coarse is None else self.coarse.count
        sizes = {
            "load": cubes, "lift": 2 * cubes, "change": cubes, "inner": cubes,
            "partial": 3 * (self.blocks + -(-bodies // BLOCK) if self.parallel else self.threads), "outcome": OUTCOME,
            "least": 1, "history": HISTORY, "direction": self.count * (2 if self.parallel else 1),
            "preconditioned": self.count if self.parallel else 0,
        }  # fmt: skip
        for name in struct.vars:
            setattr(solve, name, self._array(struct, name, sizes.get(name, self.count)))
        return solve

    @property
    def counts(self) -> dict[str, int]:
        """Of what it consists of."""
        return {"particles": self.count, "wall particles": len(self.points) - self.count}

    @property
    def holdings(self) -> dict[str, Any]:
        """What holds its memory, by part."""
        solves = self.viscous, self.projection, self.shifting
        return {"particles": self.particles, "neighbours": self.lists, "matrix": self.matrix, "solves": solves}

    @property
    def wet_area(self) -> float:
        """Area of the pipe's wall that the column covers [m2], or length [m] of both walls in two dimensions."""
        around = 2.0 if self.scene.dimensions == 2 else 2 * math.pi * self.scene.radius
        return around * self.state.layout.height

    # Lists.

    @property
    def _list_reach(self) -> tuple[float, float]:
        """Of near and of all neighbours [m]."""
        near = LAPLACIAN if self.scene.paper_scheme else CUTOFF
        return (near + SKIN) * self.state.layout.spacing, (max(near, WIDE) + SKIN) * self.state.layout.spacing

    def _reserve(self) -> None:
        """Rows of lists for what the lattice has, and more than half as much again for crowds."""
        d, n = self.scene.dimensions, self.count
        ball = math.pi if d == 2 else 4 / 3 * math.pi
        near, whole = (ball * (reach / self.state.layout.spacing) ** d for reach in self._list_reach)
        near, far, wall = (int(self._room * 1.6 * x) + 8 for x in (near, max(whole - near, 4.0), 0.55 * whole))
        self._check_memory(near, far, wall)
        for name, capacity in (("near", near), ("far", far), ("wall", wall)):
            setattr(self.lists, f"{name}_capacity", capacity)
            setattr(self.lists, f"{name}_count", self._array(self.structs.Lists, f"{name}_count", n))
            setattr(self.lists, name, self._array(self.structs.Lists, name, n * capacity))
        self.fields.pair_weight = self._array(self.structs.Fields, "pair_weight", n * near)
        self.matrix.coefficient = self._array(self.structs.Matrix, "coefficient", n * near)
        for name in ("near_capacity", "near_count", "near"):
            setattr(self.matrix, name, getattr(self.lists, name))
        self._launcher.invalidate_graphs()
        self._step = None

    def _check_memory(self, near: int, far: int, wall: int) -> None:
        """Raise :class:`CapacityError` if the lists will not fit; what else a particle has is a tenth of them."""
        size = wp.types.type_size_in_bytes(self.scalar)
        needed = 1.1 * self.count * ((4 + 2 * size) * near + 4 * (far + wall))
        free = memory_free(self.device)
        if needed > MEMORY_FRACTION * free:
            raise CapacityError(
                f"particles = {self.count}: need about {needed / 2**30:.3g} GiB on {self.device}, which has "
                f"{free / 2**30:.3g} GiB free; use a coarser spacing, or a device with more memory"
            )

    def build(self) -> None:
        """Build the lists anew for the places as they are."""
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
            self._room *= max(1.25, 1.1 * over / 1000)
            self._reserve()
        self.fields.late.zero_()
        self.rebuilds += 1

    # Stepping.

    def stage(self, kernel: Any, dim: Size, *, block: int | None = None, **named: Any) -> Stage:
        """A launch of a kernel; parameters that are not `named` are the attributes of the same names."""
        for name in parameter_names(kernel):
            if name not in named:
                named[name] = getattr(self, name)
        return Stage(kernel, dim, named, self.device, block=block)

    @property
    def step(self) -> Step:
        """Stages of one step on the arrays that there are now, a list for each thread."""
        if self._step is None:
            self._step = step_stages(self)
        return self._step

    def _alone(self) -> Step:
        return step_by_one_thread(self)

    def solves(self) -> dict[int, Any]:
        """Working arrays of its solves, by what they solve for."""
        return {VISCOSITY: self.viscous, PRESSURE: self.projection, DENSITY: self.shifting}

    def state_arrays(self) -> dict[str, np.ndarray]:
        """Arrays that the next step depends on.

        The lists are those of the places for which they were built, so that sums keep their order.
        """
        lists = {"built": self.fields.built.numpy(), "late": self.fields.late.numpy()}
        return self.state.state_dict() | lists

    def state_dict(self) -> dict[str, Any]:
        """All that the next step depends on."""
        return {"arrays": self.state_arrays(), "numbers": {"steps": self.steps, "rebuilds": self.rebuilds}}

    def load_state_dict(self, found: dict[str, Any]) -> None:
        """Go on from a `state_dict`."""
        arrays, numbers = found["arrays"], found["numbers"]
        self.particles.position.assign(arrays["built"])
        self.build()
        self.state.load_state_dict(arrays)
        self.fields.late.assign(arrays["late"])
        self.steps, self.rebuilds = int(numbers["steps"]), int(numbers["rebuilds"])
        self.time = self.steps * self.scene.time_step
