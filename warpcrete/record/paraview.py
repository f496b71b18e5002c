"""Recorder for ParaView: bodies, walls, contacts and surfaces over time as VTKHDF files.

PyVista and VTK open the files as well. The format is version 2.0 of the VTKHDF specification (VTK 9.3 and later), with
`PolyData` in time steps. The files are written with h5py.
"""

import shutil
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ..core.device.recorder_thread import RecorderThread
from ..core.extras import needs_extra
from ..core.records import SavedState
from ..core.run.files import atomic_file, cannot_write
from ..core.run.recorder import Recorder
from ..core.run.run import Run
from ..core.run.simulation_base import SimulationBase
from ..geometry.rotation import rotate

KINDS = ("Vertices", "Lines", "Polygons", "Strips")
"""Names of the kinds of cells in PolyData files, in the order of the columns of the dataset CellOffsets."""
VERSION = (2, 0)


class ParaViewRecorder(Recorder):
    """Recorder of bodies, walls, contacts between bodies and the surface of concrete as VTKHDF files in `folder`.

    The files are `bodies.vtkhdf`, `walls.vtkhdf`, `contacts.vtkhdf` if bodies touch each other, `surface.vtkhdf` for
    the concrete of flows on a grid, and `aggregates.vtkhdf` for the stones in a mortar. Bodies are points with
    `radius`, `colour` and the fields of the display; a clump appears as its spheres. To show bodies as spheres in
    ParaView, use the filter Glyph (type Sphere, scaled by `radius`) or the representation Point Gaussian. The surface
    has normals, `colour` and fields. Frames are kept in memory until a checkpoint. Then they are appended to a copy of
    each file, and the copy replaces the file, so that no file is ever incomplete. Raises :class:`WarpcreteError` if
    h5py is not installed.
    """

    expendable = True

    def __init__(self, folder: Path, *, colouring: str | None = None) -> None:
        needs_extra("paraview", "h5py")
        self.folder, self.colouring = folder, colouring
        self._frames = 0
        self._files: dict[str, Poly] = {}

    def start(self, simulation: SimulationBase) -> None:
        """Prepare the files and the walls; create the display that supplies the data of all later frames."""
        self._display, self._later = simulation.display(self.colouring), RecorderThread.for_simulation(simulation)
        self._walls = self._display.walls()
        self._open()
        # Delete files that an earlier run left in this folder when it stopped before its first checkpoint.
        for file in self._files.values():
            file.path.unlink(missing_ok=True)

    def _open(self) -> None:
        self._files["bodies"] = Poly(self.folder / "bodies.vtkhdf", "Vertices")
        if self._walls:
            self._files["walls"] = Poly(self.folder / "walls.vtkhdf", "Polygons")
        if self._display.has_surface:
            self._files["surface"] = Poly(self.folder / "surface.vtkhdf", "Polygons")
        if self._display.has_spheres:
            self._files["aggregates"] = Poly(self.folder / "aggregates.vtkhdf", "Vertices")
        if self._display.has_network:
            self._files["contacts"] = Poly(self.folder / "contacts.vtkhdf", "Lines")

    def resume(self, simulation: SimulationBase, state: SavedState) -> None:
        """Shorten all files to the number of frames that were written before the checkpoint.

        If a file has fewer frames, because it is damaged or missing, shorten the other files to that number and warn.
        """
        self._display, self._later = simulation.display(self.colouring), RecorderThread.for_simulation(simulation)
        self._walls = self._display.walls()
        self._open()
        self._frames = min(state["frames"], *(file.count() for file in self._files.values()))
        if self._frames < state["frames"]:
            lost = state["frames"] - self._frames
            warnings.warn(
                f"'{self.folder}': the last {lost} frames for ParaView are missing or damaged; the files continue "
                "without these frames",
                stacklevel=2,
            )
        for file in self._files.values():
            file.shorten(self._frames)

    def frame(self, simulation: SimulationBase) -> None:
        """Append the current state of bodies, walls and contacts to the files, as a new time step."""
        self._display.draw(self._later, self._draw)

    def _draw(self, time: float, steps: int) -> None:
        display = self._display
        centres, radii = display.centres(), display.radii()
        cells = np.arange(len(centres))[:, None]
        fields = {"radius": radii.astype(np.float32), "colour": display.colours()}
        fields |= {
            name: values if values.dtype.kind in "iu" else values.astype(np.float32)
            for name, values in display.fields().items()
        }
        self._files["bodies"].add(time, centres, cells, fields)
        if self._walls:
            self._draw_walls(time)
        if display.has_spheres:
            self._draw_spheres(time)
        if (surface := display.bare_surface()) is not None:
            fields = {name: values.astype(np.float32) for name, values in surface.fields.items()}
            fields |= {"Normals": surface.normals.astype(np.float32), "colour": display.surface_colours(surface)}
            self._files["surface"].add(time, surface.vertices, surface.faces, fields)
        if display.has_network:
            lines = display.network()
            ends = np.concatenate([each.ends.reshape(-1, 2, 3) for each in lines.values()])
            sets = np.repeat(list(lines), [2 * len(each.ends) for each in lines.values()])
            force = np.concatenate([each.forces for each in lines.values()]).astype(np.float32)
            pairs = np.arange(2 * len(ends)).reshape(-1, 2)
            fields = {"bonded": (sets != "contacts").astype("u1"), "force": np.repeat(force, 2)}
            if "hydrated bonds" in lines:
                fields["hydrated"] = (sets == "hydrated bonds").astype("u1")
            self._files["contacts"].add(time, ends.reshape(-1, 3), pairs, fields)
        self._frames += 1

    def _draw_spheres(self, time: float) -> None:
        spheres = self._display.spheres()
        count = len(spheres.radii)
        fields = {"radius": spheres.radii.astype(np.float32), "speed": spheres.speeds.astype(np.float32)}
        fields |= {"body": spheres.bodies, "colour": np.tile(np.array(spheres.colour, np.uint8), (count, 1))}
        self._files["aggregates"].add(time, spheres.centres, np.arange(count)[:, None], fields)

    def _draw_walls(self, time: float) -> None:
        points, faces, of = [], [], []
        count = 0
        for number, wall in enumerate(self._walls):
            position, orientation = self._display.wall_pose(number)
            turns = np.broadcast_to(orientation, (len(wall.vertices), 4))
            points.append(rotate(turns, wall.vertices.astype(float)) + position)
            faces.append(wall.faces + count)
            of.append(np.full(len(wall.vertices), number, np.int32))
            count += len(wall.vertices)
        self._files["walls"].add(time, np.concatenate(points), np.concatenate(faces), {"wall": np.concatenate(of)})

    def checkpoint(self, simulation: SimulationBase) -> SavedState:
        """Wait for the background jobs, then return the number of frames recorded so far, which a resumed run needs."""
        self._later.wait()
        return {"frames": self._frames}

    def write(self, simulation: SimulationBase) -> None:
        """Write the frames that are kept in memory."""
        self._write()

    def finish(self, simulation: SimulationBase, run: Run) -> None:
        """Write the frames that are still in memory when the run has ended."""
        if self._files:
            try:
                self._later.close()
            finally:  # Write the frames that are complete, even if a background job of this recorder failed.
                self._write()

    def _write(self) -> None:
        for file in self._files.values():
            file.write()


class Poly:
    """VTKHDF file with one PolyData block for each time step; the format calls such a block a partition."""

    def __init__(self, path: Path, kind: str) -> None:
        self.path, self.kind = path, kind
        self._pending_frames: list[tuple[float, np.ndarray, np.ndarray, dict[str, np.ndarray]]] = []

    def add(self, time: float, points: np.ndarray, cells: np.ndarray, fields: dict[str, np.ndarray]) -> None:
        """Add one frame: points (n, 3) [m], cells as indices of points (m, k), and fields of the points.

        `time` is the simulated time [s]. The frame is kept in memory until :meth:`write` is called.
        """
        self._pending_frames.append((time, points.astype(np.float32), cells.astype(np.int64), fields))

    def write(self) -> None:
        """Append to the file all frames that are kept in memory, as new time steps."""
        import h5py

        if not self._pending_frames:
            return
        with atomic_file(self.path) as partial:
            if self.path.is_file():
                shutil.copyfile(self.path, partial)
            try:
                with h5py.File(partial, "a") as file:
                    root = file["VTKHDF"] if "VTKHDF" in file else self._begin(file)
                    for step in self._pending_frames:
                        self._append(root, *step)
            except RuntimeError as error:  # On a full disk, h5py raises RuntimeError while closing a file.
                raise cannot_write(self.path, error) from error
        self._pending_frames = []

    def _begin(self, file: Any) -> Any:
        """Create the empty, extendable datasets of the VTKHDF format, and return the HDF5 group that contains them."""
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = np.array(VERSION, np.int64)
        root.attrs.create("Type", np.bytes_("PolyData"))
        steps = root.create_group("Steps")
        steps.attrs["NSteps"] = np.int64(0)
        _empty(root, "NumberOfPoints", np.int64)
        _empty(root, "Points", np.float32, 3)
        for kind in KINDS:
            for name in ("NumberOfConnectivityIds", "NumberOfCells", "Offsets", "Connectivity"):
                _empty(root, f"{kind}/{name}", np.int64)
        _empty(steps, "Values", np.float64)
        for name in ("PartOffsets", "NumberOfParts", "PointOffsets"):
            _empty(steps, name, np.int64)
        for name in ("CellOffsets", "ConnectivityIdOffsets"):
            _empty(steps, name, np.int64, len(KINDS))
        root.create_group("PointData")
        steps.create_group("PointDataOffsets")
        return root

    def _append(
        self, root: Any, time: float, points: np.ndarray, cells: np.ndarray, fields: dict[str, np.ndarray]
    ) -> None:
        steps = root["Steps"]
        _extend(steps["Values"], [time])
        _extend(steps["PartOffsets"], [len(root["NumberOfPoints"])])
        _extend(steps["NumberOfParts"], [1])
        _extend(steps["PointOffsets"], [len(root["Points"])])
        _extend(root["NumberOfPoints"], [len(points)])
        # In the VTKHDF format, a partition with n cells has n + 1 entries in the dataset Offsets. Readers account for
        # the additional entries, so CellOffsets contains numbers of cells.
        before = [int(root[kind]["NumberOfCells"][:].sum()) for kind in KINDS]
        _extend(steps["CellOffsets"], [before])
        _extend(steps["ConnectivityIdOffsets"], [[len(root[kind]["Connectivity"]) for kind in KINDS]])
        for kind in KINDS:
            here = cells if kind == self.kind else np.zeros((0, 1), np.int64)
            group = root[kind]
            _extend(group["NumberOfCells"], [len(here)])
            _extend(group["NumberOfConnectivityIds"], [here.size])
            _extend(group["Offsets"], here.shape[1] * np.arange(len(here) + 1))
            _extend(group["Connectivity"], here.ravel())
        for name, values in fields.items():
            if name not in root["PointData"]:
                _empty(root["PointData"], name, values.dtype, *values.shape[1:])
                _empty(steps["PointDataOffsets"], name, np.int64)
            _extend(steps["PointDataOffsets"][name], [len(root["PointData"][name])])
            _extend(root["PointData"][name], values)
        _extend(root["Points"], points)
        steps.attrs["NSteps"] = np.int64(len(steps["Values"]))

    def count(self) -> int:
        """Return the number of time steps in the file; 0 if the file is missing or damaged."""
        import h5py

        try:
            with h5py.File(self.path, "r") as file:
                return int(file["VTKHDF/Steps"].attrs["NSteps"])
        except (KeyError, OSError):
            return 0

    def shorten(self, count: int) -> None:
        """Keep only the first `count` time steps of the file."""
        import h5py

        if count == 0:
            self.path.unlink(missing_ok=True)
            return
        with atomic_file(self.path) as partial:
            shutil.copyfile(self.path, partial)
            with h5py.File(partial, "a") as file:
                _truncate(file["VTKHDF"], count)


def _truncate(root: Any, count: int) -> None:
    """Remove all time steps after the first `count` from an open VTKHDF file."""
    steps = root["Steps"]
    if int(steps.attrs["NSteps"]) == count:
        return
    points, cells = int(steps["PointOffsets"][count]), steps["CellOffsets"][count]
    ids = steps["ConnectivityIdOffsets"][count]
    for name in ("Values", "PartOffsets", "NumberOfParts", "PointOffsets", "CellOffsets", "ConnectivityIdOffsets"):
        steps[name].resize(count, 0)
    for name in root["PointData"]:
        root["PointData"][name].resize(int(steps["PointDataOffsets"][name][count]), 0)
        steps["PointDataOffsets"][name].resize(count, 0)
    root["NumberOfPoints"].resize(count, 0)
    root["Points"].resize(points, 0)
    for place, kind in enumerate(KINDS):
        root[kind]["NumberOfCells"].resize(count, 0)
        root[kind]["NumberOfConnectivityIds"].resize(count, 0)
        root[kind]["Offsets"].resize(int(cells[place]) + count, 0)
        root[kind]["Connectivity"].resize(int(ids[place]), 0)
    steps.attrs["NSteps"] = np.int64(count)


def _empty(group: Any, name: str, kind: Any, *width: int) -> None:
    rows = 1 << 10 if group.name.endswith("Steps") or "Number" in name else 1 << 14
    group.create_dataset(name, (0, *width), maxshape=(None, *width), dtype=kind, chunks=(rows, *width))


def _extend(dataset: Any, rows: Any) -> None:
    count = len(dataset)
    rows = np.asarray(rows, dataset.dtype).reshape(-1, *dataset.shape[1:])
    dataset.resize(count + len(rows), 0)
    dataset[count:] = rows
