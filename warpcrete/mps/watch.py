"""Monitor of a flow, which stops the run when its state is no longer meaningful."""

import math

from ..core.errors import InstabilityError
from ..theory.pipe import velocity
from .scene import FluidScene

FINITE_COLUMNS = ("pressure", "wall_stress", "fastest", "volume_error", "momentum")
"""Columns of the time series in which a value that is not finite stops the run."""
CURES = "a smaller time step, a finer spacing, precision float64"
COLUMN_CURES = {
    False: "; if the concrete is sheared: ends = periodic",
    True: "; if the concrete is sheared: one phase without aggregates",
}
"""Text that is added to the error message if the unstable flow is a column of particles on a piston. The key is True
for a column with aggregates. Such a column cannot be simulated on a grid, so its advice differs."""


class WatchedFlow:
    """Monitor that stops a run if a row of its time series exceeds the limits in the scene's `watch`."""

    def __init__(self, scene: FluidScene) -> None:
        self.limits = scene.watch
        self.cures = CURES + (COLUMN_CURES[scene.aggregates is not None] if scene.ends == "piston" else "")
        theory = scene.theory()
        self.pressure = scene.restart().pressure
        self.top_speed = float(velocity(scene.concrete, scene.line, theory, [0.0])[0])

    def __call__(self, row: dict[str, float]) -> None:
        """Raise :class:`InstabilityError` if a value in a `row` of the time series exceeds its limit or is not finite.

        The error names the time, the quantity, its limit and possible cures.
        """
        limits = self.limits
        for name in FINITE_COLUMNS:
            if not math.isfinite(row[name]):
                raise self._unstable(row, f"{name} is not a finite number")
        if limits.speed is not None and row["fastest"] > limits.speed * self.top_speed:
            raise self._unstable(
                row,
                f"the fastest particle moves at {row['fastest']:.3g} m/s, but theory gives at most "
                f"{self.top_speed:.3g} m/s; the limit is watch.speed = {limits.speed:g} times theory",
            )
        if limits.pressure is not None and abs(row["pressure"]) > limits.pressure * abs(self.pressure):
            raise self._unstable(
                row,
                f"the pressure on the piston is {row['pressure']:.4g} Pa, but theory gives {self.pressure:.4g} "
                f"Pa; the limit is watch.pressure = {limits.pressure:g} times theory",
            )
        if limits.volume is not None and abs(row["volume_error"]) > limits.volume:
            raise self._unstable(
                row,
                f"the concrete has lost or gained {abs(row['volume_error']):.3g} of its volume; the limit is "
                f"watch.volume = {limits.volume:g}",
            )
        balance = row["force_balance_error"]
        # Do not check the balance of forces before the first step, when the wall stress is still zero.
        if limits.force_balance is not None and row["time"] > 0 and not abs(balance) <= limits.force_balance:
            raise self._unstable(
                row,
                f"forces do not balance: the resultant is {balance:.3g} of the piston's force; the limit is "
                f"watch.force_balance = {limits.force_balance:g}",
            )

    def _unstable(self, row: dict[str, float], what: str) -> InstabilityError:
        return InstabilityError(what, time=row["time"], cure=self.cures)
