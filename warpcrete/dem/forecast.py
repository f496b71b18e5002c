"""Forecast of the time and memory that a run of discrete elements needs, measured on a cheap copy of the scene.

The copy has the same contact laws, bonds and walls as the scene, but its concrete is prepared in a cheaper way: a short
piece of the pipe is packed and repeated along the pipe. The stable time step of the copy is estimated as in a run. Its
time steps, neighbour list rebuilds and samples are timed. Constants from earlier runs supply what the copy cannot show,
such as the duration of settling.
"""

import dataclasses
import math
import time
from dataclasses import replace

import numpy as np
import warp as wp

from ..core.device.device import checked_threads, parallel
from ..core.device.footprint import footprint
from ..core.device.kernel_files import run_clock
from ..core.records import SceneArguments
from ..core.run.coroutines import run_coroutine
from ..core.run.forecast import Forecast, Probe, median_time
from ..geometry.axis import Axis
from ..geometry.walls import Prescribed
from ..kernels.dem.subcycling import SUBCYCLED_STEP_FRACTION
from .engine.bonding import bond_kinds
from .engine.state_data import restore_state, state_dict
from .engine.stepper import Stepper
from .laws import ContactLaw
from .packing import PackingReport, pack
from .scene.bodies import BodyTable, placed_bodies
from .scene.containers import PipeContainer
from .scene.scene import Scene
from .simulation import SETTLING_PARTS, ElementSimulation

# Minimum fraction of the measured wall time that is attributed to steps. It applies if the estimated time of list
# rebuilds would leave less than this fraction for the steps.
LEAST = 0.1
TIMING_TIME = 0.7  # Minimum wall time for which the steps are timed [s].
# Maximum number of spheres in the copy of the scene that the forecast times. The key is True for a GPU and False for a
# CPU. With more spheres, the time per sphere is constant.
MAXIMUM_SPHERES = {True: 400_000, False: 40_000}
# Distance that concrete moves between two rebuilds of the neighbour lists, divided by the lists' skin (the largest gap
# of a listed pair). In a straight pipe (STRAIGHT), concrete moves like a rigid body. In a bend (BENT), neighbours move
# relative to each other, so the lists become stale earlier.
STRAIGHT, BENT = 1.25, 0.5
# Number of bonds in a settled packing divided by the number in an unsettled packing. In test runs this ratio was 1.2 to
# 1.3.
BONDS_AFTER_SETTLING = 1.2
SETTLING_BUILDS = 1 / 40  # Number of neighbour list rebuilds per step while a packing settles.
# The settling of a packing is assumed to take the constant time SETTLING_OFFSET [s], plus the time in which a pressure
# wave travels PASSAGES times through the length of the concrete.
PASSAGES, SETTLING_OFFSET = 2.4, 0.19
IDLE_SPHERES = 40_000  # Number of spheres at which a GPU's step takes about twice as long as a step without spheres.


def forecast(scene: Scene, device: wp.Device, precision: str, threads: int | None, probe: Probe) -> Forecast:
    """Forecast the steps, wall time and memory of a run on a Warp `device`.

    `probe` is a function that measures how long one frame of a recording takes to write. Raises the errors that the run
    itself would raise before its first step.
    """
    ready = _ShortenedCopy(scene, device, precision, threads)
    dt, factor = ready.stepper.dt, ready.factor
    limits, governing = ready.limits()
    frames = probe(ready.simulation)
    # Time the steps a second time and use the shorter time: other programs may have slowed down one of the
    # measurements, but they rarely slow down all of a long run.
    build, sample, step = ready.build, ready.sample, min(ready.step, ready.step_time())
    steps = scene.duration / dt
    parts: dict[str, float] = {}
    if scene.fill is not None:
        parts["packing"] = ready.packing
    if scene.settle is not None and scene.settle.duration > 0:
        time_settling = _settling_time(scene)
        looks = math.ceil(SETTLING_PARTS * time_settling / scene.settle.duration)
        count = time_settling / (dt / SUBCYCLED_STEP_FRACTION if ready.stepper.batch.subcycles.rounds else dt)
        parts["settling"] = (count * (ready.settling_step() + SETTLING_BUILDS * build) + looks * sample) * factor
    builds = ready.builds(steps)
    parts["steps"] = steps * step * factor
    parts["list builds"] = builds * build * factor
    samples = max(1, math.ceil(scene.duration / scene.sample_interval))
    parts["samples"] = samples * sample * factor
    return Forecast(
        method="discrete elements",
        device="",
        counts={"bodies": round(ready.bodies * factor), "spheres": round(ready.spheres * factor),
                "contacts": round(ready.contacts * factor)},
        features=_features(ready.simulation),
        memory={name: size * factor for name, size in ready.memory.items()},
        time_step=dt,
        limits=limits,
        governing=governing,
        steps=steps,
        parts=parts,
        frame={name: spent * factor for name, spent in frames.items()},
        duration=scene.duration,
        remarks=(*scene.remarks, *ready.remarks),
    )  # fmt: skip


def _settling_time(scene: Scene) -> float:
    """Return the expected simulated time in which the packing settles [s].

    The formula was fitted to runs with the pipes of Zhan (2019).
    """
    assert scene.settle is not None
    if scene.pipe is None or scene.fill is None:
        return scene.settle.duration
    speed = math.sqrt(scene.contact.stress_scale / (0.6 * scene.fill.density))
    return min(scene.settle.duration, SETTLING_OFFSET + PASSAGES * scene.pipe.concrete_length / speed)


class _ShortenedCopy:
    """Copy of a scene on which the forecast measures wall times.

    The copy starts at t = 0 without settling, so its bodies are not at rest. If the pipe is very long, the copy has a
    shorter pipe.
    """

    def __init__(self, scene: Scene, device: wp.Device, precision: str, threads: int | None) -> None:
        self.scene, self.device = scene, device
        self.factor = 1.0
        self.packing = 0.0
        self.remarks: list[str] = []
        container = scene.fill.container if scene.fill is not None else None
        if isinstance(container, PipeContainer) and container.bore is not None:
            self.remarks.append(
                "the forecast assumes that the whole part is as wide as its start: numbers of aggregates and times are "
                "too large if the part narrows, and too small if it widens"
            )
        packed = self._packed(precision, threads) if scene.fill is not None else None
        simulation = ElementSimulation(
            replace(scene, settle=None), device=str(device), precision=precision, threads=threads
        )
        simulation.place(packed, 0.0)
        simulation.join(Stepper(simulation.model, simulation.state, scene.time_step, threads=simulation.threads))
        run_coroutine(simulation.preparing(), simulation.stepper.advance)
        self.simulation, self.stepper = simulation, simulation.stepper
        self.bodies, self.spheres = simulation.state.body_count, simulation.state.sphere_count
        self._time()

    def _packed(self, precision: str, threads: int | None) -> tuple[BodyTable, PackingReport]:
        fill = self.scene.fill
        assert fill is not None
        container, pilot = fill.container, fill.container.pilot()
        marks: list[float] = []
        table, report = pack(
            replace(fill, container=pilot), contact=self.scene.contact, seed=self.scene.seed, device=self.device,
            precision=precision, threads=checked_threads(threads),
            progress=lambda done: marks.append(run_clock()),
        )  # fmt: skip
        packing_time = marks[-1] - marks[0] if marks else 0.0
        if fill.pressure is not None and pilot is not container:
            # A packing to a given pressure consists of two packings: a trial packing, then the real packing.
            packing_time /= 2
        if not isinstance(container, PipeContainer) or not isinstance(pilot, PipeContainer):
            self.packing = packing_time * (2 if fill.pressure is not None else 1)
            return table, report
        whole = container.length / pilot.length
        most = MAXIMUM_SPHERES[parallel(self.device)]
        spheres = float(table.sphere_counts.sum())
        kept = min(whole, max(most / spheres, 1.0))
        placed = float(placed_bodies(self.scene).sphere_counts.sum())
        self.factor = (whole * spheres + placed) / (kept * spheres + placed)
        if parallel(self.device):
            long = packing_time * (IDLE_SPHERES + whole * spheres) / (IDLE_SPHERES + spheres)
        else:
            long = packing_time * whole
        self.packing = long + (packing_time if fill.pressure is not None else 0.0)
        return tiled(table, container.axis, pilot.length, kept * pilot.length), report

    def _time(self) -> None:
        """Measure the wall times [s] of a step, a neighbour list rebuild and a row, and the memory used [B].

        A row is one row of the time series.
        """
        simulation, stepper = self.simulation, self.stepper
        if self.spheres == 0:
            self.step = self.build = self.sample = 0.0
            self.contacts, self.memory = 0, {}
            self._built = 0.0
            return
        stepper.advance(stepper.time + 2 * stepper.dt)
        batch = stepper.batch
        self.build = median_time(batch.rebuild if batch.planner.rebuilds_on_device else stepper.rebuild, self.device)
        self.sample = median_time(simulation.measure, self.device)
        begun_builds, first = int(stepper.lists.builds[stepper.index]), stepper.steps
        self.step = self.step_time()
        self._built = (int(stepper.lists.builds[stepper.index]) - begun_builds) / max(stepper.steps - first, 1)
        self.contacts = round(simulation.rows[-1].get("contacts", 0.0))
        self.memory = _memory(simulation)
        if self.scene.settle and self.scene.bonds and not simulation.model.features.healing:
            load = simulation.state.pairs.load
            self.memory["contacts"] += (BONDS_AFTER_SETTLING - 1) * load.size * wp.types.type_size_in_bytes(load.dtype)

    def step_time(self) -> float:
        """Measure the wall time of one time step, without the time of neighbour list rebuilds [s]."""
        stepper = self.stepper
        if self.spheres == 0:
            return 0.0
        count, spent = 32, 0.0
        # Do not time the first steps, because they record graphs of kernel launches.
        stepper.advance(stepper.time + count * stepper.dt)
        rates = []
        while spent < TIMING_TIME:
            wp.synchronize_device(self.device)
            begun, before, built = time.perf_counter(), stepper.steps, int(stepper.lists.builds[stepper.index])
            stepper.advance(stepper.time + count * stepper.dt)
            wp.synchronize_device(self.device)
            took = time.perf_counter() - begun
            built = int(stepper.lists.builds[stepper.index]) - built
            # The measured time includes list rebuilds, so subtract their time. The time of a rebuild may have been
            # measured too long, because other programs slowed it down. Make sure that a step still gets a positive
            # time.
            rates.append(max(took - built * self.build, LEAST * took) / max(stepper.steps - before, 1))
            spent += took
            count = min(2 * count, 128)
        return float(np.quantile(rates, 0.25))

    def settling_step(self) -> float:
        """Measure the wall time of one time step without sub-cycled hydrated bonds, as during settling [s].

        The measurement switches sub-cycling off in the timed copy of the scene, so call this method last.
        """
        if not self.stepper.batch.subcycles.rounds:
            return self.step
        self.stepper.batch.subcycles.set_rounds(self.stepper.index, 0)
        return self.step_time()

    def builds(self, steps: float) -> float:
        """Return the expected number of neighbour list rebuilds in a run of `steps` steps."""
        pipe, skin = self.scene.pipe, self.stepper.skin
        if pipe is None:
            return self._built * steps
        straight = len(pipe.axis.pieces) == 1 and not hasattr(pipe.axis.pieces[0], "angle")
        return pipe.travel / ((STRAIGHT if straight else BENT) * skin)

    def limits(self) -> tuple[dict[str, float], str]:
        """Return stable time steps [s] by name, and a text that says what limits the time step.

        Each stable step is estimated with only some of the forces: contacts without bonds, contacts with one kind of
        bond, contacts without dashpots, sub-cycled bonds, or all forces together.
        """
        simulation, stepper, scene = self.simulation, self.stepper, self.scene
        fixed = scene.time_step.fixed
        safety = scene.time_step.safety
        if self.spheres == 0:
            return {"no bodies": stepper.dt}, "limited only by the largest allowed step"
        stable_steps: dict[str, float] = {}
        held = simulation.state.pairs.bond.numpy().copy() if simulation.model.features.bonds else None
        kinds = None if held is None else bond_kinds(held)

        def estimate() -> float:
            return safety * stepper.estimate()

        names = [*(["bonds"] if scene.bonds else []), *(["hydrated bonds"] if scene.hydration else []),
                 *(f"bonds of {group}" for group in scene.group_bonds)]  # fmt: skip
        if held is not None:
            simulation.state.pairs.bond.assign(np.zeros_like(held))
        subcycles = stepper.batch.subcycles
        rounds = subcycles.rounds
        if rounds:
            stable_steps["hydrated bonds, a round"] = safety * subcycles.stable_step(stepper.index)
            # Switch sub-cycling off, because the limits that are estimated next apply to steps without sub-cycling.
            subcycles.set_rounds(stepper.index, 0)
        try:
            stable_steps["contacts"] = estimate()
            for number, name in enumerate(names, 1):
                assert held is not None and kinds is not None
                if rounds and name == "hydrated bonds":
                    continue
                only = held.copy()
                # A scene with hydrated bonds also has bonds that did not hydrate, so estimate both together.
                if name == "hydrated bonds":
                    only[~np.isin(kinds, (number - 1, number))] = 0
                else:
                    only[kinds != number] = 0
                simulation.state.pairs.bond.assign(only)
                stable_steps[f"contacts and {name}"] = estimate()
        finally:
            if held is not None:
                simulation.state.pairs.bond.assign(held)
            if rounds:
                subcycles.set_rounds(stepper.index, rounds)
        if self._springs_differ:
            stable_steps["contacts without dashpots"] = min(safety * self._undamped(), scene.time_step.largest)
        whole = estimate()
        if whole > scene.time_step.largest:
            stable_steps["largest allowed"] = scene.time_step.largest
            return {**stable_steps, "all together": scene.time_step.largest}, (
                "the largest allowed time step (TimeStep.largest)"
            )
        if fixed is not None:
            return {**stable_steps, "all together": whole}, f"the given time_step = {fixed:g} s"
        alone = stable_steps["contacts"]
        bonded = {name: dt for name, dt in stable_steps.items() if name.startswith("contacts and ")}
        words = []
        if bonded and min(bonded.values()) < 0.9 * alone:
            name = min(bonded, key=bonded.__getitem__)
            times = alone / bonded[name]
            words.append(
                f"{name.removeprefix('contacts and ')}, which shorten the step to 1/{times:.3g} of that with "
                f"contacts alone, so {100 * (1 - 1 / times):.0f} % of the steps are due to them"
            )
        else:
            words.append("contacts")
            undamped = stable_steps.get("contacts without dashpots", alone)
            if undamped > 1.1 * alone:
                share = 100 * (1 - alone / undamped)
                words.append(f"their dashpots shorten the step by {share:.0f} % compared with springs alone")
        if rounds:
            words.append(f"hydrated bonds are integrated in {rounds} rounds per step, which halves the step")
        words.append(self._smallest())
        return {**stable_steps, "all together": whole}, "; ".join(words)

    @property
    def _springs_differ(self) -> bool:
        """True if the forecast can also estimate a stable step without dashpots.

        For this estimate, it is necessary that at least one contact law has dashpots and that all laws are dataclasses,
        because only dataclasses can be copied with damping ratios of 0.
        """
        laws = (self.scene.contact, *self.scene.contacts.values())
        return all(dataclasses.is_dataclass(law) for law in laws) and any(_springs(law) != law for law in laws)

    def _undamped(self) -> float:
        """Return the stable step of the contacts' springs alone, without dashpots and bonds [s]."""
        scene = replace(
            self.simulation.scene,
            contact=_springs(self.scene.contact),
            contacts={pair: _springs(law) for pair, law in self.scene.contacts.items()},
        )
        one = self.simulation
        other = ElementSimulation(scene, device=str(self.device), precision=one.precision, threads=one.threads)
        other.state = restore_state(other.model, state_dict(one.state))
        if other.model.features.bonds:
            other.state.pairs.bond.zero_()
        stepper = Stepper(
            other.model, other.state, scene.time_step, threads=one.threads, resumed=self.stepper.state_dict()
        )
        return stepper.estimate()

    def _smallest(self) -> str:
        """Return a text on the size of the lightest bodies, which oscillate fastest and so limit the time step."""
        spheres = self.simulation.state.spheres.position.numpy()[:, 3]
        table = self.simulation.state.table()
        least = int(np.argmin(table.mass))
        group = f" of {table.group[least]}" if table.group[least] else ""
        return (
            f"the lightest bodies limit the step; their size is {1e3 * table.size[least]:.3g} mm{group} "
            f"(spheres of {2e3 * spheres.min():.3g} mm or more)"
        )


def tiled(table: BodyTable, axis: Axis, period: float, length: float) -> BodyTable:
    """Return bodies for a long pipe, made by repeating the bodies of `table` along the pipe's `axis`.

    The bodies of `table` fill the first `period` [m] of the axis. Their copies fill the pipe up to the arc length
    `length` [m].
    """
    # Copies of a body keep the body's offset from the axis in the axis' local frame (tangent, normal, binormal), so
    # that the copied packing follows bends.
    grid = np.linspace(-0.1 * period, 1.1 * period, 4000)
    points, tangents, normal, side = axis.frame(grid)
    place = np.array([np.argmin(np.sum((points - p) ** 2, axis=1)) for p in table.position])
    offset = table.position - points[place]
    local = [np.sum(offset * each[place], axis=1) for each in (tangents, normal, side)]
    rows, positions = [], []
    for k in range(math.ceil(length / period - 1e-9)):
        s = grid[place] + k * period
        here = np.flatnonzero(s <= length)
        p, t, a, b = axis.frame(s[here])
        positions.append(p + local[0][here, None] * t + local[1][here, None] * a + local[2][here, None] * b)
        rows.append(here)
    row = np.concatenate(rows)
    per_row = {
        name: getattr(table, name)[row] for name in ("orientation", "velocity", "spin", "size", "template", "density")
    }
    return BodyTable(
        position=np.concatenate(positions), material=[table.material[k] for k in row],
        group=[table.group[k] for k in row], templates=table.templates, **per_row,
    )  # fmt: skip


def _springs(law: ContactLaw) -> ContactLaw:
    """Return a copy of a contact law without dashpots: all damping ratios are 0."""
    changes: SceneArguments = {}
    for each in dataclasses.fields(law):  # type: ignore[arg-type]
        value = getattr(law, each.name)
        if each.name.endswith("damping_ratio"):
            changes[each.name] = 0.0
        elif isinstance(value, ContactLaw):
            changes[each.name] = _springs(value)
    return replace(law, **changes)


def _memory(simulation: ElementSimulation) -> dict[str, float]:
    """Return the device memory used by each part of a simulation [B]."""
    state, stepper = simulation.state, simulation.stepper
    roots = {
        "bodies": state.bodies, "spheres": state.spheres, "walls": (state.slots, state.walls, simulation.model),
        "contacts": state.pairs, "rest of the state": state, "neighbour lists": stepper.lists, "rest": simulation,
    }  # fmt: skip
    return {name: float(size) for name, size in footprint(**roots).items() if size}


def _features(simulation: ElementSimulation) -> dict[str, str]:
    """Return, for each optional feature of the kernels, why the scene needs it, or "left out" otherwise."""
    f, scene = simulation.model.features, simulation.scene
    bonds = [name for name, there in (("bonds between aggregates", scene.bonds), ("hydrated bonds", scene.hydration))
             if there] + [f"bonds of {group}" for group in scene.group_bonds]  # fmt: skip
    turns = "clumps" if f.clumps else "bonds" if f.bonds else "friction or shear dashpots"
    moving = [wall.name for wall in scene.walls if isinstance(wall.motion, Prescribed)]
    kinds = [("planes and pipes" if f.analytic else ""), ("meshes" if f.meshes else "")]
    present = {
        "law between bodies": f.pair_law.__name__,
        "law with walls": f.wall_law.__name__ if f.walls else "",
        "shear history": "friction between bodies" if f.history else "",
        "rotation": turns if f.rotation else "",
        "clumps": "bodies of several spheres" if f.clumps else "",
        "bonds": ", ".join(bonds) if f.bonds else "",
        "healing": "new contacts bond" if f.healing else "",
        "drives": f"forces on {', '.join(drive.group for drive in scene.drives)}" if f.drives else "",
        "walls": " and ".join(kind for kind in kinds if kind) + (f"; {', '.join(moving)} moves" if moving else ""),
        "stops": ", ".join(
            w.name for w in scene.walls if isinstance(w.motion, Prescribed) and w.motion.stops is not None
        ),
        "structure": "the yield stress of a layer grows at rest" if f.structure else "",
        "energy balance": "requested" if f.dissipation else "",
        "wear of walls": "requested" if f.wear else "",
        "precision": simulation.precision,
        "half lists": f"each pair is stored once, {simulation.threads} threads" if f.half_list else "",
    }
    return {name: why or "left out" for name, why in present.items()}
