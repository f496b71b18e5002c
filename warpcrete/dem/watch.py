"""Watch over a run: stops it when its state no longer means anything."""

from __future__ import annotations

import math

import numpy as np
import warp as wp

from ..core.errors import InstabilityError
from .model import Model
from .probes import deepest_sphere, farthest_body, fastest_body
from .sampling import STORED
from .state import State

CALM = 0.8
"""Of what is watched for, below which no row is expected to pass it."""
COARSEST = 1e-3  # rounding of positions over the smallest radius; overlaps of a per cent then keep one digit


class Watch:
    """Checks every row of the series; speed is also checked in every step, on the device.

    It costs a few additions a sample, since the series measures overlap and energies anyway.
    """

    def __init__(self, model: Model, state: State) -> None:
        self.model, self.state = model, state
        self.limits = model.scene.watch
        self.rounding = float(np.finfo(np.float64 if model.scalar is wp.float64 else np.float32).eps)
        # Less than what lifts everything by a hundredth of the smallest radius is of no interest.
        mass = state.total_mass
        self.floor = 0.01 * mass * float(np.linalg.norm(model.scene.gravity)) * state.smallest_radius
        self.least = math.inf
        self.scale = 0.0  # the energy in play, at its largest so far

    def state_dict(self) -> dict[str, float]:
        """What it compares with."""
        return {"least": self.least, "scale": self.scale}

    def load_state_dict(self, state: dict[str, float]) -> None:
        """Go on from a `state_dict`."""
        self.least, self.scale = state["least"], state["scale"]

    def is_calm(self, row: dict[str, float]) -> bool:
        """Whether after such a row, which it has seen, the next will hardly raise anything."""
        limits = self.limits
        calm = limits.overlap is None or row["deepest_overlap"] < CALM * limits.overlap
        calm = calm and self._resolution(row) < CALM * COARSEST
        return calm and (limits.energy is None or _free(row) - self.least < CALM * limits.energy * self.scale)

    def _resolution(self, row: dict[str, float]) -> float:
        """To what part of the smallest sphere's radius positions are rounded."""
        return self.rounding * row["reach"] / self.state.smallest_radius if self.state.body_count else 0.0

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
                f"the overlap is {deepest:.3g} of the overlap that swallows a sphere or brings it behind a wall "
                f"(watch.overlap = {limits.overlap:g})",
                "stiffer contacts, smaller bodies apart at the start, slower walls, or a higher watch.overlap "
                "(overlap_limit of the scene pipe)",
            )
        resolution = self._resolution(row)
        if resolution > COARSEST:
            raise unstable(
                time,
                farthest_body(self.state),
                f"positions are rounded to {resolution:.2g} of the smallest sphere's radius at {row['reach']:.4g} m "
                "from the origin",
                "precision float64, or a scene nearer to the origin",
            )
        work, free = row["wall_work"] + row["drive_work"], _free(row)
        moving = row["kinetic_energy"] + row["elastic_energy"] + row["bond_energy"]
        self.scale = max(self.scale, moving, abs(work), self.floor)
        self.least = min(self.least, free)
        if limits.energy is not None and free - self.least > limits.energy * self.scale:
            raise unstable(
                time,
                fastest_body(self.model, self.state),
                f"energy grew by {free - self.least:.3g} J without work of a wall or drive, "
                f"{(free - self.least) / self.scale:.2g} of all energy in the scene (watch.energy = {limits.energy:g})",
            )


def _free(row: dict[str, float]) -> float:
    """Energy that is stored, less what walls and drives put in [J]."""
    return sum(row[name] for name in STORED) - (row["wall_work"] + row["drive_work"])


def unstable(time: float, body: int, what: str, cures: str = "") -> InstabilityError:
    """The error of a run that has become unstable."""
    cures = cures or "a smaller time step (safety below 0.8), softer contacts or bonds, more damping"
    return InstabilityError(f"t = {time:.6g} s, body {body}: {what}; usual cures: {cures}")


def failed_body(model: Model, state: State, place: int) -> InstabilityError:
    """The error of a run that a device has stopped, for the body at a `place` of the state's arrays."""
    own = np.flatnonzero(state.spheres.body.numpy() == place)
    velocity, radius = state.spheres.velocity.numpy()[own, :3], state.spheres.position.numpy()[own, 3]
    body, speeds = int(state.bodies.id.numpy()[place]), np.linalg.norm(velocity, axis=1)
    ways, speed = state.dt * speeds / radius, f"{speeds.max():.3g} m/s"
    wall = _wall_passed(model, state, own, radius)
    if wall:
        what, cures = (
            f"a speed of {speed} carries it through the mesh wall {wall!r}",
            "stiffer contacts, slower bodies or walls",
        )
    elif np.any(ways > 0.999):
        what = (
            f"a speed of {speed} moves it by {ways.max():.3g} of its radius in a step of {state.dt:.3g} s, so that "
            "contacts are missed"
        )
        cures = f"a time_step below {0.5 * state.dt / ways.max():.2g} s or an automatic one, or slower bodies"
    else:
        what = f"its speed rises from {speed} above watch.speed = {model.scene.watch.speed:g} m/s in one step,"
        what, cures = what + "or is not a number", ""
    return unstable(state.time, body, what, cures)


def _wall_passed(model: Model, state: State, spheres: np.ndarray, radius: np.ndarray) -> str:
    """Name of a mesh that has the centre of one of these spheres behind it; empty if there is none."""
    if not model.features.meshes:
        return ""
    walls, overlap = (getattr(state.slots, name).numpy()[spheres] for name in ("wall", "overlap"))
    sphere, slot = np.nonzero((walls >= 0) & (overlap > radius[:, None]))
    return model.walls[walls[sphere[0], slot[0]]].name if len(sphere) else ""
