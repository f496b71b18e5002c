"""Base class for runs of mortar with aggregates, in vessels and in pipes."""

import numpy as np

from ..core.errors import InstabilityError
from ..core.records import Record
from ..core.units import quantity
from ..mps.common.run import FlowRun
from .balance import last_balance
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


class AggregateRun(FlowRun):
    """Run of a mortar with aggregates, in a vessel or in a pipe."""

    flow: SuspensionFlow
    method = "suspension"

    def aggregate_columns(self) -> dict[str, float]:
        """Return two columns of the time series: the smallest gap of any sphere, and the error of the coupled solve.

        The gap is divided by the radius of the sphere, and the error by the flow's momentum.
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
        mortar. The balance of momentum is that of the last time step, along the last axis of the grid. It is missing if
        the coupled solve has not changed the flow since the program started. Its error is larger if aggregates enter at
        a given speed.
        """
        entry = {"count": self.flow.aggregates.count, "fraction": self.fraction}
        if self.scene.sieve is not None:
            entry |= {
                "stated_fraction": self.scene.aggregate_fraction,
                "smallest": quantity(self.scene.diameters[0], "m"),
            }
        if self.flow.coupled.outer == 0:
            return {"aggregates": entry}
        last = last_balance(self.flow)
        momentum = {
            "change": quantity(last.momentum, "N"),
            "forces": quantity(last.impulse, "N"),
            "error": last.momentum_error,
        }
        return {"aggregates": entry, "momentum_balance": momentum}
