"""Scenes of a part of a pump line that is full of concrete, which flows through it at a stated rate."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated, Any, ClassVar

import numpy as np

from ...core.device.device import PRECISIONS
from ...core.drawing.html import Parametrised
from ...core.drawing.style import pumping_caption
from ...core.errors import at_least, at_most, between, positive, refuse
from ...core.inputs.parameters import Above, Declared, OneOf, Within
from ...geometry.axis import Arc, Axis, Line
from ...geometry.bores import Bores
from ...geometry.inner_surface import InnerSurface, equal_radii
from ...geometry.walls import MeshWall
from ...theory.pipe import Concrete, Steady, steady
from ...theory.pipe import Line as Stretch
from ..common.settings import STEP_ERROR, MaximumIterations, PressureTolerance, check_interval
from .symmetry import Orientation, orientation

NARROW_CELLS = 11
"""Minimum number of cells across the narrowest section for which the friction computed in this section deviates little
from theory. In a cone from 100 to 80 mm, it deviated by 3.4 % with 8 cells, and by 1.2 % with 11."""
MIN_ACROSS = 6
"""Minimum number of cells across the narrowest bore; a part with fewer cells is refused."""
CLEARANCE, MIN_CELLS_LEFT = 1.0, 4
"""Limits for the measurement of friction in straight pipes. CLEARANCE is the length that is left out at both ends of a
straight pipe, divided by its radius. MIN_CELLS_LEFT is the minimum length of the stretch between them, in cells."""
ROUNDNESS_TOLERANCE = 0.03
"""Maximum relative deviation of a mesh's radius, around the axis, from the radius of a circle of equal area. With
larger deviations, theory of round pipes is not applied."""
AXIS_SAMPLES = 60
"""Number of points along the pipe's axis at which the bore inside a mesh is measured."""
FLATNESS = 0.01
"""Largest distance by which the axis of a mesh may be moved into one plane, divided by the radius of the bore."""
SIMULATED_WHOLE = ", so the whole pipe is simulated"
"""End of the remark that is shown if a part lacks the symmetry that the parameter `symmetry` requires."""


@dataclass(frozen=True, kw_only=True)
class PartSettings(Declared):
    """Settings of the simulation of a flow through a part of a pump line."""

    common: ClassVar[tuple[str, ...]] = ("duration",)

    duration: Annotated[
        float, "Longest simulated time [s]; the run ends earlier when the pressure is steady", Above()
    ] = 2.0
    time_step: Annotated[
        float, "Longest time step [s]; if step_error is 0, all time steps have this length", Above()
    ] = 5e-3
    step_error: Annotated[float, STEP_ERROR, Within(0, 0.5)] = 0.0
    gravity: Annotated[float, "Gravitational acceleration [m/s2]", Within(0, 1e4)] = 9.81
    regularisation: Annotated[float, "Parameter beta of the regularised flow law [s]", Above()] = 100.0
    tolerance: PressureTolerance = 1e-3
    maximum_iterations: MaximumIterations = 5000
    symmetry: Annotated[
        str,
        "Simulate half of the pipe, on one side of the plane in which its axis lies, or the whole pipe; with half, "
        "no aggregate crosses this plane of symmetry. A pipe without such a plane is always simulated as a whole",
        OneOf(("half", "whole")),
    ] = "half"
    steadiness: Annotated[
        float,
        "The flow counts as steady if the relative change of the pressure was smaller than this value in the last ten "
        "steps and in the ten steps before",
        Above(),
    ] = 1e-3
    precision: Annotated[str, "Precision: float32 or float64", OneOf(PRECISIONS)] = "float32"
    sample_interval: Annotated[float, "Simulated time between two rows of the time series [s]", Above()] = 0.02
    seed: Annotated[int, "Random seed of the places and sizes of aggregates; nothing else is random", Within(0)] = 0


@dataclass(frozen=True)
class Section:
    """Section of a part of a pump line, such as a bend or a taper, between two arc lengths of the axis."""

    kind: str
    """Kind of the section, such as "straight", "bend" or "taper"."""
    begin: float
    """Arc length at which the section begins [m]."""
    end: float
    """Arc length at which the section ends [m]."""
    called: str = ""
    """Description of the section; if empty, its kind is used."""

    @property
    def straight(self) -> bool:
        """True if this section is straight pipe of constant bore."""
        return self.kind == "straight"

    @property
    def label(self) -> str:
        """Short description of this section, such as its kind."""
        return self.called or self.kind


@dataclass(frozen=True, kw_only=True, repr=False)
class PartScene(Parametrised, PartSettings):
    """Part of a pump line, in which concrete enters at the start and leaves at the end; SI units, z points upwards."""

    has_heavy_aggregates: ClassVar[bool] = False
    """True if the concrete has aggregates that settle, so that a plane of symmetry must be vertical."""
    name: str
    concrete: Concrete
    axis: Axis
    """Axis of the pipe; its first and last pieces are straight."""
    bores: Bores
    """Inner radii of the round pipe as a function of the arc length; they change only where the axis is straight."""
    flow: float
    """Volume flow of the concrete through the part [m3/s]."""
    spacing: float
    """Requested cell width [m]. The simulation uses the nearest width that divides the pipe's radius at the start of
    the part into whole cells."""
    parts: tuple[Section, ...] = ()
    """Sections whose losses are reported; if empty, they are derived from `axis` and `bores`."""
    wall: MeshWall | None = None
    """Triangle mesh whose inner surface, as seen from the axis (:class:`InnerSurface`), is the bore; None for a round
    pipe."""
    insert: tuple[float, float] | None = None
    """Arc lengths [m] at which a mesh that is shorter than the part begins and ends.

    Upstream and downstream of the mesh, the bore has the cross-section of the nearer end of the mesh. None means that
    the mesh is as long as the part.
    """
    published: Mapping[str, float] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of the function that created this scene, stored so that it can be created again; empty if there is no
    such function."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.wall is not None:
            object.__setattr__(self, "axis", self.axis.flattened(FLATNESS * self.radius))
        for name in ("flow", "spacing"):
            positive(name, getattr(self, name), "m3/s" if name == "flow" else "m")
        pieces = self.axis.pieces
        if isinstance(pieces[0], Arc) or isinstance(pieces[-1], Arc):
            refuse("axis", pieces, "must begin and end with a straight piece")
        begin = 0.0
        for piece in pieces:
            wide = self.bores.at([begin, begin + piece.length])
            if isinstance(piece, Arc):
                if piece.radius <= wide.max() and self.wall is not None:
                    refuse("wall", self.wall.name, f"bends too sharply {begin:.3g} m from its start: the bend radius "
                           f"{piece.radius:.3g} m must exceed the radius of the bore, {wide.max():.3g} m",
                           "use a larger bend radius, or a finer mesh, which has more rings of triangles (bands around "
                           "the pipe) along the bend; simulations with discrete elements ('--method dem') accept this "
                           "mesh")  # fmt: skip
                if piece.radius <= wide.max():
                    problem = "must exceed the pipe's radius"
                    refuse("elbow radius", piece.radius, problem, f"use more than {wide.max():g} m")
                hint = "with a larger angle the pipe would cross itself; for a smaller angle, use a straight piece"
                between("angle", piece.angle, 1e-3, 0.75 * np.pi, "rad", hint)
                if np.ptp(wide) > 1e-9 * wide.max():
                    refuse(
                        "bores", wide.tolist(), "must be constant in a bend", "put the taper before or behind the bend"
                    )
            begin += piece.length
        if self.bores.places[-1] > self.axis.length * (1 + 1e-9):
            problem = f"must end before the end of the pipe, which is {self.axis.length:g} m long"
            refuse("taper", self.bores.places[-1], problem)
        object.__setattr__(self, "_bores", self._measured_bores())
        object.__setattr__(self, "_orientation", self._found_orientation())
        least = 2 * self.narrowest
        if self.spacing > least / MIN_ACROSS:
            problem = f"is too coarse: at least {MIN_ACROSS} cells must fit across the narrowest bore, {least:.4g} m"
            hint = f"use {at_most(least / NARROW_CELLS)} m or less; {NARROW_CELLS} cells give an accurate friction"
            refuse("spacing", self.spacing, problem, hint)
        begin, end = self.middle
        for length, at in ((begin, 0.0), (self.axis.length - end, self.axis.length)):
            shortest = (2 if end > begin else 1) * CLEARANCE * float(self.bore(at)) + MIN_CELLS_LEFT * self.spacing
            # Compare with a tolerance for rounding errors, because the lengths of the straight pipes at both ends are
            # differences of arc lengths.
            if length < shortest * (1 - 1e-9):
                remark = "" if end > begin else "; this length is half of the pipe"
                problem = f"is too short to measure the pressure loss of straight pipe{remark}"
                check = ", or check 'wall_scale'" * (self.wall is not None)
                hint = f"use {at_least(shortest)} m or more for this bore of {2 * float(self.bore(at)):.3g} m{check}"
                refuse("straight", length, problem, hint)
        fastest = self.velocity * (2 * self.radius / least) ** 2
        if not self.step_error and self.time_step * fastest > self.spacing:
            refuse("time_step", self.time_step, f"must be shorter, because concrete that flows at {fastest:.3g} m/s "
                                                "passes through more than one cell per step",
                   f"use {at_most(self.spacing / fastest, 2)} s or less")  # fmt: skip
        between("duration", self.duration, self.time_step, np.inf, "s", "simulate at least one time step")
        check_interval(self)

    def _measured_bores(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Return arc lengths [m], and for each the radius of a circle with the bore's area [m]; None without a mesh."""
        object.__setattr__(self, "_inner", None)
        if self.wall is None:
            return None
        span = self.insert or (0.0, self.axis.length)
        inner = InnerSurface(self.wall.vertices, self.wall.faces, self.axis, self.radius, "wall", self.wall.name, span)
        object.__setattr__(self, "_inner", inner)
        s = np.linspace(0.0, self.axis.length, AXIS_SAMPLES)
        reach = inner.sections(s)
        radii = equal_radii(reach)
        begin, end = self.insert or (0.0, 0.0)
        straight = (s <= begin) | (s >= end)
        object.__setattr__(
            self, "_round", bool(np.all(np.abs(reach / radii[:, None] - 1)[straight] < ROUNDNESS_TOLERANCE))
        )
        if abs(radii[0] / self.radius - 1) > 0.1:
            hint = "use this radius, or correct the scale of the mesh (0.001 for a mesh in millimetres)"
            refuse("radius", self.radius, f"must equal the mesh's radius at its start, {radii[0]:.4g} m", hint)
        return s, radii

    def _found_orientation(self) -> Orientation:
        """Return the grid's orientation, and add a remark if the part lacks the symmetry that `symmetry` requires."""
        symmetric = self.symmetry == "half" and self.axis.is_plane
        heavy = symmetric and self.has_heavy_aggregates and self.gravity > 0
        grid_orientation = orientation(
            self.axis, self.inner if symmetric else None, self.radius, self.rounded_spacing, heavy
        )
        remarks = [remark for remark in self.remarks if not remark.endswith(SIMULATED_WHOLE)]
        if grid_orientation.obstacle:
            remarks.append(grid_orientation.obstacle + SIMULATED_WHOLE)
        object.__setattr__(self, "remarks", tuple(remarks))
        return grid_orientation

    @property
    def orientation(self) -> Orientation:
        """Axes of the grid, and the symmetry of the bore about the plane of the pipe's axis."""
        return self._orientation  # type: ignore[attr-defined]

    @property
    def inner(self) -> InnerSurface | None:
        """Inner surface of the mesh; None for a round pipe without a mesh."""
        return getattr(self, "_inner", None)

    def bore(self, s: np.ndarray | float) -> np.ndarray:
        """Return the radius of a circle with the bore's area at arc lengths `s` [m], with the shape of `s`."""
        measured = getattr(self, "_bores", None)
        if measured is not None:
            return np.asarray(np.interp(s, *measured))
        return self.bores.at(s)

    @property
    def radius(self) -> float:
        """Inner radius of the round pipe at the start of the part [m]."""
        return float(self.bores.at(0.0))

    @property
    def narrowest(self) -> float:
        """Smallest radius of the bore [m]."""
        return self.bores.smallest if self.wall is None else float(np.min(self.bore(self._sampled_lengths)))

    @property
    def widest(self) -> float:
        """Largest radius of the bore [m]."""
        return self.bores.largest if self.wall is None else float(np.max(self.bore(self._sampled_lengths)))

    @property
    def _sampled_lengths(self) -> np.ndarray:
        return np.linspace(0, self.axis.length, 50)

    @property
    def is_half(self) -> bool:
        """True if only one half of the part is simulated, because the part has a plane of symmetry."""
        return self.symmetry == "half" and self.axis.is_plane and not self.orientation.obstacle

    @property
    def rounded_spacing(self) -> float:
        """Width of the cells [m]; the pipe's radius at the start of the part is a multiple of this width."""
        return self.radius / max(3, round(self.radius / self.spacing))

    @property
    def simulated_share(self) -> float:
        """Fraction of each cross-section that is simulated: 0.5 if a plane of symmetry halves the part, else 1."""
        return 0.5 if self.is_half else 1.0

    @property
    def caption(self) -> str:
        """Text with scene, diameter, concrete and flow, for titles of figures and recordings."""
        unit = self.parameters.get("line") or self.parameters.get("unit") or ""
        return pumping_caption(f"{self.name} {unit}".strip(), self.radius, self.concrete.name, self.flow)

    @property
    def velocity(self) -> float:
        """Mean velocity over the cross-section at the start of the part [m/s]."""
        return self.flow / (np.pi * float(self.bore(0.0)) ** 2)

    @property
    def is_round(self) -> bool:
        """True if the straight pipes of the part are round, so that the theory of round pipes applies to them."""
        return getattr(self, "_round", True)

    @property
    def middle(self) -> tuple[float, float]:
        """Arc lengths [m] between which this part of the pump line bends or changes its bore.

        The range extends from the first to the last bend or taper. Without bends and tapers, the range is the stretch
        in which the bore of the part's triangle mesh changes its radius. In a straight pipe of constant bore, both
        values are half the length of the part.
        """
        half = 0.5 * self.axis.length
        measured = getattr(self, "_bores", None)
        ends = [place for part in self.sections if not part.straight for place in (part.begin, part.end)]
        if ends:
            return min(ends), max(ends)
        if measured is not None and np.ptp(measured[1]) > 0.03 * self.radius:
            s, radii = measured
            step, off = s[1] - s[0], 0.01 * self.radius
            begin = s[np.abs(radii - radii[0]) > off].min() - step
            end = s[np.abs(radii - radii[-1]) > off].max() + step
            return float(begin), float(end)
        return half, half

    @property
    def sections(self) -> tuple[Section, ...]:
        """All sections of the part in order, from start to end: straight pipes, bends, tapers and so on."""
        if self.parts:
            return self.parts
        sections, begin = [], 0.0
        for piece in self.axis.pieces:
            end = begin + piece.length
            if isinstance(piece, Arc):
                sections.append(Section("bend", begin, end))
            else:
                sections += self._straights(begin, end)
            begin = end
        return tuple(sections)

    def _straights(self, begin: float, end: float) -> Iterator[Section]:
        """Yield the sections between two arc lengths [m] on a straight piece of the axis.

        A section is a straight pipe, a taper, or the stretch in which a mesh replaces the round pipe.
        """
        odd = [("bore", *self.insert)] if self.insert is not None else []
        if self.wall is None:
            places, radii = self.bores.places, self.bores.radii
            odd = [("taper", places[k], places[k + 1]) for k in range(len(places) - 1) if radii[k] != radii[k + 1]]
        for name, low, high in odd:
            if not begin <= low < end:
                continue
            if low > begin:
                yield Section("straight", begin, low)
            yield Section(name, low, high)
            begin = high
        if end > begin:
            yield Section("straight", begin, end)

    @property
    def rise(self) -> float:
        """Height of the end of the part above its start [m]."""
        ends, _ = self.axis.at([0.0, self.axis.length])
        return float(ends[1, 2] - ends[0, 2])

    @property
    def density(self) -> float:
        """Density of the concrete with its aggregates [kg/m3]."""
        return self.concrete.density

    def weight(self, s: np.ndarray) -> np.ndarray:
        """Return the hydrostatic pressure of the concrete from arc lengths `s` [m] to the end [Pa], shape as `s`."""
        height = self.axis.at(np.append(s, self.axis.length))[0][:, 2]
        return self.density * self.gravity * (height[-1] - height[:-1])

    def theory(self, s: float) -> Steady:
        """Return the steady state in one metre of straight, level pipe with the bore's radius at arc length `s` [m]."""
        line = Stretch(radius=float(self.bore(s)), length=1.0, gravity=0.0)
        return steady(self.concrete, line, self.flow)

    def friction_loss(self, begin: float, end: float) -> float:
        """Return the frictional loss by theory between two arc lengths [Pa], as the sum over short straight pipes."""
        inner = [place for place in self.bores.places if begin < place < end] if self.wall is None else []
        return sum(self._uniform_loss(*stretch) for stretch in pairwise([begin, *inner, end]))

    def _uniform_loss(self, begin: float, end: float) -> float:
        """Return the frictional loss by theory between two arc lengths [Pa]. No taper may begin or end between them."""
        edges = np.linspace(begin, end, 41)
        middles = 0.5 * (edges[1:] + edges[:-1])
        if np.ptp(self.bore(edges)) < 1e-9:
            return self.theory(begin).pressure * (end - begin)
        return float(sum(self.theory(s).pressure for s in middles) * (end - begin) / len(middles))

    def __repr__(self) -> str:
        shape = ", ".join(
            f"{piece.length:g} m" if isinstance(piece, Line) else f"{np.degrees(piece.angle):.0f} degrees"
            for piece in self.axis.pieces
        )
        return (
            f"<PartScene {self.name!r}: {self.concrete.words}, R = {self.radius:g} m, {shape}, "
            f"{self.velocity:.4g} m/s, spacing {self.spacing:g} m>"
        )
