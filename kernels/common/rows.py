"""Fast reads and writes of array rows, and products of sparse matrix rows, for the most expensive loops.

Warp's own indexing allows negative indices and any stride, which costs a CPU six instructions per access. On a GPU it
moves a 4-vector in four pieces, because its type guarantees no alignment. The functions of this module require
contiguous one-dimensional arrays allocated by Warp and nonnegative indices, and they check nothing.
"""

import functools
from types import SimpleNamespace

import warp as wp

from .types import vec8d, vec8f

READ = "return rows.data[i];"
WRITE = "rows.data[i] = value;"
READ_4F = """
#if defined(__CUDA_ARCH__)
    const float4 row = reinterpret_cast<const float4*>(rows.data)[i];
    return wp::vec_t<4, float>(row.x, row.y, row.z, row.w);
#else
    return rows.data[i];
#endif
"""
WRITE_4F = """
#if defined(__CUDA_ARCH__)
    reinterpret_cast<float4*>(rows.data)[i] = make_float4(value[0], value[1], value[2], value[3]);
#else
    rows.data[i] = value;
#endif
"""
READ_4D = """
#if defined(__CUDA_ARCH__)
    const double2 low = reinterpret_cast<const double2*>(rows.data)[2 * size_t(i)];
    const double2 high = reinterpret_cast<const double2*>(rows.data)[2 * size_t(i) + 1];
    return wp::vec_t<4, double>(low.x, low.y, high.x, high.y);
#else
    return rows.data[i];
#endif
"""
WRITE_4D = """
#if defined(__CUDA_ARCH__)
    reinterpret_cast<double2*>(rows.data)[2 * size_t(i)] = make_double2(value[0], value[1]);
    reinterpret_cast<double2*>(rows.data)[2 * size_t(i) + 1] = make_double2(value[2], value[3]);
#else
    rows.data[i] = value;
#endif
"""


READ_HALF_4F = """
#if defined(__CUDA_ARCH__)
    const float4 row = reinterpret_cast<const float4*>(rows.data)[2 * size_t(i) + part];
    return wp::vec_t<4, float>(row.x, row.y, row.z, row.w);
#else
    return reinterpret_cast<const wp::vec_t<4, float>*>(rows.data)[2 * size_t(i) + part];
#endif
"""
WRITE_HALF_4F = """
#if defined(__CUDA_ARCH__)
    reinterpret_cast<float4*>(rows.data)[2 * size_t(i) + part] = make_float4(value[0], value[1], value[2], value[3]);
#else
    reinterpret_cast<wp::vec_t<4, float>*>(rows.data)[2 * size_t(i) + part] = value;
#endif
"""
READ_HALF_4D = "return reinterpret_cast<const wp::vec_t<4, double>*>(rows.data)[2 * size_t(i) + part];"
WRITE_HALF_4D = "reinterpret_cast<wp::vec_t<4, double>*>(rows.data)[2 * size_t(i) + part] = value;"


@wp.func_native(READ)
def read_int(rows: wp.array(dtype=wp.int32), i: wp.int32) -> wp.int32: ...


@wp.func_native(READ)
def read_vec3f(rows: wp.array(dtype=wp.vec3f), i: wp.int32) -> wp.vec3f: ...


@wp.func_native(READ)
def read_vec3d(rows: wp.array(dtype=wp.vec3d), i: wp.int32) -> wp.vec3d: ...


@wp.func_native(READ_4F)
def read_vec4f(rows: wp.array(dtype=wp.vec4f), i: wp.int32) -> wp.vec4f: ...


@wp.func_native(READ_4D)
def read_vec4d(rows: wp.array(dtype=wp.vec4d), i: wp.int32) -> wp.vec4d: ...


@wp.func_native(WRITE)
def write_vec3f(rows: wp.array(dtype=wp.vec3f), i: wp.int32, value: wp.vec3f): ...


@wp.func_native(WRITE)
def write_vec3d(rows: wp.array(dtype=wp.vec3d), i: wp.int32, value: wp.vec3d): ...


@wp.func_native(WRITE_4F)
def write_vec4f(rows: wp.array(dtype=wp.vec4f), i: wp.int32, value: wp.vec4f): ...


@wp.func_native(WRITE_4D)
def write_vec4d(rows: wp.array(dtype=wp.vec4d), i: wp.int32, value: wp.vec4d): ...


@wp.func_native(READ_HALF_4F)
def read_half4f(rows: wp.array(dtype=vec8f), i: wp.int32, part: wp.int32) -> wp.vec4f: ...


@wp.func_native(READ_HALF_4D)
def read_half4d(rows: wp.array(dtype=vec8d), i: wp.int32, part: wp.int32) -> wp.vec4d: ...


@wp.func_native(WRITE_HALF_4F)
def write_half4f(rows: wp.array(dtype=vec8f), i: wp.int32, part: wp.int32, value: wp.vec4f): ...


@wp.func_native(WRITE_HALF_4D)
def write_half4d(rows: wp.array(dtype=vec8d), i: wp.int32, part: wp.int32, value: wp.vec4d): ...


SINGLE = SimpleNamespace(
    read_int=read_int, read_vec3=read_vec3f, read_vec4=read_vec4f, write_vec3=write_vec3f, write_vec4=write_vec4f,
    read_half=read_half4f, write_half=write_half4f,
)  # fmt: skip
DOUBLE = SimpleNamespace(
    read_int=read_int, read_vec3=read_vec3d, read_vec4=read_vec4d, write_vec3=write_vec3d, write_vec4=write_vec4d,
    read_half=read_half4d, write_half=write_half4d,
)  # fmt: skip


def row_functions(scalar) -> SimpleNamespace:
    """Return the functions of one precision that read and write array rows.

    They are `read_int`, `read_vec3`, `read_vec4`, `write_vec3`, `write_vec4`, `read_half` and `write_half`. `read_half`
    and `write_half` access the first (0) or the second (1) four numbers of a row of eight numbers.
    """
    return DOUBLE if scalar is wp.float64 else SINGLE


PRODUCT = """
    const int* place = neighbour.data + first;
    const SCALAR* factor = coefficient.data + first;
    VALUE a = {}, b = {}, c = {}, d = {};
    int k = 0;
    for (; k + 3 < count; k += 4) {
        a += factor[k] * value.data[place[k]];
        b += factor[k + 1] * value.data[place[k + 1]];
        c += factor[k + 2] * value.data[place[k + 2]];
        d += factor[k + 3] * value.data[place[k + 3]];
    }
    for (; k < count; ++k)
        a += factor[k] * value.data[place[k]];
    return (a + b) + (c + d);
"""
"""C++ source of the product of one row of a sparse matrix with a vector. It adds up four independent sums, because in a
single sum every addition would have to wait for the previous one."""


DIRECTED = """
    VALUE a = {}, b = {}, c = {}, d = {};
#if defined(__CUDA_ARCH__)
#define WARPCRETE_CONSTANT(at) __ldg(&at)
#else
#define WARPCRETE_CONSTANT(at) at
#endif
    const auto term = [&](int k) {
        const int at = k * rows + row, j = WARPCRETE_CONSTANT(neighbour.data[at]);
        return WARPCRETE_CONSTANT(coefficient.data[at]) * (TERM);
    };
    int k = 0;
    for (; k + 3 < count; k += 4) {
        a += term(k);
        b += term(k + 1);
        c += term(k + 2);
        d += term(k + 3);
    }
    for (; k < count; ++k)
        a += term(k);
    return (a + b) + (c + d);
"""


@functools.cache
def directed_product(scalar, value_type):
    """Build the function that multiplies one row of a sparse matrix with the vector ``value + factor * direction``.

    The function takes (neighbour, coefficient, value, direction, factor, first, row, rows, count). It returns the sum
    of ``coefficient[e] * (value[j] + factor * direction[first + j])`` over the `count` entries of the row, where
    ``j = neighbour[e]`` is the column. The index of the row's entry k is ``e = k * rows + row``, where `rows` is the
    number of rows. The arrays `neighbour` and `coefficient` must not change while the kernel runs, because a GPU reads
    them through its read-only cache.
    """
    width = wp.types.type_size(value_type)
    name = "double" if scalar is wp.float64 else "float"
    snippet = DIRECTED.replace("VALUE", name if width == 1 else f"wp::vec_t<{width}, {name}>")
    snippet = snippet.replace("TERM", "value.data[j] + factor * direction.data[first + j]")

    @wp.func_native(snippet)
    def product(
        neighbour: wp.array(dtype=wp.int32),
        coefficient: wp.array(dtype=scalar),
        value: wp.array(dtype=value_type),
        direction: wp.array(dtype=value_type),
        factor: scalar,
        first: wp.int32,
        row: wp.int32,
        rows: wp.int32,
        count: wp.int32,
    ) -> value_type: ...

    return product


@functools.cache
def entry_product(scalar, value_type):
    """Build the function that multiplies one row of a sparse matrix with a vector on a GPU.

    The function takes (neighbour, coefficient, value, row, rows, count). It returns the sum of
    ``coefficient[e] * value[neighbour[e]]`` over the `count` entries of the row, where ``neighbour[e]`` is the column.
    The index of the row's entry k is ``e = k * rows + row``, where `rows` is the number of rows. The first entries of
    all rows are therefore stored before all second entries. The arrays `neighbour` and `coefficient` must not change
    while the kernel runs.
    """
    width = wp.types.type_size(value_type)
    name = "double" if scalar is wp.float64 else "float"
    snippet = DIRECTED.replace("VALUE", name if width == 1 else f"wp::vec_t<{width}, {name}>")

    @wp.func_native(snippet.replace("TERM", "value.data[j]"))
    def product(
        neighbour: wp.array(dtype=wp.int32),
        coefficient: wp.array(dtype=scalar),
        value: wp.array(dtype=value_type),
        row: wp.int32,
        rows: wp.int32,
        count: wp.int32,
    ) -> value_type: ...

    return product


@functools.cache
def row_product(scalar, value_type):
    """Build the function that multiplies one row of a sparse matrix with a vector on a CPU.

    The function takes (neighbour, coefficient, value, first, count). It returns the sum of
    ``coefficient[e] * value[neighbour[e]]`` over the `count` entries e of the row, where ``neighbour[e]`` is the
    column. The entries of a row are stored one after the other, and `first` is the index of the first one.
    """
    width = wp.types.type_size(value_type)
    name = "double" if scalar is wp.float64 else "float"
    snippet = PRODUCT.replace("VALUE", name if width == 1 else f"wp::vec_t<{width}, {name}>").replace("SCALAR", name)

    @wp.func_native(snippet)
    def product(
        neighbour: wp.array(dtype=wp.int32),
        coefficient: wp.array(dtype=scalar),
        value: wp.array(dtype=value_type),
        first: wp.int32,
        count: wp.int32,
    ) -> value_type: ...

    return product
