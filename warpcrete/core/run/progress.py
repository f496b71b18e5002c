"""Progress bar for terminals and notebooks."""

from __future__ import annotations

import time
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from types import MappingProxyType
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from tqdm.auto import tqdm


@contextmanager
def progress_bar(quiet: bool = False) -> Generator[ProgressBar | None]:
    """Provide a progress bar as a callback, or None if `quiet`, and close the bar at the end."""
    bar = ProgressBar()
    try:
        yield None if quiet else bar
    finally:
        bar.close()


class ProgressBar:
    """Callback for `Simulation(progress=...)` that shows a tqdm bar with remaining time, pressure and speed."""

    def __init__(self) -> None:
        self._bar: tqdm[NoReturn] | None = None
        self._phase = ""

    def __call__(self, phase: str, fraction: float, figures: Mapping[str, float] = MappingProxyType({})) -> None:
        """Show the fraction of a phase that is done, and current figures such as the pressure."""
        from tqdm.auto import tqdm

        if phase != self._phase:
            self.close()
            self._phase = phase
            layout = "{desc:<9} {percentage:3.0f}% |{bar:30}| {elapsed}<{remaining}{postfix}"
            self._bar = tqdm(total=1.0, desc=phase, bar_format=layout)
            self._shown = 0.0
        if fraction < 1.0 and time.monotonic() - self._shown < 0.2:
            return
        self._shown = time.monotonic()
        assert self._bar is not None
        self._bar.n = min(fraction, 1.0)
        shown: dict[str, str] = {}
        if "pressure" in figures:
            shown["pressure"] = f"{figures['pressure'] / 1e3:.1f} kPa"
        if "steps_per_s" in figures:
            shown["steps/s"] = f"{figures['steps_per_s']:.0f}"
        self._bar.set_postfix(shown, refresh=False)  # pyright: ignore[reportUnknownMemberType]
        self._bar.refresh()

    def close(self) -> None:
        """Draw the progress bar for the last time and end its line."""
        if self._bar is not None:
            self._bar.refresh()
            self._bar.close()
            self._bar, self._phase = None, ""
