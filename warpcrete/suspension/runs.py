"""Base class for runs of mortar with aggregates, in vessels and in pipes."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ..core.errors import InstabilityError
from ..core.records import Record
from ..core.run.run import Run
from ..core.units import quantity
from ..mps.common.run import FlowRun
from .aggregates import is_inside
from .balance import last_balance
from .display import SphereDisplay
from .flow import SuspensionFlow

SOLVE_BYTES = 4 * (8 * 64 + 24)
"""Memory per cell that the coupled solve of mortar and aggregates needs [bytes], in single precision.

With each search direction, the solve stores the direction's product with the matrix. A direction and its product have
eight numbers for each cell. This memory holds 64 directions; hardly any solve needs more than 60 iterations.
A GPU also stores a compact copy of the viscous matrix, with 24 numbers for each cell.
"""
DEEPEST = 0.3
"""Overlap of an aggregate with another one or with a wall, divided by the radius of the aggregate, above which the run
stops with an error."""
UNITS = {"smallest_gap": "1", "coupled_error": "1"}
"""Units of the columns that describe aggregates in every run."""


@dataclass(repr=False)
class AggregateTable:
    """Simulated aggregates on the host, in the order of their permanent numbers, without their mirror images."""

    position: np.ndarray
    """Centroids of the aggregates [m], shape (n, 3)."""
    velocity: np.ndarray
    """Velocities of the aggregates' centroids [m/s], shape (n, 3)."""
    size: np.ndarray
    """Size of each aggregate: the diameter of a sphere of equal volume [m], shape (n,)."""
    inside: np.ndarray
    """Mask of the aggregates that are at least partly in the simulated space, shape (n,)."""

    def __len__(self) -> int:
        return len(self.size)

    def __repr__(self) -> str:
        return f"<AggregateTable of {len(self)} aggregates>"


@dataclass(repr=False)
class SuspensionRun(Run):
    """Finished or interrupted run of a mortar with aggregates: series, results and final aggregates."""

    bodies: AggregateTable = field(kw_only=True)
    """Aggregates at the end of the run."""


class AggregateRun(FlowRun):
    """Run of a mortar with aggregates, in a vessel or in a pipe."""

    flow: SuspensionFlow
    method = "suspension"
    drawn_by: ClassVar[type[SphereDisplay]]  # pyright: ignore[reportIncompatibleVariableOverride]

    def result(self, finished: bool) -> SuspensionRun:
        """Return the results of the run so far: its time series, quantities, tables and aggregates.

        `finished` is stored in the results; it is False if the run was interrupted.
        """
        run, bodies, display = super().result(finished), self.flow.aggregates, self.drawn_by(self)
        centre, velocity = (each.numpy().astype(float) for each in (bodies.bodies.centre, bodies.bodies.velocity))
        origin = display.images(np.zeros((1, 3)))[0]
        table = AggregateTable(
            position=display.images(centre)[0],
            velocity=display.images(velocity)[0] - origin,
            size=2 * bodies.radius,
            inside=is_inside(centre),
        )
        return SuspensionRun(
            run.scene, run.series, run.units, run.result, run.finished, tables=run.tables, bodies=table
        )

    def aggregate_columns(self) -> dict[str, float]:
        """Return two columns of the time series: the smallest gap of any sphere, and the error of the coupled solve.

        The gap is divided by the radius of the sphere. The error is the residual of the coupled solve, relative to the
        flow's momentum or to its change.
        """
        gap = self.flow.aggregates.smallest_gap() if self.flow.steps else 0.0
        return {"smallest_gap": min(gap, 1.0), "coupled_error": self.flow.coupled.error}

    def watch_row(self, row: dict[str, float]) -> None:
        """Raise :class:`InstabilityError` if a value is not finite, or if aggregates overlap too far.

        The limit of an overlap with a neighbour or wall is DEEPEST times the radius of the aggregate.
        """
        super().watch_row(row)
        if row["smallest_gap"] < -DEEPEST:
            raise InstabilityError(
                f"two aggregates, or an aggregate and a wall, overlap by {-row['smallest_gap']:.2g} of an aggregate's "
                f"radius; the limit is {DEEPEST:g}",
                time=row["time"],
                cure=self.cure,
            )

    @property
    def fraction(self) -> float:
        """Volume of the placed aggregates divided by the volume of the concrete."""
        layout = self.flow.state.layout
        volume = float(np.sum(layout.mass)) * layout.volume
        return 4 / 3 * np.pi * float(np.sum(self.flow.aggregates.radius**3)) / volume

    def aggregate_sizes(self) -> Record:
        """Return number and volume fraction of the aggregates and the balance of momentum, for the run's result.

        With a sieve curve, also return the stated fraction and the smallest simulated size. Smaller aggregates count as
        mortar. If only a half or a quarter is simulated, `count` is the number in this part, and `count_whole` includes
        the mirror images. The result also contains them as `aggregate_count` and `aggregate_count_whole`. The balance
        of momentum belongs to the last time step and to the last axis of the grid. The balance is missing if the last
        step is incomplete, or if the program has taken no step since it started. Its error is larger if aggregates
        enter at a given speed.
        """
        count = self.flow.aggregates.count
        whole = count * self.drawn_by(self).copies
        entry = {"count": count, "count_whole": whole, "fraction": self.fraction}
        numbers = {"aggregate_count": count, "aggregate_count_whole": whole}
        if self.scene.sieve is not None:
            entry |= {
                "stated_fraction": self.scene.aggregate_fraction,
                "smallest": quantity(self.scene.diameters[0], "m"),
            }
        if not self.flow.step_is_complete:
            return numbers | {"aggregates": entry}
        last = last_balance(self.flow)
        momentum = {
            "change": quantity(last.momentum, "N"),
            "forces": quantity(last.impulse, "N"),
            "error": last.momentum_error,
        }
        return numbers | {"aggregates": entry, "momentum_balance": momentum}
