"""Drawings of the gallery: scenes from the USD scene or the VTKHDF files of a run, drawn by VTK without a display."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from warpcrete.core.drawing.style import WIDTH, new_figure

BACKGROUND = (1.0, 1.0, 1.0)
SIDE, MARGIN, HIGHEST = 1800, 25, 5.0
"""Width of a drawn scene before it is cropped [px], margin of the crop [px], and largest height of a figure [in]."""
LONG = 1.3
"""Length of a transparent wall, relative to the bodies and the space around them, from which its ends are left out."""
AROUND = 0.1
"""Distance beyond the bodies up to which transparent walls are drawn, relative to the extent of the bodies."""


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

    from warpcrete.core.drawing.paint import colour_map

    high = max(p.shape[0] for p in pictures) / sum(p.shape[1] for p in pictures)
    figure = new_figure(caption.removeprefix("warpcrete: "), min(WIDTH * high, HIGHEST) + 0.7)
    every = figure.subplots(1, len(pictures), squeeze=False, width_ratios=[p.shape[1] for p in pictures])[0]
    for axes, picture, title in zip(every, pictures, titles, strict=True):
        axes.imshow(picture, interpolation="antialiased")
        axes.set_axis_off()
        if title:
            axes.text(0.5, -0.02, title, ha="center", va="top", transform=axes.transAxes)
    found = re.match(r"Colours: (.*) from (\S+) \(.*\) to (\S+) and above .* on (\w+)\.", colours)
    found = found or re.match(r"Colours: (.*) from (\S+) to (\S+) and above, on (\w+)\.", colours)
    if found:
        label, lower, upper, palette = found.groups()
        bar = ScalarMappable(Normalize(float(lower), float(upper)), colour_map(palette))
        figure.colorbar(bar, ax=list(every), label=label, orientation="horizontal", extend="max", fraction=0.035,
                        pad=0.02, aspect=45)  # fmt: skip
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
    words = f"Colours: pressure without weight [kPa] from 0 to {1e-3 * upper:g} and above, on viridis."
    return composed([vtk_picture(items, (0.5, -1.0, 0.5))], [""], caption_of(folder), words)
