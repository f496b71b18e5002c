"""Wall data that all methods share, and distances of points from planes and pipes (walls given by a formula).

To add another shape that a formula describes, add a branch to both functions of :func:`wall_functions` and a class to
`geometry/walls.py`.
"""

import functools
from types import SimpleNamespace

import warp as wp

from .geometry import axis_functions
from .types import types, vector_functions

# Codes for the shapes of walls. Shapes given by a formula come before meshes, both in these codes and in a scene's list
# of walls.
PLANE: int = wp.constant(0)
PIPE: int = wp.constant(1)
MESH: int = wp.constant(2)

# The first three columns of the array `across` of a mesh contain a number for each edge of a face. If exactly one other
# face shares the edge, the number is the index of that face's corner opposite the edge. If no other face shares the
# edge, the number is BORDER. If several faces share the edge, it is SHARED - k, where k is the number of a list in the
# array `ring`. This list contains the opposite corners of all these faces.
BORDER: int = wp.constant(-1)
SHARED: int = wp.constant(-2)

# Kinds of wall motion: at rest, prescribed as a function of time, or driven by a force.
FIXED: int = wp.constant(0)
PRESCRIBED: int = wp.constant(1)
DRIVEN: int = wp.constant(2)


@functools.cache
def wall_struct(scalar):
    """Build the struct of a wall's constant properties, in one precision."""
    t = types(scalar)

    @wp.struct
    class Wall:
        kind: wp.int32  # Shape of the wall: PLANE, PIPE or MESH.
        material: wp.int32  # Index of the wall's material in the model.
        normal: t.vec3  # Unit normal of a plane, which points into the concrete, in the wall's frame.
        radius: scalar  # Inner radius of a pipe [m].
        first: wp.int32  # Index of the first axis segment of a pipe.
        last: wp.int32  # Index of the last axis segment of a pipe, plus 1.
        mesh: wp.uint64  # Identifier of a mesh wall's wp.Mesh, whose corners are in the wall's frame.
        first_face: wp.int32  # Index of a mesh wall's first face in the arrays of all faces.
        motion: wp.int32  # Kind of motion: FIXED, PRESCRIBED or DRIVEN.
        start_time: wp.float64  # Time at which the wall starts to move from rest [s].
        ramp_time: wp.float64  # Time in which the speed of a prescribed motion rises linearly to its final value [s].

        # Number of strokes from rest to rest, each followed by a pause, before the wall moves steadily.
        stops: wp.float64
        stroke_time: wp.float64  # Duration of a stroke from rest to rest, including a speed ramp at both ends [s].
        pause: wp.float64  # Pause after each stroke [s].

        # If the motion of the wall is prescribed: velocity of the steady motion, after the ramp and all strokes [m/s].
        # If the wall is driven by a force: a vector in the direction of motion.
        velocity: wp.vec3d
        spin: wp.vec3d  # Angular velocity of the wall about `pivot` [rad/s].
        pivot: wp.vec3d  # Point about which the wall rotates, before the translation with `velocity` [m].
        mass: wp.float64  # Inertia of a driven wall along its direction of motion [kg].
        drive_force: wp.float64  # Force that pushes a driven wall along its direction of motion [N].
        drive_damping: wp.float64  # Viscous damping of a driven wall's motion [N s/m].
        extent: wp.float64  # Largest distance of a mesh wall's corners from the origin of the wall's frame [m].

    return Wall


@functools.cache
def wall_functions(scalar):
    """Build `distance_to_wall` and `into_wall`, which return distance and direction from a point to a plane or pipe."""
    t = types(scalar)
    Wall = wall_struct(scalar)
    axis = axis_functions(scalar)
    Segment = axis.Segment
    closest_on_axis = axis.closest_on_axis
    safe_normalize = vector_functions(scalar).safe_normalize

    @wp.func
    def distance_to_wall(wall: Wall, segments: wp.array(dtype=Segment), place: t.vec3, normal: t.vec3, x: t.vec3):
        """Return the distance of `x` from a wall [m], which is negative behind the wall, and a vector towards the wall.

        `place` is the present position of the wall. `normal` is the present normal of a plane and unused for a pipe.
        The vector points towards the nearest point of the wall, and its length has no meaning.
        """
        if wall.kind == PLANE:
            return wp.dot(place - x, -normal), -normal
        offset, tangent = closest_on_axis(segments, wall.first, wall.last, x - place)
        return wall.radius - wp.length(offset), offset

    @wp.func
    def into_wall(wall: Wall, direction: t.vec3):
        """Return the unit vector from a point towards a wall.

        `direction` is the vector that `distance_to_wall` returned for this point.
        """
        if wall.kind == PLANE:
            return direction
        # On the axis of a pipe every direction leads to the wall, so any unit vector is correct.
        return safe_normalize(direction, t.vec3(scalar(0.0), scalar(0.0), scalar(1.0)))

    return SimpleNamespace(Segment=Segment, distance_to_wall=distance_to_wall, into_wall=into_wall)
