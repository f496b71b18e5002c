"""Verification of friction between aggregates in a mortar and walls: a sphere that is pushed along a floor."""

import numpy as np

from ..suspension.aggregates import Aggregates
from ..suspension.flow import SuspensionFlow
from ..suspension.solve import Tolerances
from .case import Case, Row
from .suspensions import DENSITY, RADIUS, mortar_flow

WIDTH = RADIUS / 2
FLOOR = -6 * WIDTH
"""Coordinate of the floor along the third axis [m]."""
TOUCHING = 0.00997 * RADIUS
"""Gap between sphere and floor at the start [m]. A gap of this size counts as contact."""
PRESS = 0.02
"""Force that presses the sphere onto the floor [N]."""
LEVER = 1.005 * RADIUS
"""Distance [m] from the sphere's centre to the point at which friction acts, which lies in the middle of the gap."""
FRICTION, STEPS = 0.3, 25


def pushed(
    friction: float, force: float, torque: float, device: str, precision: str, steps: int = STEPS
) -> SuspensionFlow:
    """Simulate a sphere that is pressed onto a floor and pushed along it from rest, and return the final flow.

    The sphere has the density of the mortar. `force` is the force along the first axis [N], and `torque` is the torque
    about the second axis [N m].
    """
    sphere = Aggregates(np.array([[0.0, 0.0, FLOOR + RADIUS + TOUCHING]]), np.array([RADIUS]), DENSITY)
    flow = mortar_flow(
        (16, 12, 12), WIDTH, sphere, device, precision, friction=friction, time_step=0.02,
        tolerances=Tolerances(coupled=1e-6 if precision == "float64" else 1e-5),
    )  # fmt: skip
    flow.aggregates.bodies.force.assign(np.array([[force, 0.0, -PRESS]]))
    flow.aggregates.bodies.torque.assign(np.array([[0.0, torque, 0.0]]))
    flow.take(steps)
    return flow


def motion(flow: SuspensionFlow) -> tuple[float, float]:
    """Return the velocity of a sphere along the first axis [m/s], and its spin about the second axis [rad/s]."""
    bodies = flow.aggregates.bodies
    return float(bodies.velocity.numpy()[0, 0]), float(bodies.spin.numpy()[0, 1])


def friction_case(device: str, precision: str) -> list[Row]:
    """Check that a sphere that is pushed along a floor rolls below the limit of friction, and slides above it.

    Sliding friction acts on the sphere like a force mu N and its torque, where N is the normal force. The flow of the
    mortar is linear. A sphere without friction therefore moves in the same way if this force and torque act on it as
    external loads.
    """
    velocity, spin = motion(pushed(FRICTION, 0.2 * PRESS, 0.0, device, precision))
    flow = pushed(FRICTION, PRESS, 0.0, device, precision)
    normal = float(flow.aggregates.pairs.last_force.numpy()[0])
    measured = motion(flow)
    force = float(flow.aggregates.pairs.grip.numpy()[0]) * (measured[0] - LEVER * measured[1])
    loaded = motion(pushed(0.0, PRESS - FRICTION * normal, FRICTION * normal * LEVER, device, precision))
    return [
        Row(
            "speed of the surface by rotation, divided by the velocity, pushed with 0.2 times the pressing force",
            LEVER * spin / velocity,
            1.0,
            0.01,
        ),
        Row(
            "friction, divided by mu times the normal force, pushed with the pressing force",
            force / (FRICTION * normal),
            1.0,
            0.015,
        ),
        Row("velocity, divided by that without friction under the same loads", measured[0] / loaded[0], 1.0, 0.01),
        Row("spin, divided by that without friction under the same loads", measured[1] / loaded[1], 1.0, 0.025),
    ]


CASES = [Case("sphere pushed along a floor", "Coulomb's law", friction_case, "aggregates in mortar")]
