"""Views in the viewer: camera, walls that are cut open, and the choice of plots."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from warpcrete import scenes
from warpcrete.core.drawing.display import DrawnWall
from warpcrete.dem.measure.display import ElementDisplay
from warpcrete.record.blueprint import FIELD, camera, cut_walls


def test_a_cut_divides_large_triangles():
    """A triangle that crosses the cutting plane ends at this plane; a view shows the whole scene and little else."""
    corners = np.array([[0.0, -1.0, 0.0], [4.0, 3.0, 0.0], [0.0, 3.0, 2.0]])
    wall = DrawnWall("wall", corners, np.array([[0, 1, 2]]), False, (95, 130, 170, 70))
    box = np.stack([corners.min(0), corners.max(0)])
    scene: Any = SimpleNamespace(
        walls=lambda: [wall], cut=1.0, wall_pose=lambda number: (np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])),
        bounds=lambda: box, direction=(0.2, -0.95, 0.24), has_surface=True,
    )  # fmt: skip
    (half,) = cut_walls(scene)
    assert np.unique(half.vertices[:, 1].round(6)).tolist() == [1.0, 3.0]
    ends = np.array([[x, y, z] for x in box[:, 0] for y in box[:, 1] for z in box[:, 2]])
    for aspect in (0.5, 2.0):
        eye, target = camera(scene, aspect)
        ahead = (target - eye) / np.linalg.norm(target - eye)
        right = np.cross(ahead, (0.0, 0.0, 1.0)) / np.linalg.norm(np.cross(ahead, (0.0, 0.0, 1.0)))
        seen = (ends - eye) @ np.stack([right / aspect, np.cross(right, ahead), ahead]).T
        assert 0.9 < np.abs(seen[:, :2] / seen[:, 2:]).max() / np.tan(FIELD / 2) < 1


def test_plots_follow_what_a_scene_measures():
    """A vessel has no piston, so its plots show the shape of the heap instead of a pressure."""
    paths = {}
    for scene in (scenes.pipe(), scenes.jring_dem(), scenes.funnel_dem()):
        display: Any = SimpleNamespace(simulation=SimpleNamespace(scene=scene, unit=lambda column: "m"))
        paths[scene.name] = [plot.path for plot in ElementDisplay.plots(display)]
    assert paths["pipe"] == ["pressure", "energy"]
    assert paths["jring-dem"] == paths["funnel-dem"] == ["shape", "energy"]
