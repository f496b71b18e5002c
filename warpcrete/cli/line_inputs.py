"""Line and concrete of the command `warpcrete line`: read from files, or described by a few options."""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import click

from ..core.errors import between, positive, refuse
from ..core.inputs.amounts import accepted_units, amount, is_customary
from ..core.inputs.concretes import NamedConcrete
from ..core.inputs.concretes import concrete as named
from ..core.inputs.limits import check_limit, check_velocity
from ..core.inputs.text_files import errors_in_file
from ..geometry.axis import Axis, Line
from ..geometry.customary_labels import as_customary
from ..geometry.pipe_line import Part, PipeLine
from ..geometry.pumps import pump_of
from ..mix.mix import Mix, flow_amounts, mix_named, mix_of
from ..mix.stones import SMALLEST, sizes_by_number
from ..mps.common.mixes import concrete_of
from ..studies.lines.losses import ASSUMED_DENSITY, read_line, with_stone
from ..theory.pipe import Concrete

SHAPE = ("diameter", "length", "rise")
"""Options that describe a straight pump line, for a user who has no file that describes the line."""
MEASURES = (*SHAPE, "slump", "spread", "stone", "flow", "pump_pressure", "pump_flow", "pump_power")
"""Options whose amounts may have customary US units."""
EXAMPLE = "--diameter '125 mm' --length '190 m' --rise '20 m'"


@dataclass(frozen=True)
class LineInputs:
    """Inputs of the command `warpcrete line`: a line, a concrete and a flow."""

    line: PipeLine
    name: str
    """Name or file of the concrete; if the user stated only slump or spread, a text such as "slump 180 mm"."""
    mix: Mix | None
    """Mix design of the concrete, such as its amounts of cement and water; None if the concrete has only flow
    properties."""
    flow: float | None
    """Volume flow [m3/s]; None if neither the line nor an option states it."""

    guessed: bool = False
    """True if the user stated only the slump or spread of the concrete."""

    @functools.cached_property
    def factors(self) -> tuple[float, float]:
        """Factors on yield stresses and on viscosities from the concrete's file, for its age or temperature."""
        if self.mix is not None:
            return self.mix.factors
        stated = flow_amounts(self.source or named(self.name))
        return stated.get("yield_factor", 1.0), stated.get("viscosity_factor", 1.0)

    @functools.cached_property
    def source(self) -> NamedConcrete | None:
        """Contents of the concrete's file, or a shipped concrete; None if the user stated only the slump or spread."""
        return None if self.guessed else named(self.name)

    @functools.cached_property
    def concrete(self) -> Concrete:
        """Flow properties of the concrete, which is a yield stress fluid with a slip layer."""
        if self.guessed and self.mix is not None:
            return self.mix.concrete
        return replace(concrete_of(self.name), name=named(self.name).name)


def line_inputs(line: str | None, settings: Mapping[str, object]) -> LineInputs:
    """Return the line, concrete and flow that the options of the command describe.

    Raises :class:`SceneError` for an impossible value, and `click.UsageError` if an option is missing or contradicts
    another option.
    """
    given = _straight(settings) if line is None else _from_file(line, settings)
    given = _with_pump(given, {key: settings[f"pump_{key}"] for key in ("pressure", "flow", "power")})
    if any(is_customary(settings[name]) for name in MEASURES):
        given = as_customary(given)
    sizes = None if settings["stone"] is None else sizes_by_number("stone", settings["stone"])
    stone = sizes[1] if sizes is not None else _amount("stone", settings, "m", "size_max")
    guess = _guessed(settings, stone)
    name = guess.name if guess is not None else settings["concrete"] or given.concrete
    if name is None:
        raise click.UsageError(
            "concrete: is missing; set it in the file of the line, with --concrete no1 or a file, "
            "or with --slump '180 mm'"
        )
    from_file = line is not None and settings["concrete"] is None
    with errors_in_file(line if from_file else None):
        mix = guess if guess is not None else mix_named(str(name))
    if stone is not None:
        given = with_stone(given, stone)
    elif mix is not None and given.largest_stone is None:
        given = with_stone(given, mix.given.largest)
    return LineInputs(given, str(name), mix, _flow(settings, given, guess is not None), guess is not None)


def _amount(name: str, settings: Mapping[str, object], unit: str, limited: str = "") -> float | None:
    """Return the value of the option `name` as a positive number in `unit`, or None if the option is missing.

    The number must lie within the limits of the quantity `limited`, or of the quantity `name` if `limited` is empty.
    """
    if settings[name] is None:
        return None
    value = amount(name, settings[name], unit)
    positive(name, value, unit)
    check_limit(name, value, unit, limited or name)
    return value


def _from_file(line: str, settings: Mapping[str, object]) -> PipeLine:
    """Read a line from its file; refuse the options `--diameter`, `--length` and `--rise` next to a file."""
    for name in SHAPE:
        if settings[name] is not None:
            # The shell passes the unit of an amount such as 180 mm as a word of its own.
            hint = f"leave out --{name}, or the file"
            if any(line in accepted_units(unit) for unit in ("m", "m3/s", "Pa")):
                hint = f"'{line}' was taken as this file; write an amount without a space or in quotes, as in '180 mm'"
            raise click.UsageError(
                f"{name} = {settings[name]!r}: cannot be given together with the file of a line; {hint}"
            )
    return read_line(line)


def _straight(settings: Mapping[str, object]) -> PipeLine:
    """Return a line that consists of one straight pipe, from the options `diameter`, `length` and `rise`."""
    if all(settings[name] is None for name in SHAPE):
        raise click.UsageError(f"line: is missing; give its file, or a straight line as {EXAMPLE}")
    diameter, length = _amount("diameter", settings, "m"), _amount("length", settings, "m")
    for name, value in (("diameter", diameter), ("length", length)):
        if value is None:
            raise click.UsageError(f"{name}: is missing; a line without a file needs --{name}, as in {EXAMPLE}")
    assert diameter is not None and length is not None
    rise = 0.0
    if settings["rise"] is not None:
        rise = amount("rise", settings["rise"], "m")
        between("rise", rise, -length, length, "m", "it is the height gained over the whole length")
    slope = rise / length
    axis = Axis((0.0, 0.0, 0.0), (math.sqrt(1 - slope * slope), 0.0, slope), (Line(length),))
    return PipeLine("straight line", (Part(1, "straight", diameter, length, rise, diameter),), axis)


def _guessed(settings: Mapping[str, object], stone: float | None) -> Mix | None:
    """Return a mix that is estimated from the slump or spread in the options; None if the options contain neither.

    `stone` is the diameter of the largest stone [m], or None.
    """
    cones = {name: settings[name] for name in ("slump", "spread") if settings[name] is not None}
    if not cones:
        return None
    if settings["concrete"] is not None:
        name, value = next(iter(cones.items()))
        raise click.UsageError(
            f"{name} = {value!r}: cannot be given together with --concrete; state the {name} in the "
            "file of the concrete"
        )
    entries: dict[str, Any] = {"density": ASSUMED_DENSITY, **cones}
    if stone is not None:
        if stone < 2 * SMALLEST:
            refuse("stone", stone, f"must be at least {2 * SMALLEST:g} m", "leave out --stone for mortar")
        entries["sizes"] = [SMALLEST, stone]
    return mix_of(entries, name=", ".join(f"{name} {value}" for name, value in cones.items()))


def _flow(settings: Mapping[str, object], line: PipeLine, guessed: bool) -> float | None:
    """Return the volume flow [m3/s] that the option `--flow` states or, without this option, the file of the line.

    A flow may be missing if the slip layer is fitted to measured pressures, or if the user stated only the slump or
    spread of the concrete (`guessed`). The result is then None. In all other cases, a missing flow raises
    `click.UsageError`.
    """
    rate = _amount("flow", settings, "m3/s")
    if rate is None:
        if line.flow is None and settings["fit"] is None and not guessed:
            raise click.UsageError("flow: is missing; set it in the file of the line, or with --flow '30 m3/h'")
        return line.flow
    narrow = min(part.narrow for part in line.parts)
    check_velocity("flow", rate, 4 * rate / (math.pi * narrow**2))
    return rate


def _with_pump(line: PipeLine, limits: Mapping[str, str | None]) -> PipeLine:
    """Return the line with a pump whose limits of pressure, flow and power come from the command's options.

    A limit that no option states is taken from the pump in the line's file, if the file describes a pump.
    """
    stated = {key: value for key, value in limits.items() if value is not None}
    if not stated:
        return line
    if line.pump is not None:
        own = {key: getattr(line.pump, key) for key in limits if getattr(line.pump, key) is not None}
        stated = {**own, **stated}
    return replace(line, pump=pump_of(stated))
