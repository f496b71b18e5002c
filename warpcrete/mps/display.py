"""Display of pipe flows for recorders: particles, walls, curves and profiles."""

from typing import ClassVar

import numpy as np

from ..core.drawing.display import GLASS, Curve, DrawnWall, Plot, Points, Profile
from ..core.drawing.paint import palette_colours
from ..core.drawing.style import RUN, THEORY
from ..geometry.axis import Axis, Line
from ..theory.pipe import velocity
from .common.display import FlowRunDisplay
from .probes import MIDDLE, Snapshot, over_radius

GRAIN = np.array([120, 118, 112], np.uint8)
MORTAR = np.array([214, 204, 184], np.uint8)
GOLDEN_ANGLE = np.pi * (3 - 5**0.5)
"""Golden angle [rad]. In drawings of axisymmetric flows, each particle is turned about the axis by this angle relative
to the previous particle, so that the particles do not lie in one plane."""


class FlowDisplay(FlowRunDisplay):
    """Display of a pipe flow, with the particles coloured by speed, by pressure, or by phase (grains or mortar)."""

    colourings: ClassVar = ("speed", "pressure", "phase")
    noun: ClassVar = "concrete"

    @property
    def preferred(self) -> str:
        """Default colouring of the particles."""
        return "speed" if self.simulation.scene.aggregates is None else "phase"

    @property
    def pressure_label(self) -> str:
        """Label under which figures show the pressure that drives the flow."""
        return "pressure on the piston" if self.simulation.scene.ends == "piston" else "pressure over the stretch"

    @property
    def direction(self) -> tuple[float, float, float]:  # type: ignore[override]
        """Direction from the flow to the viewer: -y for a channel; for a tube, -y turned slightly towards +x and +z."""
        aside = 0.0 if self.simulation.scene.dimensions == 2 else 0.25
        return aside, -1.0, 0.1 * aside

    def radii(self) -> np.ndarray:
        """Return the radii of the drawn particles [m], which are half the particle spacing, shape (n,)."""
        return np.full(self.simulation.state.count, 0.5 * self.simulation.state.particle_spacing, np.float32)

    def centres(self) -> np.ndarray:
        """Return the positions of the particles [m], shape (n, 3): z is up, a channel lies in the plane y = 0."""
        x = self.read("particles.position").astype(float)
        x[:, -1] += self.simulation.scene.velocity * self.time
        if self.simulation.scene.dimensions == 2:
            return np.insert(x, 1, 0.0, axis=1)
        if x.shape[1] == 2:
            # An axisymmetric flow has only radius and height as coordinates. Draw each particle at a different
            # angle about the axis.
            angle = GOLDEN_ANGLE * np.arange(len(x))
            return np.stack([x[:, 0] * np.cos(angle), x[:, 0] * np.sin(angle), x[:, 1]], 1)
        return x

    def scale(self) -> tuple[str, float, float] | None:
        """Return label, lowest and highest value of the quantity that colours show; None if colours show materials."""
        scene, theory = self.simulation.scene, self.simulation.scene.theory()
        if self.colouring == "pressure":
            return "pressure [kPa]", 0.0, theory.pressure / 1e3
        if self.colouring == "speed":
            centre = float(velocity(scene.concrete, scene.line, theory, [0.0])[0])
            return "velocity [cm/s]", 100 * theory.slip_velocity, 100 * centre
        return None

    def categories(self) -> dict[str, np.ndarray]:
        """Return the colours of grains and mortar by name; the dictionary is empty if the colours show a quantity."""
        return {"coarse aggregate": GRAIN, "mortar": MORTAR} if self.scale() is None else {}

    def _snapshot(self) -> Snapshot:
        return self.snapshot_value("particles", lambda: Snapshot.of(self.flow))

    def fields(self) -> dict[str, np.ndarray]:
        """Return velocity along the pipe [m/s] and pressure [Pa] of all particles."""
        return {"velocity": self._snapshot().velocity, "pressure": self._snapshot().pressure}

    def colours(self) -> np.ndarray:
        snap = self._snapshot()
        scale = self.scale()
        if scale is not None:
            _, lower, upper = scale
            return palette_colours(
                snap.pressure / 1e3 if self.colouring == "pressure" else 100 * snap.velocity, upper, lower
            )
        grains = self.simulation.state.grains
        coarse = np.zeros(len(snap.height), bool) if grains is None else grains.group >= 0
        shade = np.ones(len(coarse))
        if grains is not None:  # Give neighbouring grains different shades, so that they can be told apart.
            shade[coarse] = 0.75 + 0.25 * ((grains.group[coarse] * 7919) % 13) / 12
        return (np.where(coarse[:, None], GRAIN, MORTAR) * shade[:, None]).astype(np.uint8)

    def plots(self) -> tuple[Plot, ...]:
        """Return plots over time of driving pressure and slip velocity, each with the value that theory predicts."""
        theory = self.simulation.scene.theory()
        return (
            Plot("pressure", self.pressure_label.capitalize(), (
                Curve("piston", f"{self.pressure_label} [kPa]", lambda row: row["pressure"] / 1e3, RUN),
                Curve("theory", "theory", lambda row: theory.pressure / 1e3, THEORY),
            )),
            Plot("slip", "Slip velocity", (
                Curve("layer", "slip velocity [cm/s]", lambda row: 100 * row["slip_velocity"], RUN),
                Curve("theory", "theory", lambda row: 100 * theory.slip_velocity, THEORY),
            )),
        )  # fmt: skip

    def profiles(self) -> tuple[Profile, ...]:
        """Return a plot of the velocity profile at mid-height of the column, with the profile that theory predicts."""
        place = "distance from the middle" if self.simulation.scene.dimensions == 2 else "radius"
        title = f"Velocity [cm/s] over {place} [mm]"
        return (Profile("velocity", title, (
            Points("this run", self._velocities, RUN), Points("theory", self._expected, THEORY),
        )),)  # fmt: skip

    def _velocities(self) -> tuple[np.ndarray, np.ndarray]:
        snap, layout, radius = self._snapshot(), self.simulation.state.layout, self.simulation.scene.radius
        part = snap.height / layout.height
        middle = (part > MIDDLE[0]) & (part < MIDDLE[1])
        bins = max(2, round(radius / layout.spacing))
        place, mean = over_radius(snap.distance[middle], snap.velocity[middle], radius, bins)
        return 1e3 * place, 100 * mean

    def _expected(self) -> tuple[np.ndarray, np.ndarray]:
        scene = self.simulation.scene
        place = self._velocities()[0]
        bulk = np.minimum(1e-3 * place, scene.radius - scene.line.slip_thickness)
        return place, 100 * velocity(scene.concrete, scene.line, scene.theory(), bulk)

    @property
    def cut(self) -> float | None:
        """Coordinate y [m] of the plane through a tube's axis where the tube is cut open; None for a channel."""
        return None if self.simulation.scene.dimensions == 2 else 0.0

    def walls(self) -> list[DrawnWall]:
        """Return the pipe, or the two planes of a channel, as drawn walls."""
        scene, spacing = self.simulation.scene, self.simulation.state.layout.spacing
        length = self.simulation.state.layout.height * 1.1 + self._travel()
        if scene.dimensions == 3:
            vertices, faces = Axis((0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (Line(length),)).tube(scene.radius, 48)
        else:
            deep = 2 * spacing
            corners = [(s * scene.radius, y, z) for s in (-1, 1) for y in (-deep, deep) for z in (0.0, length)]
            faces = np.array([(4 * k + a, 4 * k + b, 4 * k + c) for k in (0, 1) for a, b, c in ((0, 1, 2), (1, 3, 2))])
            vertices = np.array(corners)
        return [DrawnWall("pipe", vertices, faces, False, GLASS)]

    def _travel(self) -> float:
        """Return the distance by which the piston is expected to move during the run [m].

        If the scene states no duration, 0.05 s are assumed, in which a flow usually becomes steady.
        """
        duration = self.simulation.scene.duration
        return self.simulation.scene.velocity * (0.05 if duration is None else duration)

    def bounds(self) -> np.ndarray:
        """Return the lowest and highest corner of the space that the concrete passes through [m], shape (2, 3)."""
        size = self.simulation.state.layout.height + self._travel()
        # A picture shows the whole box between the two corners, and is as wide as this box is high. The box of a short
        # column is therefore made higher than the column, so that the pipe fits into the picture.
        across = max(0.0, 4 * self.simulation.scene.radius - size)
        return np.array([[0.0, 0.0, -0.5 * across], [0.0, 0.0, size + 0.5 * across]])
