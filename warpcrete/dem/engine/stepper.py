"""Stepper, which advances one scene of a batch in time and controls its step size and its bonds."""

import math

import numpy as np

from ...core.errors import CapacityError, InstabilityError, refuse
from ...core.run.coroutines import Coroutine, Until
from ...geometry.walls import MeshWall
from ...kernels.common.control import ARRIVED, ESTIMATED, FAILED, HALTED, OVERFLOW, STALE, STEPS
from ...kernels.dem.bond_parallel import HYDRATED
from ...kernels.dem.clock import CLOSE
from ...kernels.dem.probes import TRAVEL
from ...kernels.dem.stable_step import LEAP
from ...kernels.dem.structs import DT_PREVIOUS, TIME
from ...kernels.dem.subcycling import SUBCYCLED_STEP_FRACTION
from ...kernels.dem.wall_motion import SPEED_LIMIT
from ..scene.scene import Bonds, TimeStep
from .batch import Batch
from .bonding import make_bonds, reassign_bonds
from .failures import failed_body
from .loading import load_kernels
from .model import Model
from .neighbors import NeighborLists
from .scheduling import drive_one
from .stable_step import StableStep, expected_speed
from .state import State
from .stepper_protocol import StepperRecord, Steps
from .subcycling import MARGIN, rounds_for

# Skin of the neighbour lists (largest gap of a listed pair) divided by the mean sphere radius. On a CPU, a step of a
# pumping scene takes equally long for all skins from 0.3 to 0.75. A GPU with few spheres gains from a larger skin,
# because the lists are rebuilt less often: for 28,000 spheres a step takes 52, 48, 52 and 65 us at skins of 0.7, 1.0,
# 1.4 and 2.0. From 100,000 spheres on, a skin of 1.0 is 2 to 3 % slower than 0.7.
SKIN = {"cpu": 0.5, "cuda": 0.7, "few": 1.0}
FEW_SPHERES = 50_000
# Largest gap between a sphere and a triangle that is listed as near the sphere, divided by the largest gap of a listed
# pair of spheres.
MESH_SKIN = 4
SORT_EVERY = {"cpu": 1000, "cuda": 4000, "few": 16_000}
"""Number of steps after which the host re-sorts the bodies in memory. The keys are kinds of devices.

Neighbour lists are rebuilt 13 to 55 times in this interval. The key "few" stands for a GPU with few bodies. Few bodies
fit into the cache of the GPU in any order, so they need less sorting. For 28,000 spheres, sorting every 16,000 instead
of every 4000 steps shortens a step by 1.3 us; never sorting gives the same time as every 16,000 steps.
"""


class Stepper:
    """Object that advances one scene of a batch in time and controls its step size and its bonds.

    A single scene is a batch of one. `reaching` is a coroutine, which `scheduling.drive` runs together with the
    coroutines of other scenes. `advance` and `take` advance only the scene of this stepper.
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
        resumed: StepperRecord | None = None,
        among: tuple[NeighborLists, StableStep, int] | None = None,
    ) -> None:
        """Create a stepper for one scene of an existing batch, or of a new batch if `among` is None.

        `among` is a tuple of the neighbour lists of the existing batch, its :class:`StableStep`, and the index of the
        scene in the batch. `resumed` is the `state_dict` of an earlier stepper, whose work the new stepper continues,
        or None. `skin` is the largest gap of a listed pair [m], and `sort_every` is the number of steps between two
        re-sortings of the bodies in memory; only tests set these two arguments.
        """
        self.model, self.state, self.time_step = model, state, time_step
        if among is None:
            batch = Batch([model], [state], threads=threads)
            among = NeighborLists(batch), StableStep(batch), 0
            load_kernels(*among[:2])
        # `running` becomes True at t = 0, after the preparation of the scene. An unstable fixed step raises a
        # SceneError before t = 0 and an InstabilityError afterwards.
        self.running = False
        self._skin, self._sort_every = skin, sort_every
        self._estimated = self._goal_is_steps = False
        self._horizon_speed = -1.0, 0.0
        top_speed = self._fastest_wall(model)
        self._longest_wall_step = (
            LEAP * state.smallest_radius / top_speed if top_speed and state.sphere_count else math.inf
        )
        """Longest time step [s] in which each wall with prescribed motion moves by at most `LEAP` times the radius of
        the smallest sphere."""
        self.join(*among, resumed=resumed)

    def join(
        self, lists: NeighborLists, stable_step: StableStep, index: int, *, resumed: StepperRecord | None = None
    ) -> None:
        """Make the stepper advance the scene with the index `index` of an existing batch.

        `lists` and `stable_step` belong to this batch. `resumed` is the `state_dict` of an earlier stepper, whose work
        this stepper continues, or None.
        """
        self.lists, self.stable_step, self.index = lists, stable_step, index
        self.batch, state = lists.batch, self.state
        kind = "cpu" if not self.batch.parallel else "few" if state.sphere_count < FEW_SPHERES else "cuda"
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
            # The lists of mesh candidates stay complete while spheres and meshes move relative to each other by at most
            # `mesh_skin`. If meshes move, the spheres may move by half of this distance and the meshes by the other
            # half.
            sphere_allowance=0.5 * self.mesh_skin if moving_mesh else self.mesh_skin,
        )
        if resumed is not None:
            if math.isfinite(resumed["since_estimate"]):
                self._estimated = True
                self.batch.estimated(index, self.steps - int(resumed["since_estimate"]))
            self.batch.subcycles.load_state_dict(index, resumed["subcycles"])
        # An uninterrupted run rebuilds stale neighbour lists before it estimates the stable step. A resumed run must
        # give the same results, so rebuild stale lists now.
        stale = bool(self.batch.host_flags()[index, int(STALE)])
        if resumed is None or stale or index in self.batch.scenes_with_new_chunks:
            self.rebuild()
        else:
            self.lists.link(index)
            self.batch.planner.note_joined(index, self.steps)

    def state_dict(self) -> StepperRecord:
        """Return the data that a stepper needs, in addition to the state, to continue with identical results."""
        return {
            "skin": self.skin,
            "since_estimate": self._steps_since_estimate(),
            "subcycles": self.batch.subcycles.state_dict(self.index),
        }

    @property
    def time(self) -> float:
        """Simulated time that the scene has reached [s]."""
        return self.state.time

    @property
    def steps(self) -> int:
        """Number of time steps that the scene has completed."""
        return self.state.steps

    @property
    def dt(self) -> float:
        """Size of the scene's next time step [s]."""
        return self.state.dt

    def change(self, **settings: float) -> None:
        """Change parameters of the scene for the next steps.

        `settings` may contain `local_damping`, the growth of sizes (`growth_rate` and `growth_end`), and `held`. The
        value 1 of `held` stops all walls with prescribed motion, and the value 0 releases them.
        """
        self.batch.set(self.index, **settings)

    def rebuild(self) -> None:
        """Rebuild the neighbour lists of this scene."""
        self.batch.mark_stale([self.index])
        self.lists()

    def bond(self, bonds: Bonds, kind: int, group: int = -1) -> int:
        """Bond all unbonded pairs with gaps up to `bonds.gap` [m], and return the number of bonds of this `kind`.

        `kind` is the position of these bonds in the model's `bond_kinds`, counted from 1. If `group` is not -1, only
        pairs inside the body group of this number are bonded.
        """
        self.batch.set(self.index, skin=max(self.skin, 1.001 * bonds.gap))
        self.rebuild()
        bond_count = make_bonds(self.model, self.state, bonds, kind, group)
        self.batch.set(self.index, skin=self.skin)
        self.rebuild()
        self._estimated = False
        return bond_count

    def hydrate(self, fraction: float, seed: int) -> int:
        """Hydrate (stiffen) a random `fraction` of the bonds of the first kind, and return their number."""
        self._estimated = False
        bond_count = reassign_bonds(self.model, self.state, 1, HYDRATED, fraction, seed)
        if self.batch.features.subcycling and bond_count:
            self._choose_rounds()
        return bond_count

    def apply_rest(self) -> float:
        """Apply the effects of a time in which the concrete stands still (a rest).

        Bonds and lubrication layer gain strength, and all pairs with a gap of at most `Bonds.gap` are bonded.

        Returns the distance [m] that the wall `Rest.wall` has moved so far. The slip along the wall after the rest is
        measured from this distance.
        """
        scene, model, batch = self.model.scene, self.model, self.batch
        assert scene.rest is not None
        if scene.bonds is not None:
            kind = len(model.bond_kinds)
            reassign_bonds(model, self.state, 1, kind, 1.0, scene.seed)
            self.bond(scene.bonds, kind)
        number = next(k for k, wall in enumerate(model.walls) if wall.name == scene.rest.wall)
        travel_at_rest = float(batch.host_walls(self.index)[number, int(TRAVEL)])
        self.set_layer_gain(travel_at_rest)
        return travel_at_rest

    def set_layer_gain(self, travel_at_rest: float) -> None:
        """Add the yield stress that the lubrication layer gained while the concrete stood still (a rest).

        Slip after the rest reduces this gain again. The slip is the distance [m] that the wall `Rest.wall` has moved
        since the rest. `travel_at_rest` is the total distance [m] that this wall had moved by the time of the rest.
        """
        if self.batch.structure is not None:
            self.batch.structure.grow(self.index, travel_at_rest)

    def _choose_rounds(self) -> None:
        """Choose the number of sub-cycling rounds per time step; a round is a shorter step for the hydrated bonds."""
        subcycles, step = self.batch.subcycles, self.time_step
        subcycles.collect(self.index)
        # An estimate of the stable step ignores the hydrated bonds while the number of sub-cycling rounds is 0. The
        # number is still 0 here, so the result is the stable step of all other contacts and bonds.
        unbonded_step = self.estimate()
        dt = step.fixed or min(step.safety * SUBCYCLED_STEP_FRACTION * unbonded_step, step.largest)
        ratio = MARGIN * dt / (step.safety * subcycles.stable_step(self.index))
        subcycles.set_rounds(self.index, step.rounds or rounds_for(ratio))

    def restart_clock(self) -> None:
        """Set time, step count and all sums over time to zero, such as wall impulses, work and dissipated energy.

        The next step starts the leapfrog scheme again, with a velocity update over half a step.
        """
        state = self.state
        with self.batch.changing():
            clock = state.scenes.clock.numpy()
            clock[0, [int(TIME), int(DT_PREVIOUS)]] = 0.0
            state.scenes.clock.assign(clock)
            state.flags.zero_()
            for record in (state.walls.impulse, state.walls.angular_impulse, state.walls.travel, state.walls.work):
                record.zero_()
        state.spheres.dissipated_energy.zero_()
        state.spheres.broken.zero_()
        state.slots.worn.zero_()
        self._estimated = False
        self.rebuild()

    def stop_motion(self) -> None:
        """Set all velocities and spins of bodies and spheres to zero."""
        bodies, spheres = self.state.bodies, self.state.spheres
        for array in (bodies.velocity, bodies.spin, bodies.angular_momentum, spheres.spin):
            array.zero_()
        velocity = spheres.velocity.numpy().copy()
        velocity[:, :3] = 0.0
        spheres.velocity.assign(velocity)

    def estimate(self) -> float:
        """Estimate the current stable step; return it without safety factor [s]. It is infinite without bodies."""
        self._set_step()
        self.stable_step(self.index)
        return self.state.stable_step if self.state.body_count else math.inf

    def _set_step(self) -> None:
        step = self.time_step
        horizon = step.interval * step.largest
        if self._horizon_speed[0] != horizon:
            self._horizon_speed = horizon, expected_speed(self.model.scene, horizon)
        self.batch.set(
            self.index,
            safety=step.safety,
            largest_step=min(step.largest, self._longest_wall_step),
            fixed_step=step.fixed or 0.0,
            expected_speed=self._horizon_speed[1],
        )

    def choose_dt(self) -> float:
        """Estimate the stable step, set the size of the next time steps, and return this size [s].

        A fixed step above the stable step raises :class:`SceneError` before t = 0 and :class:`InstabilityError` later.
        """
        fixed = self.time_step.fixed
        stable = self.estimate()
        dt = self.dt
        if not stable > 0:
            raise InstabilityError(
                f"the estimated stable time step is {stable:.3g} s, but it must be above 0",
                time=self.time,
                cure="masses, stiffnesses and dashpots within the range of single precision, or precision float64",
            )
        if fixed is not None and fixed > stable * max(1.0, self.time_step.safety):
            what = f"is above the largest stable time step of this scene, {stable:.3g} s"
            if self.running:
                raise InstabilityError(
                    f"time_step = {fixed!r} {what}",
                    time=self.time,
                    cure="a smaller time_step, or no time_step for an automatic step",
                )
            refuse("time_step", fixed, what, "use a smaller value, or leave out 'time_step' for an automatic step")
        self._estimated = True
        self.batch.estimated(self.index, self.steps)
        return dt

    def _fastest_wall(self, model: Model) -> float:
        """Return the largest speed of all walls with prescribed motion [m/s], or 0 without such walls.

        Raises :class:`SceneError` if a wall moves by more than the radius of the smallest sphere in a fixed time step.
        """
        speeds = {wall.name: wall.top_speed() for wall in model.walls}
        fixed, radius = self.time_step.fixed, self.state.smallest_radius
        for name, speed in speeds.items():
            if fixed is not None and self.state.sphere_count and speed * fixed > radius:
                refuse("time_step", fixed, f"moves the wall {name!r} by {speed * fixed:.3g} m per step, further than "
                                           "the "
                       f"radius of the smallest sphere, {radius:.3g} m",
                       "leave out 'time_step' for an automatic step, or slow down the wall")  # fmt: skip
        return max(speeds.values(), default=0.0)

    def _steps_since_estimate(self) -> float:
        """Return the number of steps since the last stable step estimate; infinite if a new estimate is required."""
        if not self._estimated:
            return math.inf
        flags = self.batch.host_flags()[self.index]
        return float(flags[int(STEPS)] - flags[int(ESTIMATED)])

    def reaching(self, goal: Until | Steps) -> Coroutine:
        """Advance the scene to `goal`, which is a time or a number of steps of the current size.

        A goal in time is exceeded by less than one step. This coroutine yields whenever the batch must launch steps. It
        must be resumed when the scene has halted, because it has reached the goal or needs a new estimate of its stable
        step.
        """
        if isinstance(goal, Steps):
            yield from self._take_steps(goal.count)
            return
        while True:
            self._set_step()
            if self._steps_since_estimate() >= self.time_step.interval:
                self.choose_dt()
            if not goal.time - self.time > CLOSE * self.dt:
                return
            self._goal_is_steps = False
            self.batch.set_goal(self.index, until=goal.time, interval=self.time_step.interval)
            yield

    def _take_steps(self, count: int) -> Coroutine:
        if not self._estimated:
            self.choose_dt()
        if count > 0:
            self._goal_is_steps = True
            self.batch.set_goal(self.index, steps=self.steps + count)
            yield

    def wants_estimate(self) -> bool:
        """Return whether the goal of the scene is a number of steps and an estimate of the stable time step is due.

        All steps to such a goal have the same length, so no estimate interrupts them. An estimate can therefore be
        overdue when the scene reaches its goal.
        """
        self._set_step()
        return self._goal_is_steps and self._steps_since_estimate() >= self.time_step.interval

    def advance(self, until: float) -> None:
        """Advance only the scene of this stepper to the time `until` [s], or beyond this time by less than one step."""
        drive_one(self, self._yield_goal(Until(until)))

    def take(self, count: int) -> None:
        """Advance only the scene of this stepper by `count` steps of the current size."""
        drive_one(self, self._yield_goal(Steps(count)))

    @staticmethod
    def _yield_goal(goal: Until | Steps) -> Coroutine:
        yield goal

    def failure(self, flags: np.ndarray) -> Exception | None:
        """Return the exception to raise if the control flags `flags` of the scene report a failure; otherwise None."""
        failed = int(flags[int(FAILED)])
        if failed < 0:
            wall = self.model.walls[-1 - failed].name
            return InstabilityError(
                f"driven wall {wall!r} moves faster than {SPEED_LIMIT:g} m/s",
                time=self.time,
                cure="more mass or damping of the wall, a smaller time step",
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
        """Return whether the scene has halted because it has reached its goal or needs an estimate of its stable step.

        In both cases the coroutine from `reaching` must be resumed: it makes the estimate if one is due, and ends if
        the goal is reached. `flags` contains the control flags of the scene.
        """
        return int(flags[int(HALTED)]) == int(ARRIVED)


def steppers_of(
    models: list[Model],
    states: list[State],
    *,
    time_steps: list[TimeStep] | None = None,
    resumed: list[StepperRecord | None] | None = None,
    threads: int = 1,
) -> list[Stepper]:
    """Create a batch of scenes that have equal :func:`batch_key`, and return a stepper for each scene.

    Each list has one entry for each scene. `time_steps` contains the settings of the time step, by default automatic.
    `resumed` contains the `state_dict` of an earlier stepper, or None for a scene that starts anew.
    """
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
