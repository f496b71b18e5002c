"""Results of a run that has ended or was interrupted: its series, quantities, plots and recording."""

from __future__ import annotations

import difflib
import itertools
import json
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..drawing.html import html_table
from ..drawing.style import SERIES, legend_above, new_figure, open_frame, rgb
from ..errors import RunFolderError, WarpcreteError, flag, one_of, refuse, warn, with_suggestions
from ..inputs.origin import readable
from ..narrowing import is_dict
from ..records import Record
from ..units import shown
from .columns import Columns
from .ending import Ending
from .files import LOCK, PARTIAL, cannot_write, check_new
from .folder_kinds import missing_recording
from .folders import FolderLock, new_folder
from .output import RunOutput, output_of
from .quantities import Quantities, Result, conditions_of
from .tables import Table, dataframe, dataset
from .viewer import LOOPBACK, Viewer, has_screen, is_recording, screen_viewer, web_viewer

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame  # pyright: ignore[reportMissingTypeStubs]

DEFAULT_PLOT_COLUMNS = ("pressure", "spread", "front", "inside")
"""Names of columns in order of preference: by default, a plot shows the first of them that the series contains."""


@dataclass(frozen=True)
class FinalState:
    """State at the end of a run without a folder, from which :meth:`Run.save` can write the folder."""

    simulation: Callable[..., Any]
    """Class of the simulation that computed this final state."""
    settings: Mapping[str, Any]
    """Keyword arguments of the simulation, such as its device and precision."""
    contents: Record = field(repr=False)
    """Contents of a checkpoint of the state, with arrays in host memory."""


@dataclass(repr=False)
class Run:
    """Results of a finished or interrupted run."""

    scene: Any
    series: dict[str, np.ndarray]
    """Columns of the run's time series by name, as arrays with one entry per sample. `print` shows the unit and the
    first, last, smallest and largest value of each column."""
    units: dict[str, str]
    """Unit of each column of the time series, by the column's name."""
    result: Record
    """Quantities of the whole run: `{"value", "unit"}` if a quantity has a unit, otherwise a plain number."""
    finished: bool
    """True if the run reached its end and all its files were written."""
    interrupted: bool = False
    """True if an interruption (Ctrl-C or SIGTERM) ended the run at once, before the next row of the time series."""
    folder: Path | None = None
    """Run folder; None if the run wrote none."""
    tables: dict[str, Table] = field(default_factory=dict[str, Table])
    """Tables of the run's results over a coordinate other than time, such as the radius, by file name."""
    final_state: FinalState | None = field(default=None, init=False, compare=False)
    """Final state of a run without a folder; None for a run with a folder, or if the state is too large to keep."""

    def __post_init__(self) -> None:
        self.series, self.result = Columns(self.series, self.units, "sample"), Result(self.result)

    def __repr__(self) -> str:
        ended = "finished" if self.finished else "not finished"
        ended += f" ({self.ended.reason})" if self.ended else ""
        time = self.result.get("simulated_time", {}).get("value", 0.0)
        where = f", folder '{self.folder}'" if self.folder else ""
        failed = ", ".join(self.failed_checks)
        count = len(next(iter(self.series.values()), ()))
        return (
            f"<{type(self).__name__} of scene {self.scene.name!r}: {ended}, {time:.4g} s, {count} samples of "
            f"{len(self.series)} columns{where}{f'; failed checks: {failed}' if failed else ''}>"
        )

    def __getitem__(self, name: str) -> float:
        """Return a quantity of the whole run in SI units, with its unit in the attribute `unit` if it has one.

        Raises :class:`KeyError` if the run does not have the quantity. The message suggests similar names. If only
        some runs have the quantity, the message also states the condition.
        """
        quantities = self.quantities
        if name not in quantities:
            similar = difflib.get_close_matches(str(name), quantities, 3)
            what = f"; similar names are {', '.join(similar)}" if similar else f"; the run has {', '.join(quantities)}"
            if not quantities:
                what = "; the run has no quantities, because it ended before its results were written"
            if condition := conditions_of(self.scene).get(name):
                what = f": runs have this quantity only if {condition}{what}"
            raise KeyError(f"the run has no quantity {name!r}{what}")
        return quantities[name]

    def __contains__(self, name: object) -> bool:
        return name in self.quantities

    def __iter__(self) -> Iterator[str]:
        return iter(self.quantities)

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.quantities)

    @property
    def ended(self) -> Ending | None:
        """Reason why the run ended, with a sentence about it and the simulated time [s].

        The value is None for a saved run that was killed, or that an earlier version computed.
        """
        return Ending.of(self.result)

    @property
    def failed_checks(self) -> list[str]:
        """Names of the checks that the run failed; results of a run with a failed check are not trustworthy."""
        return [name for name, check in self.result.get("checks", {}).items() if not check["passed"]]

    @property
    def quantities(self) -> Quantities:
        """Quantities of the whole run by name, as numbers in SI units; the attribute `unit` of a number is its unit."""
        return Quantities.of(self.result)

    def table(self) -> DataFrame:
        """Return the series as a pandas DataFrame in SI units, with one row per sample and `time` [s] as index.

        The units of the columns are in `attrs["units"]` of the DataFrame. Raises :class:`WarpcreteError` if pandas is
        not installed.
        """
        return dataframe(self.series, self.units, "time")

    def to_xarray(self, table: str | None = None) -> Any:
        """Return the series as an xarray Dataset in SI units, with the dimension `time` [s].

        If `table` is the name of one of the run's `tables`, such as `stations`, return this table instead, with its
        first column as the dimension. Variables with a unit have it in `attrs["units"]`. The attributes of the Dataset
        are the scene's name and, as JSON texts, the scene's parameters and the run's quantities. Raises
        :class:`WarpcreteError` if xarray is not installed, and :class:`SceneError` for a table that the run does not
        have.
        """
        columns, units, index = self.series, self.units, "time"
        if table is not None:
            one_of("table", table, tuple(self.tables))
            columns, units = self.tables[table].columns, self.tables[table].units
            index = next(iter(columns))
        attributes = {
            "scene": str(self.scene.name),
            "parameters": json.dumps(readable(self.scene.parameters)),
            "quantities": json.dumps(self.quantities),
        }
        return dataset(columns, units, index, attributes)

    def plot(self, *columns: str, against: str = "time") -> Figure:
        """Return a Matplotlib figure that plots columns of the time series over the column `against`.

        Columns with the same unit share one pair of axes. Without `columns`, the figure shows the first column in
        `DEFAULT_PLOT_COLUMNS` that the run has, such as the pressure. Raises :class:`SceneError` for a column that the
        run does not have.
        """
        if not columns:
            columns = tuple(name for name in DEFAULT_PLOT_COLUMNS if name in self.series)[:1] or tuple(self.series)[1:2]
        for name in (*columns, against):
            if name not in self.series:
                single = f"{name} is a single number, run[{name!r}]" if name in self.quantities else ""
                refuse("column", name, f"must be one of {', '.join(self.series)}", single)
        units = list(dict.fromkeys(self.units[name] for name in columns))
        figure = new_figure(self.scene.caption, *[3.0] * len(units))
        every = np.atleast_1d(figure.subplots(len(units), 1, sharex=True))
        scale, along = shown(self.units[against]) if against != "time" else (1.0, "s")
        for axes, unit in zip(every, units, strict=True):
            factor, shown_unit = shown(unit)
            same_unit = [name for name in columns if self.units[name] == unit]
            for name, colour in zip(same_unit, itertools.cycle(SERIES)):
                x, y = scale * self.series[against], factor * self.series[name]
                axes.plot(x, y, label=_column_title(name), color=rgb(colour))
            axes.set_ylabel(f"{' and '.join(map(_column_title, same_unit))} [{shown_unit}]")
            if len(same_unit) > 1:
                legend_above(axes)
            open_frame(axes)
        every[-1].set_xlabel(f"{_column_title(against)} [{along}]")
        return figure

    def save(self, folder: str | Path | RunOutput) -> Path:
        """Write the run into a new run folder, as `warpcrete run --out` does, and return the folder's path.

        If the run has a folder already, its files are copied. Otherwise the new recordings hold all curves, but only
        the last frame; pass `out` to :class:`warpcrete.Simulation` to record every frame. If the run stopped early,
        after a row of its time series, the folder also holds a checkpoint, with which `warpcrete run --resume`
        continues the run. If `folder` is a :class:`warpcrete.RunFolder`, it selects recordings and colours. Raises
        :class:`RunFolderError` if the folder is not new or cannot be written, and :class:`WarpcreteError` if the run
        kept no state.
        """
        output = output_of(folder)
        check_new(output.path)
        if self.folder is not None:
            _copy_folder(self.folder, output.path)
        elif self.final_state is None:
            raise WarpcreteError(
                f"save: the run of scene {self.scene.name!r} kept no final state, because the simulation used more "
                "than 2 GB of memory or ended before the first row of its time series; run the scene again with "
                "warpcrete.Simulation(scene, out=FOLDER)"
            )
        else:
            final, finished, ended = self.final_state, self.finished, self.result["ended"]
            try:
                final.simulation(self.scene, out=output, **final.settings).write_run(self, final.contents)
            except BaseException:
                self.folder, self.finished, self.result["finished"] = None, finished, finished
                self.result["ended"] = ended
                raise
            self.final_state = None
        return output.path

    @with_suggestions
    def view(self, web: bool = False, bind: str = LOOPBACK) -> subprocess.Popen[bytes]:
        """Open the recording in the run's folder in Rerun's viewer, without waiting for the viewer to close.

        If `web` is true or this machine has no screen, a server shows the recording in a browser for as long as this
        program runs; the address for the browser is printed. The server listens on the IP address `bind`, which by
        default only this machine can reach. Raises :class:`RunFolderError` if there is no recording.
        """
        flag("web", web)
        if self.folder is None:
            raise RunFolderError(
                "the run has no folder; only runs with a folder can be shown: write it with run.save(FOLDER), or use "
                "warpcrete.Simulation(scene, out=FOLDER)"
            )
        opened = viewer(self.folder, web, bind)
        process = opened.start()
        if opened.in_browser:
            print(opened.address)
        return process

    def _repr_html_(self) -> str:
        """Return the quantities as an HTML table for notebooks."""
        rows: list[tuple[str, object]] = []
        if failed := self.failed_checks:
            rows.append(("failed checks", ", ".join(failed)))
        for name, entry in self.result.items():
            if is_dict(entry) and set(entry) == {"value", "unit"} and isinstance(entry["value"], float):
                rows.append((name, f"{entry['value']:.6g} {entry['unit']}"))
            elif isinstance(entry, bool | int | float | str):
                rows.append((name, f"{entry:.6g}" if isinstance(entry, float) else entry))
        return html_table(rows)


def _copy_folder(source: Path, target: Path) -> None:
    """Lock a run folder and a new folder, and copy the files of the run folder into the new one.

    A source folder without write permission, such as an archive, is not locked. If a file cannot be copied, the copies
    made before are removed.
    """
    if not source.is_dir():
        raise RunFolderError(f"'{source}': is the folder of the run and no longer exists; restore it")
    source_lock = FolderLock(source) if os.access(source, os.W_OK) else None
    copied: list[Path] = []
    try:
        with new_folder(target):
            try:
                for path in sorted(source.iterdir()):
                    if path.is_file() and path.name != LOCK and not path.name.startswith(PARTIAL):
                        copied.append(target / path.name)
                        shutil.copyfile(path, copied[-1])
            except BaseException as error:
                for path in copied:
                    path.unlink(missing_ok=True)
                if isinstance(error, OSError):
                    raise cannot_write(copied[-1] if copied else target, error) from error
                raise
    finally:
        if source_lock is not None:
            source_lock.release()


def viewer(run: Path, web: bool = False, bind: str = LOOPBACK) -> Viewer:
    """Return Rerun's viewer for the recording in the folder `run`, or for the recording file `run`.

    If `web` is true or this machine has no screen, the viewer is a server for browsers, which listens on the IP address
    `bind`. Otherwise the viewer is a window. Raises :class:`RunFolderError` if there is no recording.
    """
    recording = run / "run.rrd" if run.is_dir() else run
    if not recording.is_file() or (recording == run and run.suffix.lower() != ".rrd"):
        raise RunFolderError(f"'{run}': {missing_recording(run)}")
    # The recording of an unfinished run has several files, which the viewer shows as one recording.
    parts = sorted(run.glob("run-[0-9]*.rrd")) if run.is_dir() else []
    readable_files = [path for path in (recording, *parts) if is_recording(path)]
    if not readable_files:
        raise RunFolderError(f"'{recording}': is empty or damaged, so it is not a recording (.rrd); repeat the run")
    if damaged := [path.name for path in (recording, *parts) if path not in readable_files]:
        warn(f"'{run}': {', '.join(damaged)}: empty or damaged, so the viewer shows only a part of the run")
    return (web_viewer if web or not has_screen() else screen_viewer)(readable_files, bind)


def _column_title(column: str) -> str:
    return column.replace("_", " ")
