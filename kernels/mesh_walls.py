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

from .contact_law import contact_functions
from .geometry import triangle_functions
from .types import DT_PREVIOUS, FORCE_SCALE, HALTED, OVERFLOW, SPAN, STALE, scene_struct, types, vector_functions
from .wall_motion import wall_struct
from .walls import wall_force_function

MERGE_ANGLE = 30.0  # degrees between normals of mesh contacts below which they count as one
MESH_SLOTS = 6  # mesh contacts that one sphere can hold at a time after those of planes and pipes; more sets OVERFLOW


@functools.cache
def mesh_kernel(scalar, law, half: bool, losses: bool):
    """Kernel over spheres: adds the forces of triangle meshes to spheres and to the walls."""
    t = types(scalar)
    SceneRow = scene_struct(scalar)
    Wall = wall_struct(scalar)
    closest_on_triangle = triangle_functions(scalar).closest_on_triangle
    Parameters = law(scalar).Parameters
    contact_force = law(scalar).force
    wall_touch = contact_functions(scalar).wall_touch
    xyz = vector_functions(scalar).xyz
    safe_normalize = vector_functions(scalar).safe_normalize
    add_to_wall = wall_force_function(scalar)
    span = SPAN if half else 1
    slots_matrix = wp.types.matrix((MESH_SLOTS, 3), scalar)
    slots_vector = wp.types.vector(MESH_SLOTS, scalar)
    slots_index = wp.types.vector(MESH_SLOTS, wp.int32)
    merge_cosine = math.cos(math.radians(MERGE_ANGLE))

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
        face_across: wp.array2d(dtype=wp.int32),
        ring_start: wp.array(dtype=wp.int32),
        ring: wp.array(dtype=wp.int32),
    ):
        """`offset` points from the closest point to the centre. Ties between faces go to the lowest face."""
        if feature == 0:
            return True
        if feature < 4:
            edge = feature - 1
            across = face_across[face, edge]  # far corner of the neighbour, its face number in `edge + 3`
            if across < 0:
                return True  # a border edge
            if face_across[face, edge + 3] < face:
                return False  # the neighbour reports this edge
            a = corners[faces[face, edge]]
            along = corners[faces[face, (edge + 1) % 3]] - a
            inward = corners[across] - a
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

    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def mesh_contacts(
        scenes: wp.array(dtype=SceneRow),
        first: wp.int32,
        last: wp.int32,
        part: wp.int32,
        contact_parameters: wp.array(dtype=Parameters),
        walls: wp.array(dtype=Wall),
        wall_position: wp.array(dtype=t.vec3),
        wall_orientation: wp.array(dtype=t.quat),
        wall_velocity: wp.array(dtype=t.vec3),
        wall_spin: wp.array(dtype=t.vec3),
        corners: wp.array(dtype=t.vec3),
        faces: wp.array2d(dtype=wp.int32),
        face_across: wp.array2d(dtype=wp.int32),
        ring_start: wp.array(dtype=wp.int32),
        ring: wp.array(dtype=wp.int32),
        face_wall: wp.array(dtype=wp.int32),
        candidate_start: wp.array(dtype=wp.int32),
        candidate_face: wp.array(dtype=wp.int32),
        sphere_scene: wp.array(dtype=wp.int32),
        sphere_position: wp.array(dtype=t.vec4),
        sphere_velocity: wp.array(dtype=t.vec4),
        sphere_spin: wp.array(dtype=t.vec3),
        sphere_material: wp.array(dtype=wp.int32),
        clock: wp.array2d(dtype=wp.float64),
        flags: wp.array2d(dtype=wp.int32),
        slot_history: wp.array2d(dtype=t.vec3),
        slot_normal: wp.array2d(dtype=t.vec3),
        slot_overlap: wp.array2d(dtype=scalar),
        slot_wall: wp.array2d(dtype=wp.int32),
        force: wp.array(dtype=t.vec3),
        moment: wp.array(dtype=t.vec3),
        step_force: wp.array3d(dtype=wp.int64),
        sphere_lost: wp.array(dtype=wp.float64),
    ):
        begin_i = first + wp.tid() * wp.static(span)
        for i in range(begin_i, wp.min(begin_i + wp.static(span), last)):
            scene = sphere_scene[i]
            if flags[scene, HALTED] != 0:
                continue
            begin = scenes[scene].candidates + candidate_start[i + scene]
            end = scenes[scene].candidates + candidate_start[i + scene + 1]
            if begin == end:
                continue
            dt = scalar(clock[scene, DT_PREVIOUS])
            scale = clock[scene, FORCE_SCALE]
            wall_base = scenes[scene].walls
            analytic = scenes[scene].analytic
            position = sphere_position[i]
            x = xyz(position)
            radius = position[3]
            velocity = sphere_velocity[i]
            row = scenes[scene].laws + sphere_material[i] * scenes[scene].materials
            total_force = t.vec3()
            total_moment = t.vec3()
            total_lost = wp.float64(0.0)
            found = wp.int32(0)
            normals = slots_matrix()
            gaps = slots_vector()
            owners = slots_index()
            for k in range(begin, end):
                face = candidate_face[k]
                w = face_wall[face]
                local = wp.quat_rotate_inv(wall_orientation[w], x - wall_position[w])
                point, feature = closest_on_triangle(
                    local, corners[faces[face, 0]], corners[faces[face, 1]], corners[faces[face, 2]]
                )
                offset = local - point
                distance = wp.length(offset)
                if distance < radius:
                    first_face = walls[w].first_face
                    if is_local_minimum(
                        feature, face, first_face, offset, corners, faces, face_across, ring_start, ring
                    ):
                        a = corners[faces[face, 0]]
                        plain = wp.cross(corners[faces[face, 1]] - a, corners[faces[face, 2]] - a)
                        n = -safe_normalize(offset, -wp.normalize(plain))
                        n = wp.quat_rotate(wall_orientation[w], n)
                        gap = distance - radius
                        # A centre pushed through the surface: the side it touched before is the inside.
                        side = scalar(0.0)
                        for s in range(MESH_SLOTS):
                            if slot_wall[i, analytic + s] == w - wall_base:
                                c = wp.dot(slot_normal[i, analytic + s], n)
                                if wp.abs(c) > wp.abs(side):
                                    side = c
                        if side < scalar(-0.7):
                            n = -n
                            gap = -distance - radius
                        place = wp.int32(-1)
                        for s in range(found):
                            if owners[s] == w and wp.dot(normals[s], n) > scalar(wp.static(merge_cosine)):
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
                # History belongs to the old contact on this wall with the nearest normal.
                history = t.vec3()
                best = scalar(wp.static(merge_cosine))
                for o in range(MESH_SLOTS):
                    if slot_wall[i, analytic + o] == w - wall_base:
                        c = wp.dot(slot_normal[i, analytic + o], n)
                        if c > best:
                            best = c
                            history = slot_history[i, analytic + o]
                arm = radius + gaps[s]
                point = x + arm * n
                surface = wall_velocity[w] + wp.cross(wall_spin[w], point - wall_position[w])
                relative = surface - xyz(velocity) - wp.cross(sphere_spin[i], arm * n)
                twist = scalar(0.5) * dt * wp.dot(sphere_spin[i] + wall_spin[w], n)
                touch = wall_touch(n, gaps[s], relative, twist, radius, velocity[3])
                f, new_history, lost = contact_force(contact_parameters[row + walls[w].material], touch, history, dt)
                histories[s] = new_history
                total_lost += wp.float64(lost)
                total_force += f
                total_moment += wp.cross(arm * n, f)
                add_to_wall(step_force, part, w, -f, wp.cross(point - wall_position[w], -f), scale)
            for s in range(MESH_SLOTS):
                if s < found:
                    slot_wall[i, analytic + s] = owners[s] - wall_base
                    slot_normal[i, analytic + s] = normals[s]
                    slot_overlap[i, analytic + s] = -gaps[s]
                    slot_history[i, analytic + s] = histories[s]
                else:
                    slot_wall[i, analytic + s] = -1
            force[i] = force[i] + total_force
            moment[i] = moment[i] + total_moment
            if wp.static(losses):
                sphere_lost[i] = sphere_lost[i] + total_lost

    return mesh_contacts


@functools.cache
def candidate_kernels(scalar):
    """Count and fill kernels of the faces within reach of each sphere (reach: radius plus mesh skin)."""
    t = types(scalar)
    SceneRow = scene_struct(scalar)
    Wall = wall_struct(scalar)
    xyz = vector_functions(scalar).xyz
    closest_on_triangle = triangle_functions(scalar).closest_on_triangle

    def kernel(fill: bool):
        @wp.kernel(module="unique", enable_backward=False)
        def candidates(
            scenes: wp.array(dtype=SceneRow),
            flags: wp.array2d(dtype=wp.int32),
            walls: wp.array(dtype=Wall),
            wall_position: wp.array(dtype=t.vec3),
            wall_orientation: wp.array(dtype=t.quat),
            corners: wp.array(dtype=t.vec3),
            faces: wp.array2d(dtype=wp.int32),
            sphere_scene: wp.array(dtype=wp.int32),
            sphere_position: wp.array(dtype=t.vec4),
            candidate_start: wp.array(dtype=wp.int32),
            count: wp.array(dtype=wp.int32),
            candidate_face: wp.array(dtype=wp.int32),
        ):
            i = wp.tid()
            s = sphere_scene[i]
            if flags[s, STALE] == 0:
                return
            x = xyz(sphere_position[i])
            reach = sphere_position[i][3] + scenes[s].mesh_skin
            found = wp.int32(0)
            place = scenes[s].candidates + candidate_start[i + s]
            for w in range(scenes[s].walls + scenes[s].analytic, scenes[s].walls + scenes[s].wall_count):
                local = wp.quat_rotate_inv(wall_orientation[w], x - wall_position[w])
                centre = wp.vec3(wp.float32(local[0]), wp.float32(local[1]), wp.float32(local[2]))
                # The tree is in single precision; the margin covers its rounding.
                margin = wp.float32(reach) + wp.float32(1.0e-6) * wp.length(centre)
                box = wp.vec3(margin, margin, margin)
                query = wp.mesh_query_aabb(walls[w].mesh, centre - box, centre + box)
                local_face = wp.int32(0)
                while wp.mesh_query_aabb_next(query, local_face):
                    face = walls[w].first_face + local_face
                    point, feature = closest_on_triangle(
                        local, corners[faces[face, 0]], corners[faces[face, 1]], corners[faces[face, 2]]
                    )
                    if wp.length(local - point) <= reach:
                        if wp.static(fill):
                            candidate_face[place + found] = face
                        found += 1
            if not wp.static(fill):
                count[i + s] = found

        return candidates

    return kernel(False), kernel(True)
