"""Display of a mortar with aggregates: the surface of the concrete, and the spheres of the aggregates."""

from dataclasses import replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from ..core.drawing.display import DrawnSpheres
from ..core.drawing.surfaces import Surface, triangles
from ..mps.free.display import FreeDisplay
from ..mps.grid.display import GridDisplay
from ..mps.grid.geometry import MIRROR
from .aggregates import is_inside

STONE = (168, 120, 82)
"""Colour of aggregates: red, green and blue from 0 to 255."""
DIVISIONS = 2
"""Number of times that the triangles of an icosahedron are subdivided, so that it approximates a sphere."""
RINGS, SECTORS = 8, 24
"""Number of rings of vertices on the round part of a sphere that is cut open, and number of vertices in a ring."""
CUT_BESIDE = "Cut beside the middle"
"""Title of the cut view if the cutting plane lies beside a plane of symmetry."""
FACE_GAP = 0.05
"""Distance between the flat faces of cut spheres and of cut mortar, in cell widths; coplanar faces would flicker."""


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
        """Return a surface of the concrete with its spheres; with `cut`, only their parts behind the cutting plane."""
        spheres, depth = self.spheres(), np.inf
        if cut and self.cut is not None:
            plane = self.cut - FACE_GAP * max(self._layout.room.width)
            depth = (spheres.centres[:, 1] - plane) / spheres.radii
        depth = np.broadcast_to(depth, spheres.radii.shape)
        whole, crossed = np.flatnonzero(depth >= 1), np.flatnonzero(np.abs(depth) < 1)
        points, faces = self._sphere
        vertices, triples, normals, speeds = [concrete.vertices], [concrete.faces], [concrete.normals], []
        count = len(concrete.vertices)
        for chosen, shapes, directions, corners in (
            (whole, points[None], points[None], faces), (crossed, *_cut_spheres(depth[crossed]))
        ):  # fmt: skip
            places = spheres.centres[chosen, None] + spheres.radii[chosen, None, None] * shapes
            offsets = count + shapes.shape[1] * np.arange(len(chosen))
            vertices.append(places.reshape(-1, 3))
            triples.append((offsets[:, None, None] + corners).reshape(-1, 3))
            normals.append(np.broadcast_to(directions, places.shape).reshape(-1, 3))
            speeds.append(np.repeat(spheres.speeds[chosen], shapes.shape[1]))
            count += len(vertices[-1])
        added = count - len(concrete.vertices)
        values = {"speed": np.concatenate(speeds)}
        fields = {
            name: np.concatenate([field, values.get(name, np.zeros(added))]) for name, field in concrete.fields.items()
        }
        marks = np.concatenate([np.zeros(len(concrete.vertices)), np.ones(added)])
        return replace(
            concrete,
            vertices=np.concatenate(vertices),
            faces=np.concatenate(triples),
            normals=np.concatenate(normals),
            fields={**fields, "aggregate": marks},
        )


def _cut_spheres(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the closed surfaces of unit spheres behind a plane perpendicular to the axis y.

    `depth` is the distance of each sphere's centre behind the plane, between -1 and 1, shape (n,). The results are the
    vertices relative to the centre, shape (n, v, 3), the outward normals at the vertices, shape (n, v, 3), and the
    indices of the three vertices of each triangle, shape (f, 3). The vertices are the rearmost point, rings around the
    axis y, the rim of the flat face, and the centre of the flat face.
    """
    count, angle = len(depth), np.arccos(-depth)[:, None, None] * np.arange(1, RINGS + 1)[:, None] / RINGS
    around = 2 * np.pi * np.arange(SECTORS) / SECTORS
    parts = np.sin(angle) * np.cos(around), np.cos(angle) + 0 * around, np.sin(angle) * np.sin(around)
    round_part = np.concatenate(
        [np.broadcast_to([0.0, 1.0, 0.0], (count, 1, 3)), np.stack(parts, -1).reshape(count, RINGS * SECTORS, 3)], 1
    )
    middle = np.stack([0 * depth, -depth, 0 * depth], -1)[:, None]
    vertices = np.concatenate([round_part, round_part[:, -SECTORS:], middle], 1)
    flat = np.broadcast_to([0.0, -1.0, 0.0], (count, SECTORS + 1, 3))
    here, there = np.arange(SECTORS), (np.arange(SECTORS) + 1) % SECTORS
    ring = 1 + SECTORS * np.arange(RINGS - 1)[:, None]
    quads = np.stack([ring + here, ring + there, ring + SECTORS + there, ring + SECTORS + here], -1).reshape(-1, 4)
    rim = 1 + RINGS * SECTORS
    cap = np.stack([0 * here, 1 + there, 1 + here], 1)
    face = np.stack([0 * here + rim + SECTORS, rim + here, rim + there], 1)
    return vertices, np.concatenate([round_part, flat], 1), np.concatenate([cap, triangles(quads), face])


class SuspensionDisplay(SphereDisplay, FreeDisplay):
    """Display of a mortar with aggregates.

    The surface of the concrete hides most aggregates; only aggregates that bulge out of this surface are visible. A
    plane cuts mortar and aggregates open in the cut view.
    """

    @property
    def cut(self) -> float | None:
        """Coordinate y [m] of the cutting plane, in the middle of the simulated concrete at the start.

        If y = 0 is a plane of symmetry, the middle of the whole concrete lies in it. No aggregate crosses a plane of
        symmetry, so a cut along it would show no aggregates.
        """
        scene = self.simulation.scene
        return 0.5 * float(scene.extent[1, 0] if scene.round else scene.depth)

    @property
    def cut_title(self) -> str:
        return CUT_BESIDE if self.simulation.scene.sides.get("front") == MIRROR else super().cut_title

    def images(self, centres: np.ndarray) -> list[np.ndarray]:
        return [centres * [a, b, 1.0] for a, b in self._mirrored]
