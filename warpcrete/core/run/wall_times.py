"""Wall times of a run and of its phases, such as packing; time since the last checkpoint; time steps per second."""

import time
from collections.abc import Mapping

from ..device.kernel_files import run_clock


class WallTimes:
    """Wall times of a run, without the time to compile or load kernels.

    A resumed run adds its own time to the time in the checkpoint.
    """

    def __init__(self) -> None:
        self.phases: dict[str, float] = {}
        """Wall time of each completed phase of the run [s], by the phase's name, such as "packing"."""
        # Wall-clock time at which the last checkpoint was written or read [s].
        self._saved_at = time.perf_counter()
        self._started: float | None = None  # Time of the run clock at which this process began to run [s].
        # Wall time that a resumed run had taken before its checkpoint was written [s].
        self._before_resume = 0.0
        # Steps taken and time of the run clock [s] at the first and at the last new row of this process.
        self._rows: tuple[tuple[int, float], tuple[int, float]] | None = None

    def restore(self, phases: Mapping[str, float]) -> None:
        """Restore the wall times [s] of the phases of a run, such as packing, from the data of a checkpoint."""
        self.phases = dict(phases)
        self._before_resume = phases["running"]
        self.note_checkpoint()

    def start(self) -> None:
        """Record that the simulation begins to run now."""
        self._started = run_clock()

    def note_checkpoint(self) -> None:
        """Record that a checkpoint has been written or read now."""
        self._saved_at = time.perf_counter()

    def note_row(self, steps: int) -> None:
        """Record that the time series has a new row now, after `steps` time steps of the run."""
        now = (steps, run_clock())
        self._rows = (self._rows[0] if self._rows else now, now)

    @property
    def since_checkpoint(self) -> float:
        """Wall time since the last checkpoint [s]."""
        return time.perf_counter() - self._saved_at

    @property
    def running(self) -> float:
        """Wall time that the run has taken since t = 0, up to now and without the time to load kernels [s]."""
        return self._before_resume + (0.0 if self._started is None else run_clock() - self._started)

    @property
    def has_pace(self) -> bool:
        """True if this process has added at least two rows, so that the pace begins at the first one."""
        return self._rows is not None and self._rows[0] != self._rows[1]

    def pace(self, steps: int) -> float:
        """Return the mean number of time steps per second of wall time, in this process.

        The mean excludes the time up to the first new row of the time series, in which the launches of kernels are
        recorded. If this process has added fewer than two rows, return the mean over all `steps` of the run.
        """
        if self._rows is not None and self.has_pace:
            (first, begun), (last, ended) = self._rows
            return (last - first) / max(ended - begun, 1e-9)
        return steps / max(self.phases.get("running", 0.0), 1e-9)
