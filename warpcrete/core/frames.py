"""When recorders get frames."""

from __future__ import annotations

import numpy as np

from .errors import positive

LEAST, SLOWEST = 30, 0.04
"""Frames of a run, at least, and the longest time between two [s], unless told otherwise."""


class Frames:
    """Times of frames: every `interval` seconds of simulated time; with None 25 a second, and 30 at least of a run that
    takes the `expected` time [s], of one that goes on longer ever fewer.

    Frames lie at samples of the run, but for runs that may stop between them, every `step` [s] at most.
    """

    def __init__(self, interval: float | None, expected: float, step: float = np.inf) -> None:
        if interval is not None:
            positive("frame_interval", interval, "s")
        self._given, self._expected, self._step = interval, expected, step
        own = min(SLOWEST, expected / LEAST) if expected > 0 else SLOWEST
        self.interval = own if interval is None else interval
        """Between two frames at the start [s]."""
        self.next = 0.0
        """When the next frame is due [s]."""
        self.taken(0.0)

    def due(self, time: float) -> bool:
        """A frame is due at a sample."""
        return time >= self.next - 1e-9

    def before(self, sample: float) -> bool:
        """One is due before the next sample, and the run may stop for it."""
        return self.next < sample - self._step

    def taken(self, time: float) -> None:
        """A frame was taken."""
        if self._given is None and time > self._expected:
            self.next = time + min(SLOWEST, time / LEAST)
        else:
            self.next = self.interval * (np.floor(time / self.interval + 1e-9) + 1)
        if np.isfinite(self._step):
            self.next = max(self.next, time + self._step)
