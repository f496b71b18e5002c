"""Watch over a run: stops it when its state no longer means anything."""

from __future__ import annotations

import math

from .errors import InstabilityError
from .model import Model
from .probes import deepest_sphere, fastest_body
from .series import STORED
from .state import State


class Watch:
    """Checks every row of the series; speed is also checked in every step, on the device.

    It costs a few additions a sample, since the series measures overlap and energies anyway.
    """

    def __init__(self, model: Model, state: State) -> None:
        self.model, self.state = model, state
        self.limits = model.scene.watch
        self.least = math.inf
        self.scale = 0.0

    def __call__(self, row: dict[str, float]) -> None:
        """Raises :class:`InstabilityError` naming time, body, quantity and cures."""
        time, limits = row["time"], self.limits
        broken = [name for name, value in row.items() if not math.isfinite(value)]
        if broken:
            raise unstable(time, fastest_body(self.model, self.state), f"{broken[0]} is not a finite number")
        deepest = row["deepest_overlap"]
        if limits.overlap is not None and deepest > limits.overlap:
            raise unstable(
                time,
                deepest_sphere(self.model, self.state),
                f"overlap is {deepest:.3g} of what swallows a sphere or brings it behind a wall "
                f"(watch.overlap = {limits.overlap:g})",
                "stiffer contacts, smaller bodies apart at the start, slower walls, or a higher watch.overlap",
            )
        stored = sum(row[name] for name in STORED)
        work = row["wall_work"] + row["drive_work"]
        free = stored - work
        moving = row["kinetic_energy"] + row["elastic_energy"] + row["bond_energy"]
        self.scale = max(self.scale, moving, abs(work))
        self.least = min(self.least, free)
        if limits.energy is not None and free - self.least > limits.energy * self.scale:
            raise unstable(
                time,
                fastest_body(self.model, self.state),
                f"energy grew by {free - self.least:.3g} J that no wall or drive put in, "
                f"{(free - self.least) / self.scale:.2g} of all there is (watch.energy = {limits.energy:g})",
            )


def unstable(time: float, body: int, what: str, cures: str = "") -> InstabilityError:
    """The error of a run that has become unstable."""
    cures = cures or "a smaller time step (safety below 0.8), softer contacts or bonds, more damping"
    return InstabilityError(f"t = {time:.6g} s, body {body}: {what}; usual cures: {cures}")
