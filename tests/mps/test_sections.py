"""Tests of the areas and volumes of sections of vessels."""

import math

import numpy as np
import pytest
import trimesh

from warpcrete import scenes
from warpcrete.geometry.sections import section_area
from warpcrete.geometry.walls import MeshWall
from warpcrete.methods import method_of
from warpcrete.mps.free.quantities import start_volume
from warpcrete.mps.free.scene import FreeScene
from warpcrete.theory.pipe import Concrete
from warpcrete.theory.vessels import box_at_rest, cone_volume

SQUARE = ((0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.0, 1.0))


def test_area_inside_a_room_and_outside_holes_that_overlap():
    assert section_area(SQUARE) == pytest.approx(2.0, rel=1e-12)
    assert section_area(SQUARE[::-1], width=1.5, height=0.5) == pytest.approx(0.75, rel=1e-12)
    triangle, bar = ((-1.0, 0.0), (1.0, 0.0), (-1.0, 2.0)), ((0.25, -1.0), (1.75, -1.0), (1.75, 0.5), (0.25, 0.5))
    # The triangle takes half a square, the bar 1.5 by 0.5 less the triangle over 0.25..1 below 0.5.
    both = 0.5 + 0.75 - (0.25 * 0.5 + 0.5 * 0.5**2)
    assert section_area(SQUARE, (triangle, bar)) == pytest.approx(2.0 - both, rel=1e-12)
    star = tuple((math.cos(4 * math.pi * k / 5), math.sin(4 * math.pi * k / 5)) for k in range(5))  # crosses itself
    assert section_area(SQUARE, (SQUARE,)) == 0.0 and 0 < section_area(star) < math.pi / 2


def test_holes_that_cross_between_the_heights_of_their_corners():
    """Two triangles cross at (0.8, 0.6), at 0.6 of the length of one edge and at 0.8 of the other's."""
    one, other = ((0.0, 0.0), (2.0, 0.0), (0.0, 1.0)), ((0.0, -1.0), (1.0, 1.0), (0.0, 1.0))
    shared = (0.6 + 0.6**2 / 2) / 2 + 0.4**2  # below the crossing within the second, above it within the first
    for holes in ((one, other), (other, one)):
        assert section_area(SQUARE, holes) == pytest.approx(2.0 - (1.0 + 0.75 - shared), rel=1e-12)


def test_a_radian_of_a_cone_and_of_a_ring():
    cone = ((0.0, 0.0), (0.1, 0.0), (0.05, 0.3), (0.0, 0.3))
    assert section_area(cone, axial=True) == pytest.approx(cone_volume(0.05, 0.1, 0.3) / (2 * math.pi), rel=1e-12)
    ring = math.pi * (4 - 1.5**2) / (2 * math.pi)
    assert section_area(SQUARE, (((0, -1), (1.5, -1), (1.5, 2), (0, 2)),), axial=True) == pytest.approx(ring, rel=1e-12)


def test_vessels_hold_what_their_dimensions_say():
    """A quarter of a V-funnel, half an L-box's column, a radian of a cone."""
    funnel = scenes.funnel()
    size = funnel.dimensions
    half = size["breadth"] / 2
    area = size["outlet_width"] / 2 * size["outlet_height"]
    area += (size["outlet_width"] + size["top_width"]) / 4 * size["cone_height"]
    assert start_volume(funnel) == pytest.approx(area * half, rel=1e-9)
    assert start_volume(scenes.lbox()) == pytest.approx(0.1 * 0.6 * 0.1, rel=1e-9)
    assert start_volume(scenes.slump()) == pytest.approx(cone_volume(0.05, 0.1, 0.3) / (2 * math.pi), rel=1e-9)


def test_the_box_at_rest_is_that_of_its_column():
    scene = scenes.lbox()
    concrete = scene.concrete
    near, far, _ = box_at_rest(0.012, scene.width, 0.2, concrete.yield_stress, concrete.density, scene.gravity)
    found = method_of(scene).expected(scene)["passing_ratio"]
    assert found == pytest.approx(far / near, rel=1e-9)


def test_a_wall_in_space_takes_its_part():
    box = trimesh.creation.box(bounds=[[0.0, -1.0, -1.0], [0.05, 1.0, 1.0]])
    scene = FreeScene(
        name="half", concrete=Concrete(density=2000.0, viscosity=30.0, yield_stress=40.0,
                                                    slip_viscosity=1e3, slip_yield=0.0), axial=False,
        width=0.2, height=0.2, depth=0.1, spacing=0.02, outline=((0, 0), (0.1, 0), (0.1, 0.1), (0, 0.1)),
        walls=(MeshWall(name="step", vertices=box.vertices, faces=box.faces),), amid=(0.15, 0.05, 0.05),
    )  # fmt: skip
    assert np.isclose(start_volume(scene), 0.5 * 0.1**3, rtol=1e-9)
