"""One sphere at a wall: its size, mass and stiffness, the force on it, and an uneven triangulated plane."""

import math

import numpy as np

from warpcrete.dem.scene.scene import Bodies, Contact, Scene, TimeStep

RADIUS, DENSITY, MODULUS = 0.01, 2500.0, 1e5
MASS = DENSITY * 4 / 3 * math.pi * RADIUS**3
K_WALL = MODULUS * math.pi * RADIUS
SMOOTH = Contact(friction=0.0, normal_damping_ratio=0.0)


def sphere_scene(walls, positions, step, velocities=None, **settings):
    """Scene of spheres at walls with a fixed time step; without gravity and friction, unless `settings` differ."""
    bodies = Bodies(positions=positions, sizes=2 * RADIUS, density=DENSITY, velocities=velocities)
    usual = dict(name="spheres", duration=1, gravity=(0, 0, 0), contact=SMOOTH)
    return Scene(**usual | settings, walls=walls, time_step=TimeStep(fixed=step), bodies=(bodies,))


def force_on_sphere(start, walls, position, contact=SMOOTH):
    """Force that resting walls exert on a resting sphere, shape (3,)."""
    scene = sphere_scene(walls, [position], 1e-6, contact=contact)
    stepper = start(scene)
    stepper.take(1)
    return -stepper.state.walls.force.numpy().reshape(-1, 3).sum(0)


def grid_plane(cells=6, width=0.012, skew=0.3):
    """Triangulated z = 0, with triangles of different shapes."""
    rng = np.random.default_rng(0)
    n = cells + 1
    x, y = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    points = np.stack([x, y, 0 * x], -1).astype(float) * width
    points[1:-1, 1:-1, :2] += rng.uniform(-skew, skew, (cells - 1, cells - 1, 2)) * width
    a = (x[:-1, :-1] * n + y[:-1, :-1]).ravel()
    faces = np.concatenate([np.stack([a, a + n, a + n + 1], 1), np.stack([a, a + n + 1, a + 1], 1)])
    return points.reshape(-1, 3) - [cells * width / 2, cells * width / 2, 0], faces
