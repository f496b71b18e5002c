"""Progress of long work: a bar in terminals and notebooks, and single lines in log files."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from tqdm.auto import tqdm

REDRAW_INTERVAL = 0.2
"""Shortest time between two updates of a progress bar [s]."""
LINES_PER_PHASE = 10
"""Number of lines that report one phase of a run, such as packing, in a log file. A very short phase has fewer lines,
and a very long phase has more lines, because `SHORTEST_LINE_INTERVAL` and `LONGEST_LINE_INTERVAL` limit the time
between two lines."""
SHORTEST_LINE_INTERVAL, LONGEST_LINE_INTERVAL = 1.0, 30.0
"""Shortest and longest time between two lines that report progress in a log file [s]."""
Progress = Callable[[str, float, dict[str, float]], None]
"""Callback for progress. Its arguments are the phase (`packing`, `settling` or `running`; `compiling` if this takes a
while), the fraction done, and a few current values by name, such as the pressure."""


@contextmanager
def progress_bar(quiet: bool = False) -> Generator[ProgressBar | None]:
    """Yield a callback that shows a progress bar, or None if `quiet`; close the bar at the end of the `with` block."""
    bar = ProgressBar()
    try:
        yield None if quiet else bar
    finally:
        bar.close()


@dataclass
class _Phase:
    """State of the progress display for one phase of a run; all times are readings of the wall clock [s]."""

    name: str
    first: float
    """Fraction of the phase that was done when the display began. It is above 0 in a resumed run, because an earlier
    process did a part of the phase."""
    start: float
    shown: float
    """Time of the last line, or of the last update of the progress bar."""
    called: float
    """Time of the last call of the progress callback."""
    last: float
    """Fraction of the phase that the last line reported as done."""

    @classmethod
    def at(cls, name: str, fraction: float, now: float) -> _Phase:
        return cls(name, fraction, now, now, now, fraction)

    def skip_pause(self, now: float) -> None:
        """Leave the time since the last call, in which kernels were compiled, out of the time of this phase."""
        pause = now - self.called
        self.start, self.shown = self.start + pause, self.shown + pause


class ProgressBar:
    """Callback for `Simulation(progress=...)` that shows remaining time, pressure and speed.

    In a terminal and in a notebook this is a tqdm bar. Elsewhere, for example in a log file, a line appears on standard
    error after every tenth of the work, or after 30 s, but at most once a second.
    """

    def __init__(self) -> None:
        self._bar: tqdm[NoReturn] | None = None
        self._phase: _Phase | None = None
        # Phase that the compilation of kernels has interrupted, and that continues afterwards.
        self._interrupted: _Phase | None = None
        self._as_lines = not (stderr_is_terminal() or _in_notebook())

    def __call__(self, phase: str, fraction: float, figures: Mapping[str, float] = MappingProxyType({})) -> None:
        """Show which fraction of a phase, such as packing, is done, and the current `figures`, such as the pressure."""
        now, fraction = time.monotonic(), min(fraction, 1.0)
        shown = self._phase
        if shown is None or phase != shown.name:
            shown = self._begin_phase(phase, fraction, now)
        shown.called = now
        if self._as_lines:
            _write_line(shown, now, fraction, figures)
        else:
            self._draw(shown, now, fraction, figures)

    def _begin_phase(self, name: str, fraction: float, now: float) -> _Phase:
        """Begin a phase, or continue the phase that compiling has interrupted; its time does not include compiling."""
        before, interrupted = self._phase, self._interrupted
        self.close()
        if name == "compiling" and before is not None:
            # The first call with the phase "compiling" comes only after some kernels are compiled. Compiling began soon
            # after the last call with the previous phase, so count its time from that call.
            self._interrupted, fraction, now = before, 0.0, before.called
        if interrupted is not None and interrupted.name == name:
            interrupted.skip_pause(now)
            self._phase = interrupted
        else:
            self._phase = _Phase.at(name, fraction, now)
        return self._phase

    def _draw(self, phase: _Phase, now: float, fraction: float, figures: Mapping[str, float]) -> None:
        if self._bar is None:
            from tqdm.auto import tqdm

            layout = "{desc:<9} {percentage:3.0f}% |{bar:30}| {elapsed}<{remaining}{postfix}"
            self._bar = tqdm(total=1.0, initial=phase.first, desc=phase.name, bar_format=layout)
            if not self._bar.disable:  # A bar that TQDM_DISABLE=1 disables keeps no times.
                self._bar.start_t -= now - phase.start
        elif fraction < 1.0 and now - phase.shown < REDRAW_INTERVAL:
            return
        phase.shown = now
        self._bar.n = fraction
        self._bar.set_postfix(_texts(figures), refresh=False)  # pyright: ignore[reportUnknownMemberType]
        self._bar.refresh()

    def close(self) -> None:
        """Draw the progress bar for the last time and end its line."""
        if self._bar is not None:
            self._bar.refresh()
            self._bar.close()
        self._bar, self._phase, self._interrupted = None, None, None


def _write_line(phase: _Phase, now: float, fraction: float, figures: Mapping[str, float]) -> None:
    """Print the progress of a phase on standard error, if a line is due."""
    tenths, before = (int(LINES_PER_PHASE * done + 1e-9) for done in (fraction, phase.last))
    since, elapsed = now - phase.shown, now - phase.start
    due = tenths > before and since >= SHORTEST_LINE_INTERVAL
    if not due and since < LONGEST_LINE_INTERVAL:
        return
    # The pace may change during a run, for example when concrete begins to flow, so use the pace since the last line.
    spent, done = since, fraction - phase.last
    if done <= 0:
        spent, done = elapsed, fraction - phase.first
    phase.shown, phase.last = now, fraction
    left = f"about {_clock(spent * (1 - fraction) / done)} left" if done > 0 and fraction < 1 else ""
    if left and figures.get("at_most"):
        left += " unless the flow ends earlier"
    parts = [f"{_clock(elapsed)} elapsed", left, *(" ".join(part) for part in _texts(figures).items())]
    print(f"{phase.name}: {100 * fraction:.0f} %, {', '.join(filter(None, parts))}", file=sys.stderr, flush=True)


_announced = False


def announce_compiling(phase: str, fraction: float, figures: Mapping[str, float] = MappingProxyType({})) -> None:
    """Print one line on standard error when this process compiles kernels for the first time; ignore other progress.

    Runs without a progress bar use this callback. Compiling may take minutes, during which a run without this line
    would seem to hang.
    """
    global _announced
    if phase == "compiling" and not _announced:
        _announced = True
        print(
            "compiling kernels, which can take minutes; later runs find them in the cache", file=sys.stderr, flush=True
        )


def no_progress(phase: str, fraction: float, figures: Mapping[str, float] = MappingProxyType({})) -> None:
    """Ignore the progress of a run; commands use this callback if the user wants no progress display."""


def _texts(figures: Mapping[str, float]) -> dict[str, str]:
    """Return the pressure and the steps per second as texts for a progress display, if `figures` contains them."""
    found: dict[str, str] = {}
    if "pressure" in figures:
        found["pressure"] = f"{figures['pressure'] / 1e3:.1f} kPa"
    if "steps_per_s" in figures:
        found["steps/s"] = rate_text(figures["steps_per_s"])
    return found


def rate_text(rate: float) -> str:
    """Return a number of steps per second as text; slow rates have two significant digits."""
    return f"{rate:.0f}" if rate >= 10 else f"{rate:.2g}"


def _clock(seconds: float) -> str:
    """Return a duration as a text "minutes:seconds", or "hours:minutes:seconds" from one hour on."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes:02d}:{rest:02d}"


def stderr_is_terminal() -> bool:
    """Return whether standard error is a terminal; programs with windows may have no standard error at all."""
    return sys.stderr is not None and sys.stderr.isatty()


def _in_notebook() -> bool:
    """Return whether this process is the kernel of a notebook."""
    ipython: Any = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return shell is not None and "IPKernelApp" in shell.config
