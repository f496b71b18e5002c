"""Display of a mortar with aggregates: the surface of the concrete, and the spheres of the aggregates."""

from dataclasses import replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from ..core.drawing.display import DrawnSpheres
from ..core.drawing.surfaces import Surface
from ..mps.free.display import FreeDisplay
from ..mps.grid.display import GridDisplay
from .aggregates import is_inside

STONE = (168, 120, 82)
"""Colour of aggregates: red, green and blue from 0 to 255."""
DIVISIONS = 2
"""Number of times that the triangles of an icosahedron are subdivided, so that it approximates a sphere."""


class SphereDisplay(GridDisplay):
    """Display of a mortar on a grid whose aggregates are drawn as spheres."""

    has_spheres: ClassVar = True
    halved: ClassVar[bool] = False
    """True if the mortar in front of the cutting plane is never drawn, so that the aggregates in it are visible."""

    def surface_colours(self, surface: Surface) -> np.ndarray:
        colours = super().surface_colours(surface)
        if "aggregate" in surface.fields:
            colours[surface.fields["aggregate"] > 0] = STONE
        return colours

    @cached_property
    def _sphere(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices and faces of a sphere of unit radius."""
        import trimesh

        ball = trimesh.creation.icosphere(subdivisions=DIVISIONS)
        return np.asarray(ball.vertices, float), np.asarray(ball.faces)

    def images(self, centres: np.ndarray) -> list[np.ndarray]:
        """Return the places [m] of points of the grid in the scene, and those of their mirror images.

        The argument and the results have the shape (n, 3). The first result belongs to the simulated part.
        """
        return [centres]

    def spheres(self) -> DrawnSpheres:
        """Return the spheres of all aggregates that are at least partly in the simulated box, with mirror images."""
        return self.derived("spheres", self._spheres)

    def _spheres(self) -> DrawnSpheres:
        parts = self.flow.aggregates.parts
        centre, turn, velocity, spin = (
            self.read(f"aggregates.{name}").astype(float) for name in ("centre", "turn", "velocity", "spin")
        )
        chosen = np.flatnonzero(is_inside(centre)[parts.body])
        body, centres = parts.body[chosen], parts.centres(centre, turn)[chosen]
        places, origins = self.images(centres), self.images(np.zeros((1, 3)))
        ends = self.images(velocity[body] + np.cross(spin[body], centres - centre[body]))
        numbers = np.tile(body, len(places))
        return DrawnSpheres(
            centres=np.concatenate(places),
            radii=np.tile(parts.radius[chosen], len(places)),
            speeds=np.linalg.norm(velocity, axis=1)[numbers],
            bodies=numbers,
            ids=np.concatenate([chosen + image * len(parts.radius) for image in range(len(places))]),
            velocities=np.concatenate([end - origin for end, origin in zip(ends, origins)]),
            colour=STONE,
        )

    def bare_surface(self) -> Surface:
        """Return the surface of the mortar, without aggregates."""
        return super().surface(self.halved)

    def surface(self, cut: bool = False) -> Surface:
        """Return the surfaces of mortar and aggregates; with `cut`, only the part behind the cutting plane."""
        mortar = super().surface(cut or self.halved)
        return self.derived(("with aggregates", cut), lambda: self._with_spheres(mortar, cut))

    def _with_spheres(self, concrete: Surface, cut: bool) -> Surface:
        """Return a surface of the concrete with its spheres; with `cut`, only those in or behind the cutting plane."""
        spheres = self.spheres()
        centres, radii, speeds = spheres.centres, spheres.radii, spheres.speeds
        if cut and self.cut is not None:
            seen = centres[:, 1] + radii > self.cut
            centres, radii, speeds = centres[seen], radii[seen], speeds[seen]
        points, faces = self._sphere
        count, each = len(radii), len(points)
        vertices = (centres[:, None] + radii[:, None, None] * points).reshape(-1, 3)
        offsets = len(concrete.vertices) + each * np.arange(count)
        values = {"speed": np.repeat(speeds, each)}
        fields = {
            name: np.concatenate([field, values.get(name, np.zeros(each * count))])
            for name, field in concrete.fields.items()
        }
        marks = np.concatenate([np.zeros(len(concrete.vertices)), np.ones(each * count)])
        return replace(
            concrete,
            vertices=np.concatenate([concrete.vertices, vertices]),
            faces=np.concatenate([concrete.faces, (offsets[:, None, None] + faces).reshape(-1, 3)]),
            normals=np.concatenate([concrete.normals, np.tile(points, (count, 1))]),
            fields={**fields, "aggregate": marks},
        )


class SuspensionDisplay(SphereDisplay, FreeDisplay):
    """Display of a mortar with aggregates.

    The surface of the concrete hides most aggregates; only aggregates that bulge out of this surface are visible. In a
    cut view, the aggregates in or behind the cutting plane are visible.
    """

    @property
    def cut(self) -> float | None:
        """Coordinate y [m] of the cutting plane, in the middle of the concrete at the start.

        No aggregate crosses a plane of symmetry, so a cut along such a plane would show no aggregates.
        """
        scene = self.simulation.scene
        return 0.5 * float(scene.extent[1, 0] if scene.round else scene.depth)

    def images(self, centres: np.ndarray) -> list[np.ndarray]:
        return [centres * [a, b, 1.0] for a, b in self._mirrored]
