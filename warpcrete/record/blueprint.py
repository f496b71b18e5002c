"""Layout of a recording in the Rerun viewer: the scene, a cut through it, force chains, curves and a legend."""

from typing import Any

import numpy as np

from ..core.drawing.display import Display, DrawnWall, Plot
from ..core.drawing.style import explained
from ..geometry.rotation import rotate
from .legend import capitalised, legend_title

PAPER = (250, 250, 250)
MIN_PLAY_TIME = 8.0
"""Shortest time in which the viewer plays back a run [s]; a run with a shorter simulated time is played in slow
motion."""
SLIM = 0.25
"""Ratio of the shorter to the longer side of the scene's picture below which all views are arranged in one row or
column.
"""
AREA = 1.15
"""Width of the area for all views of the scene, divided by its height, in a viewer window of 1400 by 900 pixels."""
FIELD = np.radians(55.0)
"""Vertical angle of view of the viewer's camera [rad]."""
MARGIN, ROOM = 1.06, 1.5
"""Distance of the camera, divided by the smallest distance from which a view shows the whole scene. ROOM, the larger
value, applies to aggregates that spread out of a vessel, and MARGIN to all other scenes."""
CHAINS, CUT = "scene/network", "scene/cut"
"""Paths, in the recording, of the lines that show contact forces and of the walls that are cut open. The view of the
whole scene hides what is recorded under these paths."""
PAINT_LEGEND = "legend_of_walls"
FLAT = 1e-9
"""Largest distance from the cutting plane at which a vertex counts as lying in this plane [m]."""
Shown = tuple[str, list[str], "dict[str, Any] | None"]
"""Title, contents and overrides of a three-dimensional view. The contents are rules that include or exclude paths of
the recording, and the overrides replace recorded values in this view only."""
CUT_OPACITY = 150
"""Minimum opacity, from 0 to 255, of the half of a wall that remains in the view of the cut scene."""


def blueprint(display: Display, *, network: bool, legend: bool, duration: float) -> Any:
    """Return the layout of the Rerun viewer for the views, plots and legends that `display` supplies.

    `network` adds a view of the force chains, and `legend` adds the legend. `duration` is the simulated time of the run
    [s]; the viewer plays short runs in slow motion.
    """
    import rerun.blueprint as rrb

    scenes = _arranged(display, _scenes(display, network))
    if legend:
        bars = {"legend": f"{display.simulation.scene.caption}. Colours: {legend_title(display)}"}
        if (paint := display.paint()) is not None:
            bars[PAINT_LEGEND] = capitalised(paint.label)
        views = [rrb.Spatial2DView(name=title, origin=path, background=PAPER) for path, title in bars.items()]
        scenes = rrb.Vertical(scenes, *views, row_shares=[8, *(1 for _ in views)])
    # The viewer's own legends cover the curves, so titles name the colours instead.
    hidden = rrb.PlotLegend(visible=False)
    curves = [
        rrb.TimeSeriesView(name=plot_title(plot), origin=plot.path, plot_legend=hidden) for plot in display.plots()
    ]
    curves += [
        rrb.BarChartView(
            name=explained(each.title, [(curve.name, curve.colour) for curve in each.curves]),
            origin=f"profile/{each.path}",
            plot_legend=hidden,
        )
        for each in display.profiles()
    ]
    speed = min(1.0, duration / MIN_PLAY_TIME)
    return rrb.Blueprint(
        rrb.Horizontal(scenes, rrb.Vertical(*curves), column_shares=[3, 2]),
        rrb.TimePanel(timeline="time", playback_speed=speed, state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )


def plot_title(plot: Plot) -> str:
    """Return the title of a plot over time, with the unit; for several curves, add the name and colour of each."""
    labels = [curve.label.partition(" [") for curve in plot.curves]
    units = list(dict.fromkeys(unit for _, _, unit in labels if unit))
    if len(plot.curves) == 1:
        return capitalised(plot.curves[0].label)
    if len(units) > 1:
        return explained(plot.title, [(curve.label, curve.colour) for curve in plot.curves])
    unit = f" [{units[0]}" if units else ""
    colours = [(name, curve.colour) for (name, _, _), curve in zip(labels, plot.curves, strict=True)]
    return explained(f"{plot.title}{unit}", colours)


def _arranged(display: Display, shown: list[Shown]) -> Any:
    """Return the layout of the views `shown`: a row if the scene is tall, a column if it is wide, or else two columns.

    If there are only two views, they form a row or a column, whichever shows the scene larger.
    """
    import rerun.blueprint as rrb

    wide, high = np.ptp(_on_screen(display), axis=0)[:2]
    count = len(shown)
    if wide < SLIM * high or (count == 2 and SLIM * wide <= high and wide <= AREA * high):
        return rrb.Horizontal(*(_view(display, each, AREA / count) for each in shown))
    if high < SLIM * wide or count < 3:
        return rrb.Vertical(*(_view(display, each, AREA * count) for each in shown))
    others = [_view(display, each, 0.4 * AREA * (count - 1)) for each in shown[1:]]
    return rrb.Horizontal(_view(display, shown[0], 0.6 * AREA), rrb.Vertical(*others), column_shares=[3, 2])


def _scenes(display: Display, network: bool) -> list[Shown]:
    """Return the three-dimensional views: the whole scene, a cut through it and, with `network`, the force chains."""
    noun = display.noun
    whole = ["+ scene/**", f"- {CHAINS}/**", f"- {CUT}/**"]
    views: list[Shown] = [(noun.capitalize(), whole, None)]
    contents = ["+ scene/**", f"- {CHAINS}/**", *(f"- scene/walls/{wall.name}" for wall in cut_walls(display))]
    if display.has_surface:
        if display.cut is not None:
            views.append((display.cut_title, [*contents, f"- scene/{noun}"], None))
        return views
    kept = spheres_behind_cut(display)
    if kept is not None:
        import rerun as rr

        # In the cut view, bodies that are in front of the cutting plane at the start have the
        # radius 0, which hides them. The view therefore needs no second copy of the bodies' positions in the recording.
        hidden = {f"scene/{noun}": [rr.Points3D.from_fields(radii=np.where(kept, display.radii(), 0.0))]}
        views.append((display.cut_title, contents, hidden))
    if network:
        views.append(("Force chains", ["+ scene/**", f"- scene/{noun}", f"- {CUT}/**"], None))
    return views


def _view(display: Display, shown: Shown, aspect: float) -> Any:
    """Return a view with a camera that is as close as possible and still sees the whole scene.

    `shown` holds the title and the contents of the view. `aspect` is the width of the view divided by its height.
    """
    import rerun.blueprint as rrb

    name, contents, overrides = shown
    eye, target = camera(display, aspect)
    return rrb.Spatial3DView(
        name=name,
        origin="scene",
        contents=contents,
        overrides=overrides,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0, 0, 1)),
        line_grid=rrb.LineGrid3D(visible=False),
        background=PAPER,
    )


def camera(display: Display, aspect: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a camera position from which a view shows the whole scene, and the point to look at [m], shape (3,) each.

    `aspect` is the width of the view divided by its height.
    """
    places, axes = _on_screen(display), _axes(display)
    centre = 0.5 * (places.min(0) + places.max(0))
    across, up, ahead = (places - centre).T
    slope = np.tan(FIELD / 2)
    margin = MARGIN if display.has_surface or getattr(display.simulation.scene, "vessel", None) is None else ROOM
    distance = margin * max(float((np.maximum(np.abs(across) / aspect, np.abs(up)) / slope - ahead).max()), 0.1)
    target = centre @ axes
    return target - distance * axes[2], target


def _axes(display: Display) -> np.ndarray:
    """Return the unit vectors to the right, upwards and ahead of a camera that looks at the scene, shape (3, 3)."""
    ahead = -np.array(display.direction) / np.linalg.norm(display.direction)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(right, ahead), ahead])


def _on_screen(display: Display) -> np.ndarray:
    """Return the corners of the scene and the vertices of its walls at the start, in camera coordinates, shape (n, 3).

    The coordinates [m] run along the directions to the right, upwards and ahead of the camera.
    """
    places = [np.stack(np.meshgrid(*display.bounds().T), -1).reshape(-1, 3)]
    for number, wall in enumerate(display.walls()):
        position, orientation = display.wall_pose(number)
        vertices = wall.vertices.astype(float)
        places.append(rotate(np.broadcast_to(orientation, (len(vertices), 4)), vertices) + position)
    return np.concatenate(places) @ _axes(display).T


def spheres_behind_cut(display: Display) -> np.ndarray | None:
    """Return whether each sphere lies behind the cutting plane, as seen from the camera, as booleans of shape (n,).

    The result is None if there is no such plane, or if all spheres lie on one side of it.
    """
    if display.cut is None:
        return None
    kept = display.centres()[:, 1] >= display.cut
    return kept if kept.any() and not kept.all() else None


def cut_walls(display: Display) -> list[DrawnWall]:
    """Return the parts of the fixed, transparent walls that lie behind the cutting plane, as seen from the camera."""
    from trimesh.intersections import slice_faces_plane

    parts = []
    for number, wall in enumerate(display.walls()):
        if wall.moves or wall.colour[3] == 255 or display.cut is None:
            continue
        position, orientation = display.wall_pose(number)
        # Transform the cutting plane to the wall's own coordinate frame.
        normal, place = rotate(
            np.broadcast_to(orientation, (2, 4)),
            np.array([[0.0, 1.0, 0.0], np.array([0.0, display.cut, 0.0]) - position]),
            inverse=True,
        )
        depth = (wall.vertices - place) @ normal
        if depth.min() < -FLAT and depth.max() > FLAT:
            vertices, faces, _ = slice_faces_plane(wall.vertices.astype(float), wall.faces, normal, place)
            # The remaining half of the wall lies behind the bodies and hides none of them. It may therefore be more
            # opaque than the whole wall.
            colour = (*wall.colour[:3], max(wall.colour[3], CUT_OPACITY))
            parts.append(DrawnWall(wall.name, vertices, faces, False, colour))
    return parts
