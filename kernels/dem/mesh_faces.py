"""Faces of triangle meshes near a sphere: closest points, local minima of the distance, and lists of near faces.

At a local minimum of the distance to the whole surface, no step on the surface leads closer to the sphere's centre. On
an edge, this must hold for a step along either adjacent face; at a corner, for every edge that meets there. This gives
exactly one contact on any triangulated plane and on convex edges and corners, whatever the triangle sizes.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.control import STALE
from ..common.geometry import triangle_functions
from ..common.types import types, vector_functions
from ..common.walls import BORDER, SHARED, wall_struct
from .structs import array_structs


@functools.cache
def surface_functions(scalar) -> SimpleNamespace:
    """Return functions for a face of a triangle mesh.

    They compute the face's closest point, test for a local minimum of the distance, and return the normal.
    """
    t = types(scalar)
    Wall = wall_struct(scalar)
    closest_on_triangle = triangle_functions(scalar).closest_on_triangle
    safe_normalize = vector_functions(scalar).safe_normalize

    @wp.func
    def closest_on_face(p: t.vec3, face: wp.int32, corners: wp.array(dtype=t.vec3), faces: wp.array2d(dtype=wp.int32)):
        point, feature = closest_on_triangle(
            p, corners[faces[face, 0]], corners[faces[face, 1]], corners[faces[face, 2]]
        )
        return point, feature

    @wp.func
    def falls_towards(direction: t.vec3, offset: t.vec3):
        # Return True if a small step along `direction` on the surface leads nearer to the sphere's centre. The
        # tolerance covers rounding in single precision. Because of the tolerance, two faces may report the same
        # minimum. The contacts of both are merged later, because their normals are nearly parallel.
        return wp.dot(direction, offset) > scalar(1.0e-3) * wp.length(direction) * wp.length(offset)

    @wp.func
    def across_edge(inward: t.vec3, along: t.vec3):
        return inward - (wp.dot(inward, along) / wp.dot(along, along)) * along

    @wp.func
    def is_minimum(
        feature: wp.int32,
        face: wp.int32,
        wall: Wall,
        offset: t.vec3,
        corners: wp.array(dtype=t.vec3),
        faces: wp.array2d(dtype=wp.int32),
        across: wp.array2d(dtype=wp.int32),
        ring_start: wp.array(dtype=wp.int32),
        ring: wp.array(dtype=wp.int32),
    ):
        """Return True if the face's closest point is a local minimum of the distance to the whole surface.

        `offset` points from this point to the sphere's centre. If several faces share the point, only the face with the
        lowest number reports it.
        """
        if feature == 0:
            return True
        if feature < 4:
            edge = feature - 1
            # `across` describes, for each edge of a face, the neighbouring face beyond this edge. Column `edge` holds
            # the corner of the neighbouring face that is not on the edge. Column `edge + 3` holds the number of the
            # neighbouring face.
            beyond = across[face, edge]
            if beyond == BORDER:
                return True
            a = corners[faces[face, edge]]
            along = corners[faces[face, (edge + 1) % 3]] - a
            if beyond <= SHARED:
                row = SHARED - beyond
                if ring[ring_start[row]] != face - wall.first_face:
                    # Do not report the minimum twice: of several faces at this edge, only the face with the lowest
                    # index reports it.
                    return False
                for k in range(ring_start[row] + 1, ring_start[row + 1]):
                    if falls_towards(across_edge(corners[ring[k]] - a, along), offset):
                        return False
                return True
            if across[face, edge + 3] < face:
                # Do not report the minimum twice: the neighbouring face has a lower index than this face, so it reports
                # this edge.
                return False
            return not falls_towards(across_edge(corners[beyond] - a, along), offset)
        corner = faces[face, feature - 4]
        a = corners[corner]
        lowest = ring[ring_start[corner]]
        if lowest != face - wall.first_face:
            # Do not report the minimum twice: of all faces at this corner, only the face with the lowest index reports
            # it.
            return False
        for k in range(ring_start[corner] + 1, ring_start[corner + 1]):
            if falls_towards(corners[ring[k]] - a, offset):
                return False
        return True

    @wp.func
    def normal_of(
        offset: t.vec3,
        face: wp.int32,
        orientation: t.quat,
        corners: wp.array(dtype=t.vec3),
        faces: wp.array2d(dtype=wp.int32),
    ):
        """Return the unit normal into the wall at the contact of a sphere with a face of a mesh.

        The normal is opposite to `offset`, the vector from the face's closest point to the sphere's centre. If the
        centre lies on the face, the result is the face's own normal, which follows from the order of the face's
        corners.
        """
        a = corners[faces[face, 0]]
        plain = wp.cross(corners[faces[face, 1]] - a, corners[faces[face, 2]] - a)
        n = -safe_normalize(offset, -wp.normalize(plain))
        return wp.quat_rotate(orientation, n)

    return SimpleNamespace(closest_on_face=closest_on_face, is_minimum=is_minimum, normal_of=normal_of)


@functools.cache
def candidate_kernels(scalar) -> tuple[wp.Kernel, wp.Kernel]:
    """Return the kernels that count and store the faces near each sphere, which it may touch before the next search.

    A face is near if its distance from the sphere's surface is at most the mesh skin, the margin of these lists.
    """
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Spheres, Candidates, Walls = structs.Scenes, structs.Spheres, structs.Candidates, structs.Walls
    xyz = vector_functions(scalar).xyz
    closest_on_face = surface_functions(scalar).closest_on_face

    def kernel(fill: bool):
        @wp.kernel(module="unique", enable_backward=False)
        def find_candidates(
            # The next arguments are arrays of the model, which are constant during a run.
            corners: wp.array(dtype=t.vec3),
            faces: wp.array2d(dtype=wp.int32),
            # The next arguments are arrays of the simulated state that this kernel only reads.
            flags: wp.array2d(dtype=wp.int32),
            scenes: Scenes,
            spheres: Spheres,
            walls: Walls,
            # The next arguments are arrays that this kernel writes. The first variant of the kernel writes the number
            # of candidate faces of each sphere, and the second variant writes the candidates.
            count: wp.array(dtype=wp.int32),
            candidates: Candidates,
        ):
            i = wp.tid()
            s = spheres.scene[i]
            if flags[s, STALE] == 0:
                return
            x = xyz(spheres.position[i])
            reach = spheres.position[i][3] + scenes.row[s].mesh_skin
            found = wp.int32(0)
            place = scenes.row[s].candidates + candidates.start[i + s]
            first_wall = scenes.row[s].walls
            for w in range(first_wall + scenes.row[s].analytic, first_wall + scenes.row[s].wall_count):
                local = wp.quat_rotate_inv(walls.orientation[w], x - walls.position[w])
                centre = wp.vec3(wp.float32(local[0]), wp.float32(local[1]), wp.float32(local[2]))
                # Warp stores the bounding boxes of the mesh in single precision, so add a margin for rounding errors.
                margin = wp.float32(reach) + wp.float32(1.0e-6) * wp.length(centre)
                box = wp.vec3(margin, margin, margin)
                query = wp.mesh_query_aabb(walls.table[w].mesh, centre - box, centre + box)
                local_face = wp.int32(0)
                while wp.mesh_query_aabb_next(query, local_face):
                    face = walls.table[w].first_face + local_face
                    point, feature = closest_on_face(local, face, corners, faces)
                    if wp.length(local - point) <= reach:
                        if wp.static(fill):
                            candidates.face[place + found] = face - scenes.row[s].faces
                        found += 1
            if wp.static(fill):
                candidates.chosen[i] = t.vec4()  # Make the next step choose this sphere's near faces anew.
            else:
                count[i + s] = found

        return find_candidates

    return kernel(False), kernel(True)
