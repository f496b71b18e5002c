"""Limits of parameters and of amounts in files: what is possible and what is usual, each with a reason.

A value outside the possible range is refused, and a value outside the usual range causes a warning. Both messages
suggest the unit that was probably meant, unless the user wrote a unit. The limits hold for scene functions, files and
the command. Objects at a lower level, such as :class:`warpcrete.theory.pipe.Concrete`, take any number that their own
rules allow, so that the physics can be tested at its extremes.
"""

import math
from dataclasses import dataclass

from ..errors import PlausibilityWarning, refuse
from ..errors import warn as warn_user
from ..written_numbers import written_text
from .amounts import CUSTOMARY, UNITS


@dataclass(frozen=True)
class Limit:
    """Limits of a quantity's magnitude, in the unit in which the program computes; zero is always allowed."""

    low: float
    high: float
    why: str
    """Reason for the limits. Errors and warnings about a value outside the limits contain this text."""
    usual: tuple[float, float] | None = None
    """Lower and upper end of the usual magnitudes; a positive value outside this range causes a warning. A negative
    value causes none, because other rules refuse it."""
    unit: str = ""
    """Unit of the limits, if they hold for one quantity only. It is empty if they hold for all quantities of a unit."""


LIMITS = {
    # Limits by unit. No pump, pipe, mix or concrete test comes near these numbers; beyond them, sums may overflow.
    "m": Limit(1e-7, 1e4, "a cement grain is 1e-5 m, the longest pumping lines are 2000 m"),
    "m2": Limit(1e-12, 1e6, "the cross-section of a pipe is 0.01 m2"),
    "m3": Limit(1e-9, 1e6, "a truck mixer carries 6 to 12 m3"),
    "W": Limit(1e-9, 1e9, "the largest concrete pumps have 500 kW"),
    "kg": Limit(1e-6, 1e9, "a truck mixer carries 15 to 25 t"),
    "m/s": Limit(1e-9, 1e3, "concrete is pumped at 0.1 to 3 m/s"),
    "m/s2": Limit(1e-9, 1e4, "gravity is 9.81 m/s2, centrifuges reach 1000 times as much"),
    "s": Limit(1e-12, 1e8, "time steps are microseconds, concrete sets within a day"),
    "1/s": Limit(1e-9, 1e6, "concrete is sheared at 1 to 100 1/s"),
    "Pa": Limit(1e-9, 1e13, "slip layers have a yield stress of some Pa, diamond a modulus of 1e12 Pa"),
    "Pa/s": Limit(1e-9, 1e6, "the yield stress of fresh concrete grows by 0.1 to 2 Pa/s at rest"),
    "Pa/m": Limit(1e-3, 1e9, "pumped concrete loses 1 to 50 kPa/m"),
    "Pa s": Limit(1e-6, 1e9, "air has a viscosity of 2e-5 Pa s, pitch of 1e8 Pa s"),
    "Pa s/m": Limit(1e-6, 1e13, "slip layers have 100 to 10000 Pa s/m"),
    "Pa s2": Limit(1e-9, 1e6, "1 Pa s2 adds 10 Pa s to the viscosity at 10 1/s"),
    "Pa s2/m2": Limit(1e-6, 1e13, "1000 Pa s2/m2 adds 300 Pa s/m to a slip layer at 0.3 m/s"),
    "kg/m3": Limit(50.0, 3e4, "foams have a density of 100 kg/m3, osmium of 22600 kg/m3"),
    "m3/s": Limit(1e-12, 1.0, "the largest concrete pumps deliver 0.06 m3/s (200 m3/h)"),
    "N": Limit(1e-12, 1e9, "a grain of sand weighs 1e-5 N, the piston of the largest pumps pushes with 2e6 N"),
    "N/m": Limit(1e-9, 1e13, "simulated contacts have stiffnesses of 1e3 to 1e8 N/m"),
    "m2/N": Limit(1e-30, 1.0, "steel has a wear coefficient of 1e-13 to 1e-12 m2/N"),
    "degrees": Limit(1e-6, 360.0, "a full turn has 360 degrees"),
    "": Limit(1e-12, 1e9, "ratios are near 1"),
    # Limits by name, for quantities whose usual range is narrower than the usual range of other quantities with the
    # same unit.
    "diameter": Limit(1e-3, 10.0, "concrete pipes have diameters of 0.05 to 0.2 m", (0.01, 0.5), "m"),
    "flow": Limit(1e-12, 1.0, "the largest concrete pumps deliver 0.06 m3/s (200 m3/h)", (1e-7, 0.12), "m3/s"),
    "velocity": Limit(1e-6, 100.0, "concrete is pumped at 0.1 to 3 m/s", (1e-4, 10.0), "m/s"),
    "density": Limit(300.0, 2.5e4, "foamed concrete has 400 kg/m3, concrete 1800 to 2600, steel 7850",
                     (900.0, 8000.0), "kg/m3"),
    "bulk_density": Limit(300.0, 2.5e4, "foamed concrete has 400 kg/m3, normal concrete 2000 to 2600",
                          (900.0, 8000.0), "kg/m3"),
    "viscosity": Limit(1e-5, 1e8, "concrete has 5 to 1000 Pa s, water 0.001", (1e-3, 1e5), "Pa s"),
    "yield_stress": Limit(1e-6, 1e9, "concrete has 10 to 3000 Pa", (1e-3, 1e5), "Pa"),
    "slip_viscosity": Limit(1e-3, 1e12, "slip layers have 100 to 10000 Pa s/m; use a large value for no slip", None,
                            "Pa s/m"),
    "slip_yield": Limit(1e-6, 1e9, "slip layers have 0 to 500 Pa", (1e-3, 1e5), "Pa"),
    "flow_index": Limit(0.1, 4.0, "it is 1 for a Bingham fluid, below 1 if concrete thins, above 1 if it thickens",
                        (0.3, 2.5), "1"),
    "slip_flow_index": Limit(0.1, 4.0, "it is 1 for a linear layer, below 1 for paste that thins", (0.3, 2.5), "1"),
    "yield_factor": Limit(1e-3, 1e3, "a factor of 1 leaves the yield stresses as they are", (0.1, 10.0), "1"),
    "viscosity_factor": Limit(1e-3, 1e3, "a factor of 1 leaves the viscosities as they are", (0.1, 10.0), "1"),
    "length": Limit(1e-4, 1e4, "the longest pumping lines are 2000 m", None, "m"),
    "bend_radius": Limit(1e-4, 1e4, "bends of pumping lines have radii of 0.2 to 5 m", (0.02, 50.0), "m"),
    "size_max": Limit(1e-5, 1.0, "coarse aggregate has sizes of 4 to 63 mm", (1e-4, 0.3), "m"),
    "size_min": Limit(1e-6, 1.0, "coarse aggregate has sizes of 4 to 63 mm", (1e-5, 0.3), "m"),
    "pressure": Limit(1e-9, 1e9, "concrete pumps deliver 3e6 to 5e7 Pa (30 to 500 bar)", (100.0, 1e8), "Pa"),
    "recorded": Limit(1e-9, 1e9, "concrete pumps deliver 3e6 to 5e7 Pa (30 to 500 bar)", (1e4, 1e8), "Pa"),
    "modulus": Limit(1e-1, 1e12, "granite has 5e10 Pa; simulated grains are softer", None, "Pa"),
    "bond_modulus": Limit(1e-3, 1e12, "steel has 2e11 Pa", None, "Pa"),
    "spacing": Limit(1e-6, 10.0, "cells have sizes of 1 to 20 mm", None, "m"),
    "duration": Limit(1e-9, 1e7, "concrete sets within a day, 1e5 s", None, "s"),
    "gravity": Limit(1e-6, 1e4, "gravity is 9.81 m/s2, centrifuges reach 1000 times as much", None, "m/s2"),
    "time_step": Limit(1e-12, 1e3, "time steps are 1e-7 to 0.02 s", None, "s"),
    "sample_interval": Limit(1e-9, 1e6, "samples are 0.001 to 1 s apart", None, "s"),
    "regularisation": Limit(1e-9, 1e12, "usual values are 100 to 1e5 s", None, "s"),
    "slump": Limit(1e-5, 3.0, "the cone is 0.3 m high", (1e-4, 0.3), "m"),
    "spread": Limit(1e-2, 10.0, "the cone spreads to 0.2 to 0.9 m", (0.1, 2.0), "m"),
    "frames": Limit(1e-9, 1e6, "recordings have 1 to 1000 frames per simulated second", None, "1/s"),
    "checkpoint_every": Limit(1e-12, 1e8, "the default is a checkpoint every 60 s", None, "s"),
    "budget": Limit(1e-12, 1e8, "trade-off studies take minutes to hours", None, "s"),
    "rest": Limit(1e-6, 1e6, "concrete sets within a day, 1e5 s", (1e-3, 4e4), "s"),
}  # fmt: skip
"""Limits of quantities. A key is either the name of a quantity or a unit; the limits of a unit apply to all quantities
in this unit whose names are not keys."""
LARGEST_INTEGER = 2**31 - 1
"""Largest integer that a parameter may have, because kernels and arrays count with 32 bits."""
LARGEST_SEED = 2**63 - 1
FASTEST = 10.0
"""Mean flow velocity above which a warning is given [m/s]; concrete is pumped at 0.1 to 3 m/s."""


def limit_of(name: str, unit: str) -> Limit | None:
    """Return the limits of a quantity, or None if it has none.

    The limits listed in :data:`LIMITS` under the quantity's `name` take precedence if they are in the unit `unit`.
    Otherwise, return the limits listed under the unit, which hold for all quantities with this unit.
    """
    unit = "" if unit in ("1", "m3/m3") else unit
    named = LIMITS.get(name)
    if named is not None and named.unit == (unit or "1"):
        return named
    return LIMITS.get(unit)


def check_limit(field: str, value: float, unit: str, name: str = "") -> None:
    """Refuse an impossible value of `field`, and warn about an unlikely value; the value has the unit `unit`.

    The limits of the quantity `name` apply, or the limits of the quantity `field` if `name` is empty.
    """
    limit = limit_of(name or field, unit)
    if limit is None:
        return
    shown = f" {unit}" if unit not in ("", "1", "m3/m3") else ""
    if not math.isfinite(value):
        refuse(field, value, f"must be a finite number{shown}")
    size = abs(value)
    if size and not limit.low <= size <= limit.high:
        problem = f"is impossible: must be {limit.low:g} to {limit.high:g}{shown} ({limit.why})"
        refuse(field, value, problem, _meant(value, unit, limit))
    if value > 0 and limit.usual is not None and not limit.usual[0] <= value <= limit.usual[1]:
        suggestion = _meant(value, unit, limit)
        stated = written_text(value) or f"{value:g}{shown}"
        warn(f"{field} = {stated}: is unusual: {limit.why}{f'; {suggestion}' if suggestion else ''}")


def check_whole(field: str, value: int) -> None:
    """Refuse an integer whose magnitude is too large for a counter or for the seed of random numbers."""
    least, most = (0, LARGEST_SEED) if field == "seed" else (-LARGEST_INTEGER, LARGEST_INTEGER)
    if abs(value) > most:
        refuse(field, value, f"must be from {least} to {most}" if value < 0 else f"must be at most {most}")


def check_velocity(field: str, value: float, velocity: float) -> None:
    """Refuse or warn about a value of `field` that leads to an impossible or unlikely mean velocity.

    `velocity` is this mean velocity of the concrete [m/s]. The message shows it together with `value`, which the user
    set.
    """
    limit = LIMITS["velocity"]
    if not velocity <= limit.high:
        refuse(field, value, f"makes the concrete flow at {velocity:.3g} m/s, but at most {limit.high:g} m/s is "
               f"possible ({limit.why})", "check the flow, the diameter and their units")  # fmt: skip
    if velocity > FASTEST:
        stated = written_text(value) or f"{value:g}"
        warn(f"{field} = {stated}: makes the concrete flow at {velocity:.3g} m/s, which is unusual: {limit.why}")


def warn(text: str) -> None:
    """Give a :class:`PlausibilityWarning` with one line of text."""
    warn_user(text, PlausibilityWarning)


def _meant(value: float, unit: str, limit: Limit) -> str:
    """Return a question such as "did you mean 5 cm or 5 in?", with units in which the number would be usual.

    The question names at most one metric and one customary US unit. It is empty if the user wrote a unit, or if the
    number is usual in no unit, is negative, or is so small or large that another unit cannot explain it.
    """
    low, high = limit.usual or (limit.low, limit.high)
    if limit.usual is None and limit_of("", unit) is limit:
        return ""  # Limits of all quantities in one unit are too wide to show which unit was meant.
    if written_text(value) or not 1e-2 <= value <= 1e6:
        # The user wrote a unit, or the number is negative or so small or large that no other unit can explain it.
        return ""
    possible = [
        other for other, factor in UNITS.get(unit, {}).items() if factor != 1.0 and low <= value * factor <= high
    ]
    # An inch or a cubic yard may be as usual as a metric unit, and only the user knows which one was meant.
    customary = next((other for other in possible if other in CUSTOMARY), None)
    shown = possible[:1] + ([customary] if customary not in (None, *possible[:1]) else [])
    return f"did you mean {' or '.join(f'{value:g} {other}' for other in shown)}?" if shown else ""
