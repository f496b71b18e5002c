"""Packing: fill a pipe or any closed mesh with aggregates by growing them in place.

Small aggregates are placed at a low solid fraction and grow at a constant rate, without friction and with damping, as
in the method of Lubachevsky and Stillinger (J. Stat. Phys. 60 (1990) 561). They then come to rest. The user states
either a solid fraction, at which the growth ends, or a pressure. With a pressure, the sizes are adjusted until the
contact forces cause this pressure.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..core.device.device import find_device, parallel
from ..core.errors import CapacityError, InstabilityError, WarpcreteError, refuse
from ..core.run.coroutines import Coroutine
from ..geometry.rotation import random_orientations
from .engine.batch import batch_key
from .engine.memory import check_memory
from .engine.model import build_model
from .engine.scheduling import drive
from .engine.state import State
from .engine.stepper import Stepper, steppers_of
from .engine.stepper_protocol import Steps
from .laws import Contact, ContactLaw
from .measure.probes import contact_sums
from .scene.bodies import BodyTable
from .scene.containers import Fill, MeshContainer, PipeContainer
from .scene.scene import Scene

START_FRACTION = 0.10  # Solid fraction at which small aggregates are placed before they grow.
GROWTH_STEPS = 1500
RELAX_STEPS = 3000
CHUNK = 50  # Number of time steps between two evaluations of the pressure of a packing.
# Pressure of freshly placed aggregates, divided by the contact modulus. They overlap at first, and this pressure
# vanishes once they have pushed each other apart. The growth may therefore end only at a higher pressure.
TRANSIENT_LOOKS = 0.005
CLOSE_FRACTION = 0.75  # Solid fraction that no packing of aggregates reaches at pressures of kilopascals.

# If the pressure is too high, or too low, at this many consecutive evaluations, the sizes are changed faster.
LOOKS_BEFORE_GAIN = 45
MOST_GAIN = 16.0  # Largest factor by which the adjustment of sizes is sped up.

# Relative error of the pressure below which the relaxation of a packing ends after RELAX_STEPS steps. With a larger
# error the relaxation may take twice as many steps.
NEAR_TARGET = 0.15
MOST_BODIES = 2**25  # Maximum number of bodies, chosen so that their arrays fit the largest GPUs.


@dataclass(frozen=True)
class PackingReport:
    """Properties of a finished packing."""

    bodies: int
    spheres: int
    solid_fraction: float
    """Solid volume divided by the volume of the container; overlaps inside a clump count once."""
    coordination_number: float
    """Mean number of touching neighbours per body; walls do not count."""
    mean_overlap: float
    """Mean overlap of touching spheres; each overlap is divided by the radius of the smaller sphere."""
    largest_overlap: float
    pressure: float
    """Mean pressure from the contact forces between bodies [Pa]; contacts with the container's walls do not count."""
    size_factor: float
    """Factor by which all sizes were multiplied to reach a given pressure; 1 if a solid fraction was given instead."""


def draw(
    fill: Fill, container: PipeContainer | MeshContainer, fraction: float, random: np.random.Generator
) -> BodyTable:
    """Return aggregates at evenly spread points, with a total volume of `fraction` times the container's volume.

    `fill` describes sizes, shapes and density of the aggregates. Raises :class:`CapacityError` if the container would
    contain too many aggregates.
    """
    wanted = fraction * container.volume
    expected = wanted / (np.pi / 6 * float(np.mean(fill.sizes.sample(1000, np.random.default_rng(0)) ** 3)))
    if expected > MOST_BODIES:
        raise CapacityError(
            f"packing: {container.volume:.3g} m3 would need {expected:.2g} aggregates, more than {MOST_BODIES:.2g}; "
            "choose a smaller container or larger aggregates"
        )
    sizes = np.empty(0)
    while np.pi / 6 * np.sum(sizes**3) < wanted:
        sizes = np.concatenate([sizes, fill.sizes.sample(max(16, len(sizes)), random)])
    total = np.cumsum(np.pi / 6 * sizes**3)
    count = int(np.searchsorted(total, wanted)) + 1
    if count > 1 and abs(total[count - 2] - wanted) < abs(total[count - 1] - wanted):
        count -= 1  # Leave out the last aggregate if the total volume is then closer to the wanted volume.
    sizes = sizes[:count]
    # Shapes are drawn independently of sizes, so on average a shape's fraction by number equals its fraction by volume.
    template = random.choice(len(fill.templates), size=count, p=fill.fractions)
    points = container.sample(count, random)[random.permutation(count)]
    zero = np.zeros((count, 3))
    return BodyTable(
        points, random_orientations(count, random), zero, zero, sizes, template, np.full(count, fill.density),
        [fill.material] * count, [""] * count, fill.templates,
    )  # fmt: skip


@dataclass(frozen=True)
class Request:
    """Input of one packing by :func:`pack_many`.

    `fill` describes the container and the aggregates, and `seed` is the seed of random numbers. The aggregates have the
    stiffness of the law `contact`, but no friction, because they follow the law :meth:`ContactLaw.frictionless`.
    """

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
    """Pack aggregates into their container: place them small, let them grow without friction and come to rest.

    Returns the bodies at rest and a report. `progress` is called with the completed fraction of the work.

    If `fill` has a pressure instead of a solid fraction, a trial packing in a smaller container first finds the solid
    fraction at this pressure. The real packing starts with aggregates for about this solid fraction, and their sizes
    are adjusted until the pressure is met. The report's `size_factor`, which is close to 1, says how much the sizes
    changed.
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
    """Pack many containers independently of each other, on a GPU in common batches.

    Returns one result for each of the `requests`: (bodies, report) as from :func:`pack`, or the error that the packing
    raised. `progress` is called with the completed fraction of the work.
    """
    device = find_device(device) if device is None or isinstance(device, str) else device
    tell = progress or (lambda done: None)
    randoms = [np.random.default_rng([request.seed, 1]) for request in requests]
    pilots: dict[int, Any] = {}
    parts = []
    for number, request in enumerate(requests):
        fill = request.fill
        if fill.pressure is not None:
            pilot = fill.container.pilot()
            pilot = replace(pilot) if pilot is fill.container else pilot
            parts.append(pilot.volume / (pilot.volume + fill.container.volume))
            pilots[number] = (pilot, CLOSE_FRACTION)
    # The display of progress needs the fraction of the total work that the trial packings take.
    part = float(np.mean(parts)) if parts else 0.0

    def grow_all(containers: dict[int, Any], report_fraction: Callable[[float], None]) -> dict[int, Any]:
        outcomes: dict[int, Any] = {}
        growths: dict[int, _Growth] = {}
        for number, (container, fraction) in containers.items():
            request = requests[number]
            try:
                growths[number] = _Growth(request, container, fraction, randoms[number], device, precision)
            except WarpcreteError as error:
                outcomes[number] = error
        return outcomes | _grow_together(growths, threads, report_fraction)

    measured = grow_all(pilots, lambda done: tell(part * done)) if pilots else {}
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
    found = failed | grow_all(wanted, lambda done: tell(part + (1 - part) * done))
    return [found[number] for number in range(len(requests))]


def _grow_together(growths: dict[int, _Growth], threads: int, tell: Callable[[float], None]) -> dict[int, Any]:
    """Run packings; return the result of each packing, or the error that it raised, by its key in `growths`.

    On a GPU, packings with the same features run as one batch.
    """
    groups: dict[Any, list[int]] = {}
    for number, growth in growths.items():
        key = batch_key(growth.model) if parallel(growth.model.device) else number
        groups.setdefault(key, []).append(number)
    packings: dict[int, Any] = {}
    done = dict.fromkeys(growths, 0.0)

    def report_fraction(number: int, fraction: float) -> None:
        done[number] = fraction
        tell(sum(done.values()) / len(done))

    for numbers in groups.values():
        members = [growths[number] for number in numbers]
        steppers = steppers_of([g.model for g in members], [g.state for g in members], threads=threads)
        scenes = {}
        for number, growth, stepper in zip(numbers, members, steppers):
            stepper.change(local_damping=0.5, growth_rate=growth.rate, growth_end=1.0)
            scenes[number] = (stepper, growth.growing(stepper, lambda done, n=number: report_fraction(n, done)))
        results = drive(scenes)
        packings |= results
        stop = next((r for r in results.values() if isinstance(r, KeyboardInterrupt)), None)
        if stop is not None:
            raise stop
    return packings


class _Growth:
    """One packing in progress: state, model and rate of growth of its aggregates."""

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
        self.state.scenes.scale.fill_(start)
        _resize(self.state, self.table, start)
        self.rate = (1.0 - start) / GROWTH_STEPS

    def growing(self, stepper: Stepper, tell: Callable[[float], None]) -> Coroutine:
        """Return a coroutine that grows the aggregates, lets them come to rest, and returns bodies and report.

        The coroutine calls `tell` with the completed fraction of the work.
        """
        try:
            yield from self._grow(stepper, lambda done: tell(0.6 * done))
            yield from self._rest(stepper, lambda done: tell(0.6 + 0.4 * done))
        except InstabilityError as error:
            most = f"to a solid fraction of {self.fraction:.3g}"
            # In a packing to a given pressure, the bodies usually stop growing before they reach the solid fraction
            # `fraction`, so the message calls it a maximum.
            goal = (
                f"{most} failed"
                if self.fill.pressure is None
                else (f"to a pressure of {self.fill.pressure:.3g} Pa failed while the bodies grew, at most {most}")
            )
            raise InstabilityError(
                f"packing {goal}: {error.what}", time=error.time, body=error.body, cure=error.cure
            ) from error
        return self._result(stepper)

    def _grow(self, stepper: Stepper, tell: Callable[[float], None]) -> Coroutine:
        pressure = self.fill.pressure
        # Freshly placed aggregates overlap and push each other apart, which causes a pressure for a short time. The
        # growth may end early only if the pressure is higher than this transient pressure.
        resting = max(pressure or 0.0, TRANSIENT_LOOKS * self.contact.stress_scale)
        for number in range(GROWTH_STEPS // CHUNK):
            stepper.choose_dt()
            yield Steps(CHUNK)
            tell((number + 1) * CHUNK / GROWTH_STEPS)
            if pressure is not None and number % 2 and self._pressure() > resting:
                break

    def _rest(self, stepper: Stepper, tell: Callable[[float], None]) -> Coroutine:
        """Let the aggregates come to rest; if `fill` states a pressure, adjust sizes until the packing has it."""
        pressure = self.fill.pressure
        looks_on_target, least, was_too_low = 0, 1e-3, None
        # Number of consecutive evaluations at which the pressure was off target in the same direction.
        gain, looks_off_target = 1.0, 0
        looks = RELAX_STEPS // CHUNK
        for number in range(looks if pressure is None else 2 * looks):
            if pressure is not None:
                error = pressure - self._pressure()
                if number >= looks and abs(error) < NEAR_TARGET * pressure:
                    break
                looks_on_target = looks_on_target + 1 if abs(error) < 0.03 * pressure else 0
                if looks_on_target == 4:
                    break
                if looks_on_target:
                    gain, looks_off_target = 1.0, 0
                if was_too_low is not None and was_too_low != (error > 0):
                    least, gain, looks_off_target = 0.5 * least, max(1.0, 0.5 * gain), 0
                elif abs(error) > 0.03 * pressure:
                    looks_off_target += 1
                    if looks_off_target > LOOKS_BEFORE_GAIN and looks_off_target % 3 == 0:
                        gain = min(MOST_GAIN, 1.5 * gain)
                was_too_low = bool(error > 0)
                # In a jammed packing, a change of ln(size) changes the pressure by about the contact modulus times this
                # change. Dividing the pressure error by the modulus therefore gives the change of ln(size) that
                # corrects the pressure. In a barely jammed packing the pressure reacts far less, because growing
                # aggregates move into free space. The factor `gain` compensates for this.
                change = np.clip(gain * error / self.contact.stress_scale, -2e-3 * gain, 2e-3 * gain)
                if error > 0.5 * pressure:
                    # Increase ln(size) by at least `least`. In a packing that is not jammed yet, the pressure does not
                    # show how much the aggregates must still grow.
                    change = max(change, least)
                stepper.change(growth_rate=float(change) / CHUNK, growth_end=2.0)
            stepper.choose_dt()
            yield Steps(CHUNK)
            tell(min(1.0, (number + 1) / looks))

    def _pressure(self) -> float:
        return contact_sums(self.model, self.state).virial / (3 * self.container.volume)

    def _result(self, stepper: Stepper) -> tuple[BodyTable, PackingReport]:
        state, pressure = self.state, self.fill.pressure
        stepper.stop_motion()
        factor = float(state.scenes.scale.numpy()[0])
        sums = contact_sums(self.model, state, coordination=True)
        result = state.table()
        # The sizes of the bodies changed at constant mass, so their density is wrong. Restore the given density.
        result.density = self.table.density.copy()
        if self.fill.bulk_density is not None:
            result.density[:] = self.fill.bulk_density * self.container.volume / result.volume.sum()
        result.velocity = np.zeros_like(result.velocity)
        result.spin = np.zeros_like(result.spin)
        reached = sums.virial / (3 * self.container.volume)
        if pressure is not None and self.container is self.fill.container:
            problem = f"reached {reached:.3g} Pa after all sizes were multiplied by {factor:.3f}"
            if not 0.8 * pressure < reached < 1.2 * pressure or not 0.93 < factor < 1.07:
                refuse(
                    "packing pressure",
                    pressure,
                    f"cannot be met: the packing {problem}",
                    "give a solid fraction instead, or a pressure of 0.001 to 0.1 times the contacts' modulus "
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
    """Multiply the radii of all spheres, and their distances from the centroid of their body, by `factor`."""
    spheres = state.spheres
    position = spheres.position.numpy().astype(float)
    centre = table.position[spheres.body.numpy()]
    position[:, :3] = centre + factor * (position[:, :3] - centre)
    position[:, 3] *= factor
    spheres.position.assign(position.astype(spheres.position.numpy().dtype))
