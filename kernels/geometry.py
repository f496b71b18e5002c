"""Pipe axes made of lines and arcs, and closest points on triangles."""

import functools
from types import SimpleNamespace

import warp as wp

from .types import types

LINE = wp.constant(0)
ARC = wp.constant(1)

# Features of a triangle that can hold its closest point, as returned by `closest_on_triangle`.
FACE = wp.constant(0)  # 1, 2, 3: the edge from corner 0, 1, 2 to the next; 4, 5, 6: corner 0, 1, 2
FIRST_EDGE = wp.constant(1)
FIRST_CORNER = wp.constant(4)


@functools.cache
def axis_functions(scalar):
    """Struct ``Segment`` and functions of a pipe axis in one precision."""
    t = types(scalar)

    @wp.struct
    class Segment:
        kind: wp.int32
        start: t.vec3  # first point of the segment
        tangent: t.vec3  # unit tangent there
        outward: t.vec3  # arcs: unit vector from the arc's centre to its start
        radius: scalar  # arcs: radius of the centreline
        lower: scalar  # range of the arc length (lines) or angle (arcs) that counts as this segment
        upper: scalar

    @wp.func
    def closest_on_axis(segments: wp.array(dtype=Segment), first: wp.int32, last: wp.int32, x: t.vec3):
        """Vector from the nearest axis point to `x` (shape 3) and the axis' unit tangent there."""
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
    """Closest point on a triangle, in one precision (regions as in Ericson, Real-Time Collision Detection, 5.1.5)."""
    t = types(scalar)

    @wp.func
    def closest_on_triangle(p: t.vec3, a: t.vec3, b: t.vec3, c: t.vec3):
        """Closest point of triangle abc to p, and the feature (face, edge or corner) that holds it."""
        zero = scalar(0.0)
        ab = b - a
        ac = c - a
        ap = p - a
        d1 = wp.dot(ab, ap)
        d2 = wp.dot(ac, ap)
        if d1 <= zero and d2 <= zero:
            return a, wp.int32(4)
        bp = p - b
        d3 = wp.dot(ab, bp)
        d4 = wp.dot(ac, bp)
        if d3 >= zero and d4 <= d3:
            return b, wp.int32(5)
        vc = d1 * d4 - d3 * d2
        if vc <= zero and d1 >= zero and d3 <= zero:
            return a + (d1 / (d1 - d3)) * ab, wp.int32(1)
        cp = p - c
        d5 = wp.dot(ab, cp)
        d6 = wp.dot(ac, cp)
        if d6 >= zero and d5 <= d6:
            return c, wp.int32(6)
        vb = d5 * d2 - d1 * d6
        if vb <= zero and d2 >= zero and d6 <= zero:
            return a + (d2 / (d2 - d6)) * ac, wp.int32(3)
        va = d3 * d6 - d5 * d4
        if va <= zero and d4 - d3 >= zero and d5 - d6 >= zero:
            return b + ((d4 - d3) / ((d4 - d3) + (d5 - d6))) * (c - b), wp.int32(2)
        total = va + vb + vc
        return a + ab * (vb / total) + ac * (vc / total), wp.int32(0)

    return SimpleNamespace(closest_on_triangle=closest_on_triangle)
