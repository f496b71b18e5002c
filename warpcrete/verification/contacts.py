"""Verification of single contacts: damped oscillator, rolling and sliding, stick-slip, and contact with meshes."""

import math
from dataclasses import replace

import numpy as np

from ..dem.laws import Contact
from ..dem.scene.clumps import clump
from ..dem.scene.scene import Bodies, Bonds, Scene, TimeStep
from ..geometry.walls import Driven, MeshWall, PlaneWall, Prescribed
from .case import Case, Row, start

RADIUS, DENSITY, MODULUS = 0.01, 2500.0, 1e5
MASS = DENSITY * 4 / 3 * math.pi * RADIUS**3
STIFFNESS = MODULUS * math.pi * RADIUS  # Normal stiffness of a sphere's contact with a wall [N/m].
FLOOR = PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1))


def sphere_on_floor(contact, height=RADIUS, **changes) -> Scene:
    """Return a scene of one sphere above a floor.

    `contact` is the contact law, and `height` the height of the sphere's centre above the floor [m]. `changes` replace
    arguments of the scene, or arguments of the sphere's body if their name starts with `body_`.
    """
    body = dict(positions=[[0.0, 0.0, height]], sizes=2 * RADIUS, density=DENSITY)
    body |= {name[5:]: changes.pop(name) for name in list(changes) if name.startswith("body_")}
    return Scene(
        **(dict(name="one", duration=1.0, contact=contact, walls=(FLOOR,), bodies=(Bodies(**body),)) | changes)
    )


def oscillator(device, precision) -> list[Row]:
    """Compare a sphere that oscillates on a floor under gravity with the exact solution of the damped oscillator.

    The sphere is released so gently that it never lifts off.
    """
    rows = []
    omega = math.sqrt(STIFFNESS / MASS)
    rest = 9.81 / omega**2
    for beta in (0.0, 0.3):
        damped = omega * math.sqrt(1 - beta**2)
        end = 2.3 * 2 * math.pi / omega
        errors = []
        for steps in (100, 200, 400):
            dt = end / steps
            contact = Contact(effective_modulus=MODULUS, friction=0.0, normal_damping_ratio=beta)
            scene = sphere_on_floor(contact, RADIUS - 0.4 * rest, time_step=TimeStep(fixed=dt))
            stepper = start(scene, device, precision)
            worst = 0.0
            for step in range(1, steps + 1):
                stepper.take(1)
                t = step * dt
                swing = math.cos(damped * t) + beta * omega / damped * math.sin(damped * t)
                exact = rest - 0.6 * rest * math.exp(-beta * omega * t) * swing
                overlap = RADIUS - float(stepper.state.bodies.position.numpy()[0, 2])
                worst = max(worst, abs(overlap - exact))
            errors.append(worst / rest)
        OSCILLATOR.curves[f"damping ratio {beta:g}"] = (end / np.array([100, 200, 400]) * omega, np.array(errors))
        # Single precision resolves the height to 1e-9 m, or 6e-5 of the overlap at rest. With the finest time step this
        # rounding error is visible, so the tolerance is larger in single precision.
        floor = 4e-4 if precision == "float32" else 0.0
        allowed = {0.0: 6e-4, 0.3: 5e-3}[beta] + floor
        label = f"overlap, damping ratio {beta:g}, 174 steps a period: largest error"
        rows.append(Row(label, errors[-1], 0.0, allowed, scale=1.0))
        order = math.log2(errors[0] / errors[1])
        # The leapfrog method is of second order without damping. The dashpot's force uses the velocity half a step
        # earlier, so with damping the method is only of first order.
        rows.append(Row(f"order of convergence in dt, damping ratio {beta:g}", order, 2.0 if beta == 0 else 1.0, 0.12))
    return rows


def rolling(device, precision) -> list[Row]:
    """Compare the accelerations of a sphere on an incline with rigid-body mechanics.

    The sphere rolls without slip if tan(theta), the incline's slope, is below 7/2 mu, with the coefficient of friction
    mu. On a steeper incline the sphere slides, and friction spins it up.
    """
    rows = []
    friction, g = 0.2, 9.81
    tolerance = 1e-3 if precision == "float32" else 1e-10
    for label, slope in (("below", 0.8 * 3.5 * friction), ("above", 1.5 * 3.5 * friction)):
        cosine = 1 / math.sqrt(1 + slope**2)
        sine = slope * cosine
        rest = MASS * g * cosine / STIFFNESS
        contact = Contact(
            effective_modulus=MODULUS,
            friction=friction,
            normal_damping_ratio=0.3,
            shear_damping_ratio=0.3,
            dashpot="slip-cut",
        )
        scene = sphere_on_floor(
            contact, RADIUS - rest, gravity=(g * sine, 0.0, -g * cosine), time_step=TimeStep(fixed=1e-5)
        )
        stepper = start(scene, device, precision)
        stepper.advance(0.1)
        first = _speed_and_spin(stepper)
        time = stepper.time
        stepper.advance(0.3)
        second = _speed_and_spin(stepper)
        span = stepper.time - time
        lever = 1 - rest / RADIUS
        if label == "below":
            acceleration = g * sine / (1 + 0.4 / lever**2)
            turning = acceleration / (RADIUS * lever)
        else:
            acceleration = g * (sine - friction * cosine)
            turning = 2.5 * friction * g * cosine * lever / RADIUS
        faster, spun = ((later - earlier) / span for earlier, later in zip(first, second))
        rows += [
            Row(f"acceleration {label} the threshold of slip", faster, acceleration, tolerance, "m/s2"),
            Row(f"angular acceleration {label} the threshold of slip", spun, turning, tolerance, "rad/s2"),
        ]
    return rows


def _speed_and_spin(stepper) -> tuple[float, float]:
    return float(stepper.state.bodies.velocity.numpy()[0, 0]), float(stepper.state.bodies.spin.numpy()[0, 1])


def stick_slip(device, precision) -> list[Row]:
    """Compare the stick-slip motion of a sled with the exact solution.

    The sled has mass m. It is pressed with force N on a floor that moves at speed V, and it is held by a spring of
    stiffness k. While the sled sticks to the floor, the spring's force grows as k V t. When the force reaches mu N,
    with the friction coefficient mu, the sled begins to slip. From then on, with the time t counted from this moment,
    the force is mu N + V sqrt(k m) sin(omega t) with omega = sqrt(k / m). The speed of the sled relative to the floor
    is zero once per period.
    """
    friction, press, speed, modulus = 0.4, 0.5, 0.05, 1e6
    side = 1.2 * RADIUS
    corners = [[side, side, 0], [side, -side, 0], [-side, side, 0], [-side, -side, 0], [2 * side, 0, 0]]
    shape = clump("sled", np.array(corners), np.full(5, RADIUS))
    size = RADIUS / shape.radii[0]
    contact = Contact(effective_modulus=modulus, friction=friction, shear_damping_ratio=0.3, dashpot="slip-cut")
    smooth = replace(contact, friction=0.0, normal_damping_ratio=0.0, shear_damping_ratio=0.0)
    # Radius [m] of the anchor, which is the sphere to which the sled's spring is attached. The anchor is too heavy to
    # move, and so small that it touches neither plate.
    small = 0.5 * RADIUS
    spring = Bonds(effective_modulus=1e4, tensile_strength=1e12, cohesion=1e12, gap=2e-5)
    depth = press / 5 / (modulus * math.pi * RADIUS)
    nose = np.array([shape.offsets[:, 0].max() * size + RADIUS + small + 1e-5, 0, 0])
    height = np.array([0, 0, RADIUS - depth])
    scene = Scene(
        name="sled", duration=1.0, gravity=(0, 0, 0), contact=contact, bonds=spring, time_step=TimeStep(fixed=5e-5),
        contacts={("sled", "lid"): smooth, ("anchor", "sled"): smooth},
        walls=(
            PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1), motion=Prescribed(velocity=(-speed, 0, 0))),
            PlaneWall(name="lid", point=(0, 0, 2 * RADIUS - 2 * depth), normal=(0, 0, -1), material="lid",
                      motion=Driven(direction=(0, 0, -1), force=press, mass=0.05, damping=5.0)),
        ),
        bodies=(
            Bodies(positions=height[None], sizes=size, template=shape, density=DENSITY, material="sled",
                   velocities=[[-speed, 0, 0]]),
            Bodies(positions=(height + nose)[None], sizes=2 * small, density=1e15, material="anchor"),
        ),
    )  # fmt: skip
    stepper = start(scene, device, precision)
    stepper.bond(spring, 1)
    stiffness = 1e4 * math.pi * small**2 / (RADIUS + small)
    mass = float(stepper.state.bodies.mass.numpy().min())
    omega = math.sqrt(stiffness / mass)
    slip = friction * press / (stiffness * speed)
    ripple = speed * math.sqrt(stiffness * mass)
    rows = []
    for label, time, force in (
        ("sticking, half way to slip", 0.5 * slip, 0.5 * friction * press),
        ("highest", slip + 0.5 * math.pi / omega, friction * press + ripple),
        ("lowest", slip + 1.5 * math.pi / omega, friction * press - ripple),
        ("highest, two periods on", slip + 4.5 * math.pi / omega, friction * press + ripple),
    ):
        stepper.advance(time)
        pull = float(stepper.state.pairs.load.numpy()[0, 3])
        rows.append(Row(f"force of the spring, {label}", pull, force, 5e-3, "N"))
    return rows


def meshes(device, precision) -> list[Row]:
    """Compare the force of a triangle mesh on a gliding sphere with the stiffness times the exact overlap.

    A sphere, too heavy to be pushed away, glides over the finely triangulated side of a box, over a convex edge, and
    over a corner.
    """
    box, faces = _box(0.05, 5)
    contact = Contact(effective_modulus=MODULUS, friction=0.0, normal_damping_ratio=0.0)
    rows = []
    depth, speed = 0.1 * RADIUS, 1.0
    paths = {
        "across faces, edges and vertices of a flat side": ([-0.021, 0.0123, 0.05], [1.0, 0.37, 0.0]),
        "over a convex edge": ([0.03, 0.0123, 0.05], [1.0, 0.0, 0.0]),
        "over a corner": ([0.035, 0.035, 0.05], [1.0, 1.0, 0.0]),
    }
    for label, (begin, direction) in paths.items():
        along = speed * np.array(direction) / np.linalg.norm(direction)
        begin = np.array(begin) + [0, 0, RADIUS - depth]
        scene = Scene(
            name="glide", duration=1.0, gravity=(0, 0, 0), contact=contact, time_step=TimeStep(fixed=1e-4),
            walls=(MeshWall(name="box", vertices=box, faces=faces),),
            bodies=(Bodies(positions=begin[None], sizes=2 * RADIUS, density=1e15, velocities=along[None]),),
        )  # fmt: skip
        stepper = start(scene, device, precision)
        worst = 0.0
        for _ in range(400):
            place = stepper.state.bodies.position.numpy()[0].astype(float)
            stepper.take(1)
            force = np.linalg.norm(stepper.state.walls.force.numpy()[0])
            near = np.clip(place, -0.05, 0.05)
            overlap = max(RADIUS - float(np.linalg.norm(place - near)), 0.0)
            worst = max(worst, abs(force - STIFFNESS * overlap))
        rows.append(Row(f"force {label}: largest error, divided by the largest force", worst / (STIFFNESS * depth), 0.0,
                        5e-6 if precision == "float32" else 1e-11, scale=1.0))  # fmt: skip
    return rows


def _box(half: float, cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and faces of a closed cube with the edge length 2 * `half` [m].

    Each side consists of `cells` x `cells` pairs of triangles.
    """
    import trimesh

    line = np.linspace(-half, half, cells + 1)
    vertices: list[list[float]] = []
    triangles: list[list[int]] = []
    for axis in range(3):
        for side in (-half, half):
            first = len(vertices)
            for u in line:
                for v in line:
                    point = [0.0, 0.0, 0.0]
                    point[axis], point[(axis + 1) % 3], point[(axis + 2) % 3] = side, u, v
                    vertices.append(point)
            for i in range(cells):
                for j in range(cells):
                    a = first + i * (cells + 1) + j
                    b, c, d = a + 1, a + cells + 1, a + cells + 2
                    triangles += [[a, c, d], [a, d, b]] if side > 0 else [[a, d, c], [a, b, d]]
    mesh = trimesh.Trimesh(vertices, triangles, process=False)
    mesh.merge_vertices()
    return np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int32)


OSCILLATOR = Case("damped oscillator", "exact solution", oscillator, "contacts")
CASES = [
    OSCILLATOR,
    Case("rolling and sliding", "rigid-body mechanics of a sphere on an incline", rolling, "contacts"),
    Case("stick-slip", "exact solution of a sled on a moving floor", stick_slip, "contacts"),
    Case("mesh walls", "exact distance to a box", meshes, "contacts"),
]
