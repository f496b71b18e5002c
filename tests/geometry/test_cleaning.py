"""Cleaning of triangle meshes: one corner for each place, one triangle for each surface."""

import numpy as np
import pytest
import trimesh

from warpcrete.geometry.cleaning import clean


def box():
    made = trimesh.creation.box((0.2, 0.1, 0.3)).subdivide()
    return np.array(made.vertices), np.array(made.faces)


def test_a_clean_mesh_keeps_its_arrays():
    vertices, faces = box()
    cleaned, kept, origin = clean(vertices, faces)
    assert np.array_equal(cleaned, vertices) and np.array_equal(kept, faces)
    assert np.array_equal(origin, np.arange(len(faces))) and kept.dtype == faces.dtype


@pytest.mark.parametrize("apart", [0.0, 1e-8])
def test_separate_corners_of_each_triangle_become_shared(apart):
    vertices, faces = box()
    rng = np.random.default_rng(3)
    loose = vertices[faces].reshape(-1, 3) + 2.0 + apart * rng.uniform(-1, 1, (3 * len(faces), 3))
    cleaned, kept, origin = clean(loose, np.arange(len(loose)).reshape(-1, 3))
    mesh = trimesh.Trimesh(cleaned, kept, process=False)
    assert len(cleaned) == len(vertices) and len(kept) == len(faces) and mesh.is_watertight
    assert mesh.volume == pytest.approx(0.2 * 0.1 * 0.3, rel=1e-5) and np.array_equal(origin, np.arange(len(faces)))


def test_repeated_triangles_are_dropped_whichever_way_they_wind():
    vertices, faces = box()
    rng = np.random.default_rng(4)
    again = np.concatenate([faces, faces[:, ::-1], np.roll(faces, 1, axis=1)])
    order = rng.permutation(len(again))
    cleaned, kept, origin = clean(vertices, again[order])
    assert np.array_equal(cleaned, vertices) and len(kept) == len(faces)
    assert np.array_equal(again[order][origin], kept)
    assert len({tuple(sorted(face)) for face in kept.tolist()}) == len(faces)
    assert np.all(np.diff(origin) > 0)


def test_triangles_without_area_are_dropped_with_the_corners_that_only_they_use():
    vertices, faces = box()
    extra = np.concatenate([vertices, [[0.5, 0.0, 0.0], [0.6, 0.0, 0.0], [0.7, 1e-9, 0.0]]])
    flat = np.array([[0, 0, 1], [len(vertices), len(vertices) + 1, len(vertices) + 2]])
    cleaned, kept, origin = clean(extra, np.concatenate([flat, faces]))
    assert np.array_equal(cleaned, vertices) and np.array_equal(kept, faces)
    assert np.array_equal(origin, np.arange(len(faces)) + 2)


def test_corners_of_a_fine_mesh_stay_apart():
    vertices, faces = box()
    fine = vertices * 1e-4 + 0.01  # twenty micrometres long, a centimetre from the origin
    cleaned, kept, _ = clean(fine, faces)
    assert len(cleaned) == len(vertices) and len(kept) == len(faces)
    assert len(clean(fine, faces, tolerance=1e-3)[1]) == 0
