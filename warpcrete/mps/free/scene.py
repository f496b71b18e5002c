"""Scenes of concrete with a free surface in a vessel. A gate may hold the concrete back until it is lifted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, ClassVar

import numpy as np

from ...core.device.device import PRECISIONS
from ...core.drawing.html import Parametrised
from ...core.errors import at_most, between, one_of, positive, refuse
from ...core.inputs.parameters import Above, Declared, OneOf, Within
from ...core.records import SceneArguments
from ...geometry.walls import Wall
from ...standards import StandardTest
from ...theory.pipe import Concrete
from ..common.mixes import ConcreteParameters
from ..common.settings import STEP_ERROR, MaximumIterations, PressureTolerance, check_interval
from ..grid.geometry import MIRROR, OPEN_SIDE, WALL

SIDES = (("left", "right"), ("front", "back"), ("bottom", "top"))
"""Names of the lower and upper sides of the simulated space along each axis."""
REST_SPEED = (
    "Speed threshold of rest [m/s]: concrete is at rest if all of it (in an L-box, 90 % of it) has been slower for "
    "one second"
)
Points = tuple[tuple[float, float], ...]
"""Corners of a polygon [m], each with its horizontal coordinate (or radius) and its height."""


@dataclass(frozen=True, kw_only=True)
class FreeSettings(Declared):
    """Settings of the simulation of a free-surface flow."""

    common: ClassVar[tuple[str, ...]] = ("duration",)

    duration: Annotated[
        float, "Longest simulated time [s]; the run ends earlier when the concrete is at rest", Above()
    ] = 60.0
    rest_speed: Annotated[float, REST_SPEED, Above()] = 2e-4
    time_step: Annotated[
        float, "Longest time step [s]; if step_error is 0, all time steps have this length", Above()
    ] = 2e-2
    step_error: Annotated[float, STEP_ERROR, Within(0, 0.5)] = 1e-3
    gravity: Annotated[float, "Gravitational acceleration [m/s2]", Above()] = 9.81
    regularisation: Annotated[
        float,
        "Parameter beta of the regularised flow law [s]; concrete below the yield stress creeps at a rate of 1/beta",
        Above(),
    ] = 1e5
    tolerance: PressureTolerance = 1e-3
    maximum_iterations: MaximumIterations = 5000
    precision: Annotated[str, "Precision: float32 or float64", OneOf(PRECISIONS)] = "float32"
    sample_interval: Annotated[float, "Simulated time between two rows of the time series [s]", Above()] = 0.02
    seed: Annotated[int, "Random seed of the places and sizes of aggregates; nothing else is random", Within(0)] = 0


@dataclass(frozen=True, kw_only=True, repr=False)
class FreeScene(Parametrised, FreeSettings):
    """Concrete in a vessel: an axisymmetric, plane or three-dimensional flow with a free surface; SI units.

    Each polygon is the vertical cross-section of a body. The body extends through the whole depth of the simulated
    space, or is a body of revolution if the flow is axisymmetric or if `round` is true.
    """

    name: str
    test: StandardTest | None = None
    """Standard test whose results are measured; None without a test."""
    concrete: Concrete
    axial: bool
    """True for an axisymmetric flow about x = 0. False for a plane flow (per metre of depth) or in three dimensions."""
    width: float
    """Width of the simulated space, which is a box around the vessel [m]."""
    height: float
    """Height of the simulated space [m]."""
    spacing: float
    """Requested cell width [m]. The simulation uses the nearest width that divides `width` into whole cells."""
    outline: Points
    """Polygon whose interior the concrete fills at the start, except for the parts inside walls."""
    depth: float = 0.0
    """Depth of the simulated space [m]; 0 for a plane or an axisymmetric flow."""
    round: bool = False
    """True if the polygons of a three-dimensional flow are vertical cross-sections of bodies of revolution about the
    axis x = y = 0."""
    blocks: tuple[Points, ...] = ()
    """Polygons that are the vertical cross-sections of walls at rest."""
    walls: tuple[Wall, ...] = ()
    """Three-dimensional walls at rest. Concrete is on the side of a wall's closed mesh on which the point `amid`
    lies."""
    amid: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Point [m] where concrete may be; it tells which side of each closed mesh is open to the concrete."""
    sides: Mapping[str, str] = field(default_factory=dict)
    """Kind of each side of the simulated space, by the names in SIDES.

    A side is a "wall", a "mirror" (plane of symmetry) or "open" (concrete that reaches it is removed). Sides without
    an entry are walls, with two exceptions: the top is open, and the left side of an axisymmetric flow is the axis.
    """
    gate: Points = ()
    """Polygon of the gate or mould that is lifted; empty if nothing holds the concrete back."""
    lift_speed: float = 0.0
    """Speed at which the gate is lifted [m/s]."""
    plate_slips: bool = False
    """True if concrete slips on the sides of the simulated box; False if it sticks to them."""
    walls_slip: bool = False
    """True if the concrete slips on blocks and walls with its slip layer; otherwise it sticks to them."""
    dimensions: Mapping[str, float] = field(default_factory=dict)
    """Dimensions of the vessel that are needed to compute the results of the standard test, by name [m]."""
    published: Mapping[str, float] = field(default_factory=dict)
    """Published values of result quantities, in SI units."""
    remarks: tuple[str, ...] = ()
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of the function that created this scene, stored so that it can be created again; empty if there is no
    such function."""

    @property
    def whole_concrete(self) -> Concrete:
        """Concrete including its aggregates, for closed forms. In this class, it is the simulated fluid itself."""
        return self.concrete

    @property
    def fluid(self) -> FreeScene:
        """The scene without aggregates that are simulated one by one; in this class, the scene itself."""
        return self

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("width", "height", "spacing"):
            positive(name, getattr(self, name), "m")
        between("depth", self.depth, 0, np.inf, "m")
        if self.axial and self.depth:
            problem = "must be 0 for an axisymmetric flow, because only a three-dimensional flow has a depth"
            refuse("depth", self.depth, problem, "use 0")
        if self.round and not self.depth:
            hint = "set 'depth' to the value of 'width', or use 'axial' for an axisymmetric flow"
            refuse("round", self.round, "needs a three-dimensional flow, but 'depth' is 0", hint)
        if self.walls and not self.depth:
            problem = "must be empty for a plane or an axisymmetric flow"
            refuse("walls", f"{len(self.walls)}", problem, "set 'depth' above 0, or use 'blocks' instead")
        for name, kind in self.sides.items():
            one_of("sides", name, [side for pair in SIDES for side in pair])
            one_of(f"sides[{name}]", kind, (WALL, MIRROR, OPEN_SIDE))
            if name in SIDES[1] and not self.depth:
                problem = "exists only in a three-dimensional flow"
                refuse("sides", name, problem, f"set 'depth' above 0, or leave out {name!r}")
            if name == "left" and self.axial:
                problem = "is the axis of an axisymmetric flow, whose kind cannot be chosen"
                refuse("sides", name, problem, f"leave out {name!r}")
        for name in ("outline", "gate", *(f"blocks[{n}]" for n in range(len(self.blocks)))):
            points = self.blocks[int(name[7:-1])] if name.startswith("blocks") else getattr(self, name)
            if name == "gate" and not points:
                continue
            corners = np.array(points, dtype=float)
            if corners.ndim != 2 or corners.shape[0] < 3 or corners.shape[1] != 2 or not np.isfinite(corners).all():
                problem = "must be three or more corners, each of two finite numbers [m]"
                refuse(name, points, problem, "list the corners in the order in which they follow each other")
        if self.test:
            self.test.check_dimensions(self.dimensions)
            if self.test.in_space and not self.depth:
                refuse(
                    "depth", self.depth, f"must be above 0 for test {self.test.name!r}", "use half of the box's width"
                )
        if np.any(np.ptp(self.extent, axis=0) <= 0):
            problem = f"must lie within the simulated space, {self.width:g} by {self.height:g} m"
            refuse("outline", self.outline, problem, "move the corners of the outline, or enlarge the simulated space")
        for wall in self.walls:
            if wall.motion is not None:
                problem = "must be None, because walls of a free-surface flow cannot move"
                refuse(f"{wall.name}.motion", "given", problem)
        between("lift_speed", self.lift_speed, 0, np.inf, "m/s")
        if self.gate and not self.lift_speed:
            problem = "must be above 0, because the scene has a gate that is lifted"
            refuse("lift_speed", self.lift_speed, problem, "use about 0.1 m/s, or leave out the gate")
        smallest = min(np.ptp(self.extent, axis=0))
        if self.spacing > smallest / 4:
            problem = (
                f"is too coarse: at least four cells must fit across the concrete at the start, which is "
                f"{smallest:.4g} m in its shortest direction"
            )
            refuse("spacing", self.spacing, problem, f"use {at_most(smallest / 4)} m or less")
        check_interval(self)
        fall = float(np.sqrt(2 * self.gravity * self.extent[1, 1]))
        if not self.step_error and self.time_step * fall > self.spacing:
            refuse("time_step", self.time_step, f"must be shorter, because concrete that falls at {fall:.3g} m/s "
                                                "passes through more than one cell per step",
                   f"use {at_most(self.spacing / fall, 2)} s or less")  # fmt: skip

    @property
    def extent(self) -> np.ndarray:
        """Lowest and highest corner of the concrete at the start, clipped to the simulated space, shape (2, 2) [m]."""
        corners = np.clip(np.array(self.outline, dtype=float), 0.0, [self.width, self.height])
        return np.stack([corners.min(0), corners.max(0)])

    @property
    def caption(self) -> str:
        """Text with scene and concrete, for titles of figures and recordings."""
        return f"{self.name}, concrete {self.concrete.words}"

    @property
    def about_axis(self) -> bool:
        """True if the vessel is a body of revolution, so that the concrete forms a round heap."""
        return self.axial or self.round

    @property
    def form(self) -> str:
        """Geometry of the flow as a text: axisymmetric, plane or three-dimensional."""
        return "axisymmetric" if self.axial else "three-dimensional" if self.depth else "plane"

    def __repr__(self) -> str:
        return (
            f"<FreeScene {self.name!r}: {self.concrete.words}, {self.form}, "
            f"{self.width:g} m wide, spacing {self.spacing:g} m>"
        )


@dataclass(frozen=True, kw_only=True)
class FreeConcrete(ConcreteParameters, FreeSettings):
    """Parameters that the flow simulations of all standard tests of fresh concrete share."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.slip_thickness:
            refuse(
                "slip_thickness",
                self.slip_thickness,
                "must be 0, because a slip layer in a vessel has no thickness in the simulation",
                "leave out 'slip_thickness'; 'slip_viscosity' and 'slip_yield' describe the slip layer",
            )

    def settings(self) -> SceneArguments:
        """Return the values of all members of :class:`FreeSettings` by name; they control the simulation of a scene."""
        return {f.name: getattr(self, f.name) for f in fields(FreeSettings)}
