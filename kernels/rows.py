"""Reads and writes of arrays' rows, for the loops where most of the time goes.

Warp's own indexing allows negative indices and any stride, which costs six instructions an access. These functions
take contiguous arrays of one dimension and indices from 0 on, and check nothing.
"""

from types import SimpleNamespace

import warp as wp

READ = "return rows.data[i];"
WRITE = "rows.data[i] = value;"


@wp.func_native(READ)
def read_int(rows: wp.array(dtype=wp.int32), i: wp.int32) -> wp.int32: ...


@wp.func_native(READ)
def read_vec3f(rows: wp.array(dtype=wp.vec3f), i: wp.int32) -> wp.vec3f: ...


@wp.func_native(READ)
def read_vec4f(rows: wp.array(dtype=wp.vec4f), i: wp.int32) -> wp.vec4f: ...


@wp.func_native(READ)
def read_vec3d(rows: wp.array(dtype=wp.vec3d), i: wp.int32) -> wp.vec3d: ...


@wp.func_native(READ)
def read_vec4d(rows: wp.array(dtype=wp.vec4d), i: wp.int32) -> wp.vec4d: ...


@wp.func_native(WRITE)
def write_vec3f(rows: wp.array(dtype=wp.vec3f), i: wp.int32, value: wp.vec3f): ...


@wp.func_native(WRITE)
def write_vec3d(rows: wp.array(dtype=wp.vec3d), i: wp.int32, value: wp.vec3d): ...


@wp.func_native(WRITE)
def write_vec4f(rows: wp.array(dtype=wp.vec4f), i: wp.int32, value: wp.vec4f): ...


@wp.func_native(WRITE)
def write_vec4d(rows: wp.array(dtype=wp.vec4d), i: wp.int32, value: wp.vec4d): ...


SINGLE = SimpleNamespace(int=read_int, vec3=read_vec3f, vec4=read_vec4f, write_vec3=write_vec3f, write_vec4=write_vec4f)
DOUBLE = SimpleNamespace(int=read_int, vec3=read_vec3d, vec4=read_vec4d, write_vec3=write_vec3d, write_vec4=write_vec4d)


def row_functions(scalar) -> SimpleNamespace:
    """Functions ``int``, ``vec3``, ``vec4`` (read a row), ``write_vec3`` and ``write_vec4`` of one precision."""
    return DOUBLE if scalar is wp.float64 else SINGLE
