"""Data sheet of a concrete pump: its limits of pressure, flow and power."""

from collections.abc import Mapping
from dataclasses import dataclass

from ..core.errors import one_of, positive, refuse
from ..core.inputs.amounts import amount
from ..core.inputs.limits import check_limit
from ..core.inputs.text_files import errors_located_at

PUMP = {
    "pressure": ("Pa", "Largest pressure on the concrete"),
    "flow": ("m3/s", "Largest volume flow"),
    "power": ("W", "Power of the motor"),
}
"""Entries of a pump in a pipeline file, with their units and meaning. If the file has a single value instead of these
entries, this value is the pressure."""
WEAKEST = 1e5
"""Smallest accepted value of a pump's pressure limit [Pa]. A smaller number is most likely in bar or MPa without its
unit."""


@dataclass(frozen=True)
class Pump:
    """Limits of a concrete pump; a limit that is not known is None."""

    pressure: float
    """Largest pressure of the pump on the concrete [Pa]."""
    flow: float | None = None
    """Largest volume flow of the pump [m3/s]."""
    power: float | None = None
    """Power of the pump's motor [W]."""


def pump_of(given: object) -> Pump:
    """Return the pump that the entry `given` describes: its pressure, or a mapping with the keys :data:`PUMP`.

    Raises :class:`SceneError` for a wrong key or value, or if there is no pressure.
    """
    entries = given if isinstance(given, Mapping) else {"pressure": given}
    amounts = {}
    for key, value in entries.items():
        with errors_located_at(entries, key):
            one_of("pump's key", key, PUMP)
            called, unit = f"pump {key}", PUMP[key][0]
            amounts[key] = amount(called, value, unit)
            positive(called, amounts[key], unit)
            if key == "pressure" and amounts[key] < WEAKEST:
                problem = f"must be at least {WEAKEST:g} Pa; concrete pumps deliver 30 to 400 bar"
                refuse(called, amounts[key], problem, "write the unit, for example '70 bar'")
            check_limit(called, amounts[key], unit, key)
    if "pressure" not in amounts:
        hint = "add the largest pressure from the data sheet, for example 'pressure: 85 bar'"
        refuse("pump", dict(entries), "has no 'pressure'", hint)
    return Pump(**amounts)
