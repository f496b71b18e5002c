"""The run as a USD scene: one point instancer, one prototype a clump template, time samples, walls, a camera."""

# pyright: reportAttributeAccessIssue=false
# (the pxr modules fill themselves when they load)

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .drawing import body_values, colour_limit, colours, view, wall_mesh, wall_pose
from .errors import RunFolderError
from .simulation import Simulation
from .spine import Recorder, Run

FRAMES_PER_SECOND = 1000  # time codes are milliseconds of simulated time


class UsdRecorder(Recorder):
    """Writes scene.usdc at checkpoints and when the run ends, also after an interruption. Z up, metres."""

    def __init__(self, path: Path, *, colouring: str = "speed") -> None:
        self.path, self.colouring = path, colouring
        self._stage: Any = None
        self._first: float | None = None
        self._last: float | None = None

    def start(self, simulation: Simulation) -> None:
        """Stage, prototypes, walls and camera."""
        from pxr import Usd

        stage = Usd.Stage.CreateInMemory()
        self._stage = stage
        self._build(simulation, stage)

    def resume(self, simulation: Simulation, memory: dict[str, Any]) -> None:
        """Open the file of the checkpoint and take out what came after it."""
        from pxr import Sdf, Tf, Usd

        try:
            layer = Sdf.Layer.OpenAsAnonymous(str(self.path))
        except Tf.ErrorException as error:
            raise RunFolderError(f"'{self.path}': is missing or damaged; the run cannot be resumed") from error
        self._first, self._last = memory["first"], memory["last"]

        paths: list[Any] = []
        layer.Traverse(Sdf.Path.absoluteRootPath, paths.append)
        for path in paths:
            if path.IsPropertyPath():
                for code in layer.ListTimeSamplesForPath(path):
                    if code > self._last:
                        layer.EraseTimeSample(path, code)
        self._stage = Usd.Stage.Open(layer)
        self._build(simulation, self._stage)

    def _build(self, simulation: Simulation, stage) -> None:
        """Everything that does not change; on a stage that has it already, the same again."""
        from pxr import Gf, Usd, UsdGeom, Vt

        state = simulation.state
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        stage.SetTimeCodesPerSecond(FRAMES_PER_SECOND)
        stage.SetFramesPerSecond(round(1 / simulation.frame_interval) or 1)
        root = UsdGeom.Xform.Define(stage, "/Run")
        stage.SetDefaultPrim(root.GetPrim())
        instancer = UsdGeom.PointInstancer.Define(stage, "/Run/Aggregates")
        self._instancer = instancer
        order = np.argsort(state.body_id.numpy())
        size = state.body_size.numpy()[order].astype(np.float32)
        paths = []
        for number, template in enumerate(state.templates):
            path = f"/Run/Aggregates/Prototypes/Template_{number}"
            prototype = UsdGeom.Xform.Define(stage, path)
            prototype.GetPrim().SetMetadata("comment", template.name)
            for k, (offset, radius) in enumerate(zip(template.offsets, template.radii, strict=True)):
                ball = UsdGeom.Sphere.Define(stage, f"{path}/Sphere_{k}")
                ball.CreateRadiusAttr(float(radius))
                ball.CreateExtentAttr([Gf.Vec3f(*[-float(radius)] * 3), Gf.Vec3f(*[float(radius)] * 3)])
                UsdGeom.XformCommonAPI(ball).SetTranslate(Gf.Vec3d(*map(float, offset)))
            paths.append(path)
        instancer.CreatePrototypesRel().SetTargets(paths)
        instancer.CreateProtoIndicesAttr(Vt.IntArray.FromNumpy(state.body_template.numpy()[order].astype(np.int32)))
        instancer.CreateIdsAttr(Vt.Int64Array.FromNumpy(np.arange(state.body_count, dtype=np.int64)))
        instancer.CreateScalesAttr(Vt.Vec3fArray.FromNumpy(np.repeat(size[:, None], 3, 1)))
        self._colour = UsdGeom.PrimvarsAPI(instancer).CreatePrimvar(
            "displayColor", self._types().Color3fArray, UsdGeom.Tokens.vertex
        )
        self._upper = colour_limit(simulation, self.colouring)

        UsdGeom.Xform.Define(stage, "/Run/Walls")
        self._walls = {}
        for number, wall in enumerate(simulation.model.walls):
            drawn = wall_mesh(wall)
            if drawn is None:
                continue
            vertices, faces = drawn
            mesh = UsdGeom.Mesh.Define(stage, f"/Run/Walls/{_prim_name(wall.name, number, simulation)}")
            points = vertices.astype(np.float32)
            mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points))
            mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
            mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.astype(np.int32).ravel()))
            mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
            mesh.CreateDoubleSidedAttr(True)
            mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([points.min(0), points.max(0)])))
            opaque = wall.motion is not None
            mesh.CreateDisplayColorAttr([Gf.Vec3f(0.75, 0.43, 0.24) if opaque else Gf.Vec3f(0.59, 0.65, 0.7)])
            mesh.CreateDisplayOpacityAttr([1.0 if opaque else 0.15])
            mesh.ClearXformOpOrder()
            self._walls[number] = (mesh.AddTranslateOp(), mesh.AddOrientOp(UsdGeom.XformOp.PrecisionDouble))
            if not opaque:
                self._pose(simulation, number, Usd.TimeCode.Default())

        eye, target = view(simulation, 1.9)
        camera = UsdGeom.Camera.Define(stage, "/Run/Camera")
        look = Gf.Matrix4d().SetLookAt(Gf.Vec3d(*eye), Gf.Vec3d(*target), Gf.Vec3d(0, 0, 1)).GetInverse()
        camera.ClearXformOpOrder()
        camera.AddTransformOp().Set(look)
        distance = float(np.linalg.norm(eye - target))
        camera.CreateFocalLengthAttr(22.0)
        camera.CreateClippingRangeAttr(Gf.Vec2f(0.01 * distance, 100 * distance))
        camera.CreateFocusDistanceAttr(distance)

    def frame(self, simulation: Simulation) -> None:
        """One time sample of all bodies and moving walls."""
        from pxr import Usd, Vt

        state = simulation.state
        code = Usd.TimeCode(simulation.stepper.time * FRAMES_PER_SECOND)
        self._first = code.GetValue() if self._first is None else self._first
        self._last = code.GetValue()
        order = np.argsort(state.body_id.numpy())
        position = state.body_position.numpy()[order].astype(np.float32)
        # USD stores quaternions in half precision, real part last in memory as here.
        orientation = state.body_orientation.numpy()[order].astype(np.float16)
        self._instancer.CreatePositionsAttr().Set(Vt.Vec3fArray.FromNumpy(position), code)
        self._instancer.CreateOrientationsAttr().Set(Vt.QuathArray.FromNumpy(np.ascontiguousarray(orientation)), code)
        velocity = state.body_velocity.numpy()[order].astype(np.float32)
        self._instancer.CreateVelocitiesAttr().Set(Vt.Vec3fArray.FromNumpy(velocity), code)
        if state.body_count:
            reach = (
                state.body_size.numpy()[order]
                * np.array([t.extent for t in state.templates])[state.body_template.numpy()[order]]
            )
            lower, upper = (position - reach[:, None]).min(0), (position + reach[:, None]).max(0)
            extent = np.stack([lower, upper]).astype(np.float32)
            self._instancer.CreateExtentAttr().Set(Vt.Vec3fArray.FromNumpy(extent), code)
        tint = colours(body_values(simulation, self.colouring), self._upper).astype(np.float32) / 255
        self._colour.Set(Vt.Vec3fArray.FromNumpy(tint), code)
        for number in self._walls:
            if simulation.model.walls[number].motion is not None:
                self._pose(simulation, number, code)

    def finish(self, simulation: Simulation, run: Run) -> None:
        """Write the file."""
        if self._stage is not None:
            self._write()

    def checkpoint(self, simulation: Simulation) -> dict[str, Any]:
        """Write the file as it is so far."""
        self._write()
        return {"first": self._first, "last": self._last}

    def _write(self) -> None:
        # Beside, then rename: no reader meets half a file.
        if self._first is None:
            return
        self._stage.SetStartTimeCode(self._first)
        self._stage.SetEndTimeCode(self._last)
        partial = self.path.with_name("partial-" + self.path.name)
        self._stage.GetRootLayer().Export(str(partial))
        partial.replace(self.path)

    def _pose(self, simulation: Simulation, number: int, code) -> None:
        from pxr import Gf

        position, (x, y, z, w) = wall_pose(simulation, number)
        translate, orient = self._walls[number]
        translate.Set(Gf.Vec3d(*map(float, position)), code)
        orient.Set(Gf.Quatd(float(w), float(x), float(y), float(z)), code)

    @staticmethod
    def _types():
        from pxr import Sdf

        return Sdf.ValueTypeNames


def _prim_name(name: str, number: int, simulation: Simulation) -> str:
    from pxr import Tf

    valid = Tf.MakeValidIdentifier(name)
    same = [w for w in simulation.model.walls if Tf.MakeValidIdentifier(w.name) == valid]
    return valid if len(same) == 1 and name else f"{valid}_{number}"
