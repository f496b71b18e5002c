"""Stepping: a scene's own course through a batch, and the loop that carries all of them forward."""

from __future__ import annotations

import math
from collections.abc import Generator
from typing import Any

import numpy as np

from .batch import Batch
from .dem import StableStep, foreseen_speed, make_bonds, reassign_bonds
from .errors import CapacityError, InstabilityError, refuse
from .interrupts import put_off
from .kernels.types import DT_PREVIOUS, FAILED, OVERFLOW, STALE, STEPS, TIME
from .kernels.wall_motion import SPEED_LIMIT
from .model import Model
from .neighbors import NeighborLists
from .scene import Bonds, MeshWall, TimeStep
from .state import State
from .watch import unstable

# Skin over the mean sphere radius. On a CPU the cost of a pumping step is flat from 0.3 to 0.75; a GPU steps so fast
# that rebuilding less often pays (142, 116, 111 us a step at 0.35, 0.6, 0.9).
SKIN = {"cpu": 0.5, "cuda": 0.7}
MESH_SKIN = 4  # times the skin

Course = Generator[None, None, Any]
"""What a scene does, as a generator: each `yield` waits until the scene has reached the goal that it set."""


class Stepper:
    """One scene of a batch: its step size, goals and bonds. Alone, it is a batch of one.

    Methods that take steps come twice: `advancing` is a course, to be driven with those of other scenes; `advance`
    drives it to its end.
    """

    def __init__(
        self,
        model: Model,
        state: State,
        time_step: TimeStep,
        *,
        local_damping: float = 0.0,
        growth_rate: float = 0.0,
        growth_end: float = 1.0,
        skin: float | None = None,
        sort_every: int = 20,
        threads: int = 1,
        memory: dict[str, Any] | None = None,
        among: tuple[NeighborLists, StableStep, int] | None = None,
    ) -> None:
        """`among` are lists and estimate of a batch, and the scene's number in it; None makes a batch of one."""
        self.model, self.state, self.time_step = model, state, time_step
        if among is None:
            batch = Batch([model], [state], threads=threads)
            among = NeighborLists(batch), StableStep(batch), 0
        self.lists, self._estimate, self.index = among
        self.batch = self.lists.batch
        mean = state.mean_radius
        self.skin = SKIN["cuda" if self.batch.is_cuda else "cpu"] * mean if skin is None else skin
        if memory is not None:
            self.skin = memory["skin"]
        moving_mesh = any(isinstance(wall, MeshWall) and wall.motion is not None for wall in model.walls)
        self.mesh_skin = MESH_SKIN * self.skin
        self.lists.sort_every[self.index] = sort_every
        self.batch.set(
            self.index,
            skin=self.skin,
            mesh_skin=self.mesh_skin,
            # What spheres and moving meshes may go between two builds adds up to the skin.
            sphere_share=0.5 * self.mesh_skin if moving_mesh else self.mesh_skin,
            local_damping=local_damping,
            growth_rate=growth_rate,
            growth_end=growth_end,
        )
        self._since_estimate = math.inf
        self._foreseen = -1.0, 0.0
        self.running = False  # until then an unstable fixed step is bad input, later an instability
        if memory is not None:
            self.lists.builds[self.index], self._since_estimate = memory["builds"], memory["since_estimate"]
        if memory is None or self.index in self.batch.rechunked:
            self.rebuild()

    def memory(self) -> dict[str, Any]:
        """What a stepper needs, besides the state, to go on as this one would."""
        return {
            "skin": self.skin,
            "builds": int(self.lists.builds[self.index]),
            "since_estimate": self._since_estimate,
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
        """Change `local_damping`, `growth_rate` or `growth_end` from the next step on."""
        self.batch.set(self.index, **settings)

    def rebuild(self) -> None:
        """Build the lists anew."""
        self._set_flags(STALE, 1)
        self.lists()

    def bond(self, bonds: Bonds, kind: int, group: int = -1) -> int:
        """Bond pairs within `bonds.gap` (inside a `group` only, if given); returns how many of `kind` there are."""
        self.batch.set(self.index, skin=max(self.skin, 1.001 * bonds.gap))
        self.rebuild()
        made = make_bonds(self.model, self.state, bonds, kind, group)
        self.batch.set(self.index, skin=self.skin)
        self.rebuild()
        self._since_estimate = math.inf
        return made

    def hydrate(self, old: int, new: int, share: float, seed: int) -> int:
        """Give a random share of the bonds of kind `old` the properties of kind `new`; returns how many have them."""
        self._since_estimate = math.inf
        return reassign_bonds(self.model, self.state, old, new, share, seed)

    def restart_clock(self) -> None:
        """Set time, step count and the walls' records to zero; the next kick is a half one."""
        state = self.state
        self.batch.changed()
        clock = state.clock.numpy()
        clock[0, [int(TIME), int(DT_PREVIOUS)]] = 0.0
        state.clock.assign(clock)
        state.flags.zero_()
        self.batch.changed()
        for array in (
            state.wall_impulse, state.wall_angular_impulse, state.wall_travel, state.wall_work, state.sphere_lost,
            state.sphere_broken,
        ):  # fmt: skip
            array.zero_()
        self._since_estimate = math.inf
        self.rebuild()

    def stop_motion(self) -> None:
        """Set all velocities to zero."""
        state = self.state
        for array in (state.body_velocity, state.body_spin, state.body_angular_momentum, state.sphere_spin):
            array.zero_()
        velocity = state.sphere_velocity.numpy().copy()
        velocity[:, :3] = 0.0
        state.sphere_velocity.assign(velocity)

    def estimate(self) -> float:
        """The stable step as things are now, without safety factor [s]; infinite for a state without bodies."""
        self._set_step()
        self._estimate(self.index)
        return self.state.stable_step if self.state.body_count else math.inf

    def _set_step(self) -> None:
        step = self.time_step
        horizon = step.interval * step.largest
        if self._foreseen[0] != horizon:
            self._foreseen = horizon, foreseen_speed(self.model.scene, horizon)
        self.batch.set(
            self.index,
            safety=step.safety,
            largest_step=step.largest,
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
                f"t = {self.time:.6g} s: the stable time step came out as {stable:.3g} s; usual cures: masses, "
                "stiffnesses and dashpots that single precision can hold, or precision float64"
            )
        if fixed is not None and fixed > stable * max(1.0, self.time_step.safety):
            what = f"is above the stable step of this scene, {stable:.3g} s"
            if self.running:
                raise InstabilityError(
                    f"t = {self.time:.6g} s: time_step = {fixed!r} {what}; usual cures: a smaller step, or none "
                    "given for an automatic one"
                )
            refuse("time_step", fixed, what, "leave it out for an automatic step")
        self._since_estimate = 0
        return dt

    def advancing(self, until: float) -> Course:
        """Course: step until the simulated time reaches `until` [s], to within one step."""
        while True:
            dt = self.dt
            if self._since_estimate >= self.time_step.interval:
                dt = self.choose_dt()
            left = math.ceil((until - self.time) / dt - 1e-6)
            if left <= 0:
                return
            yield from self.taking(min(left, self.time_step.interval - int(self._since_estimate)))

    def taking(self, count: int) -> Course:
        """Course: take `count` steps of the present size."""
        if self._since_estimate == math.inf:
            self.choose_dt()
        if count > 0:
            self.batch.goal(self.index, self.steps + count)
            yield
        self._since_estimate += count

    def advance(self, until: float) -> None:
        """Step until the simulated time reaches `until` [s], to within one step."""
        drive_one(self, self.advancing(until))

    def take(self, count: int) -> None:
        """Take `count` steps of the present size."""
        drive_one(self, self.taking(count))

    def _set_flags(self, slot: Any, value: int) -> None:
        self.batch.changed()
        flags = self.state.flags.numpy()
        flags[0, int(slot)] = value
        self.state.flags.assign(flags)
        self.batch.changed()

    def trouble(self, flags: np.ndarray) -> Exception | None:
        """What a scene's flags complain about."""
        if flags[int(FAILED)] < 0:
            wall = self.model.walls[-1 - int(flags[int(FAILED)])].name
            return InstabilityError(
                f"t = {self.time:.6g} s: driven wall {wall!r} is faster than {SPEED_LIMIT:g} m/s; "
                "usual cures: more mass or damping of the wall, a smaller time step"
            )
        if flags[int(FAILED)]:
            place = int(flags[int(FAILED)]) - 1
            body = int(self.state.body_id.numpy()[place])
            speed = float(np.linalg.norm(self.state.body_velocity.numpy()[place]))
            limit = self.model.scene.watch.speed
            return unstable(
                self.time,
                body,
                f"speed goes from {speed:.3g} m/s past watch.speed = {limit:g} m/s in one step, or is not a number",
            )
        if flags[int(OVERFLOW)]:
            return CapacityError(
                f"at t = {self.time:.6g} s a sphere touches a mesh wall in more than six directions at once; "
                "use finer aggregates or a coarser mesh"
            )
        return None


def steppers_of(
    models: list[Model],
    states: list[State],
    *,
    time_steps: list[TimeStep] | None = None,
    memories: list[dict[str, Any] | None] | None = None,
    threads: int = 1,
) -> list[Stepper]:
    """Steppers of scenes that share one batch; :func:`warpcrete.batch.batch_key` tells which may."""
    batch = Batch(models, states, threads=threads)
    among = NeighborLists(batch), StableStep(batch)
    return [
        Stepper(
            model,
            state,
            time_steps[s] if time_steps else TimeStep(),
            memory=memories[s] if memories else None,
            among=(*among, s),
        )
        for s, (model, state) in enumerate(zip(models, states))
    ]


def drive(courses: dict[int, tuple[Stepper, Course]]) -> dict[int, Any]:
    """Drive the courses of scenes of one batch to their ends, by scene number; returns what each returned or raised.

    An interruption (Ctrl-C), wherever it falls, is raised inside every course that waits.
    """
    results: dict[int, Any] = {}
    waiting: set[int] = set()
    stop: KeyboardInterrupt | None = None

    def go_on(s: int, error: BaseException | None = None) -> None:
        nonlocal stop
        waiting.discard(s)
        course = courses[s][1]
        try:
            if error is None:
                next(course)
            else:
                course.throw(error)
        except StopIteration as end:
            results[s] = end.value
            if getattr(end.value, "interrupted", False):
                stop = stop or KeyboardInterrupt()
        except KeyboardInterrupt as interruption:
            results[s] = stop = interruption
        except Exception as failure:
            results[s] = failure
        else:
            waiting.add(s)

    for s in courses:
        go_on(s, stop)
    lists = next(iter(courses.values()))[0].lists if courses else None
    while waiting and lists is not None:
        try:
            if stop is None:
                flags = lists.batch.launch()
                for s in sorted(waiting):
                    if (error := courses[s][0].trouble(flags[s])) is not None:
                        go_on(s, error)
                if np.any(flags[:, int(STALE)]):
                    with put_off():
                        lists()
                for s in sorted(waiting):
                    if flags[s, int(STEPS)] >= lists.batch.goals[s]:
                        go_on(s, stop)
        except KeyboardInterrupt as interruption:
            stop = interruption
        except CapacityError as full:  # of the lists, which all scenes share
            for s in sorted(waiting):
                go_on(s, full)
        if stop is not None:
            for s in sorted(waiting):
                go_on(s, stop)
    return results


def drive_one(stepper: Stepper, course: Course) -> Any:
    """Drive one scene's course; returns what it returns, raises what it raises."""
    result = drive({stepper.index: (stepper, course)})[stepper.index]
    if isinstance(result, BaseException):
        raise result
    return result
