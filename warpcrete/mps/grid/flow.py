"""Flow on a grid through which particles carry the concrete.

A step has four parts. Particles bring their velocities to the faces of the cells (affine particle-in-cell, Jiang et al.
2015). An implicit solve changes these velocities by viscosity, walls, pressure and weight. An increment of the pressure
removes their divergence. Particles take their velocity from the grid and move with it.

The length of steps may adapt to the flow. The equations do not depend on how the particles are arranged, so concrete
can be sheared without limit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from ...core.device.device import parallel
from ...core.device.launching import Launcher, Stage, Step, launch, parameter_names
from ...kernels.common.control import HALTED
from ...kernels.common.reductions import BLOCK
from ...kernels.mps.conjugate_gradient import (
    OUTCOME,
    serial_solver,
)
from ...kernels.mps.grid.bins import bin_kernels, lift_kernel
from ...kernels.mps.grid.cells import NOW, WANTED
from ...kernels.mps.grid.filling import fill_kernel
from ...kernels.mps.grid.forces import momentum_kernel, viscosity_kernels
from ...kernels.mps.grid.pace import Pace, clock_kernels, speed_kernels
from ...kernels.mps.grid.pressure import crowd_kernels, drive_kernels, pressure_kernels
from ...kernels.mps.grid.structure import break_kernel
from ...kernels.mps.grid.transfer import advect_kernel, extend_kernel, gather_kernel
from ...kernels.mps.grid.walls import side_kernel, wall_kernel
from ...kernels.mps.resident_solver import resident_blocks, resident_solver
from ...kernels.mps.structs import DENSITY, PRESSURE, VISCOSITY, array_structs, flow_struct
from ..allocation import allocate
from ..stages import ABSOLUTE_PRESSURE_FACTOR, VELOCITY_ERROR
from ..stepping import Stepping
from .state import GridState, grid_numbers

HISTORY = 256  # Maximum number of iterations of a solve of which the residual norms are kept.
ROUNDING = {"float32": 1e-6, "float64": 1e-14}  # Relative rounding error of the net flow into a cell, by precision.
EXTRAPOLATED_CELLS = 3  # Number of cells beyond the concrete, in air and walls, to which velocities are extrapolated.
# Two tolerances of the solve that moves crowded particles apart. The first is relative to the initial residual. The
# second is relative to the residual that displaces the volume of a whole cell in one step.
DISPERSION_TOLERANCES = 0.1, 1e-5
MIN_RELATIVE_SPEED = 0.05
"""Minimum speed, relative to the typical speed of the flow, to which the error of a step is compared."""
UNREACHABLE_STEPS = 2**31 - 1  # Number of steps that no run ever reaches.


@dataclass(frozen=True)
class System:
    """Linear system with a row for each face or for each cell of the grid."""

    rows: int
    matrix: Any
    """Coefficients of the system, a struct `Matrix`."""
    arrays: Any
    """Working arrays of the solve, a struct `Solve` whose arrays hold one number per row."""
    numbers: Any
    """Struct `FlowConstants`, of which the solve reads only the number of rows."""


class GridFlow(Stepping):
    """Flow on a grid, which advances its state in time."""

    next_step: float
    """Length of the next step [s], unless the step must end earlier to meet the goal."""
    threads = 1
    """Number of CPU threads that work on the flow."""
    rebuilds = 0
    """Number of rebuilds of neighbour lists; always zero, because a grid needs no lists."""

    def __init__(self, state: GridState) -> None:
        scene = state.scene
        self.state, self.scene, self.device = state, scene, state.device
        self.parallel = parallel(self.device)
        self.scalar, self.count = state.scalar, state.count
        self.flags, self.particles, self.mesh, self.walls = state.flags, state.particles, state.mesh, state.walls
        self.geometry, self.solid_after = state.geometry, state.solid_after
        self.g = grid_numbers(state)
        self._launcher = Launcher(1, self.device)
        self.full = state.layout.full or state.layout.periodic
        kind, faces = state.layout.kind, state.layout.axes * state.slots
        self.viscous = self._system(faces, kind.velocity_neighbours)
        self.projection = self._system(state.slots, kind.pressure_neighbours)
        # A second system with the pressure matrix moves particles out of crowded regions. A full pipe does not need
        # this system.
        self.dispersion = None if self.full else replace(self.projection, arrays=self._arrays(state.slots))
        self.event_flags = wp.zeros(2, dtype=wp.int32, device=self.device)
        self._no_threshold = wp.zeros(1, dtype=wp.float64, device=self.device)
        self._extended = [wp.zeros(faces, dtype=self.scalar, device=self.device) for _ in range(2)]
        self._known_faces = [wp.zeros(faces, dtype=wp.int32, device=self.device) for _ in range(2)]
        self.steps = 0
        self._step: Step | None = None
        self._goal_reached, self._goal_time, self._goal_sent = True, 0.0, False
        self.pace, self._clock = self._step_control(), clock_kernels(self.scalar, kind)
        self._read_clock()

    def _step_control(self) -> Any:
        """Return the struct `Pace`, which controls the length of steps.

        The method also stores the residual norms at which the solves stop.
        """
        pace, scene = Pace(), self.scene
        stop_norm = DISPERSION_TOLERANCES[1]
        pace.longest, pace.error = scene.time_step, scene.step_error
        pace.floor = MIN_RELATIVE_SPEED * self.state.layout.speed
        pace.viscous = VELOCITY_ERROR * self._force
        pace.pressure = max(
            ABSOLUTE_PRESSURE_FACTOR * scene.tolerance * self._force / self.state.layout.length, self._rounding
        )
        pace.crowding = stop_norm * scene.concrete.density / scene.time_step**2 * self._volume * self._size
        for system, norm in ((self.viscous, pace.viscous), (self.projection, pace.pressure)):
            system.arrays.stop_norm.fill_(norm)
        if self.dispersion is not None:
            self.dispersion.arrays.stop_norm.fill_(pace.crowding)
        return pace

    @property
    def viscosity_threshold(self) -> wp.array:
        """Norm of the residual at which the viscosity solve stops, shape (1,)."""
        return self.viscous.arrays.stop_norm

    @property
    def pressure_threshold(self) -> wp.array:
        """Norm of the residual at which the pressure solve stops, shape (1,)."""
        return self.projection.arrays.stop_norm

    @property
    def dispersion_threshold(self) -> wp.array:
        """Norm of the residual at which the solve that moves particles apart stops, shape (1,)."""
        return self._no_threshold if self.dispersion is None else self.dispersion.arrays.stop_norm

    @property
    def adaptive(self) -> bool:
        """True if the length of steps adapts to the flow."""
        return self.scene.step_error > 0

    def set_goal(self, until: float = math.inf, steps: int | None = None) -> None:
        """Set the goal of the next steps: a simulated time `until` [s], or a number of `steps`.

        If all time steps are equal, the flow stops at the step that ends nearest to `until`.
        """
        super().set_goal(until, steps)
        self._goal_time = math.inf
        if steps is None and self.adaptive:
            self._goal_time, self._goal = until, UNREACHABLE_STEPS
        self._goal_reached = self.steps >= self._goal or self._goal_time - self.time < 1e-9 * self.scene.time_step
        self._goal_sent = False

    def launch(self) -> None:
        """Launch some steps towards the goal; a GPU takes them on its current stream while Python goes on."""
        if not self._goal_sent:
            launch(
                self._clock.begin, 1, self.device, until=min(self._goal_time, 1e300), goal=self._goal, pace=self.pace,
                flags=self.flags, mesh=self.mesh, viscosity_threshold=self.viscosity_threshold,
                pressure_threshold=self.pressure_threshold, dispersion_threshold=self.dispersion_threshold,
            )  # fmt: skip
            self._goal_sent = True
        super().launch()

    @property
    def goal_reached(self) -> bool:
        """True when the flow has reached its goal."""
        return self._goal_reached

    @property
    def _steps_left(self) -> int:
        """Number of steps to the goal if no time step gets shorter; steps beyond the goal change nothing."""
        if not self.adaptive:
            return self._goal - self.steps
        by_time = min((self._goal_time - self.time) / self.next_step, UNREACHABLE_STEPS)
        return min(max(1, math.ceil(by_time - 1e-6)), self._goal - self.steps)

    def _read_progress(self, flags: np.ndarray) -> None:
        super()._read_progress(flags)
        self._goal_reached = bool(flags[int(HALTED)])
        self._read_clock()

    def _read_clock(self) -> None:
        clock = self.mesh.clock.numpy()
        self.time, self.next_step = float(clock[int(NOW)]), float(clock[int(WANTED)])

    def _system(self, rows: int, near: int) -> System:
        structs = array_structs(self.scalar, 2)
        matrix = structs.Matrix()
        matrix.near_capacity = near
        for name in structs.Matrix.vars:
            if name not in ("near_capacity", "grain_rows", "grains", "coarse"):
                # The struct's arrays for drag and position serve particle flows only; on a grid both arrays stay zero.
                size = {"near": rows * near, "coefficient": rows * near, "drag": rows, "position": rows}
                allocate(structs.Matrix, self.device, matrix, **{name: size.get(name, rows)})
        numbers = flow_struct(self.scalar)()
        numbers.count = rows
        return System(rows, matrix, self._arrays(rows), numbers)

    def _arrays(self, rows: int) -> Any:
        """Return the working arrays of the solve of a linear system with `rows` equations."""
        struct = array_structs(self.scalar, 2).NumberSolve
        sizes = {
            "partial": 3 * -(-rows // BLOCK),
            "outcome": OUTCOME,
            "stop_norm": 1,
            "history": HISTORY,
            "direction": rows * (2 if self.parallel else 1),
            "preconditioned": rows if self.parallel else 0,
            **dict.fromkeys(("load", "lift", "change", "inner"), 0),
        }
        return allocate(struct, self.device, **dict.fromkeys(struct.vars, rows) | sizes)

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of particles and of cells."""
        return {"particles": self.count, "cells": math.prod(self.state.layout.cells)}

    @property
    def holdings(self) -> dict[str, Any]:
        """Objects that hold the flow's device arrays, by the name under which a forecast states their memory."""
        systems = self._systems.values()
        return {
            "particles": self.particles, "grid": self.mesh, "walls": [self.geometry, self.state.opened],
            "matrix": [system.matrix for system in systems], "solves": [system.arrays for system in systems],
        }  # fmt: skip

    @property
    def _systems(self) -> dict[int, System]:
        """Linear systems of velocity, pressure and crowding, by solve: VISCOSITY, PRESSURE or DENSITY."""
        found = {VISCOSITY: self.viscous, PRESSURE: self.projection}
        return found if self.dispersion is None else found | {DENSITY: self.dispersion}

    # The following methods return the stages of a step and the state for checkpoints.

    @property
    def step(self) -> Step:
        """Stages of one time step, in a single list, because one thread launches all of them."""
        if self._step is None:
            self._step = [self._stages()]
        return self._step

    @property
    def _kernel_arrays(self) -> dict[str, Any]:
        """Arrays and structs of the flow, by the names of the kernel parameters that receive them."""
        return {
            "flags": self.flags,
            "particles": self.particles,
            "mesh": self.mesh,
            "walls": self.walls,
            "geometry": self.geometry,
            "solid_after": self.solid_after,
            "g": self.g,
            "pace": self.pace,
            "event_flags": self.event_flags,
            "count": self.count,
            "viscosity_threshold": self.viscosity_threshold,
            "pressure_threshold": self.pressure_threshold,
            "dispersion_threshold": self.dispersion_threshold,
        }

    def _stages(self) -> list[Any]:
        """Return all stages of one step in their order.

        1. Sort particles into cells, find how full the cells are, and gather velocities on the faces.
        2. Compute shear rates, apparent viscosities and wall friction, and solve for the velocities.
        3. Solve for the pressure increment, and remove the divergence of the velocities.
        4. Adapt the driving force, measure the speed, break the structure, and move crowded particles apart.
        5. Extrapolate the velocities beyond the concrete, move the particles, and advance the time.
        """
        slots, serial = self.state.slots, not self.parallel
        layout = self.state.layout
        kind, scalar = layout.kind, self.scalar
        bins = bin_kernels(scalar, kind)
        viscosity = viscosity_kernels(scalar, kind)
        pressure = pressure_kernels(scalar, serial, kind)
        velocity, increment = self.mesh.velocity, self.mesh.increment
        opening = None
        if len(layout.opens):
            opening = self.stage(lift_kernel(scalar, kind), slots, slots=slots, after=self.state.opened)
        return [
            self.stage(bins.clear, slots),
            *([opening] if opening else []),
            self.stage(bins.tally, self.count),
            self.stage(bins.allot, slots),
            self.stage(bins.sort, self.count),
            self.stage(bins.order, slots),
            *([] if self.full else [self.stage(fill_kernel(scalar, kind), slots)]),
            self.stage(gather_kernel(scalar, kind), slots),
            self.stage(viscosity.rates, slots),
            self.stage(viscosity.viscosity, slots),
            self.stage((wall_kernel if kind.cut else side_kernel)(scalar, kind), slots),
            self.stage(
                momentum_kernel(scalar, serial, kind), slots, matrix=self.viscous.matrix, viscous=self.viscous.arrays,
            ),
            *self._solve(self.viscous, VISCOSITY, velocity, 0.0),
            self.stage(pressure.divergence, slots, matrix=self.projection.matrix, projection=self.projection.arrays),
            *self._solve(self.projection, PRESSURE, increment, self.scene.tolerance),
            self.stage(pressure.project, slots),
            *(self._drive() if layout.periodic and layout.mean_velocity_fixed else []),
            *(self._speeds() if self.adaptive else []),
            *(self._break_structure() if kind.thixotropic else []),
            *([] if self.full else self._disperse()),
            *self._extrapolate(extend_kernel(scalar, kind)),
            self.stage(advect_kernel(scalar, kind), self.count, velocity=self._extended[0], good=self._known_faces[0]),
            self.stage(self._clock.tick, 1),
        ]  # fmt: skip

    def _break_structure(self) -> list[Stage]:
        """Return the stage in which shear and slip break the structure that the concrete gained at rest."""
        scene = self.scene
        return [
            self.stage(
                break_kernel(self.scalar, self.state.layout.kind), self.state.slots, breakdown=scene.breakdown,
                breakdown_strain=scene.breakdown_strain, rebuild_rate=scene.rebuild_rate,
            )
        ]  # fmt: skip

    @property
    def _force(self) -> float:
        """Norm of the forces on all faces that change each velocity by the typical speed within the longest step."""
        scene = self.scene
        return scene.concrete.density / scene.time_step * self._volume * self.state.layout.speed * self._size

    @property
    def _rounding(self) -> float:
        """Norm of the rounding error of the divergence; no solve can reduce its residual below this norm."""
        part = ROUNDING["float64" if self.scalar is wp.float64 else "float32"]
        return part * self._force / min(self.state.layout.room.width)

    @property
    def _volume(self) -> float:
        """Volume of a cell [m3]; in plane flow per metre of depth, in axisymmetric flow per radian."""
        layout = self.state.layout
        return math.prod(layout.room.width) * (layout.length if layout.axial else 1.0)

    @property
    def _size(self) -> float:
        """Factor from the rms of a residual to its norm: the square root of the number of initially full cells."""
        layout = self.state.layout
        return math.sqrt(max(self.count * (layout.particle_spacing / layout.spacing) ** layout.axes, 1.0))

    def _extrapolate(self, kernel: Any) -> list[Stage]:
        """Return stages that extrapolate velocities beyond the concrete, each by one cell.

        The stages alternate between two arrays, in such an order that the last stage writes to the first array.
        """
        found = []
        for turn in range(EXTRAPOLATED_CELLS):
            to = (EXTRAPOLATED_CELLS - 1 - turn) % 2
            found.append(
                self.stage(
                    kernel, self.state.slots, again=int(turn > 0), final=int(turn == EXTRAPOLATED_CELLS - 1),
                    before=self._extended[1 - to], known_before=self._known_faces[1 - to], after=self._extended[to],
                    known_after=self._known_faces[to],
                )
            )  # fmt: skip
        return found

    def _disperse(self) -> list[Any]:
        """Return stages that move crowded particles apart; they solve a system with the pressure's matrix."""
        kernels, slots = crowd_kernels(self.scalar, self.state.layout.kind), self.state.slots
        assert self.dispersion is not None
        return [
            self.stage(kernels.source, slots, projection=self.dispersion.arrays),
            *self._solve(self.dispersion, DENSITY, self.mesh.potential, DISPERSION_TOLERANCES[0]),
            self.stage(kernels.disperse, slots),
        ]

    def _speeds(self) -> list[Stage]:
        """Return stages that measure the speed of the concrete, from which the length of the next step follows."""
        kernels = speed_kernels(self.scalar, self.state.layout.kind)
        if not self.parallel:
            return [self.stage(kernels.speeds, 1)]
        blocks, partial = -(-self.viscous.rows // BLOCK), self.viscous.arrays.partial
        return [
            self.stage(kernels.sums, BLOCK * blocks, block=BLOCK, blocks=blocks, partial=partial),
            self.stage(kernels.speeds_of_sums, BLOCK, block=BLOCK, blocks=blocks, partial=partial),
        ]

    def _drive(self) -> list[Stage]:
        """Return stages that apply the driving force which keeps the mean velocity of a periodic pipe constant."""
        kernels, slots = drive_kernels(self.scalar, self.state.layout.axes), self.state.slots
        correct = self.stage(kernels.correct, slots)
        if not self.parallel:
            return [self.stage(kernels.deficit, 1), correct]
        blocks, partial = -(-slots // BLOCK), self.viscous.arrays.partial
        return [
            self.stage(kernels.sums, BLOCK * blocks, block=BLOCK, blocks=blocks, partial=partial),
            self.stage(kernels.deficit_of_sums, BLOCK, block=BLOCK, blocks=blocks, partial=partial),
            correct,
        ]

    def _solve(self, system: System, what: int, x: wp.array, tolerance: float) -> list[Any]:
        """Return the stage of a conjugate-gradient solve that adds its solution to `x`.

        The solve stops when the residual is below `tolerance` times the initial one, or below the norm stored in the
        system.
        """
        kind = self.scalar, 2, False
        named = {
            "flow": system.numbers, "what": what, "tolerance": tolerance,
            "maximum": self.scene.maximum_iterations, "matrix": system.matrix, "system": system.arrays, "x": x,
            "count": system.rows, "gate": self._launcher.gate, "flags": self.flags,
            "parts": 1, "lower": 0, "upper": 1, "workers": 1,
        }  # fmt: skip
        kernel, tasks, block = serial_solver(*kind), 1, None
        if self.parallel:
            block, parties = resident_blocks(self.device, system.rows, system.matrix.near_capacity, self.abreast)
            named["parties"] = parties
            kernel, tasks = resident_solver(*kind, width=block), block * parties
        return [Stage(kernel, tasks, {name: named[name] for name in parameter_names(kernel)}, self.device, block=block)]

    def solves(self) -> dict[int, Any]:
        """Return the working arrays of each linear solve; the keys are VISCOSITY, PRESSURE and DENSITY."""
        return {what: system.arrays for what, system in self._systems.items()}

    def state_arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays that the next step depends on."""
        return self.state.state_dict()

    def state_dict(self) -> dict[str, Any]:
        """Return the arrays and numbers that a checkpoint needs to continue the flow at the next step."""
        return {"arrays": self.state_arrays(), "numbers": {"steps": self.steps}}

    def load_state_dict(self, found: dict[str, Any]) -> None:
        """Restore the flow from a `state_dict`."""
        self.state.load_state_dict(found["arrays"])
        self.steps = int(found["numbers"]["steps"])
        self._read_clock()
