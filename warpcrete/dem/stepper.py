"""Stepping: a scene's own way through a batch."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..core.errors import CapacityError, InstabilityError, refuse
from ..core.run_loop import Coroutine, Until
from ..geometry.walls import MeshWall
from ..kernels.common.control import ARRIVED, ESTIMATED, FAILED, HALTED, OVERFLOW, STALE, STEPS
from ..kernels.dem.clock import CLOSE
from ..kernels.dem.probes import TRAVEL
from ..kernels.dem.stable_step import LEAP
from ..kernels.dem.structs import DT_PREVIOUS, TIME
from ..kernels.dem.subcycling import PART
from ..kernels.dem.wall_motion import SPEED_LIMIT
from .batch import Batch
from .bonding import make_bonds, reassign_bonds
from .loading import load_kernels
from .model import Model
from .neighbors import NeighborLists
from .scene import Bonds, TimeStep
from .scheduling import Steps, drive_one
from .stable_step import StableStep, foreseen_speed
from .state import State
from .subcycling import MARGIN, rounds_for
from .watch import failed_body

# Skin over the mean sphere radius. On a CPU the cost of a pumping step is flat from 0.3 to 0.75; a GPU steps so fast
# that rebuilding less often pays where there are few spheres (28,000: 52, 48, 52 and 65 us a step at 0.7, 1.0, 1.4 and
# 2.0; 100,000 and more were 2 or 3 % slower at 1.0).
SKIN = {"cpu": 0.5, "cuda": 0.7, "few": 1.0}
FEW = 50_000
MESH_SKIN = 4  # times the skin
SORT_EVERY = {"cpu": 1000, "cuda": 4000, "few": 16_000}
"""Steps from one re-sorting of the bodies to the next, by the host: 13 to 55 builds of the lists. Few bodies are near
to hand wherever they lie: of 28,000 spheres a step takes 1.3 us less than with 4000, and no less without any."""


class Stepper:
    """One scene of a batch: its step size, goals and bonds. Alone, it is a batch of one.

    `reaching` is a coroutine, which `scheduling.drive` carries forward with those of other scenes; `advance` and
    `take` drive it alone.
    """

    def __init__(
        self,
        model: Model,
        state: State,
        time_step: TimeStep,
        *,
        skin: float | None = None,
        sort_every: int | None = None,
        threads: int = 1,
        resumed: dict[str, Any] | None = None,
        among: tuple[NeighborLists, StableStep, int] | None = None,
    ) -> None:
        """`among` are lists and estimate of a batch, and the scene's number in it; None makes a batch of one.

        `resumed` is the `state_dict` of a stepper that this one goes on from; `skin` [m] and `sort_every`, steps from
        one re-sorting to the next, are for tests.
        """
        self.model, self.state, self.time_step = model, state, time_step
        if among is None:
            batch = Batch([model], [state], threads=threads)
            among = NeighborLists(batch), StableStep(batch), 0
            load_kernels(*among[:2])
        self.running = False  # until then an unstable fixed step is bad input, later an instability
        self.meanwhile: Callable[[], None] | None = None
        """To be called once, when further steps are under way."""
        self._skin, self._sort_every = skin, sort_every
        self._estimated = self._counting = False
        self._foreseen = -1.0, 0.0
        fastest = self._fastest_wall(model)
        self._wall_step = LEAP * state.smallest_radius / fastest if fastest and state.sphere_count else math.inf
        """Longest step in which a prescribed wall goes no further than the smallest sphere may [s]."""
        self.join(*among, resumed=resumed)

    def join(
        self,
        lists: NeighborLists,
        stable_step: StableStep,
        index: int,
        *,
        resumed: dict[str, Any] | None = None,
    ) -> None:
        """Be number `index` of the batch that has these; a `state_dict` says where it goes on from."""
        self.lists, self.stable_step, self.index = lists, stable_step, index
        self.batch, state = lists.batch, self.state
        kind = "cpu" if not self.batch.parallel else "few" if state.sphere_count < FEW else "cuda"
        self.skin = SKIN[kind] * state.mean_radius if self._skin is None else self._skin
        if resumed is not None:
            self.skin = resumed["skin"]
        moving_mesh = any(isinstance(wall, MeshWall) and wall.motion is not None for wall in self.model.walls)
        self.mesh_skin = MESH_SKIN * self.skin
        self.batch.set(
            index,
            skin=self.skin,
            sort_every=SORT_EVERY[kind] if self._sort_every is None else self._sort_every,
            mesh_skin=self.mesh_skin,
            # What spheres and moving meshes may go between two builds adds up to the skin.
            sphere_allowance=0.5 * self.mesh_skin if moving_mesh else self.mesh_skin,
        )
        if resumed is not None:
            if math.isfinite(resumed["since_estimate"]):
                self._estimated = True
                self.batch.estimated(index, self.steps - int(resumed["since_estimate"]))
            self.batch.subcycles.load_state_dict(index, resumed["subcycles"])
        stale = bool(self.batch.host_flags()[index, int(STALE)])  # estimates come after new lists, and after sorting
        if resumed is None or stale or index in self.batch.rechunked:
            self.rebuild()
        else:
            self.lists.link(index)
            self.batch.ahead.joined(index, self.steps)

    def state_dict(self) -> dict[str, Any]:
        """What a stepper needs, besides the state, to go on as this one would."""
        return {
            "skin": self.skin,
            "since_estimate": self._since_estimate(),
            "subcycles": self.batch.subcycles.state_dict(self.index),
        }

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.state.time

    @property
    def steps(self) -> int:
        """Completed steps."""
        return self.state.steps

    @property
    def dt(self) -> float:
        """Size of the next step [s]."""
        return self.state.dt

    def change(self, **settings: float) -> None:
        """Change `local_damping`, `growth_rate`, `growth_end` or `held` (walls that stand still) from now on."""
        self.batch.set(self.index, **settings)

    def rebuild(self) -> None:
        """Build the lists anew."""
        self.batch.outdate([self.index])
        self.lists()

    def bond(self, bonds: Bonds, kind: int, group: int = -1) -> int:
        """Bond pairs within `bonds.gap` (inside a `group` only, if given); returns how many of `kind` there are."""
        self.batch.set(self.index, skin=max(self.skin, 1.001 * bonds.gap))
        self.rebuild()
        made = make_bonds(self.model, self.state, bonds, kind, group)
        self.batch.set(self.index, skin=self.skin)
        self.rebuild()
        self._estimated = False
        return made

    def hydrate(self, old: int, new: int, fraction: float, seed: int) -> int:
        """Give a random part of the bonds of kind `old` the properties of kind `new`; returns how many have them."""
        self._estimated = False
        made = reassign_bonds(self.model, self.state, old, new, fraction, seed)
        if self.batch.features.subcycling and made:
            self._choose_rounds()
        return made

    def stand(self) -> float:
        """Put in the scene's rest, with bonds and layer as after it; returns the travel from which slip counts [m]."""
        scene, model, batch = self.model.scene, self.model, self.batch
        assert scene.rest is not None
        if scene.bonds is not None:
            kind = len(model.bond_kinds)
            reassign_bonds(model, self.state, 1, kind, 1.0, scene.seed)
            self.bond(scene.bonds, kind)
        number = next(k for k, wall in enumerate(model.walls) if wall.name == scene.rest.wall)
        begun = float(batch.host_walls(self.index)[number, int(TRAVEL)])
        self.wear_from(begun)
        return begun

    def wear_from(self, begun: float) -> None:
        """Let the layer have what it gained at rest, less what slip since a travel of `begun` [m] took."""
        if self.batch.structure is not None:
            self.batch.structure.grow(self.index, begun)

    def _choose_rounds(self) -> None:
        """Step hydrated bonds in as many rounds as they need within a step of all else."""
        subcycles, step = self.batch.subcycles, self.time_step
        subcycles.collect(self.index)
        all_else = self.estimate()  # as long as there are no rounds
        dt = step.fixed or min(step.safety * PART * all_else, step.largest)
        ratio = MARGIN * dt / (step.safety * subcycles.stable_step(self.index))
        subcycles.set_rounds(self.index, step.rounds or rounds_for(ratio))

    def restart_clock(self) -> None:
        """Set time, step count and the walls' records to zero; the next kick is a half one."""
        state = self.state
        self.batch.device_changed()
        clock = state.scenes.clock.numpy()
        clock[0, [int(TIME), int(DT_PREVIOUS)]] = 0.0
        state.scenes.clock.assign(clock)
        state.flags.zero_()
        self.batch.device_changed()
        for name in ("impulse", "angular_impulse", "travel", "work"):
            getattr(state.walls, name).zero_()
        state.spheres.dissipated_energy.zero_()
        state.spheres.broken.zero_()
        state.slots.worn.zero_()
        self._estimated = False
        self.rebuild()

    def stop_motion(self) -> None:
        """Set all velocities to zero."""
        bodies, spheres = self.state.bodies, self.state.spheres
        for array in (bodies.velocity, bodies.spin, bodies.angular_momentum, spheres.spin):
            array.zero_()
        velocity = spheres.velocity.numpy().copy()
        velocity[:, :3] = 0.0
        spheres.velocity.assign(velocity)

    def estimate(self) -> float:
        """The stable step as things are now, without safety factor [s]; infinite for a state without bodies."""
        self._set_step()
        self.stable_step(self.index)
        return self.state.stable_step if self.state.body_count else math.inf

    def _set_step(self) -> None:
        step = self.time_step
        horizon = step.interval * step.largest
        if self._foreseen[0] != horizon:
            self._foreseen = horizon, foreseen_speed(self.model.scene, horizon)
        self.batch.set(
            self.index,
            safety=step.safety,
            largest_step=min(step.largest, self._wall_step),
            fixed_step=step.fixed or 0.0,
            foreseen_speed=self._foreseen[1],
        )

    def choose_dt(self) -> float:
        """Estimate the stable step and set the size of the next steps [s]."""
        fixed = self.time_step.fixed
        stable = self.estimate()
        dt = self.dt
        if not stable > 0:
            raise InstabilityError(
                f"t = {self.time:.6g} s: the stable time step is {stable:.3g} s, which is not above 0; usual cures: "
                "masses, stiffnesses and dashpots within the range of single precision, or precision float64"
            )
        if fixed is not None and fixed > stable * max(1.0, self.time_step.safety):
            what = f"is above the stable step of this scene, {stable:.3g} s"
            if self.running:
                raise InstabilityError(
                    f"t = {self.time:.6g} s: time_step = {fixed!r} {what}; usual cures: a smaller time_step, or none "
                    "for an automatic step"
                )
            refuse("time_step", fixed, what, "leave it out for an automatic step")
        self._estimated = True
        self.batch.estimated(self.index, self.steps)
        return dt

    def _fastest_wall(self, model: Model) -> float:
        """Return the speed of the fastest prescribed wall [m/s].

        Raises :class:`SceneError` if one goes further than the smallest radius in a fixed step.
        """
        speeds = {wall.name: wall.top_speed() for wall in model.walls}
        fixed, radius = self.time_step.fixed, self.state.smallest_radius
        for name, speed in speeds.items():
            if fixed is not None and self.state.sphere_count and speed * fixed > radius:
                refuse("time_step", fixed, f"moves the wall {name!r} by {speed * fixed:.3g} m a step, further than the "
                       f"smallest radius, {radius:.3g} m",
                       "leave it out for an automatic step, or slow down the wall")  # fmt: skip
        return max(speeds.values(), default=0.0)

    def _since_estimate(self) -> float:
        """Steps taken since the stable step was estimated; infinite where it must be anew."""
        if not self._estimated:
            return math.inf
        flags = self.batch.host_flags()[self.index]
        return float(flags[int(STEPS)] - flags[int(ESTIMATED)])

    def reaching(self, goal: Until | Steps) -> Coroutine:
        """Coroutine that gets to a goal: a time, to within one step, or a number of steps of the present size.

        It yields when the batch has something to work for, and goes on when the scene has halted because it is there,
        or because its stable step must be estimated and no device has done that.
        """
        if isinstance(goal, Steps):
            yield from self._taking(goal.count)
            return
        while True:
            self._set_step()
            if self._since_estimate() >= self.time_step.interval:
                self.choose_dt()
            if not goal.time - self.time > CLOSE * self.dt:
                return
            self._counting = False
            self.batch.goal(self.index, until=goal.time, interval=self.time_step.interval)
            yield

    def _taking(self, count: int) -> Coroutine:
        if not self._estimated:
            self.choose_dt()
        if count > 0:
            self._counting = True
            self.batch.goal(self.index, steps=self.steps + count)
            yield

    def wants_estimate(self) -> bool:
        """Whether, having taken so many steps, it will estimate the stable step before it takes others."""
        self._set_step()
        return self._counting and self._since_estimate() >= self.time_step.interval

    def advance(self, until: float) -> None:
        """Step until the simulated time reaches `until` [s], to within one step."""
        drive_one(self, self._wanting(Until(until)))

    def take(self, count: int) -> None:
        """Take `count` steps of the present size."""
        drive_one(self, self._wanting(Steps(count)))

    @staticmethod
    def _wanting(goal: Until | Steps) -> Coroutine:
        yield goal

    def trouble(self, flags: np.ndarray) -> Exception | None:
        """What a scene's flags complain about."""
        failed = int(flags[int(FAILED)])
        if failed < 0:
            wall = self.model.walls[-1 - failed].name
            return InstabilityError(
                f"t = {self.time:.6g} s: driven wall {wall!r} moves faster than {SPEED_LIMIT:g} m/s; usual cures: "
                "more mass or damping of the wall, a smaller time step"
            )
        if failed:
            return failed_body(self.model, self.state, failed - 1)
        if flags[int(OVERFLOW)]:
            return CapacityError(
                f"at t = {self.time:.6g} s a sphere touches a mesh wall in more than six directions at once; "
                "use finer aggregates or a coarser mesh"
            )
        return None

    def reached(self, flags: np.ndarray) -> bool:
        """Whether a scene with these flags is where it wanted to be, or must be looked after."""
        return int(flags[int(HALTED)]) == int(ARRIVED)


def steppers_of(
    models: list[Model],
    states: list[State],
    *,
    time_steps: list[TimeStep] | None = None,
    resumed: list[dict[str, Any] | None] | None = None,
    threads: int = 1,
) -> list[Stepper]:
    """Steppers of scenes that share one batch; :func:`warpcrete.dem.batch.batch_key` tells which may."""
    batch = Batch(models, states, threads=threads)
    among = NeighborLists(batch), StableStep(batch)
    load_kernels(*among)
    return [
        Stepper(
            model,
            state,
            time_steps[s] if time_steps else TimeStep(),
            resumed=resumed[s] if resumed else None,
            among=(*among, s),
        )
        for s, (model, state) in enumerate(zip(models, states))
    ]
