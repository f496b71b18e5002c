"""Pictures of the gallery: every entry runs its command or its lines of Python, and draws what they leave.

python notebooks/gallery/make.py                  makes all pictures and the page, in some ten minutes on two idle cores
python notebooks/gallery/make.py slump line       makes two of them
python notebooks/gallery/make.py --again          runs all commands anew, as after a change of the program
python notebooks/gallery/make.py --list           lists their names

Runs are kept in a folder for temporary files, so that entries with the same command share one run. Scenes are drawn by
VTK from the USD scene or the VTKHDF files of a run, without a display. The screenshot of the viewer also needs Vulkan,
in software if there is no GPU; Debian has it in the package mesa-vulkan-drivers.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
WORK = Path(tempfile.gettempdir()) / "warpcrete-gallery"
MADE = ".made"
"""File that marks the folder of a complete run."""
WIDTH, MOST_BYTES = 1200, 120_000
"""Width of a picture [px], which is sharp on screens with two pixels for each point, and largest size of its file."""
FIGURE = 7.6
"""Width of the figure of a drawn scene [in]."""
BACKGROUND = (1.0, 1.0, 1.0)
SIDE, MARGIN, HIGHEST = 1800, 25, 5.0
"""Width of a drawn scene before it is cropped [px], margin of the crop [px], and largest height of a figure [in]."""
LONG = 1.3
"""Length of a transparent wall, relative to the bodies and the space around them, from which its ends are left out."""
AROUND = 0.1
"""Distance beyond the bodies up to which transparent walls are drawn, relative to the extent of the bodies."""


@dataclass(frozen=True)
class Entry:
    """Picture of the gallery."""

    name: str
    title: str
    says: str
    """Caption: one sentence about what the picture shows."""
    code: str
    """Command, or lines of Python that leave a Matplotlib figure in the name `figure`."""
    draw: Callable[[Path], Any]
    """Function that takes the folder of the run and returns the picture as a figure, or as the path of an image."""


# Drawing of scenes.


def scene_picture(files: Sequence[tuple[str, Path]], **look: Any) -> Any:
    """Return a figure of USD scenes side by side, with their titles, captions and one colour bar."""
    pictures, notes = [], {}
    for _, path in files:
        picture, notes = usd_picture(path, **look)
        pictures.append(picture)
    return composed(pictures, [title for title, _ in files], notes.get("title", ""), notes.get("colours", ""))


def composed(pictures: list[np.ndarray], titles: list[str], caption: str, colours: str) -> Any:
    """Return a figure of pictures side by side, with a caption above and the colour bar that a sentence describes."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure

    from warpcrete.core.drawing.paint import colour_map

    high = max(p.shape[0] for p in pictures) / sum(p.shape[1] for p in pictures)
    figure = Figure(figsize=(FIGURE, min(FIGURE * high, HIGHEST) + 0.85), layout="constrained")
    every = figure.subplots(1, len(pictures), squeeze=False, width_ratios=[p.shape[1] for p in pictures])[0]
    for axes, picture, title in zip(every, pictures, titles, strict=True):
        axes.imshow(picture, interpolation="antialiased")
        axes.set_axis_off()
        if title:
            axes.text(0.5, -0.02, title, fontsize=9, ha="center", va="top", transform=axes.transAxes)
    figure.suptitle(caption.removeprefix("warpcrete: "), fontsize=9.5)
    found = re.match(r"Colours: (.*) from (\S+) \(.*\) to (\S+) and above .* on (\w+)\.", colours)
    found = found or re.match(r"Colours: (.*) from (\S+) to (\S+) and above, on (\w+)\.", colours)
    if found:
        label, lower, upper, palette = found.groups()
        bar = ScalarMappable(Normalize(float(lower), float(upper)), colour_map(palette))
        drawn = figure.colorbar(bar, ax=list(every), orientation="horizontal", extend="max", fraction=0.035, pad=0.02,
                                aspect=45)  # fmt: skip
        drawn.set_label(label, fontsize=9)
        drawn.ax.tick_params(labelsize=8)
    return figure


def usd_picture(
    path: Path, *, time: float | None = None, direction: tuple[float, float, float] = (0.35, -1.0, 0.35),
    only_walls: bool = False, cut: bool = False, opacity: float | None = None,
) -> tuple[np.ndarray, dict[str, Any]]:  # fmt: skip
    """Draw a USD scene at a time [s], its last by default; return the picture and the notes of the file.

    `direction` leads from the scene to the camera. With `cut`, walls and bodies in front of the middle are left out.
    """
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(path))
    code = stage.GetEndTimeCode() if time is None else 1e3 * time
    notes, items = dict(stage.GetRootLayer().customLayerData), []
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Mesh) and not str(prim.GetPath()).count("/Prototypes/"):
            mesh = UsdGeom.Mesh(prim)
            points = np.array(mesh.GetPointsAttr().Get(code), float)
            matrix = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(code))
            points = points @ matrix[:3, :3] + matrix[3, :3]
            faces = np.array(mesh.GetFaceVertexIndicesAttr().Get(code)).reshape(-1, 3)
            normals = mesh.GetNormalsAttr().Get(code)
            colours = UsdGeom.PrimvarsAPI(prim).GetPrimvar("displayColor").ComputeFlattened(code)
            shown = np.array(mesh.GetDisplayOpacityAttr().Get() or [1.0], float)[0]
            if painted := prim.GetCustomDataByKey("colours"):
                notes["colours"] = "Colours: {quantity} from {lower:g} to {upper:g} and above, on {palette}.".format(
                    **painted
                )
                shown = 1.0
            elif only_walls:
                continue
            if cut and shown < 1 and len(points):
                middle = 0.5 * (points[:, 1].min() + points[:, 1].max())
                faces = faces[points[faces].mean(1)[:, 1] > middle]
            if opacity is not None and shown < 1:
                shown = opacity
            items.append((points, faces, screen(np.array(colours)), shown, normals))
        elif prim.IsA(UsdGeom.PointInstancer) and not only_walls:
            items.append(spheres_of(UsdGeom.PointInstancer(prim), stage, code, cut))
    if bodies := [item[0] for item in items if len(item) == 3 or item[3] == 1]:
        low, high = (f([f(body, axis=0) for body in bodies if len(body)], axis=0) for f in (np.min, np.max))
        reach = AROUND * float(np.max(high - low))
        items = [near(item, low - reach, high + reach) for item in items]
    return vtk_picture(items, direction), notes


def near(item: tuple[Any, ...], low: np.ndarray, high: np.ndarray) -> tuple[Any, ...]:
    """Return a transparent pipe that is much longer than the bodies without its ends far from them."""
    import vtk
    from vtk.util.numpy_support import vtk_to_numpy

    if len(item) == 3 or item[3] == 1 or not len(item[0]) or np.ptp(item[0], axis=0).max() < LONG * (high - low).max():
        return item
    box = vtk.vtkBox()
    box.SetBounds(*np.stack([low, high], 1).ravel())
    clip = vtk.vtkClipPolyData()
    clip.SetInputData(actor(item).GetMapper().GetInput())
    clip.SetClipFunction(box)
    clip.InsideOutOn()
    whole = vtk.vtkTriangleFilter()
    whole.SetInputConnection(clip.GetOutputPort())
    whole.Update()
    found = whole.GetOutput()
    points = vtk_to_numpy(found.GetPoints().GetData())
    return points, vtk_to_numpy(found.GetPolys().GetConnectivityArray()).reshape(-1, 3), item[2][:1], item[3], None


def spheres_of(instancer: Any, stage: Any, code: float, cut: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the centres, radii and colours of all spheres of a point instancer."""
    from pxr import UsdGeom

    from warpcrete.geometry.rotation import rotate

    places = np.array(instancer.GetPositionsAttr().Get(code), float)
    turns, sizes = instancer.GetOrientationsAttr().Get(code), np.array(instancer.GetScalesAttr().Get())[:, 0]
    kinds = np.array(instancer.GetProtoIndicesAttr().Get())
    colours = np.array(UsdGeom.PrimvarsAPI(instancer).GetPrimvar("displayColor").ComputeFlattened(code))
    q = np.tile([0.0, 0.0, 0.0, 1.0], (len(places), 1))
    if turns is not None:
        q = np.array([[*t.GetImaginary(), t.GetReal()] for t in turns], float)
    found = []
    for kind, target in enumerate(instancer.GetPrototypesRel().GetTargets()):
        mine = kinds == kind
        for ball in stage.GetPrimAtPath(target).GetChildren():
            at = np.array(UsdGeom.Xformable(ball).GetLocalTransformation().ExtractTranslation())
            turned = rotate(q[mine], np.tile(at, (mine.sum(), 1)))
            radius = UsdGeom.Sphere(ball).GetRadiusAttr().Get()
            found.append((places[mine] + sizes[mine, None] * turned, radius * sizes[mine], colours[mine]))
    centres, radii, paint = (np.concatenate([part[k] for part in found]) for k in range(3))
    shown = centres[:, 1] > 0.5 * (centres[:, 1].min() + centres[:, 1].max()) if cut else np.ones(len(centres), bool)
    return centres[shown], radii[shown], screen(paint[shown])


def screen(linear: np.ndarray) -> np.ndarray:
    """Return linear colours as sRGB bytes (IEC 61966-2-1)."""
    c = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    return (255 * np.clip(c, 0, 1)).astype(np.uint8)


def vtk_picture(items: list[Any], direction: Sequence[float]) -> np.ndarray:
    """Draw meshes (points, faces, colours, opacity, normals), spheres (centres, radii, colours) and VTK actors."""
    import vtk
    from vtk.util.numpy_support import vtk_to_numpy

    renderer = vtk.vtkRenderer()
    renderer.SetBackground(*BACKGROUND)
    for item in items:
        renderer.AddActor(actor(item) if isinstance(item, tuple) else item)
    window = vtk.vtkRenderWindow()
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(0)  # Transparent walls need depth peeling, which excludes multisampling.
    window.SetAlphaBitPlanes(1)
    window.SetSize(SIDE, SIDE)
    window.AddRenderer(renderer)
    renderer.SetUseDepthPeeling(1)
    renderer.SetMaximumNumberOfPeels(8)
    camera = renderer.GetActiveCamera()
    camera.SetFocalPoint(0, 0, 0)
    camera.SetPosition(*direction)
    camera.SetViewUp(0, 0, 1)
    camera.SetViewAngle(25)
    renderer.ResetCamera()
    light = vtk.vtkLightKit()
    light.AddLightsToRenderer(renderer)
    window.Render()
    image = vtk.vtkWindowToImageFilter()
    image.SetInput(window)
    image.ReadFrontBufferOff()
    image.Update()
    data = image.GetOutput()
    across, down, _ = data.GetDimensions()
    found = vtk_to_numpy(data.GetPointData().GetScalars()).reshape(down, across, -1)[::-1, :, :3]
    return found[_drawn(found, 1)][:, _drawn(found, 0)]


def _drawn(picture: np.ndarray, axis: int) -> slice:
    """Return the rows or columns of a picture that show anything, with a small margin."""
    there = np.flatnonzero((picture.min(-1) < 254).any(axis))
    return slice(max(there[0] - MARGIN, 0), there[-1] + MARGIN) if len(there) else slice(None)


def actor(item: tuple[Any, ...]) -> Any:
    """Return the VTK actor of a mesh or of spheres."""
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray

    spheres = len(item) == 3
    points, colours = np.ascontiguousarray(item[0], np.float64), np.ascontiguousarray(item[2])
    data = vtk.vtkPolyData()
    places = vtk.vtkPoints()
    places.SetData(numpy_to_vtk(points, deep=True))
    data.SetPoints(places)
    if len(colours) == len(points):
        paint = numpy_to_vtk(colours, deep=True)
        paint.SetName("colour")
        data.GetPointData().SetScalars(paint)
    found = vtk.vtkActor()
    if spheres:
        radius = numpy_to_vtk(np.ascontiguousarray(2 * item[1], np.float64), deep=True)
        radius.SetName("size")
        data.GetPointData().AddArray(radius)
        ball = vtk.vtkSphereSource()
        ball.SetThetaResolution(20)
        ball.SetPhiResolution(14)
        mapper = vtk.vtkGlyph3DMapper()
        mapper.SetInputData(data)
        mapper.SetSourceConnection(ball.GetOutputPort())
        mapper.SetScaleArray("size")
        mapper.SetScaleModeToScaleByMagnitude()
    else:
        cells = vtk.vtkCellArray()
        corners = numpy_to_vtkIdTypeArray(np.ascontiguousarray(item[1], np.int64).ravel(), deep=True)
        starts = numpy_to_vtkIdTypeArray(3 * np.arange(len(item[1]) + 1, dtype=np.int64), deep=True)
        cells.SetData(starts, corners)
        data.SetPolys(cells)
        if item[4] is not None:
            data.GetPointData().SetNormals(numpy_to_vtk(np.array(item[4], np.float64), deep=True))
        mapper = vtk.vtkPolyDataMapper()
        mapper.SetInputData(data)
        found.GetProperty().SetOpacity(item[3])
        if len(colours) != len(points):
            found.GetProperty().SetColor(*(colours[0] / 255))
            mapper.ScalarVisibilityOff()
    mapper.SetColorModeToDirectScalars()
    found.SetMapper(mapper)
    found.GetProperty().SetSpecular(0.15)
    found.GetProperty().SetSpecularPower(20)
    found.GetProperty().SetAmbient(0.12)
    return found


def last_step(path: Path, time: float | None = None) -> Any:
    """Return the data of a VTKHDF file at a time [s], the last by default."""
    import vtk

    reader = vtk.vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    times = reader.GetOutputInformation(0).Get(vtk.vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    reader.UpdateTimeStep(times[-1] if time is None else min(times, key=lambda t: abs(t - time)))
    found = vtk.vtkPolyData()
    found.DeepCopy(reader.GetOutput())
    return found


def coloured(data: Any, field: str, upper: float, palette: str) -> Any:
    """Return a VTK actor of data that a field colours."""
    import vtk

    from warpcrete.core.drawing.paint import colour_map

    table = vtk.vtkLookupTable()
    table.SetNumberOfTableValues(256)
    for k, colour in enumerate(colour_map(palette)(np.linspace(0, 1, 256))):
        table.SetTableValue(k, *map(float, colour))
    mapper = vtk.vtkPolyDataMapper()
    mapper.SetInputData(data)
    mapper.SelectColorArray(field)
    mapper.SetScalarModeToUsePointFieldData()
    mapper.SetLookupTable(table)
    mapper.SetScalarRange(0.0, upper)
    found = vtk.vtkActor()
    found.SetMapper(mapper)
    found.GetProperty().SetAmbient(0.2)
    return found


def glass(data: Any, opacity: float = 0.22) -> Any:
    """Return a VTK actor of a transparent wall."""
    import vtk

    mapper = vtk.vtkPolyDataMapper()
    mapper.SetInputData(data)
    mapper.ScalarVisibilityOff()
    found = vtk.vtkActor()
    found.SetMapper(mapper)
    found.GetProperty().SetColor(0.37, 0.5, 0.67)
    found.GetProperty().SetOpacity(opacity)
    return found


def chains(folder: Path) -> Any:
    """Draw the contact forces in a pipe as tubes whose width and colour show the force."""
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, vtk_to_numpy

    data = last_step(folder / "contacts.vtkhdf")
    force = vtk_to_numpy(data.GetPointData().GetArray("force"))
    upper = float(np.quantile(force[force > 0], 0.98))
    strong = vtk.vtkThreshold()
    strong.SetInputData(data)
    strong.SetInputArrayToProcess(0, 0, 0, vtk.vtkDataObject.FIELD_ASSOCIATION_POINTS, "force")
    strong.SetThresholdFunction(vtk.vtkThreshold.THRESHOLD_UPPER)
    strong.SetUpperThreshold(0.15 * upper)
    lines = vtk.vtkGeometryFilter()
    lines.SetInputConnection(strong.GetOutputPort())
    lines.Update()
    data = lines.GetOutput()
    force = vtk_to_numpy(data.GetPointData().GetArray("force"))
    width = numpy_to_vtk(np.clip(force / upper, 0.02, 1.0) * 2.2e-3, deep=True)
    width.SetName("width")
    data.GetPointData().AddArray(width)
    data.GetPointData().SetActiveScalars("width")
    tube = vtk.vtkTubeFilter()
    tube.SetInputData(data)
    tube.SetVaryRadiusToVaryRadiusByAbsoluteScalar()
    tube.SetNumberOfSides(6)
    tube.Update()
    items = [coloured(tube.GetOutput(), "force", upper, "viridis"), glass(last_step(folder / "walls.vtkhdf"))]
    words = f"Colours: contact force [N] from 0 to {upper:.2g} and above, on viridis."
    return composed([vtk_picture(items, (0.25, -1.0, 0.2))], [""], caption_of(folder), words)


def lumps(folder: Path) -> Any:
    """Draw the largest lumps of aggregates that hydrated bonds join, each in its colour, and other aggregates pale."""
    from vtk.util.numpy_support import vtk_to_numpy

    from warpcrete.core.drawing.style import SERIES

    bodies, data = last_step(folder / "bodies.vtkhdf"), last_step(folder / "contacts.vtkhdf")
    centres, radii = vtk_to_numpy(bodies.GetPoints().GetData()), vtk_to_numpy(bodies.GetPointData().GetArray("radius"))
    number = {tuple(np.round(1e6 * centre)): k for k, centre in enumerate(centres)}
    ends = vtk_to_numpy(data.GetPoints().GetData())[vtk_to_numpy(data.GetPointData().GetArray("hydrated")) > 0]
    lump = np.arange(len(centres))
    pairs = np.array([number[tuple(np.round(1e6 * end))] for end in ends]).reshape(-1, 2)
    for _ in range(len(centres)):  # Give joined aggregates the smallest number among them, until nothing changes.
        before = lump.copy()
        np.minimum.at(lump, pairs[:, 0], before[pairs[:, 1]])
        np.minimum.at(lump, pairs[:, 1], lump[pairs[:, 0]])
        if np.array_equal(before, lump):
            break
    names, sizes = np.unique(lump, return_counts=True)
    largest = names[np.argsort(-sizes, kind="stable")[: len(SERIES)]]
    items: list[Any] = [glass(last_step(folder / "walls.vtkhdf"), 0.12)]
    shown = (PALE, *SERIES)
    for colour, chosen in zip(shown, (~np.isin(lump, largest), *(lump == name for name in largest))):
        radius = radii[chosen] * (PALE_SIZE if colour == PALE else 1.0)
        items.append((centres[chosen], radius, np.tile(np.array(colour, np.uint8), (chosen.sum(), 1))))
    counts = ", ".join(map(str, sorted(sizes, reverse=True)[: len(SERIES)]))
    return composed([vtk_picture(items, (0.3, -1.0, 0.2))], [f"lumps of {counts} aggregates"], caption_of(folder), "")


PALE, PALE_SIZE = (205, 205, 200), 0.25
"""Colour of aggregates outside of the largest lumps, and their drawn radius relative to the true one."""


def caption_of(folder: Path) -> str:
    """Return the caption of the scene of a run folder."""
    import warpcrete

    return warpcrete.load(folder).scene.caption


def surface_file(folder: Path) -> Any:
    """Draw the surface of the concrete from its file for ParaView, coloured by the pressure."""
    data = last_step(folder / "surface.vtkhdf")
    data.GetPointData().SetActiveNormals("Normals")
    upper = 1e3 * round(1e-3 * data.GetPointData().GetArray("pressure").GetRange()[1])
    items = [coloured(data, "pressure", upper, "viridis"), glass(last_step(folder / "walls.vtkhdf"), 0.15)]
    words = f"Colours: pressure without weight [Pa] from 0 to {upper:g} and above, on viridis."
    return composed([vtk_picture(items, (0.5, -1.0, 0.5))], [""], caption_of(folder), words)


# Entries.


def image(name: str) -> Callable[[Path], Path]:
    """Return a function that takes a picture which the command itself has drawn."""
    return lambda folder: folder / name


def usd(**look: Any) -> Callable[[Path], Any]:
    """Return a function that draws the USD scene of a run."""
    return lambda folder: scene_picture([("", folder / "scene.usdc")], **look)


def units(folder: Path) -> Any:
    """Draw the scenes of a study side by side, each with the value that its case varies."""
    cases = sorted(path.parent for path in folder.glob("*/scene.usdc"))
    names = [re.sub(r"^\d+-unit=", "unit ", case.name) for case in cases]
    figure = scene_picture([(name, case / "scene.usdc") for name, case in zip(names, cases, strict=True)])
    figure.suptitle("pumping units, diameter 100 mm, concrete zhan, 8.48 m3/h", fontsize=9.5)
    return figure


def viewer(folder: Path) -> Path:
    """Take a screenshot of the end of a recording in the Rerun viewer, which needs no display for that."""
    from PIL import Image
    from rerun.experimental import ViewerClient

    import warpcrete

    shot, port = folder / "viewer.png", "9877"
    program = shutil.which("rerun") or str(Path(sys.executable).parent / "rerun")
    words = [
        program,
        folder / "run.rrd",
        "--headless",
        "--window-size",
        "1400x900",
        "--renderer",
        "vulkan",
        "--port",
        port,
    ]
    # The command is a script that starts the viewer, so both get a session, which ends as a whole.
    shown = subprocess.Popen(
        [*map(str, words)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )
    try:
        client = _once_there(lambda: ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy"))
        end = float(warpcrete.load(folder).series["time"][-1])
        _once_there(lambda: client.set_time("time", duration=end, play_state="paused"))
        time.sleep(SETTLING)
        client.save_screenshot(str(shot))
    finally:
        os.killpg(shown.pid, signal.SIGTERM)
        shown.wait(timeout=30)
    with Image.open(shot) as picture:
        below = picture.crop((0, MENU, *picture.size))
    below.save(shot)
    return shot


MENU = 37
"""Height of the viewer's menu, which is not drawn [px]."""
STARTING, SETTLING = 60.0, 5.0
"""Longest time in which the viewer starts, and time in which it draws a new state [s]."""


def _once_there(action: Callable[[], Any]) -> Any:
    """Return the result of an action of the viewer, which fails until the viewer has started."""
    started = time.monotonic()
    while True:
        try:
            return action()
        except Exception as error:  # The viewer's interface raises several kinds, none of them documented.
            if time.monotonic() - started > STARTING:
                raise SystemExit(f"viewer: Rerun did not start within {STARTING:g} s: {error}") from error
            time.sleep(1)


REDUCER = """\
import numpy as np, matplotlib.figure as drawing, warpcrete; figure = drawing.Figure((7.6, 2.2), layout="constrained")
scene = warpcrete.scenes.part(unit="horizontal", outlet_diameter=0.07, spacing=0.01)
simulation = warpcrete.Simulation(scene, device="cpu"); simulation.run(); display = simulation.display("speed")
half = display.surface(cut=True); x, y, z = half.vertices.T; cap = half.faces[np.all(y[half.faces] < 1e-6, axis=1)]
axes = figure.add_subplot(aspect="equal", title=scene.caption, xlabel="x [m]", ylabel="z [m]")
figure.colorbar(axes.tripcolor(x, z, cap, half.fields["speed"]), label="[m/s]")"""
MIGRATION = """\
import warpcrete; from matplotlib.figure import Figure; from warpcrete.core.drawing.style import legend_beside
scene = warpcrete.scenes.channel(aggregates=True, spacing=0.005, duration=2.0, sample_interval=0.05)
run = warpcrete.Simulation(scene, device="cpu").run(); figure = Figure((7.6, 3), layout="constrained")
axes = figure.add_subplot(xlabel="time [s]", ylabel="change of share [points]", title=scene.caption)
for part, share in ((name, run.series[f"aggregate_{name}"]) for name in ("front", "rear", "inner", "outer")):
    axes.plot(run.series["time"], 100 * (share - share[0]), label=part); legend_beside(axes)"""
RESTART = """\
from matplotlib.figure import Figure; from warpcrete.theory.pipe import CONCRETES, Line, restart
figure, rests = Figure(figsize=(7.6, 3.6), layout="constrained"), range(0, 1801, 60)
axes = figure.add_subplot(xlabel="rest [s]", ylabel="pressure [bar]", title="Restart of 100 m, no2, 20 m3/h")
for rate in (0.1, 0.5, 1.7):
    peaks = [restart(CONCRETES["no2"], Line(length=100, rise=0), t, rate, 20 / 3600).pressure / 1e5 for t in rests]
    axes.plot(rests, peaks); axes.annotate(f" {rate} Pa/s", (rests[-1], peaks[-1])); axes.set_xlim(0, 2100)"""
CONCRETE = "--concrete own --density 2300 --viscosity 30 --yield-stress"
PIPE = "--diameter 0.1 --length 0.35 --elbow-radius 0.25"
PIPE_A = "--diameter 0.1 --length 0.35"
ENTRIES = (
    Entry("units", "Pumping units", "Aggregates in the four units of Zhan et al. (2019), coloured by the largest "
          "contact force on each: a vertical and a horizontal pipe, and two bends.",
          f"warpcrete study pipe --unit A B C D {PIPE} --travel 0.02 --settle 0.3 --usd --out OUT", units),
    Entry("chains", "Force chains in a bend", "Forces between the aggregates. The dark disc is the piston, and the "
          "forces are largest near it. The short lines at the top lie in the plug of balls.",
          f"warpcrete run pipe --unit D {PIPE} --travel 0.15 --network --paraview --out OUT", chains),
    Entry("viewer", "The same bend in the viewer", "The recording in the Rerun viewer: bodies, a cut, force chains and "
          "curves over time on one timeline.",
          f"warpcrete run pipe --unit D {PIPE} --travel 0.15 --network --paraview --out OUT", viewer),
    Entry("blocked", "A blocked reducer", "Stones of 14 to 18 mm in a pipe that narrows from 80 to 36 mm: those below "
          "the throat (dark) lag behind the piston and jam, and the run stops.",
          "warpcrete run part-dem --unit vertical --diameter 0.08 --outlet-diameter 0.036 --taper 0.08 \\\n"
          "    --straight 0.12 --size-min 0.014 --size-max 0.018 --plug none --stop-when-blocked \\\n"
          "    --colour speed --out OUT",
          usd(direction=(0.3, -1.0, 0.25), cut=True)),
    Entry("worn", "A worn bend", "Depth that sliding and impacts have worn off the wall of a bend.",
          f"warpcrete run pipe --unit D {PIPE} --travel 0.3 --wear --out OUT",
          usd(direction=(-0.55, -1.0, 0.1), only_walls=True)),
    Entry("slump", "Slump test", "A cone of concrete whose mould is lifted, coloured by the shear rate.",
          f"warpcrete run slump {CONCRETE} 500 --spacing 0.01 --duration 1 --out OUT",
          usd(time=0.5, direction=(0.25, -1.0, 0.35), opacity=0.18)),
    Entry("heap", "Shape after the slump test", "The concrete at rest beside the closed form of a heap, and spread and "
          "height over time.", f"warpcrete run slump {CONCRETE} 200 --spacing 0.01 --out OUT", image("flow.png")),
    Entry("jring", "J-ring test", "Grains that spread through a ring of bars, coloured by their speed.",
          "warpcrete run jring-dem --size-min 0.016 --size-max 0.022 --duration 1 --lift-time 0.5 --colour speed "
          "--out OUT", usd(time=0.4, direction=(0.2, -1.0, 0.55), opacity=0.2)),
    Entry("lbox", "L-box test", "Concrete that flows through two bars into the box, as the gate opens.",
          "warpcrete run lbox --concrete own --density 2300 --viscosity 20 --yield-stress 30 --bars 2 \\\n"
          "    --bar-diameter 0.02 --spacing 0.0125 --duration 0.5 --out OUT",
          usd(direction=(0.45, -1.0, 0.35), opacity=0.2)),
    Entry("funnel", "V-funnel test", "Concrete that flows out of a funnel, most sheared at the outlet.",
          "warpcrete run funnel --concrete own --density 2300 --viscosity 20 --yield-stress 20 --spacing 0.015 \\\n"
          "    --duration 1 --out OUT", usd(direction=(0.3, -1.0, 0.15))),
    Entry("line", "Pressure along a line", "Pressure in the line of the Shanghai Tower by theory, with its likely "
          "range, its weight, and the pressure recorded at the pump.",
          "warpcrete line shanghai-tower --theory --out OUT", image("line.png")),
    Entry("trade", "Error against time", "A trade-off front: each point is a setting of the program; the line joins "
          "those that no other setting beats. A hollow marker means that its run failed one of the checks of the "
          "scene.",
          "warpcrete trade channel --budget 40s --out OUT", image("trade.png")),
    Entry("posterior", "What measurements determine", "Slip layers that agree with the wall stress at two flows. Above "
          "and right: how likely each viscosity and yield stress of the layer is; lower left: both together, of which "
          "only a narrow band is likely.",
          "warpcrete calibrate notebooks/targets/two_flows.yaml --trials 14 --out OUT",
          image("calibration.png")),
    Entry("migration", "Migration of stones", "Share of aggregate in the front and the rear half of a column, and near "
          "the axis and the wall, in percentage points since the start. A step is one grain that crosses a border.",
          MIGRATION, lambda folder: None),
    Entry("mortar", "Stones in mortar", "Grains and mortar in a channel: the grains are rigid; the mortar beside "
          "the wall is sheared.", "warpcrete run channel --aggregates --spacing 0.005 --duration 0.05 --out OUT",
          image("flow.png")),
    Entry("validation", "Predicted against measured", "Predictions over measurements, with the likely range of each; "
          "filled points are never used for a fit.", "warpcrete validate --quick --out OUT", image("validation.png")),
    Entry("strokes", "Two strokes with a stop", "Pressure on a piston that stops and starts again.",
          "warpcrete run pipe --unit horizontal --concrete no2 --diameter 0.1 --length 0.25 --ramp 0.02 \\\n"
          "    --strokes 2 --stroke 0.1 --pause 0.3 --out OUT", image("pressure.png")),
    Entry("clumps", "Clumps in a bend", "Aggregates as clumps of spheres, from the USD scene of the run, which Blender "
          "opens as well.",
          "warpcrete run pipe --unit C --shapes reference --diameter 0.1 --length 0.25 --elbow-radius 0.25 \\\n"
          "    --size-min 0.012 --size-max 0.024 --travel 0.02 --settle 0.2 --colour size --out OUT",
          usd(direction=(0.35, -1.0, 0.3), cut=True)),
    Entry("lumps", "Hydrated lumps", "Lumps of aggregates that hydrated bonds join, after they were pushed: the eight "
          "largest in colours, all other aggregates small and pale.",
          f"warpcrete run pipe --unit A {PIPE_A} --travel 0.05 --hydration 0.1 --network --paraview --out OUT", lumps),
    Entry("reducer", "Inside a reducer", "Speed of the concrete in a reducer, cut open: a plug that becomes faster.",
          REDUCER, lambda folder: None),
    Entry("paraview", "A file for ParaView", "Concrete in a bend, coloured by the pressure without weight, from "
          "`surface.vtkhdf` and `walls.vtkhdf` of the run, drawn by VTK.",
          "warpcrete run part --unit bend-to-vertical --spacing 0.0125 --paraview --out OUT", surface_file),
    Entry("profile", "Plug and slip", "Velocity over the radius of a tube: the concrete moves as a plug and slips on "
          "the wall, as theory says.", "warpcrete run tube --concrete no2 --ends periodic --out OUT",
          image("flow.png")),
    Entry("study", "A parameter study", "Slump and spread over the yield stress (left) and over the viscosity "
          "(right): each colour is a value of the other, and each marker a quantity.",
          "warpcrete study slump --concrete own --density 2300 --yield-stress 100 300 500 --viscosity 20 60 \\\n"
          "    --spacing 0.0125 --out OUT", image("study.png")),
    Entry("restart", "Pressure after a rest", "Pressure of 100 m of pipe that starts again, by theory, for three rates "
          "at which the concrete stiffens at rest.", RESTART, lambda folder: None),
)  # fmt: skip


def folder_of(code: str) -> Path:
    """Return the folder of the run that a command or lines of Python make."""
    return WORK / hashlib.sha256(code.encode()).hexdigest()[:12]


def arguments(code: str) -> list[str]:
    """Return the words of a command, with the folder of its run."""
    return [str(folder_of(code)) if word == "OUT" else word for word in shlex.split(code.replace("\\\n", ""))]


def make(entry: Entry) -> None:
    """Run the code of an entry, if it was not run before, and write its picture."""
    folder = folder_of(entry.code)
    if entry.code.startswith("warpcrete "):
        if not (folder / MADE).exists():
            shutil.rmtree(folder, ignore_errors=True)  # of a run that was interrupted
            words = [sys.executable, "-m", "warpcrete", *arguments(entry.code)[1:]]
            words += [] if words[3] in ("line", "validate") else ["--quiet", "--device", "cpu"]
            done = subprocess.run(words, cwd=HERE.parents[1], capture_output=True, text=True)
            if done.returncode not in (0, 3):  # A check of a run as short as these may fail.
                shutil.rmtree(folder, ignore_errors=True)
                said = f"{done.stdout[-800:]}{done.stderr[-1500:]}"
                raise SystemExit(f"{entry.name}: exit code {done.returncode}\n{said}")
            (folder / MADE).touch()
        picture = entry.draw(folder)
    else:
        names: dict[str, Any] = {}
        exec(entry.code, names)
        picture = names["figure"]
    save(picture, HERE / f"{entry.name}.png")


def save(picture: Any, path: Path) -> None:
    """Write a picture with as many colours as its size allows."""
    from PIL import Image

    if isinstance(picture, Path):
        found = Image.open(picture).convert("RGB")
    else:
        out = io.BytesIO()
        picture.savefig(out, dpi=100 * 2, format="png")
        found = Image.open(out).convert("RGB")
    if found.width > WIDTH:
        found = found.resize((WIDTH, round(WIDTH * found.height / found.width)), Image.Resampling.LANCZOS)
    for colours in (256, 128, 64, 32, 16):
        flat = found.quantize(colours, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        flat.save(path, optimize=True)
        if path.stat().st_size <= MOST_BYTES:
            return


def page() -> str:
    """Return the page of the gallery."""
    lines = ["# Gallery", "", "What does warpcrete show, and which command shows it?", ""]
    lines += [
        "Every picture was made by `python notebooks/gallery/make.py` from the command or the lines below it. The runs "
        "are short and coarse, so that the whole gallery takes some ten minutes on two idle CPU cores.",
        "",
    ]
    for entry in ENTRIES:
        language = "" if entry.code.startswith("warpcrete ") else "python"
        code = entry.code.replace(" --out OUT", f" --out {entry.name}")
        lines += [f"## {entry.title}", "", f"![{entry.title}]({entry.name}.png)", "", entry.says, "",
                  f"```{language}", code, "```", ""]  # fmt: skip
    lines += ["## Not covered", "", "[Look at a run](../how-to/view.md) says how to open recordings, and "
              "[recordings](../reference/recordings.md) lists what they contain.", ""]  # fmt: skip
    return "\n".join(lines)


def main() -> None:
    """Make the pictures that are named, or all of them, and the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="pictures to make (default: all)")
    parser.add_argument("--again", action="store_true", help="run the commands anew, even if their runs are kept")
    parser.add_argument("--list", action="store_true", help="list the names of all pictures")
    given = parser.parse_args()
    known = {entry.name: entry for entry in ENTRIES}
    if given.list:
        print("\n".join(known))
        return
    for name in given.names:
        if name not in known:
            parser.error(f"{name!r} is not a picture; use one of {', '.join(known)}")
    os.environ.setdefault("PYTHONPATH", str(HERE.parents[1]))
    for name in given.names or known:
        if given.again:
            shutil.rmtree(folder_of(known[name].code), ignore_errors=True)
    failures = []
    for name in given.names or known:
        started = time.perf_counter()
        try:
            make(known[name])
        except SystemExit as failure:  # The other pictures are made all the same.
            failures.append(str(failure))
            continue
        size = (HERE / f"{name}.png").stat().st_size
        print(f"{name:12} {time.perf_counter() - started:6.1f} s {size / 1e3:6.1f} kB", flush=True)
    (HERE / "index.md").write_text(page(), encoding="utf-8")
    if failures:
        raise SystemExit("\n".join(failures))


if __name__ == "__main__":
    main()
