"""A run that has ended, or was cut: its series and quantities, for people and programs."""

from __future__ import annotations

import difflib
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from .errors import RunFolderError, WarpcreteError, refuse
from .html import html_table
from .units import number, shown
from .viewer import LOOPBACK, Viewer, has_screen, screen_viewer, web_viewer

COURSES = ("pressure", "spread", "front", "inside")
"""Columns of which the first that a series has is what its plot shows."""


@dataclass(frozen=True)
class Table:
    """Columns of equal length by name, and the unit of each."""

    columns: dict[str, np.ndarray]
    units: dict[str, str]


@dataclass(repr=False)
class Run:
    """A finished (or interrupted) run."""

    scene: Any
    series: dict[str, np.ndarray]
    """One array a column, one entry a sample."""
    units: dict[str, str]
    """Unit of each column."""
    result: dict[str, Any]
    """Quantities of the whole run: those with a unit are `{"value", "unit"}`, pure numbers stand plain."""
    finished: bool
    interrupted: bool = False
    """Cut at once by an interruption (Ctrl-C), not at a sample."""
    folder: Path | None = None
    tables: dict[str, Table] = field(default_factory=dict)
    """By the names of their files: what stands along something else than time."""

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
        """A quantity of the whole run, in SI units; `run.result` has its unit.

        Raises :class:`KeyError`, with names that are alike, for one that the run does not have.
        """
        if name not in self._numbers():
            alike = difflib.get_close_matches(name, self._numbers(), 3)
            what = f"; similar names are {', '.join(alike)}" if alike else f"; it has {', '.join(self._numbers())}"
            raise KeyError(f"the run has no quantity {name!r}{what}")
        return self._numbers()[name]

    def _ipython_key_completions_(self) -> list[str]:
        return list(self._numbers())

    def _numbers(self) -> dict[str, float]:
        found = {}
        for name, entry in self.result.items():
            if isinstance(entry, dict):
                entry = entry["value"] if set(entry) == {"value", "unit"} else None
            if isinstance(entry, int | float) and not isinstance(entry, bool):
                found[name] = number(entry)
        return found

    def table(self) -> Any:
        """The series as a pandas DataFrame in SI units, one row a sample, with `time` [s] as index; `attrs["units"]`
        has the units of its columns.

        Raises :class:`WarpcreteError` where pandas is not installed.
        """
        return dataframe(self.series, self.units, "time")

    def plot(self, *columns: str, against: str = "time") -> Any:
        """Matplotlib figure of columns of the series over another one; those of one unit share an axis.

        Without columns: pressure, spread, way of the front or what remains, whichever the run has. Raises
        :class:`SceneError` for a column that it does not have.
        """
        from matplotlib.figure import Figure

        if not columns:
            columns = tuple(name for name in COURSES if name in self.series)[:1] or tuple(self.series)[1:2]
        for name in (*columns, against):
            if name not in self.series:
                refuse("column", name, f"must be one of {', '.join(self.series)}")
        units = list(dict.fromkeys(self.units[name] for name in columns))
        figure = Figure(figsize=(7, 1.2 + 2.8 * len(units)), layout="constrained")
        every = np.atleast_1d(figure.subplots(len(units), 1, sharex=True))
        scale, along = shown(self.units[against]) if against != "time" else (1.0, "s")
        for axes, unit in zip(every, units, strict=True):
            factor, people = shown(unit)
            here = [name for name in columns if self.units[name] == unit]
            for name in here:
                axes.plot(scale * self.series[against], factor * self.series[name], label=_words(name), linewidth=1.6)
            axes.set_ylabel(f"{_words(here[0])} [{people}]" if len(here) == 1 else f"[{people}]")
            if len(here) > 1:
                axes.legend(frameon=False, fontsize=9)
            axes.spines[["top", "right"]].set_visible(False)
        every[-1].set_xlabel(f"{_words(against)} [{along}]")
        figure.suptitle(f"{self.scene.name}: {', '.join(map(_words, columns))}", fontsize=10)
        return figure

    def view(self, web: bool = False, bind: str = LOOPBACK) -> subprocess.Popen[bytes]:
        """Open the recording of the run's folder in Rerun's viewer and go on.

        With `web` a server shows it in a browser, at the address that is printed, as long as this program runs; `bind`
        is the IP address that it listens on, by default that of this machine alone. Raises :class:`RunFolderError` if
        there is no recording, or no screen.
        """
        if self.folder is None:
            raise RunFolderError(
                "the run has no folder; run 'warpcrete run SCENE --out FOLDER' to get a folder with a recording"
            )
        opened = viewer(self.folder, web, bind)
        process = opened.start()
        if web:
            print(opened.address)
        return process

    def _repr_html_(self) -> str:
        """Its quantities as a table, for notebooks."""
        rows = []
        for name, entry in self.result.items():
            if isinstance(entry, dict) and set(entry) == {"value", "unit"} and isinstance(entry["value"], float):
                rows.append((name, f"{entry['value']:.6g} {entry['unit']}"))
            elif isinstance(entry, bool | int | float | str):
                rows.append((name, f"{entry:.6g}" if isinstance(entry, float) else entry))
        return html_table(rows)


def dataframe(columns: Mapping[str, Any], units: Mapping[str, str], index: str) -> Any:
    """A pandas DataFrame with a column as index, if it is there, and the units of the columns in `attrs["units"]`.

    Raises :class:`WarpcreteError` where pandas is not installed.
    """
    try:
        import pandas
    except ImportError:
        raise WarpcreteError(
            "run.table needs pandas; run pip install 'warpcrete[notebook]', or use the arrays in run.series"
        ) from None
    found = pandas.DataFrame(dict(columns))
    if index in found:
        found = found.set_index(index)
    found.attrs["units"] = dict(units)
    return found


def viewer(run: Path, web: bool = False, bind: str = LOOPBACK) -> Viewer:
    """Return Rerun's viewer of a run folder's recording, or of the recording `run`, on the screen or in a browser.

    Raises :class:`RunFolderError` if there is none, or no screen.
    """
    recording = run / "run.rrd" if run.is_dir() else run
    if not recording.is_file():
        raise RunFolderError(f"'{run}': contains no run.rrd; record one with 'warpcrete run SCENE --out {run}'")
    if not web and not has_screen():
        raise RunFolderError(f"'{run}': no screen was found (DISPLAY is not set); use --web to show the recording in "
                             f"a browser, or open {recording} elsewhere with 'rerun {recording.name}'")  # fmt: skip
    # An unfinished run lies in parts; they are one recording to the viewer.
    parts = sorted(run.glob("run-[0-9]*.rrd")) if run.is_dir() else []
    return (web_viewer if web else screen_viewer)([recording, *parts], bind)


def _words(column: str) -> str:
    return column.replace("_", " ")
