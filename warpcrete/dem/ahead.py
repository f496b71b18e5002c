"""How many steps are launched before the host looks at a batch again."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ..kernels.common.control import ESTIMATED, FAILED, GOAL, HALTED, STALE, STEPS
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
SOONER, LATER = 0.95, 1.1
"""By what factor lists are expected to last less than they did, and, where they were built anew before they were stale,
longer than was expected."""
ALONG = 0.6
"""Of the steps that a scene's lists last, after which they are built along with those of another."""
NOBODY = np.zeros(0, dtype=np.int64)
WAIT = 20
"""Steps after which a GPU looks whether lists are stale, at most."""
BRIEF = 8
"""Steps that lists are expected to last at least."""


class Ahead:
    """Nothing hangs on these numbers but time: scenes halt where they must, and what is in flight passes them by."""

    def __init__(self, parallel: bool, scenes: int) -> None:
        self.parallel, self.scenes = parallel, scenes
        self._built = np.zeros(scenes, dtype=np.int64)  # completed steps when the lists were built
        self._lasting = np.full(scenes, 64.0 if scenes == 1 else np.inf)  # steps that they are expected to
        self._whole = np.ones(scenes, dtype=bool)  # not so of lists that were older when they came
        self._since_captured = 0
        self.rebuilds_itself = False
        """A GPU builds the lists of its only scene without the host, but where bodies are to be sorted or there is no
        room."""

    def stepped(self, launched: int) -> None:
        """So many steps were launched."""
        self._since_captured += launched

    def captured(self) -> None:
        """Graphs are made anew."""
        self._since_captured = 0

    def largest_graph(self, threads: int, rounds: int) -> int:
        """Steps of one graph, if each has so many rounds for stiff bonds."""
        kind = "cuda" if self.parallel else "threads" if threads > 1 and self._since_captured > OLD else "cpu"
        return max(1, LARGEST_GRAPH[kind] // (1 + rounds // 4))

    def due(self, flags: np.ndarray, sort_every: np.ndarray, among: Sequence[int]) -> np.ndarray:
        """Scenes `among` some, whose lists should be built now: those that are stale and, where there are several on a
        GPU, those that soon will be. What waits for its lists is passed by, and takes next to no less time."""
        if not flags[:, int(STALE)].any() and (self.scenes == 1 or not self.parallel):
            return NOBODY
        steps, stale = flags[:, int(STEPS)], flags[:, int(STALE)] != 0
        age = steps - self._built
        chosen = np.zeros(self.scenes, dtype=bool)
        chosen[list(among)] = True
        chosen &= flags[:, int(FAILED)] == 0
        # Where bodies are to be sorted that says nothing of how long lists last.
        early = (sort_every > 0) & (steps % np.maximum(sort_every, 1) == 0)
        came = chosen & stale & ~early & self._whole
        self._lasting[came] = np.maximum((1.0 if self.scenes == 1 else SOONER) * age[came], BRIEF)
        if self.scenes == 1 or not self.parallel:
            return np.flatnonzero(stale)
        outlived = chosen & ~stale & (age >= self._lasting)
        self._lasting[outlived] *= LATER
        if not (stale | outlived).any():
            return NOBODY
        return np.flatnonzero(stale | outlived | (chosen & (age >= ALONG * self._lasting)))

    def joined(self, s: int, steps: int) -> None:
        """Scene `s` comes with lists, who knows how old, having completed so many steps."""
        self._built[s], self._whole[s] = steps, False

    def built(self, flags: np.ndarray) -> None:
        """Lists of the scenes that are stale by these flags are new."""
        stale = flags[:, int(STALE)] != 0
        self._built[stale], self._whole[stale] = flags[stale, int(STEPS)], True

    def pieces(self, flags: np.ndarray, clock: np.ndarray, rows: np.ndarray) -> list[int]:
        """Steps to be launched, in pieces after which a GPU estimates the stable step of the scenes that must have it,
        and looks after lists that it builds itself.

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
        piece = min(intervals[s] for s in running)
        lists = min(self._lasting[s] - (slots[s][int(STEPS)] - self._built[s]) for s in running)
        if self.scenes > 1:
            # Who is not in step with the rest, since it had to wait, comes to its estimate first, and waits for theirs.
            piece = min(piece, BATCH_LAUNCH)
            sizes = [min(max(estimates), piece, count)]
            most = min(BATCH_LAUNCH, lists)
            while sum(sizes) < count and sum(sizes) + piece <= most:
                sizes.append(min(piece, count - sum(sizes)))
            return sizes
        # A scene that goes stale leaves the rest of what is in flight to idle: expect it when it came last time.
        if self.rebuilds_itself:
            every = max(int(rows["sort_every"][0]), 0) or NEVER
            count = min(count, every - slots[0][int(STEPS)] % every)
        else:
            count = min(count, int(lists) if lists > 0 else max(16, int(self._lasting[0] - lists) // 4))
        first = min(count, estimates[0])
        whole, rest = divmod(count - first, piece)
        sizes = [first, *[piece] * whole, *([rest] if rest else [])]
        if not self.rebuilds_itself:
            return sizes
        return [min(WAIT, size - done) for size in sizes for done in range(0, size, WAIT)]
