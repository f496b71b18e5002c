"""Axes, bores, meshes, heaps and stones: what functions of plain arrays give for one set of arguments (see `kept`)."""

import kept
import numpy as np
import trimesh
from tubes import bent

from warpcrete import scenes
from warpcrete.dem.measure import blockage, heaps, segregation, station_losses, stations
from warpcrete.dem.measure.wear import patches_of
from warpcrete.dem.scene import clumps, sizes
from warpcrete.dem.scene.containers import low_discrepancy_points
from warpcrete.dem.scene.strokes import held, peaks, stroke_table, strokes_of
from warpcrete.geometry import (
    cleaning,
    crossings,
    curves,
    mesh_axis,
    mesh_parts,
    mesh_sections,
    meshes,
    prisms,
    sections,
    solids,
)
from warpcrete.geometry.axis import Arc, Axis, Line
from warpcrete.geometry.bores import Bores
from warpcrete.geometry.inner_surface import InnerSurface, equal_radii
from warpcrete.geometry.rotation import rotate
from warpcrete.geometry.surfaces import Surfaces
from warpcrete.geometry.walls import MeshWall, PipeWall, PlaneWall, Prescribed

AXIS = Axis(
    (0.1, -0.2, 0.3), (0, 0, 2), (Line(0.3), Arc(0.2, 1.2, (1, 0, 0)), Line(0.1), Arc(0.15, 0.8, (0, 1, 0)), Line(0.2))
)
BORES = Bores((0.1, 0.25, 0.6), (0.06, 0.05, 0.08))
RNG = np.random.default_rng(11)
POINTS = AXIS.at(np.linspace(-0.1, AXIS.length + 0.1, 14))[0] + RNG.normal(0, 0.03, (14, 3))
SPHERES = np.c_[RNG.uniform(-0.1, 0.1, (60, 2)), RNG.uniform(0, 0.05, 60), RNG.uniform(0.004, 0.012, 60)]
SPHERES = np.r_[SPHERES, [[0.4, 0.3, 0.01, 0.01], [0.42, 0.3, 0.01, 0.01]]]
BOX = trimesh.creation.box((0.2, 0.1, 0.3))


def test_axes_and_bores_are_kept():
    s = np.linspace(-0.05, AXIS.length + 0.05, 9)
    kept.compare(
        "axes",
        {
            "axis": AXIS,
            "segments": AXIS.segments(),
            "hinges": AXIS.hinges(),
            "at": AXIS.at(s),
            "frame": AXIS.frame(s),
            "nearest": AXIS.nearest(POINTS),
            "along": AXIS.along(POINTS),
            "projected": AXIS.projected(POINTS),
            "carried": AXIS.carried(s, np.array([1.0, 0.0, 0.0])),
            "parametrised": AXIS.parametrised(),
            "tube": AXIS.tube(0.05, 7),
            "swept": AXIS.swept(s[1:4], np.array([0.05, 0.06, 0.04]), 5),
            "bores": BORES,
            "bore": BORES.at(s),
            "volume": BORES.volume(0.05, 0.5),
            "surface": BORES.surface(0.05, 0.5),
            "spread": BORES.spread(np.linspace(0, 1, 6), 0.7),
            "mesh": BORES.mesh(AXIS, 8, 0.02, 0.03),
            "between": BORES.mesh_between(AXIS, 0.15, 0.55, 6),
            "directions": [
                mesh_parts.directions_at(AXIS, 0.7),
                mesh_parts.directions_at(Axis((0, 0, 0), (1, 0, 0.1), AXIS.pieces), 0.4),
            ],
            "rotated": mesh_parts.rotated_pieces(AXIS.pieces, np.eye(3)[[2, 0, 1]]),
            "together": mesh_parts.together([AXIS.tube(0.05, 3), AXIS.tube(0.04, 4), AXIS.tube(0.03, 5)])[1],
            "crossing": [
                crossings.first_crossing(AXIS, [(0.4, 0.1, 5), (0.3, 0.1, 9), (0.24, 0.1, 5)], gap)
                for gap in (0.0, 0.2, 0.4)
            ],
            "distances": crossings.distances(POINTS[:2], np.stack([POINTS[2:-1], POINTS[3:]], 1)),
            "curve": curves.curve_through(np.array([[0, 0, 0], [0.5, 0.1, 0], [1.0, 0.4, 0.2]]), np.array([1.0, 0, 0])),
            "tangent": curves.start_tangent(POINTS[:4]),
            "biarc": curves.biarc(POINTS[2], np.array([0.0, 0, 1]), POINTS[7], np.array([1.0, 0, 0])),
            "rotate": [rotate(np.tile([0.1, 0.7, 0.1, 0.7], (3, 1)), POINTS[:3], inverse) for inverse in (False, True)],
        },
    )


def test_meshes_are_kept(tmp_path):
    straight = Axis((0, 0, 0), (1, 0, 0), (Line(0.4),))
    path = tmp_path / "tube.stl"
    bent(path, straight, 0.05, 24, wall=4e-3)
    mesh, long = trimesh.load_mesh(path), 0.4
    surface = InnerSurface(
        np.array(mesh.vertices), np.array(mesh.faces), Axis((0, 0, 0), (1, 0, 0), (Line(long),)), 0.05, "wall", "x"
    )
    s = np.linspace(-0.1 * long, 1.1 * long, 7)
    probes = np.c_[np.linspace(-0.1, 1.1, 9) * long, np.linspace(-0.06, 0.06, 9), np.full(9, 0.01)]
    twice = (np.r_[BOX.vertices, BOX.vertices + 1e-9], np.r_[BOX.faces, BOX.faces + 8, BOX.faces[:3, [0, 0, 1]]])
    inner = trimesh.creation.box((0.05, 0.05, 0.05))
    inner.invert()
    hollow = trimesh.util.concatenate([BOX, inner, BOX.copy().apply_translation([1, 0, 0])])
    found = mesh_sections.follow(
        np.array(mesh.vertices), np.array(mesh.faces), np.array([0.0, 0, 0]), [np.array([1.0, 0, 0])], "wall", "x"
    )
    apart = trimesh.util.concatenate([BOX, trimesh.creation.box((0.1, 0.1, 0.1)).apply_translation((0.5, 0, 0))])
    surfaces = Surfaces()
    surfaces.add(np.array(BOX.vertices), np.array(BOX.faces), 0)
    surfaces.add(np.array(inner.vertices), np.array(inner.faces), 3)
    cone, wedge = prisms.truncated_cone(0.1, 0.05, 0.3, 8), prisms.prism([(0, 0), (1, 0), (0.5, 1)], 0.2, (0.5, 0.3))
    kept.compare(
        "meshes",
        {
            "begin": surface.begin,
            "end": surface.end,
            "sections": surface.sections(s, 8),
            "inside": surface._inside(s),
            "distance": surface.distance(probes),
            "radii": equal_radii(surface.sections(s, 8)),
            "kept": [len(surface.faces), surface.origin.sum()],
            "follow": [found.ahead, found.points[::6], found.radii[::6]],
            "pieces": mesh_axis.pieces_through(AXIS.at(np.linspace(0, 0.5, 40))[0], np.array([0.0, 0, 1]), 0.05, 0.05),
            "clean": cleaning.clean(*map(np.array, twice)),
            "merged": cleaning.merged_corners(np.array(twice[0]), 1e-8),
            "border": meshes.border_edges(trimesh.Trimesh(BOX.vertices, BOX.faces[:-2])),
            "solid": [len(solids.without_cavities(mesh).faces) for mesh in (hollow, apart)],
            "signed": meshes.signed_distance(BOX, POINTS - POINTS.mean(0)),
            "faces": meshes.faces_at(BOX, POINTS - POINTS.mean(0), 2.0),
            "rays": meshes.rays(BOX, np.zeros((5, 3)), POINTS[:5] / np.linalg.norm(POINTS[:5], axis=1)[:, None], 1.0),
            "bore": meshes.Bore.of(np.array([[0.05, 0.04, 0.05, 0.06], [0.05, 0.05, 0.04, 0.05]])),
            "probes": meshes.bore_probes(mesh, straight, 0.05, 0.9 * long, 6),
            "surfaces": surfaces,
            "cone": [cone.vertices, cone.faces, cone.without(1, 3)],
            "wedge": [wedge.vertices, wedge.faces, wedge.trimesh().volume],
            "rectangle": prisms.rectangle((0, 0, 0), (1, 0, 0), (0, 2, 0)),
            "area": [
                sections.section_area(
                    [(0, 0), (2, 0), (1, 2)], [[(0.5, 0.2), (1, 0.2), (1, 1)]], width=1.5, height=1.0, axial=axial
                )
                for axial in (False, True)
            ],
        },
    )


def test_heaps_and_stones_are_kept():
    stones = (AXIS.at(np.linspace(0.02, 0.6, 40))[0] + RNG.normal(0, 0.015, (40, 3)), RNG.uniform(3e-3, 9e-3, 40))
    volume, size = stones[1] ** 3 * 4, 2 * stones[1]
    s, apart = np.linspace(0.02, 0.6, 40), np.linspace(0, 1, 40)
    columns = np.linspace(0, 1, 9)
    kept.compare(
        "heaps",
        {
            "surface": heaps.surface(SPHERES, (-0.1, 0.1), (-0.05, 0.12), 0.012),
            "main": heaps.main_body(SPHERES).astype(int),
            "spread": heaps.spread(SPHERES),
            "at": heaps.height_at(SPHERES, (-0.05, 0.1), (0.0, 0.1)),
            "top": heaps.height_of_top(SPHERES, 0.03),
            "around": heaps.height_around(SPHERES, 0.02, 0.06),
            "shadow": heaps.shadow(SPHERES, 0.05, 0.03, 0.004),
            "ball": segregation.ball_points(20),
            "even": segregation.measured(AXIS, 0.05, (*stones, volume, size)),
            "tapered": segregation.measured(AXIS, BORES, (*stones, volume, size)),
            "none": segregation.measured(AXIS, 0.05, (stones[0][:0], *[volume[:0]] * 3)),
            "mixing": [segregation.mixing(s, apart, size > 0.012), segregation.mixing(s, apart, s > 0.3)],
            "travel": [
                blockage.blockage_travel(0.1, length, modulus) for length in (0.2, 1.0, 5.0) for modulus in (1e5, 1e8)
            ],
            "advance": [blockage.least_advance(s, s + 0.02 * (1 + np.sin(9 * s)), volume, end) for end in (0.4, 0.7)],
            "loaded": blockage.last_loaded(columns, 1 - s**2, np.c_[s, s + 0.05]),
            "area": [
                blockage.bore_area([PipeWall(name="pipe", axis=AXIS, radius=0.05, material="wall")], AXIS, 0.05, 0.3)
            ],
            "spread_evenly": stations._spread_evenly(s, s + 0.05 * np.cos(9 * s), np.c_[volume, s], columns),
            "filled": stations._filled_slices(columns, 0.1, s, volume),
            "front": stations._front(s, volume, 0.4 * volume.sum()),
            "mean": [station_losses._logarithmic_mean(*pair) for pair in ((1.0, 2.0), (3.0, 3.0), (5.0, 4.9999))],
        },
    )


def test_shapes_of_aggregates_are_kept():
    rng = np.random.default_rng
    curve = (4e-3, 8e-3, 16e-3), (0.0, 0.4, 1.0)
    union = clumps.union_properties(np.array([[0, 0, 0], [0.6, 0.1, 0], [0, 0.5, 0.4]]), np.array([0.5, 0.4, 0.6]), 60)
    own = clumps.clump("own", np.array([[0, 0, 0], [0.6, 0.1, 0], [0, 0.5, 0.4]]), np.array([0.5, 0.4, 0.6]))
    kept.compare(
        "aggregates",
        {
            "sets": {name: clumps.templates(name) for name in clumps.TEMPLATE_SETS},
            "union": union,
            "own": [own.radii, own.inertia],
            "gaussian": sizes.Gaussian(0.01, 0.004, 0.005, 0.02).sample(30, rng(2)),
            "uniform": sizes.Uniform(0.005, 0.02).sample(9, rng(2)),
            "sieve": [sizes.SieveCurve(*curve).sample(30, rng(2)), sizes.SieveCurve(*curve)],
            "points": low_discrepancy_points(9, rng(2)),
        },
    )


def test_worn_patches_are_kept():
    pipe = PipeWall(name="pipe", axis=AXIS, radius=0.05, material="wall")
    plate = PlaneWall(name="plate", point=(0, 0, 0.1), normal=(0, 1, 1), material="wall", drawn_radius=0.2)
    mesh = MeshWall(name="box", vertices=np.array(BOX.vertices), faces=np.array(BOX.faces), material="wall")
    moving = PlaneWall(
        name="piston",
        point=(0, 0, 0),
        normal=(0, 0, 1),
        material="wall",
        motion=Prescribed(velocity=(0, 0, 0.3), spin=(0.5, 0, 0), pivot=(0, 0.2, 0), ramp_time=0.4),
    )
    found = {}
    for wall in (pipe, plate, mesh):
        patches = patches_of(wall, 0.03)
        found[wall.name] = [
            patches.areas,
            patches.of(POINTS - (0 if wall is pipe else POINTS.mean(0))),
            patches.surface(),
            wall.drawn(),
        ]
    found["place"] = patches_of(pipe, 0.03).place(POINTS)
    found["speeds"] = [wall.top_speed() for wall in (pipe, moving)]
    found["points"] = [wall.reference_points for wall in (pipe, plate, mesh)]
    kept.compare("patches", found)


def test_strokes_of_a_piston_are_kept():
    pipe = scenes.pipe(strokes=3, pause=0.5, stroke=0.2, ramp=0.05).pipe
    time = np.linspace(0, 4, 81)
    series = {"time": time, "pressure": 3e3 + 500 * np.sin(3 * time), "travel": 0.1 * time}
    kept.compare(
        "strokes",
        {
            "strokes": strokes_of(pipe, time),
            "peaks": peaks(pipe, series),
            "held": held(pipe, series),
            "table": stroke_table(pipe, series),
        },
    )
