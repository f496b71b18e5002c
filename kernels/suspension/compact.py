"""Compact copy of the viscous matrix, for the viscous solves of the preconditioner on a GPU.

A GPU spends most of the time of a viscous solve on reading the matrix. The preconditioner needs the matrix only
approximately, so the copy rounds the off-diagonal entries to 16 bits (bfloat16, the upper half of a number in single
precision). It does not store the columns of these entries, because they follow from the row: a face is coupled with at
most ENTRIES other faces, at fixed offsets on the grid.

The sum of the rounding errors of a row is added to the diagonal, so that a uniform motion causes the same forces as
with the exact matrix. Otherwise, rounding errors would exceed the inertia of the mortar in long time steps. Rotations
cause exact forces only in cubic cells, where the entries that cancel one another are equal and are rounded alike.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..mps.grid.cells import GridKind, grid_parameters_struct
from ..mps.grid.levels import system_structs
from ..mps.structs import row_place
from .vectors import share_functions, store_function, vector_struct

ENTRIES = 14
"""Number of off-diagonal entries of a row.

The axis of a face is the axis to which the face is perpendicular. A face is coupled with its two neighbours of the same
axis along this axis. For each of the other two axes, it is coupled with its two neighbours of the same axis along that
other axis, and with four faces of that other axis.
"""

NEIGHBOURS = """
    const int rows = 3 * slots, axis = row / slots, cell = row - axis * slots;
    int up = deep, down = -deep;
    if (period > 0) {
        const int layer = cell / deep - 1;
        up -= layer == period - 1 ? period * deep : 0;
        down += layer == 0 ? period * deep : 0;
    }
    const int first = axis == 2 ? 0 : axis + 1, second = axis == 0 ? 2 : axis - 1;
    const auto after = [&](int along) { return along == 0 ? 1 : along == 1 ? wide : up; };
    const auto before = [&](int along) { return along == 0 ? -1 : along == 1 ? -wide : down; };
    const auto column = [&](int k) {
        const int along = k < 2 ? axis : k < 8 ? first : second, part = k < 2 ? k : (k - 2) % 6;
        int place = cell;
        if (part == 0)
            place += before(along);
        else if (part == 1 || part >= 4)
            place += after(along);
        if (part == 3 || part == 5)
            place += before(axis);
        place += (part < 2 ? axis : along) * slots;
        return place < 0 ? 0 : place < rows ? place : rows - 1;
    };
"""
"""C++ source of the function `column`, which returns the column of the entry k of a row.

Entries 0 and 1 belong to the face's own axis. Each other axis has six entries: the faces of the same axis on both
sides, and four faces of the other axis. The argument `wide` is the number of cells in a row of cells along the first
axis, `deep` the number in a horizontal layer, and `period` the number of layers of a periodic grid, or 0. The frame
around the grid counts in `wide` and `deep`. A column outside the grid, whose entry is 0, is moved into the range of
valid columns.
"""
COMPRESS = """
    float sums[ENTRIES] = {};
    SCALAR change = 0;
    for (int n = 0; n < count; ++n) {
        const size_t at = size_t(n) * step + start;
        const float value = (float)coefficient.data[at];
        bool found = false;
        change -= coefficient.data[at];
#pragma unroll
        for (int k = 0; k < ENTRIES; ++k) {
            const bool same = !found && column(k) == near.data[at];
            sums[k] += same ? value : 0.0f;
            found = found || same;
        }
    }
#pragma unroll
    for (int k = 0; k < ENTRIES; k += 2) {
        unsigned int both = 0;
        for (int half = 0; half < 2; ++half) {
            union { float number; unsigned int bits; } part = {sums[k + half]};
            part.bits = (part.bits + 0x7fffu + ((part.bits >> 16) & 1u)) & 0xffff0000u;
            both |= half == 0 ? part.bits >> 16 : part.bits;
            change += (SCALAR)part.number;
        }
        entries.data[size_t(k / 2) * rows + row] = both;
    }
    return change;
"""
PRODUCT = """
    SCALAR even = 0, odd = 0;
#pragma unroll
    for (int k = 0; k < ENTRIES; k += 2) {
        const unsigned int both = entries.data[size_t(k / 2) * rows + row];
        union { unsigned int bits; float number; } one, two;
        one.bits = both << 16;
        two.bits = both & 0xffff0000u;
        even += (SCALAR)one.number * value.data[column(k)];
        odd += (SCALAR)two.number * value.data[column(k + 1)];
    }
    return even + odd;
"""


@functools.cache
def compact_struct(scalar):
    """Build the struct `Compact`, which holds the compact copy of the viscous matrix."""

    @wp.struct
    class Compact:
        # Off-diagonal entries times -1, as pairs of bfloat16. The pair with the index k * rows + row holds the entries
        # 2 k (lower half) and 2 k + 1 (upper half) of a row. Shape (ENTRIES / 2 * rows,).
        entries: wp.array(dtype=wp.uint32)
        # Diagonal plus the rounding errors of the row; 0 for faces whose velocities are known. Shape (rows,).
        diagonal: wp.array(dtype=scalar)

    return Compact


@functools.cache
def compact_kernels(scalar, serial: bool, of: GridKind) -> SimpleNamespace:
    """Build the kernels of the compact copy of the viscous matrix A.

    - `compress` makes the copy, with one task per row.
    - `multiply` computes the product of the copy and a direction on all faces, with `tasks` tasks.
    """
    Grid = grid_parameters_struct(scalar, 3)
    Matrix, Vector, Compact = system_structs(scalar).Matrix, vector_struct(scalar), compact_struct(scalar)
    own, store, entry = share_functions(serial), store_function(serial), row_place(serial)
    name = "double" if scalar is wp.float64 else "float"

    def source(text: str) -> str:
        return (NEIGHBOURS + text).replace("SCALAR", name).replace("ENTRIES", str(ENTRIES))

    @wp.func_native(source(COMPRESS))
    def compress_row(
        row: wp.int32, slots: wp.int32, wide: wp.int32, deep: wp.int32, period: wp.int32, count: wp.int32,
        start: wp.int32, step: wp.int32, near: wp.array(dtype=wp.int32), coefficient: wp.array(dtype=scalar),
        entries: wp.array(dtype=wp.uint32),
    ) -> scalar: ...  # fmt: skip

    @wp.func_native(source(PRODUCT))
    def product(
        row: wp.int32, slots: wp.int32, wide: wp.int32, deep: wp.int32, period: wp.int32,
        entries: wp.array(dtype=wp.uint32), value: wp.array(dtype=scalar),
    ) -> scalar: ...  # fmt: skip

    @wp.func
    def period(g: Grid) -> wp.int32:
        return wp.where(wp.static(of.periodic), g.n[2], 0)

    @wp.kernel(enable_backward=False, module="unique")
    def compress(g: Grid, matrix: Matrix, compact: Compact):
        r = wp.tid()
        diagonal = scalar(0.0)
        count = wp.int32(0)
        if matrix.free[r] == 0:
            diagonal = matrix.diagonal[r]
            count = matrix.near_count[r]
        start = entry(r, 0, matrix.rows, matrix.near_capacity)
        step = entry(r, 1, matrix.rows, matrix.near_capacity) - start
        wide, deep = g.n[0] + 2, (g.n[0] + 2) * (g.n[1] + 2)
        compact.diagonal[r] = diagonal + compress_row(
            r, g.slots, wide, deep, period(g), count, start, step, matrix.near, matrix.coefficient, compact.entries
        )

    @wp.kernel(enable_backward=False, module="unique")
    def multiply(
        g: Grid, tasks: wp.int32, compact: Compact, inverse: wp.array(dtype=scalar), direction: Vector, result: Vector,
        partial: wp.array(dtype=wp.float64),
    ):  # fmt: skip
        task = wp.tid()
        rows = 3 * g.slots
        wide, deep = g.n[0] + 2, (g.n[0] + 2) * (g.n[1] + 2)
        sum = wp.float64(0.0)
        for r in range(own.first(task, tasks, rows), own.end(task, tasks, rows), own.stride(tasks)):
            diagonal = compact.diagonal[r]
            x = direction.faces[r]
            q = scalar(0.0)
            if diagonal != scalar(0.0):
                other = product(r, g.slots, wide, deep, period(g), compact.entries, direction.faces)
                q = diagonal * x - other
                if inverse[r] != scalar(0.0):
                    sum += wp.float64(q * x)
            result.faces[r] = q
        store(task, partial, 0, sum)

    return SimpleNamespace(compress=compress, multiply=multiply)
