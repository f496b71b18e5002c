"""Errors to raise for a run that the device has stopped; they name the body, the likely cause and the usual cures."""

import numpy as np

from ...core.errors import InstabilityError
from ..laws import own_laws
from ..scene.scene import Scene
from .model import Model
from .state import State


def unstable(time: float, body: int, what: str, cures: str = "", scene: Scene | None = None) -> InstabilityError:
    """Return the error for a run that became unstable at `time` [s].

    The message contains the permanent number of the `body`, a description `what` of the failure, and the usual `cures`.
    If a `scene` is given, the message also names the scene's contact laws that are defined outside this package,
    because the forces of these laws may be wrong.
    """
    cures = cures or "a smaller time step (safety below 0.8), softer contacts or bonds, more damping"
    if scene is not None and (own := own_laws(scene.laws())):
        cures += f", or the opposite sign in force() of {own}, if that force pulls where it should push"
    return InstabilityError(what, time=time, body=body, cure=cures)


def failed_body(model: Model, state: State, place: int) -> InstabilityError:
    """Return the error for a run that the device stopped because of one body, whose index in the arrays is `place`."""
    own = np.flatnonzero(state.spheres.body.numpy() == place)
    velocity, radius = state.spheres.velocity.numpy()[own, :3], state.spheres.position.numpy()[own, 3]
    body, speeds = int(state.bodies.id.numpy()[place]), np.linalg.norm(velocity, axis=1)
    ways, speed = state.dt * speeds / radius, f"{speeds.max():.3g} m/s"
    together = ways + state.dt * model.mesh_speed / radius
    wall = _wall_passed(model, state, own, radius)
    if wall:
        what = f"a speed of {speed} carries it through the mesh wall {wall!r}"
        cures = "stiffer contacts, slower bodies or walls"
    elif np.any(ways > 0.999):
        what = (
            f"a speed of {speed} moves it by {ways.max():.3g} times its radius in a step of {state.dt:.3g} s, so that "
            "contacts are missed"
        )
        cures = f"a time_step below {0.5 * state.dt / ways.max():.2g} s or an automatic one, or slower bodies"
    elif np.any(together > 0.999):
        what = (
            f"a speed of {speed} and mesh walls that move at up to {model.mesh_speed:.3g} m/s bring it closer to a "
            f"wall by {together.max():.3g} times its radius in a step of {state.dt:.3g} s, so that contacts are missed"
        )
        cures = f"a time_step below {0.5 * state.dt / together.max():.2g} s or an automatic one, or slower walls"
    else:
        limit = model.scene.watch.speed
        what = (
            f"its speed rises in one step from {speed} to more than watch.speed = {limit:g} m/s, or to a value that is "
            "not a number"
        )
        cures = ""
    return unstable(state.time, body, what, cures, model.scene)


def _wall_passed(model: Model, state: State, spheres: np.ndarray, radius: np.ndarray) -> str:
    """Return the name of a mesh wall that the centre of a sphere has crossed, or an empty string.

    `spheres` contains the indices of the spheres to check, and `radius` contains their radii [m].
    """
    if not model.features.meshes:
        return ""
    walls, overlap = (getattr(state.slots, name).numpy()[spheres] for name in ("wall", "overlap"))
    sphere, slot = np.nonzero((walls >= 0) & (overlap > radius[:, None]))
    return model.walls[int(walls[sphere[0], slot[0]])].name if len(sphere) else ""
