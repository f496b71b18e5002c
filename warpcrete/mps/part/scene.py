"""Scenes of a part of a line that concrete fills and flows through at a given rate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from ...core.device import PRECISIONS
from ...core.errors import between, positive, refuse
from ...core.html import Parametrised
from ...core.parameters import Above, Declared, OneOf, Within
from ...geometry.axis import Arc, Axis, Line
from ...geometry.meshes import rays
from ...geometry.walls import MeshWall
from ...theory.pipe import Concrete, Steady, steady
from ...theory.pipe import Line as Stretch
from ..scene import STEP_ERROR, check_interval

FEWEST = 6
"""Cells across the narrowest bore."""
CLEAR, LEFT = 1.0, 4
"""Length of pipe beside an end or the middle of a part that the measured lines leave out, over the radius there, and
cells that must be left.
"""
ROUND = 0.03
"""By how much a bore's radius may differ around it for theory to call it round."""
AROUND, ALONG = 24, 60
"""Directions and places in which a mesh's bore is measured."""


@dataclass(frozen=True, kw_only=True)
class PartSettings(Declared):
    """How a flow through a part is computed."""

    duration: Annotated[float, "simulated time at most: a run ends when the pressure is steady [s]", Above()] = 2.0
    time_step: Annotated[float, "longest; every step, where step_error is 0 [s]", Above()] = 5e-3
    step_error: Annotated[float, STEP_ERROR, Within(0, 0.5)] = 0.0
    gravity: Annotated[float, "[m/s2]", Within(0, 1e4)] = 9.81
    regularisation: Annotated[float, "beta of the regularised Bingham law [s]", Above()] = 100.0
    tolerance: Annotated[float, "of the pressure solve: residual over that at its start", Within(1e-12, 0.5)] = 1e-3
    maximum_iterations: Annotated[int, "of a solve, before the run ends with an error", Within(1)] = 5000
    steadiness: Annotated[
        float, "steady: the pressure changes by less than this part in ten steps, and in the ten before", Above()
    ] = 1e-3
    precision: Annotated[str, "float32 or float64", OneOf(PRECISIONS)] = "float32"
    sample_interval: Annotated[float, "simulated time between two rows of the series [s]", Above()] = 0.02
    seed: Annotated[int, "nothing is random", Within(0)] = 0


@dataclass(frozen=True, kw_only=True, repr=False)
class PartScene(Parametrised, PartSettings):
    """Concrete that fills a pipe along an axis and flows through it, in at its start and out at its end; SI units, z
    up.
    """

    name: str
    concrete: Concrete
    axis: Axis
    """Its first and last pieces are straight; at most one arc lies between."""
    radius: float
    """Inner, at the start [m]."""
    flow: float
    """[m3/s]"""
    spacing: float
    """Wanted width of the cells [m]; the nearest that divides the radius at the start."""
    taper: tuple[float, float, float] | None = None
    """Arc lengths between which a cone leads to another radius, and that radius [m]."""
    wall: MeshWall | None = None
    """Instead of the round pipe: a mesh, of which what the axis sees is the bore."""
    insert: tuple[float, float] | None = None
    """Arc lengths between which a mesh is more than round pipe [m]; None: as it is found."""
    published: Mapping[str, float] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    parameters: Mapping[str, Any] = field(default_factory=dict)
    """Arguments that make this scene again through its scene function; empty if it has none."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("radius", "flow", "spacing"):
            positive(name, getattr(self, name), "m3/s" if name == "flow" else "m")
        pieces = self.axis.pieces
        arcs = [piece for piece in pieces if isinstance(piece, Arc)]
        if isinstance(pieces[0], Arc) or isinstance(pieces[-1], Arc) or len(arcs) > 1:
            refuse("axis", pieces, "must begin and end straight, with one arc between at most")
        for arc in arcs:
            if arc.radius <= self.radius:
                refuse("elbow radius", arc.radius, "must exceed the pipe's radius", f"take more than {self.radius:g} m")
            between("angle", arc.angle, 1e-3, 0.75 * np.pi, "rad", "a sharper turn meets itself")
        if self.taper is not None:
            begin, end, narrow = self.taper
            positive("outlet radius", narrow, "m")
            between("taper", begin, 0, end, "m")
            between("taper", end, np.nextafter(begin, np.inf), self.axis.length, "m", "the taper must end in the part")
            if arcs and begin < self.axis.length - pieces[-1].length and end > pieces[0].length:
                refuse("taper", self.taper, "may not lie in the bend", "put it before or behind")
        object.__setattr__(self, "_bores", self._measured_bores())
        least = 2 * min(float(self.bore(s)) for s in np.linspace(0, self.axis.length, 50))
        if self.spacing > least / FEWEST:
            refuse("spacing", self.spacing, f"must leave {FEWEST} cells across the narrowest bore, {least:.4g} m",
                   f"take {least / FEWEST:.3g} m or less")  # fmt: skip
        begin, end = self.middle
        for length, at in ((begin, 0.0), (self.axis.length - end, self.axis.length)):
            wanted = (2 if end > begin else 1) * CLEAR * float(self.bore(at)) + LEFT * self.spacing
            if length < wanted * (1 - 1e-9):  # lengths are differences
                share = "" if end > begin else ", half of it,"
                refuse("straight", length, f"is too short for a straight stretch{share} to be measured in [m]",
                       f"take {wanted:.3g} m or more")  # fmt: skip
        fastest = self.velocity * (2 * self.radius / least) ** 2
        if not self.step_error and self.time_step * fastest > self.spacing:
            refuse("time_step", self.time_step, f"lets concrete of {fastest:.3g} m/s pass more than a cell",
                   f"take {self.spacing / fastest:.2g} s or less")  # fmt: skip
        between("duration", self.duration, self.time_step, np.inf, "s", "one time step at least")
        check_interval(self)

    def _measured_bores(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Arc lengths and radii of equal area of a mesh's bore [m]."""
        if self.wall is None:
            return None
        inset = 1e-3 * self.radius  # a ray along a mesh's rim may miss it
        s = np.linspace(inset, self.axis.length - inset, ALONG)
        points, _, normal, side = self.axis.frame(s)
        angle = 2 * np.pi * (np.arange(AROUND) + 0.382) / AROUND
        ways = np.cos(angle)[None, :, None] * normal[:, None] + np.sin(angle)[None, :, None] * side[:, None]
        starts = np.broadcast_to(points[:, None], ways.shape).reshape(-1, 3)
        reach = rays(self.wall, starts, ways.reshape(-1, 3), 10 * self.radius).reshape(-1, AROUND)
        if np.any(reach < 0):
            refuse("wall", self.wall.name, f"has gaps along the axis: {np.count_nonzero(reach < 0)} of {reach.size} "
                   "probes find no wall", "close its holes, or move it so that it lies about the axis")  # fmt: skip
        radii = np.sqrt(np.mean(reach**2, axis=1))
        begin, end = self.insert or (0.0, 0.0)
        straight = (s <= begin) | (s >= end)
        object.__setattr__(self, "_round", bool(np.all(np.abs(reach / radii[:, None] - 1)[straight] < ROUND)))
        if abs(radii[0] / self.radius - 1) > 0.1:
            refuse("radius", self.radius, f"is not that of the mesh, {radii[0]:.4g} m at the start",
                   "give its radius, or the scale of its unit (0.001 for mm)")  # fmt: skip
        return s, radii

    def bore(self, s: np.ndarray | float) -> np.ndarray:
        """Radius of the bore at arc lengths [m], by its area where a mesh is not round; shape as `s`."""
        measured = getattr(self, "_bores", None)
        if measured is not None:
            return np.asarray(np.interp(s, *measured))
        if self.taper is None:
            return np.full(np.shape(s), self.radius)
        begin, end, narrow = self.taper
        return np.asarray(np.interp(s, [begin, end], [self.radius, narrow]))

    @property
    def velocity(self) -> float:
        """Mean, at the start [m/s]."""
        return self.flow / (np.pi * float(self.bore(0.0)) ** 2)

    @property
    def is_round(self) -> bool:
        """Does a round pipe's theory hold for the straight stretches?"""
        return getattr(self, "_round", True)

    @property
    def middle(self) -> tuple[float, float]:
        """Arc lengths between which the part is no straight pipe [m]: its bend, its taper, or from one to the other,
        or where a mesh's bore changes; none: both are the middle.
        """
        half = 0.5 * self.axis.length
        measured = getattr(self, "_bores", None)
        ends = []
        if len(self.axis.pieces) > 1:
            ends += [self.axis.pieces[0].length, self.axis.length - self.axis.pieces[-1].length]
        if self.taper is not None:
            ends += self.taper[:2]
        if self.insert is not None:
            ends += self.insert
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
    def rise(self) -> float:
        """Of the whole part [m]."""
        ends, _ = self.axis.at([0.0, self.axis.length])
        return float(ends[1, 2] - ends[0, 2])

    def theory(self, s: float) -> Steady:
        """Steady flow through a straight, level metre of the bore there."""
        line = Stretch(radius=float(self.bore(s)), length=1.0, gravity=0.0)
        return steady(self.concrete, line, self.flow)

    def friction(self, begin: float, end: float) -> float:
        """Pressure that theory has lost between two arc lengths, as if each bore were a straight pipe's [Pa]."""
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
            f"<PartScene {self.name!r}: {self.concrete.name}, R = {self.radius:g} m, {shape}, "
            f"{self.velocity:.4g} m/s, spacing {self.spacing:g} m>"
        )
