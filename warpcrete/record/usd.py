"""Recorder of a USD scene: bodies with time samples, walls, materials, light and a camera.

All rigid bodies are one point instancer with a prototype for each shape. The concrete of a flow on a grid is a mesh of
its surface, the stones in it are a point instancer of spheres, and the particles of flows with moving particles are
points.
"""

# pyright: reportAttributeAccessIssue=false
# Modules of pxr (the USD library) add attributes when they are imported, so Pyright must not report them as missing.

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ..core.device.recorder_thread import RecorderThread
from ..core.drawing.display import Display, DrawnWall, RigidBodies
from ..core.records import SavedState
from ..core.run.files import atomic_file, cannot_write
from ..core.run.recorder import Recorder
from ..core.run.run import Run
from ..core.run.simulation_base import SimulationBase
from .usd_looks import Colours, Painted, bind, bodies_look, describe, light, linear, wall_look

FRAMES_PER_SECOND = 1000  # One USD time code stands for one millisecond of simulated time.


class UsdRecorder(Recorder):
    """Recorder that writes scene.usdc, in metres with Z up, at checkpoints and at the end of a run.

    The file is also written when a run is interrupted. If `velocities` is true, the file also contains the velocities
    of rigid bodies, which renderers need for motion blur. These velocities make the file one and a half times as large.
    The file always contains the velocities of stones in mortar.
    """

    expendable = True

    def __init__(self, path: Path, *, colouring: str | None = None, velocities: bool = True) -> None:
        self.path, self.colouring, self.velocities = path, colouring, velocities
        self._stage: Any = None
        self._bodies: Any = None
        self._spheres: _Spheres | None = None
        self._first: float | None = None
        self._last: float | None = None

    def start(self, simulation: SimulationBase) -> None:
        """Create a USD stage in memory, with everything that does not change in time."""
        from pxr import Usd

        self._build(simulation, Usd.Stage.CreateInMemory())

    def resume(self, simulation: SimulationBase, state: SavedState) -> None:
        """Open the file of the checkpoint and remove all time samples after the checkpoint."""
        from pxr import Sdf, Tf, Usd

        try:
            layer = Sdf.Layer.OpenAsAnonymous(str(self.path))
        except Tf.ErrorException:
            warnings.warn(
                f"'{self.path}': is missing or damaged; a new recording begins now, without the earlier frames",
                stacklevel=2,
            )
            self.start(simulation)
            return
        self._first, self._last = state["first"], state["last"]

        paths: list[Any] = []
        layer.Traverse(Sdf.Path.absoluteRootPath, paths.append)
        for path in paths:
            if path.IsPropertyPath():
                for code in layer.ListTimeSamplesForPath(path):
                    if code > self._last:
                        layer.EraseTimeSample(path, code)
        self._build(simulation, Usd.Stage.Open(layer))

    def _build(self, simulation: SimulationBase, stage: Any) -> None:
        """Define all objects on the USD stage, with the data that does not change in time.

        Objects that exist already, because a run is resumed, keep their time samples.
        """
        from pxr import UsdGeom

        self._stage, self._later = stage, RecorderThread.for_simulation(simulation)
        self._display = display = simulation.display(self.colouring)
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        stage.SetTimeCodesPerSecond(FRAMES_PER_SECOND)
        stage.SetFramesPerSecond(round(1 / simulation.frames.interval) or 1)
        root = UsdGeom.Xform.Define(stage, "/Run")
        stage.SetDefaultPrim(root.GetPrim())
        rigid = display.rigid_bodies()
        path = f"/Run/{display.noun.capitalize()}"
        if display.has_surface:
            self._bodies = _Surface(stage, path)
            self._spheres = _Spheres(stage, "/Run/Aggregates", display) if display.has_spheres else None
        elif rigid is None:
            self._bodies = _Points(stage, path, display)
        else:
            self._bodies = _Instances(stage, path, rigid, self.velocities)
        self._build_walls(display.walls())
        self._build_camera(display)
        light(stage, display)
        describe(stage, display, simulation.scene)

    def _build_walls(self, walls: list[DrawnWall]) -> None:
        from pxr import Usd, UsdGeom, Vt

        UsdGeom.Xform.Define(self._stage, "/Run/Walls")
        self._poses: dict[int, tuple[Any, Any]] = {}
        self._painted: dict[int, Painted] = {}
        for number, wall in enumerate(walls):
            name = _prim_name(wall.name, number, walls)
            mesh = UsdGeom.Mesh.Define(self._stage, f"/Run/Walls/{name}")
            points = wall.vertices.astype(np.float32)
            mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
            mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(wall.faces), 3, np.int32)))
            mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(wall.faces.astype(np.int32).ravel()))
            mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
            mesh.CreateDoubleSidedAttr(True)
            mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([points.min(0), points.max(0)])))
            painted = self._display.wall_values(number) is not None
            material, colour, opacity = wall_look(self._stage, wall, f"Wall_{name}", painted)
            bind(mesh.GetPrim(), material)
            mesh.CreateDisplayOpacityAttr([opacity])
            mesh.ClearXformOpOrder()
            if painted:
                self._painted[number] = Painted(mesh)
            else:
                mesh.CreateDisplayColorAttr([colour])
            self._poses[number] = (mesh.AddTranslateOp(), mesh.AddOrientOp(UsdGeom.XformOp.PrecisionDouble))
            if not wall.moves:
                self._pose(number, Usd.TimeCode.Default())
        self._moving = [number for number, wall in enumerate(walls) if wall.moves]

    def _build_camera(self, display: Display) -> None:
        from pxr import Gf, UsdGeom

        eye, target = display.view(1.9)
        camera = UsdGeom.Camera.Define(self._stage, "/Run/Camera")
        look = Gf.Matrix4d().SetLookAt(Gf.Vec3d(*map(float, eye)), Gf.Vec3d(*map(float, target)), Gf.Vec3d(0, 0, 1))
        camera.ClearXformOpOrder()
        camera.AddTransformOp().Set(look.GetInverse())
        distance = float(np.linalg.norm(eye - target))
        camera.CreateFocalLengthAttr(22.0)
        camera.CreateClippingRangeAttr(Gf.Vec2f(0.01 * distance, 100 * distance))
        camera.CreateFocusDistanceAttr(distance)

    def frame(self, simulation: SimulationBase) -> None:
        """Record one time sample of all bodies and moving walls."""
        self._display.draw(self._later, self._draw)

    def _draw(self, time: float, steps: int) -> None:
        from pxr import Usd

        code = Usd.TimeCode(time * FRAMES_PER_SECOND)
        self._first = code.GetValue() if self._first is None else self._first
        self._last = code.GetValue()
        self._bodies.frame(self._display, code)
        if self._spheres is not None:
            self._spheres.frame(self._display, code)
        for number in self._moving:
            self._pose(number, code)
        paint = self._display.paint()
        for number, painted in self._painted.items():
            values = self._display.wall_values(number)
            assert values is not None and paint is not None
            painted.set(values, paint, code)

    def _pose(self, number: int, code: Any) -> None:
        from pxr import Gf

        position, (x, y, z, w) = self._display.wall_pose(number)
        translate, orient = self._poses[number]
        translate.Set(Gf.Vec3d(*map(float, position)), code)
        orient.Set(Gf.Quatd(float(w), float(x), float(y), float(z)), code)

    def finish(self, simulation: SimulationBase, run: Run) -> None:
        """Write the USD file when the run has ended."""
        if self._stage is not None:
            try:
                self._later.close()
            finally:  # Write the frames that are complete, even if a background job of this recorder failed.
                self._write()

    def checkpoint(self, simulation: SimulationBase) -> SavedState:
        """Return the USD time codes of the first and the last frame [ms], which a resumed run needs."""
        self._later.wait()
        return {"first": self._first, "last": self._last}

    def write(self, simulation: SimulationBase) -> None:
        """Write the file with all frames so far."""
        self._write()

    def _write(self) -> None:
        from pxr import Tf

        if self._first is None:
            return
        self._stage.SetStartTimeCode(self._first)
        self._stage.SetEndTimeCode(self._last)
        with atomic_file(self.path) as partial:
            try:
                written = self._stage.GetRootLayer().Export(str(partial))
            except Tf.ErrorException as error:
                raise cannot_write(self.path, error) from error
            if not written:
                raise cannot_write(self.path, OSError("the USD library states no reason"))


class _Instances:
    """USD point instancer that shows rigid bodies."""

    def __init__(self, stage: Any, path: str, rigid: RigidBodies, velocities: bool) -> None:
        from pxr import Gf, Sdf, UsdGeom, Vt

        self._instancer = instancer = UsdGeom.PointInstancer.Define(stage, path)
        shapes = []
        # Orientations are left out if all shapes are single spheres, whose rotation about their centres is not visible.
        self._turn = any(len(prototype.radii) > 1 or np.any(prototype.offsets) for prototype in rigid.prototypes)
        self._velocities = velocities
        look = bodies_look(stage)
        for number, prototype in enumerate(rigid.prototypes):
            shape = f"{path}/Prototypes/Template_{number}"
            prim = UsdGeom.Xform.Define(stage, shape).GetPrim()
            prim.SetMetadata("comment", prototype.name)
            bind(prim, look)
            for k, (offset, radius) in enumerate(zip(prototype.offsets, prototype.radii, strict=True)):
                ball = UsdGeom.Sphere.Define(stage, f"{shape}/Sphere_{k}")
                ball.CreateRadiusAttr(float(radius))
                ball.CreateExtentAttr([Gf.Vec3f(*[-float(radius)] * 3), Gf.Vec3f(*[float(radius)] * 3)])
                UsdGeom.XformCommonAPI(ball).SetTranslate(Gf.Vec3d(*map(float, offset)))
            shapes.append(shape)
        size = rigid.sizes.astype(np.float32)
        instancer.CreatePrototypesRel().SetTargets(shapes)
        instancer.CreateProtoIndicesAttr(Vt.IntArray.FromNumpy(rigid.prototype.astype(np.int32)))
        instancer.CreateIdsAttr(Vt.Int64Array.FromNumpy(np.arange(len(size), dtype=np.int64)))
        instancer.CreateScalesAttr(Vt.Vec3fArray.FromNumpy(np.repeat(size[:, None], 3, 1)))
        primvars = UsdGeom.PrimvarsAPI(instancer)
        self._colours = Colours(
            primvars.CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray, UsdGeom.Tokens.vertex)
        )
        extents = np.array([prototype.extent for prototype in rigid.prototypes])
        self._reach = size * extents[rigid.prototype] if len(size) else size

    def frame(self, display: Display, code: Any) -> None:
        from pxr import Vt

        pose = display.pose()
        position = pose.positions.astype(np.float32)
        self._instancer.CreatePositionsAttr().Set(Vt.Vec3fArray.FromNumpy(position), code)
        if self._turn:
            # USD stores quaternions in half precision and in the order x, y, z, w (real part last), which is also the
            # order in this program.
            orientation = np.ascontiguousarray(pose.orientations.astype(np.float16))
            self._instancer.CreateOrientationsAttr().Set(Vt.QuathArray.FromNumpy(orientation), code)
        if self._velocities:
            velocity = Vt.Vec3fArray.FromNumpy(pose.velocities.astype(np.float32))
            self._instancer.CreateVelocitiesAttr().Set(velocity, code)
        if len(position):
            extent = _extent(position, self._reach)
            self._instancer.CreateExtentAttr().Set(Vt.Vec3fArray.FromNumpy(extent), code)
        self._colours.set(display.body_colours(), code)


class _Spheres:
    """USD point instancer that shows spheres in a concrete, whose number may change from frame to frame.

    Between two frames, a renderer computes the positions from the velocities of the first frame. Without velocities, it
    would interpolate between two arrays of equal length, even if they do not contain the same spheres.
    """

    def __init__(self, stage: Any, path: str, display: Display) -> None:
        from pxr import Gf, UsdGeom, Vt

        self._instancer = UsdGeom.PointInstancer.Define(stage, path)
        ball = UsdGeom.Sphere.Define(stage, f"{path}/Prototypes/Sphere")
        ball.CreateRadiusAttr(0.5)
        ball.CreateExtentAttr([Gf.Vec3f(-0.5), Gf.Vec3f(0.5)])
        bind(ball.GetPrim(), bodies_look(stage))
        ball.CreateDisplayColorAttr(Vt.Vec3fArray.FromNumpy(linear(np.array([display.spheres().colour]))))
        self._instancer.CreatePrototypesRel().SetTargets([ball.GetPath()])

    def frame(self, display: Display, code: Any) -> None:
        from pxr import Vt

        spheres, instancer = display.spheres(), self._instancer
        position, radius = spheres.centres.astype(np.float32), spheres.radii.astype(np.float32)
        size = np.repeat(2 * radius[:, None], 3, 1)
        instancer.CreateIdsAttr().Set(Vt.Int64Array.FromNumpy(spheres.ids.astype(np.int64)), code)
        velocity = Vt.Vec3fArray.FromNumpy(spheres.velocities.astype(np.float32))
        instancer.CreateVelocitiesAttr().Set(velocity, code)
        instancer.CreatePositionsAttr().Set(Vt.Vec3fArray.FromNumpy(position), code)
        instancer.CreateScalesAttr().Set(Vt.Vec3fArray.FromNumpy(size), code)
        instancer.CreateProtoIndicesAttr().Set(Vt.IntArray.FromNumpy(np.zeros(len(radius), np.int32)), code)
        if len(position):
            instancer.CreateExtentAttr().Set(Vt.Vec3fArray.FromNumpy(_extent(position, radius)), code)


class _Surface:
    """USD mesh that shows the surface of concrete, with its own vertices and faces in every frame."""

    def __init__(self, stage: Any, path: str) -> None:
        from pxr import UsdGeom

        self._mesh = UsdGeom.Mesh.Define(stage, path)
        self._mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        self._colours = Colours(self._mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex))
        bind(self._mesh.GetPrim(), bodies_look(stage))

    def frame(self, display: Display, code: Any) -> None:
        from pxr import UsdGeom, Vt

        mesh, surface = self._mesh, display.bare_surface()
        assert surface is not None
        vertices = surface.vertices.astype(np.float32)
        mesh.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(vertices), code)
        mesh.CreateNormalsAttr().Set(Vt.Vec3fArray.FromNumpy(surface.normals.astype(np.float32)), code)
        mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
        mesh.CreateFaceVertexCountsAttr().Set(Vt.IntArray.FromNumpy(np.full(len(surface.faces), 3, np.int32)), code)
        mesh.CreateFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(surface.faces.astype(np.int32).ravel()), code)
        if len(vertices):
            mesh.CreateExtentAttr().Set(Vt.Vec3fArray.FromNumpy(_extent(vertices, np.zeros(1, np.float32))), code)
        self._colours.set(display.surface_colours(surface), code)


class _Points:
    """USD points that show fluid particles."""

    def __init__(self, stage: Any, path: str, display: Display) -> None:
        from pxr import UsdGeom, Vt

        self._points = UsdGeom.Points.Define(stage, path)
        self._radii = display.radii().astype(np.float32)
        self._points.CreateWidthsAttr(Vt.FloatArray.FromNumpy(2 * self._radii))
        self._points.CreateIdsAttr(Vt.Int64Array.FromNumpy(np.arange(len(self._radii), dtype=np.int64)))
        self._colours = Colours(self._points.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex))
        bind(self._points.GetPrim(), bodies_look(stage))

    def frame(self, display: Display, code: Any) -> None:
        from pxr import Vt

        place = display.centres().astype(np.float32)
        self._points.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(place), code)
        extent = _extent(place, self._radii)
        self._points.CreateExtentAttr().Set(Vt.Vec3fArray.FromNumpy(extent), code)
        self._colours.set(display.colours(), code)


def _extent(places: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Return the lowest and the highest corner of the box around all bodies [m], shape (2, 3).

    `places` are the centres of the bodies [m], and `reach` is the largest distance of each body's surface from its
    centre [m]. For a surface, `places` are its vertices and `reach` is 0.
    """
    # Store the values of each coordinate next to each other in memory, so that NumPy finds their minimum ten times as
    # fast.
    x = np.ascontiguousarray(places.T)
    return np.stack([(x - reach).min(1), (x + reach).max(1)]).astype(np.float32)


def _prim_name(name: str, number: int, walls: list[DrawnWall]) -> str:
    from pxr import Tf

    valid = Tf.MakeValidIdentifier(name)
    same = [wall for wall in walls if Tf.MakeValidIdentifier(wall.name) == valid]
    return valid if len(same) == 1 and name else f"{valid}_{number}"
