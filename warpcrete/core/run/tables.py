"""Tables of results, and their conversion to the tables of pandas and xarray, which are optional packages."""

from __future__ import annotations

import importlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import WarpcreteError
from ..narrowing import is_number
from .columns import Columns

if TYPE_CHECKING:
    from pandas import DataFrame  # pyright: ignore[reportMissingTypeStubs]


@dataclass(frozen=True, repr=False)
class Table:
    """Table of a run's results over a coordinate, such as the radius: columns of equal length, and their units."""

    columns: dict[str, np.ndarray]
    """Arrays of shape (n,) by the name of the column."""
    units: dict[str, str]
    """Unit of each column, by the column's name."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", Columns(self.columns, self.units))

    def __repr__(self) -> str:
        return repr(self.columns)

    def _repr_html_(self) -> str:
        """Return a summary of the columns as an HTML table for notebooks."""
        return Columns(self.columns, self.units).html()


def dataframe(
    columns: Mapping[str, Sequence[Any] | np.ndarray],
    units: Mapping[str, str],
    index: str,
    instead: str = "the arrays in run.series",
) -> DataFrame:
    """Return columns as a pandas DataFrame, with the column `index` as its index if there is such a column.

    The units of the columns are in `attrs["units"]`. Raises :class:`WarpcreteError` if pandas is not installed; the
    message names `instead`, such as "the arrays in run.series", as another way to get the data.
    """
    try:
        import pandas  # pyright: ignore[reportMissingTypeStubs]
    except ImportError:
        raise WarpcreteError(f"table: needs pandas; run pip install pandas, or use {instead}") from None
    found = pandas.DataFrame(dict(columns))
    if index in found:
        found = found.set_index(index)  # pyright: ignore[reportUnknownMemberType]
    found.attrs["units"] = dict(units)
    return found


def dataset(
    columns: Mapping[str, Sequence[Any] | np.ndarray],
    units: Mapping[str, str],
    index: str,
    attributes: Mapping[str, str],
    instead: str = "the arrays in run.series",
) -> Any:
    """Return columns as an xarray Dataset with one dimension, whose coordinate is the column `index`.

    The attribute `attrs["units"]` of each variable is its unit, for xarray's plots and for pint, which requires
    exponents as in "m^3/s". The attribute `attrs["long_name"]` is its name with spaces. `attributes` become the
    attributes of the whole Dataset. Raises :class:`WarpcreteError` if xarray is not installed; the message names
    `instead`, such as "the arrays in run.series", as another way to get the data.
    """
    try:
        xarray: Any = importlib.import_module("xarray")
    except ImportError:
        raise WarpcreteError(f"to_xarray: needs xarray; run pip install xarray, or use {instead}") from None
    variables = {
        name: (index, _array(values), {"long_name": name.replace("_", " ")} | _unit_attribute(units.get(name, "")))
        for name, values in columns.items()
    }
    along = {name: variables.pop(name) for name in (index,) if name in variables}
    return xarray.Dataset(variables, along, dict(attributes))


def with_powers(unit: str) -> str:
    """Return the name of a unit in the notation of pint, in which exponents follow "^": "m^3/s" for "m3/s"."""
    return re.sub(r"([A-Za-z])([0-9])", r"\1^\2", unit)


def _unit_attribute(unit: str) -> dict[str, str]:
    return {"units": with_powers(unit)} if unit else {}


def unstacked(found: Any, names: Sequence[str]) -> Any:
    """Return the one-dimensional xarray Dataset `found` as a grid whose dimensions are the variables `names`.

    No two rows may have the same values of these variables. At grid points without a row, numbers are NaN and texts are
    empty.
    """
    (index,) = found.dims
    found = found.reset_index(index).reset_coords(index).set_coords(list(names))
    along = {name: found[name].values.tolist() for name in names}
    axes = {name: list(dict.fromkeys(values)) for name, values in along.items()}
    axes = {name: sorted(axis) if all(map(is_number, axis)) else axis for name, axis in axes.items()}
    place = tuple([axes[name].index(value) for value in along[name]] for name in names)
    variables = {}
    for name, variable in found.data_vars.items():
        values = variable.values
        numeric = values.dtype.kind in "fiu"
        whole = np.full([len(axis) for axis in axes.values()], np.nan if numeric else "", float if numeric else object)
        whole[place] = values
        variables[name] = (tuple(names), whole, variable.attrs)
    coordinates = {name: (name, _array(axis), found[name].attrs) for name, axis in axes.items()}
    return type(found)(variables, coordinates, found.attrs)


def _array(values: Sequence[Any] | np.ndarray) -> np.ndarray:
    """Return values as an array; in a column of numbers, a missing value (None) becomes NaN."""
    filled = [np.nan if value is None else value for value in values]
    return np.asarray(filled if all(map(is_number, filled)) else values)
