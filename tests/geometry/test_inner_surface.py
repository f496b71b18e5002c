"""The bore of a mesh: what its axis sees, whatever lies outside, and where it leads."""

import numpy as np
import pytest
import trimesh
from tubes import bent

from warpcrete import SceneError, scenes
from warpcrete.geometry import mesh_parts
from warpcrete.geometry.axis import Arc, Axis, Line
from warpcrete.geometry.inner_surface import InnerSurface
from warpcrete.geometry.lines import line_of
from warpcrete.geometry.mesh_axis import pieces_through
from warpcrete.geometry.mesh_parts import WAYS
from warpcrete.geometry.mesh_sections import follow
from warpcrete.mps.part.layout import Frame, bore_distance

STRAIGHT = Axis((0, 0, 0), (1, 0, 0), (Line(0.6),))
EIGHTH = np.pi / 4
BENDS = {
    "S": Axis(
        (0, 0, 0), (1, 0, 0), (Line(0.1), Arc(0.25, EIGHTH, (0, 0, 1)), Arc(0.25, EIGHTH, (0, 0, -1)), Line(0.1))
    ),
    "elbow": Axis((0, 0, 0), (1, 0, 0), (Line(0.1), Arc(0.1, 2 * EIGHTH, (0, 1, 0)), Line(0.1))),
    "in space": Axis(
        (0, 0, 0), (1, 0, 0), (Line(0.1), Arc(0.2, 2 * EIGHTH, (0, 1, 0)), Arc(0.2, EIGHTH, (0, 0, 1)), Line(0.1))
    ),
    "without straight ends": Axis((0, 0, 0), (1, 0, 0), (Arc(0.3, 2 * EIGHTH, (0, 0, 1)),)),
}  # fmt: skip
FLOW = {"concrete": "no1", "flow": 1.5e-3, "straight": 0.3, "spacing": 0.0125, "gravity": 0.0}


def repeated(path, change):
    """Write the triangles of a file as `change` makes them of vertices and faces, and return the path."""
    mesh = trimesh.load_mesh(path)
    trimesh.Trimesh(*change(np.array(mesh.vertices), np.array(mesh.faces)), process=False).export(path)
    return path


LONG = {"before": 0.05, "after": 0.05}
TUBES = {
    "a wall of 0.5 mm": {"wall": 0.5e-3, **LONG},
    "a wall of 4 mm": {"wall": 4e-3, **LONG},
    "a wall of 30 mm": {"wall": 30e-3, **LONG},
    "a wall that ends with the part": {"wall": 4e-3},
    "an open tube that ends with the part": {},
    "lids that end with the part": {"lids": True},
    "lids 5 mm beyond": {"lids": True, "before": 5e-3, "after": 5e-3},
    "open ends 20 mm beyond": {"before": 0.02, "after": 0.02},
    "a square skin": {"wall": 4e-3, "square": True, **LONG},
    "a skin aside": {"wall": 8e-3, "aside": 5e-3, **LONG},
}
CHANGES = {
    "every triangle twice": lambda v, f: (v, np.concatenate([f, f])),
    "both sides": lambda v, f: (v, np.concatenate([f, f[:, ::-1]])),
    "corners not merged": lambda v, f: (v[f].reshape(-1, 3), np.arange(f.size).reshape(-1, 3)),
}


@pytest.fixture(scope="module")
def open_tube(tmp_path_factory):
    return distances(bent(tmp_path_factory.mktemp("tube") / "open.stl", STRAIGHT, **LONG))


def distances(path):
    """Distances from the wall that the cells of a straight part see, inside and outside and beyond both ends."""
    scene = scenes.part(unit="horizontal", wall=str(path), **FLOW)
    random = np.random.default_rng(7)
    along = random.uniform(-0.02, 0.62, 500)
    aside = random.uniform(-0.06, 0.06, (500, 2))
    return bore_distance(scene)(Frame(scene).to_grid(np.column_stack([along, aside])))


@pytest.mark.parametrize("made", TUBES.values(), ids=TUBES)
def test_a_bore_is_the_same_whatever_lies_outside(tmp_path, open_tube, made):
    found = distances(bent(tmp_path / "tube.stl", STRAIGHT, **made))
    inside = open_tube > 0
    assert 100 < np.count_nonzero(inside) < 400
    assert np.array_equal(found > 0, inside)
    assert found[inside] == pytest.approx(open_tube[inside], abs=2e-7)


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_a_bore_is_the_same_however_its_triangles_are_stored(tmp_path, open_tube, change):
    path = repeated(bent(tmp_path / "tube.stl", STRAIGHT, wall=4e-3, **LONG), change)
    inside = open_tube > 0
    found = distances(path)
    assert np.array_equal(found > 0, inside) and found[inside] == pytest.approx(open_tube[inside], abs=2e-7)


def test_the_inner_surface_keeps_the_facets_of_the_bore_alone(tmp_path):
    """The bore of a thick tube has as many facets as an open tube.

    A step inside the bore is one of the bore's walls.
    """
    mesh = trimesh.load_mesh(bent(tmp_path / "thick.stl", STRAIGHT, wall=4e-3))
    surface = InnerSurface(mesh.vertices, mesh.faces, STRAIGHT, 0.05, "wall", "thick")
    assert len(surface.faces) == 2 * 64 * (1 + int(0.6 / 0.01)) and np.all(np.diff(surface.origin) > 0)
    assert np.linalg.norm(surface.vertices[:, 1:], axis=1) == pytest.approx(0.05, rel=1e-6)
    points, faces = STRAIGHT.swept(np.array([0.0, 0.3, 0.3 + 1e-9, 0.6]), np.array([0.05, 0.05, 0.04, 0.04]), 64)
    step = InnerSurface(points, faces, STRAIGHT, 0.05, "wall", "step")
    assert len(step.faces) == len(faces)
    assert step.distance(np.array([[0.299, 0.045, 0.0]])) == pytest.approx(1e-3, rel=0.01)


@pytest.mark.parametrize(
    ("cut", "words"),
    [
        (lambda x: x[:, 0] < 0.5, r"encloses the axis from 0 to 0\.50\d* m, but the part extends from 0 to 0\.6 m"),
        (lambda x: x[:, 0] > 0.1, r"encloses the axis from 0\.09\d* to 0\.6 m"),
        (lambda x: (np.abs(x[:, 0] - 0.3) > 0.06) | (x[:, 1] < 0), r"has gaps along the axis: \d+ of \d+ cross-sec"),
        (lambda x: (np.abs(x[:, 0] - 0.31) > 0.006) | (x[:, 1] < 0.049), r"is not closed: \d+ edges between"),
    ],
)  # fmt: skip
def test_a_mesh_that_is_no_whole_bore_is_refused(tmp_path, cut, words):
    whole = trimesh.load_mesh(bent(tmp_path / "tube.stl", STRAIGHT))
    trimesh.Trimesh(whole.vertices, whole.faces[cut(whole.triangles_center)]).export(tmp_path / "cut.stl")
    with pytest.raises(SceneError, match=rf"^wall = '.*cut\.stl': {words}"):
        scenes.part(unit="horizontal", wall=str(tmp_path / "cut.stl"), **FLOW)


@pytest.mark.parametrize("bend", BENDS.values(), ids=BENDS)
@pytest.mark.parametrize("made", [{}, {"lids": True}, {"wall": 4e-3}], ids=["open", "lids", "wall"])
def test_the_axis_of_a_bent_bore_is_found(tmp_path, bend, made):
    """It ends where the mesh does, in its direction, and lies nowhere a hundredth of the radius beside."""
    mesh = trimesh.load_mesh(bent(tmp_path / "bend.stl", bend, **made))
    found = follow(mesh.vertices, mesh.faces, np.zeros(3), [np.array(way, float) for way in WAYS], "wall", "bend")
    assert found.ahead.tolist() == [1, 0, 0] and found.radii[:-1] == pytest.approx(0.05, rel=2e-3)
    pieces = pieces_through(found.points, found.ahead, 0.05, 0.05)
    axis = Axis((0, 0, 0), (1, 0, 0), pieces)
    assert len(pieces) < 20 and axis.length == pytest.approx(bend.length, abs=5e-4)
    (end,), (way,) = axis.at(axis.length)
    (known,), (ahead,) = bend.at(bend.length)
    assert np.linalg.norm(end - known) < 5e-4 and np.linalg.norm(way - ahead) < 0.01
    middles = bend.at(np.linspace(0, bend.length, 200))[0]
    assert np.linalg.norm(middles - axis.nearest(middles), axis=1).max() < 0.01 * 0.05


def coarse(path, rings):
    """Write an elbow of 100 mm between straights of 300 mm, with few rings of triangles around its bend."""
    axis = Axis((0, 0, 0), (1, 0, 0), (Line(0.3), Arc(0.3, 2 * EIGHTH, (0, 0, 1)), Line(0.3)))
    stations = np.concatenate([[0.0], 0.3 + np.linspace(0.0, 0.6 * EIGHTH, rings), [axis.length]])
    trimesh.Trimesh(*axis.swept(stations, 0.05, 48), process=False).export(path)
    return path, axis


@pytest.mark.parametrize("rings", [4, 6, 8, 12])
def test_an_elbow_of_few_rings_has_a_smooth_axis(tmp_path, rings):
    """The axis rounds the kinks of the mesh: it is within 0.064 radii of the polygon through the rings' centres."""
    path, true = coarse(tmp_path / "elbow.stl", rings)
    axis = scenes.part(wall=str(path), **FLOW).axis
    arcs = [piece for piece in axis.pieces if isinstance(piece, Arc)]
    assert min(arc.radius for arc in arcs) > 0.05
    turned = np.cross(axis.at(0.0)[1][0], axis.at(axis.length)[1][0])
    assert np.linalg.norm(turned) == pytest.approx(1.0, abs=1e-3)
    sagitta = 0.3 * (1 - np.cos(2 * EIGHTH / (rings - 1) / 2))
    points = axis.at(np.linspace(0.3, axis.length - 0.3, 200))[0]
    offset = points - axis.at(0.3)[0][0]
    assert np.linalg.norm(offset - true.nearest(offset), axis=1).max() < sagitta + 0.064 * 0.05


def test_a_bend_that_is_too_sharp_for_a_flow_is_refused_in_one_line(tmp_path, monkeypatch):
    path, _ = coarse(tmp_path / "elbow.stl", 6)
    monkeypatch.setattr("warpcrete.geometry.mesh_axis.AXIS_TOLERANCES", (0.004,))
    mesh_parts._measured.cache_clear()
    with pytest.raises(SceneError, match=r"^wall = '.*': bends too sharply .* more rings of triangles"):
        scenes.part(wall=str(path), **FLOW)
    mesh_parts._measured.cache_clear()


@pytest.mark.parametrize("sharp", [0.075, 0.1, 0.15])
@pytest.mark.parametrize("stretch", [0.02, 0.2])
def test_the_axis_of_a_tight_elbow_is_found_to_its_end(tmp_path, sharp, stretch):
    """Radii of 0.75, 1 and 1.5 diameters, between stretches of a fifth of a diameter and of two."""
    elbow = Axis((0, 0, 0), (1, 0, 0), (Line(stretch), Arc(sharp, 2 * EIGHTH, (0, 0, 1)), Line(stretch)))
    mesh = trimesh.load_mesh(bent(tmp_path / "elbow.stl", elbow, wall=4e-3))
    found = follow(mesh.vertices, mesh.faces, np.zeros(3), [np.array([1.0, 0, 0])], "wall", "elbow")
    axis = Axis((0, 0, 0), (1, 0, 0), pieces_through(found.points, found.ahead, 0.05, 0.05))
    (end,), (way,) = axis.at(axis.length)
    (known,), (ahead,) = elbow.at(elbow.length)
    # A stretch shorter than a radius shows no direction of its own: the end is off by up to 3.5 mm and 3 degrees.
    near, askew = (5e-4, 0.01) if stretch == 0.2 else (4e-3, 0.06)
    assert np.linalg.norm(end - known) < near and np.linalg.norm(way - ahead) < askew


@pytest.mark.parametrize("begin", [-0.3, -0.05])
def test_a_mesh_that_begins_before_its_origin_is_refused(tmp_path, begin):
    axis = Axis((begin, 0, 0), (1, 0, 0), (Line(0.6),))
    bent(tmp_path / "tube.stl", axis)
    for make in (scenes.part, scenes.part_dem):
        with pytest.raises(SceneError, match="extends behind its origin, where it should begin; move the mesh so that"):
            make(wall=str(tmp_path / "tube.stl"))


def test_walls_that_nothing_can_follow_are_refused(tmp_path):
    """An undercut hides a part of the wall; a plate with a thickness closes the end; unit mesh needs a mesh."""
    s, radii = [0, 0.2, 0.19, 0.25, 0.26, 0.6], [0.05, 0.05, 0.06, 0.06, 0.05, 0.05]
    points, faces = STRAIGHT.swept(np.array(s), np.array(radii), 64)
    trimesh.Trimesh(points, faces, process=False).export(tmp_path / "groove.stl")
    with pytest.raises(SceneError, match=r"has an undercut .wall that is not visible from the axis. 0\.[12]\d* m"):
        scenes.part(unit="horizontal", wall=str(tmp_path / "groove.stl"), **FLOW)
    for make in (scenes.part, scenes.part_dem):
        with pytest.raises(SceneError, match="unit = 'mesh': needs a "):
            make(unit="mesh")


def test_a_part_goes_as_its_mesh_does(tmp_path):
    """Diameter, length and rise come from the mesh, and pipe goes on straight before and behind it."""
    path = bent(tmp_path / "s.stl", BENDS["S"], wall=4e-3)
    scene = scenes.part(wall=str(path), **FLOW | {"straight": 0.25})
    assert scene.parameters["unit"] == "mesh" and scene.radius == pytest.approx(0.05, rel=2e-3)
    assert scene.axis.length == pytest.approx(0.5 + BENDS["S"].length, abs=5e-4)
    assert scene.rise == pytest.approx(2 * 0.25 * (1 - np.cos(EIGHTH)), abs=2e-4)
    assert scene.insert == scene.middle == pytest.approx((0.25, 0.25 + BENDS["S"].length), abs=5e-4)
    assert scene.bore(np.linspace(0, scene.axis.length, 50)) == pytest.approx(0.05, rel=3e-3)
    middles = scene.axis.at(np.linspace(0, scene.axis.length, 50))[0]
    assert bore_distance(scene)(Frame(scene).to_grid(middles)) == pytest.approx(0.05, rel=0.01)
    up = Axis((0, 0, 0), (0, 0, 1), (Line(0.1), Arc(0.2, EIGHTH, (1, 0, 0)), Line(0.1)))
    upright = scenes.part(wall=str(bent(tmp_path / "up.stl", up)), **FLOW)
    assert upright.axis.tangent == (0, 0, 1) and upright.rise > 0.6


def test_a_line_goes_on_where_a_bent_bore_leads(tmp_path):
    bent(tmp_path / "elbow.stl", BENDS["elbow"], facets=96)
    parts = [{"straight": 1}, {"bend": {"to": "up", "radius": 0.3}}, {"bore": {"file": "elbow.stl"}}, {"straight": 1}]
    line = line_of({"diameter": "100 mm", "parts": parts}, "it", tmp_path)
    assert line.parts[2].length == pytest.approx(BENDS["elbow"].length, abs=5e-4)
    # The mesh turns from its x to its y, which lies to the left of a line that went level and then up.
    assert line.axis.at(line.length)[1][0] == pytest.approx([0, 1, 0], abs=0.01)
    assert line.parts[2].rise == pytest.approx(0.2, abs=1e-3) and line.parts[3].rise == pytest.approx(0, abs=0.01)


def test_elements_go_through_a_bent_bore(tmp_path):
    """The wall is the inner surface between round pipes, all along the axis."""
    path = bent(tmp_path / "s.stl", BENDS["S"], radius=0.04, wall=1e-3)
    scene = scenes.part_dem(wall=str(path), straight=0.15, size_min=12e-3, size_max=20e-3, travel=0.04, flow=1e-3)
    wall = next(wall for wall in scene.walls if wall.name == "pipe")
    middles = scene.pipe.axis.at(np.linspace(0.01, scene.pipe.axis.length - 0.01, 100))[0]
    apart = trimesh.proximity.closest_point_naive(trimesh.Trimesh(wall.vertices, wall.faces), middles)[1]
    assert apart == pytest.approx(0.04, rel=0.02)
    beyond = np.linalg.norm(wall.vertices - scene.pipe.axis.nearest(wall.vertices), axis=1)
    assert beyond.max() < 0.0404, "no outer skin"


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda mesh: mesh.apply_translation((0.2, 0.1, 0)), "has no closed cross-section at its origin"),
        (lambda mesh: mesh.apply_translation((0, 0.01, 0)), r"does not begin at its origin: .* lies 0\.01 m beside"),
        (
            lambda mesh: mesh.apply_scale(1e3),
            r"wall_scale = 1\.0: makes the bore 99\.9\d* m wide .*; use --wall-scale 0\.001 for a file in mill",
        ),
    ],
)
def test_a_bore_that_cannot_be_followed_says_why_in_one_line(tmp_path, made, words):
    mesh = trimesh.load_mesh(bent(tmp_path / "s.stl", BENDS["S"]))
    made(mesh).export(tmp_path / "moved.stl")
    with pytest.raises(SceneError, match=words) as caught:
        scenes.part(wall=str(tmp_path / "moved.stl"), **FLOW)
    assert "\n" not in str(caught.value)


@pytest.mark.thorough
def test_the_pressure_of_a_bent_bore_is_that_of_bends(device, tmp_path):
    """An S of two bends costs what a line of the same bends does; its polygon of 96 corners is 0.1 % narrower."""
    from warpcrete.methods import Simulation

    bend = Axis((0, 0, 0), (1, 0, 0), (Arc(0.25, EIGHTH, (0, 0, 1)), Arc(0.25, EIGHTH, (0, 0, -1))))
    path = bent(tmp_path / "s.stl", bend, facets=96, wall=4e-3)
    bends = "{bend: {to: up, angle: 45, radius: 0.25}}, {bend: {to: level, radius: 0.25}}"
    parts = f"[{{straight: 0.3}}, {bends}, {{straight: 0.3}}]"
    (tmp_path / "s.yaml").write_text(f"diameter: 100 mm\nparts: {parts}\n", encoding="utf-8")
    given = {name: value for name, value in FLOW.items() if name != "straight"}
    meshed = Simulation(scenes.part(wall=str(path), **FLOW), device=device).run().result
    known = Simulation(scenes.part(line=str(tmp_path / "s.yaml"), **given), device=device).run().result
    assert meshed["pressure"]["value"] == pytest.approx(known["pressure"]["value"], rel=0.01)


@pytest.mark.parametrize("down", [False, True], ids=["up", "down"])
def test_a_mesh_in_a_vertical_pipe_lies_as_behind_a_bend_from_a_level_one(down):
    """The level pipe leads along x, and a mesh in it has its own directions."""
    way = (0.0, 0.0, -1.0 if down else 1.0)
    bend = Axis((0, 0, 0), (1, 0, 0), (Line(0.5), Arc(0.4, np.pi / 2, way), Line(0.5)))
    assert mesh_parts.directions_at(bend, 0.2) == pytest.approx(np.eye(3), abs=1e-12)
    vertical = mesh_parts.directions_at(Axis((0, 0, 0), way, (Line(1.0),)), 0.3)
    assert vertical == pytest.approx(mesh_parts.directions_at(bend, bend.length - 0.1), abs=1e-12)
    assert vertical == pytest.approx(np.array([way, [0, 1, 0], [way[2] * -1.0, 0, 0]]), abs=1e-12)
