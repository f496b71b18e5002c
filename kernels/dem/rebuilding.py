"""What a GPU decides by itself of a rebuild of its lists."""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import FAILED, GOAL, HALTED, STALE, STEPS, WAITS
from .clock import is_there
from .structs import DT, SINCE_BUILD, TIME, array_structs

ALONG = 0.6
"""Of the time that a scene's lists lasted, after which they are built along with those of another."""
LATER = 1.05
"""By what factor lists are expected to last longer each time that they are built before they are stale."""


@functools.cache
def rebuilding_kernels(scalar) -> SimpleNamespace:
    """Kernels over scenes: ``look`` whether lists of some are stale, ``ask`` whether they are to be built now, and with
    them those of scenes under way that will soon be stale; ``fit`` whether there is no room for what was found, and
    ``note`` what is built. Where bodies are to be sorted nothing is: that takes the host.
    """
    Scenes = array_structs(scalar).Scenes

    @wp.kernel(module="unique", enable_backward=False)
    def look(flags: wp.array2d(dtype=wp.int32), scenes: Scenes, found: wp.array(dtype=wp.int32)):
        """`found`: are some stale, and are bodies to be sorted? Zero before."""
        s = wp.tid()
        if flags[s, STALE] == 0 or flags[s, FAILED] != 0:
            return
        every = scenes.row[s].sort_every
        found[0] = 1
        if every > 0 and flags[s, STEPS] % wp.max(every, 1) == 0:
            found[1] = 1

    @wp.kernel(module="unique", enable_backward=False)
    def ask(
        found: wp.array(dtype=wp.int32), scenes: Scenes, flags: wp.array2d(dtype=wp.int32),
        lasted: wp.array(dtype=wp.float64), asked: wp.array(dtype=wp.int32),
    ):  # fmt: skip
        """`lasted` is how long the lists of each scene are known to last [s]."""
        s = wp.tid()
        builds = found[0] != 0 and found[1] == 0
        if s == 0:
            asked[0] = wp.where(builds, 1, 0)
        if not builds or flags[s, FAILED] != 0:
            return
        since = scenes.clock[s, SINCE_BUILD]
        if flags[s, STALE] != 0:
            lasted[s] = since
            return
        left = scenes.row[s].until - scenes.clock[s, TIME]
        ended = is_there(flags[s, STEPS] - flags[s, GOAL], -1, left, scenes.clock[s, DT])
        if not ended and since > wp.float64(wp.static(ALONG)) * lasted[s]:
            lasted[s] = wp.max(since, wp.float64(wp.static(LATER)) * lasted[s])
            flags[s, STALE] = 1
            flags[s, HALTED] = WAITS

    @wp.kernel(module="unique", enable_backward=False)
    def fit(
        flags: wp.array2d(dtype=wp.int32), scenes: Scenes, scanned: wp.array(dtype=wp.int32),
        room: wp.array(dtype=wp.int32), face_scanned: wp.array(dtype=wp.int32), face_room: wp.array(dtype=wp.int32),
        lacking: wp.array(dtype=wp.int32),
    ):  # fmt: skip
        """`lacking`: some stale scene has no room, for pairs or for faces. Zero before."""
        s = wp.tid()
        if flags[s, STALE] == 0:
            return
        begin = scenes.row[s].spheres + s
        end = begin + scenes.row[s].sphere_count
        if scanned[end] - scanned[begin] > room[s]:
            lacking[0] = 1
        if face_scanned.shape[0] > 0:
            if face_scanned[end] - face_scanned[begin] > face_room[s]:
                lacking[0] = 1

    @wp.kernel(module="unique", enable_backward=False)
    def note(flags: wp.array2d(dtype=wp.int32), built: wp.array(dtype=wp.int32)):
        """One more building of the lists of each stale scene."""
        s = wp.tid()
        if flags[s, STALE] != 0:
            built[s] = built[s] + 1

    return SimpleNamespace(look=look, ask=ask, fit=fit, note=note)
