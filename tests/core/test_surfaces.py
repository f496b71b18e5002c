"""Surfaces of concrete from levels on a grid: closed, of the right volume, outward, cut open, empty."""

import numpy as np
import pytest
import trimesh

from warpcrete.core.drawing.surfaces import Cut, Level, revolved, smoothed, surface_of

H = 0.05
NODES = np.arange(-1 + H / 2, 1, H)


def grid(*places):
    return np.meshgrid(*places, indexing="ij")


def clipped(distance):
    return np.clip(distance / H, -0.5, 0.5)


def ball(radius=0.6, kind=float):
    x, y, z = grid(NODES, NODES, NODES)
    level = clipped(radius - np.sqrt(x**2 + y**2 + z**2)).astype(kind)
    return Level((NODES, NODES, NODES), level, {"height": z.astype(kind)})


def heap(kind=float):
    """A cylinder of radius 0.6 and height 0.4 on the floor, as a section through the axis."""
    nodes = np.arange(H / 2, 1, H)
    r, z = grid(nodes, nodes)
    return Level((nodes, nodes), np.minimum(clipped(0.6 - r), clipped(0.4 - z)).astype(kind), {"radius": r})


def is_closed(surface):
    found = trimesh.Trimesh(surface.vertices, surface.faces)
    found.merge_vertices(merge_norm=True)
    return found.is_watertight and found.is_winding_consistent


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_a_ball_is_closed_and_as_large_as_it_is(kind):
    """Measured 0.7 % too small with twelve cells over the radius, because vertices lie on chords."""
    surface = surface_of(ball(kind=kind))
    assert is_closed(surface) and 0.991 < surface.volume / (4 / 3 * np.pi * 0.6**3) < 1
    outward = surface.vertices / np.linalg.norm(surface.vertices, axis=1)[:, None]
    assert np.sum(outward * surface.normals, axis=1).min() > 0.99  # measured 0.997
    assert surface.fields["height"] == pytest.approx(surface.vertices[:, 2], abs=H)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("half", [False, True])
def test_a_heap_of_revolution_is_closed_and_as_large_as_it_is(half, kind):
    """Measured 0.7 % too small, because the free edge is rounded; the edge on the floor is sharp."""
    surface = revolved(heap(kind), half)
    whole = np.pi * 0.6**2 * 0.4
    assert is_closed(surface) and 0.992 < surface.volume / (whole / 2 if half else whole) < 1
    assert surface.vertices.min(0) == pytest.approx([-0.6, 0.0 if half else -0.6, 0.0], abs=1e-6)
    assert surface.vertices.max(0) == pytest.approx([0.6, 0.6, 0.4], abs=1e-6)
    radius = np.hypot(*surface.vertices[:, :2].T)
    assert surface.fields["radius"] == pytest.approx(radius, abs=H)
    if half:  # The section is flat, filled, and seen from the front.
        flat = np.all(np.abs(surface.normals - [0, -1, 0]) < 1e-6, axis=1)
        corners = surface.vertices[surface.faces[np.all(flat[surface.faces], axis=1)]][:, :, [0, 2]]
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        assert 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() == pytest.approx(1.2 * 0.4, rel=0.006)


@pytest.mark.parametrize("cells", [8, 16, 32])
def test_a_block_lies_between_its_walls(cells):
    """Sides of the grid, edges and corners are exact."""
    nodes = (np.arange(cells) + 0.5) / cells
    surface = surface_of(Level((nodes,) * 3, np.full((cells,) * 3, 0.5)))
    assert surface.vertices.min(0) == pytest.approx(0) and surface.vertices.max(0) == pytest.approx(1)
    assert is_closed(surface) and surface.volume == pytest.approx(1)


@pytest.mark.parametrize("fill", [0.05, 0.3, 0.45])
def test_a_partly_filled_layer_is_as_high_as_its_fill(fill):
    """Level 0.5 below, `fill` in the layer and -0.5 above it: the height is off by at most 0.09 cells."""
    x, z = NODES[:8], NODES[:8]
    level = np.full((8, 8, 8), -0.5)
    level[:, :, :4], level[:, :, 4] = 0.5, fill
    surface = surface_of(Level((x, x, z), level))
    assert surface.vertices[:, 2].max() == pytest.approx(z[0] - H / 2 + (4.5 + fill) * H, abs=0.09 * H)


@pytest.mark.parametrize("normal", [(0.0, 1.0, 0.0), (0.6, 0.8, 0.0)])
def test_a_cut_leaves_half_a_ball_with_a_sharp_flat_face(normal):
    normal = np.array(normal)
    surface = surface_of(ball(), Cut(normal, 0.0))
    depth = surface.vertices @ normal
    assert is_closed(surface) and depth.min() > -1e-9
    assert surface.volume / (2 / 3 * np.pi * 0.6**3) == pytest.approx(1, abs=0.008)  # measured 0.0073
    on_plane = np.linalg.norm(surface.vertices[depth < 1e-9], axis=1)
    assert len(on_plane) > 300 and on_plane.max() == pytest.approx(0.6, rel=0.03)


def test_mirror_images_meet_without_a_seam():
    whole, part = ball(), (slice(20, None),) * 3
    upper = Level(tuple(p[20:] for p in whole.places), whole.values[part], {"height": whole.fields["height"][part]})
    found = surface_of(upper.mirrored(0).mirrored(1).mirrored(2))
    assert is_closed(found) and found.volume == pytest.approx(surface_of(whole).volume, rel=1e-9)


@pytest.mark.parametrize("shape", [(0, 0, 0), (1, 1, 1), (5, 6, 7)])
def test_where_there_is_no_concrete_there_is_no_surface(shape):
    level = Level(tuple(H * np.arange(n) for n in shape), np.full(shape, -0.5), {"height": np.zeros(shape)})
    empty = surface_of(level)
    assert empty.vertices.shape == (0, 3) and empty.faces.shape == (0, 3) and empty.volume == 0
    for half in (False, True):
        section = Level(level.places[:2], level.values[:, :, 0] if shape[2] else np.zeros((0, 0)))
        assert len(revolved(section, half).faces) == 0


def test_one_full_cell_is_a_small_body_amid_empty_ones():
    values = np.full((3, 3, 3), -0.5)
    values[1, 1, 1] = 0.5
    surface = surface_of(Level((H * np.arange(3.0),) * 3, values))
    assert is_closed(surface) and 0 < surface.volume < H**3 and len(surface.vertices) == 8


def test_smoothing_keeps_the_sum_away_from_the_sides():
    values = np.zeros((7, 7))
    values[3, 3] = 1.0
    found = smoothed(values)
    assert found.sum() == pytest.approx(1) and found[2:5, 3] == pytest.approx([0.125, 0.25, 0.125])
