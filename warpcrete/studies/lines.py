"""A line of pipes, read from a file: its parts, whether they fit, and what the closed form makes of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.amounts import amount
from ..core.concretes import is_file, read_yaml
from ..core.errors import one_of, positive, refuse
from ..geometry.axis import Arc, Axis, Line
from ..theory.pipe import Concrete, rested, steady
from ..theory.pipe import Line as Stretch

SHIPPED = Path(__file__).parents[1] / "measured" / "lines"
KEYS = ("name", "source", "recorded", "diameter", "flow", "concrete", "largest_stone", "begin", "parts")
PARTS = {
    "straight": ("length", "rise", "diameter"),
    "bend": ("angle", "radius", "to"),
    "reducer": ("to", "length"),
}
"""Kinds of parts, and what each may say."""
BEGINS = {"level": (1.0, 0.0, 0.0), "up": (0.0, 0.0, 1.0), "down": (0.0, 0.0, -1.0)}
WAYS = ("up", "down", "left", "right", "level", "back")
SHARPEST = 135.0
"""Bend that one part may make [degrees]."""
BLOCKING = 3.0
"""Diameters over largest stones below which a pipe is known to block (ACI 304.2R asks for 3 of crushed stone)."""
UP = np.array([0.0, 0.0, 1.0])
HALF_TURN = 0.51 * math.pi
"""Way along a line over the pipe's diameter within which it is near itself, however it bends."""
FINE = 200
"""Places at which a taper's friction is summed."""


@dataclass(frozen=True)
class Part:
    """A piece of a line."""

    number: int
    """From 1."""
    kind: str
    diameter: float
    """[m]"""
    length: float
    """Of its axis [m]."""
    rise: float
    """Of its end over its start [m]."""
    outlet: float
    """Diameter at its end [m]."""
    radius: float = 0.0
    """Of a bend [m]."""
    angle: float = 0.0
    """Of a bend [degrees]."""

    @property
    def label(self) -> str:
        """What it is, in a few words."""
        if self.kind == "bend":
            return f"bend of {self.angle:g} degrees, radius {self.radius:g} m"
        if self.kind == "reducer":
            return f"{1e3 * self.diameter:g} to {1e3 * self.outlet:g} mm"
        slope = self.rise / self.length
        way = {1.0: " up", -1.0: " down", 0.0: ""}.get(round(slope, 9), f", rises {self.rise:.3g} m")
        return f"straight{way}"

    @property
    def alike(self) -> tuple[Any, ...]:
        """The same for parts that lose the same, a straight one by the metre."""
        if self.kind == "straight":
            return (self.kind, self.diameter)
        return (self.kind, self.diameter, self.outlet, self.length, self.radius, self.angle)

    def friction(self, concrete: Concrete, flow: float) -> float:
        """What the closed form of a straight pipe of its bore and length loses [Pa]."""
        at = (np.arange(FINE) + 0.5) / FINE if self.outlet != self.diameter else np.zeros(1)
        bores = self.diameter + at * (self.outlet - self.diameter)
        losses = [steady(concrete, Stretch(radius=d / 2, length=1.0, rise=0.0), flow).pressure for d in bores.tolist()]
        return float(np.mean(losses)) * self.length


@dataclass(frozen=True)
class PipeLine:
    """Parts in a row; SI units."""

    name: str
    parts: tuple[Part, ...]
    axis: Axis
    flow: float | None = None
    """[m3/s]"""
    concrete: str | None = None
    largest_stone: float | None = None
    """[m]"""
    source: str = ""
    recorded: float | None = None
    """Pressure at the pump [Pa]."""

    @property
    def length(self) -> float:
        """[m]"""
        return sum(part.length for part in self.parts)

    @property
    def rise(self) -> float:
        """[m]"""
        return sum(part.rise for part in self.parts)

    def restart(self, concrete: Concrete, rest: float, thixotropy: float, flow: float = 0.0) -> float:
        """Pressure at the pump [Pa] that sets all of it going after `rest` [s], by theory.

        Its yield stresses have grown by `thixotropy` [Pa/s]. Without a `flow` [m3/s] it is that from which the line
        moves; with one that at which it starts at that flow at once.
        """
        grown = rested(concrete, rest, thixotropy)
        weight = concrete.density * Stretch().gravity * self.rise
        return max(weight + sum(part.friction(grown, flow) for part in self.parts), 0.0)

    def remarks(self) -> list[str]:
        """What a reader should know of it."""
        found = []
        narrow = min(min(part.diameter, part.outlet) for part in self.parts)
        if self.largest_stone and narrow < BLOCKING * self.largest_stone:
            found.append(f"stones of {1e3 * self.largest_stone:g} mm in a bore of {1e3 * narrow:g} mm may block: less "
                         f"than {BLOCKING:g} of them lie across it")  # fmt: skip
        return found


def shipped_lines() -> tuple[str, ...]:
    """Names of the lines that come with the package."""
    return tuple(sorted(path.stem for path in SHIPPED.glob("*.yaml")))


def read_line(name: Path | str) -> PipeLine:
    """A line from a YAML file, or a shipped one by its name.

    Raises :class:`SceneError` for one that cannot be read, or whose parts do not fit.
    """
    path = SHIPPED / f"{name}.yaml" if str(name) in shipped_lines() else Path(name)
    if not path.is_file():
        refuse("line", str(name), f"is no file and none of {', '.join(shipped_lines())}", "write one: see --help")
    given = dict(read_yaml(path, "line"))
    if isinstance(given.get("concrete"), str) and is_file(given["concrete"]):
        given["concrete"] = str(path.parent / given["concrete"])
    return line_of(given, path.stem)


def line_of(given: Mapping[str, Any], name: str = "line") -> PipeLine:
    """A line from the contents of such a file: `parts`, each a mapping of its kind to what it says of it, the
    `diameter` that the first has, and which way it begins; and, where they are known, `flow`, `concrete`,
    `largest_stone`, `source`, `recorded`.
    """
    if not isinstance(given, Mapping):
        refuse("line", given, "must be 'key: value' lines, or a mapping of such")
    for key in given:
        one_of("line's key", key, KEYS)
    entries = given.get("parts")
    if not isinstance(entries, Sequence) or isinstance(entries, str) or not entries:
        refuse("parts", entries, "must be a list of one part or more", "as '- straight: 10 m'")
    if "diameter" not in given:
        refuse("diameter", None, "must be given, that of the first part", "as 'diameter: 125 mm'")
    diameter = _above("diameter", given["diameter"], "m")
    begin = given.get("begin", "level")
    one_of("begin", begin, BEGINS)
    stone = _above("largest_stone", given["largest_stone"], "m") if "largest_stone" in given else None
    course = _Course(np.array(BEGINS[begin]), diameter)
    for number, entry in enumerate(entries, 1):
        course.add(number, entry)
    axis = Axis((0.0, 0.0, 0.0), BEGINS[begin], tuple(course.pieces))
    line = PipeLine(
        name=str(given.get("name", name)),
        parts=tuple(course.parts),
        axis=axis,
        flow=_above("flow", given["flow"], "m3/s") if "flow" in given else None,
        concrete=str(given["concrete"]) if "concrete" in given else None,
        source=str(given.get("source", "")),
        recorded=_above("recorded", given["recorded"], "Pa") if "recorded" in given else None,
    )
    _check_crossing(line)
    return with_stone(line, stone)


def with_stone(line: PipeLine, stone: float | None) -> PipeLine:
    """The line of a concrete whose largest stone [m] is known. Raises :class:`SceneError` where it does not pass."""
    for part in line.parts:
        if stone is not None and stone >= min(part.diameter, part.outlet):
            refuse("largest_stone", stone, f"does not pass part {part.number}, {part.label}, of "
                   f"{min(part.diameter, part.outlet):g} m", "take a wider pipe or a smaller stone")  # fmt: skip
    return replace(line, largest_stone=stone)


def _above(field: str, given: Any, unit: str) -> float:
    found = amount(field, given, unit)
    positive(field, found, unit)
    return found


class _Course:
    """Where a line has come to, part by part."""

    def __init__(self, tangent: np.ndarray, diameter: float) -> None:
        self.tangent, self.diameter = tangent, diameter
        self.heading = tangent if tangent[2] == 0 else np.array([1.0, 0.0, 0.0])
        """Level direction in which the line last went."""
        self.parts: list[Part] = []
        self.pieces: list[Line | Arc] = []

    def add(self, number: int, entry: Any) -> None:
        """Go on by a part, as a file has it."""
        if not isinstance(entry, Mapping) or len(entry) != 1:
            refuse(f"part {number}", entry, f"must be one of {', '.join(PARTS)}, and what it is",
                   "as '- straight: {length: 10 m}'")  # fmt: skip
        kind, said = next(iter(entry.items()))
        one_of(f"part {number}", kind, PARTS)
        if not isinstance(said, Mapping):
            said = {PARTS[kind][0]: said}
        for key in said:
            one_of(f"part {number}, {kind}: key", key, PARTS[kind])

        def get(key: str, unit: str, default: Any = None) -> float:
            if key not in said and default is None:
                refuse(f"part {number}, {kind}", dict(said), f"must say its {key}", f"as '{key}: 1'")
            return amount(f"part {number}, {kind}: {key}", said.get(key, default), unit)

        part, piece = getattr(self, f"_{kind}")(number, said, get)
        self.parts.append(part)
        self.pieces.append(piece)
        self.diameter = part.outlet

    def _straight(self, number: int, said: Mapping[str, Any], get: Callable[..., float]) -> tuple[Part, Line]:
        length = get("length", "m")
        positive(f"part {number}, straight: length", length, "m")
        rise = length * float(self.tangent[2])
        if "rise" in said and abs(get("rise", "m") - rise) > 0.01 * length:
            refuse(f"part {number}, straight: rise", said["rise"], f"does not fit: the line goes on with a rise of "
                   f"{rise:.4g} m over {length:g} m", "put a bend before it, or leave the rise out")  # fmt: skip
        if "diameter" in said and abs(get("diameter", "m") - self.diameter) > 1e-6:
            refuse(f"part {number}, straight: diameter", said["diameter"], "does not fit a part before it of "
                   f"{self.diameter:g} m", "put a reducer between them")  # fmt: skip
        return Part(number, "straight", self.diameter, length, rise, self.diameter), Line(length)

    def _bend(self, number: int, said: Mapping[str, Any], get: Callable[..., float]) -> tuple[Part, Arc]:
        radius = get("radius", "m")
        field = f"part {number}, bend"
        if radius <= self.diameter / 2:
            refuse(f"{field}: radius", radius, f"must exceed the pipe's, {self.diameter / 2:g} m")
        way = said.get("to")
        one_of(f"{field}: to", way, WAYS)
        left = np.cross(UP, self.heading)
        towards = {"up": UP, "down": -UP, "left": left, "right": -left, "level": self.heading,
                   "back": -self.heading}[str(way)]  # fmt: skip
        across = towards - (towards @ self.tangent) * self.tangent
        if np.linalg.norm(across) < 1e-6:
            refuse(
                f"{field}: to", way, "is where the line goes already, or came from", f"take one of {', '.join(WAYS)}"
            )
        whole = math.degrees(math.acos(float(np.clip(towards @ self.tangent, -1, 1))))
        angle = get("angle", "degrees", round(whole, 9))
        if not 1 <= angle <= SHARPEST:
            refuse(f"{field}: angle", angle, f"must be in [1, {SHARPEST:g}] degrees", "make two bends of it")
        if way in ("up", "down", "level") and angle > whole + 1e-6:
            refuse(f"{field}: angle", angle, f"goes beyond {way!r}, {whole:.4g} degrees from where the line goes",
                   "leave the angle out")  # fmt: skip
        turn = math.radians(angle)
        across = across / np.linalg.norm(across)
        rise = radius * float((1 - math.cos(turn)) * across[2] + math.sin(turn) * self.tangent[2])
        piece = Arc(radius, turn, (float(across[0]), float(across[1]), float(across[2])))
        tangent = math.cos(turn) * self.tangent + math.sin(turn) * across
        tangent = np.where(np.abs(tangent) < 1e-12, 0.0, tangent)
        self.tangent = tangent / np.linalg.norm(tangent)
        level = self.tangent * [1, 1, 0]
        if np.linalg.norm(level) > 1e-6:
            self.heading = level / np.linalg.norm(level)
        return Part(number, "bend", self.diameter, radius * turn, rise, self.diameter, radius, angle), piece

    def _reducer(self, number: int, said: Mapping[str, Any], get: Callable[..., float]) -> tuple[Part, Line]:
        outlet, length = get("to", "m"), get("length", "m")
        for key, value in (("to", outlet), ("length", length)):
            positive(f"part {number}, reducer: {key}", value, "m")
        if abs(outlet - self.diameter) < 1e-9:
            refuse(f"part {number}, reducer: to", outlet, "is the diameter that the line has", "take a straight part")
        if length < 0.5 * abs(outlet - self.diameter):
            refuse(f"part {number}, reducer: length", length, "must be half of what the diameter changes, at least",
                   f"take {0.5 * abs(outlet - self.diameter):.3g} m or more")  # fmt: skip
        rise = length * float(self.tangent[2])
        return Part(number, "reducer", self.diameter, length, rise, outlet), Line(length)


def _check_crossing(line: PipeLine) -> None:
    """Refuse a line that meets itself."""
    begin = 0.0
    rows: list[tuple[int, float, float, float]] = []
    edges = []
    for part in line.parts:
        s = np.linspace(begin, begin + part.length, 9 if part.kind == "bend" else 2)
        points, _ = line.axis.at(s)
        wide = max(part.diameter, part.outlet)
        rows += [(part.number, s[k], s[k + 1], wide) for k in range(len(s) - 1)]
        edges += [points[k : k + 2] for k in range(len(s) - 1)]
        begin += part.length
    number, start, end, wide = np.array(rows).T
    ends = np.array(edges)
    for k in range(len(rows)):
        later = np.arange(k + 1, len(rows))
        apart = 0.5 * (wide[k] + wide[later])
        # What follows along the tightest bend, of half a diameter, is nearer than a diameter for half a turn.
        far = start[later] - end[k] > HALF_TURN * apart
        near = later[far][distances(ends[k], ends[later[far]]) < apart[far]]
        if len(near):
            refuse("parts", [int(number[k]), int(number[near[0]])], "meet: the line crosses itself there",
                   "lead it another way")  # fmt: skip


def distances(one: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Least distances [m] of a segment (2, 3) from each of others (n, 2, 3) (Ericson 2005, 5.1.9)."""
    first, second, between = one[1] - one[0], others[:, 1] - others[:, 0], one[0] - others[:, 0]
    a, e, f = first @ first, np.sum(second**2, 1), np.sum(second * between, 1)
    b, c = second @ first, between @ first
    determinant = a * e - b * b
    skew = determinant > 1e-12 * a * e
    s = np.where(skew, np.clip((b * f - c * e) / np.where(skew, determinant, 1.0), 0, 1), 0.0)
    t = (b * s + f) / e
    s = np.where((t < 0) | (t > 1), np.clip((b * np.clip(t, 0, 1) - c) / a, 0, 1), s)
    gap = one[0] + s[:, None] * first - others[:, 0] - np.clip(t, 0, 1)[:, None] * second
    return np.linalg.norm(gap, axis=1)


def layered(concrete: Concrete, factor: float) -> Concrete:
    """The same concrete with so many times the slip layer's resistance."""
    return replace(concrete, slip_viscosity=factor * concrete.slip_viscosity, slip_yield=factor * concrete.slip_yield)
