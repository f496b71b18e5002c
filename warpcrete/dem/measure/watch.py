"""Check the state of a run against limits, and stop the run when the state has become meaningless."""

import math

import numpy as np
import warp as wp

from ..engine.failures import unstable
from ..engine.model import Model
from ..engine.state import State
from .probes import deepest_sphere, farthest_body, fastest_body
from .sampling import STORED

MAX_ROUNDING = (
    # Largest allowed rounding error of positions, divided by the smallest radius. With this error, an overlap of 1 % of
    # the radius is accurate to one digit.
    1e-3
)


class Watch:
    """Check of every row of the time series against the limits of the scene; speeds are also checked in every step.

    The checks cost little, because the overlaps and energies that they need are recorded in each row anyway.
    """

    def __init__(self, model: Model, state: State) -> None:
        self.model, self.state = model, state
        self.limits = model.scene.watch
        self.rounding = float(np.finfo(np.float64 if model.scalar is wp.float64 else np.float32).eps)
        # Changes of energy smaller than `floor` are ignored. `floor` is the energy that lifts all bodies by a hundredth
        # of the smallest radius.
        mass = state.total_mass
        self.floor = 0.01 * mass * float(np.linalg.norm(model.scene.gravity)) * state.smallest_radius
        self.least = math.inf
        self.scale = 0.0  # Largest energy (kinetic plus elastic) or work in the rows of the time series so far [J].

    def state_dict(self) -> dict[str, float]:
        """Return the energies in earlier rows of the time series; later rows are compared with them."""
        return {"least": self.least, "scale": self.scale}

    def load_state_dict(self, state: dict[str, float]) -> None:
        """Restore the energies in earlier rows of the time series from a `state_dict`."""
        self.least, self.scale = state["least"], state["scale"]

    def _resolution(self, row: dict[str, float]) -> float:
        """Return the rounding error of positions divided by the radius of the smallest sphere."""
        return self.rounding * row["reach"] / self.state.smallest_radius if self.state.body_count else 0.0

    def __call__(self, row: dict[str, float]) -> None:
        """Raise :class:`InstabilityError` if a row of the time series exceeds a limit of the scene.

        The error names the time, the body concerned and settings that may help.
        """
        time, limits = row["time"], self.limits
        broken = [name for name, value in row.items() if not math.isfinite(value)]
        if broken:
            text = f"{broken[0]} is not a finite number"
            raise unstable(time, fastest_body(self.model, self.state), text, scene=self.model.scene)
        deepest = row["deepest_overlap"]
        if limits.overlap is not None and deepest > limits.overlap:
            raise unstable(
                time,
                deepest_sphere(self.model, self.state),
                f"a sphere overlaps its neighbour or a wall by {deepest:.3g} times the overlap at which it would pass "
                f"through; the limit is watch.overlap = {limits.overlap:g}",
                "stiffer contacts, bodies that do not overlap at the start, slower walls, or a higher watch.overlap "
                "(the scene's parameter 'overlap_limit')",
                self.model.scene,
            )
        resolution = self._resolution(row)
        if resolution > MAX_ROUNDING:
            raise unstable(
                time,
                farthest_body(self.state),
                f"positions {row['reach']:.4g} m from the origin are rounded to {resolution:.2g} of the smallest "
                f"sphere's radius; the limit is {MAX_ROUNDING:g}",
                "'precision' float64, or positions nearer to the origin",
            )
        work, free = row["wall_work"] + row["drive_work"], _free(row)
        # A contact law with attraction can make the elastic energy negative. Use its absolute value, because only the
        # magnitude of the energy matters for the energy scale of the scene.
        moving = row["kinetic_energy"] + abs(row["elastic_energy"]) + row["bond_energy"]
        self.scale = max(self.scale, moving, abs(work), self.floor)
        self.least = min(self.least, free)
        if limits.energy is not None and free - self.least > limits.energy * self.scale:
            raise unstable(
                time,
                fastest_body(self.model, self.state),
                f"energy grew by {free - self.least:.3g} J without work of a wall or drive; this increase is "
                f"{(free - self.least) / max(self.scale, 1e-300):.2g} of the largest energy in the scene so far; the "
                f"limit of this fraction is watch.energy = {limits.energy:g}",
                scene=self.model.scene,
            )


def _free(row: dict[str, float]) -> float:
    """Return the stored energy minus the work of walls and driving forces [J].

    Only dissipation may change this difference.
    """
    return sum(row[name] for name in STORED) - (row["wall_work"] + row["drive_work"])
