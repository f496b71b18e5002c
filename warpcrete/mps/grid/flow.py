"""Flow on a grid through which particles carry the concrete.

A step has four parts:

- Particles transfer their velocities to the faces of the cells (affine particle-in-cell, Jiang et al. 2015).
- An implicit solve changes these velocities by viscosity, walls, pressure and weight.
- An increment of the pressure removes the divergence of the velocities.
- Particles take their velocity from the grid and move with it.

The length of the time steps may adapt to the flow. The equations are discretised on the grid and not between particles,
so concrete can be sheared without limit.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import warp as wp

from ...core.device.device import default_threads, parallel
from ...core.device.launching import Arguments, Launcher, Step, launch
from ...core.records import SavedState
from ...kernels.common.control import HALTED
from ...kernels.mps.grid.cells import NOW, WANTED
from ...kernels.mps.grid.pace import Pace, clock_kernels
from ...kernels.mps.structs import DENSITY, PRESSURE, VISCOSITY
from ..common.stepping import ABSOLUTE_PRESSURE_FACTOR, LARGEST_GRAPH, VELOCITY_ERROR, Stepping
from .stages import DISPERSION_TOLERANCES, GridStep
from .state import GridState, grid_numbers
from .systems import CHUNKS, System, solve_arrays, system_of

# Rounding error of a cell's net inflow, divided by a typical net inflow, by precision.
ROUNDING = {"float32": 1e-6, "float64": 1e-14}
MIN_RELATIVE_SPEED = 0.05
"""Minimum speed in the relative error of a time step, divided by the typical speed of the flow. The relative error is
the error divided by the rms speed of the concrete, or by the minimum speed if the rms speed is smaller."""
CELLS_PER_THREAD = 256
"""Minimum number of cells for each CPU thread."""
UNREACHABLE_STEPS = 2**31 - 1  # Number of steps so large that no run reaches it; it stands for no limit.


class GridFlow(Stepping):
    """Object that advances a flow on a grid in time."""

    next_step: float
    """Length of the next step [s]. The step is cut short if the time up to which the flow must run is reached
    earlier."""
    rebuilds = 0
    """Number of rebuilds of neighbour lists; always zero, because a grid needs no lists."""

    def __init__(self, state: GridState, *, threads: int | None = None) -> None:
        scene = state.scene
        self.state, self.scene, self.device = state, scene, state.device
        self.parallel = parallel(self.device)
        self.scalar, self.count = state.scalar, state.count
        self.flags, self.particles, self.mesh, self.walls = state.flags, state.particles, state.mesh, state.walls
        self.geometry, self.solid_after = state.geometry, state.solid_after
        self.g = grid_numbers(state)
        useful_threads = min(threads or default_threads(), CHUNKS, state.slots // CELLS_PER_THREAD)
        self.threads = 1 if self.parallel else max(1, useful_threads)
        self._launcher = Launcher(self.threads, self.device)
        self.gate, self.barrier = self._launcher.gate, self._launcher.barrier
        self.full = state.layout.full or state.layout.periodic
        kind, faces = state.layout.kind, state.layout.axes * state.slots
        near, shape = (kind.velocity_neighbours, kind.pressure_neighbours), state.shape
        self.viscous = system_of(self.scalar, self.device, shape, state.layout.axes, near[0])
        self.projection = system_of(self.scalar, self.device, shape, 1, near[1])
        # A second linear system, with the matrix of the pressure, moves particles out of crowded regions. A full pipe
        # needs no such system, because its cells are full by definition.
        self.dispersion = (
            None
            if self.full
            else replace(
                self.projection, arrays=solve_arrays(self.scalar, self.device, state.slots, self.projection.first[-1])
            )
        )
        self.event_flags = wp.zeros(2, dtype=wp.int32, device=self.device)
        self._no_threshold = wp.zeros(1, dtype=wp.float64, device=self.device)
        self.extended = [wp.zeros(faces, dtype=self.scalar, device=self.device) for _ in range(2)]
        self.known_faces = [wp.zeros(faces, dtype=wp.int32, device=self.device) for _ in range(2)]
        self.steps = 0
        self._step: Step | None = None
        self._goal_reached, self._goal_time, self._goal_sent = True, 0.0, False
        self.pace, self.clock_kernels = self._step_control(), clock_kernels(self.scalar, kind)
        self._read_clock()

    def _step_control(self) -> Any:
        """Return the struct `Pace`, which contains the constants that control the length of time steps.

        The method also stores the residual norms at which the linear solves stop.
        """
        pace, scene = Pace(), self.scene
        stop_norm = DISPERSION_TOLERANCES[1]
        pace.longest, pace.error = scene.time_step, scene.step_error
        pace.floor = MIN_RELATIVE_SPEED * self.state.layout.speed
        pace.transfer = 0.0 if self.full else 1.0
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
        """Norm of the residual below which the viscosity solve stops, one number on the device, shape (1,)."""
        return self.viscous.arrays.stop_norm

    @property
    def pressure_threshold(self) -> wp.array:
        """Norm of the residual below which the pressure solve stops, one number on the device, shape (1,)."""
        return self.projection.arrays.stop_norm

    @property
    def dispersion_threshold(self) -> wp.array:
        """Norm of the residual below which the solve that disperses crowded particles stops, shape (1,)."""
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
        """Launch some of the time steps that the flow still needs to reach its goal.

        The goal is a time or a number of steps. On a GPU the method returns before the steps are completed; they run on
        the current CUDA stream.
        """
        self.begin_goal()
        super().launch()

    def begin_goal(self) -> None:
        """Send the goal, a time or a number of steps, to the device, unless this has been done."""
        if not self._goal_sent:
            launch(
                self.clock_kernels.begin, 1, self.device, until=min(self._goal_time, 1e300), goal=self._goal,
                pace=self.pace, flags=self.flags, mesh=self.mesh, viscosity_threshold=self.viscosity_threshold,
                pressure_threshold=self.pressure_threshold, dispersion_threshold=self.dispersion_threshold,
            )  # fmt: skip
            self._goal_sent = True

    @property
    def _largest_graph(self) -> int:
        # The threads check only between two graphs (recorded sequences of steps) whether other programs use their
        # cores. A step on a grid takes long, so a graph has only few steps, to keep these checks frequent.
        return LARGEST_GRAPH["cuda" if self.parallel else "cpu"]

    @property
    def goal_reached(self) -> bool:
        """True when the flow has reached the time or the number of steps that `set_goal` has set."""
        return self._goal_reached

    @property
    def _steps_left(self) -> int:
        """Estimated number of steps to the goal, if all of them are as long as the next one.

        An estimate that is too large does no harm, because steps that are launched beyond the goal have no effect.
        """
        if not self.adaptive:
            return self._goal - self.steps
        by_time = min((self._goal_time - self.time) / self.next_step, UNREACHABLE_STEPS)
        return min(max(1, math.ceil(by_time - 1e-6)), self._goal - self.steps)

    def read_progress(self) -> np.ndarray:
        flags = super().read_progress()
        self._goal_reached = bool(flags[int(HALTED)])
        self._read_clock()
        return flags

    def _read_clock(self) -> None:
        clock = self.mesh.clock.numpy()
        self.time, self.next_step = float(clock[int(NOW)]), float(clock[int(WANTED)])

    @property
    def counts(self) -> dict[str, int]:
        """Numbers of particles and of cells."""
        return {"particles": self.count, "cells": math.prod(self.state.layout.cells)}

    @property
    def holdings(self) -> dict[str, Any]:
        """Objects that hold the flow's device arrays; the keys name them in a forecast, which states their memory."""
        systems = self._systems.values()
        return {
            "particles": self.particles, "grid": self.mesh, "walls": [self.geometry, self.state.opened],
            "matrix": [system.matrix for system in systems], "solves": [system.arrays for system in systems],
        }  # fmt: skip

    @property
    def _systems(self) -> dict[int, System]:
        """Linear systems that each time step solves, by the keys VISCOSITY, PRESSURE and DENSITY."""
        systems = {VISCOSITY: self.viscous, PRESSURE: self.projection}
        return systems if self.dispersion is None else systems | {DENSITY: self.dispersion}

    # The following methods return the stages of a step and the state for checkpoints.

    @property
    def step(self) -> Step:
        if self._step is None:
            self._step = [GridStep(self, range(part, part + 1)).stages() for part in range(self.threads)]
        return self._step

    def _single_thread_step(self) -> Step:
        return [GridStep(self, range(self.threads)).stages()]

    @property
    def _kernel_arrays(self) -> Arguments:
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

    @property
    def _force(self) -> float:
        """Norm that the residual of the velocity solve has if every velocity is wrong by the typical speed of the flow.

        The norm is computed for a time step of the longest allowed length.
        """
        scene = self.scene
        return scene.concrete.density / scene.time_step * self._volume * self.state.layout.speed * self._size

    @property
    def _rounding(self) -> float:
        """Norm of the rounding error of the divergence; a pressure solve cannot reduce its residual below this norm."""
        part = ROUNDING["float64" if self.scalar is wp.float64 else "float32"]
        return part * self._force / min(self.state.layout.room.width)

    @property
    def _volume(self) -> float:
        """Cell volume [m3]; in plane flow per metre of depth, in axisymmetric flow per radian at a typical radius."""
        layout = self.state.layout
        return math.prod(layout.room.width) * (layout.length if layout.axial else 1.0)

    @property
    def _size(self) -> float:
        """Ratio of a residual's norm to its rms value: square root of the number of initially full cells."""
        layout = self.state.layout
        return math.sqrt(max(self.count * (layout.particle_spacing / layout.spacing) ** layout.axes, 1.0))

    def solves(self) -> dict[int, Any]:
        return {what: system.arrays for what, system in self._systems.items()}

    def state_arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays that the next step depends on."""
        return self.state.state_dict()

    def state_dict(self) -> SavedState:
        """Return the arrays and numbers that a checkpoint needs to continue the flow at the next step."""
        return {"arrays": self.state_arrays(), "numbers": {"steps": self.steps}}

    def load_state_dict(self, found: SavedState) -> None:
        """Restore the flow from a `state_dict`."""
        self.state.load_state_dict(found["arrays"])
        self.steps = int(found["numbers"]["steps"])
        self._read_clock()
