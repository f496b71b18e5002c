"""Coupled solve of mortar velocity, rigid aggregates and pressure in one time step.

Flows without aggregates solve for velocity and pressure one after the other. With aggregates, this would cause errors
of about a third in the velocities of the aggregates. The method of generalised conjugate residuals (Eisenstat, Elman &
Schultz 1983) therefore solves for velocities and pressure together, up to a tolerance.

The preconditioner follows Cahouet & Chabard (1988). It turns a residual into approximate changes of pressure and
velocities. The pressure is the solution of a pressure solve for the net inflow in the residual, plus a multiple of the
net inflow that depends on the cell. A viscous solve with the forces of this pressure then gives the velocities.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from ..core.device.arrays import Kernel
from ..core.device.launching import Arguments, Stage, completed
from ..core.errors import CapacityError, ConvergenceError
from ..dem.engine.stages import warp_width
from ..kernels.common.reductions import BLOCK
from ..kernels.mps.grid.cells import DT
from ..kernels.suspension.compact import ENTRIES, compact_kernels, compact_struct
from ..kernels.suspension.coupling import advance_kernels, pressure_kernels, product_kernels, residual_kernels
from ..kernels.suspension.pairs import CAPACITY, pair_kernels
from ..kernels.suspension.vectors import PQ, RZ, RZ_AFTER, RZ_FIRST, SUMS, add_kernel, sum_kernel
from ..kernels.suspension.velocity import force_kernels, gather_kernel, search_kernels, update_kernels
from ..mps.common.allocation import allocate
from .directions import CHUNK, Directions

CPU_TASKS = 32
"""Number of tasks that share the faces of the grid in a solve on a CPU."""
GPU_TASKS = 64 * BLOCK
"""Minimum number of tasks that share the faces of the grid on a GPU. A larger grid has about as many tasks as cells."""
ROUNDING = {"float32": 1e-6, "float64": 1e-14}
"""Smallest residual that rounding errors allow, divided by the largest residual of the step, by precision."""
NEGLIGIBLE = 0.1
"""Residual at which a pressure solve of the preconditioner may stop, as a fraction of the residual that the coupled
solve accepts. A smaller residual would hardly improve the coupled solve."""
PASSES, CANCELLED = 2, 0.1
"""PASSES: maximum number of times that a search direction is made orthogonal to all earlier ones. CANCELLED: the work
is repeated if it has reduced the norm of the direction's effect to less than this fraction. Without the repetition, the
residual of a slump test in single precision stopped falling at 3e-3."""
CONTACT_PASSES = 3
"""Maximum number of coupled solves in a step. A solve that finds new contacts is repeated with these contacts."""
ROUGH_ERROR, CERTAIN = 3e-2, 0.9
"""Limits of an early search for contacts, which avoids most repeated solves. The search takes place as soon as the
error of the solve falls below ROUGH_ERROR. The velocities are not yet accurate then, so a pair counts as a contact only
if it would overlap even at the fraction CERTAIN of its speed of approach. In 50 steps of five flows, no pair was put in
contact that would not have been in contact after the solve."""
KEPT_DIRECTIONS = 60
"""Largest number of search directions that a repeated solve reuses. If the previous solve has stored more directions,
all of them are discarded, because memory and the work of orthogonalisation would grow with each repetition."""
VISCOUS, VISCOUS_WITH_YIELD, CHECKED = 0.5, 0.25, 7
"""Accuracy of the viscous solves of the preconditioner.

A viscous solve stops when the norm of its residual has fallen to the fraction VISCOUS of the norm at its start, or to
the fraction VISCOUS_WITH_YIELD if the mortar has a yield stress. The solve checks this condition only after every
CHECKED iterations, so a solve makes at least CHECKED iterations: with fewer, the coupled solve would need more
iterations than they save. A check also makes the host wait for the GPU. `notebooks/development/notes-suspension.md`
gives times with other values.

A mortar with a yield stress needs more exact viscous solves, because its viscosity differs by a factor of up to 1000
from cell to cell. With VISCOUS, the first ten steps of a slump test needed 147 iterations of the coupled solve instead
of 106.
"""


@dataclass(frozen=True)
class Tolerances:
    """Tolerances and iteration limits of the coupled solve and of the solves in its preconditioner."""

    coupled: float = 1e-4
    """Norm of the residual at which the coupled solve stops, divided by the norm of the flow's momentum."""
    change: float = 1e-2
    """Second condition at which the coupled solve stops: norm of the residual, divided by the norm at the start of the
    step.

    The residual at the start of a step is the force that changes the momentum. In a very short step, the change is much
    smaller than the momentum, so the first condition alone would accept a solution that lacks a large part of it."""
    pressure: float = 0.9
    """Residual norm at which a pressure solve of the preconditioner stops, divided by the norm at its start.

    Most pressure solves then stop after their first iteration. With a multigrid preconditioner, more exact pressure
    solves do not save iterations of the coupled solve.
    """
    pressure_single_level: float = 0.1
    """Residual norm at which a pressure solve stops on a grid without multigrid, divided by the norm at its start.

    On such a grid, the first iterations hardly change a pressure that varies slowly in space. If a pressure solve
    stopped after them, inflow and outflow of the whole grid would differ by some tenths of a per cent."""
    outer: int = 200
    """Maximum number of iterations of the coupled solve."""
    inner: int = 5000
    """Maximum number of iterations of a viscous solve."""


class CoupledSolve:
    """Solver of the coupled equations of mortar, aggregates and pressure in a :class:`SuspensionFlow`."""

    def __init__(self, flow: Any, tolerances: Tolerances) -> None:
        self.flow, self.tolerances = flow, tolerances
        self.device, self.scalar = flow.device, flow.scalar
        serial = not flow.parallel
        self.tasks = CPU_TASKS if serial else max(GPU_TASKS, flow.state.slots // BLOCK * BLOCK)
        kind = flow.state.layout.kind
        bodies = flow.aggregates.kind
        self.search, self.forces = search_kernels(self.scalar, serial, kind), force_kernels(self.scalar, kind)
        self.gather = gather_kernel(self.scalar, serial, kind, bodies)
        self.updates = update_kernels(self.scalar, serial, kind)
        self.residuals = residual_kernels(self.scalar, serial, kind)
        self.pressures = pressure_kernels(self.scalar, serial, kind)
        self.products = product_kernels(self.scalar, serial, kind)
        self.moves = advance_kernels(self.scalar, serial, kind)
        self.add_faces = add_kernel(self.scalar)
        self.pairs = pair_kernels(self.scalar, bodies)
        self.add_up = sum_kernel(serial)
        self.count = flow.aggregates.count
        # `for_bodies` is the number of tasks that work on aggregates; on a GPU these tasks fill whole blocks.
        # `partials` is the number of partial sums of an inner product.
        self.for_bodies = self.count if serial else -(-self.count * warp_width(self.device) // BLOCK) * BLOCK
        self.all_tasks = self.tasks + self.for_bodies
        self.partials = self.all_tasks // (1 if serial else BLOCK)
        slots = flow.state.slots
        self.directions = Directions(
            self.scalar, self.device, {"faces": 3 * slots, "linear": self.count, "angular": self.count, "cells": slots}
        )
        self.partial = wp.zeros(CHUNK * self.partials, dtype=wp.float64, device=self.device)
        self.sums = wp.zeros(SUMS + CHUNK, dtype=wp.float64, device=self.device)
        self.factors = wp.zeros(CHUNK, dtype=wp.float64, device=self.device)
        self.residual, self.inner_residual, self.direction, self.product = (self._vector() for _ in range(4))
        self.solution, self.weighted = self._vector(), self._vector()
        self.inflow = wp.zeros(flow.state.slots, dtype=self.scalar, device=self.device)
        self.yielding = wp.zeros(flow.state.slots, dtype=self.scalar, device=self.device)
        self.inverse = wp.zeros(3 * flow.state.slots, dtype=self.scalar, device=self.device)
        self.force = wp.zeros(3 * flow.state.slots, dtype=self.scalar, device=self.device)
        # Only a GPU uses a compact copy of the viscous matrix. A CPU reads the rows of the exact matrix one after the
        # other, which is fast enough.
        self.compact: Any = None
        if not serial:
            sizes = {"entries": 3 * ENTRIES // 2 * slots, "diagonal": 3 * slots}
            self.compact = allocate(compact_struct(self.scalar), self.device, **sizes)
            self.compacts = compact_kernels(self.scalar, serial, kind)
        self._viscous = VISCOUS_WITH_YIELD if flow.scene.concrete.yield_stress > 0 else VISCOUS
        self._stages: dict[Any, Stage] = {}
        self.outer = 0
        self.inner = 0
        self.error = 0.0
        # Norm with which the norm of the residual is compared, and two residuals of the step: the largest, and the one
        # at the start.
        self._scale = 0.0
        self._largest = 0.0
        self._start: float | None = None
        self._dt = 0.0

    def _vector(self) -> Any:
        return self.directions.vector()

    def _launch(self, kernel: Kernel, tasks: int, **named: object) -> None:
        # A launch is recorded once for each set of arguments and then repeated; only the argument `factor` may change
        # between repetitions.
        key = (id(kernel), tasks, *((name, _identity(value)) for name, value in named.items() if name != "factor"))
        if key not in self._stages:
            self._stages[key] = Stage(kernel, tasks, completed(kernel, named, self._arrays), self.device, block=BLOCK)
        stage = self._stages[key]
        if "factor" in named:
            stage.set("factor", named["factor"])
        stage()

    @property
    def _arrays(self) -> Arguments:
        flow = self.flow
        return flow.kernel_arrays | {
            "tasks": self.tasks, "partials": self.partials, "first": self.tasks // (BLOCK if flow.parallel else 1),
            "factors": self.factors, "inverse": self.inverse, "yielding": self.yielding, "matrix": flow.viscous.matrix,
            "compact": self.compact, "partial": self.partial, "sums": self.sums,
        }  # fmt: skip

    def _sum(self, slot: int, sums: int = 1) -> None:
        """Add up the partial sums of several inner products on the device.

        `sums` is the number of inner products. The results are stored in `self.sums` from the index `slot` on.
        """
        block = 1 if not self.flow.parallel else BLOCK
        self._launch(self.add_up, sums * block, count=self.partials, slot=slot)

    def _products(self, *vectors: tuple[int, Any]) -> np.ndarray:
        """Return the inner products of the vector `weighted` with other vectors.

        Each of `vectors` is a pair: a number of vectors, and the struct of arrays that holds these vectors.
        """
        slot = 0
        for count, many in vectors:
            self._launch(
                self.products.products, self.all_tasks, count=count, slot=slot, weighted=self.weighted,
                many=many,
            )  # fmt: skip
            slot += count
        self._sum(SUMS, slot)
        return self.sums.numpy()[SUMS : SUMS + slot]

    def _subtract(self, factors: np.ndarray, many: Any, result: Any) -> None:
        self.factors.assign(np.pad(factors, (0, CHUNK - len(factors))))
        self._launch(self.products.combine, self.all_tasks, count=len(factors), many=many, result=result)

    def solve(self) -> None:
        """Solve for the velocities and pressures at the end of the step, and store them.

        Raises :class:`ConvergenceError` if the tolerance is not reached.
        """
        flow = self.flow
        for array in (self.solution.faces, self.solution.linear, self.solution.angular, self.solution.cells):
            array.zero_()
        self.inner, self.outer, self._largest, self._start = 0, 0, 0.0, None
        self._dt = float(flow.mesh.clock.numpy()[int(DT)])
        self.directions.known = self.directions.orthogonal = 0
        if self.compact is not None:
            self._launch(self.compacts.compress, 3 * flow.state.slots)
        self._begin(again=False)
        self._iterate(max(self.tolerances.coupled, ROUGH_ERROR))
        if self._new_contacts(CERTAIN):
            self._begin(again=True)
        for turn in range(CONTACT_PASSES):
            self._iterate(self.tolerances.coupled)
            if not self._new_contacts() or turn == CONTACT_PASSES - 1:
                break
            self._begin(again=True)
        self._launch(self.moves.finish, self.all_tasks, solution=self.solution)
        if flow.aggregates.pairs.full.numpy()[0]:
            raise CapacityError(
                f"t = {flow.time:.6g} s: an aggregate has more than {int(CAPACITY)} neighbours; use aggregates whose "
                "sizes differ less"
            )

    def mean_velocity(self) -> np.ndarray:
        """Return the velocity across each face [m/s], averaged over mortar and aggregates in it, shape (3, *shape)."""
        self._launch(self.forces.blend, self.for_bodies, x=self._present(), flow=self.product.faces)
        return self.product.faces.numpy().astype(float).reshape(3, *self.flow.state.shape)

    def pressure_forces(self) -> None:
        """Compute the forces of the present pressure on all faces [N], and store them in `force`."""
        flow = self.flow
        self._launch(self.residuals.pressure_force, flow.state.slots, pressure=flow.mesh.pressure, forces=self.force)

    def _present(self) -> Any:
        """Return the vector of the present velocities, stored in the arrays of `self.product`."""
        flow, bodies = self.flow, self.flow.aggregates.bodies
        present = self.product
        for name, array in (("faces", flow.mesh.velocity), ("linear", bodies.velocity), ("angular", bodies.spin)):
            wp.copy(getattr(present, name), array)
        return present

    def _begin(self, again: bool) -> None:
        """Compute the residual of the coupled equations for the current solution.

        The solution is still zero, unless the solve is repeated with new contacts (`again`).
        """
        flow, slots = self.flow, self.flow.state.slots
        # Earlier stages computed pressure forces and inflows as if faces that aggregates cover in part were mortar
        # only. Correct both for the covered parts.
        start = self._present()
        self._launch(self.forces.blend, self.for_bodies, x=start, flow=start.faces)
        self._launch(self.add_faces, 3 * slots, one=flow.mesh.velocity, factor=-1.0, result=start.faces)
        self._launch(self.residuals.inflow, slots, change=start.faces, sign=1.0, result=self.residual.cells)
        self._launch(self.residuals.start, self.all_tasks, viscous=flow.viscous.arrays,
                     projection=flow.projection.arrays, inflow=self.inflow, again=int(again),
                     residual=self.residual)  # fmt: skip
        self._launch(self.forces.reduce, self.for_bodies, forces=self.residual.faces, factor=1.0, result=self.residual)
        self._launch(self.pairs.load, self.count, longest=flow.scene.time_step, forces=self.residual)
        self._launch(self.residuals.pressure_force, slots, pressure=flow.mesh.pressure, forces=self.force)
        self._push(1.0, self.residual, edges_only=True)
        if again:
            flow.invert_blocks()
            self._multiply(self.solution, self.product)
            self._subtract(np.ones(1), self.product, self.residual)

    def _iterate(self, tolerance: float) -> None:
        """Reduce the residual to a tolerance; raise :class:`ConvergenceError` if this fails.

        A repeated solve, with new contacts, first uses the search directions that the previous solve has stored.
        """
        directions = self.directions
        first = directions.orthogonal
        if first == 0:
            self.error = self._advance(0.0, self.direction, self.product)
        history = [self.error]
        end = max(directions.known, first) + self.tolerances.outer
        while self.error > tolerance and directions.orthogonal < end:
            number = directions.orthogonal
            change, effect = directions[number]
            if number >= directions.known:
                self._precondition(self.residual, change)
                self._multiply(change, effect)
                self.outer += 1
            factor = self._orthogonalise(number)
            self.error = self._advance(factor, change, effect)
            history.append(self.error)
            directions.known = max(directions.known, number + 1)
            if not factor:
                break
        if self.error > tolerance:
            most = self.tolerances.outer
            raise ConvergenceError(self.flow.time, "coupled", len(history) - 1, history, self.error, most)

    def _orthogonalise(self, number: int) -> float:
        """Make the effect of a search direction orthogonal to earlier effects, and return the best step along it.

        The effect is the product of the matrix with the direction. The best step is the one that minimises the
        residual. The step is 0 if the effect is zero.

        If a subtraction removes most of an effect, rounding errors leave the remainder far from orthogonal, so the
        subtraction is repeated (Daniel, Gragg, Kaufman & Stewart 1976).
        """
        change, effect = self.directions[number]
        self._weigh(effect)
        size, along = self._products((1, effect), (1, self.residual))
        for _ in range(PASSES if number else 0):
            before = float(size)
            for first, count, changes, effects in self.directions.before(number):
                factors = self.directions.factors(first, self._products((count, effects)))
                self._subtract(factors, changes, change)
                self._subtract(factors, effects, effect)
            self._weigh(effect)
            size, along = self._products((1, effect), (1, self.residual))
            if size > CANCELLED**2 * before:
                break
        self.directions.add_norm(float(size) if size > 0 else np.inf)
        return float(along / size) if size > 0 else 0.0

    def _weigh(self, one: Any) -> None:
        self._launch(self.products.weigh, self.all_tasks, one=one, weighted=self.weighted)

    def _new_contacts(self, certain: float = 1.0) -> bool:
        """Mark pairs that would overlap at the end of the step as touching, and return whether there are new contacts.

        A pair counts if it would overlap even at the fraction `certain` of its speed of approach. New contacts change
        the matrix, so the effects of the stored search directions are updated.
        """
        changed, directions = self.flow.aggregates.pairs.changed, self.directions
        changed.zero_()
        self._launch(self.pairs.touch, self.count, change=self.solution, certain=certain)
        if not changed.numpy()[0]:
            return False
        if directions.known > KEPT_DIRECTIONS:
            directions.known = 0
        for _, count, changes, effects in directions.before(directions.known):
            self._launch(self.pairs.stiffen, self.count, count=count, change=changes, effect=effects)
        directions.orthogonal = 0
        return True

    def _advance(self, factor: float, change: Any, effect: Any) -> float:
        """Move the solution by `factor` along a direction, and return the relative residual.

        The relative residual is the norm of the residual, divided by the norm of the flow's momentum. The divisor is
        smaller if the change of the momentum is small: a relative residual of `Tolerances.coupled` then means that the
        residual has fallen to the fraction `Tolerances.change` of the residual at the start of the step.
        """
        self._launch(
            self.moves.advance, self.all_tasks, factor=factor, change=change, effect=effect,
            solution=self.solution, residual=self.residual,
        )  # fmt: skip
        self._sum(SUMS, 2)
        left, momentum = map(float, np.sqrt(self.sums.numpy()[SUMS : SUMS + 2]))
        rounding = ROUNDING["float64" if self.scalar is wp.float64 else "float32"]
        if self._start is None:
            self._start = left
        self._largest = max(self._largest, left)
        smallest = max(self.tolerances.change * self._start, rounding * momentum)
        self._scale = min(momentum, smallest / self.tolerances.coupled)
        if self._scale == 0.0:
            return float(np.inf if left > 0 else 0.0)
        # Rounding errors prevent a residual that is much smaller than the largest of the step, so accept the present
        # solution. This case occurs in a short first step, in which the weight is much larger than the momentum.
        accepted = left <= rounding * self._largest
        return min(left / self._scale, self.tolerances.coupled if accepted else np.inf)

    def _pressure_floor(self) -> float:
        """Return the residual norm below which a pressure solve would hardly improve the coupled solve."""
        flow, width = self.flow, min(self.flow.state.layout.room.width)
        concrete, dt = flow.scene.concrete, self._dt
        worth = (concrete.density * width**2 / dt + concrete.viscosity) / width**3
        inflow = NEGLIGIBLE * self.tolerances.coupled * self._scale / np.sqrt(worth)
        return float(concrete.density / dt * inflow)

    def _push(self, factor: float, into: Any, edges_only: bool = False) -> None:
        """Add a multiple of the pressure forces `self.force` to the forces on mortar faces and aggregates.

        With `edges_only`, the forces on mortar faces already contain the pressure forces, and the method only corrects
        them for the parts of faces that aggregates cover.
        """
        if edges_only:
            self._launch(self.forces.reduce, self.for_bodies, forces=self.force, factor=-factor, result=into)
        else:
            self._launch(self.add_faces, len(self.force), one=self.force, factor=factor, result=into.faces)
        self._launch(self.forces.push, self.for_bodies, forces=self.force, factor=factor, result=into)

    def _precondition(self, residual: Any, change: Any) -> None:
        """Apply the preconditioner: store an approximate solution for the right-hand side `residual` in `change`."""
        flow, slots = self.flow, self.flow.state.slots
        self._launch(self.pressures.request, slots, inflow=residual, projection=flow.projection.arrays)
        flow.pressure_threshold.fill_(self._pressure_floor())
        for stage in flow.pressure_stages:
            stage()
        self._launch(self.pressures.press, slots, residual=residual, solved=flow.mesh.increment, result=change)
        self._launch(self.residuals.pressure_force, slots, pressure=change.cells, forces=self.force)
        own = self.inner_residual
        for name in ("faces", "linear", "angular"):
            wp.copy(getattr(own, name), getattr(residual, name))
        self._push(1.0, own)
        self._solve_velocity(change)

    def _solve_velocity(self, solution: Any) -> None:
        """Solve the viscous equations for the velocities that the forces in `inner_residual` cause."""
        named = {"solution": solution, "residual": self.inner_residual, "direction": self.direction}
        self._launch(self.search.begin, self.all_tasks, **named)
        self._sum(int(RZ))
        self._launch(self.updates.shift, 1, first=1)
        multiply = self.search.multiply if self.compact is None else self.compacts.multiply
        for number in range(self.tolerances.inner):
            if number % CHECKED == 0:
                sums = self.sums.numpy()
                # The solve also ends if p.Ap is not positive for a search direction p, which the rounding errors of the
                # compact matrix A may cause.
                if sums[int(RZ)] <= self._viscous**2 * sums[int(RZ_FIRST)] or (number > 0 and sums[int(PQ)] <= 0.0):
                    return
            self._launch(multiply, self.tasks, direction=self.direction, result=self.product)
            self._launch(self.gather, self.for_bodies, direction=self.direction, result=self.product)
            self._sum(int(PQ))
            self._launch(self.updates.update, self.all_tasks, result=self.product, **named)
            self._sum(int(RZ_AFTER))
            self._launch(self.search.turn, self.all_tasks, direction=self.direction, result=self.product)
            self._launch(self.updates.shift, 1, first=0)
            self.inner += 1

    def _multiply(self, change: Any, effect: Any) -> None:
        """Multiply the matrix of the coupled equations by the vector `change`, and store the product in `effect`."""
        slots = self.flow.state.slots
        self._launch(self.search.multiply, self.tasks, direction=change, result=effect)
        self._launch(self.gather, self.for_bodies, direction=change, result=effect)
        self._launch(self.residuals.pressure_force, slots, pressure=change.cells, forces=self.force)
        self._push(-1.0, effect)
        wp.copy(self.force, change.faces)
        self._launch(self.forces.blend, self.for_bodies, x=change, flow=self.force)
        self._launch(self.residuals.inflow, slots, change=self.force, sign=-1.0, result=effect.cells)


def _identity(value: Any) -> Any:
    """Return a key that identifies an argument of a kernel: a number itself, or the identity of an object."""
    return value if isinstance(value, (int, float)) else id(value)
