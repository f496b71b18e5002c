"""The step loop: launches stages many at a time, rebuilds lists when asked, adapts the step size."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp

from .dem import StableStep, make_bonds, reassign_bonds, step_stages
from .errors import CapacityError, InstabilityError, refuse
from .kernels.types import DT, DT_PREVIOUS, FAILED, OVERFLOW, STALE, STEPS, TIME
from .kernels.wall_motion import SPEED_LIMIT
from .model import Model
from .neighbors import NeighborLists
from .scene import Bonds, TimeStep
from .state import State
from .watch import unstable

SKIN = 0.35  # of the mean sphere radius; the cost of a pumping step is flat from 0.3 to 0.75


class Stepper:
    """Carries a state forward in time.

    A state whose lists no longer cover every possible contact freezes itself on the device: the kernels
    return at once until the lists are rebuilt. So no contact is missed, however many steps are in flight.
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
        memory: dict[str, Any] | None = None,
    ) -> None:
        self.model, self.state, self.time_step = model, state, time_step
        radii = state.sphere_offset.numpy()[:, 3]
        mean = float(radii.mean()) if len(radii) else 1.0
        self.skin = SKIN * mean if skin is None else skin
        if memory is not None:
            self.skin = memory["skin"]
        self.lists = NeighborLists(model, state, skin=self.skin, mesh_skin=4 * self.skin, sort_every=sort_every)
        self.stable_step = StableStep(model, state, time_step.interval * time_step.largest)
        self._settings = dict(local_damping=local_damping, growth_rate=growth_rate, growth_end=growth_end)
        self._graphs: dict[int, wp.Graph] = {}
        self._since_estimate = math.inf
        self.running = False  # until then an unstable fixed step is bad input, later an instability
        if memory is None:
            self.rebuild()
        else:
            self.lists.builds, self._since_estimate = memory["builds"], memory["since_estimate"]
            self._record()

    def memory(self) -> dict[str, Any]:
        """What a stepper needs, besides the state, to go on as this one would."""
        return {"skin": self.skin, "builds": self.lists.builds, "since_estimate": self._since_estimate}

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return float(self.state.clock.numpy()[int(TIME)])

    @property
    def steps(self) -> int:
        """Completed steps."""
        return int(self.state.flags.numpy()[int(STEPS)])

    @property
    def dt(self) -> float:
        """Size of the next step [s]."""
        return float(self.state.clock.numpy()[int(DT)])

    def change(self, **settings: float) -> None:
        """Change `local_damping`, `growth_rate` or `growth_end` from the next step on."""
        self._settings.update(settings)
        self._record()

    def rebuild(self) -> None:
        """Build the lists anew."""
        if self.lists(self.model, self.state) or not hasattr(self, "stages"):
            self._record()

    def bond(self, bonds: Bonds, kind: int, group: int = -1) -> int:
        """Bond pairs within `bonds.gap` (inside a `group` only, if given); returns how many of `kind` there are."""
        usual = self.lists.skin
        self.lists.skin = max(usual, 1.001 * bonds.gap)
        self.rebuild()
        made = make_bonds(self.model, self.state, bonds, kind, group)
        self.lists.skin = usual
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
        clock = state.clock.numpy()
        clock[[int(TIME), int(DT_PREVIOUS)]] = 0.0
        state.clock.assign(clock)
        state.flags.zero_()
        for array in (
            state.wall_impulse, state.wall_angular_impulse, state.wall_travel, state.wall_work, state.wall_step_force,
            state.sphere_lost,
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

    def choose_dt(self) -> float:
        """Estimate the stable step and set the size of the next steps [s]."""
        stable = self.stable_step(self.model, self.state)
        fixed = self.time_step.fixed
        if fixed is not None:
            if fixed > stable * max(1.0, self.time_step.safety):
                what = f"is above the stable step of this scene, {stable:.3g} s"
                if self.running:
                    raise InstabilityError(
                        f"t = {self.time:.6g} s: time_step = {fixed!r} {what}; usual cures: a smaller step, or none "
                        "given for an automatic one"
                    )
                refuse("time_step", fixed, what, "leave it out for an automatic step")
            dt = fixed
        else:
            dt = min(self.time_step.safety * stable, self.time_step.largest)
        clock = self.state.clock.numpy()
        clock[int(DT)] = dt
        self.state.clock.assign(clock)
        self._since_estimate = 0
        return dt

    def advance(self, until: float) -> None:
        """Step until the simulated time reaches `until` [s], to within one step."""
        while True:
            dt = self.dt
            if self._since_estimate >= self.time_step.interval:
                dt = self.choose_dt()
            left = math.ceil((until - self.time) / dt - 1e-6)
            if left <= 0:
                return
            self.take(min(left, self.time_step.interval - int(self._since_estimate)))

    def take(self, count: int) -> None:
        """Take `count` steps of the present size."""
        goal = self.steps + count
        if self._since_estimate == math.inf:
            self.choose_dt()
        if self.model.device.is_cuda:
            while (left := goal - self.steps) > 0:
                self._launch_graph(left)
                self._attend()
        else:
            flags = self.state.flags.numpy()  # a view: reading it costs nothing
            while flags[int(STEPS)] < goal:
                for stage in self.stages:
                    stage()
                if flags[int(STALE)] or flags[int(FAILED)] or flags[int(OVERFLOW)]:
                    self._attend()
        self._since_estimate += count

    def _attend(self) -> None:
        flags = self.state.flags.numpy()
        if flags[int(FAILED)] < 0:
            wall = self.model.walls[-1 - int(flags[int(FAILED)])].name
            raise InstabilityError(
                f"t = {self.time:.6g} s: driven wall {wall!r} is faster than {SPEED_LIMIT:g} m/s; "
                "usual cures: more mass or damping of the wall, a smaller time step"
            )
        if flags[int(FAILED)]:
            place = int(flags[int(FAILED)]) - 1
            body = int(self.state.body_id.numpy()[place])
            speed = float(np.linalg.norm(self.state.body_velocity.numpy()[place]))
            limit = self.model.scene.watch.speed
            raise unstable(
                self.time,
                body,
                f"speed goes from {speed:.3g} m/s past watch.speed = {limit:g} m/s in one step, or is not a number",
            )
        if flags[int(OVERFLOW)]:
            raise CapacityError(
                f"at t = {self.time:.6g} s a sphere touches a mesh wall in more than six directions at once; "
                "use finer aggregates or a coarser mesh"
            )
        if flags[int(STALE)]:
            self.rebuild()

    def _record(self) -> None:
        self.stages = step_stages(
            self.model, self.state, skin=self.skin, mesh_skin=self.lists.mesh_skin, **self._settings
        )
        self._graphs.clear()

    def _launch_graph(self, count: int) -> None:
        # Powers of two, so that few graphs serve every count.
        size = 1 << (count.bit_length() - 1)
        if size not in self._graphs:
            for stage in self.stages:  # load every kernel before capture; on a frozen state nothing moves
                wp.load_module(stage.kernel.module, device=self.model.device)
            with wp.ScopedCapture(device=self.model.device) as capture:
                for _ in range(size):
                    for stage in self.stages:
                        stage()
            self._graphs[size] = capture.graph
        wp.capture_launch(self._graphs[size])
