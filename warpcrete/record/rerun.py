"""Recorder for the Rerun viewer, which writes to a file, to a viewer, or to both."""

import uuid
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ..core.device.recorder_thread import RecorderThread
from ..core.drawing.display import Colour, Display, Profile
from ..core.drawing.paint import COLOUR_STEPS, Paint, packed
from ..core.drawing.style import THEORY
from ..core.records import SavedState
from ..core.run.recorder import Recorder
from ..core.run.run import Run
from ..core.run.simulation_base import SimulationBase
from ..core.run.viewer import LOOPBACK
from .blueprint import CHAINS, CUT, PAINT_LEGEND, blueprint, cut_walls
from .legend import legend, paint_legend
from .rerun_stream import POLL_INTERVAL, RerunStream

TEXTURE_MARGIN = 512
"""Number of texels that repeat the first colour at the start of the texture. A renderer may sample colours slightly
outside the triangles at the edges of a mesh, and therefore slightly outside the colour scale."""


def with_values(tensor: Any, values: np.ndarray) -> Any:
    """Return a copy of a Rerun tensor (an Arrow array) that holds the new `values`, as many and of the same type."""
    # Arrow stores the values of a Rerun tensor as a union of list arrays, one for each data type.
    union = tensor.field("buffer")
    kind = union.type_codes[0].as_py()
    members = [union.field(number) for number in range(union.type.num_fields)]
    members[kind] = type(members[kind]).from_arrays(members[kind].offsets, values).cast(members[kind].type)
    buffer = type(union).from_buffers(union.type, 1, union.buffers()[:3], children=members)
    return type(tensor).from_arrays([tensor.field("shape"), tensor.field("names"), buffer], fields=list(tensor.type))


class RerunRecorder(Recorder):
    """Recorder of bodies, moving walls, curves and profiles on one timeline, with a legend and a cut through the scene.

    Every clump is drawn by its own spheres, and the concrete of a flow on a grid is drawn by its surface. `path` is the
    path of the .rrd file, or None. `live` is True to open a viewer, or the URL of a running viewer
    (`rerun+http://127.0.0.1:9876/proxy`). `bind` is the IP address on which a newly opened viewer listens. `colouring`
    is the quantity that colours the bodies. If `network` is true, lines show contacts and bonds between bodies, in
    simulation methods that have them: the width and brightness of a line show the contact force, and bonds without
    compression are orange.

    Every checkpoint closes a part of the recording (`run.rrd`, `run-0001.rrd` and so on), so that a resumed run
    continues after a complete part. At the end the parts are joined into one file.
    """

    expendable = True

    def __init__(
        self,
        path: Path | None,
        *,
        live: bool | str = False,
        bind: str = LOOPBACK,
        colouring: str | None = None,
        network: bool = False,
    ) -> None:
        self.path, self.colouring, self.network = path, colouring, network
        self._stream = RerunStream(path, live, bind)
        self._rr = self._stream.rr
        self._later = RecorderThread(in_thread=False)
        self._display: Display | None = None

    def start(self, simulation: SimulationBase) -> None:
        """Open the file and the viewer, and send the layout of the views and all data that does not change."""
        if self.path is not None:
            # Delete the part files of an earlier run that stopped before its first checkpoint.
            for path in self._stream.parts_from(0):
                path.unlink(missing_ok=True)
        display, self._later = simulation.display(self.colouring), RecorderThread.for_simulation(simulation)
        self._open(display, str(uuid.uuid4()), 0, self._blueprint(simulation, display))
        self._describe(display)
        self._log_zeros(display, simulation.stepper.time, simulation.stepper.steps)

    def resume(self, simulation: SimulationBase, state: SavedState) -> None:
        """Delete the parts of the recording that were written after the checkpoint, and open the next part."""
        if self.path is not None:
            if not self.path.is_file():
                warnings.warn(
                    f"'{self.path}': is missing; a new recording begins now, without the earlier frames", stacklevel=2
                )
                self.start(simulation)
                return
            for path in self._stream.parts_from(state["parts"]):
                path.unlink()
            # Parts of the recording of a finished run may be missing, because they are joined into one file already.
            if not simulation.at_end:
                for number in range(1, state["parts"]):
                    if not (part := self._stream.part_path(number)).is_file():
                        warnings.warn(f"'{part}': is missing; the recording lacks its part of the frames", stacklevel=2)
        display, self._later = simulation.display(self.colouring), RecorderThread.for_simulation(simulation)
        live = bool(self._stream.live)
        layout = self._blueprint(simulation, display) if live else None
        self._open(display, state["recording_id"], state["parts"], layout)
        # A newly opened viewer has no data yet. It gets all constant data again, and `_places` stays empty, so that the
        # positions of bars and of surface vertices are sent again.
        if live:
            self._describe(display)
        else:
            self._places = dict(state["places"])

    def checkpoint(self, simulation: SimulationBase) -> SavedState:
        """Return the data with which a resumed run continues the recording in its next part."""
        self._later.wait()
        following = self._stream.part + (self.path is not None)
        return {"recording_id": self._stream.recording_id, "parts": following, "places": self._places}

    def write(self, simulation: SimulationBase) -> None:
        """Close the current part of the recording and open the next part."""
        if self.path is not None:
            self._stream.open_next_part()

    def sample(self, simulation: SimulationBase, row: dict[str, float]) -> None:
        """Record the current values of all curves, such as pressures, that the viewer plots over time."""
        assert self._display is not None
        time = row["time"]
        # The recording of a finished run can be made afterwards from the rows of its time series, which contain no step
        # numbers. The step number is then known only for the last row, which belongs to the final state.
        steps = simulation.stepper.steps if time == simulation.stepper.time else None
        values = {
            f"{plot.path}/{curve.name}": curve.value(row) for plot in self._display.plots() for curve in plot.curves
        }

        def log() -> None:
            self._stream.set_time(time, steps)
            for path, value in values.items():
                if value is not None:
                    self._log(path, self._rr.Scalars(value))

        self._later.submit(log)

    def frame(self, simulation: SimulationBase) -> None:
        """Record bodies, moving walls and, if selected, the lines between bodies."""
        assert self._display is not None
        self._display.draw(self._later, self._draw)
        # Draw the legend after the first frame, because drawing a legend takes ten times as long as drawing a frame.
        if self._legend_due:
            self._legend_due = False
            self._later.submit(self._log_legend)

    def _log_legend(self) -> None:
        assert self._display is not None
        picture = legend(self._display)
        if picture is not None:
            self._log("legend", self._rr.EncodedImage(contents=picture, media_type="image/png"), static=True)

    def _draw(self, time: float, steps: int) -> None:
        rr, display = self._rr, self._display
        assert display is not None
        self._stream.set_time(time, steps)
        if not display.has_surface:
            spheres = rr.Points3D.from_fields(positions=display.centres(), colors=display.packed_colours())
            self._log(f"scene/{display.noun}", spheres)
        else:
            self._draw_surface(display, f"scene/{display.noun}")
            if display.cut is not None:
                self._draw_surface(display, f"{CUT}/{display.noun}", cut=True)
        for number, name in self._moving:
            self._log_pose(number, f"scene/walls/{name}")
        self._draw_paint(display)
        if self.network:
            for name, lines in display.network().items():
                self._log(f"{CHAINS}/{name}", rr.LineStrips3D(lines.ends, colors=lines.colours, radii=lines.radii))
        for profile in display.profiles():
            self._draw_profile(profile)

    def _draw_surface(self, display: Display, path: str, cut: bool = False) -> None:
        """Record the surface of the concrete, or only its colours if its shape is the same as in the previous frame.

        If `cut` is true, the concrete in front of the display's cutting plane is left out.
        """
        surface = display.surface(cut)
        assert surface is not None
        fields: dict[str, Any] = {"vertex_colors": packed(display.surface_colours(surface))}
        if not np.array_equal(self._places.get(path, ()), surface.vertices):
            self._places[path] = surface.vertices
            fields |= {"vertex_positions": surface.vertices, "triangle_indices": surface.faces,
                       "vertex_normals": surface.normals}  # fmt: skip
        self._log(path, self._rr.Mesh3D.from_fields(**fields))

    def _draw_paint(self, display: Display) -> None:
        """Record the colours of walls that show a quantity, such as the worn depth.

        The value at each vertex becomes a coordinate in a texture that holds all colours.
        """
        paint = display.paint()
        if paint is None:
            return
        painted: list[str] = []
        for number, wall in enumerate(self._walls):
            if (values := display.wall_values(number)) is None:
                continue
            places = np.full((len(values), 2), 0.5, np.float32)
            places[:, 0] = (TEXTURE_MARGIN + paint.steps(values) + 0.5) / (TEXTURE_MARGIN + COLOUR_STEPS)
            paths = [f"scene/walls/{wall}"] + [f"{CUT}/{wall}"] * (wall in self._cut)
            for path in paths:
                self._log(path, self._rr.Mesh3D.from_fields(vertex_texcoords=places))
            painted += paths
        if paint != self._paint:
            self._paint = paint
            self._log_scale(paint, painted)

    def _log_scale(self, paint: Paint, painted: list[str]) -> None:
        """Record the texture with all colours of walls that show a quantity, and the legend, as static data.

        `painted` holds the paths of these walls in the recording. The viewer uses the last version of static data for
        all frames, so a new scale also applies to earlier frames.
        """
        rr = self._rr
        from rerun.components import ImageFormat

        colours = np.pad(paint.colours(), ((TEXTURE_MARGIN, 0), (0, 0)), mode="edge")
        form = ImageFormat(width=len(colours), height=1, color_model="RGB", channel_datatype="U8")
        texture = rr.Mesh3D.from_fields(albedo_texture_buffer=colours.tobytes(), albedo_texture_format=form)
        for path in painted:
            self._log(path, texture, static=True)
        if (picture := paint_legend(paint)) is not None:
            self._log(PAINT_LEGEND, rr.EncodedImage(contents=picture, media_type="image/png"), static=True)

    def _draw_profile(self, profile: Profile) -> None:
        """Record the curves of a profile as bar charts, because the viewer plots curves only over time."""
        curves = [(curve, *curve.read()) for curve in profile.curves]
        for number, (curve, places, values) in enumerate(curves):
            if len(places):
                apart = float(np.min(np.diff(places))) if len(places) > 1 else 1.0
                width = 0.8 * apart / len(curves)
                middle = places + (number - 0.5 * (len(curves) - 1)) * width
                fields: dict[str, Any] = {"values": self._bars(np.array(values, dtype=float))}
                path = f"profile/{profile.path}/{curve.name.replace(' ', '_')}"
                # Converting the positions of the bars of a bar chart takes most of the time, so send them only when
                # they have changed.
                if not np.array_equal(self._places.get(path, ()), middle):
                    self._places[path] = middle
                    fields |= {"abscissa": middle, "widths": np.full(len(middle), width, np.float32),
                               "color": curve.colour}  # fmt: skip
                self._log(path, self._rr.BarChart.from_fields(**fields))

    def _bars(self, values: np.ndarray) -> Any:
        """Return the heights of the bars of a bar chart as a tensor in Rerun's format.

        Creating a tensor takes ten times as long as replacing the values of a tensor. Therefore one tensor is kept for
        each number of bars, and only its values are replaced.
        """
        from rerun.components import TensorDataBatch

        like = self._tensors.get(len(values))
        if like is None:
            self._tensors[len(values)] = like = TensorDataBatch(values).as_arrow_array()
        return with_values(like, values)

    def finish(self, simulation: SimulationBase, run: Run) -> None:
        """Flush the recording and close it."""
        if self._stream.is_connected:
            try:
                self._later.close()
            except BaseException:
                self._stream.disconnect(POLL_INTERVAL)
                raise
            self._stream.close()

    def tidy(self, simulation: SimulationBase, run: Run) -> None:
        """Join the part files of the recording into one file."""
        self._stream.join_parts()

    def _describe(self, display: Display) -> None:
        """Record all data that does not change during the run."""
        rr = self._rr
        self._log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        if not display.has_surface:
            self._log(f"scene/{display.noun}", rr.Points3D.from_fields(radii=display.radii()), static=True)
        for number, wall in enumerate(display.walls()):
            mesh = rr.Mesh3D(
                vertex_positions=wall.vertices, triangle_indices=wall.faces, albedo_factor=_clear(wall.colour)
            )
            self._log(f"scene/walls/{wall.name}", mesh, static=True)
            if not wall.moves:
                self._log_pose(number, f"scene/walls/{wall.name}", static=True)
        for wall in cut_walls(display):
            mesh = rr.Mesh3D(vertex_positions=wall.vertices, triangle_indices=wall.faces, albedo_factor=wall.colour)
            self._log(f"{CUT}/{wall.name}", mesh, static=True)
            self._log_pose(self._walls.index(wall.name), f"{CUT}/{wall.name}", static=True)
        self._legend_due = True
        for plot in display.plots():
            for curve in plot.curves:
                colours = None if curve.colour is None else [list(curve.colour)]
                line = rr.SeriesLines(names=curve.label, colors=colours)
                self._log(f"{plot.path}/{curve.name}", line, static=True)

    def _log(self, path: str, what: object, static: bool = False) -> None:
        self._later.yield_to_run()
        self._stream.log(path, what, static)

    def _log_zeros(self, display: Display, time: float, steps: int) -> None:
        """Record one point with the value 0 in every plot, so that the axis of values begins at zero."""
        self._stream.set_time(time, steps)
        for plot in display.plots():
            self._log(f"{plot.path}/zero", self._rr.SeriesLines(colors=[THEORY], names="zero"), static=True)
            self._log(f"{plot.path}/zero", self._rr.Scalars(0.0))

    def _log_pose(self, number: int, path: str, static: bool = False) -> None:
        assert self._display is not None
        position, orientation = self._display.wall_pose(number)
        pose = self._rr.Transform3D(translation=position, quaternion=self._rr.Quaternion(xyzw=orientation))
        self._log(path, pose, static=static)

    def _blueprint(self, simulation: SimulationBase, display: Display) -> Any:
        network = self.network and display.has_network
        with_legend = display.scale() is not None or bool(display.categories())
        return blueprint(display, network=network, legend=with_legend, duration=simulation.expected_duration)

    def _open(self, display: Display, recording_id: str, part: int, blueprint: object) -> None:
        scene = display.simulation.scene
        self._display = display
        walls = display.walls()
        self._walls = [wall.name for wall in walls]
        self._moving = [(number, wall.name) for number, wall in enumerate(walls) if wall.moves]
        self._cut = [wall.name for wall in cut_walls(display)]
        self._paint: Paint | None = None
        self._legend_due = False
        # Tensors in Rerun's format for the heights of the bars of a bar chart, by the number of bars. They are kept
        # because replacing the values of a tensor is faster than creating a new one.
        self._tensors: dict[int, Any] = {}
        # Positions of the bars of bar charts, and of surface vertices, that were recorded last. The key is the path of
        # the bar chart or surface in the recording.
        self._places: dict[str, np.ndarray] = {}
        # The viewer keeps one layout for each application name, so each kind of scene needs an application name of its
        # own.
        self._stream.connect(f"warpcrete {scene.name}", scene.caption, recording_id, part, blueprint)


def _clear(colour: Colour) -> Colour:
    """Return the colour of a wall, darkened if the wall is transparent.

    The viewer blends colours as amounts of light, not as perceived brightness. A bright transparent wall would
    therefore outshine dark colours behind it.
    """
    red, green, blue, opacity = colour
    return colour if opacity == 255 else (red // 3, green // 3, blue // 2, opacity)
