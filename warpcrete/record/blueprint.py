"""Layout of a recording in the Rerun viewer: the scene, a cut through it, force chains, curves and a legend."""

from typing import Any

import numpy as np

from ..core.drawing.display import Display, DrawnWall, Plot
from ..core.drawing.style import explained
from ..geometry.rotation import rotate
from .legend import capitalised, legend_title

PAPER = (250, 250, 250)
MIN_PLAY_TIME = 8.0
"""Shortest time for which the viewer plays a run [s]; shorter simulated times are played in slow motion."""
SLIM = 0.25
"""Aspect ratio of the scene, width to height or height to width, below which all views are arranged in one row or
column.
"""
CHAINS, CUT = "scene/network", "scene/cut"
"""Paths, in the recording, of the lines that show contact forces and of the walls that are cut open. The view of the
whole scene hides what is recorded under these paths."""
PAINT_LEGEND = "legend_of_walls"
CUT_OPACITY = 150
"""Minimum opacity, from 0 to 255, of the half of a wall that remains in the view of the cut scene."""


def blueprint(display: Display, *, network: bool, legend: bool, duration: float) -> Any:
    """Return the layout of the Rerun viewer for what a display shows, for a run of `duration` [s] of simulated time."""
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
    curves = [rrb.TimeSeriesView(name=plot_title(plot), origin=plot.path, plot_legend=hidden)
              for plot in display.plots()]  # fmt: skip
    curves += [
        rrb.BarChartView(
            name=explained(each.title, [(curve.name, curve.colour) for curve in each.curves]),
            origin=f"profile/{each.path}", plot_legend=hidden,
        ) for each in display.profiles()
    ]  # fmt: skip
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


def _arranged(display: Display, views: list[Any]) -> Any:
    """Arrange the views: in a row if the scene is tall, in a column if it is long, and in two columns otherwise."""
    import rerun.blueprint as rrb

    wide, _, high = np.ptp(display.bounds(), axis=0)
    if wide < SLIM * high:
        return rrb.Horizontal(*views)
    if high < SLIM * wide or len(views) == 1:
        return rrb.Vertical(*views)
    return rrb.Horizontal(views[0], rrb.Vertical(*views[1:]), column_shares=[3, 2] if len(views) > 2 else [1, 1])


def _scenes(display: Display, network: bool) -> list[Any]:
    """Return the three-dimensional views: the whole scene, the scene cut open by a plane, and the force chains."""
    noun = display.noun
    whole = ["+ scene/**", f"- {CHAINS}/**", f"- {CUT}/**"]
    found = [_view(display, noun.capitalize(), whole)]
    contents = ["+ scene/**", f"- {CHAINS}/**", *(f"- scene/walls/{wall.name}" for wall in cut_walls(display))]
    if display.has_surface:
        if display.cut is not None:
            found.append(_view(display, "Cut through the middle", [*contents, f"- scene/{noun}"]))
        return found
    kept = spheres_behind_cut(display)
    if kept is not None:
        import rerun as rr

        # In the view "Cut through the middle", bodies that are in front of the cutting plane at the start have the
        # radius 0, which hides them. The view therefore needs no second copy of the bodies' positions in the recording.
        hidden = {f"scene/{noun}": [rr.Points3D.from_fields(radii=np.where(kept, display.radii(), 0.0))]}
        found.append(_view(display, "Cut through the middle", contents, hidden))
    if network:
        found.append(_view(display, "Force chains", ["+ scene/**", f"- scene/{noun}", f"- {CUT}/**"]))
    return found


def _view(display: Display, name: str, contents: list[str], overrides: dict[str, Any] | None = None) -> Any:
    import rerun.blueprint as rrb

    eye, target = display.view(1.45)
    return rrb.Spatial3DView(
        name=name,
        origin="scene",
        contents=contents,
        overrides=overrides,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0, 0, 1)),
        line_grid=rrb.LineGrid3D(visible=False),
        background=PAPER,
    )


def spheres_behind_cut(display: Display) -> np.ndarray | None:
    """Return a boolean for each sphere, true behind the cutting plane, shape (n,).

    The result is None without a plane, or if all spheres lie on one side of it.
    """
    if display.cut is None:
        return None
    kept = display.centres()[:, 1] >= display.cut
    return kept if kept.any() and not kept.all() else None


def cut_walls(display: Display) -> list[DrawnWall]:
    """Return the fixed, transparent walls without their faces in front of the cutting plane."""
    found = []
    for number, wall in enumerate(display.walls()):
        if wall.moves or wall.colour[3] == 255 or display.cut is None:
            continue
        position, orientation = display.wall_pose(number)
        middles = wall.vertices[wall.faces].mean(axis=1).astype(float)
        places = rotate(np.broadcast_to(orientation, (len(middles), 4)), middles) + position
        kept = wall.faces[places[:, 1] >= display.cut]
        if 0 < len(kept) < len(wall.faces):
            # The remaining half of the wall lies behind the bodies and hides none of them. It may therefore be more
            # opaque than the whole wall.
            colour = (*wall.colour[:3], max(wall.colour[3], CUT_OPACITY))
            found.append(DrawnWall(wall.name, wall.vertices, kept, False, colour))
    return found
