"""One surface of a mesh makes one contact, however its triangles are put together."""

import math
import warnings

import numpy as np
import pytest
import trimesh
from conftest import by_id
from wall_spheres import DENSITY, K_WALL, MASS, RADIUS, SMOOTH, force_on_sphere, grid_plane

from warpcrete import SceneError, scenes
from warpcrete.dem.scene.scene import Bodies, Scene, TimeStep
from warpcrete.geometry.walls import MeshWall

OVERLAPS = (0.1, 0.2, 0.3, 0.4, 0.7)
"""Over the radius."""
PLACES = np.stack(np.meshgrid(*[np.arange(-2, 3) * 2.3 * RADIUS] * 2), -1).reshape(-1, 2)


def loose(vertices, faces):
    """Every face gets corners of its own."""
    return vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)


def ribbed(vertices, faces, leaning):
    """Ribs hang down from every third row of corners; so many more `leaning` ones from the same rows."""
    n = math.isqrt(len(vertices))
    for lean in [0.0] + [0.02] * leaning:
        for row in range(0, n, 3):
            top = np.arange(row * n, row * n + n)
            low = len(vertices) + np.arange(n)
            vertices = np.concatenate([vertices, vertices[top] - [lean, 0, 0.05]])
            strips = [np.stack([top[:-1], top[1:], low[:-1]], 1), np.stack([top[1:], low[1:], low[:-1]], 1)]
            faces = np.concatenate([faces, *strips])
    return vertices, faces


def joined(*meshes):
    """Meshes beside one another, without corners in common."""
    firsts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + first for (_, faces), first in zip(meshes, firsts)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)


def two_skins(vertices, faces, thickness):
    """A second surface lies under the first, as the outside of a wall does."""
    return joined((vertices, faces), (vertices - [0, 0, thickness], faces[:, ::-1]))


def near(vertices, faces, apart=1e-8):
    corners, faces = loose(vertices, faces)
    return corners + np.random.default_rng(2).uniform(-apart, apart, corners.shape), faces


SURFACES = {
    "clean": lambda v, f: (v, f),
    "twice": lambda v, f: (v, np.concatenate([f, f])),
    "both sides": lambda v, f: (v, np.concatenate([f, f[:, ::-1]])),
    "loose corners": loose,
    "corners nearly together": near,
    "corners about together": lambda v, f: near(v, f, 1e-6),
    "another tiling over it": lambda v, f: joined((v, f), grid_plane(17, 0.144 / 17)),
    "three faces at an edge": lambda v, f: ribbed(v, f, 0),
    "four faces at an edge": lambda v, f: ribbed(v, f, 1),
    "two skins 10 um apart": lambda v, f: two_skins(v, f, 1e-5),
    "two skins 2 mm apart": lambda v, f: two_skins(v, f, 2e-3),
    "two loose skins": lambda v, f: two_skins(*loose(v, f), 2e-3),
}


def pushes(start, wall, positions):
    """Forces that a wall at rest exerts on spheres at rest that do not meet, shape (n, 3) [N]."""
    dt = 1e-6
    scene = Scene(
        name="probe", duration=0, walls=(wall,), gravity=(0, 0, 0), contact=SMOOTH, time_step=TimeStep(fixed=dt),
        bodies=(Bodies(positions=positions, sizes=2 * RADIUS, density=DENSITY),),
    )  # fmt: skip
    stepper = start(scene)
    stepper.take(1)
    return by_id(stepper.state, "velocity")[:, :3] * MASS / (0.5 * dt)  # of half a step


@pytest.mark.parametrize("cells", [12, 48], ids=["coarse", "fine"])
@pytest.mark.parametrize("surface", SURFACES)
def test_a_plane_of_triangles_pushes_once(start, surface, cells):
    """Triangles of 12 mm and 3 mm under spheres of 20 mm, whose overlaps are up to 20 mm across."""
    vertices, faces = SURFACES[surface](*grid_plane(cells, 0.144 / cells))
    wall = MeshWall(name="floor", vertices=vertices, faces=faces)
    shift = np.random.default_rng(7).uniform(-1e-3, 1e-3, PLACES.shape)
    overlap = np.resize(OVERLAPS, len(PLACES)) * RADIUS
    ratio = pushes(start, wall, np.column_stack([PLACES + shift, RADIUS - overlap])) / (K_WALL * overlap[:, None])
    # Measured 7e-6, 1.2e-2 (edges lean as corners lie 2 um over one another) and 2e-13.
    rough = {"corners nearly together": 2e-5, "corners about together": 3e-2}.get(surface, 1e-9)
    assert ratio == pytest.approx(np.tile([0.0, 0.0, 1.0], (len(PLACES), 1)), abs=rough)


def test_a_rib_that_stands_on_a_plane_pushes_beside_it(start):
    vertices, faces = ribbed(*grid_plane(6, 0.012, skew=0.0), 0)
    wall = MeshWall(name="floor", vertices=-vertices, faces=faces)  # the ribs stand, at x = 0 and 36 mm each side
    both = force_on_sphere(start, (wall,), np.array([0.8 * RADIUS, 0.002, 0.7 * RADIUS]))
    assert both == pytest.approx(np.array([0.2, 0, 0.3]) * K_WALL * RADIUS, rel=1e-9, abs=1e-12)
    alone = force_on_sphere(start, (wall,), np.array([1.8 * RADIUS, 0.002, 0.7 * RADIUS]))
    assert alone == pytest.approx(np.array([0, 0, 0.3]) * K_WALL * RADIUS, rel=1e-9, abs=1e-12)


def test_an_edge_of_three_faces_from_which_a_face_leads_nearer_pushes_nothing(start):
    """A ridge with a rib below it, a short slope down from it, and a floor there, on which the sphere lies."""
    profile = np.array([[-0.06, -0.06], [0, 0], [0.00134, -0.00067], [0.06, -0.00067], [0, -0.06]])
    ends = np.array([-0.05, 0.05])
    vertices = np.array([[x, y, z] for x, z in profile for y in ends])
    faces = [face for a, b in ((0, 1), (1, 2), (2, 3), (1, 4))
             for face in ([2 * a, 2 * a + 1, 2 * b], [2 * a + 1, 2 * b + 1, 2 * b])]  # fmt: skip
    wall = MeshWall(name="floor", vertices=vertices, faces=np.array(faces))
    force = force_on_sphere(start, (wall,), np.array([0.00634, 0.001, -0.00067 + 0.008]))
    assert force == pytest.approx([0, 0, K_WALL * 0.002], rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("thickness", [0.5e-3, 4e-3])
def test_a_sphere_in_a_corner_of_a_thin_box_is_pushed_by_the_inside_alone(start, thickness):
    def box(half):
        corners = np.array([[x, y, z] for x in (-half, half) for y in (-half, half) for z in (-half, half)])
        quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
        return corners, np.array([t for a, b, c, d in quads for t in ([a, b, c], [a, c, d])])

    (inner, faces), (outer, _) = box(0.05), box(0.05 + thickness)
    vertices, faces = joined((inner, faces[:, ::-1]), (outer, faces))
    wall = MeshWall(name="box", vertices=vertices, faces=faces)
    depth = np.array([0.2, 0.35, 0.5]) * RADIUS
    force = force_on_sphere(start, (wall,), 0.05 - RADIUS + depth)
    assert force == pytest.approx(-K_WALL * depth, rel=1e-9)


@pytest.mark.parametrize("surface", ["twice", "two loose skins"])
def test_a_centre_pushed_through_both_skins_is_pushed_back(start, surface):
    vertices, faces = SURFACES[surface](*grid_plane())
    speed = math.sqrt(K_WALL / MASS) * 1.3 * RADIUS
    scene = Scene(
        name="press", duration=1, walls=(MeshWall(name="floor", vertices=vertices, faces=faces),), gravity=(0, 0, 0),
        contact=SMOOTH, time_step=TimeStep(fixed=1e-5),
        bodies=(Bodies(positions=[[0.001, 0.002, RADIUS]], sizes=2 * RADIUS, density=DENSITY,
                       velocities=np.array([[0, 0, -speed]])),),
    )  # fmt: skip
    stepper = start(scene)
    lowest = 0.0
    for _ in range(13):
        stepper.take(100)
        lowest = min(lowest, by_id(stepper.state, "position")[0, 2])
    assert lowest < -0.29 * RADIUS  # below both skins
    assert by_id(stepper.state, "velocity")[0, 2] == pytest.approx(speed, rel=1e-3)


def test_a_start_on_the_surface_itself_is_no_section(tmp_path):
    """All rays end where they begin: that is refused in one line, without a warning of NumPy's."""
    path = tmp_path / "box.stl"
    trimesh.creation.box(bounds=[[0, 0, 0], [0.4, 0.1, 0.1]]).export(path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(SceneError, match="has no closed cross-section at its origin"):
            scenes.part(wall=str(path), diameter=0.1)
