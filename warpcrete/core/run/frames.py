"""Schedule of frames: the simulated times at which recorders draw the state of a run."""

import numpy as np

from ..errors import positive

MINIMUM_FRAMES, LONGEST_FRAME_INTERVAL = 30, 0.04
"""Minimum number of recorded frames of a run, and longest simulated time between two frames [s], if the user sets no
frame interval."""


class Frames:
    """Schedule of frames (pictures of the state): one every `interval` seconds of simulated time.

    If `interval` is None, there are at least 25 frames per second, and at least 30 frames in a run of the `expected`
    duration [s]. The argument `step` selects when frames are taken:

    - A finite `step` is the constant time step [s]. The run stops between samples (rows of the time series) for each
      frame that is due. Two frames are at least one time step apart.
    - An infinite `step` means that the time step varies. A due frame is taken at the next sample.
    """

    def __init__(self, interval: float | None, expected: float, step: float = np.inf) -> None:
        if interval is not None:
            positive("frame_interval", interval, "s")
        self._requested_interval, self._expected_duration, self._time_step = interval, expected, step
        default_interval = (
            min(LONGEST_FRAME_INTERVAL, expected / MINIMUM_FRAMES) if expected > 0 else LONGEST_FRAME_INTERVAL
        )
        self.interval = default_interval if interval is None else interval
        """Simulated time between two recorded frames at the start of the run [s]."""
        self.next = 0.0
        """Simulated time at which the next picture of the state (frame) is recorded [s]."""
        self.schedule_next(0.0)

    def due(self, time: float) -> bool:
        """Return whether a frame (picture of the state) is due at `time` [s], when the time series gets a new row."""
        return time >= self.next - 1e-9

    def due_before(self, sample: float) -> bool:
        """Return whether the run should stop for a frame (picture of the state) before its next sample.

        `sample` is the time [s] of that sample, the next row of the time series. The run should stop if the frame is
        due more than one time step earlier. A run whose time step is not constant never stops between samples.
        """
        return self.next < sample - self._time_step

    def schedule_next(self, time: float) -> None:
        """Set the time at which the next frame (picture of the state) is recorded, after a frame at `time` [s]."""
        if self._requested_interval is None and time > self._expected_duration:
            self.next = time + min(LONGEST_FRAME_INTERVAL, time / MINIMUM_FRAMES)
        else:
            self.next = self.interval * (np.floor(time / self.interval + 1e-9) + 1)
        if np.isfinite(self._time_step):
            self.next = max(self.next, time + self._time_step)
