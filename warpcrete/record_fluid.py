"""Flows for the Rerun viewer, as USD and as a picture."""

# pyright: reportAttributeAccessIssue=false
# (the pxr modules fill themselves when they load)

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .axis import Axis, Line
from .drawing import colours
from .fluid_probes import Snapshot
from .fluid_simulation import FluidSimulation
from .record_rerun import RerunRecorder
from .record_usd import FRAMES_PER_SECOND, UsdRecorder
from .spine import Recorder, Run
from .theory import velocity

COLOURINGS = ("speed", "pressure", "phase")
GRAIN = np.array([120, 118, 112], np.uint8)
MORTAR = np.array([214, 204, 184], np.uint8)


def places(simulation: FluidSimulation) -> np.ndarray:
    """Particles in the room [m], shape (n, 3): z up, a channel in the plane of x and z."""
    x = simulation.state.position.numpy().astype(float)
    x[:, -1] += simulation.scene.velocity * simulation.stepper.time
    if simulation.scene.dimensions == 2:
        x = np.insert(x, 1, 0.0, axis=1)
    return x


def tint(simulation: FluidSimulation, colouring: str) -> np.ndarray:
    """RGB bytes (n, 3): by speed on a scale that shows the profile, by pressure, or grains against mortar."""
    snap = Snapshot.of(simulation.flow)
    theory = simulation.flow.theory
    if colouring == "pressure":
        return colours(snap.pressure, theory.pressure)
    if colouring == "speed":
        centre = float(velocity(simulation.scene.concrete, simulation.scene.line, theory, [0.0])[0])
        return colours(snap.velocity, centre, theory.slip_velocity)
    grains = simulation.state.grains
    coarse = np.zeros(len(snap.height), bool) if grains is None else grains.group >= 0
    shade = np.ones(len(coarse))
    if grains is not None:  # neighbours tell apart
        shade[coarse] = 0.75 + 0.25 * ((grains.group[coarse] * 7919) % 13) / 12
    return (np.where(coarse[:, None], GRAIN, MORTAR) * shade[:, None]).astype(np.uint8)


def expected_travel(simulation: FluidSimulation) -> float:
    """Of the piston [m]; a run until steady takes some hundredths of a second."""
    duration = simulation.scene.duration
    return simulation.scene.velocity * (0.05 if duration is None else duration)


def view(simulation: FluidSimulation, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """A place for the eye and the point to look at, both (3,) [m]: the whole way of the column."""
    size = simulation.state.layout.height + expected_travel(simulation)
    centre = np.array([0.0, 0.0, 0.5 * size])
    aside = 0.0 if simulation.scene.dimensions == 2 else 0.25
    return centre + distance * max(size, 4 * simulation.scene.radius) * np.array([aside, -1.0, 0.1 * aside]), centre


def wall(simulation: FluidSimulation) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of the pipe, or of the two planes."""
    scene = simulation.scene
    length = simulation.state.layout.height * 1.1 + expected_travel(simulation)
    if scene.dimensions == 3:
        return Axis((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (Line(length),)).tube(scene.radius, 48)
    deep = 2 * simulation.state.layout.spacing
    corners = [(s * scene.radius, y, z) for s in (-1, 1) for y in (-deep, deep) for z in (0.0, length)]
    faces = [(4 * k + a, 4 * k + b, 4 * k + c) for k in (0, 1) for a, b, c in ((0, 1, 2), (1, 3, 2))]
    return np.array(corners), np.array(faces)


class FluidRerunRecorder(RerunRecorder):
    """Particles, pressure on the piston and slip velocity on one timeline; parameters as :class:`RerunRecorder`."""

    COLOURINGS = COLOURINGS

    def _limit(self, simulation: Any) -> float:
        return 1.0

    def _describe(self, simulation: Any) -> None:
        rr, recording = self._rr, self._recording
        recording.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        radius = np.full(simulation.state.count, 0.5 * simulation.state.layout.spacing, np.float32)
        recording.log("scene/concrete", rr.Points3D.from_fields(radii=radius), static=True)
        vertices, faces = wall(simulation)
        recording.log(
            "scene/pipe",
            rr.Mesh3D(vertex_positions=vertices, triangle_indices=faces, albedo_factor=(150, 165, 180, 40)),
            static=True,
        )
        for path, name in (
            ("pressure/piston", "piston pressure [kPa]"), ("pressure/theory", "theory"),
            ("slip/layer", "slip velocity [cm/s]"), ("slip/theory", "theory"),
        ):  # fmt: skip
            colour = [150, 150, 150] if name == "theory" else [215, 95, 30]
            recording.log(path, rr.SeriesLines(names=name, colors=colour), static=True)

    def sample(self, simulation: Any, row: dict[str, float]) -> None:
        """Scalars of one row."""
        rr, recording, theory = self._rr, self._recording, simulation.flow.theory
        self._set_time(simulation)
        for path, value in (
            ("pressure/piston", row["pressure"] / 1e3), ("pressure/theory", theory.pressure / 1e3),
            ("slip/layer", 100 * row["slip_velocity"]), ("slip/theory", 100 * theory.slip_velocity),
        ):  # fmt: skip
            recording.log(path, rr.Scalars(value))

    def frame(self, simulation: Any) -> None:
        """All particles."""
        self._set_time(simulation)
        self._recording.log(
            "scene/concrete",
            self._rr.Points3D.from_fields(positions=places(simulation), colors=tint(simulation, self.colouring)),
        )

    def _blueprint(self, simulation: Any):
        import rerun.blueprint as rrb

        eye, target = view(simulation, 1.1)
        scene = rrb.Spatial3DView(
            name=f"Concrete by {self.colouring}",
            origin="scene",
            eye_controls=rrb.EyeControls3D(position=eye, look_target=target, eye_up=(0, 0, 1)),
            line_grid=rrb.LineGrid3D(visible=False),
            background=(250, 250, 250),
        )
        plots = rrb.Vertical(
            rrb.TimeSeriesView(name="Pressure on the piston", origin="pressure"),
            rrb.TimeSeriesView(name="Slip velocity", origin="slip"),
        )
        return rrb.Blueprint(rrb.Horizontal(scene, plots, column_shares=[2, 1]), collapse_panels=True)


class FluidUsdRecorder(UsdRecorder):
    """Writes scene.usdc with the particles as USD points; otherwise as :class:`UsdRecorder`."""

    def _build(self, simulation: Any, stage) -> None:
        from pxr import Gf, UsdGeom, Vt

        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        stage.SetTimeCodesPerSecond(FRAMES_PER_SECOND)
        stage.SetFramesPerSecond(round(1 / simulation.frame_interval) or 1)
        root = UsdGeom.Xform.Define(stage, "/Run")
        stage.SetDefaultPrim(root.GetPrim())
        points = UsdGeom.Points.Define(stage, "/Run/Concrete")
        self._points = points
        count = simulation.state.count
        points.CreateWidthsAttr(Vt.FloatArray.FromNumpy(np.full(count, simulation.state.layout.spacing, np.float32)))
        points.CreateIdsAttr(Vt.Int64Array.FromNumpy(np.arange(count, dtype=np.int64)))
        self._colour = points.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
        vertices, faces = wall(simulation)
        mesh = UsdGeom.Mesh.Define(stage, "/Run/Walls/Pipe")
        corners = vertices.astype(np.float32)
        mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(corners))
        mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
        mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.astype(np.int32).ravel()))
        mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        mesh.CreateDoubleSidedAttr(True)
        mesh.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(np.stack([corners.min(0), corners.max(0)])))
        mesh.CreateDisplayColorAttr([Gf.Vec3f(0.59, 0.65, 0.7)])
        mesh.CreateDisplayOpacityAttr([0.15])
        eye, target = view(simulation, 1.7)
        camera = UsdGeom.Camera.Define(stage, "/Run/Camera")
        look = Gf.Matrix4d().SetLookAt(Gf.Vec3d(*map(float, eye)), Gf.Vec3d(*map(float, target)), Gf.Vec3d(0, 0, 1))
        camera.ClearXformOpOrder()
        camera.AddTransformOp().Set(look.GetInverse())
        camera.CreateFocalLengthAttr(22.0)
        distance = float(np.linalg.norm(eye - target))
        camera.CreateClippingRangeAttr(Gf.Vec2f(0.01 * distance, 100 * distance))

    def frame(self, simulation: Any) -> None:
        """One time sample of all particles."""
        from pxr import Usd, Vt

        code = Usd.TimeCode(simulation.stepper.time * FRAMES_PER_SECOND)
        self._first = code.GetValue() if self._first is None else self._first
        self._last = code.GetValue()
        place = places(simulation).astype(np.float32)
        self._points.CreatePointsAttr().Set(Vt.Vec3fArray.FromNumpy(place), code)
        half = np.float32(0.5 * simulation.state.layout.spacing)
        extent = np.stack([place.min(0) - half, place.max(0) + half])
        self._points.CreateExtentAttr().Set(Vt.Vec3fArray.FromNumpy(extent), code)
        shades = tint(simulation, self.colouring).astype(np.float32) / 255
        self._colour.Set(Vt.Vec3fArray.FromNumpy(shades), code)


def plot_flow(run: Run, particles: tuple[np.ndarray, np.ndarray, float] | None = None):
    """Matplotlib figure: pressure against time, velocity profiles, both beside theory; `particles` (places, RGB
    bytes, spacing) are drawn beside them.
    """
    from matplotlib.collections import EllipseCollection
    from matplotlib.figure import Figure

    result, scene = run.result, run.scene
    figure = Figure(figsize=(9.5 if particles is not None else 7.5, 4.2), layout="constrained")
    ratios = [1.25, 1.25, 0.75] if particles is not None else [1, 1]
    axes = figure.subplots(1, len(ratios), width_ratios=ratios)
    axes[0].plot(run.series["time"], run.series["pressure"] / 1e3, linewidth=1.6, label="this run")
    axes[0].axhline(result["pressure_theory"]["value"] / 1e3, color="0.4", linestyle=":", label="theory")
    printed = scene.notes.get("paper", {})
    if "pressure" in printed:
        axes[0].axhline(
            printed["pressure"] / 1e3, color="k", linestyle="--", linewidth=0.8, label="printed (Xu et al.)"
        )
    axes[0].set(xlabel="time [s]", ylabel="pressure on the piston [kPa]")
    # The start is far below and of no interest.
    shown = np.append(run.series["pressure"][2:] / 1e3, result["pressure_theory"]["value"] / 1e3)
    lowest, highest = np.nanmin(shown), np.nanmax(shown)
    if np.isfinite(lowest + highest):
        margin = max(0.2 * (highest - lowest), 0.05 * abs(highest), 1e-9)
        axes[0].set_ylim(lowest - margin, highest + margin)
    axes[0].legend(frameon=False, fontsize=8)
    for part in result["profiles"]:
        axes[1].plot(
            100 * np.array(part["radius"]["value"]), 100 * np.array(part["velocity"]["value"]), ".", markersize=5,
            label=f"{100 * part['height']['value']:.0f} cm above the piston",
        )  # fmt: skip
    radius = np.linspace(0, scene.radius, 200)
    theory = velocity(scene.concrete, scene.line, scene.theory(), radius)
    axes[1].plot(100 * radius, 100 * theory, color="0.4", linestyle=":", label="theory")
    axes[1].set(xlabel="distance from the middle [cm]", ylabel="velocity [cm/s]")
    axes[1].legend(frameon=False, fontsize=8)
    for one in axes[:2]:
        one.spines[["top", "right"]].set_visible(False)
    if particles is not None:
        place, shades, spacing = particles
        order = np.argsort(-place[:, 1])
        width = np.full(len(place), spacing)
        axes[2].add_collection(
            EllipseCollection(
                width,
                width,
                np.zeros(len(place)),
                units="xy",
                offsets=place[order][:, [0, 2]],
                offset_transform=axes[2].transData,
                facecolors=shades[order] / 255,
                edgecolors="none",
            )
        )
        axes[2].set(aspect="equal", xlabel="x [m]", ylabel="z [m]")
        axes[2].autoscale_view()
    return figure


class FlowPlotRecorder(Recorder):
    """Writes flow.png when the run ends."""

    def __init__(self, path: Path, colouring: str = "speed") -> None:
        self.path, self.colouring = path, colouring

    def finish(self, simulation: Any, run: Run) -> None:
        """Draw, if there is more than the start."""
        if "profiles" not in run.result:
            return
        shown = places(simulation), tint(simulation, self.colouring), simulation.state.layout.spacing
        partial = self.path.with_name(self.path.name + ".partial")
        plot_flow(run, shown).savefig(partial, dpi=150, format="png")
        partial.replace(self.path)
