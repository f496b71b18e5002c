"""Discrete element simulation from scene to finished run, on top of the run loop of `core`."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING

from ..core.device.kernel_files import run_clock
from ..core.records import Record, SavedState
from ..core.run.coroutines import Coroutine, Until, run_coroutine
from ..core.run.method import results_of
from ..core.run.provenance import provenance
from ..core.run.run import Run
from ..core.run.run_loop import Simulation
from ..core.run.tables import Table
from ..core.units import quantity
from .engine.bonding import bond_kinds
from .engine.memory import check_memory, memory_of_batch
from .engine.model import build_model
from .engine.state import State
from .engine.state_data import restore_state, state_dict, state_hash
from .engine.stepper import Stepper
from .measure.blockage import BlockageWatch
from .measure.display import ElementDisplay
from .measure.probes import body_sums, contact_sums
from .measure.quantities import Known, quantities
from .measure.sampling import STORED, Sampler, unit_of
from .measure.stations import UNITS as STATION_UNITS
from .measure.vessel_measures import at_rest, is_over
from .measure.watch import Watch
from .measure.wear import WearMap
from .packing import PackingReport, pack
from .scene.bodies import BodyTable, placed_bodies
from .scene.checks import warn_of_coarse_step
from .scene.scene import Scene
from .scene.strokes import stroke_table

QUIET = 1e-5  # Ratio of kinetic to elastic energy below which a packing counts as settled before t = 0.
SETTLING_PARTS = 50  # Number of intervals into which settling is divided; after each, the motion is checked.


@dataclass(repr=False)
class ElementRun(Run):
    """Finished or interrupted discrete element run: series, results and final bodies."""

    packing: PackingReport | None = None
    bodies: BodyTable = field(default_factory=BodyTable.empty)
    """Bodies at the end of the run."""
    wear: WearMap | None = None
    """Wear of the walls; None if the scene does not request it."""


class ElementSimulation(Simulation):
    """Discrete element simulation; :class:`warpcrete.Simulation` explains the parameters and errors."""

    scene_type = Scene
    scene: Scene
    stepper: Stepper

    if TYPE_CHECKING:

        def run(self) -> ElementRun: ...

    def set_up(self) -> None:
        """Build the model, and set the attributes that change before t = 0 to their initial values."""
        self.model = build_model(self.scene, self.device, self.precision)
        self.packing: PackingReport | None = None
        # Number of completed intervals of the settling before t = 0. It is None before the settling begins and after it
        # ends.
        self._settled: int | None = None
        self.rested: float | None = None
        """Travel of the piston [m] at the moment of the concrete's rest (see `Scene.rest`); None before this moment."""

    @property
    def prepared(self) -> bool:
        return hasattr(self, "state")

    @property
    def rows(self) -> list[dict[str, float]]:
        return self.sampler.rows

    def unit(self, column: str) -> str:
        return unit_of(column, self.model.walls)

    def display(self, colouring: str | None = None) -> ElementDisplay:
        return ElementDisplay(self, colouring)

    def prepare(self) -> None:
        """Prepare the state at t = 0: pack, place bodies, bond body groups, settle, and bond contacts."""
        scene = self.scene
        started = run_clock()
        self.tell("packing", 0.0)
        packed = None
        if scene.fill is not None:
            packed = pack(
                scene.fill,
                contact=scene.contact,
                seed=scene.seed,
                device=self.device,
                precision=self.precision,
                progress=lambda fraction: self.tell("packing", fraction),
                threads=self.threads,
            )
        self.place(packed, run_clock() - started)
        self.join(Stepper(self.model, self.state, scene.time_step, threads=self.threads))
        run_coroutine(self.preparing(), self.stepper.advance)

    def place(self, packed: tuple[BodyTable, PackingReport] | None, took: float) -> None:
        """Create the state from the packed bodies and from the bodies that the scene places.

        `packed` is the result of a packing, or None for a scene without one, and `took` is the wall time of the packing
        [s].
        """
        table = BodyTable.empty()
        if packed is not None:
            table, self.packing = packed
        self.tell("packing", 1.0)
        self.wall_times.phases["packing"] = took
        table = table.joined(placed_bodies(self.scene))
        check_memory(self.model, table)
        self.state = State(self.model, table)

    def join(self, stepper: Stepper) -> None:
        """Use `stepper`, which may share a batch with other scenes, to advance the state from now on."""
        # The base class declares a more general type for this attribute. A narrower type is safe, because only this
        # class assigns the attribute.
        self.stepper = stepper  # pyright: ignore[reportIncompatibleVariableOverride]
        settling = self.scene.settle is not None and (self._resumed is None or self._settled is not None)
        damping = self.scene.settle.local_damping if settling else self.scene.local_damping  # type: ignore[union-attr]
        stepper.change(local_damping=damping)

    def preparing(self) -> Coroutine:
        """Prepare the state at t = 0, starting from newly placed bodies or from a checkpoint of the settling."""
        scene, model = self.scene, self.model
        if self._settled is None:
            first_group_kind = 1 + (scene.bonds is not None) + (scene.hydration is not None)
            for number, (group, bonds) in enumerate(scene.group_bonds.items()):
                self.stepper.bond(bonds, first_group_kind + number, model.groups.index(group))
            self.stepper.choose_dt()  # Raise the error for an unstable step before any file is written.

        started = run_clock() - self.wall_times.phases.get("settling", 0.0)
        if scene.settle and scene.settle.duration > 0:
            with self._walls_held():
                yield from self._settling(scene.settle.duration)
            self.stepper.change(local_damping=scene.local_damping)
        self.wall_times.phases["settling"] = run_clock() - started
        self._settled = None
        self.stepper.restart_clock()
        if scene.bonds is not None and scene.bonds.healing:
            # Bonds that formed during settling carry forces. Remove them, and bond all contacts again without forces.
            bonds = self.state.pairs.bond.numpy()
            bonds[bond_kinds(bonds) <= 1] = 0
            self.state.pairs.bond.assign(bonds)
        self.bond()
        self.stepper.choose_dt()
        self._begin()

    @contextmanager
    def _walls_held(self) -> Iterator[None]:
        """Hold all walls with prescribed motion still within this context manager, because they first move at t = 0."""
        self.stepper.change(held=1)
        try:
            yield
        finally:
            self.stepper.change(held=0)

    def _settling(self, duration: float) -> Coroutine:
        before, begun = self.wall_times.phases.get("settling", 0.0), run_clock()
        if self._settled is None:
            self._settled = 0
            self._checkpoint()
        for part in range(self._settled, SETTLING_PARTS):
            self._settled = part
            self.wall_times.phases["settling"] = before + run_clock() - begun
            if self.stop_requested:
                self._checkpoint()
                raise KeyboardInterrupt
            self._checkpoint_if_due()
            yield Until(duration * (part + 1) / SETTLING_PARTS)
            self.tell("settling", (part + 1) / SETTLING_PARTS)
            kinetic = body_sums(self.model, self.state).kinetic_energy
            if part > 2 and kinetic < QUIET * contact_sums(self.model, self.state).elastic_energy:
                break
        self.tell("settling", 1.0)

    def bond(self) -> None:
        """Bond all pairs with a gap of at most `Bonds.gap`, and hydrate the share of bonds in `Scene.hydration`.

        Do nothing if the scene has no bonds.
        """
        scene = self.scene
        if scene.bonds is None:
            return
        self.stepper.bond(scene.bonds, 1)
        if scene.hydration is not None:
            self.stepper.hydrate(scene.hydration.fraction, scene.seed)

    def reaching(self, time: float) -> Coroutine:
        """Advance the simulation to `time` [s]; this coroutine yields the times to which the run loop must step.

        A scene may contain a rest, for example ten minutes in which the concrete stands still. The rest is not
        simulated: at the time `Rest.at`, bonds and lubrication layer gain the strength of the whole rest at once. If a
        rest is still to come before or at `time`, the simulation first advances to `Rest.at` and applies this gain.
        """
        rest = self.scene.rest
        if rest is not None and self.rested is None and rest.at <= time:
            yield Until(rest.at)
            self.rested = self.stepper.apply_rest()
        yield Until(time)

    def _begin(self) -> None:
        self.stepper.running = True
        self.sampler = Sampler(self.model, self.state)
        self.watch = Watch(self.model, self.state)
        self.blockage = BlockageWatch(self.model, self.state) if self.scene.looks_for_blockage else None

    def state_dict(self) -> SavedState:
        """Return the data of a checkpoint: state, stepper and packing report, and a part that depends on the time.

        Before t = 0 this part is the progress of the settling, afterwards it contains all measurements.
        """
        self.stepper.batch.flush()
        found = {
            "state": state_dict(self.state),
            "stepper": self.stepper.state_dict(),
            "packing": asdict(self.packing) if self.packing else None,
        }
        if self._settled is not None:
            return found | {"settled": self._settled}
        return found | {
            "sampler": self.sampler.state_dict(),
            "watch": self.watch.state_dict(),
            "blockage": self.blockage.state_dict() if self.blockage is not None else None,
            **({"rested": self.rested} if self.scene.rest is not None else {}),
        }

    def load_state_dict(self, state: SavedState) -> None:
        """Restore the simulation from a checkpoint that :meth:`state_dict` returned, so that the run can continue.

        The method creates a batch for this simulation alone. If the checkpoint was saved while the concrete settled,
        the settling is completed.
        """
        self.restore(state)
        stepper = Stepper(self.model, self.state, self.scene.time_step, threads=self.threads, resumed=state["stepper"])
        self.join(stepper)
        run_coroutine(self.going_on(state), stepper.advance)

    def restore(self, state: SavedState) -> None:
        """Create the state from a `state_dict`; to resume the run, call :meth:`join` and then run :meth:`going_on`."""
        self.state = restore_state(self.model, state["state"])
        self._settled = state.get("settled")

    def _memory(self) -> float:
        """Return the device memory of the run [B]; in a batch, a share in proportion to the run's number of spheres."""
        batch = self.stepper.batch
        return memory_of_batch(self.stepper) * self.state.sphere_count / max(batch.sphere_count, 1)

    def going_on(self, state: SavedState) -> Coroutine:
        """Continue from a `state_dict`: restore packing report and measurements, or resume the settling."""
        if state["packing"] is not None:
            self.packing = PackingReport(**state["packing"])
        if self._settled is not None:
            yield from self.preparing()
            return
        self._begin()
        self.sampler.load_state_dict(state["sampler"])
        self.watch.load_state_dict(state["watch"])
        self.rested = state.get("rested")
        if self.rested is not None:
            self.stepper.set_layer_gain(self.rested)
        if self.blockage is not None:
            self.blockage.load_state_dict(state["blockage"])

    def release(self) -> None:
        if "stepper" in self.__dict__:
            self.stepper.batch.states.clear()
        # If the simulation failed early, some of these attributes do not exist.
        for name in ("state", "stepper", "sampler", "watch", "blockage"):
            self.__dict__.pop(name, None)

    def measure(self) -> dict[str, float]:
        """Measure the next row of the time series, check for a blockage, and return the row."""
        row = self.sampler.sample()
        if self.blockage is not None:
            self.blockage(row)
        return row

    def watch_row(self, row: dict[str, float]) -> None:
        self.watch(row)

    def ended_early(self) -> bool:
        """Return whether the run may end before its planned duration.

        A run may end early if a test in a vessel is over, or if the pipe is blocked and the settings of the scene end
        blocked runs.
        """
        vessel, blockage = self.scene.vessel, self.scene.blockage
        if self.blockage is not None and self.blockage.found and blockage is not None and blockage.stop:
            return True
        return vessel is not None and self.state.sphere_count > 0 and is_over(vessel, self.rows)

    def running(self) -> Coroutine:
        """Run to the end, as in the base class, and then warn if the time step was too coarse."""
        run: Run = yield from super().running()
        # Warn after all results have been written, so that none is lost if the user turns warnings into errors.
        if run.finished and self._ended_run is None:
            warn_of_coarse_step(run)
        return run

    def why_ended(self) -> tuple[str, str]:
        vessel, blockage, time = self.scene.vessel, self.scene.blockage, self.stepper.time
        if self.blockage is not None and self.blockage.found and blockage is not None and blockage.stop:
            return "blocked", f"the pipe was blocked at t = {time:.4g} s, and the scene ends blocked runs"
        if vessel is not None and self.state.sphere_count > 0 and is_over(vessel, self.rows):
            if at_rest(vessel, self.rows):
                return "rest", f"the concrete came to rest at t = {time:.4g} s"
            return "empty", f"the concrete had flowed out at t = {time:.4g} s"
        if self.scene.pipe is not None and self.rows[-1].get("travel", 0.0) > 0.999 * self.scene.pipe.travel:
            return "travel", f"the piston completed its travel at t = {time:.4g} s"
        return super().why_ended()

    def result(self, finished: bool) -> ElementRun:
        series = self.sampler.series()
        steps, state = self.stepper.steps, self.state
        running = self.wall_times.phases.get("running", 0.0)
        tables: dict[str, Table] = {}
        result: Record = {
            "scene": self.scene.name,
            "method": "dem",
            "finished": finished,
            "ended": None,
            "simulated_time": quantity(self.stepper.time, "s"),
            "steps": steps,
            "bodies": state.body_count,
            "spheres": state.sphere_count,
        }
        if self.scene.pipe is not None:
            result["unit"] = self.scene.pipe.name
            result["concrete_length"] = quantity(self.scene.pipe.concrete_length, "m")
            if self.scene.pipe.stops is not None and "pressure" in series:
                result["strokes"] = stroke_table(self.scene.pipe, series)
        if self.scene.vessel is not None:
            result["at_rest"] = bool(self.rows) and state.sphere_count > 0 and at_rest(self.scene.vessel, self.rows)
        if self.packing is not None:
            result["packing"] = asdict(self.packing)
        if self.rows:
            last = self.rows[-1]
            result["energies_at_end"] = {
                name: quantity(last[name], "J")
                for name in (*STORED, "wall_work", "drive_work", "dissipated_energy")
                if name in last
            }
            mass = float(state.bodies.mass.numpy().sum(dtype=float))
            contacts = contact_sums(self.model, state, coordination=True)
            known = Known(
                self.scene, self.model.walls, series, mass, contacts, wear=self.sampler.wear,
                blockage=self.blockage, log=self.sampler.log,
            )  # fmt: skip
            result |= results_of(quantities(), known)
            if known.log is not None and known.pumped:
                tables["stations"] = Table(known.log.table(known.window), STATION_UNITS)
        result["speed"] = {
            "wall_time": quantity(running, "s"),
            "packing_time": quantity(self.wall_times.phases.get("packing", 0.0), "s"),
            "settling_time": quantity(self.wall_times.phases.get("settling", 0.0), "s"),
            "steps_per_second": quantity(self.pace, "1/s"),
            "sphere_steps_per_second": quantity(self.pace * state.sphere_count, "1/s"),
            "memory": quantity(self._memory(), "B"),
        }
        result["state_hash"] = state_hash(state)
        result["provenance"] = provenance(self.device, self.precision, self.scene.seed, self.threads)
        units = {name: self.unit(name) for name in series}
        return ElementRun(
            self.scene, series, units, result, finished, tables=tables, packing=self.packing, bodies=state.table(),
            wear=self.sampler.wear,
        )  # fmt: skip
