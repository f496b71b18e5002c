"""Stones of one size that a piston pushes through a funnel into a narrower pipe, for tests and benches of blockage."""

import numpy as np

from warpcrete.dem.laws import Contact
from warpcrete.dem.scene.containers import Fill, PipeContainer
from warpcrete.dem.scene.scene import Blockage, PipeUnit, PressureProbe, Scene, Watch
from warpcrete.dem.scene.sizes import Uniform
from warpcrete.geometry.axis import Axis, Line
from warpcrete.geometry.walls import MeshWall, PlaneWall, Prescribed

STONE, WIDE, LENGTH, CONE, THROAT, FACETS = 0.016, 0.08, 0.16, 0.03, 0.06, 24


def funnel(narrow: float) -> MeshWall:
    """A pipe of 80 mm that narrows to `narrow` [m] just past the stones."""
    begin = LENGTH + 0.005
    rings = ((-WIDE, WIDE), (begin, WIDE), (begin + CONE, narrow), (begin + CONE + THROAT, narrow))
    angle = 2 * np.pi * np.arange(FACETS) / FACETS
    vertices = [[x, d / 2 * np.cos(a), d / 2 * np.sin(a)] for x, d in rings for a in angle]
    faces = []
    for first in range(0, FACETS * (len(rings) - 1), FACETS):
        for k in range(FACETS):
            a, b = first + k, first + (k + 1) % FACETS
            faces += [[a, a + FACETS, b], [b, a + FACETS, b + FACETS]]
    return MeshWall(name="pipe", vertices=np.array(vertices), faces=np.array(faces))


def orifice(ratio: float, seed: int = 0, *, friction: float = 0.5, modulus: float = 2e6, travel: float = 0.1) -> Scene:
    """Stones of 16 mm, pushed into a pipe `ratio` of them wide at 0.4 m/s, without gravity; it ends when blocked."""
    axis, velocity = Axis((0, 0, 0), (1, 0, 0), (Line(LENGTH + 0.5),)), 0.4
    push = Prescribed(velocity=(velocity, 0, 0))
    return Scene(
        name="orifice",
        duration=travel / velocity,
        fill=Fill(
            container=PipeContainer(axis, WIDE / 2, LENGTH),
            sizes=Uniform(0.95 * STONE, 1.05 * STONE),
            pressure=1e4,
        ),
        walls=(
            PlaneWall(name="piston", point=(0, 0, 0), normal=(1, 0, 0), motion=push, drawn_radius=WIDE / 2),
            funnel(ratio * STONE),
        ),
        contact=Contact(effective_modulus=modulus, friction=friction),
        gravity=(0, 0, 0),
        pressure=PressureProbe(wall="piston", area=np.pi * WIDE**2 / 4),
        pipe=PipeUnit(
            name="orifice", axis=axis, radius=WIDE / 2, concrete_length=LENGTH, velocity=velocity, ramp=0.0,
            travel=travel,
        ),
        blockage=Blockage(stop=True),
        watch=Watch(overlap=1.5),
        sample_interval=0.0025,
        seed=seed,
    )  # fmt: skip
