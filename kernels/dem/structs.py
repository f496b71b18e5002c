"""Structs of the arrays that the discrete-element kernels work on: scenes, bodies, spheres, slots, pairs, walls.

A slot stores a sphere's contact with a wall. Arrays are flat over all scenes of a batch. Indices stored in the arrays
of the state count from the scene's first row; these are `bodies.first`, `spheres.body`, `slots.wall`, `candidates.face`
and the entries of `pairs.other`. The state of a scene is therefore the same alone and in a batch. Indices into the
tables of meshes and pipe axes, which are not part of the state, count over the whole batch. Arrays of features that no
scene uses have zero rows.

The integer array `flags`, shape (scenes, FLAGS), is passed to kernels separately; `common.control` lists its columns.
"""

import functools
from types import SimpleNamespace

import warp as wp

from ..common.types import types
from ..common.walls import wall_struct

# The next constants are column indices of the double-precision array `clock`, which has one row per scene.
TIME: int = wp.constant(0)  # column index of the simulated time [s]
DT: int = wp.constant(1)  # column index of the coming time step [s]

# DT_PREVIOUS is the column index of the previous time step [s]. It is 0 at the start, so that the first velocity kick
# has half the length.
DT_PREVIOUS: int = wp.constant(2)
SINCE_BUILD: int = wp.constant(3)  # column index of the time since the neighbour lists were built [s]

# FORCE_SCALE is the column index of the number of integer units per newton in fixed-point sums of wall forces [1/N].
FORCE_SCALE: int = wp.constant(4)
STABLE: int = wp.constant(5)  # column index of the latest estimate of the stable step, without safety factor [s]

# Number of columns of the array `clock`, whose rows belong to scenes.
CLOCK = 8

# The next constants are values of `links.state`. A link is a listed pair of spheres whose contact a GPU evaluates.
APART: int = wp.constant(0)  # value of `links.state` if the two spheres of a link do not touch

# TOUCHING: The spheres of the link touch or are bonded. In a list that was just rebuilt, the link may instead have
# contact history from the old list.
TOUCHING: int = wp.constant(1)
# PARTED: The contact of the link's spheres has just ended. The energy left in its springs counts as lost in the next
# step.
PARTED: int = wp.constant(2)
# STIFF: The spheres of the link have a stiff bond, whose forces are computed in several rounds per step (sub-cycling).
STIFF: int = wp.constant(3)


@functools.cache
def scene_struct(scalar):
    """Return the struct `SceneRow`, which contains the parameters of one scene.

    It also contains the index at which the data of the scene begin in each array that all scenes share.
    """
    t = types(scalar)

    @wp.struct
    class SceneRow:
        gravity: t.vec3  # acceleration of gravity [m/s2]

        # local damping: each force component is changed against the motion by this fraction of its magnitude; 0: off
        local_damping: scalar
        speed_limit: scalar  # speed limit of the bodies; the scene fails if a body is faster [m/s]
        mesh_speed: scalar  # largest speed of the mesh walls whose motion is prescribed [m/s]
        skin: scalar  # margin of the neighbour lists: pairs of spheres with a smaller gap are listed [m]
        mesh_skin: scalar  # margin of the candidate lists: triangles with a smaller gap to a sphere are listed [m]

        # Distance that spheres may move before the candidate lists of triangles are rebuilt. Meshes may move by the
        # rest of `mesh_skin`, the margin of these lists [m].
        sphere_allowance: scalar
        growth_rate: scalar  # increase of the size scale factor per step, during growth in packing
        growth_end: scalar  # size scale factor at which the growth during packing stops
        safety: wp.float64  # safety factor: automatic time step divided by the stable step
        largest_step: wp.float64  # upper limit of the automatic time step [s]
        fixed_step: wp.float64  # fixed time step [s]; 0: automatic
        until: wp.float64  # time at which the scene halts [s]
        interval: wp.int32  # steps between two estimates of the stable step
        sort_every: wp.int32  # steps between two re-sortings of the bodies; 0: never

        # largest speed [m/s] that walls and gravity are expected to cause in the scene before the stable step is
        # estimated again
        expected_speed: wp.float64
        wall_stiffness: wp.float64  # lower bound of the stiffness of the contacts on a driven wall [N/m]
        largest_radius: scalar  # largest sphere radius, at full size [m]

        # The following integers are the first indices of the scene in the arrays of bodies, spheres, pairs and so on,
        # which are joint arrays of all scenes of a batch. The integers named `..._count` are the numbers of entries
        # that belong to the scene.
        bodies: wp.int32
        body_count: wp.int32
        spheres: wp.int32
        sphere_count: wp.int32
        pairs: wp.int32
        loads: wp.int32
        candidates: wp.int32
        faces: wp.int32
        walls: wp.int32
        wall_count: wp.int32
        analytic: wp.int32  # number of planes and pipes, which precede meshes in the list of walls
        walls_fixed: wp.int32  # 1 if no plane or pipe of the scene ever moves, else 0
        held: wp.int32  # 1 while walls with prescribed motion are held at rest, else 0
        materials: wp.int32  # number of materials; contact parameters form a square table over pairs of materials
        laws: wp.int32  # first row of the scene in the table of contact parameters
        bonds: wp.int32
        groups: wp.int32

    return SceneRow


@functools.cache
def array_structs(scalar) -> SimpleNamespace:
    """Return the structs of arrays for scenes, bodies, spheres, wall contacts, pairs of spheres, mesh faces and walls.

    Their names are `Scenes`, `Bodies`, `Spheres`, `Slots`, `Pairs`, `Candidates` and `Walls`. If a comment states no
    shape, the array has one entry for each scene, body, sphere or wall.
    """
    t = types(scalar)
    SceneRow = scene_struct(scalar)
    Wall = wall_struct(scalar)

    @wp.struct
    class Scenes:
        # Parameters of each scene, and the indices at which the data of the scene begin in arrays that all scenes
        # share, shape (scenes,).
        row: wp.array(dtype=SceneRow)
        # Simulated time [s], time step [s] and other numbers of each scene, shape (scenes, CLOCK). Constants of this
        # module, such as TIME and DT, are the indices of the columns.
        clock: wp.array2d(dtype=wp.float64)
        scale: wp.array(dtype=scalar)  # scale factor of all sphere sizes during growth in packing, shape (scenes,)

        # mean velocity of each scene's spheres when its neighbour lists were built [m/s]
        reference_velocity: wp.array(dtype=t.vec3)

    @wp.struct
    class Bodies:
        id: wp.array(dtype=wp.int32)  # permanent number of each body, shape (bodies,)
        scene: wp.array(dtype=wp.int32)  # index of each body's scene in the batch

        # index of each body's shape in the list of clump templates, which contains the shapes of all bodies
        shape: wp.array(dtype=wp.int32)
        group: wp.array(dtype=wp.int32)  # index of each body's group in the model; 0: no group
        size: wp.array(dtype=scalar)  # diameter of a sphere with the body's volume, at full size [m]
        mass: wp.array(dtype=scalar)  # mass of each body [kg]
        inertia: wp.array(dtype=t.vec3)  # principal moments of inertia of each body [kg m2]
        position: wp.array(dtype=t.vec3)  # position of each body's centroid [m]
        rounding: wp.array(dtype=t.vec3)  # rounding error of each body's position, for compensated summation [m]
        velocity: wp.array(dtype=t.vec3)  # velocity of each body's centroid in the middle of the last step [m/s]

        # angular velocity of each body in space axes, in the middle of the last step [rad/s]
        spin: wp.array(dtype=t.vec3)
        orientation: wp.array(dtype=t.quat)  # rotation of each body from its body axes to space axes
        angular_momentum: wp.array(dtype=t.vec3)  # angular momentum of each body in space axes [kg m2/s]

        # Index of each body's first sphere. The indices of each scene end with the scene's total number of spheres.
        # Shape (bodies + scenes,).
        first: wp.array(dtype=wp.int32)

    @wp.struct
    class Spheres:
        id: wp.array(dtype=wp.int32)  # permanent number of each sphere, shape (spheres,)
        scene: wp.array(dtype=wp.int32)  # index of each sphere's scene in the batch
        body: wp.array(dtype=wp.int32)  # index of each sphere's body in the scene
        material: wp.array(dtype=wp.int32)  # index of each sphere's material in the model

        # centre of each sphere in the body's frame, and its radius, both for a scale factor of 1 [m]
        offset: wp.array(dtype=t.vec4)
        position: wp.array(dtype=t.vec4)  # centre of each sphere in space, and its radius [m]
        velocity: wp.array(dtype=t.vec4)  # velocity of each sphere's centre [m/s], and mass of its body [kg]

        # angular velocity of each sphere's body [rad/s], padded to four numbers for fast access
        spin: wp.array(dtype=t.vec4)
        built: wp.array(dtype=t.vec4)  # position and radius of each sphere when the neighbour lists were built [m]

        # Centre of each sphere when its distance from fixed planes and pipes was last measured, and its distance from
        # the nearest of these planes and pipes, reduced by a margin for rounding errors [m].
        clear: wp.array(dtype=t.vec4)
        force: wp.array(dtype=t.vec3)  # contact force (CPU: all contacts, GPU: walls only); zero between steps [N]
        moment: wp.array(dtype=t.vec3)  # contact moment about each sphere's centre [N m]

        # Bit mask that marks neighbours of each sphere in contact in the last step. Bit k belongs to entry k of the
        # sphere's neighbour list; the mask covers the first BLOCK entries.
        touching: wp.array(dtype=wp.int32)
        dissipated_energy: wp.array(dtype=wp.float64)  # energy dissipated since the start, recorded at each sphere [J]

        # number of bonds broken since the start in tension and in shear, recorded at each sphere
        broken: wp.array(dtype=wp.vec2i)

    @wp.struct
    class Slots:
        # bit mask of the planes and pipes that each sphere touched in the last step, shape (spheres,)
        touching: wp.array(dtype=wp.int32)
        # Contact history of each wall contact, for spring laws the shear force [N], shape (spheres, slots). A slot is a
        # storage place for one contact. A sphere's slots for planes and pipes come first, then those for meshes.
        history: wp.array2d(dtype=t.vec3)
        # moment of the rolling-resistance spring of each wall contact [N m], shape (spheres, slots)
        rolling: wp.array2d(dtype=t.vec3)
        normal: wp.array2d(dtype=t.vec3)  # normal of each mesh contact, into the wall, shape (spheres, slots)
        overlap: wp.array2d(dtype=scalar)  # overlap of each mesh contact [m], shape (spheres, slots)
        wall: wp.array2d(dtype=wp.int32)  # wall index of each mesh contact, -1: no contact, shape (spheres, slots)

        # `worn` holds the wear of each wall by each sphere since the last measurement, shape (spheres, walls). Each
        # entry has three values: the work of sliding [J], the energy loss of impacts [J], and the integral of the
        # load over the sliding distance [N m].
        worn: wp.array2d(dtype=wp.vec3d)
        # last point of contact with each wall, in the wall's frame [m], shape (spheres, walls)
        worn_at: wp.array2d(dtype=t.vec3)

    @wp.struct
    class Pairs:
        # Index of each sphere's first list entry, counted from the scene's first list entry. The indices of each scene
        # end with the scene's total number of list entries. Shape (spheres + scenes,).
        start: wp.array(dtype=wp.int32)
        # index j of the neighbour, or -1 - j if j has the lower permanent number, shape (pairs,)
        other: wp.array(dtype=wp.int32)
        # Contact history of each pair, shape (pairs,). For spring laws it is the shear force [N], padded to four
        # numbers.
        history: wp.array(dtype=t.vec4)
        rolling: wp.array(dtype=t.vec3)  # moment of the rolling-resistance spring [N m], shape (pairs,)

        # bond state, see `bond_parallel.py`; 0 without a bond, negative if it broke, shape (pairs,)
        bond: wp.array(dtype=wp.int32)
        # `load` holds the force and the moment of each bond, shape (rows,). The force consists of shear vector and
        # tension [N]; the moment consists of bending vector and torsion [N m]. Both are in one array, because a GPU
        # moves memory in units of 32 bytes. `warpcrete/dem/engine/bonding.py` explains which row a bond uses.
        load: wp.array(dtype=t.vec8)

    @wp.struct
    class Candidates:
        # Index of each sphere's first entry in `face`. The indices of each scene end with the scene's total number of
        # entries. Shape (spheres + scenes,).
        start: wp.array(dtype=wp.int32)
        # indices within the scene of the triangles within reach of each sphere, shape (candidates,)
        face: wp.array(dtype=wp.int32)
        # Near candidates of each sphere: triangles that may touch it soon. A sphere's entries begin at the same index
        # as in `face`. Shape (candidates,).
        near: wp.array(dtype=wp.int32)
        near_count: wp.array(dtype=wp.int32)  # number of near candidates of each sphere, shape (spheres,)

        # First three numbers: centre of each sphere when its near candidates were chosen [m]. Fourth number: the near
        # candidates contain all triangles that the sphere may touch while the sum of its radius, its displacement and
        # the displacement of meshes is below this number [m]. All are 0 before the first choice. Shape (spheres,).
        chosen: wp.array(dtype=t.vec4)

    @wp.struct
    class Walls:
        scene: wp.array(dtype=wp.int32)  # index of each wall's scene in the batch, shape (walls,)
        table: wp.array(dtype=Wall)  # constant properties of each wall
        rest_position: wp.array(dtype=wp.vec3d)  # position of the wall's frame at the start [m]
        position_exact: wp.array(dtype=wp.vec3d)  # position of the wall's frame in double precision [m]
        velocity_exact: wp.array(dtype=wp.vec3d)  # velocity of the wall in double precision [m/s]
        position: wp.array(dtype=t.vec3)  # position of the wall's frame [m]
        orientation: wp.array(dtype=t.quat)  # orientation of the wall's frame
        normal: wp.array(dtype=t.vec3)  # planes only: unit normal that points into the concrete
        velocity: wp.array(dtype=t.vec3)  # mean velocity of the wall over the step [m/s]
        spin: wp.array(dtype=t.vec3)  # mean angular velocity of the wall over the step [rad/s]
        force: wp.array(dtype=wp.vec3d)  # total contact force on the wall in the last step [N]
        moment: wp.array(dtype=wp.vec3d)  # total contact moment on the wall about the wall's position [N m]
        impulse: wp.array(dtype=wp.vec3d)  # time integral of the contact force on the wall since the start [N s]

        # time integral of the contact moment on the wall since the start [N m s]
        angular_impulse: wp.array(dtype=wp.vec3d)
        travel: wp.array(dtype=wp.float64)  # displacement along the wall's path since the start [m]
        work: wp.array(dtype=wp.float64)  # work done by the wall on the concrete since the start [J]

        # meshes only: largest possible displacement of a corner since the neighbour lists were built [m]
        moved: wp.array(dtype=wp.float64)
        # force and moment on each wall in this step, in fixed point, shape (threads, walls, 6)
        step_force: wp.array3d(dtype=wp.int64)

    return SimpleNamespace(
        Scenes=Scenes, Bodies=Bodies, Spheres=Spheres, Slots=Slots, Pairs=Pairs, Candidates=Candidates, Walls=Walls,
    )  # fmt: skip


@functools.cache
def links_struct(scalar):
    """Return the struct `Links`: the pairs as a GPU evaluates them, one thread per pair.

    A GPU's neighbour list contains each pair twice. The pair's `entry` is in the row of the sphere with the lower
    permanent number; its `twin` is in the row of the other sphere. Only entries store contact history, twins do not.
    """
    t = types(scalar)

    @wp.struct
    class Links:
        # Four indices of each link, which count from the first row of the scene: the sphere with the lower permanent
        # number, the sphere with the higher one, the list entry of the pair at the former sphere, and the entry at the
        # latter sphere. All four are -1 if the link is unused. Shape (links,).
        link: wp.array(dtype=wp.vec4i)
        scene: wp.array(dtype=wp.int32)  # index of each link's scene in the batch, shape (links,)
        state: wp.array(dtype=wp.int32)  # state of each link: APART, TOUCHING, PARTED or STIFF, shape (links,)

        # Bit masks that mark neighbours in contact, for the entries of a sphere's neighbour list after the first BLOCK
        # entries. Each sphere has EXTRA_MASKS integers, shape (spheres * EXTRA_MASKS,).
        later_touching: wp.array(dtype=wp.int32)
        # For each entry of the neighbour lists, the link that stands for its pair. If p is the index of the link, the
        # entry of the sphere with the lower permanent number stores p, and the entry of the other sphere stores -1 - p.
        # Shape (list entries,).
        end: wp.array(dtype=wp.int32)
        # Result of each link (pair of spheres) in this step, shape (elements per link * links,). An element holds a
        # vector and a number. The lower sphere of a pair is the one with the lower permanent number. Without bonds,
        # rolling resistance and energy sums, a link has two elements:
        # - force on the lower sphere [N], and lever arm of the force at the lower sphere [m];
        # - moment of the contact about a sphere's centre divided by the lever arm at this sphere [N], which is the same
        #   for both spheres, and lever arm at the higher sphere [m].
        # Otherwise a link has two elements for the lower sphere, followed by two for the higher sphere:
        # - force on the sphere [N], and the energy that the contact lost [J], which is 0 for the higher sphere;
        # - moment about the sphere's centre [N m], and 0.
        result: wp.array(dtype=t.vec4)
        # Near links, which are the listed pairs of spheres that may touch soon. Each one holds four indices in the
        # arrays of the batch: the two spheres, the pair's entry in the neighbour list, and the link. Shape (links,).
        near: wp.array(dtype=wp.vec4i)
        # Two integers, shape (2,). The first is the number of near links. The second is a flag: 1 if at least one scene
        # must check all its links instead of only its near links, and 0 otherwise.
        near_count: wp.array(dtype=wp.int32)
        # `near_list_exceeded` is 1 for a scene whose near links (listed pairs of spheres that may touch soon) may miss
        # a contact, for example because a sphere has moved far. Otherwise it is 0. Shape (scenes,).
        near_list_exceeded: wp.array(dtype=wp.int32)
        # positions and radii of the spheres when near links were chosen [m], shape (spheres,)
        near_position: wp.array(dtype=t.vec4)
        # time from the rebuild of the neighbour list to the latest choice of near links (listed pairs of spheres that
        # may touch soon) [s], shape (scenes,)
        near_time: wp.array(dtype=wp.float64)

    return Links


@functools.cache
def subcycled_struct(scalar):
    """Return the struct `Subcycled`: the pairs with stiff bonds, and the bodies that these pairs join.

    These bodies move in several sub-cycling rounds per step. If a comment states no shape, the array has one entry for
    each of these pairs or bodies. The struct contains its own copy of everything that a round reads, in contiguous
    rows, because a round on a GPU is bound by memory latency.
    """
    t = types(scalar)
    Pairs = array_structs(scalar).Pairs

    @wp.struct
    class Subcycled:
        rounds: wp.array(dtype=wp.int32)  # number of sub-cycling rounds in a step; 0: no sub-cycling, shape (scenes,)
        stable: wp.array(dtype=wp.float64)  # stable step of the pairs with stiff bonds alone [s], shape (scenes,)
        pair_scene: wp.array(dtype=wp.int32)  # index of each pair's scene in the batch, shape (pairs,)
        lower: wp.array(dtype=wp.int32)  # lower one of the permanent numbers of the pair's two spheres
        higher: wp.array(dtype=wp.int32)  # higher one of the permanent numbers of the pair's two spheres

        # Four indices of each pair: its two bodies in this struct, then the rows of `force` for the forces on these
        # bodies.
        ends: wp.array(dtype=wp.vec4i)
        # for the sphere of each pair with the lower permanent number: centre in the body's frame, and radius [m]
        lower_offset: wp.array(dtype=t.vec4)
        # for the sphere of each pair with the higher permanent number: centre in the body's frame, and radius [m]
        higher_offset: wp.array(dtype=t.vec4)
        law: wp.array(dtype=wp.int32)  # index of the pair's contact parameters in `pair_parameters`
        entry: wp.array(dtype=wp.int32)  # index of the neighbour list entry that holds the pair

        # index of the pair's second entry in the neighbour list, or -1 if the pair has only one entry
        copy: wp.array(dtype=wp.int32)
        # contact history and bond of each pair; the last sub-cycling round of a step copies them to the neighbour list
        held: Pairs
        # 1 while the bond holds; 0 once it is broken and the pair is an ordinary contact again
        active: wp.array(dtype=wp.int32)
        # energy that each pair has lost in the sub-cycling rounds of this step so far [J]
        lost: wp.array(dtype=wp.float64)
        # 1 if the bond of a pair holds; the negative code of its failure mode if it broke in this step
        outcome: wp.array(dtype=wp.int32)
        body_scene: wp.array(dtype=wp.int32)  # index of each body's scene in the batch, shape (bodies,)
        body_number: wp.array(dtype=wp.int32)  # permanent number of each body
        place: wp.array(dtype=wp.int32)  # current index of each body in the batch's arrays of bodies

        # index of each body's first row in `force`, followed by the number of rows, shape (bodies + 1,)
        start: wp.array(dtype=wp.int32)
        # For each row of `force`, the pair and the sphere to which it belongs: 2 p for the sphere of pair p with the
        # lower permanent number, 2 p + 1 for its other sphere. Shape (2 pairs,).
        ref: wp.array(dtype=wp.int32)
        mass: wp.array(dtype=scalar)  # mass of each body [kg]
        inertia: wp.array(dtype=t.vec3)  # principal moments of inertia of each body [kg m2]

        # Position of each body's centroid in the middle of a time step [m]. The velocities in this struct belong to the
        # same time.
        position: wp.array(dtype=t.vec3)
        rounding: wp.array(dtype=t.vec3)  # rounding error of each body's position, for compensated summation [m]
        orientation: wp.array(dtype=t.quat)  # rotation of each body from its body axes to space axes
        velocity: wp.array(dtype=t.vec3)  # velocity of each body's centroid [m/s]
        spin: wp.array(dtype=t.vec3)  # angular velocity of each body in space axes [rad/s]
        angular_momentum: wp.array(dtype=t.vec3)  # angular momentum of each body in space axes [kg m2/s]

        # all forces on each body other than the forces of pairs with stiff bonds, gravity included [N]
        other_force: wp.array(dtype=t.vec3)
        other_torque: wp.array(dtype=t.vec3)  # torque of `other_force` about each body's centroid [N m]

        # force of each pair on each of its two bodies, grouped by body [N], shape (2 pairs,)
        force: wp.array(dtype=t.vec3)
        # torque of each pair on each of its two bodies about their centroids [N m], shape (2 pairs,)
        torque: wp.array(dtype=t.vec3)
        # Number for each body of the batch: 1 + the row of the body in the arrays of this struct. It is 0 for a body
        # without stiff bonds.
        member: wp.array(dtype=wp.int32)

    return Subcycled
