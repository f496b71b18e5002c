"""Rigid aggregates in a grid flow: their initial state, and their arrays on a device."""

from dataclasses import dataclass, field

import numpy as np
import warp as wp

from ..core.device.arrays import Scalar, host_copy
from ..core.errors import at_most, refuse
from ..dem.scene.clumps import ClumpTemplate, sphere
from ..kernels.suspension.bodies import BodyKind, body_structs
from ..kernels.suspension.leaving import PARKED
from ..kernels.suspension.pairs import CAPACITY, LOOKED_AT, pair_struct
from ..mps.common.allocation import allocate
from ..mps.grid.layout import GridLayout

MIN_CELLS = 3.0
"""Minimum number of cells across the smallest aggregate. With fewer cells, the drag is more than 10 % too small."""
MAX_GRID = 64
"""Maximum number of cells along an axis of the hash grid that finds neighbouring aggregates."""
STATE_ARRAYS = ("centre", "velocity", "spin", "turn")
"""Names of the arrays in `Bodies` that a checkpoint contains, because the next step depends on them."""


CONTACT_ARRAYS = ("last_other", "last_normal", "last_force")
"""Names of the arrays in `Pairs` that a checkpoint contains if there is friction. They hold the neighbour, the normal
and the normal force of each contact in the last step, on which friction in the next step depends."""


@dataclass(frozen=True)
class Aggregates:
    """Aggregates in a mortar at the start of a run: n rigid bodies, each a sphere or a clump of spheres."""

    centre: np.ndarray
    """Positions of the aggregates' centres in the coordinates of the grid [m], shape (n, 3)."""
    radius: np.ndarray
    """Radii of spheres with the volumes of the aggregates [m], shape (n,)."""
    density: float
    """Density of the aggregates [kg/m3]."""
    velocity: np.ndarray | None = None
    """Velocities of the aggregates' centres [m/s], shape (n, 3); None if all aggregates are at rest."""
    shapes: tuple[ClumpTemplate, ...] = field(default_factory=lambda: (sphere(),))
    """Shapes of the aggregates."""
    shape: np.ndarray | None = None
    """Index in `shapes` of each aggregate's shape, shape (n,); None if all have the first shape."""
    turn: np.ndarray | None = None
    """Orientations of the aggregates as quaternions (x, y, z, w), shape (n, 4); None if no aggregate is rotated."""

    def __post_init__(self) -> None:
        centre, radius = np.asarray(self.centre, float), np.asarray(self.radius, float)
        if centre.ndim != 2 or centre.shape[1] != 3 or radius.shape != centre.shape[:1]:
            problem = f"must have the shape (n, 3) for radii of shape {radius.shape}"
            refuse("centre", centre.shape, problem, "give one centre and one radius for each aggregate")
        if not (np.isfinite(centre).all() and np.all(radius > 0)):
            problem = "must be above 0 for all aggregates, and all centres must be finite"
            refuse("radius", radius.tolist(), problem, "correct or remove the aggregates that violate this")
        object.__setattr__(self, "centre", centre)
        object.__setattr__(self, "radius", radius)

    @property
    def count(self) -> int:
        """Number of aggregates."""
        return len(self.radius)

    @property
    def clumps(self) -> bool:
        """True if any shape has more than one sphere."""
        return any(len(shape.radii) > 1 for shape in self.shapes)

    @property
    def size(self) -> np.ndarray:
        """Diameters of spheres with the volumes of the aggregates [m], shape (n,)."""
        return 2 * self.radius

    @property
    def kinds(self) -> np.ndarray:
        """Index in `shapes` of each aggregate's shape, shape (n,)."""
        return np.zeros(self.count, int) if self.shape is None else np.asarray(self.shape, int)

    @property
    def turns(self) -> np.ndarray:
        """Orientations of the aggregates as quaternions (x, y, z, w), shape (n, 4)."""
        return np.tile([0.0, 0.0, 0.0, 1.0], (self.count, 1)) if self.turn is None else self.turn

    @property
    def widths(self) -> np.ndarray:
        """Shortest side of each aggregate's bounding box along its principal axes [m], shape (n,)."""
        return self.size * np.array([shape.widths.min() for shape in self.shapes])[self.kinds]


class Spheres:
    """All spheres of the aggregates, sorted by aggregate. In shapes of arrays, m is the number of spheres."""

    def __init__(self, aggregates: Aggregates) -> None:
        kinds, size, shapes = aggregates.kinds, aggregates.size, aggregates.shapes
        number = np.array([len(shape.radii) for shape in shapes])[kinds]
        self.first = np.concatenate([[0], np.cumsum(number)])
        """Index of each aggregate's first sphere, and the number of all spheres, shape (n + 1,)."""
        self.body = np.repeat(np.arange(aggregates.count), number)
        """Index of the aggregate to which each sphere belongs, shape (m,)."""
        scale = np.repeat(size, number)
        self.offset = np.concatenate([shapes[k].offsets for k in kinds]) * scale[:, None]
        """Centres of the spheres along the principal axes of their aggregates [m], shape (m, 3)."""
        self.radius = np.concatenate([shapes[k].radii for k in kinds]) * scale
        """Radii of the spheres [m], shape (m,)."""
        self.share = np.concatenate([shapes[k].shares for k in kinds]) * np.pi / 6 * scale**3
        """Volume that counts as part of each sphere [m3], shape (m,). Overlaps of spheres count once."""
        self.moments = np.array([shape.inertia for shape in shapes])[kinds] * size[:, None] ** 2
        """Principal moments of inertia of the aggregates, divided by their masses [m2], shape (n, 3)."""

    @property
    def count(self) -> int:
        """Number of spheres."""
        return len(self.radius)

    def centres(self, centre: np.ndarray, turn: np.ndarray) -> np.ndarray:
        """Return the centres of the spheres [m], shape (m, 3).

        `centre` and `turn` are the centres, shape (n, 3), and the orientations of the aggregates, shape (n, 4).
        """
        return centre[self.body] + rotated(turn[self.body], self.offset)


def _entries(count: np.ndarray) -> np.ndarray:
    """Return the indices of all entries that describe a contact, in arrays with CAPACITY entries for each sphere.

    `count` is the number of contacts of each sphere. They fill the sphere's first entries, and its other entries are
    unused.
    """
    return np.concatenate([s * int(CAPACITY) + np.arange(n) for s, n in enumerate(count)]).astype(int)


def rotated(turn: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return the vectors `x`, shape (n, 3), rotated by the unit quaternions `turn` (x, y, z, w), shape (n, 4)."""
    axis, part = turn[:, :3], turn[:, 3:]
    across = 2 * np.cross(axis, x)
    return x + part * across + np.cross(axis, across)


def is_inside(centres: np.ndarray) -> np.ndarray:
    """Return a mask of the aggregates that are at least partly in the simulated box, shape (n,).

    `centres` are the centres of the aggregates [m], shape (n, 3). An aggregate outside the box has a coordinate whose
    magnitude is PARKED or more.
    """
    return np.abs(centres).max(1) < float(PARKED)


class BodyState:
    """State of the aggregates on a device: motion, neighbours, and the faces and cells of the grid that they cover."""

    def __init__(
        self, aggregates: Aggregates, layout: GridLayout, density: float, gravity: np.ndarray, scalar: Scalar,
        device: wp.Device, friction: float = 0.0,
    ) -> None:  # fmt: skip
        structs = body_structs(scalar)
        count, radius = aggregates.count, aggregates.radius
        width = min(layout.room.width)
        narrowest = float(aggregates.widths.min())
        if narrowest < MIN_CELLS * width:
            refuse("spacing", width, f"is too coarse: the narrowest aggregate, {narrowest:.3g} m, must be at least "
                                     f"{MIN_CELLS:g} cells wide",
                   f"use {at_most(narrowest / 4)} m or less, a quarter of its width, or count smaller aggregates "
                   "as mortar")  # fmt: skip
        volume = 4 / 3 * np.pi * radius**3
        extra = (aggregates.density - density) * volume
        zero = np.zeros((count, 3))
        self.count, self.radius, self.extra_weight = count, radius, extra[:, None] * gravity
        self.kind, parts = BodyKind(aggregates.clumps, friction > 0), Spheres(aggregates)
        self.parts, self.spheres = parts, parts.count
        self.excess = aggregates.density - density
        self.low = np.array(layout.room.origin)
        self.high = self.low + np.array(layout.room.cells) * np.array(layout.room.width)
        self.bodies = allocate(
            structs.Bodies, device, centre=aggregates.centre, spin=count,
            velocity=zero if aggregates.velocity is None else np.asarray(aggregates.velocity, float),
            turn=aggregates.turns, radius=radius, extra_mass=extra,
            extra_inertia=0.4 * extra * radius**2, force=self.extra_weight, torque=count, mobility=count,
            spin_mobility=count,
            resistance=count,
        )  # fmt: skip
        if self.kind.clumps:
            allocate(structs.Bodies, device, self.bodies, first=parts.first, body=parts.body, size=parts.radius,
                     share=parts.share, offset=parts.offset, arm=parts.count, moments=parts.moments, tensor=count,
                     gyration=count)  # fmt: skip
        # Upper bound of the number of faces that an aggregate covers: three times the number of cells that its spheres
        # would contain if their radii were larger by two cells.
        room = np.ceil(3 * 4 / 3 * np.pi * (parts.radius / width + 2) ** 3).astype(int)
        room = np.add.reduceat(room, parts.first[:-1])
        slots = int(np.prod(layout.shape))
        self.cover = allocate(
            structs.Cover, device, claims=3 * slots, owner=3 * slots, closing=3 * slots, closer=3 * slots, shared=slots,
            touches=3 * slots, toucher=3 * slots, covered=3 * slots, solid=4 * slots, count=count, touched=count,
            first=np.concatenate([[0], np.cumsum(room)]), faces=int(room.sum()), part=int(room.sum()),
            lever=int(room.sum()),
        )  # fmt: skip
        entries = parts.count * int(CAPACITY)
        self.pairs = allocate(
            pair_struct(scalar), device, count=parts.count, other=entries, normal=entries, gap=entries, rough=entries,
            still=entries, lubrication=entries, hold=entries, touching=entries, smallest_gap=parts.count, full=1,
            changed=1,
        )  # fmt: skip

        if self.kind.friction:
            allocate(pair_struct(scalar), device, self.pairs, grip=entries, drift=entries, last_count=parts.count,
                     last_other=entries, last_normal=entries, last_force=entries)  # fmt: skip

        # The hash grid finds neighbours from points in single precision, so the largest distance of two neighbours is
        # enlarged slightly to allow for rounding.
        room = layout.room
        self.span = 1.0001 * (2 * float(parts.radius.max()) + float(LOOKED_AT) * max(room.width))
        lengths = np.array(room.cells) * np.array(room.width)
        self.grid = wp.HashGrid(*np.clip(lengths / self.span, 1, MAX_GRID).astype(int).tolist(), device=device)
        self.points = wp.zeros(parts.count, dtype=wp.vec3f, device=device)

    def sort(self) -> None:
        """Sort the centres of the spheres into the cells of the hash grid."""
        self.grid.build(self.points, self.span)

    def state_dict(self) -> dict[str, np.ndarray]:
        """Return centres, velocities, spins, orientations and, with friction, contacts of the aggregates, by name."""
        arrays = {name: host_copy(getattr(self.bodies, name)) for name in STATE_ARRAYS}
        if self.kind.friction:
            arrays["last_count"] = host_copy(self.pairs.last_count)
            entries = _entries(arrays["last_count"])
            arrays |= {name: getattr(self.pairs, name).numpy()[entries] for name in CONTACT_ARRAYS}
        return arrays

    def load_state_dict(self, found: dict[str, np.ndarray]) -> None:
        """Restore the state of the aggregates from a `state_dict`."""
        for name in STATE_ARRAYS:
            getattr(self.bodies, name).assign(found[name])
        if self.kind.friction:
            self.pairs.last_count.assign(found["last_count"])
            entries = _entries(found["last_count"])
            for name in CONTACT_ARRAYS:
                whole = getattr(self.pairs, name).numpy()
                whole[entries] = found[name]
                getattr(self.pairs, name).assign(whole)

    @property
    def inside(self) -> np.ndarray:
        """Mask of the aggregates that are at least partly in the simulated box, shape (n,)."""
        return is_inside(self.bodies.centre.numpy())

    def volume_inside(self, opens: int) -> float:
        """Return the fraction of the aggregates' volume that has not left the box through an open side.

        The bits of `opens` are 1 for open sides: bit 2 k for the lower side along axis k, and bit 2 k + 1 for the upper
        one.
        """
        parts = self.parts
        centre = parts.centres(self.bodies.centre.numpy().astype(float), self.bodies.turn.numpy().astype(float))
        left = np.zeros(parts.count)
        for side in range(6):
            if opens >> side & 1:
                axis = side // 2
                depth = centre[:, axis] - self.low[axis] if side % 2 == 0 else self.high[axis] - centre[:, axis]
                h = np.clip(parts.radius - depth, 0.0, 2 * parts.radius)
                left += h**2 * (3 * parts.radius - h) / (4 * parts.radius**3)
        return float(np.sum(parts.share * np.maximum(1 - left, 0.0)) / np.sum(parts.share))

    def smallest_gap(self) -> float:
        """Return the smallest gap of any sphere to a neighbour or wall, divided by the radius of that sphere.

        The gaps are taken at the start of the last step. A gap is negative where a sphere overlaps its neighbour.
        """
        return float(self.pairs.smallest_gap.numpy().min())
