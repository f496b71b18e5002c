"""Results of a run that has ended or was interrupted: its series, quantities, plots and recording."""

from __future__ import annotations

import difflib
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..drawing.html import html_table
from ..errors import RunFolderError, WarpcreteError, refuse
from ..narrowing import is_dict
from ..units import number, shown
from .viewer import LOOPBACK, Viewer, has_screen, screen_viewer, web_viewer

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame  # pyright: ignore[reportMissingTypeStubs]

DEFAULT_PLOT_COLUMNS = ("pressure", "spread", "front", "inside")
"""Names of columns in order of preference: by default, a plot shows the first of them that the series contains."""


@dataclass(frozen=True)
class Table:
    """Table of a run's results over a coordinate: columns of equal length by name, and the unit of each column."""

    columns: dict[str, np.ndarray]
    units: dict[str, str]


@dataclass(repr=False)
class Run:
    """Results of a finished or interrupted run."""

    scene: Any
    series: dict[str, np.ndarray]
    """Columns of the series by name, as arrays with one entry per sample."""
    units: dict[str, str]
    """Unit of each column of the time series, by the column's name."""
    result: dict[str, Any]
    """Quantities of the whole run: `{"value", "unit"}` if a quantity has a unit, otherwise a plain number."""
    finished: bool
    interrupted: bool = False
    """True if an interruption (Ctrl-C) ended the run at once, before it reached the next sample."""
    folder: Path | None = None
    tables: dict[str, Table] = field(default_factory=dict[str, Table])
    """Tables of the run's results over a coordinate other than time, such as the radius, by file name."""

    def __repr__(self) -> str:
        ended = "finished" if self.finished else "not finished"
        time = self.result.get("simulated_time", {}).get("value", 0.0)
        where = f", folder '{self.folder}'" if self.folder else ""
        count = len(next(iter(self.series.values()), ()))
        return (
            f"<{type(self).__name__} of scene {self.scene.name!r}: {ended}, {time:.4g} s, {count} samples of "
            f"{len(self.series)} columns{where}>"
        )

    def __getitem__(self, name: str) -> float:
        """Return a quantity of the whole run in SI units; `run.result` has its unit.

        Raises :class:`KeyError`, with similar names, if the run does not have the quantity.
        """
        if name not in self._numbers():
            similar = difflib.get_close_matches(name, self._numbers(), 3)
            what = f"; similar names are {', '.join(similar)}" if similar else f"; it has {', '.join(self._numbers())}"
            raise KeyError(f"the run has no quantity {name!r}{what}")
        return self._numbers()[name]

    def _ipython_key_completions_(self) -> list[str]:
        return list(self._numbers())

    def _numbers(self) -> dict[str, float]:
        found: dict[str, float] = {}
        for name, entry in self.result.items():
            if is_dict(entry):
                entry = entry["value"] if set(entry) == {"value", "unit"} else None
            if isinstance(entry, int | float) and not isinstance(entry, bool):
                found[name] = number(entry)
        return found

    def table(self) -> DataFrame:
        """Return the series as a pandas DataFrame in SI units, with one row per sample and `time` [s] as index.

        The units of the columns are in `attrs["units"]` of the DataFrame. Raises :class:`WarpcreteError` if pandas is
        not installed.
        """
        return dataframe(self.series, self.units, "time")

    def plot(self, *columns: str, against: str = "time") -> Figure:
        """Return a Matplotlib figure of columns of the series over another column; columns of one unit share an axis.

        By default, the figure shows the pressure, the spread, the position of the front or the remaining concrete,
        whichever the run has first. Raises :class:`SceneError` for a column that the run does not have.
        """
        from matplotlib.figure import Figure

        if not columns:
            columns = tuple(name for name in DEFAULT_PLOT_COLUMNS if name in self.series)[:1] or tuple(self.series)[1:2]
        for name in (*columns, against):
            if name not in self.series:
                refuse("column", name, f"must be one of {', '.join(self.series)}")
        units = list(dict.fromkeys(self.units[name] for name in columns))
        figure = Figure(figsize=(7, 1.2 + 2.8 * len(units)), layout="constrained")
        every = np.atleast_1d(figure.subplots(len(units), 1, sharex=True))
        scale, along = shown(self.units[against]) if against != "time" else (1.0, "s")
        for axes, unit in zip(every, units, strict=True):
            factor, shown_unit = shown(unit)
            same_unit = [name for name in columns if self.units[name] == unit]
            for name in same_unit:
                axes.plot(
                    scale * self.series[against], factor * self.series[name], label=_column_title(name), linewidth=1.6
                )
            axes.set_ylabel(
                f"{_column_title(same_unit[0])} [{shown_unit}]" if len(same_unit) == 1 else f"[{shown_unit}]"
            )
            if len(same_unit) > 1:
                axes.legend(frameon=False, fontsize=9)
            axes.spines[["top", "right"]].set_visible(False)
        every[-1].set_xlabel(f"{_column_title(against)} [{along}]")
        figure.suptitle(  # pyright: ignore[reportUnknownMemberType]
            f"{self.scene.name}: {', '.join(map(_column_title, columns))}", fontsize=10
        )
        return figure

    def view(self, web: bool = False, bind: str = LOOPBACK) -> subprocess.Popen[bytes]:
        """Open the recording in the run's folder in Rerun's viewer, without waiting for the viewer to close.

        With `web`, a server shows the recording in a browser while this program runs, and its address is printed. The
        server listens on the IP address `bind`, which by default only this machine can reach. Raises
        :class:`RunFolderError` if there is no recording or no screen.
        """
        if self.folder is None:
            raise RunFolderError(
                "the run has no folder; only runs with a folder can be shown: run 'warpcrete run SCENE --out FOLDER'"
            )
        opened = viewer(self.folder, web, bind)
        process = opened.start()
        if web:
            print(opened.address)
        return process

    def _repr_html_(self) -> str:
        """Return the quantities as an HTML table for notebooks."""
        rows: list[tuple[str, object]] = []
        for name, entry in self.result.items():
            if is_dict(entry) and set(entry) == {"value", "unit"} and isinstance(entry["value"], float):
                rows.append((name, f"{entry['value']:.6g} {entry['unit']}"))
            elif isinstance(entry, bool | int | float | str):
                rows.append((name, f"{entry:.6g}" if isinstance(entry, float) else entry))
        return html_table(rows)


def dataframe(columns: Mapping[str, np.ndarray], units: Mapping[str, str], index: str) -> DataFrame:
    """Return columns as a pandas DataFrame, with the column `index` as its index if there is such a column.

    The units of the columns are in `attrs["units"]`. Raises :class:`WarpcreteError` if pandas is not installed.
    """
    try:
        import pandas  # pyright: ignore[reportMissingTypeStubs]
    except ImportError:
        raise WarpcreteError(
            "run.table needs pandas; run pip install 'warpcrete[notebook]', or use the arrays in run.series"
        ) from None
    found = pandas.DataFrame(dict(columns))
    if index in found:
        found = found.set_index(index)  # pyright: ignore[reportUnknownMemberType]
    found.attrs["units"] = dict(units)
    return found


def viewer(run: Path, web: bool = False, bind: str = LOOPBACK) -> Viewer:
    """Return Rerun's viewer for the recording in the folder `run`, or for the recording file `run`.

    With `web`, the viewer is a server for browsers, which listens on the IP address `bind`; otherwise it is a window.
    Raises :class:`RunFolderError` if there is no recording or no screen.
    """
    recording = run / "run.rrd" if run.is_dir() else run
    if not recording.is_file():
        raise RunFolderError(
            f"'{run}': contains no recording (run.rrd); record a new run with 'warpcrete run SCENE --out FOLDER'"
        )
    if not web and not has_screen():
        raise RunFolderError(f"'{run}': no screen was found (DISPLAY is not set); use --web to show the recording in "
                             f"a browser, or open {recording} elsewhere with 'rerun {recording.name}'")  # fmt: skip
    # The recording of an unfinished run has several files, which the viewer shows as one recording.
    parts = sorted(run.glob("run-[0-9]*.rrd")) if run.is_dir() else []
    return (web_viewer if web else screen_viewer)([recording, *parts], bind)


def _column_title(column: str) -> str:
    return column.replace("_", " ")
