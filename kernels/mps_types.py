"""Types, numbers and small functions that the kernels of the moving particle method share.

One source serves two and three dimensions. The last coordinate runs along the pipe, the others across it; places are
counted from the piston, velocities are those of the room.
"""

import functools
from types import SimpleNamespace

import warp as wp

from .types import SPAN

# Slots of the integer control array `flags`.
HALTED = wp.constant(0)  # every kernel returns at once: the lists are stale, or a solve failed
STALE = wp.constant(1)  # a particle left the place for which the lists were built
FAILED = wp.constant(2)  # number of the solve that failed, or LOST
STEPS = wp.constant(3)  # completed steps
OVERFLOW = wp.constant(4)  # over 1000: what the longest row of a list needs, in per mille of its capacity
FLAGS = 8

# What failed.
VISCOSITY = 1
PRESSURE = 2
DENSITY = 3
LOST = 4  # a particle is not a number, or far outside


@functools.cache
def mps_types(scalar, dimensions: int) -> SimpleNamespace:
    """`vec` and `mat` of one precision in two or three dimensions."""
    double = scalar is wp.float64
    if dimensions == 2:
        return SimpleNamespace(vec=wp.vec2d if double else wp.vec2f, mat=wp.mat22d if double else wp.mat22f)
    return SimpleNamespace(vec=wp.vec3d if double else wp.vec3f, mat=wp.mat33d if double else wp.mat33f)


@functools.cache
def fluid_struct(scalar):
    """Numbers of a flow."""

    @wp.struct
    class Flow:
        count: wp.int32  # fluid particles
        spacing: scalar  # l0 [m]
        cutoff: scalar  # reach of gradient, divergence and Laplacian [m]
        wide: scalar  # reach of the density [m]
        lattice_number: scalar  # sum of weights inside the lattice
        lattice_density: scalar  # sum of density weights inside the lattice
        radius: scalar  # of the pipe, or half the channel's width [m]
        piston_speed: scalar  # [m/s]
        gravity: scalar  # along the pipe, against the flow [m/s2]
        dt: scalar  # [s]
        density: scalar  # reference of the pressure's equation [kg/m3]
        viscosity: scalar  # plastic [Pa s]
        yield_stress: scalar  # [Pa]
        regularisation: scalar  # beta [s]
        slip_viscosity: scalar  # eta_L [Pa s/m]
        slip_yield: scalar  # tau_L0 [Pa]
        aggregate_viscosity: scalar  # of coarse aggregate [Pa s]
        correction: scalar  # share of the density's error that a step takes away
        skin: scalar  # of the lists [m]

    return Flow


@functools.cache
def mps_functions(scalar, dimensions: int) -> SimpleNamespace:
    """Weights and geometry of one precision in two or three dimensions."""
    t = mps_types(scalar, dimensions)
    last = dimensions - 1

    @wp.func
    def across(x: t.vec) -> t.vec:
        """The part of a vector that is not along the pipe."""
        x[last] = scalar(0.0)
        return x

    @wp.func
    def outward(x: t.vec) -> t.vec:
        """Unit vector from the axis to a place."""
        part = across(x)
        size = wp.length(part)
        if size > scalar(0.0):
            return part / size
        return t.vec()

    @wp.func
    def weight(r: scalar, reach: scalar) -> scalar:
        """Koshizuka & Oka's weight (Xu, Li & Jiang 2021, Eq. 2)."""
        return reach / r - scalar(1.0)

    @wp.func
    def density_weight(r: scalar, reach: scalar) -> scalar:
        """Wendland's quintic: its sum hardly depends on how particles at the same density are arranged."""
        if r >= reach:
            return scalar(0.0)
        q = r / reach
        a = scalar(1.0) - q
        a = a * a
        return a * a * (scalar(4.0) * q + scalar(1.0))

    @wp.func
    def inverse(m: t.mat) -> t.mat:
        """Of a moment matrix; where too few neighbours fix it, that of its mean."""
        mean = wp.trace(m) / scalar(dimensions)
        whole = mean
        for _ in range(wp.static(dimensions - 1)):
            whole *= mean
        if wp.determinant(m) > scalar(1.0e-3) * whole:
            return wp.inverse(m)
        if mean > scalar(0.0):
            return wp.identity(n=wp.static(dimensions), dtype=scalar) / mean
        return t.mat()

    return SimpleNamespace(
        across=across, outward=outward, weight=weight, density_weight=density_weight, inverse=inverse
    )


def row_place(serial: bool):
    """Function of (row, entry, rows, capacity): where an entry of a row of a list lies.

    A CPU walks a row, so its entries are neighbours; threads of a GPU walk many rows abreast, so those are.
    """
    return place_by_row if serial else place_by_entry


@wp.func
def place_by_row(row: wp.int32, entry: wp.int32, rows: wp.int32, capacity: wp.int32) -> wp.int32:
    return row * capacity + entry


@wp.func
def place_by_entry(row: wp.int32, entry: wp.int32, rows: wp.int32, capacity: wp.int32) -> wp.int32:
    return entry * rows + row


def span(serial: bool) -> int:
    """Rows that a task takes: many on a CPU, where a task costs, one on a GPU."""
    return SPAN if serial else 1
