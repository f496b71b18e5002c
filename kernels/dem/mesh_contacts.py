"""Contact of spheres with triangle meshes.

A mesh contact is accepted only where a triangle's closest point is a local minimum of the distance to the *whole*
surface (`mesh_faces`). Facets that approximate a concave curved surface can each hold a minimum. Minima whose normals
differ by less than `MERGE_ANGLE` therefore count as one contact, and the deepest one is used.

A surface also hides what lies behind it. The farther of two contacts is dropped if its point lies behind the plane
through the nearer contact point, perpendicular to the nearer normal. A tolerance of BEHIND allows for rounded corners.
The far surface of a wall that is thinner than the overlap thus adds no force. Edges of coincident faces that do not
share corners are hidden in the same way. If the overlap is small, no true contact is hidden.

A sphere's list of candidate triangles stays valid for hundreds of steps, so most of these triangles are too far away to
touch. Each sphere therefore has a second, shorter list of near candidates. The kernel rebuilds this list when sphere
and meshes may have approached by more than a margin. Both lists have the same order and yield the same contacts.

The arrays of walls and contact slots are separate arguments of the kernel, and the loop that searches for an old
contact's history is part of the kernel's own code. If the arrays came in structs, or if the search were a function,
CUDA's compiler would unroll the loops differently and the kernel would take 5 % longer.
"""

import functools
import math
from types import SimpleNamespace

import warp as wp

from ..common.control import FAILED, HALTED, OVERFLOW
from ..common.types import SPAN, types, vector_functions
from ..common.walls import wall_struct
from .analytic_walls import surface_touch_function, wall_force_function
from .mesh_faces import surface_functions
from .structs import DT_PREVIOUS, FORCE_SCALE, array_structs, scene_struct
from .warps import any_active
from .wear import wear_functions

MERGE_ANGLE = 30.0  # Angle between the normals of two mesh contacts below which they count as one contact [degrees].
MERGE_COSINE = math.cos(math.radians(MERGE_ANGLE))
# A contact point of a sphere counts as hidden by a nearer contact if it lies behind the plane through the nearer
# contact point. It also counts as hidden if it lies in front of this plane by at most this fraction of the sphere's
# radius.
BEHIND = 2.0e-2
ROUNDING = 0.99
"""Fraction of a margin. If the displacements of a sphere and of the meshes add up to more than this fraction of the
margin, the triangles near the sphere are chosen again. The rest of the margin covers rounding errors."""
# Number of storage places (slots) of a sphere for its contacts with meshes; they follow its slots for planes and pipes.
# If a sphere has more mesh contacts, the flag OVERFLOW is set.
MESH_SLOTS = 6
Owners = wp.types.vector(MESH_SLOTS, wp.int32)


@functools.cache
def merging_functions(scalar, rolls: bool) -> SimpleNamespace:
    """Return functions for the contacts of one sphere with meshes.

    Several triangles of a mesh can touch the sphere at nearly the same place. The functions merge the sphere's contacts
    with the same wall if the contact normals are nearly parallel. They also find, for each contact, the same contact in
    the previous step, so that its contact history continues.
    """
    t = types(scalar)
    Vectors, Values = wp.types.matrix((MESH_SLOTS, 3), scalar), wp.types.vector(MESH_SLOTS, scalar)

    @wp.func
    def hides(n: t.vec3, gap: scalar, farther_n: t.vec3, farther_gap: scalar, radius: scalar):
        """Return True if a contact makes a farther contact of the same sphere with the same wall superfluous.

        This is so if the normals of both contacts are nearly parallel, or if the farther contact point lies behind the
        plane through the nearer contact point that is perpendicular to the nearer normal.
        """
        if gap > farther_gap:
            return False
        c = wp.dot(n, farther_n)
        ahead = radius + gap - c * (radius + farther_gap)
        return c > scalar(wp.static(MERGE_COSINE)) or ahead < scalar(wp.static(BEHIND)) * radius

    @wp.func
    def with_contact(
        normals: Vectors, gaps: Values, owners: Owners, found: wp.int32, w: wp.int32, n: t.vec3, gap: scalar,
        radius: scalar,
    ):  # fmt: skip
        """Return the contacts of a sphere with meshes after a new contact on wall `w` has been added.

        If an existing contact hides the new contact, the list of contacts stays unchanged. Otherwise the existing
        contacts that the new contact hides are removed, and the new contact takes the place of the first removed one.
        A returned count above MESH_SLOTS means that there was no room for the new contact.
        """
        for s in range(found):
            if owners[s] == w and hides(normals[s], gaps[s], n, gap, radius):
                return normals, gaps, owners, found
        place = wp.int32(-1)
        kept = wp.int32(0)
        for s in range(found):
            if owners[s] == w and hides(n, gap, normals[s], gaps[s], radius):
                if place < 0:
                    place = kept
                    kept += 1
            else:
                normals[kept] = normals[s]
                gaps[kept] = gaps[s]
                owners[kept] = owners[s]
                kept += 1
        if place < 0:
            place = kept
            kept += 1
        if place < MESH_SLOTS:
            normals[place] = n
            gaps[place] = gap
            owners[place] = w
        return normals, gaps, owners, kept

    @wp.func
    def on_side_before(
        i: wp.int32,
        first: wp.int32,
        wall: wp.int32,
        n: t.vec3,
        distance: scalar,
        radius: scalar,
        slot_wall: wp.array2d(dtype=wp.int32),
        slot_normal: wp.array2d(dtype=t.vec3),
    ):
        """Return the normal and the gap of a contact, seen from the side that the sphere touched in the previous step.

        This matters if the sphere's centre has been pushed through the surface: the normal must then still point to the
        side from which the sphere came.
        """
        gap = distance - radius
        # Among the normals that this sphere had on this wall in the previous step, find the one most nearly parallel to
        # `n` or -`n`. `side` is the cosine of the angle between this normal and `n`.
        side = scalar(0.0)
        for s in range(MESH_SLOTS):
            if slot_wall[i, first + s] == wall:
                c = wp.dot(slot_normal[i, first + s], n)
                if wp.abs(c) > wp.abs(side):
                    side = c
        if side < scalar(-0.7):
            n = -n
            gap = -distance - radius
        return n, gap

    @wp.func
    def keep_contacts(
        i: wp.int32,
        first: wp.int32,
        first_wall: wp.int32,
        found: wp.int32,
        owners: Owners,
        normals: Vectors,
        gaps: Values,
        histories: Vectors,
        turnings: Vectors,
        slot_wall: wp.array2d(dtype=wp.int32),
        slot_normal: wp.array2d(dtype=t.vec3),
        slot_overlap: wp.array2d(dtype=scalar),
        slot_history: wp.array2d(dtype=t.vec3),
        slot_rolling: wp.array2d(dtype=t.vec3),
    ):
        """Store the mesh contacts of this step, so that the next step finds their history.

        Each sphere has a fixed number of slots for contacts with walls; `first` is its first slot for meshes.
        """
        for s in range(MESH_SLOTS):
            if s < found:
                slot_wall[i, first + s] = owners[s] - first_wall
                slot_normal[i, first + s] = normals[s]
                slot_overlap[i, first + s] = -gaps[s]
                slot_history[i, first + s] = histories[s]
                if wp.static(rolls):
                    slot_rolling[i, first + s] = turnings[s]
            else:
                slot_wall[i, first + s] = -1

    return SimpleNamespace(
        Vectors=Vectors,
        Values=Values,
        with_contact=with_contact,
        on_side_before=on_side_before,
        keep_contacts=keep_contacts,
    )


@functools.cache
def contact_function(scalar, law):
    """Return the function `mesh_contact`, which evaluates the contact of a sphere with a mesh.

    The result is the force and moment on the sphere, the moment on the wall about the wall's position, the new
    histories of shear and rolling, and the energy lost.
    """
    t = types(scalar)
    functions, rolls = law.functions(scalar), law.rolls
    Parameters, contact_force = functions.Parameters, functions.force
    contact_moment = functions.moment if rolls else None
    surface_touch = surface_touch_function(scalar)

    @wp.func
    def mesh_contact(
        p: Parameters, place: t.vec3, wall_velocity: t.vec3, wall_spin: t.vec3, n: t.vec3, gap: scalar, x: t.vec3,
        radius: scalar, velocity: t.vec4, spin: t.vec3, history: t.vec3, rolling: t.vec3, dt: scalar,
    ):  # fmt: skip
        touch, point = surface_touch(place, wall_velocity, wall_spin, n, gap, x, radius, velocity, spin, dt)
        f, sheared, lost = contact_force(p, touch, history, dt)
        moment = wp.cross((radius + gap) * n, f)
        on_wall = wp.cross(point - place, -f)
        rolled = t.vec3()
        if wp.static(rolls):
            held_back, rolled, lost_rolling = contact_moment(p, touch, wall_spin - spin, rolling, dt)
            moment = moment + held_back
            on_wall = on_wall - held_back
            lost += lost_rolling
        return f, moment, on_wall, sheared, rolled, lost

    return mesh_contact


@functools.cache
def near_function(scalar):
    """Return the function `choose_near`, which updates the list of the triangles that a sphere may touch soon."""
    t = types(scalar)
    SceneRow, Candidates = scene_struct(scalar), array_structs(scalar).Candidates
    xyz, pack = vector_functions(scalar).xyz, vector_functions(scalar).pack
    closest_on_face = surface_functions(scalar).closest_on_face

    @wp.func
    def choose_near(
        i: wp.int32, begin: wp.int32, end: wp.int32, x: t.vec3, radius: scalar, margin: scalar, scene: SceneRow,
        candidates: Candidates, corners: wp.array(dtype=t.vec3), faces: wp.array2d(dtype=wp.int32),
        face_wall: wp.array(dtype=wp.int32), wall_position: wp.array(dtype=t.vec3),
        wall_orientation: wp.array(dtype=t.quat), wall_moved: wp.array(dtype=wp.float64),
    ) -> wp.int32:  # fmt: skip
        """Update the near candidates of sphere i, and return the index in `candidates.near` at which they end.

        The candidates of the sphere have the indices `begin` to `end` - 1. Near candidates are the candidates whose
        distance from the surface of the sphere is less than `margin` [m]. They are chosen again if sphere and meshes
        may have approached by the margin since the last choice.
        """
        moved = wp.float64(0.0)
        for w in range(scene.walls + scene.analytic, scene.walls + scene.wall_count):
            moved += wall_moved[w]
        chosen = candidates.chosen[i]
        is_valid = wp.length(x - xyz(chosen)) + radius + scalar(moved) <= chosen[3]
        # The threads of a warp wait for each other, so rebuilding the lists of all threads costs no more than
        # rebuilding one. If one thread must rebuild its list, all of them do.
        if any_active(not is_valid):
            near = begin
            for k in range(begin, end):
                w = face_wall[scene.faces + candidates.face[k]]
                local = wp.quat_rotate_inv(wall_orientation[w], x - wall_position[w])
                nearest, _feature = closest_on_face(local, scene.faces + candidates.face[k], corners, faces)
                if wp.length(local - nearest) < radius + margin:
                    candidates.near[near] = candidates.face[k]
                    near += 1
            candidates.near_count[i] = near - begin
            candidates.chosen[i] = pack(x, radius + scalar(moved) + scalar(wp.static(ROUNDING)) * margin)
        return begin + candidates.near_count[i]

    return choose_near


@functools.cache
def mesh_parts(scalar, law) -> SimpleNamespace:
    """Return the types and functions from which the kernel for contacts with meshes is built, by name."""
    structs, functions = array_structs(scalar), law.functions(scalar)
    return SimpleNamespace(
        **vars(surface_functions(scalar)),
        **vars(merging_functions(scalar, law.rolls)),
        choose_near=near_function(scalar),
        Wall=wall_struct(scalar),
        Scenes=structs.Scenes,
        Spheres=structs.Spheres,
        Candidates=structs.Candidates,
        Parameters=functions.Parameters,
        mesh_contact=contact_function(scalar, law),
        **vars(wear_functions(scalar, law)),
        surface_touch=surface_touch_function(scalar),
        add_to_wall=wall_force_function(scalar),
        xyz=vector_functions(scalar).xyz,
    )


@functools.cache
def mesh_kernel(scalar, law, half: bool, dissipation: bool, wear: bool) -> wp.Kernel:
    """Return the kernel over spheres that adds the contact forces of triangle meshes to spheres and walls."""
    t = types(scalar)
    parts, rolls = mesh_parts(scalar, law), law.rolls
    span = SPAN if half else 1

    # The arrays of walls and slots are separate arguments. With structs, CUDA's compiler orders the arithmetic of this
    # kernel in another way, which is slower and changes the last digit.
    @wp.kernel(module="unique", enable_backward=False, grid_stride=False)
    def mesh_contacts(
        # The next arguments are arrays of the model, which are constant during a run.
        wall_parameters: wp.array(dtype=parts.Parameters), corners: wp.array(dtype=t.vec3),
        faces: wp.array2d(dtype=wp.int32), across: wp.array2d(dtype=wp.int32), ring_start: wp.array(dtype=wp.int32),
        ring: wp.array(dtype=wp.int32), face_wall: wp.array(dtype=wp.int32), wall_table: wp.array(dtype=parts.Wall),
        # The next arguments are the range of spheres that this launch processes, the index of the CPU thread, and the
        # largest gap at which a triangle counts as near a sphere, as a fraction of the neighbour lists' skin.
        first: wp.int32, last: wp.int32, part: wp.int32, near_margin: scalar,
        # The next arguments are arrays of the simulated state that this kernel only reads.
        scenes: parts.Scenes, candidates: parts.Candidates, wall_position: wp.array(dtype=t.vec3),
        wall_orientation: wp.array(dtype=t.quat), wall_velocity: wp.array(dtype=t.vec3),
        wall_spin: wp.array(dtype=t.vec3), wall_moved: wp.array(dtype=wp.float64),
        # The next arguments are arrays that this kernel reads and writes.
        flags: wp.array2d(dtype=wp.int32), spheres: parts.Spheres, slot_wall: wp.array2d(dtype=wp.int32),
        slot_normal: wp.array2d(dtype=t.vec3), slot_overlap: wp.array2d(dtype=scalar),
        slot_history: wp.array2d(dtype=t.vec3), slot_rolling: wp.array2d(dtype=t.vec3),
        slot_worn: wp.array2d(dtype=wp.vec3d), slot_worn_at: wp.array2d(dtype=t.vec3),
        wall_step_force: wp.array3d(dtype=wp.int64),
    ):  # fmt: skip
        begin_i = first + wp.tid() * wp.static(span)
        for i in range(begin_i, wp.min(begin_i + wp.static(span), last)):
            scene = spheres.scene[i]
            if flags[scene, HALTED] != 0:
                continue
            begin = scenes.row[scene].candidates + candidates.start[i + scene]
            end = scenes.row[scene].candidates + candidates.start[i + scene + 1]
            if begin == end:
                continue
            first_wall, analytic = scenes.row[scene].walls, scenes.row[scene].analytic
            x = parts.xyz(spheres.position[i])
            radius = spheres.position[i][3]
            end = parts.choose_near(
                i, begin, end, x, radius, near_margin * scenes.row[scene].skin, scenes.row[scene], candidates, corners,
                faces, face_wall, wall_position, wall_orientation, wall_moved,
            )  # fmt: skip
            found = wp.int32(0)
            normals, gaps, owners = parts.Vectors(), parts.Values(), Owners()
            for k in range(begin, end):
                face = scenes.row[scene].faces + candidates.near[k]
                w = face_wall[face]
                local = wp.quat_rotate_inv(wall_orientation[w], x - wall_position[w])
                nearest, feature = parts.closest_on_face(local, face, corners, faces)
                offset = local - nearest
                distance = wp.length(offset)
                if distance < radius:
                    if parts.is_minimum(feature, face, wall_table[w], offset, corners, faces, across, ring_start, ring):
                        n = parts.normal_of(offset, face, wall_orientation[w], corners, faces)
                        n, gap = parts.on_side_before(
                            i, analytic, w - first_wall, n, distance, radius, slot_wall, slot_normal
                        )
                        normals, gaps, owners, found = parts.with_contact(
                            normals, gaps, owners, found, w, n, gap, radius
                        )
                        if found > MESH_SLOTS:
                            found = MESH_SLOTS
                            flags[scene, OVERFLOW] = 1
            # Contact slots are filled in order. An unused first slot thus means that all slots are unused, and that
            # there is no history to clear.
            if found == 0 and slot_wall[i, analytic] < 0:
                continue
            dt, scale = scalar(scenes.clock[scene, DT_PREVIOUS]), scenes.clock[scene, FORCE_SCALE]
            velocity = spheres.velocity[i]
            spin = parts.xyz(spheres.spin[i])
            row = scenes.row[scene].laws + spheres.material[i] * scenes.row[scene].materials
            total_force, total_moment, total_lost = t.vec3(), t.vec3(), wp.float64(0.0)
            histories, turnings = parts.Vectors(), parts.Vectors()
            for s in range(found):
                n = normals[s]
                w = owners[s]
                # A contact inherits the history of an old contact with the same wall: the one with the most nearly
                # parallel normal.
                history, rolling = t.vec3(), t.vec3()
                best = scalar(wp.static(MERGE_COSINE))
                for o in range(MESH_SLOTS):
                    if slot_wall[i, analytic + o] == w - first_wall:
                        c = wp.dot(slot_normal[i, analytic + o], n)
                        if c > best:
                            best = c
                            history = slot_history[i, analytic + o]
                            if wp.static(rolls):
                                rolling = slot_rolling[i, analytic + o]
                f, moment, m, sheared, rolled, lost = parts.mesh_contact(
                    wall_parameters[row + wall_table[w].material], wall_position[w], wall_velocity[w], wall_spin[w], n,
                    gaps[s], x, radius, velocity, spin, history, rolling, dt,
                )  # fmt: skip
                # If the centre of the sphere has passed the surface, check whether the whole sphere could be behind the
                # surface after one more step. If so, mark the scene as failed.
                if gaps[s] < -radius:
                    if dt * wp.dot(parts.xyz(velocity) - wall_velocity[w], n) - gaps[s] > scalar(2.0) * radius:
                        wp.atomic_cas(flags, scene, FAILED, 0, 1 + spheres.body[i])
                histories[s] = sheared
                turnings[s] = rolled
                total_lost += wp.float64(lost)
                total_force += f
                total_moment += moment
                parts.add_to_wall(wall_step_force, part, w, -f, m, scale)
                if wp.static(wear):
                    touch, point = parts.surface_touch(
                        wall_position[w], wall_velocity[w], wall_spin[w], n, gaps[s], x, radius, velocity, spin, dt
                    )
                    did = parts.contact_wear(wall_parameters[row + wall_table[w].material], touch, f, lost, dt)
                    slot_worn[i, w - first_wall] = slot_worn[i, w - first_wall] + did
                    slot_worn_at[i, w - first_wall] = parts.in_frame(point, wall_position[w], wall_orientation[w])
            parts.keep_contacts(
                i, analytic, first_wall, found, owners, normals, gaps, histories, turnings, slot_wall, slot_normal,
                slot_overlap, slot_history, slot_rolling,
            )  # fmt: skip
            spheres.force[i] = spheres.force[i] + total_force
            spheres.moment[i] = spheres.moment[i] + total_moment
            if wp.static(dissipation):
                spheres.dissipated_energy[i] = spheres.dissipated_energy[i] + total_lost

    return mesh_contacts
