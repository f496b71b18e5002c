"""Vectors of the coupled equations of mortar and aggregates, and how tasks share and add up their entries."""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.reductions import total
from ..common.types import types

# Indices of the array of sums of a solve by conjugate gradients.
RZ = wp.constant(0)  # Product of residual and preconditioned residual.
PQ = wp.constant(1)  # Product of the search direction and its product with the matrix.
RZ_AFTER = wp.constant(2)  # Product of residual and preconditioned residual after the step.
RZ_FIRST = wp.constant(3)  # Product of residual and preconditioned residual at the start of the solve.
SUMS = 4


@functools.cache
def vector_struct(scalar):
    """Build the struct `Vector`: values of all unknowns, or of the residuals of all equations."""
    vec3 = types(scalar).vec3

    @wp.struct
    class Vector:
        faces: wp.array(dtype=scalar)  # Values of the faces, shape (3 slots,).
        linear: wp.array(dtype=vec3)  # Velocity of or force on each aggregate, shape (n,).
        angular: wp.array(dtype=vec3)  # Spin of or torque on each aggregate, shape (n,).
        cells: wp.array(dtype=scalar)  # Values of the cells, shape (slots,).

    return Vector


@functools.cache
def share_functions(serial: bool) -> SimpleNamespace:
    """Build functions that divide items among tasks: `first`, `end` and `stride` of the items of one task.

    A CPU task gets a contiguous range of items; the tasks of a GPU take the items in turn.
    """

    @wp.func
    def first(task: wp.int32, tasks: wp.int32, items: wp.int32) -> wp.int32:
        if wp.static(serial):
            return wp.int32(wp.int64(task) * wp.int64(items) / wp.int64(tasks))
        return task

    @wp.func
    def end(task: wp.int32, tasks: wp.int32, items: wp.int32) -> wp.int32:
        if wp.static(serial):
            return wp.int32(wp.int64(task + 1) * wp.int64(items) / wp.int64(tasks))
        return items

    @wp.func
    def stride(tasks: wp.int32) -> wp.int32:
        return wp.where(wp.static(serial), 1, tasks)

    return SimpleNamespace(first=first, end=end, stride=stride)


@functools.cache
def sum_kernel(serial: bool):
    """Build the kernel that adds up partial sums; on a GPU it runs in one block."""

    @wp.kernel(enable_backward=False, module="unique")
    def add_up(count: wp.int32, slot: wp.int32, partial: wp.array(dtype=wp.float64), sums: wp.array(dtype=wp.float64)):
        if wp.static(serial):
            sum = wp.float64(0.0)
            for k in range(count):
                sum += partial[k]
            sums[slot] = sum
        else:
            sum = total(wp.tid(), partial, 0, count)
            if wp.tid() == 0:
                sums[slot] = sum

    return add_up


@functools.cache
def add_kernel(scalar):
    """Build the kernel that adds a multiple of an array to another one, with one task per element."""

    @wp.kernel(enable_backward=False, module="unique")
    def add_multiple(one: wp.array(dtype=scalar), factor: scalar, result: wp.array(dtype=scalar)):
        k = wp.tid()
        result[k] = result[k] + factor * one[k]

    return add_multiple
