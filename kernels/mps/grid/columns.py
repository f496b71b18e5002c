"""Particles in columns, by which a CPU transfers mass and velocity to cells and faces with vector instructions.

A column is a part of an array that holds one number of each particle, such as a component of its velocity. The
particles are sorted by cell. Loops over the particles of a cell process LANES particles at a time: a first loop
computes weights and values, and the compiler turns this loop into vector instructions. A second loop adds up the values
in the order of the particles, so the sums have the same bits as without vector instructions.

A GPU has no columns. Its threads read the particles one by one (`transfer.py`, `filling.py`).
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..structs import mps_types
from .cells import grid_structs

LANES = 8
"""Number of particles that are processed at a time, and number of unused entries at the end of each column. A cell in
space holds about eight particles."""


def column_count(dimensions: int) -> int:
    """Return the number of columns: one for the mass, and one per component of position, velocity and gradient."""
    return 1 + 2 * dimensions + dimensions**2


WEIGHTS = """
    using T = SCALAR;
    const T* at = columns.data + begin;
    for (int left = count; left > 0; left -= LANES, at += LANES) {
        T weight[LANES], value[LANES];
        for (int k = 0; k < LANES; ++k) {
            T d[DIMS];
            for (int b = 0; b < DIMS; ++b)
                d[b] = DISTANCE;
            T factor = FIRST;
            for (int b = 0; b < DIMS; ++b) {
                const T near = T(1) - wp::abs(d[b]) / width[b];
                factor *= near > T(0) ? near : T(0);
            }
            VALUE
            weight[k] = k < left ? factor : T(0);
        }
        for (int k = 0; k < LANES; ++k) {
            ADD
        }
    }
    return sums;
"""
"""C++ source of the loop over the particles of a cell. The functions below replace the words in capitals. The last
iteration of the loop may read particles of the next cell, which get the weight 0."""


@functools.cache
def column_functions(scalar, dimensions: int, periodic: bool = False) -> SimpleNamespace:
    """Build functions that write and read the columns of particles.

    - `store` copies a particle into entry k of each column.
    - `add_mass` adds the mass of the particles of a cell to a sum. The weights of the particles fall linearly to zero
      at a distance of one cell from a point.
    - `add_velocity` adds the weights of the particles, and their weighted velocities along an axis, to two sums. The
      velocity of each particle is extrapolated linearly to the point, with the particle's velocity gradient.

    The entries of a cell begin at `begin`, and there are `count` of them. The columns are `stride` entries apart. In a
    `periodic` pipe, `length` is the length after which the pipe repeats itself.
    """
    t = mps_types(scalar, dimensions)
    vec, Columns = t.vec, wp.array(dtype=scalar)
    pair = wp.types.vector(2, scalar)
    Particles = grid_structs(scalar, dimensions).Particles
    dims = dimensions
    constants = {"LANES": LANES, "DIMS": dims, "SCALAR": "double" if scalar is wp.float64 else "float"}

    def source(distance: str, first: str, value: str, add: str) -> str:
        found = WEIGHTS
        for word, text in ({"DISTANCE": distance, "FIRST": first, "VALUE": value, "ADD": add} | constants).items():
            found = found.replace(word, str(text))
        return found

    @wp.func
    def store(particles: Particles, p: wp.int32, columns: Columns, k: wp.int32, stride: wp.int32):
        x, u, slope = particles.position[p], particles.velocity[p], particles.gradient[p]
        columns[k] = particles.mass[p]
        for b in range(dims):
            columns[(1 + b) * stride + k] = x[b]
            columns[(1 + dims + b) * stride + k] = u[b]
            for d in range(dims):
                columns[(1 + 2 * dims + b * dims + d) * stride + k] = slope[b, d]

    @wp.func_native(
        source("at[(1 + b) * stride + k] - place[b]", "T(1)", "value[k] = at[k];", "sums += weight[k] * value[k];")
    )
    def add_mass(
        columns: Columns, stride: wp.int32, begin: wp.int32, count: wp.int32, place: vec, width: vec, sums: scalar
    ) -> scalar: ...

    # Sum the products of the gradient and the distance in the order in which Warp multiplies a matrix by a vector.
    distance = "place[b] - at[(1 + b) * stride + k]"
    turned = f"({distance}) - (b == DIMS - 1 ? length * wp::round(({distance}) / length) : T(0))"

    @wp.func_native(
        source(
            turned if periodic else distance,
            "at[k]",
            """
            const T* slope = at + (1 + 2 * DIMS + axis * DIMS) * stride + k;
            T change = slope[0] * d[0];
            for (int b = 1; b < DIMS; ++b)
                change += slope[b * stride] * d[b];
            value[k] = at[(1 + DIMS + axis) * stride + k] + change;
            """,
            "sums[0] += weight[k]; sums[1] += weight[k] * value[k];",
        )
    )
    def add_velocity(
        columns: Columns, stride: wp.int32, begin: wp.int32, count: wp.int32, place: vec, width: vec, length: scalar,
        axis: wp.int32, sums: pair,
    ) -> pair: ...  # fmt: skip

    return SimpleNamespace(store=store, add_mass=add_mass, add_velocity=add_velocity, pair=pair)
