"""Decide how many time steps the host launches before it reads the control flags of a batch again.

A launch is asynchronous on a GPU: the host queues several steps and does not wait for them. A scene that needs the
host, for example for new neighbour lists, halts itself on the device and skips the remaining queued steps. The number
of steps per launch therefore affects speed only, never results.
"""

import math
from collections.abc import Sequence

import numpy as np

from ...kernels.common.control import ESTIMATED, FAILED, GOAL, HALTED, STALE, STEPS
from ...kernels.dem.clock import CLOSE
from ...kernels.dem.structs import DT, TIME

LAUNCH = {"cpu": 64, "cuda": 512}
"""Maximum number of steps that are launched before the host checks for Ctrl-C. The keys are kinds of devices."""
BATCH_LAUNCH = 40
"""Maximum number of steps that the host queues on a GPU for a batch of several scenes.

After these steps the host deals with the scenes that have halted, for example by rebuilding their neighbour lists.
"""
LARGEST_GRAPH = {"cpu": 2, "threads": 8, "cuda": 64}
"""Maximum number of time steps whose kernel launches are recorded in one graph.

On a CPU, recording a graph costs as much as several steps and replaying a graph costs almost nothing. Several CPU
threads get longer graphs, because they lose time when they wait for each other between two graphs.
"""
STABLE_CHUNK_STEPS = 256
"""Number of steps with the same division of bodies among CPU threads, after which the threads may use longer graphs.

A graph contains the recorded launches of several steps. Soon after the start of a run the division often changes, which
makes recorded graphs useless.
"""
NEVER = 2**31 - 1
"""Largest 32-bit integer, used as a step count that no scene ever reaches: the goal of a scene that runs until a given
time."""
LIFETIME_DECREASE, LIFETIME_INCREASE = 0.95, 1.1
"""Factors that adapt the expected lifetime of neighbour lists. If lists have become stale, the next lists are expected
to last `LIFETIME_DECREASE` times as many steps as these lists did. If lists are still valid at the end of their
expected lifetime, this lifetime grows by the factor `LIFETIME_INCREASE`."""
SHARED_REBUILD_AGE = 0.6
"""Minimum age at which the neighbour lists of a scene are rebuilt early, as a fraction of their expected lifetime.

A rebuild is early if these lists are still valid, but the lists of another scene of the batch must be rebuilt.
"""
NO_SCENES = np.zeros(0, dtype=np.int64)
DEVICE_CHECK_INTERVAL = 20
"""Maximum number of steps between two checks with which a GPU finds, without the host, that its neighbour lists are
stale."""
MINIMUM_LIFETIME = 8
"""Minimum number of steps that neighbour lists are expected to stay valid."""


class LaunchPlanner:
    """Planner of the number of steps per launch, and of the time at which neighbour lists are rebuilt.

    The choices of the planner affect speed only: a scene halts itself on the device when it needs the host, and kernels
    that are already launched skip a halted scene.
    """

    def __init__(self, parallel: bool, scenes: int) -> None:
        self.parallel, self.scenes = parallel, scenes
        # For each scene, the step count at which its neighbour lists were built, and the expected lifetime of its lists
        # in steps.
        self._built_at_step = np.zeros(scenes, dtype=np.int64)
        self._expected_lifetime = np.full(scenes, 64.0 if scenes == 1 else np.inf)
        # A scene may join the batch with neighbour lists of unknown age. `_age_known` is then False, because the
        # lifetime of these lists cannot be measured.
        self._age_known = np.ones(scenes, dtype=bool)
        self._steps_since_capture = 0
        self.rebuilds_on_device = False
        """True if a GPU rebuilds the neighbour lists without the host, which requires that the batch has one scene.

        The host still rebuilds lists when bodies must be sorted or when the arrays are too small.
        """

    def count_steps(self, launched: int) -> None:
        """Add `launched` steps to the count of steps that were launched since graphs were last recorded."""
        self._steps_since_capture += launched

    def reset_step_count(self) -> None:
        """Set to zero the count of steps that were launched since graphs were last recorded."""
        self._steps_since_capture = 0

    def largest_graph(self, threads: int, rounds: int) -> int:
        """Return the maximum number of steps in one recorded graph of launches.

        `threads` is the number of CPU threads that take part in a step, and `rounds` is the number of sub-cycling
        rounds per step. Rounds are the shorter steps that integrate stiff bonds within one step. The more rounds a
        step has, the fewer steps a graph may contain.
        """
        kind = (
            "cuda"
            if self.parallel
            else "threads"
            if threads > 1 and self._steps_since_capture > STABLE_CHUNK_STEPS
            else "cpu"
        )
        return max(1, LARGEST_GRAPH[kind] // (1 + rounds // 4))

    def scenes_to_rebuild(self, flags: np.ndarray, sort_every: np.ndarray, among: Sequence[int]) -> np.ndarray:
        """Return the indices of the scenes whose neighbour lists should be rebuilt now.

        All scenes with stale lists must be rebuilt. On a GPU, the rebuild of several scenes takes hardly longer than
        the rebuild of one scene. A GPU therefore also rebuilds those scenes whose lists will soon be stale. `among`
        contains the indices of the running scenes, and `flags` contains the control flags of all scenes.

        `sort_every` contains, for each scene, the number of steps between two re-sortings of its bodies, or 0 for no
        re-sorting. After a re-sorting step, lists are stale although they could be used longer. Such a scene is rebuilt
        too, but the age of its lists is not used to predict when its next lists will be stale.
        """
        if not flags[:, int(STALE)].any() and (self.scenes == 1 or not self.parallel):
            return NO_SCENES
        steps, stale = flags[:, int(STEPS)], flags[:, int(STALE)] != 0
        age = steps - self._built_at_step
        chosen = np.zeros(self.scenes, dtype=bool)
        chosen[list(among)] = True
        chosen &= flags[:, int(FAILED)] == 0
        # Do not measure the lifetime of neighbour lists that are rebuilt early because bodies are re-sorted.
        early = (sort_every > 0) & (steps % np.maximum(sort_every, 1) == 0)
        became_stale = chosen & stale & ~early & self._age_known
        self._expected_lifetime[became_stale] = np.maximum(
            (1.0 if self.scenes == 1 else LIFETIME_DECREASE) * age[became_stale], MINIMUM_LIFETIME
        )
        if self.scenes == 1 or not self.parallel:
            return np.flatnonzero(stale)
        outlived = chosen & ~stale & (age >= self._expected_lifetime)
        self._expected_lifetime[outlived] *= LIFETIME_INCREASE
        if not (stale | outlived).any():
            return NO_SCENES
        return np.flatnonzero(stale | outlived | (chosen & (age >= SHARED_REBUILD_AGE * self._expected_lifetime)))

    def note_joined(self, s: int, steps: int) -> None:
        """Record that scene `s` joined the batch after `steps` completed steps, with neighbour lists of unknown age."""
        self._built_at_step[s], self._age_known[s] = steps, False

    def note_rebuilt(self, flags: np.ndarray) -> None:
        """Record that the neighbour lists of all scenes that `flags` marks as stale have been rebuilt."""
        stale = flags[:, int(STALE)] != 0
        self._built_at_step[stale], self._age_known[stale] = flags[stale, int(STEPS)], True

    def launch_sizes(self, flags: np.ndarray, clock: np.ndarray, rows: np.ndarray) -> list[int]:
        """Divide the next launch of time steps into pieces, and return the number of steps of each piece.

        A launch is a sequence of time steps that the host requests at once. After each piece, a GPU estimates the
        stable time step of the scenes that need an estimate. A GPU that can rebuild neighbour lists without the host
        also rebuilds stale lists after each piece.

        The arguments are arrays with one row for each scene: `flags` contains the control flags, `clock` contains the
        times, and `rows` contains the parameters.
        """
        # Convert to plain Python numbers. For one scene, arithmetic on them is ten times as fast as with NumPy, and the
        # GPU idles while the host computes.
        untils, intervals, slots = rows["until"].tolist(), rows["interval"].tolist(), flags.tolist()
        clocks = clock.tolist()
        running = [s for s in range(self.scenes) if slots[s][int(HALTED)] == 0]
        if not running:
            return []
        left: list[float] = []
        estimates: list[int] = []
        for s in running:
            slot, (time, dt) = slots[s], (clocks[s][int(TIME)], clocks[s][int(DT)])
            by_time = (untils[s] - time) / dt - CLOSE if dt > 0 else math.inf
            left.append(min(by_time, slot[int(GOAL)] - slot[int(STEPS)]))
            estimates.append(max(intervals[s] - (slot[int(STEPS)] - slot[int(ESTIMATED)]), 1))
        count = max(1, math.ceil(min(max(left), LAUNCH["cuda" if self.parallel else "cpu"])))
        if not self.parallel:
            return [min(count, max(estimates))]
        piece = min(intervals[s] for s in running)
        remaining_lifetime = min(
            self._expected_lifetime[s] - (slots[s][int(STEPS)] - self._built_at_step[s]) for s in running
        )
        if self.scenes > 1:
            # The scenes of a batch need their next estimates of the stable step at different steps, because some of
            # them have waited for new neighbour lists. The first piece of the launch ends when the last scene needs an
            # estimate. The other scenes halt when they need an estimate, and wait for the end of the piece.
            piece = min(piece, BATCH_LAUNCH)
            sizes = [min(max(estimates), piece, count)]
            most = min(BATCH_LAUNCH, remaining_lifetime)
            while sum(sizes) < count and sum(sizes) + piece <= most:
                sizes.append(min(piece, count - sum(sizes)))
            return sizes
        # The device skips all steps of a launch that follow the moment at which the neighbour lists become stale. If
        # only the host can rebuild the lists, the launch should therefore end at that moment. The lists are expected to
        # last as long as the previous lists did.
        if self.rebuilds_on_device:
            every = max(int(rows["sort_every"][0]), 0) or NEVER
            count = min(count, every - slots[0][int(STEPS)] % every)
        else:
            count = min(
                count,
                int(remaining_lifetime)
                if remaining_lifetime > 0
                else max(16, int(self._expected_lifetime[0] - remaining_lifetime) // 4),
            )
        first = min(count, estimates[0])
        whole, rest = divmod(count - first, piece)
        sizes = [first, *[piece] * whole, *([rest] if rest else [])]
        if not self.rebuilds_on_device:
            return sizes
        return [
            min(DEVICE_CHECK_INTERVAL, size - offset)
            for size in sizes
            for offset in range(0, size, DEVICE_CHECK_INTERVAL)
        ]
