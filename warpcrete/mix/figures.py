"""Properties calculated from a mix, each with an uncertainty band, the entry from which it follows, and its source."""

from dataclasses import dataclass, replace

from ..core.errors import refuse
from ..theory.fits import student_t

INSTRUMENTS = 2.0
"""Largest accepted ratio between a value from a rheometer and a value from a slump cone for the same property.

If their uncertainty bands do not overlap, the ratio is taken between the two band ends that are nearest to each other.
With a larger ratio, the values contradict each other. The factor is an assumption; even rheometers differ from one
another (Ferraris & Martys 2003; RILEM TC 266-MRP 2023).
"""

CONES = 3.0
"""Largest accepted ratio between two yield stresses that follow from the spread and from the slump of one cone.

If their uncertainty bands do not overlap, the ratio is taken between the two band ends that are nearest to each other.
With a larger ratio, the two measurements contradict each other. In 80 pairs of measurements by Yeh (2007), the ratio
reaches 1.6.
"""


@dataclass(frozen=True)
class Figure:
    """Calculated or measured property of a concrete."""

    name: str
    value: float
    low: float
    high: float
    """Upper end of the uncertainty band, in which the true value is expected; its lower end is `low`, both in
    `unit`."""
    unit: str
    way: str
    """Origin of the value: the entry of the mix from which it follows, such as 'slump of 200 mm'."""
    source: str
    """Publication of the relation from which the value follows, and a remark on how reliable the value is."""
    instrument: str = "rheometer"
    """Kind of instrument whose errors affect the value: 'cone' for slump, spread and T500, otherwise 'rheometer'."""

    def __post_init__(self) -> None:
        assert self.low <= self.value <= self.high, self

    @property
    def span(self) -> str:
        """The property's value, its uncertainty band and its unit as text, such as '30 (20 to 45) Pa s'."""
        band = "" if self.low == self.high else f" ({short(self.low)} to {short(self.high)})"
        return f"{short(self.value)}{band} {self.unit}"


def short(value: float) -> str:
    """Return a number as text with three significant digits. Numbers from 0.0001 to 999999 have no exponent."""
    return f"{float(f'{value:.3g}'):g}"


def around(name: str, value: float, off: float, unit: str, way: str, source: str) -> Figure:
    """Return a property whose uncertainty band reaches from (1 - `off`) to (1 + `off`) times its value.

    `way` names the entry of the mix from which the value follows.
    """
    return Figure(name, value, value * (1 - off), value * (1 + off), unit, way, source)


def reconciled(candidates: list[Figure]) -> tuple[Figure, list[str]]:
    """Return the first of several values for one property, after a check that the other values do not contradict it.

    The result also contains remarks on differences between the values. The values come from different entries of the
    mix, and each has an uncertainty band. If two bands do not overlap, take the ratio of the higher band's lower end to
    the lower band's upper end. This ratio has a limit:

    - 1 for two values from rheometers, so that their bands must overlap.
    - :data:`INSTRUMENTS` for a value from a rheometer and a value from a slump cone.
    - :data:`CONES` for two values that follow from spread and slump. The band of the result is then widened until it
      reaches the other band.

    Raises :class:`SceneError` if a ratio is too large.
    """
    first, remarks = candidates[0], []
    for other in candidates[1:]:
        apart = max(other.low / max(first.high, 1e-9), first.low / max(other.high, 1e-9))
        words = f"{first.name}: {first.span} from {first.way}, but {other.span} from {other.way}"
        cones = first.instrument == other.instrument == "cone"
        if apart > (CONES if cones else INSTRUMENTS if first.instrument != other.instrument else 1.0):
            refuse(f"mix {first.name}", f"{first.span} from {first.way}", f"contradicts {other.span} from {other.way}",
                   "leave out the less reliable measurement, or state its uncertainty")  # fmt: skip
        if apart > 1 and cones:
            remarks.append(f"{words}; the first is used, and its band is widened up to the band of the second")
            first = replace(first, low=min(first.low, other.high), high=max(first.high, other.low))
        elif apart > 1:
            remarks.append(f"{words}; the first value is used, because instruments often differ by as much")
    return first, remarks


def line_uncertainty(error: float, count: int, value: float, default: float) -> float:
    """Return the uncertainty of a slope or intercept of a straight line through `count` points, in the unit of `value`.

    With three or more points, the result is the half width of the 95 % confidence interval, which follows from the
    standard `error`. Two points give no standard error; the result is then the fraction `default` of the `value`.
    """
    if count < 3:
        return default * abs(value)
    return student_t(count - 2) * error


def of_line(name: str, value: float, off: float, unit: str, way: str, count: int) -> Figure:
    """Return a property of concrete that was measured as the slope or the intercept of a straight line.

    The line goes through `count` points, which `way` describes in messages. `off` is the uncertainty of the value, in
    `unit`. Raises :class:`SceneError` if the value is negative, or if it is a viscosity of zero.
    """
    viscous = unit.startswith("Pa s")
    if value < 0 or (viscous and value == 0):
        refuse(f"mix {name}", round(value, 6), f"follows from a straight line through measured points ({way}), but "
               f"must be {'above 0' if viscous else '0 or more'} {unit}",
               "check the points and their units")  # fmt: skip
    source = "straight line, 95 %" if count > 2 else "straight line; two points give no uncertainty"
    return Figure(name, value, max(value - off, 0.1 * value if viscous else 0.0), value + off, unit, way, source)
