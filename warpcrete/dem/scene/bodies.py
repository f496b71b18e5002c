"""Table of bodies on the host, from which the state of a run is built, and which a run returns at its end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .clumps import ClumpTemplate, sphere
from .scene import Scene


@dataclass(repr=False)
class BodyTable:
    """Bodies on the host, one row for each body, in the order of their permanent numbers."""

    position: np.ndarray
    """Centroids of the bodies [m], shape (n, 3)."""
    orientation: np.ndarray
    """Unit quaternions (x, y, z, w) that rotate from the body's frame to the global frame, shape (n, 4)."""
    velocity: np.ndarray
    """Velocities of the bodies' centroids [m/s], shape (n, 3)."""
    spin: np.ndarray
    """Angular velocities of the bodies in the global frame [rad/s], shape (n, 3)."""
    size: np.ndarray
    """Size of each body: the diameter of a sphere of equal volume [m], shape (n,)."""
    template: np.ndarray
    """Index of each body's shape in `templates`, shape (n,)."""
    density: np.ndarray
    """Density of each body [kg/m3], shape (n,)."""
    material: list[str]
    group: list[str]
    templates: tuple[ClumpTemplate, ...]

    def __len__(self) -> int:
        return len(self.size)

    def __repr__(self) -> str:
        return f"<BodyTable of {len(self)} bodies of {len(self.templates)} shapes>"

    @property
    def volume(self) -> np.ndarray:
        """Volume of each body [m3], shape (n,)."""
        return np.pi / 6 * self.size**3

    @property
    def mass(self) -> np.ndarray:
        """Mass of each body [kg], shape (n,)."""
        return self.density * self.volume

    @property
    def sphere_counts(self) -> np.ndarray:
        """Number of spheres of each body, shape (n,)."""
        return np.array([len(template.radii) for template in self.templates], dtype=int)[self.template]

    @staticmethod
    def empty() -> BodyTable:
        """Return a table without bodies."""
        none = np.zeros((0, 3))
        return BodyTable(none, np.zeros((0, 4)), none, none, np.zeros(0), np.zeros(0, int), np.zeros(0), [], [], ())

    def joined(self, other: BodyTable) -> BodyTable:
        """Return a table with the bodies of this table followed by the bodies of `other`.

        A template object that occurs in both tables is stored once.
        """
        templates = list(self.templates)
        for template in other.templates:
            if all(template is not known for known in templates):
                templates.append(template)
        place = np.array([next(i for i, k in enumerate(templates) if k is t) for t in other.templates], dtype=int)
        renumbered = place[other.template] if len(other.templates) else other.template
        return BodyTable(
            *(
                np.concatenate([getattr(self, name), getattr(other, name)])
                for name in ("position", "orientation", "velocity", "spin", "size")
            ),
            np.concatenate([self.template, renumbered]).astype(int),
            np.concatenate([self.density, other.density]),
            self.material + other.material,
            self.group + other.group,
            tuple(templates),
        )


def placed_bodies(scene: Scene) -> BodyTable:
    """Return a table of the bodies whose positions the scene gives explicitly; it does not contain packed bodies."""
    table = BodyTable.empty()
    for bodies in scene.bodies:
        n = len(bodies.positions)
        identity = np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
        zero = np.zeros((n, 3))
        table = table.joined(
            BodyTable(
                bodies.positions,
                identity if bodies.orientations is None else bodies.orientations,
                zero if bodies.velocities is None else bodies.velocities,
                zero if bodies.spins is None else bodies.spins,
                bodies.sizes,
                np.zeros(n, int),
                np.full(n, bodies.density),
                [bodies.material] * n,
                [bodies.group] * n,
                (bodies.template or sphere(),),
            )
        )
    return table
