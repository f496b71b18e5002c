"""Contact of spheres with triangle meshes.

Mesh contact keeps a candidate only where its closest point is a local minimum of the distance to the
*whole* surface: on an edge, neither adjacent face may fall towards the sphere's centre; at a corner,
no edge that meets there may. That leaves one contact on any triangulated plane and on convex edges and
corners, whatever the triangle sizes. Facets that approximate a concave curved surface can each hold a
minimum; those whose normals differ by less than `MERGE_ANGLE` count as one surface, and the deepest wins.
"""

import functools
import math

import warp as wp

from ..common.control import HALTED, OVERFLOW, STALE
from ..common.geometry import triangle_functions
from ..common.types import SPAN, types, vector_functions
from .analytic_walls import surface_touch_function, wall_force_function
from .structs import DT_PREVIOUS, FORCE_SCALE, array_structs

MERGE_ANGLE = 30.0  # degrees between normals of mesh contacts below which they count as one
MERGE_COSINE = math.cos(math.radians(MERGE_ANGLE))
MESH_SLOTS = 6  # mesh contacts that one sphere can hold at a time after those of planes and pipes; more sets OVERFLOW


@functools.cache
def minimum_function(scalar):
    """`is_local_minimum`: whether a closest point is one of the distance to the whole surface, too."""
    t = types(scalar)

    @wp.func
    def falls_towards(direction: t.vec3, offset: t.vec3):
        # Would a step along `direction` on the surface come nearer to the sphere's centre? The tolerance
        # covers single-precision noise; a minimum reported twice within it merges by angle anyway.
        return wp.dot(direction, offset) > scalar(1.0e-3) * wp.length(direction) * wp.length(offset)

    @wp.func
    def is_local_minimum(
        feature: wp.int32,
        face: wp.int32,
        first_face: wp.int32,
        offset: t.vec3,
        corners: wp.array(dtype=t.vec3),
        faces: wp.array2d(dtype=wp.int32),
        across: wp.array2d(dtype=wp.int32),
        ring_start: wp.array(dtype=wp.int32),
        ring: wp.array(dtype=wp.int32),
    ):
        """`offset` points from the closest point to the centre. Ties between faces go to the lowest face."""
        if feature == 0:
            return True
        if feature < 4:
            edge = feature - 1
            beyond = across[face, edge]  # far corner of the neighbour, its face number in `edge + 3`
            if beyond < 0:
                return True  # a border edge
            if across[face, edge + 3] < face:
                return False  # the neighbour reports this edge
            a = corners[faces[face, edge]]
            along = corners[faces[face, (edge + 1) % 3]] - a
            inward = corners[beyond] - a
            inward = inward - (wp.dot(inward, along) / wp.dot(along, along)) * along
            return not falls_towards(inward, offset)
        corner = faces[face, feature - 4]
        a = corners[corner]
        lowest = ring[ring_start[corner]]
        if lowest != face - first_face:
            return False  # the lowest face of the ring reports this corner
        for k in range(ring_start[corner] + 1, ring_start[corner + 1]):
            if falls_towards(corners[ring[k]] - a, offset):
                return False
        return True

    return is_local_minimum


@functools.cache
def face_function(scalar):
    """`touch_of_face`: whether a sphere touches a surface on one of its faces, the normal into the wall, the gap."""
    t = types(scalar)
    structs = array_structs(scalar)
    Slots, Walls = structs.Slots, structs.Walls
    is_local_minimum = minimum_function(scalar)
    closest_on_triangle = triangle_functions(scalar).closest_on_triangle
    safe_normalize = vector_functions(scalar).safe_normalize

    @wp.func
    def side_before(slots: Slots, i: wp.int32, analytic: wp.int32, wall: wp.int32, n: t.vec3):
        """Cosine between a normal and that of the contact before, on the same wall, that is most nearly along it."""
        side = scalar(0.0)
        for s in range(MESH_SLOTS):
            if slots.wall[i, analytic + s] == wall:
                c = wp.dot(slots.normal[i, analytic + s], n)
                if wp.abs(c) > wp.abs(side):
                    side = c
        return side

    @wp.func
    def touch_of_face(
        i: wp.int32,
        face: wp.int32,
        w: wp.int32,
        first_wall: wp.int32,
        analytic: wp.int32,
        x: t.vec3,
        radius: scalar,
        corners: wp.array(dtype=t.vec3),
        faces: wp.array2d(dtype=wp.int32),
        across: wp.array2d(dtype=wp.int32),
        ring_start: wp.array(dtype=wp.int32),
        ring: wp.array(dtype=wp.int32),
        slots: Slots,
        walls: Walls,
    ):
        n = t.vec3()
        gap = scalar(0.0)
        touches = wp.bool(False)
        orientation = walls.orientation[w]
        local = wp.quat_rotate_inv(orientation, x - walls.position[w])
        point, feature = closest_on_triangle(
            local, corners[faces[face, 0]], corners[faces[face, 1]], corners[faces[face, 2]]
        )
        offset = local - point
        distance = wp.length(offset)
        if distance < radius:
            first_face = walls.table[w].first_face
            if is_local_minimum(feature, face, first_face, offset, corners, faces, across, ring_start, ring):
                touches = wp.bool(True)
                a = corners[faces[face, 0]]
                plain = wp.cross(corners[faces[face, 1]] - a, corners[faces[face, 2]] - a)
                n = -safe_normalize(offset, -wp.normalize(plain))
                n = wp.quat_rotate(orientation, n)
                gap = distance - radius
                # A centre pushed through the surface: the side it touched before is the inside.
                if side_before(slots, i, analytic, w - first_wall, n) < scalar(-0.7):
                    n = -n
                    gap = -distance - radius
        return touches, n, gap

    return touch_of_face


@functools.cache
def history_function(scalar):
    """`history_of`: that of the old contact of sphere i with a wall whose normal is nearest to `n`."""
    t = types(scalar)
    Slots = array_structs(scalar).Slots

    @wp.func
    def history_of(slots: Slots, i: wp.int32, analytic: wp.int32, wall: wp.int32, n: t.vec3):
        history = t.vec3()
        best = scalar(wp.static(MERGE_COSINE))
        for o in range(MESH_SLOTS):
            if slots.wall[i, analytic + o] == wall:
                c = wp.dot(slots.normal[i, analytic + o], n)
                if c > best:
                    best = c
                    history = slots.history[i, analytic + o]
        return history

    return history_of


@functools.cache
def mesh_kernel(scalar, law, half: bool, dissipation: bool):
    """Kernel over spheres: adds the forces of triangle meshes to spheres and to the walls."""
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Spheres, Slots, Candidates, Walls = (
        structs.Scenes, structs.Spheres, structs.Slots, structs.Candidates, structs.Walls
    )  # fmt: skip
    functions = law.functions(scalar)
    Parameters, contact_force = functions.Parameters, functions.force
    touch_of_face = face_function(scalar)
    history_of = history_function(scalar)
    surface_touch = surface_touch_function(scalar)
    xyz = vector_functions(scalar).xyz
    add_to_wall = wall_force_function(scalar)
    span = SPAN if half else 1
    slots_matrix = wp.types.matrix((MESH_SLOTS, 3), scalar)
    slots_vector = wp.types.vector(MESH_SLOTS, scalar)
    slots_index = wp.types.vector(MESH_SLOTS, wp.int32)

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def mesh_contacts(
        # model
        wall_parameters: wp.array(dtype=Parameters),
        corners: wp.array(dtype=t.vec3),
        faces: wp.array2d(dtype=wp.int32),
        across: wp.array2d(dtype=wp.int32),
        ring_start: wp.array(dtype=wp.int32),
        ring: wp.array(dtype=wp.int32),
        face_wall: wp.array(dtype=wp.int32),
        # chunk
        first: wp.int32,
        last: wp.int32,
        part: wp.int32,
        # state, read
        scenes: Scenes,
        candidates: Candidates,
        # state, read and written
        flags: wp.array2d(dtype=wp.int32),
        spheres: Spheres,
        slots: Slots,
        walls: Walls,
    ):
        begin_i = first + wp.tid() * wp.static(span)
        for i in range(begin_i, wp.min(begin_i + wp.static(span), last)):
            scene = spheres.scene[i]
            if flags[scene, HALTED] != 0:
                continue
            begin = scenes.row[scene].candidates + candidates.start[i + scene]
            end = scenes.row[scene].candidates + candidates.start[i + scene + 1]
            if begin == end:
                continue
            dt = scalar(scenes.clock[scene, DT_PREVIOUS])
            scale = scenes.clock[scene, FORCE_SCALE]
            wall_base = scenes.row[scene].walls
            analytic = scenes.row[scene].analytic
            position = spheres.position[i]
            x = xyz(position)
            radius = position[3]
            velocity = spheres.velocity[i]
            row = scenes.row[scene].laws + spheres.material[i] * scenes.row[scene].materials
            total_force = t.vec3()
            total_moment = t.vec3()
            total_lost = wp.float64(0.0)
            # One contact for each surface that the sphere touches.
            found = wp.int32(0)
            normals = slots_matrix()
            gaps = slots_vector()
            owners = slots_index()
            for k in range(begin, end):
                face = candidates.face[k]
                w = face_wall[face]
                touches, n, gap = touch_of_face(
                    i, face, w, wall_base, analytic, x, radius, corners, faces, across, ring_start, ring, slots, walls
                )
                if touches:
                    place = wp.int32(-1)
                    for s in range(found):
                        if owners[s] == w and wp.dot(normals[s], n) > scalar(wp.static(MERGE_COSINE)):
                            place = s
                    if place < 0:
                        if found < MESH_SLOTS:
                            normals[found] = n
                            gaps[found] = gap
                            owners[found] = w
                            found += 1
                        else:
                            flags[scene, OVERFLOW] = 1
                    elif gap < gaps[place]:
                        normals[place] = n
                        gaps[place] = gap
            histories = slots_matrix()
            for s in range(found):
                n = normals[s]
                w = owners[s]
                gap = gaps[s]
                history = history_of(slots, i, analytic, w - wall_base, n)
                touch, point = surface_touch(walls, w, n, gap, x, radius, velocity, spheres.spin[i], dt)
                f, new_history, lost = contact_force(wall_parameters[row + walls.table[w].material], touch, history, dt)
                histories[s] = new_history
                total_lost += wp.float64(lost)
                total_force += f
                total_moment += wp.cross((radius + gap) * n, f)
                add_to_wall(walls.step_force, part, w, -f, wp.cross(point - walls.position[w], -f), scale)
            for s in range(MESH_SLOTS):
                if s < found:
                    slots.wall[i, analytic + s] = owners[s] - wall_base
                    slots.normal[i, analytic + s] = normals[s]
                    slots.overlap[i, analytic + s] = -gaps[s]
                    slots.history[i, analytic + s] = histories[s]
                else:
                    slots.wall[i, analytic + s] = -1
            spheres.force[i] = spheres.force[i] + total_force
            spheres.moment[i] = spheres.moment[i] + total_moment
            if wp.static(dissipation):
                spheres.dissipated_energy[i] = spheres.dissipated_energy[i] + total_lost

    return mesh_contacts


@functools.cache
def candidate_kernels(scalar):
    """Count and fill kernels of the faces within reach of each sphere (reach: radius plus mesh skin)."""
    t = types(scalar)
    structs = array_structs(scalar)
    Scenes, Spheres, Candidates, Walls = structs.Scenes, structs.Spheres, structs.Candidates, structs.Walls
    xyz = vector_functions(scalar).xyz
    closest_on_triangle = triangle_functions(scalar).closest_on_triangle

    def kernel(fill: bool):
        @wp.kernel(module="unique", enable_backward=False)
        def find_candidates(
            # model
            corners: wp.array(dtype=t.vec3),
            faces: wp.array2d(dtype=wp.int32),
            # state, read
            flags: wp.array2d(dtype=wp.int32),
            scenes: Scenes,
            spheres: Spheres,
            walls: Walls,
            # written: the count of each sphere, or its candidates
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
                # The tree is in single precision; the margin covers its rounding.
                margin = wp.float32(reach) + wp.float32(1.0e-6) * wp.length(centre)
                box = wp.vec3(margin, margin, margin)
                query = wp.mesh_query_aabb(walls.table[w].mesh, centre - box, centre + box)
                local_face = wp.int32(0)
                while wp.mesh_query_aabb_next(query, local_face):
                    face = walls.table[w].first_face + local_face
                    point, feature = closest_on_triangle(
                        local, corners[faces[face, 0]], corners[faces[face, 1]], corners[faces[face, 2]]
                    )
                    if wp.length(local - point) <= reach:
                        if wp.static(fill):
                            candidates.face[place + found] = face
                        found += 1
            if not wp.static(fill):
                count[i + s] = found

        return find_candidates

    return kernel(False), kernel(True)
