"""Spheres at triangle meshes: one contact for each edge, corner and facet, as at exact surfaces."""

import math

import numpy as np
import pytest
import trimesh
from conftest import by_id
from wall_spheres import DENSITY, K_WALL, MASS, RADIUS, SMOOTH, force_on_sphere, grid_plane, sphere_scene

from warpcrete.dem.measure.probes import contact_sums
from warpcrete.dem.scene.scene import Bodies, Contact, Scene, TimeStep
from warpcrete.geometry.axis import Arc, Axis, Line
from warpcrete.geometry.walls import MeshWall, PipeWall, PlaneWall, Prescribed


@pytest.mark.parametrize("order", [1, -1])
def test_every_edge_of_a_pyramid_is_one_contact(start, order):
    """Near the tip, the tip is no second contact, whichever face comes first in the file."""
    turns = 2 * math.pi * np.arange(5) / 5
    corners = np.stack([0.05 * np.cos(turns), 0.05 * np.sin(turns), np.full(5, -0.02)], 1)
    faces = np.array([[0, 1 + k, 1 + (k + 1) % 5] for k in range(5)])[::order]
    wall = MeshWall(name="pyramid", vertices=np.r_[[[0.0, 0.0, 0.0]], corners], faces=faces)
    for angle in turns:
        edge = np.array([0.05 * math.cos(angle), 0.05 * math.sin(angle), -0.02])
        edge /= np.linalg.norm(edge)
        outward = np.array([-edge[2] * math.cos(angle), -edge[2] * math.sin(angle), math.hypot(edge[0], edge[1])])
        force = force_on_sphere(start, (wall,), 0.004 * edge + (RADIUS - 1e-4) * outward)
        assert force == pytest.approx(K_WALL * 1e-4 * outward, rel=1e-6, abs=1e-6 * K_WALL * 1e-4)
    force = force_on_sphere(start, (wall,), [0, 0, RADIUS - 1e-4])
    assert force == pytest.approx([0, 0, K_WALL * 1e-4], rel=1e-6, abs=1e-6 * K_WALL * 1e-4)


@pytest.mark.parametrize("depth", [1e-5, 1e-3, 5e-3])
def test_triangulated_plane_is_a_plane(start, depth):
    vertices, faces = grid_plane()
    wall = MeshWall(name="floor", vertices=vertices, faces=faces)
    rng = np.random.default_rng(1)
    places = [np.array([*rng.uniform(-0.015, 0.015, 2), RADIUS - depth]) for _ in range(12)]
    places += [np.array([*vertices[k, :2], RADIUS - depth]) for k in (16, 17, 24)]  # over corners
    places += [np.array([*(0.5 * (vertices[16] + vertices[17]))[:2], RADIUS - depth])]  # over an edge
    for place in places:
        force = force_on_sphere(start, (wall,), place)
        assert force == pytest.approx([0, 0, K_WALL * depth], rel=1e-9, abs=1e-9 * K_WALL * depth)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_rolling_over_a_triangulated_plane_is_rolling_over_a_plane(start, device, precision):
    vertices, faces = grid_plane()
    flat = PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1))
    paths = []
    for wall in (flat, MeshWall(name="floor", vertices=vertices, faces=faces)):
        scene = Scene(
            name="roll",
            duration=1,
            walls=(wall,),
            contact=Contact(friction=0.3),
            time_step=TimeStep(fixed=5e-5),
            bodies=(
                Bodies(
                    positions=[[-0.02, -0.013, RADIUS]],
                    sizes=2 * RADIUS,
                    density=DENSITY,
                    velocities=np.array([[0.5, 0.31, 0.0]]),
                ),
            ),
        )
        stepper = start(scene, precision)
        stepper.advance(0.08)
        paths.append([by_id(stepper.state, n)[0].astype(float) for n in ("position", "velocity", "spin")])
    for flat_value, mesh_value in zip(*paths):
        error = np.abs(mesh_value - flat_value).max() / np.abs(flat_value).max()
        # Measured 9e-7 and 0. On a GPU the plane, not the mesh, is handled with approximate division and root, off by
        # two units in the last place at each of 1,600 steps.
        single = 1e-5 if device.startswith("cuda") else 2e-6
        assert error < (single if precision == "float32" else 1e-12)


def test_convex_edge_and_corner_give_one_force_towards_the_centre(start):
    box = trimesh.creation.box((0.06, 0.06, 0.06))
    wall = MeshWall(name="box", vertices=box.vertices, faces=box.faces)
    depth = 1e-3
    for corner, direction in (
        ((0.03, 0.03, 0.007), (1, 1, 0)),
        ((0.03, 0.03, 0.03), (1, 1, 1)),
        ((0.03, 0.004, 0.03), (1, 0, 1)),
    ):
        n = np.array(direction) / np.linalg.norm(direction)
        force = force_on_sphere(start, (wall,), np.array(corner) + (RADIUS - depth) * n)
        assert force == pytest.approx(K_WALL * depth * n, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("by", [0.0, 0.55])
def test_a_convex_body_touches_each_sphere_once(start, by):
    """Twelve bodies of arbitrary shape, with a sphere at every corner, or beside it on one of its edges."""
    rng = np.random.default_rng(2)
    points = 0.2 * trimesh.creation.icosahedron().vertices * rng.uniform(0.9, 1.1, (12, 12, 1))
    hulls = [trimesh.convex.convex_hull(each + [number, 0, 0]) for number, each in enumerate(points)]
    hull = trimesh.util.concatenate(hulls)
    places, normals = [], []
    for corner, beside in enumerate(hull.vertex_faces):
        edges = [sorted((corner, other)) for other in hull.vertex_neighbors[corner]]
        edge = edges[rng.integers(len(edges))]
        meeting = hull.face_adjacency[hull.face_adjacency_edges.tolist().index(edge)] if by else beside[beside >= 0]
        along = hull.vertices[sum(edge) - corner] - hull.vertices[corner]
        normal = hull.face_normals[meeting].mean(axis=0)
        normals.append(normal / np.linalg.norm(normal))
        places.append(hull.vertices[corner] + by * RADIUS * along / np.linalg.norm(along))
    # The sphere overlaps so far that the corner lies inside it, too, in a direction that is not merged with the edge's.
    places, normals, depth = np.array(places), np.array(normals), 0.2 * RADIUS
    scene = sphere_scene(
        (MeshWall(name="hulls", vertices=hull.vertices, faces=rng.permutation(hull.faces)),),
        places + (RADIUS - depth) * normals,
        1e-6,
    )
    stepper = start(scene)
    stepper.take(1)
    force = by_id(stepper.state, "velocity") * MASS / (0.5 * stepper.dt)
    assert force == pytest.approx(K_WALL * depth * normals, rel=1e-6, abs=1e-6 * K_WALL * depth)


def test_the_energy_in_a_mesh_is_that_in_a_plane(start):
    """Springs store energy at the time of the positions, although a mesh's overlaps are half a step older."""
    vertices, faces = grid_plane()
    rising = Prescribed(velocity=(0.0, 0.0, 0.2))
    flat = PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1), motion=rising)
    stored = []
    for wall in (flat, MeshWall(name="floor", vertices=vertices, faces=faces, motion=rising)):
        scene = Scene(
            name="bounce", duration=1, walls=(wall,), contact=SMOOTH, time_step=TimeStep(fixed=5e-5),
            bodies=(Bodies(positions=[[0, 0, RADIUS]], sizes=2 * RADIUS, density=DENSITY, velocities=[[0, 0, -0.5]]),),
        )  # fmt: skip
        stepper, energies = start(scene), []
        for _ in range(20):
            stepper.take(3)
            energies.append(contact_sums(stepper.model, stepper.state).elastic_energy)
        stored.append(np.array(energies))
    assert stored[1] == pytest.approx(stored[0], rel=1e-9) and stored[0].min() > 0


def test_concave_corner_gives_both_forces(start):
    box = trimesh.creation.box((0.06, 0.06, 0.06))
    wall = MeshWall(name="box", vertices=box.vertices, faces=box.faces)
    depth = 1e-3
    at = 0.03 - RADIUS + depth
    force = force_on_sphere(start, (wall,), np.array([at, at, 0.0]))
    assert force == pytest.approx([-K_WALL * depth, -K_WALL * depth, 0], rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("bend", [False, True])
def test_faceted_pipe_pushes_like_the_round_one(start, bend):
    pieces = (Arc(0.2, math.pi / 2, (1, 0, 0)),) if bend else (Line(0.3),)
    axis = Axis((0, 0, 0), (0, 0, 1), pieces)
    radius, depth, facets = 0.05, 2e-3, 64
    vertices, faces = axis.tube(radius, facets)
    mesh = MeshWall(name="pipe", vertices=vertices, faces=faces)
    exact = PipeWall(name="pipe", axis=axis, radius=radius)
    rng = np.random.default_rng(4)
    point, _, normal, side = axis.frame(0.45 * axis.length)
    sag = radius * (1 - math.cos(math.pi / facets)) + (0.2 + radius) * (0.5 * 0.0049 / 0.25) ** 2 * bend
    for angle in rng.uniform(0, 2 * math.pi, 25):
        outward = math.cos(angle) * normal[0] + math.sin(angle) * side[0]
        place = point[0] + (radius - RADIUS + depth) * outward
        a, b = force_on_sphere(start, (exact,), place), force_on_sphere(start, (mesh,), place)
        assert a == pytest.approx(-K_WALL * depth * outward, rel=1e-9, abs=1e-9)
        # One contact, its overlap deeper by no more than the facets' sag, its direction within a facet's turn.
        assert np.linalg.norm(a) * 0.999 <= np.linalg.norm(b) <= K_WALL * (depth + 1.5 * sag)
        assert a @ b / np.linalg.norm(a) / np.linalg.norm(b) > math.cos(2 * math.pi / facets)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_long_thin_triangles_push_along_their_normal(start, precision):
    # Two metres long, 5 mm wide: products of its coordinates lose all digits in single precision.
    axis = Axis((0, 0, 0), (0, 0, 1), (Line(2.0),))
    vertices, faces = axis.tube(0.05, 64)
    wall = MeshWall(name="pipe", vertices=vertices, faces=faces)
    rng = np.random.default_rng(2)
    for angle, z in zip(rng.uniform(0, 2 * math.pi, 20), rng.uniform(0.1, 1.9, 20)):
        outward = np.array([math.cos(angle), math.sin(angle), 0.0])
        place = (0.05 - RADIUS + 1e-3) * outward + [0, 0, z]
        scene = sphere_scene((wall,), [place], 1e-6)
        stepper = start(scene, precision)
        stepper.take(1)
        force = -stepper.state.walls.force.numpy()[0]
        size = np.linalg.norm(force)
        assert abs(force[2]) < (1e-4 if precision == "float32" else 1e-12) * size
        assert K_WALL * 1e-3 * 0.999 <= size <= K_WALL * (1e-3 + 7e-5)


def test_centre_pushed_through_a_mesh_is_pushed_back(start):
    vertices, faces = grid_plane()
    scene = sphere_scene(
        (MeshWall(name="floor", vertices=vertices, faces=faces),),
        [[0.001, 0.002, RADIUS]],
        1e-5,
        [[0, 0, -math.sqrt(K_WALL / MASS) * 1.3 * RADIUS]],
    )
    stepper = start(scene)
    lowest = 0.0
    for _ in range(1300):
        stepper.take(1)
        lowest = min(lowest, by_id(stepper.state, "position")[0, 2])
    assert lowest == pytest.approx(RADIUS - 1.3 * RADIUS, rel=1e-3)  # 0.3 radii below the floor
    assert by_id(stepper.state, "position")[0, 2] > RADIUS
    assert by_id(stepper.state, "velocity")[0, 2] == pytest.approx(math.sqrt(K_WALL / MASS) * 1.3 * RADIUS, rel=1e-3)


def test_moving_mesh_keeps_its_contacts(start):
    # A triangulated floor rises at 0.2 m/s and carries a sphere for many times its candidate skin.
    vertices, faces = grid_plane()
    floor = MeshWall(
        name="floor", vertices=vertices, faces=faces, motion=Prescribed(velocity=(0.0, 0.0, 0.2), ramp_time=0.05)
    )
    scene = Scene(
        name="lift",
        duration=1,
        walls=(floor,),
        contact=Contact(normal_damping_ratio=0.5),
        time_step=TimeStep(fixed=1e-4),
        bodies=(Bodies(positions=[[0.001, 0.002, RADIUS]], sizes=2 * RADIUS, density=DENSITY),),
    )
    stepper = start(scene, skin=0.35 * RADIUS)
    stepper.advance(1.0)
    lift = by_id(stepper.state, "position")[0, 2] - stepper.state.walls.position.numpy()[0, 2]
    assert stepper.state.walls.position.numpy()[0, 2] > 10 * stepper.mesh_skin
    assert lift == pytest.approx(RADIUS - MASS * 9.81 / K_WALL, rel=1e-5)
