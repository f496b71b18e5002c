"""Display of a mortar with aggregates: the surface of the concrete, and the spheres of the aggregates."""

from dataclasses import replace
from functools import cached_property

import numpy as np

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

    def surface_colours(self, surface: Surface) -> np.ndarray:
        colours = super().surface_colours(surface)
        colours[surface.fields["aggregate"] > 0] = STONE
        return colours

    @cached_property
    def _sphere(self) -> tuple[np.ndarray, np.ndarray]:
        """Vertices and faces of a sphere of unit radius."""
        import trimesh

        ball = trimesh.creation.icosphere(subdivisions=DIVISIONS)
        return np.asarray(ball.vertices, float), np.asarray(ball.faces)

    def sphere_centres(self) -> np.ndarray:
        """Return the centres of the spheres of all aggregates [m], shape (m, 3)."""
        centres, bodies = self.read("aggregates.centre").astype(float), self.flow.aggregates
        return bodies.parts.centres(centres, self.read("aggregates.turn").astype(float))

    def with_spheres(
        self, concrete: Surface, centres: np.ndarray, numbers: np.ndarray, cut: float | None = None
    ) -> Surface:
        """Return a surface of the concrete with spheres at `centres` [m], shape (n, 3).

        `numbers` are the indices of these spheres in the list of the spheres of all aggregates. With `cut`, only
        spheres in or behind the plane at this coordinate y [m] are drawn.
        """
        parts = self.flow.aggregates.parts
        radii = parts.radius[numbers]
        speeds = np.linalg.norm(self.read("aggregates.velocity").astype(float), axis=1)[parts.body[numbers]]
        if cut is not None:
            visible = centres[:, 1] + radii > cut
            centres, radii, speeds = centres[visible], radii[visible], speeds[visible]
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

    def surface(self, cut: bool = False) -> Surface:
        """Return the surfaces of concrete and aggregates; with `cut`, only the part behind the cutting plane."""
        concrete = super().surface(cut)
        return self.derived(("with aggregates", cut), lambda: self._with_spheres(concrete, cut))

    def _with_spheres(self, concrete: Surface, cut: bool) -> Surface:
        inside = is_inside(self.read("aggregates.centre").astype(float))
        inside = inside[self.flow.aggregates.parts.body]
        copies = self._mirrored
        centres = np.concatenate([self.sphere_centres()[inside] * [a, b, 1.0] for a, b in copies])
        return self.with_spheres(
            concrete, centres, np.tile(np.flatnonzero(inside), len(copies)), self.cut if cut else None
        )
