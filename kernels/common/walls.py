"""What walls are, whatever meets them, and how far a point is from one that is given by a formula.

Another such shape is a branch in both functions of :func:`wall_functions`, and a class in `geometry/walls.py`.
"""

import functools
from types import SimpleNamespace

import warp as wp

from .geometry import axis_functions
from .types import types, vector_functions

# Shapes. Those given by a formula come before meshes, in numbers as in the order of a scene's walls.
PLANE = wp.constant(0)
PIPE = wp.constant(1)
MESH = wp.constant(2)

# What lies across an edge of a mesh's face, where that is not a single face: nothing, or several faces; then the number
# of the edge's row in the rings of the corners is taken off.
BORDER = wp.constant(-1)
SHARED = wp.constant(-2)

# Motions.
FIXED = wp.constant(0)
PRESCRIBED = wp.constant(1)
DRIVEN = wp.constant(2)


@functools.cache
def wall_struct(scalar):
    """What a wall is, its state apart."""
    t = types(scalar)

    @wp.struct
    class Wall:
        kind: wp.int32
        material: wp.int32
        normal: t.vec3  # planes: unit normal into the material, in the wall's frame
        radius: scalar  # pipes: inner radius
        first: wp.int32  # pipes: range of axis segments
        last: wp.int32
        mesh: wp.uint64  # meshes: id of the wp.Mesh, in the wall's frame
        first_face: wp.int32  # meshes: offset of its faces in the flat face arrays
        motion: wp.int32
        start_time: wp.float64  # prescribed motion: the speed ramps linearly from start_time on ...
        ramp_time: wp.float64  # ... for this long, then holds
        stops: wp.float64  # how often it first goes from rest to rest and pauses, a whole number
        stroke_time: wp.float64  # from rest to rest, with a ramp at both ends [s]
        pause: wp.float64  # behind each stroke [s]
        velocity: wp.vec3d  # of the final, steady motion [m/s]
        spin: wp.vec3d  # [rad/s], about `pivot`
        pivot: wp.vec3d
        mass: wp.float64  # driven walls: inertia along `velocity`'s unit direction [kg]
        drive_force: wp.float64  # force that pushes a driven wall along that direction [N]
        drive_damping: wp.float64  # [N s/m]
        extent: wp.float64  # meshes: largest distance of a corner from the wall's origin [m]

    return Wall


@functools.cache
def wall_functions(scalar):
    """`distance_to_wall` and `into_wall`, for walls given by a formula."""
    t = types(scalar)
    Wall = wall_struct(scalar)
    axis = axis_functions(scalar)
    Segment = axis.Segment
    closest_on_axis = axis.closest_on_axis
    safe_normalize = vector_functions(scalar).safe_normalize

    @wp.func
    def distance_to_wall(wall: Wall, segments: wp.array(dtype=Segment), place: t.vec3, normal: t.vec3, x: t.vec3):
        """Distance of `x` to the surface of a wall that is at `place`, turned to `normal`; negative behind it [m].

        Also a vector that points to the nearest place of the surface, of any length.
        """
        if wall.kind == PLANE:
            return wp.dot(place - x, -normal), -normal
        offset, tangent = closest_on_axis(segments, wall.first, wall.last, x - place)
        return wall.radius - wp.length(offset), offset

    @wp.func
    def into_wall(wall: Wall, direction: t.vec3):
        """Unit vector of a direction that `distance_to_wall` gave."""
        if wall.kind == PLANE:
            return direction
        # On the axis of a pipe every direction leads to the wall.
        return safe_normalize(direction, t.vec3(scalar(0.0), scalar(0.0), scalar(1.0)))

    return SimpleNamespace(Segment=Segment, distance_to_wall=distance_to_wall, into_wall=into_wall)
