"""Device functions for pipe axes made of lines and arcs, and for closest points on triangles."""

import functools
from types import SimpleNamespace

import warp as wp

from .types import types

LINE: int = wp.constant(0)
ARC: int = wp.constant(1)


@functools.cache
def axis_functions(scalar):
    """Return the struct ``Segment`` (a line or arc of a pipe axis) and the function `closest_on_axis`."""
    t = types(scalar)

    @wp.struct
    class Segment:
        kind: wp.int32  # Kind of the segment: LINE or ARC.
        start: t.vec3  # First point of the segment [m].
        tangent: t.vec3  # Unit tangent at the segment's first point.
        outward: t.vec3  # Unit vector from an arc's centre to its first point; unused for lines.
        radius: scalar  # Radius of an arc's centreline [m]; unused for lines.
        lower: scalar  # Lower end of the segment: distance from `start` along a line [m], or angle on an arc [rad].
        upper: scalar  # Upper end of the segment: distance from `start` along a line [m], or angle on an arc [rad].

    @wp.func
    def closest_on_axis(segments: wp.array(dtype=Segment), first: wp.int32, last: wp.int32, x: t.vec3):
        """Return the vector from the nearest point of the axis to `x` [m], and the axis' unit tangent at that point."""
        best = scalar(1.0e30)
        best_offset = t.vec3()
        best_tangent = t.vec3()
        for s in range(first, last):
            segment = segments[s]
            offset = t.vec3()
            tangent = segment.tangent
            if segment.kind == LINE:
                along = wp.clamp(wp.dot(x - segment.start, segment.tangent), segment.lower, segment.upper)
                offset = x - segment.start - along * segment.tangent
            else:
                centre = segment.start - segment.radius * segment.outward
                local = x - centre
                angle = wp.atan2(wp.dot(local, segment.tangent), wp.dot(local, segment.outward))
                angle = wp.clamp(angle, segment.lower, segment.upper)
                c = wp.cos(angle)
                d = wp.sin(angle)
                offset = local - segment.radius * (c * segment.outward + d * segment.tangent)
                tangent = c * segment.tangent - d * segment.outward
            distance = wp.dot(offset, offset)
            if distance < best:
                best = distance
                best_offset = offset
                best_tangent = tangent
        return best_offset, best_tangent

    return SimpleNamespace(Segment=Segment, closest_on_axis=closest_on_axis)


@functools.cache
def triangle_functions(scalar):
    """Build the function `closest_on_triangle`, in one precision.

    The function projects the point onto the triangle's plane. If the projection lies outside one or two edges, the
    result is the closest point of the nearest of these edges. This method is exact to rounding even on triangles that
    are hundreds of times longer than wide (a straight pipe in an STL file), where barycentric coordinates lose
    accuracy.
    """
    t = types(scalar)

    @wp.func
    def closest_on_edge(p: t.vec3, a: t.vec3, b: t.vec3):
        """Return the point of segment ab closest to p, and a code: 0 if it is a, 1 if between a and b, 2 if it is b."""
        along = b - a
        part = wp.dot(p - a, along) / wp.dot(along, along)
        if part <= scalar(0.0):
            return a, wp.int32(0)
        if part >= scalar(1.0):
            return b, wp.int32(2)
        return a + part * along, wp.int32(1)

    @wp.func
    def feature_of(edge: wp.int32, where: wp.int32):
        if where == 1:
            return 1 + edge
        if where == 0:
            return 4 + edge
        return 4 + (edge + 1) % 3

    @wp.func
    def closest_on_triangle(p: t.vec3, a: t.vec3, b: t.vec3, c: t.vec3):
        """Return the point of triangle abc closest to p, and a code for the face, edge or corner on which it lies.

        The code is 0 inside the face, 1, 2 or 3 on the edge from corner 0, 1 or 2 to the next corner, and 4, 5 or 6 at
        corner 0, 1 or 2.
        """
        zero = scalar(0.0)
        n = wp.normalize(wp.cross(b - a, c - a))
        outside_ab = wp.dot(wp.cross(n, b - a), p - a) < zero
        outside_bc = wp.dot(wp.cross(n, c - b), p - b) < zero
        outside_ca = wp.dot(wp.cross(n, a - c), p - c) < zero
        point = p - wp.dot(p - a, n) * n
        feature = wp.int32(0)
        best = scalar(1.0e30)
        if outside_ab:
            near, where = closest_on_edge(p, a, b)
            best = wp.length_sq(p - near)
            point = near
            feature = feature_of(0, where)
        if outside_bc:
            near, where = closest_on_edge(p, b, c)
            if wp.length_sq(p - near) < best:
                best = wp.length_sq(p - near)
                point = near
                feature = feature_of(1, where)
        if outside_ca:
            near, where = closest_on_edge(p, c, a)
            if wp.length_sq(p - near) < best:
                best = wp.length_sq(p - near)
                point = near
                feature = feature_of(2, where)
        return point, feature

    return SimpleNamespace(closest_on_triangle=closest_on_triangle)
