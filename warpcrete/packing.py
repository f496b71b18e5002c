"""Packing: fill a pipe or any closed mesh with aggregates, by growing them in place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .axis import Axis
from .batch import batch_key
from .clumps import ClumpTemplate, reference
from .errors import CapacityError, InstabilityError, WarpcreteError, positive, refuse
from .laws import Contact, ContactLaw
from .memory import check_memory
from .model import build_model, find_device
from .probes import contact_sums
from .scene import MeshWall, PipeWall, PlaneWall, Scene
from .sizes import Gaussian, Sizes
from .state import BodyTable, State
from .stepper import Course, Stepper, drive, steppers_of

START_FRACTION = 0.10  # solid fraction at which aggregates are sown
GROWTH_STEPS = 1500
RELAX_STEPS = 3000
TRANSIENT = 0.005  # pressure over contact modulus that aggregates reach before they have parted
CLOSE_FRACTION = 0.75  # more than any packing of these shapes takes under kilopascals
MOST_BODIES = 2**25  # whose arrays still fit the memory of today's largest GPU


@dataclass(frozen=True)
class PipeContainer:
    """The first `length` of a pipe, between two planes across it."""

    axis: Axis
    radius: float
    length: float

    def __post_init__(self) -> None:
        positive("container radius", self.radius, "m")
        positive("container length", self.length, "m")

    @property
    def volume(self) -> float:
        """[m3] (Pappus: a bend does not change it)."""
        return float(np.pi * self.radius**2 * self.length)

    @property
    def narrowest(self) -> float:
        """Largest sphere diameter that fits [m]."""
        return min(2 * self.radius, self.length)

    def walls(self, material: str) -> tuple:
        """Pipe and end planes."""
        points, tangents = self.axis.at([0.0, self.length])
        return (
            PipeWall(name="pipe", axis=self.axis, radius=self.radius, material=material),
            PlaneWall(name="start", point=tuple(points[0]), normal=tuple(tangents[0]), material=material),
            PlaneWall(name="end", point=tuple(points[1]), normal=tuple(-tangents[1]), material=material),
        )

    def pilot(self) -> PipeContainer:
        """A smaller container in which packings are much the same."""
        return replace(self, length=min(self.length, 3 * self.radius))

    def sample(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Well spread points inside, shape (count, 3) [m]."""
        u = spread_points(count, random)
        s = u[:, 0] * self.length
        r = self.radius * np.sqrt(u[:, 1])
        angle = 2 * np.pi * u[:, 2]
        points, _, normal, side = self.axis.frame(s)
        return points + (r * np.cos(angle))[:, None] * normal + (r * np.sin(angle))[:, None] * side


@dataclass(frozen=True)
class MeshContainer:
    """Inside of a closed triangle mesh: a ``trimesh.Trimesh`` or a path that trimesh reads."""

    mesh: object

    def __post_init__(self) -> None:
        from .meshes import load_closed

        object.__setattr__(self, "mesh", load_closed(self.mesh, "container"))

    @property
    def volume(self) -> float:
        """[m3]"""
        return float(self.mesh.volume)  # type: ignore[attr-defined]

    @property
    def narrowest(self) -> float:
        """Shortest side of the bounding box [m]."""
        return float(self.mesh.extents.min())  # type: ignore[attr-defined]

    def walls(self, material: str) -> tuple:
        """The mesh itself."""
        return (MeshWall(name="container", vertices=self.mesh.vertices, faces=self.mesh.faces, material=material),)  # type: ignore[attr-defined]

    def pilot(self) -> MeshContainer:
        """The container itself: of a mesh nothing smaller is alike."""
        return self

    def sample(self, count: int, random: np.random.Generator) -> np.ndarray:
        """Well spread points inside, shape (count, 3) [m]."""
        from .meshes import signed_distance

        lower, upper = self.mesh.bounds  # type: ignore[attr-defined]
        wanted = int(1.2 * count * np.prod(upper - lower) / self.volume) + 64
        while True:
            points = lower + spread_points(wanted, random) * (upper - lower)
            inside = points[signed_distance(self.mesh, points) < 0]  # type: ignore[arg-type]
            if len(inside) >= count:
                # A sequence is well spread in whole only: thin it evenly.
                return inside[np.linspace(0, len(inside) - 1, count).astype(int)]
            wanted *= 2


@dataclass(frozen=True, kw_only=True)
class Fill:
    """Aggregates and the container they are packed into."""

    container: PipeContainer | MeshContainer
    sizes: Sizes = field(default_factory=Gaussian)
    templates: tuple[ClumpTemplate, ...] = field(default_factory=reference)
    shares: tuple[float, ...] | None = None
    """Volume share of each template; None: equal."""
    density: float = 2500.0
    """[kg/m3]"""
    material: str = "aggregate"
    solid_fraction: float | None = None
    """Solid volume over container volume; give this or `pressure`."""
    pressure: float | None = None
    """Mean pressure of the finished packing, without gravity or friction [Pa]."""

    def __post_init__(self) -> None:
        positive("density", self.density, "kg/m3")
        if (self.solid_fraction is None) == (self.pressure is None):
            refuse("solid_fraction", self.solid_fraction, "give either a solid fraction or a pressure")
        if self.solid_fraction is not None and not 0.01 <= self.solid_fraction <= 0.8:
            refuse("solid_fraction", self.solid_fraction, "must be in [0.01, 0.8]", "dense mixes pack at 0.55 to 0.7")
        if self.pressure is not None:
            positive("packing pressure", self.pressure, "Pa")
        if not self.templates:
            refuse("templates", self.templates, "needs one or more")
        shares = np.ones(len(self.templates)) if self.shares is None else np.asarray(self.shares, float)
        if shares.shape != (len(self.templates),) or np.any(shares < 0) or not shares.sum() > 0:
            refuse("shares", self.shares, f"must be {len(self.templates)} shares, 0 or more, not all 0")
        object.__setattr__(self, "shares", tuple((shares / shares.sum()).tolist()))
        # An aggregate lies along the container if it is long, so its thinnest width decides.
        thickest = self.sizes.largest * min(2 * float(t.radii.max()) for t in self.templates)
        if thickest >= self.container.narrowest:
            refuse(
                "largest size",
                self.sizes.largest,
                f"does not fit the container, which is {self.container.narrowest:g} m across",
                "choose smaller aggregates or a wider pipe",
            )


@dataclass(frozen=True)
class PackingReport:
    """What a packing came to."""

    bodies: int
    spheres: int
    solid_fraction: float
    """Solid volume (overlaps inside a clump counted once) over container volume."""
    coordination_number: float
    """Mean number of touching neighbours of a body; walls do not count."""
    mean_overlap: float
    """Of touching spheres, over the smaller radius."""
    largest_overlap: float
    pressure: float
    """Mean pressure from contact forces, container walls not counted [Pa]."""
    size_factor: float
    """All sizes were multiplied by this to meet a pressure; 1 for a solid fraction."""


def spread_points(count: int, random: np.random.Generator) -> np.ndarray:
    """Low-discrepancy points in the unit cube (Roberts' R3 sequence), randomly shifted; shape (count, 3)."""
    root = 1.2207440846057596  # real root of x^4 = x + 1
    steps = root ** -np.arange(1, 4)
    return (random.uniform(size=3) + np.arange(1, count + 1)[:, None] * steps) % 1.0


def random_orientations(count: int, random: np.random.Generator) -> np.ndarray:
    """Uniformly distributed unit quaternions x, y, z, w, shape (count, 4)."""
    q = random.normal(size=(count, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def draw(
    fill: Fill, container: PipeContainer | MeshContainer, fraction: float, random: np.random.Generator
) -> BodyTable:
    """Aggregates with a total of `fraction` times the container's volume, sown at well spread points."""
    wanted = fraction * container.volume
    expected = wanted / (np.pi / 6 * float(np.mean(fill.sizes.sample(1000, np.random.default_rng(0)) ** 3)))
    if expected > MOST_BODIES:
        raise CapacityError(
            f"packing: {container.volume:.3g} m3 would take {expected:.2g} aggregates, more than {MOST_BODIES:.2g}; "
            "choose a smaller container or larger aggregates"
        )
    sizes = np.empty(0)
    while np.pi / 6 * np.sum(sizes**3) < wanted:
        sizes = np.concatenate([sizes, fill.sizes.sample(max(16, len(sizes)), random)])
    total = np.cumsum(np.pi / 6 * sizes**3)
    count = int(np.searchsorted(total, wanted)) + 1
    if count > 1 and abs(total[count - 2] - wanted) < abs(total[count - 1] - wanted):
        count -= 1  # whichever comes nearer
    sizes = sizes[:count]
    # Sizes do not depend on the shape, so shares by number are shares by volume.
    template = random.choice(len(fill.templates), size=count, p=fill.shares)
    points = container.sample(count, random)[random.permutation(count)]
    zero = np.zeros((count, 3))
    return BodyTable(
        points, random_orientations(count, random), zero, zero, sizes, template, np.full(count, fill.density),
        [fill.material] * count, [""] * count, fill.templates,
    )  # fmt: skip


@dataclass(frozen=True)
class Request:
    """What :func:`pack_many` packs: a fill, the contact law whose stiffness it has, and a seed."""

    fill: Fill
    contact: ContactLaw
    seed: int


def pack(
    fill: Fill,
    *,
    contact: ContactLaw | None = None,
    seed: int = 0,
    device=None,
    precision: str = "float32",
    progress: Callable[[float], None] | None = None,
    threads: int = 1,
) -> tuple[BodyTable, PackingReport]:
    """Pack aggregates into their container: sow them small, let them grow, frictionless and damped, and settle.

    Returns the bodies at rest and a report. `progress` is called with the share done. To meet a pressure, a
    pilot packing finds the solid fraction that belongs to it; the packing itself then stops growing where the
    pressure is met, which changes all sizes by a factor near 1 that the report names.
    """
    request = Request(fill, contact or Contact(), seed)
    (packed,) = pack_many([request], device=device, precision=precision, progress=progress, threads=threads)
    if isinstance(packed, BaseException):
        raise packed
    return packed


def pack_many(
    requests: Sequence[Request],
    *,
    device=None,
    precision: str = "float32",
    progress: Callable[[float], None] | None = None,
    threads: int = 1,
) -> list[Any]:
    """Pack many containers side by side; for each (bodies, report) as from :func:`pack`, or the error it raised."""
    device = find_device(device) if device is None or isinstance(device, str) else device
    tell = progress or (lambda share: None)
    randoms = [np.random.default_rng([request.seed, 1]) for request in requests]
    pilots: dict[int, Any] = {}
    shares = []
    for number, request in enumerate(requests):
        fill = request.fill
        if fill.pressure is not None:
            pilot = fill.container.pilot()
            pilot = replace(pilot) if pilot is fill.container else pilot
            shares.append(pilot.volume / (pilot.volume + fill.container.volume))
            pilots[number] = (pilot, CLOSE_FRACTION)
    share = float(np.mean(shares)) if shares else 0.0

    def grow_all(containers: dict[int, Any], told: Callable[[float], None]) -> dict[int, Any]:
        found: dict[int, Any] = {}
        growths: dict[int, _Growth] = {}
        for number, (container, fraction) in containers.items():
            request = requests[number]
            try:
                growths[number] = _Growth(request, container, fraction, randoms[number], device, precision)
            except WarpcreteError as error:
                found[number] = error
        return found | _grow_together(growths, threads, told)

    measured = grow_all(pilots, lambda s: tell(share * s)) if pilots else {}
    wanted: dict[int, Any] = {}
    failed: dict[int, Any] = {}
    for number, request in enumerate(requests):
        fraction = request.fill.solid_fraction
        if number in measured:
            if isinstance(measured[number], BaseException):
                failed[number] = measured[number]
                continue
            fraction = min(measured[number][1].solid_fraction * 1.02, CLOSE_FRACTION)
        wanted[number] = (request.fill.container, fraction)
    found = failed | grow_all(wanted, lambda s: tell(share + (1 - share) * s))
    return [found[number] for number in range(len(requests))]


def _grow_together(growths: dict[int, _Growth], threads: int, tell: Callable[[float], None]) -> dict[int, Any]:
    """Drive growths of the same features as one batch each; what each returned or raised, by number."""
    groups: dict[Any, list[int]] = {}
    for number, growth in growths.items():
        key = batch_key(growth.model) if growth.model.device.is_cuda else number
        groups.setdefault(key, []).append(number)
    found: dict[int, Any] = {}
    done = dict.fromkeys(growths, 0.0)

    def told(number: int, share: float) -> None:
        done[number] = share
        tell(sum(done.values()) / len(done))

    for numbers in groups.values():
        members = [growths[number] for number in numbers]
        steppers = steppers_of([g.model for g in members], [g.state for g in members], threads=threads)
        courses = {}
        for number, growth, stepper in zip(numbers, members, steppers):
            stepper.change(local_damping=0.5, growth_rate=growth.rate, growth_end=1.0)
            courses[stepper.index] = (stepper, growth.course(stepper, lambda s, n=number: told(n, s)))
        results = drive(courses)
        found |= {number: results[stepper.index] for number, stepper in zip(numbers, steppers)}
        stop = next((r for r in results.values() if isinstance(r, KeyboardInterrupt)), None)
        if stop is not None:
            raise stop
    return found


class _Growth:
    """One packing under way."""

    def __init__(self, request: Request, container, fraction: float, random, device, precision: str) -> None:
        fill = request.fill
        self.fill, self.contact, self.container, self.fraction = fill, request.contact, container, fraction
        self.table = draw(fill, container, fraction, random)
        scene = Scene(
            name="packing",
            duration=0.0,
            fill=fill,
            walls=container.walls("wall"),
            contact=request.contact.frictionless(),
            gravity=(0.0, 0.0, 0.0),
        )
        self.model = build_model(scene, device, precision, growth=True)
        check_memory(self.model, self.table)
        self.state = State(self.model, self.table)
        start = min(1.0, (START_FRACTION / fraction) ** (1 / 3))
        self.state.scale.fill_(start)
        _resize(self.state, self.table, start)
        self.rate = (1.0 - start) / GROWTH_STEPS

    def course(self, stepper: Stepper, tell: Callable[[float], None]) -> Course:
        """Grow and come to rest; returns bodies and report."""
        try:
            yield from self._grow(stepper, tell)
        except InstabilityError as error:
            raise InstabilityError(f"packing to a solid fraction of {self.fraction:.3g} failed: {error}") from error
        return self._result(stepper)

    def _grow(self, stepper: Stepper, tell: Callable[[float], None]) -> Course:
        pressure, contact, chunk = self.fill.pressure, self.contact, 50
        for number in range(GROWTH_STEPS // chunk):
            stepper.choose_dt()
            yield from stepper.taking(chunk)
            tell(0.6 * (number + 1) * chunk / GROWTH_STEPS)
            # Sown aggregates that still overlap push for a while: only a pressure well above that counts.
            enough = max(pressure or 0.0, TRANSIENT * contact.stress_scale)
            if pressure is not None and number % 2 and self._pressure() > enough:
                break
        # Rest, and with a wanted pressure creep towards it from either side.
        steps, good, least, below = RELAX_STEPS, 0, 1e-3, None
        for number in range(steps // chunk):
            if pressure is not None:
                error = pressure - self._pressure()
                good = good + 1 if abs(error) < 0.03 * pressure else 0
                if good == 4:
                    break
                # dp/d(ln size) of a packing is about its contacts' modulus.
                change = np.clip(error / contact.stress_scale, -2e-3, 2e-3)
                if below is not None and below != (error > 0):
                    least *= 0.5
                below = bool(error > 0)
                if error > 0.5 * pressure:
                    change = max(change, least)  # not jammed: no pressure tells how far to go
                stepper.change(growth_rate=float(change) / chunk, growth_end=2.0)
            stepper.choose_dt()
            yield from stepper.taking(chunk)
            tell(0.6 + 0.4 * (number + 1) * chunk / steps)

    def _pressure(self) -> float:
        return contact_sums(self.model, self.state).virial / (3 * self.container.volume)

    def _result(self, stepper: Stepper) -> tuple[BodyTable, PackingReport]:
        state, pressure = self.state, self.fill.pressure
        stepper.stop_motion()
        factor = float(state.scale.numpy()[0])
        sums = contact_sums(self.model, state, coordination=True)
        result = state.table()
        # The grown sizes keep their density, not their mass.
        result.density = self.table.density.copy()
        result.velocity = np.zeros_like(result.velocity)
        result.spin = np.zeros_like(result.spin)
        reached = sums.virial / (3 * self.container.volume)
        if pressure is not None and self.container is self.fill.container:
            found = f"came to {reached:.3g} Pa with sizes changed by a factor of {factor:.3f}"
            if not 0.8 * pressure < reached < 1.2 * pressure or not 0.93 < factor < 1.07:
                refuse(
                    "packing pressure",
                    pressure,
                    f"cannot be met, the packing {found}",
                    f"choose a solid fraction, or a pressure between 0.001 and 0.1 of the contacts' modulus "
                    f"({self.contact.stress_scale:g} Pa)",
                )
        report = PackingReport(
            bodies=len(result),
            spheres=state.sphere_count,
            solid_fraction=float(result.volume.sum() / self.container.volume),
            coordination_number=sums.coordination_number,
            mean_overlap=sums.mean_overlap,
            largest_overlap=sums.largest_overlap,
            pressure=reached,
            size_factor=factor,
        )
        return result, report


def _resize(state: State, table: BodyTable, factor: float) -> None:
    """Shrink spheres about their bodies' centroids."""
    position = state.sphere_position.numpy().astype(float)
    centre = table.position[state.sphere_body.numpy()]
    position[:, :3] = centre + factor * (position[:, :3] - centre)
    position[:, 3] *= factor
    state.sphere_position.assign(position.astype(state.sphere_position.numpy().dtype))
