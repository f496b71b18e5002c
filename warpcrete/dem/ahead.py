"""How many steps are launched before the host looks at a batch again."""

from __future__ import annotations

import math

import numpy as np

from ..kernels.common.control import ESTIMATED, GOAL, HALTED, STEPS
from ..kernels.dem.clock import CLOSE
from ..kernels.dem.structs import DT, TIME

LAUNCH = {"cpu": 64, "cuda": 512}
"""Steps from one look at Ctrl-C to the next, at most."""
BATCH_LAUNCH = 40
"""Steps in flight before scenes that halted are looked after, where there are several."""
LARGEST_GRAPH = {"cpu": 2, "threads": 8, "cuda": 64}
"""Steps of one graph: on a CPU capturing costs as much as some steps, replaying next to nothing, but threads lose each
other between two."""
OLD = 256
"""Steps after which threads have larger graphs captured: chunks may change before."""
NEVER = 2**31 - 1
"""A count of steps that no scene gets to."""


class Ahead:
    """Nothing hangs on these numbers but time: scenes halt where they must, and what is in flight passes them by."""

    def __init__(self, parallel: bool, scenes: int) -> None:
        self.parallel, self.scenes = parallel, scenes
        self._since_build = 0
        self._between_builds = 64
        self._since_captured = 0

    def stepped(self, count: int, launched: int) -> None:
        """The first scene has completed so many steps of those that were launched."""
        self._since_build += count
        self._since_captured += launched

    def captured(self) -> None:
        """Graphs are made anew."""
        self._since_captured = 0

    def largest_graph(self, threads: int, rounds: int) -> int:
        """Steps of one graph, if each has so many rounds for stiff bonds."""
        kind = "cuda" if self.parallel else "threads" if threads > 1 and self._since_captured > OLD else "cpu"
        return max(1, LARGEST_GRAPH[kind] // (1 + rounds // 4))

    def built(self) -> None:
        """Lists are new."""
        self._between_builds = max(self._since_build, 8)
        self._since_build = 0

    def pieces(self, flags: np.ndarray, clock: np.ndarray, rows: np.ndarray) -> list[int]:
        """Steps to be launched, in pieces after which a GPU estimates the stable step of the scenes that must have it.

        `flags`, `clock` and `rows` are those of all scenes.
        """
        # Plain numbers: of one scene NumPy takes ten times as long, while a GPU has nothing to do.
        untils, intervals, slots, clocks = (
            rows["until"].tolist(),
            rows["interval"].tolist(),
            flags.tolist(),
            clock.tolist(),
        )
        running = [s for s in range(self.scenes) if slots[s][int(HALTED)] == 0]
        if not running:
            return []
        left, estimates = [], []
        for s in running:
            slot, (time, dt) = slots[s], (clocks[s][int(TIME)], clocks[s][int(DT)])
            by_time = (untils[s] - time) / dt - CLOSE if dt > 0 else math.inf
            left.append(min(by_time, slot[int(GOAL)] - slot[int(STEPS)]))
            estimates.append(max(intervals[s] - (slot[int(STEPS)] - slot[int(ESTIMATED)]), 1))
        count = max(1, math.ceil(min(max(left), LAUNCH["cuda" if self.parallel else "cpu"])))
        if not self.parallel:
            return [min(count, max(estimates))]
        estimate, piece = min(estimates), min(intervals[s] for s in running)
        if self.scenes > 1:
            # Scenes that had to wait for their lists come to their estimates between those of the others.
            count = min(count, BATCH_LAUNCH)
            estimate = piece = 1 << max(piece // 2, 1).bit_length() - 1
        else:
            # A scene that goes stale leaves the rest of what is in flight to idle: expect it when it came last time.
            expected = self._between_builds - self._since_build
            count = min(count, expected if expected > 0 else max(16, self._since_build // 4))
        first = min(count, estimate)
        whole, rest = divmod(count - first, piece)
        return [first, *[piece] * whole, *([rest] if rest else [])]
