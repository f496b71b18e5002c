"""Coupled solve of mortar velocity, rigid aggregates and pressure in one time step.

Flows without aggregates solve for velocity and pressure one after the other. With aggregates, this would cause errors
of a third in their velocities. The method of generalised conjugate residuals (Eisenstat, Elman & Schultz 1983)
therefore solves for velocities and pressure together, up to a tolerance. The preconditioner is that of Cahouet &
Chabard (1988). Its pressure is the solution of a pressure solve for the net inflow of the residual, plus the viscosity
times the net inflow per volume. A viscous solve then gives its velocities.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from ..core.device.launching import Stage, completed
from ..core.errors import CapacityError, ConvergenceError
from ..kernels.common.reductions import BLOCK
from ..kernels.mps.grid.cells import DT
from ..kernels.suspension.coupling import algebra_kernels, residual_kernels
from ..kernels.suspension.pairs import CAPACITY, pair_kernels
from ..kernels.suspension.vectors import PQ, RZ, RZ_AFTER, RZ_FIRST, SUMS, add_kernel, sum_kernel, vector_struct
from ..kernels.suspension.velocity import force_kernels, search_kernels, update_kernels
from ..mps.common.allocation import allocate

CPU_TASKS, GPU_TASKS = 32, 64 * BLOCK
ROUNDING = {"float32": 1e-6, "float64": 1e-14}
"""Smallest residual that rounding errors allow, divided by the largest residual of the step, by precision."""
NEGLIGIBLE = 0.1
"""Fraction of the tolerance of the coupled solve below which a pressure solve need not reduce its residual."""
CONTACT_PASSES = 3
"""Maximum number of coupled solves in a step. If a solve finds new contacts, it is repeated with these contacts."""
CHECKED = 5
"""Number of iterations of a viscous solve between two convergence checks, for which the device must wait."""


@dataclass(frozen=True)
class Tolerances:
    """Tolerances and iteration limits of the coupled solve and of the solves in its preconditioner."""

    coupled: float = 1e-4
    """Norm of the residual at which the coupled solve stops, divided by the norm of the flow's momentum."""
    viscous: float = 0.1
    """Residual norm at which a viscous solve of the preconditioner stops, divided by the norm at its start."""
    pressure: float = 0.1
    """Residual norm at which a pressure solve of the preconditioner stops, divided by the norm at its start."""
    outer: int = 60
    """Maximum number of iterations of the coupled solve."""
    inner: int = 5000
    """Maximum number of iterations of a viscous solve."""


class CoupledSolve:
    """Solver of the coupled equations of mortar, aggregates and pressure in a :class:`SuspensionFlow`."""

    def __init__(self, flow: Any, tolerances: Tolerances) -> None:
        self.flow, self.tolerances = flow, tolerances
        self.device, self.scalar = flow.device, flow.scalar
        serial = not flow.parallel
        self.tasks = CPU_TASKS if serial else GPU_TASKS
        kind = flow.state.layout.kind
        self.search, self.forces = search_kernels(self.scalar, serial, kind), force_kernels(self.scalar, kind)
        self.updates = update_kernels(self.scalar, serial, kind)
        self.residuals = residual_kernels(self.scalar, serial, kind)
        self.algebra = algebra_kernels(self.scalar, serial, kind)
        self.add_faces = add_kernel(self.scalar)
        self.pairs = pair_kernels(self.scalar, flow.state.layout.kind)
        self.add_up = sum_kernel(serial)
        self.count = flow.aggregates.count
        self.partial = wp.zeros(self.tasks + self.count, dtype=wp.float64, device=self.device)
        self.sums = wp.zeros(SUMS, dtype=wp.float64, device=self.device)
        self.residual, self.inner_residual, self.direction, self.product = (self._vector() for _ in range(4))
        self.solution, self.part = self._vector(), self._vector()
        self.tried: list[tuple[Any, Any]] = []
        self.inflow = wp.zeros(flow.state.slots, dtype=self.scalar, device=self.device)
        self.yielding = wp.zeros(flow.state.slots, dtype=self.scalar, device=self.device)
        self.force = wp.zeros(3 * flow.state.slots, dtype=self.scalar, device=self.device)
        self._stages: dict[Any, Stage] = {}
        self.outer = 0
        self.inner = 0
        self.error = 0.0
        self._momentum = 0.0
        self._largest = 0.0
        self._dt = 0.0

    def _vector(self) -> Any:
        slots = self.flow.state.slots
        return allocate(
            vector_struct(self.scalar), self.device, faces=3 * slots, linear=self.count, angular=self.count, cells=slots
        )

    def _launch(self, kernel: Any, tasks: int, *, block: int | None = None, **named: Any) -> None:
        # Launches are recorded once for each set of arrays; the factor of a multiple changes.
        key = (id(kernel), *((name, _identity(value)) for name, value in named.items() if name != "factor"))
        if key not in self._stages:
            self._stages[key] = Stage(kernel, tasks, completed(kernel, named, self._arrays), self.device, block=block)
        stage = self._stages[key]
        if "factor" in named:
            stage.set("factor", named["factor"])
        stage()

    @property
    def _arrays(self) -> dict[str, Any]:
        flow = self.flow
        return flow.kernel_arrays | {
            "tasks": self.tasks, "yielding": self.yielding, "matrix": flow.viscous.matrix, "partial": self.partial, "sums": self.sums,
        }  # fmt: skip

    def _sum(self, slot: int) -> None:
        serial = not self.flow.parallel
        self._launch(self.add_up, 1 if serial else BLOCK, block=BLOCK, count=self.tasks + self.count, slot=slot)

    def _inner_product(self, one: Any, two: Any) -> float:
        self._launch(self.algebra.inner, self.tasks + self.count, one=one, two=two)
        return float(self.partial.numpy().sum())

    def _add(self, factor: float, one: Any, result: Any) -> None:
        self._launch(self.algebra.add, self.tasks + self.count, factor=factor, one=one, result=result)

    def solve(self) -> None:
        """Solve for the velocities and pressures at the end of the step, and store them.

        Raises :class:`ConvergenceError` if the tolerance is not reached.
        """
        flow = self.flow
        for array in (self.solution.faces, self.solution.linear, self.solution.angular, self.solution.cells):
            array.zero_()
        self.inner, self.outer, self._largest = 0, 0, 0.0
        self._dt = float(flow.mesh.clock.numpy()[int(DT)])
        for turn in range(CONTACT_PASSES):
            self._begin(again=turn > 0)
            self._iterate()
            if not self._new_contacts():
                break
        self._launch(self.algebra.finish, self.tasks + self.count, solution=self.solution)
        if flow.aggregates.pairs.full.numpy()[0]:
            raise CapacityError(
                f"t = {flow.time:.6g} s: an aggregate has more than {int(CAPACITY)} neighbours; use aggregates whose "
                "sizes differ less"
            )

    def _begin(self, again: bool) -> None:
        """Compute the residual of the current solution; the solution is zero unless the solve is repeated (`again`)."""
        flow, slots = self.flow, self.flow.state.slots
        # The pressure forces and inflows computed so far treat partly covered faces as mortar only. Correct both for
        # the parts of the faces that aggregates cover.
        start = self.product
        bodies = flow.aggregates.bodies
        for name, array in (("faces", flow.mesh.velocity), ("linear", bodies.velocity), ("angular", bodies.spin)):
            wp.copy(getattr(start, name), array)
        self._launch(self.forces.blend, self.count, x=start, flow=start.faces)
        self._launch(self.add_faces, 3 * slots, one=flow.mesh.velocity, factor=-1.0, result=start.faces)
        self._launch(self.residuals.inflow, slots, change=start.faces, sign=1.0, result=self.residual.cells)
        self._launch(self.residuals.start, self.tasks + self.count, viscous=flow.viscous.arrays,
                     projection=flow.projection.arrays, inflow=self.inflow, again=int(again),
                     residual=self.residual)  # fmt: skip
        self._launch(self.forces.reduce, self.count, forces=self.residual.faces, factor=1.0, result=self.residual)
        self._launch(self.pairs.load, self.count, longest=flow.scene.time_step, force=self.residual.linear)
        self._launch(self.residuals.pressure_force, slots, pressure=flow.mesh.pressure, forces=self.force)
        self._push(1.0, self.residual, edges_only=True)
        if again:
            flow.invert_blocks()
            self._multiply(self.solution, self.product)
            self._add(-1.0, self.product, self.residual)

    def _iterate(self) -> None:
        """Reduce the residual to the tolerance; raise :class:`ConvergenceError` if this fails."""
        history = []
        for outer in range(self.tolerances.outer + 1):
            self.error = self._relative_error()
            history.append(self.error)
            if self.error <= self.tolerances.coupled or outer == self.tolerances.outer:
                break
            change, effect = self._direction(outer)
            self._precondition(self.residual, change)
            self._multiply(change, effect)
            for earlier, its_effect in self.tried[:outer]:
                factor = self._inner_product(effect, its_effect)
                self._add(-factor, earlier, change)
                self._add(-factor, its_effect, effect)
            size = np.sqrt(self._inner_product(effect, effect))
            if not size > 0:
                break
            self._scale(1 / size, change)
            self._scale(1 / size, effect)
            factor = self._inner_product(self.residual, effect)
            self._add(factor, change, self.solution)
            self._add(-factor, effect, self.residual)
        self.outer += len(history) - 1
        if self.error > self.tolerances.coupled:
            raise ConvergenceError(self.flow.time, "coupled", len(history), history, self.error, self.tolerances.outer)

    def _new_contacts(self) -> bool:
        """Mark pairs that would overlap at the end of the step as touching, and return whether there are such pairs."""
        changed = self.flow.aggregates.pairs.changed
        changed.zero_()
        self._launch(self.pairs.touch, self.count, change=self.solution.linear)
        return bool(changed.numpy()[0])

    def _relative_error(self) -> float:
        left = self._inner_product(self.residual, self.residual)
        self._largest = max(self._largest, left)
        self._launch(self.algebra.scale_of, self.tasks + self.count, change=self.solution)
        whole = self._momentum = float(self.partial.numpy().sum())
        if left <= (ROUNDING["float64" if self.scalar is wp.float64 else "float32"]) ** 2 * self._largest:
            # Rounding errors prevent a smaller residual, so accept it. This happens in a short first step, in which
            # the weight is much larger than the momentum of the flow.
            return min(float(np.sqrt(left / whole)), self.tolerances.coupled) if whole > 0 else 0.0
        return float(np.sqrt(left / whole)) if whole > 0 else float(np.inf if left > 0 else 0.0)

    def _pressure_floor(self) -> float:
        """Return the residual norm below which a pressure solve would hardly improve the coupled solve."""
        flow, width = self.flow, min(self.flow.state.layout.room.width)
        concrete, dt = flow.scene.concrete, self._dt
        worth = (concrete.density * width**2 / dt + concrete.viscosity) / width**3
        inflow = NEGLIGIBLE * self.tolerances.coupled * np.sqrt(self._momentum / worth)
        return float(concrete.density / dt * inflow)

    def _direction(self, number: int) -> tuple[Any, Any]:
        if number >= len(self.tried):
            self.tried.append((self._vector(), self._vector()))
        return self.tried[number]

    def _scale(self, factor: float, one: Any) -> None:
        self._add(factor - 1.0, one, one)

    def _push(self, factor: float, into: Any, edges_only: bool = False) -> None:
        """Add a multiple of the pressure forces `self.force` to the forces on mortar faces and aggregates.

        With `edges_only`, the forces on mortar faces already contain the pressure forces, and the method only corrects
        them for the parts of faces that aggregates cover.
        """
        if edges_only:
            self._launch(self.forces.reduce, self.count, forces=self.force, factor=-factor, result=into)
        else:
            self._launch(self.add_faces, len(self.force), one=self.force, factor=factor, result=into.faces)
        self._launch(self.forces.push, self.count, forces=self.force, factor=factor, result=into)

    def _precondition(self, residual: Any, change: Any) -> None:
        """Apply the preconditioner: store in `change` an approximate solution for the right-hand side `residual`."""
        flow, slots = self.flow, self.flow.state.slots
        self._launch(self.residuals.request, slots, inflow=residual, projection=flow.projection.arrays)
        flow.pressure_threshold.fill_(self._pressure_floor())
        for stage in flow.pressure_stages:
            stage()
        self._launch(self.residuals.press, slots, residual=residual, solved=flow.mesh.increment, result=change)
        self._launch(self.residuals.pressure_force, slots, pressure=change.cells, forces=self.force)
        own = self.inner_residual
        for name in ("faces", "linear", "angular"):
            wp.copy(getattr(own, name), getattr(residual, name))
        self._push(1.0, own)
        self._solve_velocity(change)

    def _solve_velocity(self, solution: Any) -> None:
        """Solve the viscous equations for the velocities that the forces in `inner_residual` cause."""
        all_tasks = self.tasks + self.count
        named = {"solution": solution, "residual": self.inner_residual, "direction": self.direction}
        self._launch(self.search.begin, all_tasks, **named)
        self._sum(int(RZ))
        self._launch(self.updates.shift, 1, first=1)
        for number in range(self.tolerances.inner):
            if number % CHECKED == 0:
                sums = self.sums.numpy()
                if sums[int(RZ)] <= self.tolerances.viscous**2 * sums[int(RZ_FIRST)]:
                    return
            self._launch(self.search.multiply, self.tasks, direction=self.direction, result=self.product)
            self._launch(self.search.gather, self.count, direction=self.direction, result=self.product)
            self._sum(int(PQ))
            self._launch(self.updates.update, all_tasks, result=self.product, **named)
            self._sum(int(RZ_AFTER))
            self._launch(self.search.turn, all_tasks, direction=self.direction, result=self.product)
            self._launch(self.updates.shift, 1, first=0)
            self.inner += 1

    def _multiply(self, change: Any, effect: Any) -> None:
        """Multiply the matrix of the coupled equations with `change`, and store the product in `effect`."""
        slots = self.flow.state.slots
        self._launch(self.search.multiply, self.tasks, direction=change, result=effect)
        self._launch(self.search.gather, self.count, direction=change, result=effect)
        self._launch(self.residuals.pressure_force, slots, pressure=change.cells, forces=self.force)
        self._push(-1.0, effect)
        wp.copy(self.force, change.faces)
        self._launch(self.forces.blend, self.count, x=change, flow=self.force)
        self._launch(self.residuals.inflow, slots, change=self.force, sign=-1.0, result=effect.cells)


def _identity(value: Any) -> Any:
    """Return what tells an argument of a kernel from another one: a number itself, or the identity of an array."""
    return value if isinstance(value, (int, float)) else id(value)
