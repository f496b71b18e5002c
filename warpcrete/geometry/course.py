"""Course of a pipeline in space, built part by part from the entries of its file."""

import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..core.errors import at_least, between, one_of, positive, refuse
from ..core.inputs.amounts import amount, bare_number, is_amount
from ..core.inputs.limits import check_limit, warn
from ..core.inputs.text_files import errors_located_at
from .axis import Arc, Axis, Line
from .curves import curve_through, start_tangent
from .line_entries import (
    BEND_DIAMETERS,
    BEND_RADIUS,
    FACTORS,
    HOSE_FACTOR,
    KEYS,
    LIMITED_AS,
    MOST_POINTS,
    PART_HINTS,
    PARTS,
    REDUCER_LENGTH,
    VALVE_DIAMETERS,
    WAYS,
    WITHOUT_ENTRIES,
)
from .pipe_line import Part

MAX_BEND_ANGLE = 135.0
"""Largest accepted angle of a single bend [degrees]."""
BEND_EXTRA_LOSS = ((0.0, 0.15, 0.3, 0.6), (0.0, 0.023, 0.042, 0.125))
"""Additional pressure loss of a bend, divided by the loss in straight pipe of the same length. The first tuple holds
ratios of pipe diameter to bend radius, and the second tuple holds the additional loss at each ratio. Source: simulated
flows through bends of 150 mm pipe at 30 m3/h, for the concrete no1, which has the highest loss of three concretes. The
loss of a hose is computed from this table."""
MAX_HOSE_KINK = 20.0
"""Largest angle [degrees] at the start of a hose, between the direction of the pipeline and the tangent of the curve
through the hose's points. A larger angle is refused as a kink."""
HOSE_LAYER = (0.1, 10.0)
"""Usual range of the resistance of the slip layer in a hose divided by the resistance of the slip layer in a pipe. A
warning is given outside this range."""
SHORT_FORMS = {"bend": "up", "reducer": "100 mm", "bore": "{file: valve.stl}"}
"""Examples of the entries of a part; for all other kinds of parts, the example is a length."""
UP = np.array([0.0, 0.0, 1.0])
Pieces = Sequence[Line | Arc]


def _corrected(entry: object) -> str:
    """Return a hint that says how to write an entry of the list of parts correctly.

    A correct entry maps the kind of a part to its properties. Users write '- elbow' or '- straight 10 m', which YAML
    reads as a text, or a property beside the kind instead of below it, as in '- {straight: 10 m, factor: 1.2}'.
    """
    if isinstance(entry, Mapping):
        kind, *others = entry or ("",)
        known = kind in PARTS and not isinstance(entry[kind], Mapping) and all(key in PARTS[kind] for key in others)
        if others and known:
            said = {next(iter(PARTS[kind])): entry[kind], **{key: entry[key] for key in others}}
            return f"write '- {kind}: {{{', '.join(f'{key}: {value}' for key, value in said.items())}}}'"
    kind, _, rest = entry.partition(" ") if isinstance(entry, str) else ("", "", "")
    if kind in PART_HINTS:
        return PART_HINTS[kind]
    if kind in PARTS:
        return f"write '- {kind}: {rest.strip() or SHORT_FORMS.get(kind, '1 m')}'"
    return "for example '- straight: {length: 10 m}'"


class Course:
    """Pipeline under construction: its current direction and diameter, and the parts added so far."""

    def __init__(self, tangent: np.ndarray, diameter: float, folder: Path) -> None:
        self.begin: tuple[float, float, float] = tuple(tangent.tolist())
        self.tangent, self.diameter, self.folder = tangent, diameter, folder
        self.heading = tangent if tangent[2] == 0 else np.array([1.0, 0.0, 0.0])
        """Most recent direction of the pipeline that was not vertical, projected onto the horizontal plane, as a unit
        vector of shape (3,)."""
        self.parts: list[Part] = []
        self.pieces: list[Line | Arc] = []

    def add(self, number: int, entry: object) -> None:
        """Append a part to the pipeline.

        `entry` is the part's entry in the pipeline file, and `number` counts the parts from 1.
        """
        if isinstance(entry, str) and entry in WITHOUT_ENTRIES:
            entry = {entry: {}}
        if not isinstance(entry, Mapping) or len(entry) != 1:
            problem = f"must be one of {', '.join(PARTS)}, followed by a colon and the properties of the part"
            refuse(f"part {number}", entry, problem, _corrected(entry))
        kind, said = next(iter(entry.items()))
        if kind in PART_HINTS:
            refuse(f"part {number}", kind, f"must be one of {', '.join(PARTS)}", PART_HINTS[kind])
        one_of(f"part {number}", kind, PARTS)
        if said is None and kind in WITHOUT_ENTRIES:
            said = {}
        if not isinstance(said, Mapping):
            listed = kind == "hose" and isinstance(said, Sequence) and not isinstance(said, str)
            said = {"points" if listed else next(iter(PARTS[kind])): said}
        for key in said:
            with errors_located_at(said, key):
                _check_key(f"part {number}, {kind}: key", kind, key, said[key])

        def get(key: str, unit: str, default: object = None) -> float:
            if key not in said and default is None:
                refuse(f"part {number}, {kind}", dict(said), f"has no {key!r}", f"add it, for example '{key}: 1 m'")
            field = f"part {number}, {kind}: {key}"
            with errors_located_at(said, key):
                found = amount(field, said.get(key, default), unit)
                if key in said:
                    check_limit(field, found, unit, LIMITED_AS.get(key, key))
            return found

        part, pieces = getattr(self, f"_{kind}")(number, said, get)
        self.parts.append(replace(part, factor=_stated(part, said, get)))
        self.pieces += pieces
        self.diameter = part.outlet

    def _straight(self, number: int, said: Mapping[str, object], get: Callable[..., float]) -> tuple[Part, Pieces]:
        length = get("length", "m")
        positive(f"part {number}, straight: length", length, "m")
        rise = length * float(self.tangent[2])
        if "rise" in said and abs(get("rise", "m") - rise) > 0.01 * length:
            problem = f"does not fit: in the direction of the line here, a part of {length:g} m rises by {rise:.4g} m"
            hint = "put a bend before this part, or leave out 'rise'"
            refuse(f"part {number}, straight: rise", said["rise"], problem, hint)
        diameter = get("diameter", "m", self.diameter)
        positive(f"part {number}, straight: diameter", diameter, "m")
        if abs(diameter - self.diameter) > 1e-6:
            refuse(f"part {number}, straight: diameter", said["diameter"], "differs from the diameter at the end of "
                                                                           "the part before "
                   f"it, {self.diameter:g} m", "put a reducer between the two parts")  # fmt: skip
        return Part(number, "straight", self.diameter, length, rise, self.diameter), (Line(length),)

    def _bend(self, number: int, said: Mapping[str, object], get: Callable[..., float]) -> tuple[Part, Pieces]:
        radius = get("radius", "m", max(BEND_RADIUS, BEND_DIAMETERS * self.diameter))
        field = f"part {number}, bend"
        if radius <= self.diameter / 2:
            problem = f"must exceed the radius of the pipe, {self.diameter / 2:g} m"
            refuse(f"{field}: radius", radius, problem, "give the radius of the bend's centreline")
        way = said.get("to")
        if way is None or bare_number(way) or is_amount(way, "degrees"):
            angle = said.get("angle", 45) if way is None else way
            example = f"write the direction and, if needed, the angle, as in 'bend: {{to: up, angle: {angle}}}'"
            refuse(f"{field}: to", way, f"must be one of {', '.join(WAYS)}", example)
        direction, _, turn = str(way).partition(" ")
        if direction in WAYS and bare_number(turn.strip()):
            example = f"write 'bend: {{to: {direction}, angle: {turn.strip()}}}'"
            refuse(f"{field}: to", way, f"must be one of {', '.join(WAYS)}", example)
        one_of(f"{field}: to", way, WAYS)
        left = np.cross(UP, self.heading)
        towards = {"up": UP, "down": -UP, "left": left, "right": -left, "level": self.heading, "back": -self.heading}[
            str(way)
        ]
        across = towards - (towards @ self.tangent) * self.tangent
        if np.linalg.norm(across) < 1e-6:
            problem = "is the direction that the line already has, or the opposite of it"
            refuse(f"{field}: to", way, problem, f"use another of {', '.join(WAYS)}")
        whole = math.degrees(math.acos(float(np.clip(towards @ self.tangent, -1, 1))))
        angle = get("angle", "degrees", round(whole, 9))
        if not 1 <= angle <= MAX_BEND_ANGLE:
            problem = f"must be in [1, {MAX_BEND_ANGLE:g}] degrees"
            refuse(f"{field}: angle", angle, problem, "split a larger bend into two, and leave out a smaller one")
        if way in ("up", "down", "level") and angle > whole + 1e-6:
            problem = f"turns the line beyond the direction {way!r}, which it reaches at {whole:.4g} degrees"
            refuse(f"{field}: angle", angle, problem, "leave out 'angle' for a bend that ends in this direction")
        turn = math.radians(angle)
        across = across / np.linalg.norm(across)
        rise = radius * float((1 - math.cos(turn)) * across[2] + math.sin(turn) * self.tangent[2])
        piece = Arc(radius, turn, (float(across[0]), float(across[1]), float(across[2])))
        self._turn(math.cos(turn) * self.tangent + math.sin(turn) * across)
        return Part(number, "bend", self.diameter, radius * turn, rise, self.diameter, radius, angle), (piece,)

    def _turn(self, tangent: np.ndarray) -> None:
        """Set the direction in which the next part of the pipeline starts to `tangent`, a vector of any length.

        Unless the new direction is vertical, also set `heading` to its horizontal component.
        """
        tangent = np.where(np.abs(tangent) < 1e-12, 0.0, tangent)
        self.tangent = tangent / np.linalg.norm(tangent)
        level = self.tangent * [1, 1, 0]
        if np.linalg.norm(level) > 1e-6:
            self.heading = level / np.linalg.norm(level)

    def _hose(self, number: int, said: Mapping[str, object], get: Callable[..., float]) -> tuple[Part, Pieces]:
        """Return a hose and the pieces of its axis: a straight line of a given length, or a curve through given points.

        `said` holds the entries of the hose in the pipeline's file, and `get` returns the number in an entry. A point
        has three coordinates relative to the start of the hose [m]: ahead, to the left, and up.
        """
        field = f"part {number}, hose"
        given = said.get("points")
        _refuse_both(field, said, "length", "points")
        if "length" in said:
            length = get("length", "m")
            positive(f"{field}: length", length, "m")
            rise = length * float(self.tangent[2])
            return Part(number, "hose", self.diameter, length, rise, self.diameter, relative_loss=HOSE_FACTOR,
                        layer=_hose_layer(field, said)), (Line(length),)  # fmt: skip
        if not isinstance(given, Sequence) or isinstance(given, str) or not given:
            hint = "for example '[[1, 0, 0], [2, 0, -0.5]]', or a length, as in 'hose: 8 m'"
            refuse(f"{field}: points", given, "must be a list of points", hint)
        if any(not isinstance(p, Sequence) or isinstance(p, str) or len(p) != 3 for p in given):
            problem = "must each have three coordinates [m]: ahead, to the left and up"
            refuse(f"{field}: points", given, problem, "for example '[2, 0, -0.5]'")
        if len(given) > MOST_POINTS:
            problem = f"must be at most {MOST_POINTS} points"
            hint = f"leave out {len(given) - MOST_POINTS} or more of the points where the hose is nearly straight"
            refuse(f"{field}: points", f"{len(given)} points", problem, hint)
        local = np.array([[0.0] * 3] + [[amount(f"{field}: points", x, "m") for x in point] for point in given])
        for x in local.ravel().tolist():
            check_limit(f"{field}: points", x, "m", "length")
        if np.any(np.linalg.norm(np.diff(local, axis=0), axis=1) < 0.5 * self.diameter):
            problem = f"must be at least half a diameter, {self.diameter / 2:g} m, apart"
            refuse(f"{field}: points", given, problem, "leave out points that are closer together")
        layer = _hose_layer(field, said)
        points = local @ np.array([self.heading, np.cross(UP, self.heading), UP])
        askew = math.degrees(math.acos(float(np.clip(start_tangent(points) @ self.tangent, -1, 1))))
        if askew > MAX_HOSE_KINK:
            refuse(f"{field}: points", given, f"begin at an angle of {askew:.0f} degrees to the direction of the line",
                   "put a bend before the hose, or move the first points so that they lie ahead")  # fmt: skip
        pieces = curve_through(points, self.tangent)
        length = sum(piece.length for piece in pieces)
        bends = [piece for piece in pieces if isinstance(piece, Arc)]
        sharpest = min((piece.radius for piece in bends), default=math.inf)
        if self.diameter > BEND_EXTRA_LOSS[0][-1] * sharpest:
            refuse(f"{field}: points", given, f"bend the hose to a radius of {sharpest:.3g} m, but it must "
                   f"be at least {at_least(self.diameter / BEND_EXTRA_LOSS[0][-1])} m",
                   "move the points so that the hose bends less sharply")  # fmt: skip
        more = (
            sum(arc.length * float(np.interp(self.diameter / arc.radius, *BEND_EXTRA_LOSS)) for arc in bends) / length
        )
        rise = float(points[-1, 2])
        end = Axis((0.0, 0.0, 0.0), tuple(self.tangent.tolist()), tuple(pieces)).at(length)[1][0]
        self._turn(end)
        return Part(
            number, "hose", self.diameter, length, rise, self.diameter, relative_loss=1 + more, layer=layer
        ), pieces

    def _reducer(self, number: int, said: Mapping[str, object], get: Callable[..., float]) -> tuple[Part, Pieces]:
        outlet, length = get("to", "m"), get("length", "m", REDUCER_LENGTH)
        for key, value in (("to", outlet), ("length", length)):
            positive(f"part {number}, reducer: {key}", value, "m")
        if abs(outlet - self.diameter) < 1e-9:
            problem = "is already the diameter of the line"
            refuse(f"part {number}, reducer: to", outlet, problem, "use a part 'straight' instead")
        if length < 0.5 * abs(outlet - self.diameter):
            refuse(f"part {number}, reducer: length", length, "is too short: must be at least half of the change of "
                                                              "the diameter",
                   f"use {at_least(0.5 * abs(outlet - self.diameter))} m or more")  # fmt: skip
        rise = length * float(self.tangent[2])
        return Part(number, "reducer", self.diameter, length, rise, outlet), (Line(length),)

    def _valve(self, number: int, said: Mapping[str, object], get: Callable[..., float]) -> tuple[Part, Pieces]:
        length = get("length", "m", VALVE_DIAMETERS * self.diameter)
        positive(f"part {number}, valve: length", length, "m")
        rise = length * float(self.tangent[2])
        return Part(number, "valve", self.diameter, length, rise, self.diameter), (Line(length),)

    def _bore(self, number: int, said: Mapping[str, object], get: Callable[..., float]) -> tuple[Part, Pieces]:
        # The module of meshes needs Warp, which takes seconds to import, so import it only for a line with a mesh.
        from .mesh_parts import bore_of, directions_at, rotated_pieces

        field, file = f"part {number}, bore", said.get("file")
        if not isinstance(file, str) or not file:
            refuse(f"{field}: file", file, "must be the path of a mesh file", "for example 'file: valve.stl'")
        length = get("length", "m") if "length" in said else None
        outlet, scale = get("outlet", "m", self.diameter), get("scale", "1", 1.0)
        for key, value in (("length", length), ("outlet", outlet), ("scale", scale)):
            if value is not None:
                positive(f"{field}: {key}", value, "" if key == "scale" else "m")
        path = Path(os.path.realpath(self.folder / file))
        mesh = bore_of((f"{field}: file", f"{field}: scale"), path, scale, length, (self.diameter, outlet))
        before = Axis((0.0, 0.0, 0.0), self.begin, (*self.pieces, Line(self.diameter)))
        directions = directions_at(before, before.length)
        ends, tangents = mesh.axis.at([0.0, mesh.axis.length])
        rise = float(((ends[1] - ends[0]) @ directions)[2])
        self._turn(tangents[1] @ directions)
        part = Part(number, "bore", self.diameter, mesh.axis.length, rise, outlet, mesh=mesh)
        return part, rotated_pieces(mesh.axis.pieces, directions)


def _check_key(field: str, kind: str, key: object, value: object) -> None:
    """Refuse the entry `key` of a part if a part of this kind has no such entry; `field` is its name in the message."""
    if str(key)[:1].isdecimal():
        hint = "within braces, put an amount with a decimal comma in quotes, as in '12,5 m'"
        refuse(field, key, f"must be one of {', '.join(PARTS[kind])}", hint)
    if kind == "hose" and key == "diameter":
        problem = f"must be one of {', '.join(PARTS[kind])}; a hose is as wide as the part before it"
        refuse(field, key, problem, f"put 'reducer: {{to: {value}}}' before it")
    if key in KEYS and key not in PARTS[kind]:
        problem = f"must be one of {', '.join(PARTS[kind])}"
        refuse(field, key, problem, f"write '{key}: {value}' outside the list 'parts', without indentation")
    if (kind, key) == ("reducer", "from"):
        problem = f"must be one of {', '.join(PARTS[kind])}; a reducer begins with the diameter of the line"
        refuse(field, key, problem, "leave out 'from'")
    if kind == "bend" and key in WAYS:
        problem = f"must be one of {', '.join(PARTS[kind])}"
        refuse(field, key, problem, f"write 'to: {key}, angle: {value}'" if value is not None else f"write 'to: {key}'")
    one_of(field, key, PARTS[kind])


def _refuse_both(field: str, said: Mapping[str, object], one: str, other: str) -> None:
    """Refuse a part whose entries `said` contain both `one` and `other`, which exclude each other.

    `field` is the name of the part in the message.
    """
    if one in said and said.get(other) is not None:
        problem = f"cannot be given together with {other!r}"
        refuse(f"{field}: {one}", said[one], problem, f"leave out {one!r} or {other!r}")


def _stated(part: Part, said: Mapping[str, object], get: Callable[..., float]) -> float | None:
    """Return the friction that a part's entries state, divided by the friction of straight pipe of the same length.

    `said` holds the entries, and `get` returns the number in an entry. The result is None if no entry states friction.
    """
    field = f"part {part.number}, {part.kind}"
    _refuse_both(field, said, "factor", "equivalent")
    for stated in ("factor", "equivalent"):
        # Refuse the entry `layer` of a hose together with these entries, because they state the hose's total friction,
        # which already contains the effect of its slip layer.
        _refuse_both(field, said, stated, "layer")
    if "factor" in said:
        factor = get("factor", "1")
        hint = "'factor' is the friction of the part divided by the friction of a straight pipe of the same length"
        between(f"{field}: factor", factor, *FACTORS, "", hint)
        return factor
    if "equivalent" in said:
        length = get("equivalent", "m")
        positive(f"{field}: equivalent", length, "m")
        return length / part.length
    return None


def _hose_layer(field: str, said: Mapping[str, object]) -> float:
    """Return the resistance of a hose's slip layer, divided by the resistance of the slip layer in a pipe.

    The value comes from the entry `layer` of the hose; without this entry it is 1. `field` is the name of the hose in
    messages.
    """
    layer = float(amount(f"{field}: layer", said.get("layer", 1.0), "1"))
    positive(f"{field}: layer", layer, "")
    if not HOSE_LAYER[0] <= layer <= HOSE_LAYER[1]:
        warn(
            f"{field}: layer = {layer:g}: is unusual: hoses have {HOSE_LAYER[0]:g} to {HOSE_LAYER[1]:g} times the "
            "resistance of a pipe; write per cent with the sign, as in '80 %'"
        )
    return layer
