"""Forces of all contacts of a state, for measurements along a pipe, and the sum of contact stresses of every body."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from operator import attrgetter

import numpy as np
import warp as wp

from ...core.device.graphs import Call
from ...core.device.launching import Stage
from ...kernels.common.types import types
from ...kernels.dem.stations import STRESSES, force_probe, stress_probe
from ..engine.model import Model
from ..engine.pairs import chunks_of
from ..engine.state import State
from .probes import launch_recorded, scene_stage

READ_ARRAYS = ("spheres.id", "spheres.position", "spheres.velocity", "spheres.body", "bodies.group", "bodies.size",
        "bodies.mass", "bodies.position", "pairs.start", "pairs.other", "slots.wall")  # fmt: skip
"""Names of the arrays of a state that a measurement in the slices of a pipe reads, in addition to the contact
forces."""
STRESS_RESOLUTION = 2.0**-40
"""Resolution of the integers that :func:`body_stresses` returns, as a fraction of its argument `unit`.

With this resolution, sums over thousands of contacts are exact to nine digits. Values of up to a million times `unit`
still fit into 64-bit integers.
"""


def body_stresses(model: Model, state: State, unit: float) -> wp.array:
    """Return, for every body, the sum over contacts of force times branch vector, as integers, shape (bodies, 6).

    This sum is the body's stress times volume [J]. The integers count multiples of `STRESS_RESOLUTION` times `unit`
    [J]. The columns are xx, yy, zz, xy, yz and zx; the rows are in the order of the state's arrays. Each body of a pair
    receives half of the pair's value. The array is on the device, and the next call overwrites it.
    """
    stress = state.scratch("body stresses", (state.body_count, int(STRESSES)), wp.int64)
    if state.sphere_count:
        scale = 1 / (STRESS_RESOLUTION * unit)
        launch_recorded(
            state,
            f"body stresses in {unit!r}",
            lambda: [Call(stress.zero_), *_force_stages(model, state), _stress_stage(model, state, scale, stress)],
        )
    return stress


def _stress_stage(model: Model, state: State, scale: float, stress: wp.array) -> Stage:
    pair_push, wall_push, wall_arm = _arrays(state)
    return scene_stage(state, stress_probe(model.scalar), state.sphere_count, scale=scale, pair_push=pair_push,
                       wall_push=wall_push, wall_arm=wall_arm, stress=stress)  # fmt: skip


@dataclass(frozen=True)
class StationArrays:
    """Host copies of the arrays from which stresses, velocities and other values in slices of a pipe are computed.

    On a CPU, they are the run's own arrays and not copies.
    """

    model: Model
    chunks: list[int] | None
    arrays: Mapping[str, np.ndarray]

    def __getitem__(self, name: str) -> np.ndarray:
        return self.arrays[name]


def read_arrays(model: Model, state: State) -> StationArrays:
    """Compute the forces of all contacts; return all arrays that measurements in slices of a pipe need."""
    launch_recorded(state, "forces", lambda: _force_stages(model, state))
    arrays = {path: attrgetter(path)(state) for path in READ_ARRAYS}
    arrays |= zip(("pair pushes", "wall pushes", "wall arms"), _arrays(state))
    return StationArrays(model, chunks_of(state), {name: each.numpy() for name, each in arrays.items()})


def _arrays(state: State) -> tuple[wp.array, wp.array, wp.array]:
    vec3 = types(state.model.scalar).vec3
    slots = state.slots.history.shape[1]
    return (
        state.scratch("pair pushes", (len(state.pairs.other),), vec3),
        state.scratch("wall pushes", (state.sphere_count, slots), vec3),
        state.scratch("wall arms", (state.sphere_count, slots), vec3),
    )


def _force_stages(model: Model, state: State) -> list[Stage]:
    f = model.features
    pair_push, wall_push, wall_arm = _arrays(state)
    kernel = force_probe(model.scalar, f.pair_law, f.wall_law, f.half_list, f.history, f.bonds)
    base = int(state.batch.rows["spheres"][state.index])
    return [
        scene_stage(state, kernel, last - first, first=base + first, last=base + last, pair_push=pair_push,
                    wall_push=wall_push, wall_arm=wall_arm)
        for first, last in pairwise(state.chunks)
    ]  # fmt: skip
