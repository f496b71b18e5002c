"""The arrays that kernels of discrete elements work on, as structs: scenes, bodies, spheres, slots, pairs, walls.

Arrays are flat over all scenes of a batch. Indices that an array holds (`bodies.first`, `spheres.body`, entries of
`pairs.other`, `slots.wall`, `candidates.face`) count from the scene's first row, so a scene alone and in a batch holds
the same numbers. Those of a mesh's tables and of axes, which no state holds, count over the whole batch. What the
features of a scene do not need has no rows.

Beside them stands `flags`, an array of the slots of `common.control`, shape (scenes, FLAGS), no member of `Scenes`.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.types import types
from ..common.walls import wall_struct

# Slots of the double-precision array `clock`, one row a scene.
TIME = wp.constant(0)  # [s]
DT = wp.constant(1)  # step about to be taken [s]
DT_PREVIOUS = wp.constant(2)  # step taken before; 0 at the start, which makes the first kick a half one [s]
SINCE_BUILD = wp.constant(3)  # time since the neighbour lists were built [s]
FORCE_SCALE = wp.constant(4)  # fixed-point units per newton
STABLE = wp.constant(5)  # the stable step as last estimated, without safety factor [s]
CLOCK = 8


@functools.cache
def scene_struct(scalar):
    """What kernels must know of one scene of a batch: its numbers, and where its rows begin in the flat arrays."""
    t = types(scalar)

    @wp.struct
    class SceneRow:
        gravity: t.vec3
        local_damping: scalar
        speed_limit: scalar
        skin: scalar  # of the pair lists
        mesh_skin: scalar  # of the mesh candidates
        sphere_allowance: scalar  # of the mesh skin, for spheres to go in; moving meshes take the rest [m]
        growth_rate: scalar
        growth_end: scalar
        safety: wp.float64  # of the automatic time step
        largest_step: wp.float64
        fixed_step: wp.float64  # 0: automatic
        until: wp.float64  # time at which the scene halts [s]
        interval: wp.int32  # steps from one estimate of the stable step to the next
        sort_every: wp.int32  # steps from one re-sorting of the bodies to the next, 0: never
        foreseen_speed: wp.float64  # that a wall will have or forces can give before the next estimate
        wall_stiffness: wp.float64  # least that a driven wall meets [N/m]
        largest_radius: scalar  # at full size
        bodies: wp.int32  # first rows, and how many
        body_count: wp.int32
        spheres: wp.int32
        sphere_count: wp.int32
        pairs: wp.int32
        loads: wp.int32
        candidates: wp.int32
        faces: wp.int32
        walls: wp.int32
        wall_count: wp.int32
        analytic: wp.int32  # planes and pipes, which come first
        still: wp.int32  # 1: none of those ever moves
        held: wp.int32  # 1: walls that move by prescription stand still for now
        materials: wp.int32  # contact parameters form a square table of them
        laws: wp.int32  # first row of that table
        bonds: wp.int32
        groups: wp.int32

    return SceneRow


@functools.cache
def array_structs(scalar) -> SimpleNamespace:
    """Structs `Scenes`, `Bodies`, `Spheres`, `Slots`, `Pairs`, `Candidates` and `Walls`."""
    t = types(scalar)
    SceneRow = scene_struct(scalar)
    Wall = wall_struct(scalar)

    @wp.struct
    class Scenes:
        row: wp.array(dtype=SceneRow)  # numbers and first rows, shape (scenes,)
        clock: wp.array2d(dtype=wp.float64)  # slots above, shape (scenes, CLOCK)
        scale: wp.array(dtype=scalar)  # factor of all sizes while packing grows them, shape (scenes,)
        reference_velocity: wp.array(dtype=t.vec3)  # mean at the lists' building, the common drift [m/s]

    @wp.struct
    class Bodies:
        id: wp.array(dtype=wp.int32)  # permanent number, shape (bodies,) as the rest
        scene: wp.array(dtype=wp.int32)  # number in the batch
        shape: wp.array(dtype=wp.int32)  # an index into the state's templates
        group: wp.array(dtype=wp.int32)  # index into the model's groups; 0 is none
        size: wp.array(dtype=scalar)  # diameter of the sphere of equal volume, at full size [m]
        mass: wp.array(dtype=scalar)  # [kg]
        inertia: wp.array(dtype=t.vec3)  # principal moments [kg m2]
        position: wp.array(dtype=t.vec3)  # centroid [m]
        rounding: wp.array(dtype=t.vec3)  # what rounding took from the position so far [m]
        velocity: wp.array(dtype=t.vec3)  # at the middle of the last step [m/s]
        spin: wp.array(dtype=t.vec3)  # in space, likewise [rad/s]
        orientation: wp.array(dtype=t.quat)  # from body to space
        angular_momentum: wp.array(dtype=t.vec3)  # in space [kg m2/s]
        first: wp.array(dtype=wp.int32)  # sphere of each body, and the end of the last, shape (bodies + scenes,)

    @wp.struct
    class Spheres:
        id: wp.array(dtype=wp.int32)  # permanent number, shape (spheres,) as the rest
        scene: wp.array(dtype=wp.int32)  # number in the batch
        body: wp.array(dtype=wp.int32)  # that it belongs to
        material: wp.array(dtype=wp.int32)  # index into the model's materials
        offset: wp.array(dtype=t.vec4)  # centre in the body's frame, radius; at full size [m]
        position: wp.array(dtype=t.vec4)  # centre and radius [m]
        velocity: wp.array(dtype=t.vec4)  # of the centre [m/s], and the body's mass [kg]
        spin: wp.array(dtype=t.vec4)  # of the body [rad/s], and nothing: rows of four are moved at once
        built: wp.array(dtype=t.vec4)  # position and radius when the lists were built [m]
        clear: wp.array(dtype=t.vec4)  # where its distance to still walls was last measured, and that distance [m]
        force: wp.array(dtype=t.vec3)  # of all contacts in this step, on a GPU of those with walls; 0 between steps [N]
        moment: wp.array(dtype=t.vec3)  # about its centre [N m]
        touching: wp.array(dtype=wp.int32)  # a bit for each of the first list entries that touched in the last step
        dissipated_energy: wp.array(dtype=wp.float64)  # since the start [J]
        broken: wp.array(dtype=wp.vec2i)  # bonds since the start: by tension, by shear

    @wp.struct
    class Slots:
        touching: wp.array(dtype=wp.int32)  # a bit for each plane or pipe touched in the last step, shape (spheres,)
        history: wp.array2d(dtype=t.vec3)  # of a contact with a wall: planes and pipes, then meshes, (spheres, slots)
        rolling: wp.array2d(dtype=t.vec3)  # moment of a contact's spring against rolling [N m], (spheres, slots)
        normal: wp.array2d(dtype=t.vec3)  # of mesh contacts, into the wall, (spheres, slots)
        overlap: wp.array2d(dtype=scalar)  # of mesh contacts [m], (spheres, slots)
        wall: wp.array2d(dtype=wp.int32)  # of mesh contacts, -1 for none, (spheres, slots)
        worn: wp.array2d(dtype=wp.vec3d)  # by contacts with each wall since the last sample: work of sliding [J], loss
        # of impacts [J], load times way slid [N m], (spheres, walls)
        worn_at: wp.array2d(dtype=t.vec3)  # where it last touched each wall, in the wall's frame [m], (spheres, walls)

    @wp.struct
    class Pairs:
        start: wp.array(dtype=wp.int32)  # first entry of each sphere's row, and the end, shape (spheres + scenes,)
        other: wp.array(dtype=wp.int32)  # the other sphere j, or -1 - j if j has the lower number, shape (pairs,)
        history: wp.array(dtype=t.vec4)  # of the contact, for springs the shear force [N], and nothing, shape (pairs,)
        rolling: wp.array(dtype=t.vec3)  # moment of the contact's spring against rolling [N m], shape (pairs,)
        bond: wp.array(dtype=wp.int32)  # its kind and row as of `bond_parallel`, 0 for none, below 0 broken, (pairs,)
        load: wp.array(dtype=t.vec8)  # of each bond: shear vector and tension [N], bending vector and torsion [N m],
        # shape (rows,), see `warpcrete/dem/bonding.py`; one row each, since a GPU moves 32 bytes or none

    @wp.struct
    class Candidates:
        start: wp.array(dtype=wp.int32)  # first entry of each sphere's row, and the end, shape (spheres + scenes,)
        face: wp.array(dtype=wp.int32)  # triangles within reach of it, from the scene's first, shape (candidates,)

    @wp.struct
    class Walls:
        scene: wp.array(dtype=wp.int32)  # number in the batch, shape (walls,) as the rest
        table: wp.array(dtype=Wall)  # what each wall is
        rest_position: wp.array(dtype=wp.vec3d)  # at the start [m]
        position_exact: wp.array(dtype=wp.vec3d)  # in double precision [m]
        velocity_exact: wp.array(dtype=wp.vec3d)  # likewise [m/s]
        position: wp.array(dtype=t.vec3)  # of the wall's frame [m]
        orientation: wp.array(dtype=t.quat)  # of the wall's frame
        normal: wp.array(dtype=t.vec3)  # planes: unit normal into the material
        velocity: wp.array(dtype=t.vec3)  # mean over the step [m/s]
        spin: wp.array(dtype=t.vec3)  # mean over the step [rad/s]
        force: wp.array(dtype=wp.vec3d)  # of all contacts in the last step [N]
        moment: wp.array(dtype=wp.vec3d)  # about the wall's position [N m]
        impulse: wp.array(dtype=wp.vec3d)  # of that force since the start [N s]
        angular_impulse: wp.array(dtype=wp.vec3d)  # of that moment since the start [N m s]
        travel: wp.array(dtype=wp.float64)  # displacement along its path since the start [m]
        work: wp.array(dtype=wp.float64)  # done on the material since the start [J]
        moved: wp.array(dtype=wp.float64)  # meshes: way that a corner may have gone since the lists were built [m]
        step_force: wp.array3d(dtype=wp.int64)  # force and moment of this step in fixed point, (threads, walls, 6)

    return SimpleNamespace(
        Scenes=Scenes, Bodies=Bodies, Spheres=Spheres, Slots=Slots, Pairs=Pairs, Candidates=Candidates, Walls=Walls,
    )  # fmt: skip


@functools.cache
def links_struct(scalar):
    """Struct `Links`: pairs as a GPU evaluates them, a thread each. A pair's `entry` is that of its sphere with the
    lower permanent number; the entry of the other is its `twin`. Only entries that are no twins hold history.
    """
    t = types(scalar)

    @wp.struct
    class Links:
        link: wp.array(dtype=wp.vec4i)  # lower and higher sphere, entry and twin, from the scene's first; or -1
        scene: wp.array(dtype=wp.int32)  # number in the batch, shape (links,) as the rest
        touched: wp.array(dtype=wp.int32)  # 1: in the last step, 2: in the one before, 3: a stiff bond holds it
        more: wp.array(dtype=wp.int32)  # as `touching` of spheres, of the entries after those, MORE for each sphere
        end: wp.array(dtype=wp.int32)  # of each entry of the lists: its link p from the scene's first, of twins -1 - p
        pull: wp.array(dtype=t.vec4)  # rows of what a link gave in this step. Of two: force on its lower sphere [N] and
        # the arm of that [m]; the contact's moment over the arm [N] and the arm of the other. Of four, two for each
        # sphere: force on it [N] and, of the lower, lost energy [J]; moment about its centre [N m]
        near: wp.array(dtype=wp.vec4i)  # of links that are close: spheres and entry, from the batch's first, and link
        near_count: wp.array(dtype=wp.int32)  # how many they are, and whether some scene's no longer do, shape (2,)
        outrun: wp.array(dtype=wp.int32)  # 1: near links of the scene may miss a contact, shape (scenes,)
        seen: wp.array(dtype=t.vec4)  # position and radius when near links were chosen [m], shape (spheres,)
        seen_at: wp.array(dtype=wp.float64)  # time since the lists were built then [s], shape (scenes,)

    return Links


@functools.cache
def subcycled_struct(scalar):
    """Struct `Subcycled`: pairs that are stepped in rounds, and bodies that have such pairs. All that a round needs
    stands here, row by row: a GPU waits for memory in each."""
    t = types(scalar)
    Pairs = array_structs(scalar).Pairs

    @wp.struct
    class Subcycled:
        rounds: wp.array(dtype=wp.int32)  # in a step, 0 for none, shape (scenes,)
        stable: wp.array(dtype=wp.float64)  # step for these pairs alone [s], shape (scenes,)
        pair_scene: wp.array(dtype=wp.int32)  # number in the batch, shape (pairs,) as the rest
        lower: wp.array(dtype=wp.int32)  # permanent numbers of the two spheres
        higher: wp.array(dtype=wp.int32)  # likewise
        ends: wp.array(dtype=wp.vec4i)  # rows of the bodies of both, and their rows in `force`
        lower_offset: wp.array(dtype=t.vec4)  # centre in the body's frame, radius [m]
        higher_offset: wp.array(dtype=t.vec4)  # likewise
        law: wp.array(dtype=wp.int32)  # row of the contact's parameters
        entry: wp.array(dtype=wp.int32)  # of the list, that holds the pair
        copy: wp.array(dtype=wp.int32)  # of the list, that holds it a second time, or -1
        held: Pairs  # history and bonds, a row for each pair; those of the list follow at the end of a step
        active: wp.array(dtype=wp.int32)  # 0: the bond is broken, and the contact is one as all others
        lost: wp.array(dtype=wp.float64)  # energy, in the rounds so far of the step [J]
        outcome: wp.array(dtype=wp.int32)  # 1, or how the bond broke in this step
        body_scene: wp.array(dtype=wp.int32)  # number in the batch, shape (bodies,) as the rest
        body_number: wp.array(dtype=wp.int32)  # permanent
        place: wp.array(dtype=wp.int32)  # where it is now, in the batch
        start: wp.array(dtype=wp.int32)  # first of its rows in `force` and `torque`, and the end, shape (bodies + 1,)
        ref: wp.array(dtype=wp.int32)  # twice the pair's number, 1 more for its higher end, shape (2 pairs,)
        mass: wp.array(dtype=scalar)  # [kg]
        inertia: wp.array(dtype=t.vec3)  # principal moments [kg m2]
        position: wp.array(dtype=t.vec3)  # in the middle of a step, as the velocities of all bodies [m]
        rounding: wp.array(dtype=t.vec3)  # what rounding took from the position so far [m]
        orientation: wp.array(dtype=t.quat)  # from body to space
        velocity: wp.array(dtype=t.vec3)  # [m/s]
        spin: wp.array(dtype=t.vec3)  # in space [rad/s]
        angular_momentum: wp.array(dtype=t.vec3)  # in space [kg m2/s]
        other_force: wp.array(dtype=t.vec3)  # of all but stiff pairs [N]
        other_torque: wp.array(dtype=t.vec3)  # about the centroid [N m]
        force: wp.array(dtype=t.vec3)  # of each end of a pair on its body, body by body [N], shape (2 pairs,)
        torque: wp.array(dtype=t.vec3)  # about the centroid [N m], shape (2 pairs,)
        member: wp.array(dtype=wp.int32)  # of every body of the batch: 1 + its row here, or 0

    return Subcycled
