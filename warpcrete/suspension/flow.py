"""Grid flow of a mortar with rigid aggregates: the stages of one time step, which the host launches one by one."""

from typing import Any

import numpy as np
import warp as wp

from ..core.device.launching import Arguments, Stage
from ..core.records import SavedState
from ..dem.engine.stages import warp_width
from ..kernels.common.control import HALTED
from ..kernels.mps.grid.advection import advect_kernel
from ..kernels.mps.grid.forces import momentum_kernel
from ..kernels.mps.grid.pressure import pressure_kernels
from ..kernels.mps.grid.walls import wall_kernel
from ..kernels.mps.structs import PRESSURE
from ..kernels.suspension import coupling
from ..kernels.suspension.blocks import block_kernel
from ..kernels.suspension.bodies import motion_kernels, pose_kernel
from ..kernels.suspension.cover import cover_kernels, release_kernels
from ..kernels.suspension.entering import entering_kernels
from ..kernels.suspension.friction import friction_kernels
from ..kernels.suspension.leaving import leaving_kernels
from ..kernels.suspension.neighbours import neighbour_kernels
from ..kernels.suspension.strain import strain_kernels
from ..mps.grid.flow import GridFlow
from ..mps.grid.geometry import MIRROR, OPEN_SIDE, WALL
from ..mps.grid.stages import GridStep
from ..mps.grid.state import GridState
from .aggregates import Aggregates, BodyState
from .entrance import Entrance
from .solve import CoupledSolve, Tolerances

CUTOFF_CELLS = 2.0
"""Smallest gap between two aggregates that the grid resolves, in cell widths.

In narrower gaps, the grid gives only a part of the lubrication force, and the rest is added as a force between the two
aggregates.
"""

PORE_DRAG = 0.2
"""Constant in the resistance to flow through the pores between aggregates, which the preconditioner of the coupled
solve assumes. At a face, this resistance is the viscous resistance times PORE_DRAG / r^2, where r is the radius of the
smallest aggregate in cell widths.

The constant affects only the number of iterations of the coupled solve. It was chosen to make this number small in
eight flows.
"""


class SuspensionStep(GridStep):
    """Stages of one time step of a mortar with aggregates, before and after the coupled solve."""

    def before(self) -> list[Stage]:
        """Return the stages before the coupled solve, which set up its equations."""
        flow, kind, scalar, slots = self.flow, self.kind, self.scalar, self.slots
        serial = not flow.parallel
        bodies, abreast = flow.aggregates.kind, flow.aggregates.count * warp_width(flow.device)
        cover, free = cover_kernels(scalar, kind, bodies), release_kernels(scalar, kind)
        motion, strain = motion_kernels(scalar, kind), strain_kernels(scalar, kind)
        neighbours, leaving = neighbour_kernels(scalar, kind, bodies), leaving_kernels(scalar, bodies)
        count, spheres = flow.aggregates.count, flow.aggregates.spheres
        return [
            *self.gather(),
            *(self._alone(pose_kernel(scalar), count) if bodies.clumps else []),
            *(self._alone(leaving.park, count, opens=flow.opens) if flow.opens else []),
            *self._entering("guide"),
            *self._alone(cover.clear, 4 * slots),
            *self._alone(cover.claim, abreast),
            *self._alone(free.close, slots),
            *self._alone(free.shut, 3 * slots),
            *self._alone(free.share, slots),
            *self._entering("relax", slots),
            *self._alone(free.release, slots),
            *self._alone(cover.collect, count),
            *self._alone(motion.carry, count),
            *self._alone(neighbours.locate, spheres, points=flow.aggregates.points),
            flow.aggregates.sort,
            *self._alone(neighbours.find, spheres, grid=flow.aggregates.grid.id, span=flow.aggregates.span,
                         sides=flow.sides, mirrors=flow.mirrors,
                         longest=flow.scene.time_step, cutoff=flow.cutoff, roughness=flow.roughness),
            *(self._alone(leaving.weigh, count, opens=flow.opens, excess=flow.aggregates.excess)
              if flow.opens else []),
            *self._entering("ignore"),
            *self._entering("weigh", excess=flow.aggregates.excess),
            *(self._alone(friction_kernels(scalar, kind, bodies).rub, spheres, mirrors=flow.mirrors,
                          friction=flow.friction) if bodies.friction else []),
            *self._alone(strain.rates, slots),
            *self._alone(strain.viscosity, slots),
            *self._cells(wall_kernel(scalar, kind)),
            *self._cells(momentum_kernel(scalar, serial, kind), mesh=flow.cut, matrix=flow.viscous.matrix,
                         viscous=flow.viscous.arrays),
            *self.blocks(),
            *self._divergence(),
            *self._alone(coupling.pressure_kernels(scalar, serial, kind).resist, slots, matrix=flow.viscous.matrix,
                         pressures=flow.projection.matrix, drag=flow.drag, yielding=flow.coupled.yielding),
            *self._complete(flow.projection),
        ]  # fmt: skip

    def _entering(self, name: str, tasks: int | None = None, **named: object) -> list[Stage]:
        """Return the stage that runs one of the kernels for aggregates that enter through a plane.

        The stage is empty if no aggregates enter. The kernel has one task per aggregate unless `tasks` states another
        number.
        """
        flow = self.flow
        if flow.entrance is None:
            return []
        kernel = getattr(entering_kernels(self.scalar, self.kind, flow.aggregates.kind), name)
        return self._alone(kernel, tasks or flow.aggregates.count, **named)

    def _divergence(self) -> list[Stage]:
        """Return the stage that computes the net inflow into each cell, and the matrix of the pressure projection."""
        kernel, system = (
            pressure_kernels(self.scalar, not self.flow.parallel, self.kind).divergence,
            self.flow.projection,
        )
        return self._cells(kernel, matrix=system.matrix, projection=system.arrays)

    def blocks(self) -> list[Stage]:
        """Return the stages that invert the diagonal blocks of each aggregate in the matrix of the viscous solve."""
        kernel = block_kernel(self.scalar, not self.flow.parallel, self.kind, self.flow.aggregates.kind)
        tasks = self.flow.aggregates.count * warp_width(self.flow.device)
        inverse = self._alone(kernel, tasks, matrix=self.flow.viscous.matrix)
        return [*inverse, *self._entering("fix")]

    def after(self) -> list[Stage]:
        """Return the stages after the coupled solve, which move the mortar and the aggregates."""
        flow, kind, scalar = self.flow, self.kind, self.scalar
        fixed = self.layout.periodic and self.layout.mean_velocity_fixed
        hasten = self._alone(motion_kernels(scalar, kind).hasten, flow.aggregates.count) if fixed else []
        return [
            *(self._drive() if fixed else []),
            *hasten,
            *(self._speeds() if flow.adaptive else []),
            # The solve that moves crowded particles apart needs the matrix of the pressure projection. The kernel
            # `resist` has changed this matrix for the coupled solve, so compute it again.
            *([] if flow.full else [*self._divergence(), *self._complete(flow.projection), *self._disperse()]),
            *self._extrapolate(),
            *self._shared(advect_kernel(scalar, kind), flow.count, velocity=flow.extended[0], good=flow.known_faces[0]),
            *(self._remember() if flow.friction else []),
            *self._alone(motion_kernels(scalar, kind).move, flow.aggregates.count),
            *self._alone(flow.clock_kernels.tick, 1),
        ]

    def _remember(self) -> list[Stage]:
        """Return the stage that stores the normal forces of contacts, on which friction depends in the next step."""
        bodies = self.flow.aggregates
        kernel = friction_kernels(self.scalar, self.kind, bodies.kind).remember
        return self._alone(kernel, bodies.spheres, longest=self.flow.scene.time_step)

    def pressure_solve(self, tolerance: float) -> list[Stage]:
        """Return the stage that solves for the pressure increment."""
        return self._solve(self.flow.projection, PRESSURE, self.flow.mesh.increment, tolerance)


class SuspensionFlow(GridFlow):
    """Flow of a mortar with rigid aggregates on a three-dimensional grid."""

    def __init__(
        self, state: GridState, aggregates: Aggregates, *, roughness: float = 1e-2, friction: float = 0.0,
        tolerances: Tolerances | None = None, entrance: Entrance | None = None,
    ) -> None:  # fmt: skip
        super().__init__(state, threads=1)
        down = np.array([0.0, 0.0, -state.scene.gravity]) if entrance is None else entrance.gravity
        self.entrance = None if entrance is None else entrance.on_device(aggregates.centre, self.scalar, self.device)
        self.aggregates = BodyState(
            aggregates, state.layout, state.scene.concrete.density, down, self.scalar, self.device, friction
        )
        state.aggregates = self.aggregates.bodies
        # The struct `cut` shares all arrays of the flow's struct `mesh`, except for the viscosities. In `cut`, the
        # viscosities are divided by the mortar fractions of cells and edges.
        self.cut = state.structs.Fields()
        for name in state.structs.Fields.vars:
            setattr(self.cut, name, getattr(self.mesh, name))
        self.cut.in_cell, self.cut.in_corner = wp.zeros_like(self.mesh.in_cell), wp.zeros_like(self.mesh.in_corner)
        self.roughness, self.friction = roughness, friction
        self.cutoff = CUTOFF_CELLS * max(state.layout.room.width)
        self.drag = PORE_DRAG * (min(state.layout.room.width) / float(aggregates.radius.min())) ** 2
        sides = [side for pair in state.layout.room.sides for side in pair]
        self.mirrors = sum(1 << n for n, side in enumerate(sides) if side == MIRROR)
        # The sides of the box around a pipe lie behind the pipe's wall and behind the plane through which aggregates
        # enter, so aggregates never touch these sides.
        met = (WALL, MIRROR) if entrance is None else (MIRROR,)
        self.sides = sum(1 << n for n, side in enumerate(sides) if side in met)
        # In a vessel, the top of the box, which is the last of its sides, is open as well. Leave it out of the open
        # sides through which aggregates may leave, because it is above the concrete. The ends of a periodic pipe are
        # connected, so no aggregate leaves it.
        leaving = [] if state.layout.periodic else sides if entrance is not None else sides[:-1]
        self.opens = sum(1 << n for n, side in enumerate(leaving) if side == OPEN_SIDE)
        self.coupled = CoupledSolve(self, tolerances or Tolerances())
        self.step_is_complete = False
        """True if this process has completed the last step that it began; the arrays then describe this whole step."""
        self._build_stages()

    @property
    def holdings(self) -> dict[str, Any]:
        coupled_arrays = {
            "aggregates": self.aggregates,
            "coupled solve": self.coupled.directions,
            "viscous solve": self.coupled.compact,
        }
        return super().holdings | coupled_arrays | ({} if self.entrance is None else {"entrance": self.entrance})

    def _build_stages(self) -> None:
        part = SuspensionStep(self, range(1))
        self._before, self._after, self._blocks = part.before(), part.after(), part.blocks()
        tolerances, single = self.coupled.tolerances, self.projection.matrix.levels == 1
        self.pressure_stages = part.pressure_solve(tolerances.pressure_single_level if single else tolerances.pressure)

    def share(self, abreast: int) -> None:
        super().share(abreast)
        self._build_stages()

    @property
    def kernel_arrays(self) -> Arguments:
        """Arrays and structs of the flow, by the names of the kernel parameters that receive them."""
        return self._kernel_arrays

    @property
    def _kernel_arrays(self) -> Arguments:
        return super()._kernel_arrays | {
            "bodies": self.aggregates.bodies, "cover": self.aggregates.cover, "cut": self.cut,
            "pairs": self.aggregates.pairs, "entrance": self.entrance,
        }  # fmt: skip

    def invert_blocks(self) -> None:
        """Recompute the aggregates' inverse diagonal blocks after new contacts have changed the viscous matrix."""
        for stage in self._blocks:
            stage()

    def launch(self) -> None:
        """Take time steps until the flow reaches its goal, such as a time; the host launches every stage."""
        self.begin_goal()
        # Read the progress after each step: the error of a failed solve states the time at the start of the step.
        while not self.read_progress()[int(HALTED)]:
            self.take_step()

    def take_step(self) -> None:
        """Take one time step."""
        self.step_is_complete = False
        for stage in self._before:
            stage()
        self.coupled.solve()
        for stage in self._after:
            stage()
        self.step_is_complete = True

    def outcomes(self) -> dict[str, dict[str, float]]:
        """Return the numbers of iterations of the viscous and coupled solves in the last step, and the relative error.

        The relative error is the final residual of the coupled solve, relative to the flow's momentum or to its change.
        """
        coupled = self.coupled
        return {
            "viscosity": {"iterations": float(coupled.inner)},
            "pressure": {"iterations": float(coupled.outer), "after": coupled.error},
        }

    def state_arrays(self) -> dict[str, np.ndarray]:
        return super().state_arrays() | {f"aggregate_{name}": a for name, a in self.aggregates.state_dict().items()}

    def load_state_dict(self, found: SavedState) -> None:
        """Restore the flow and its aggregates from a `state_dict`."""
        self.aggregates.load_state_dict(
            {name.removeprefix("aggregate_"): a for name, a in found["arrays"].items() if name.startswith("aggregate_")}
        )
        super().load_state_dict(found)
        self.step_is_complete = False
