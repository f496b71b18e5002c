"""Functions that read option values with units, such as '10 min', without importing the simulations."""

from collections.abc import Sequence

from ..core.errors import refuse
from ..core.inputs.amounts import amount
from ..core.inputs.limits import check_limit

THIXOTROPY = 0.5
"""Default growth rate A_thix of the yield stress at rest [Pa/s], for moderate stiffening (Roussel 2006)."""
THIXOTROPY_BAND = (0.1, 1.0)
"""Usual range of the yield stress's growth rate at rest [Pa/s], for a concrete whose growth rate was not measured. The
lower end stands for hardly any stiffening, and the upper end for strong stiffening (Roussel 2006)."""
HIGHEST_THIXOTROPY = 1.7
"""Highest published growth rate of the yield stress at rest [Pa/s] (Roussel 2006)."""


def option_amount(field: str, given: str | None, unit: str) -> float | None:
    """Return the text `given` of an option as a number in `unit`, or None if the option is missing.

    `field` is the name of the option. Raises :class:`SceneError` for a wrong unit or an impossible value.
    """
    if given is None:
        return None
    value = amount(field, given, unit)
    check_limit(field, value, unit)
    return value


def option_amounts(field: str, given: Sequence[str], unit: str) -> list[float]:
    """Return the texts `given` of a repeatable option, whose name is `field`, as numbers in `unit`."""
    return [value for each in given if (value := option_amount(field, each, unit)) is not None]


def growth_of(rest: float | None, thixotropy: float | None) -> float:
    """Return the rate A_thix [Pa/s] at which the yield stress grows at rest: the stated rate, or the default.

    Raises :class:`SceneError` if a rate is stated without a time of rest.
    """
    if thixotropy is not None and rest is None:
        refuse("thixotropy", thixotropy, "needs the duration of the rest", "add, for example, --rest 600 for 600 s")
    return THIXOTROPY if thixotropy is None else thixotropy
