"""Trial of contact laws that are defined outside this package: forces, energies and reach between two bodies.

A kernel moves two equal spheres, or a sphere and a wall, along prescribed paths and calls the functions of the law in
the same way as the kernels of a run. The checks compare the returned values with each other. They do not use the
formulas of the law, so they apply to any law:

- The work that `force` does along a path is the change of `energy` plus the energy lost.
- `stiffness` returns at least half of the stiffness that follows from `force`, because this value limits the time step.
- A force at rest has no part along the contact plane, and friction and dashpots act against the motion.
- All laws of a scene begin to push at the same overlap. This overlap is 0, or twice the thickness of the stones' coats;
  a coat is a layer around a stone that other spheres may enter.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import warp as wp

from ...core.errors import SceneError, refuse
from ...core.inputs.limits import warn
from ...kernels.common.types import types
from ...kernels.dem.law_trial import law_trial_kernel
from .base import ContactLaw, own_laws
from .own import check_object, explained, packing_law

STEPS = 2000
"""Number of steps in which the path of a trial reaches its deepest overlap."""
DEEPEST = 0.5
"""Deepest overlap on the path of a trial, divided by the radius of the spheres."""
FIRST_STEP = 60
"""First step at which work and energy are compared. If the force jumps at the beginning of a contact, the work cannot
be summed accurately over fewer steps."""
ENERGY_TOLERANCE = 0.05
"""Largest difference of work and energy, divided by the work that was done so far."""
TOLD_SHARE = 0.5
"""Minimum stiffness or dashpot that `stiffness` may return, divided by the value that follows from `force`."""
ONSET_TOLERANCE = 0.01
"""Largest difference between the overlaps at which two laws begin to push, divided by the radius."""
SLOW, PROBE = 1e-4, 1e-2
"""Speeds of a slow path and of an impact, divided by the square root of `stress_scale` / density."""
ROUNDING = 1e-3
"""Smallest fraction of a force, or of an energy, that is too large to be a rounding error."""
NORMAL, ALONG = np.array([0.6, 0.0, 0.8]), np.array([0.0, 1.0, 0.0])
"""Normal of the contact, and direction in which body b slides, in `kernels/dem/law_trial.py`."""
STIFFNESSES = (("k_n", "N/m"), ("k_s", "N/m"), ("c_n", "N s/m"), ("c_s", "N s/m"))
"""Names and units of the four values that `stiffness` returns."""
STRESS_FACTOR = 30.0
"""Factor by which `stress_scale` may be larger or smaller than F / d^2, where F is the force of the law at the overlap
d between two spheres of diameter d."""


@dataclass(frozen=True)
class Circumstances:
    """Spheres and settings with which the contact laws of a scene are tried."""

    radius: float
    """Radius of the spheres with which a contact law is tried [m]."""
    density: float
    """Density of the spheres with which a contact law is tried [kg/m3]."""
    bonds: bool
    """True if the scene has bonds; contact laws are then called for pairs that do not touch."""
    losses: bool
    """True if the run sums up the energy lost, so that the losses of a contact law must be right."""
    scalar: Any
    """Floating-point type of the kernels, `wp.float32` or `wp.float64`."""
    device: Any
    """Device on which the law is tried, a Warp device."""

    @property
    def mass(self) -> float:
        """Mass of one sphere in the trial of a contact law [kg]."""
        return self.density * 4 / 3 * math.pi * self.radius**3


def check_own_laws(bodies: Iterable[ContactLaw], walls: Iterable[ContactLaw], where: Circumstances) -> None:
    """Try all contact laws of a scene, if any of them is defined outside this package.

    `bodies` contains the laws between bodies, and `walls` contains the laws on walls. `where` holds the spheres and
    settings of the trial. Raises :class:`SceneError` with the name of the function that is wrong, its result and a
    hint. The trial includes the laws for packing that the method `frictionless` returns.
    """
    laws = list({id(law): law for law in (*bodies, *walls)}.values())
    if not own_laws(laws):
        return
    first: _Onset | None = None
    for law in laws:
        onset = _tried(law, type(law).__name__, where)
        if own_laws([law]):
            packing = packing_law(law, ContactLaw)
            _same_reach(onset, _tried(packing, f"{type(law).__name__}.frictionless()", where), where)
        first = first or onset
        _same_reach(first, onset, where)


@dataclass(frozen=True)
class _Onset:
    """Overlaps [m] at which a law begins to push apart two spheres (`pair`), or a sphere and a wall (`wall`).

    An overlap is None if the force does not grow with the overlap.
    """

    name: str
    pair: float | None
    wall: float | None


def _same_reach(one: _Onset, other: _Onset, where: Circumstances) -> None:
    """Raise :class:`SceneError` if two laws begin to push at different overlaps.

    The overlaps may differ by ONSET_TOLERANCE times the radius of the spheres.
    """
    for what, right, wrong in (("two spheres", one.pair, other.pair), ("a sphere and a wall", one.wall, other.wall)):
        if right is not None and wrong is not None and abs(right - wrong) > ONSET_TOLERANCE * where.radius:
            refuse(
                other.name,
                f"begins to push {what} apart at an overlap of {wrong:.3g} m",
                f"must begin at {right:.3g} m like {one.name}, because all stones have a coat of the same thickness, a "
                "layer in which stones may overlap and only pull on each other; the coat is half as thick as the reach "
                "of the pull",
                "give both laws the same reach; to leave out a pull, set its force to 0, but not its reach",
            )


def _tried(law: ContactLaw, name: str, where: Circumstances) -> _Onset:
    """Check a contact law if a user wrote it, and return the overlaps at which it begins to push.

    `where` holds the spheres and settings of the trial, and `name` is the name of the law in messages.
    """
    own = bool(own_laws([law]))
    if own:
        check_object(law)
    depth = DEEPEST * where.radius * np.linspace(0, 1, STEPS + 1) ** 2
    path = np.concatenate([depth, depth[-2::-1]])
    speed = math.sqrt(law.stress_scale / where.density)
    dt = depth[-1] / (SLOW * speed) / STEPS
    rest = _march(law, where, dt, 1, -path, -np.gradient(path) / dt, 0.0)
    if own:
        _check_rest(law, rest, path)
        _check_work(law, rest, path)
        _check_motion(law, where, depth[FIRST_STEP::FIRST_STEP], PROBE * speed)
        if where.losses:
            dt = depth[-1] / (PROBE * speed) / STEPS
            impact = _march(law, where, dt, 1, -path, -np.gradient(path) / dt, PROBE * speed)
            _check_work(law, impact, path)
        if where.bonds:
            _check_gap(law, _march(law, where, dt, 0, 0.01 * where.radius + path, 0.0, 0.0))
    return _Onset(name, *(_onset(depth, push[: STEPS + 1]) for push in rest.push))


def _onset(depth: np.ndarray, push: np.ndarray) -> float | None:
    """Return the overlap at which a pushing force begins to grow [m]; None if it does not grow.

    `push` contains the forces [N] at the overlaps `depth` [m].
    """
    growth = push - np.minimum.accumulate(push)
    limit = max(1e-6 * growth[-1], 1e-5 * np.abs(push).max())
    return float(depth[np.argmax(growth > limit)]) if growth[-1] > limit else None


def _march(
    law: ContactLaw, where: Circumstances, dt: float, keep: int, gap: np.ndarray, opening: Any, sliding: Any
) -> SimpleNamespace:
    """Return the results of a law's functions along a path of two spheres and along the same path at a wall.

    The path has one value per step: the `gap` [m], the speed `opening` at which the gap grows [m/s], and the `sliding`
    speed [m/s]. With `keep` = 0, each step begins with a zero history. The results have the shape (2, steps, ...). The
    first index is 0 for the two spheres and 1 for the wall.
    """
    scalar, device = where.scalar, where.device
    three, four = types(scalar).vec3, types(scalar).vec4
    path = [np.broadcast_to(each, (2, len(gap))) for each in (gap, opening, sliding)]
    kinds = (three, three, scalar, four, scalar, three, three)
    results = [wp.zeros(path[0].shape, dtype=kind, device=device) for kind in kinds]
    try:
        kernel = law_trial_kernel(scalar, type(law))
        row = wp.array([law.on_device(scalar)], dtype=law.functions(scalar).Parameters, device=device)
        inputs = [row, keep, dt, where.radius, where.mass, *(wp.array(x, dtype=scalar, device=device) for x in path)]
        wp.launch(kernel, dim=2, inputs=[*inputs, *results], device=device)
    except SceneError:
        raise
    except Exception as error:  # Warp raises many kinds of exceptions for code that it cannot compile.
        explained(type(law), error)
    force, history, lost, stiffness, energy, moment, _ = (each.numpy().astype(float) for each in results)
    push = -force @ NORMAL
    along = force + push[..., None] * NORMAL
    power = -push * path[1] + (force @ ALONG + moment @ np.cross(NORMAL, ALONG) / where.radius) * path[2]
    return SimpleNamespace(
        force=force,
        push=push,
        along=along,
        side=force @ ALONG,
        history=history,
        lost=lost,
        stiffness=stiffness,
        energy=energy,
        work=power * dt,
    )


def _check_rest(law: ContactLaw, found: SimpleNamespace, depth: np.ndarray) -> None:
    """Check values along a slow path, on which a contact closes and opens again and only its springs act.

    `found` contains the results of :func:`_march` along this path, which has no sliding. `depth` is the overlap at each
    of its steps [m].
    """
    name = type(law).__name__
    for label in ("force", "stiffness", "energy"):
        wrong = np.argwhere(~np.isfinite(getattr(found, label)))
        if len(wrong):
            refuse(
                f"{name}.{label}()",
                float(getattr(found, label)[tuple(wrong[0])]),
                f"must be a finite number, also at an overlap of {depth[wrong[0][1]]:.3g} m",
                "avoid roots of negative numbers, and divisions by zero at the gap 0",
            )
    low = found.stiffness.min(axis=(0, 1))
    if low.min() < 0:
        label, unit = STIFFNESSES[int(low.argmin())]
        refuse(
            f"{name}.stiffness()",
            f"{label} = {low.min():.3g} {unit}",
            "must not be negative",
            "return 0 where the force falls with the overlap or with the speed",
        )
    if not law.has_history and np.abs(found.history).max() > 0:
        refuse(
            f"{name}.has_history",
            False,
            "must be True, because force() returns a new history",
            "set has_history = True, or return the history unchanged",
        )
    aside, size = np.abs(found.along).max(), np.abs(found.force).max()
    if aside > ROUNDING * size:
        refuse(
            f"{name}.force()",
            f"{aside:.3g} N along the contact plane",
            "must be along touch.normal while the bodies do not slide",
            "multiply the force at rest by touch.normal",
        )
    push = found.push[0, : STEPS + 1]
    if push.max() <= 0 and push.min() < 0:
        refuse(
            f"{name}.force()",
            f"a pull of {-push.min():.3g} N at an overlap of {depth[push.argmin()]:.3g} m",
            "must push overlapping stones apart; the normal points from body a to body b, and the force acts on body a",
            "return the opposite sign, or make the spring stiffer or the pull weaker or shorter",
        )
    zero, most = np.abs(found.energy[:, 0]).max(), np.abs(found.energy).max()
    if zero > ROUNDING * most:
        refuse(
            f"{name}.energy()",
            f"{zero:.3g} J at the gap 0",
            "must be 0 J there if the history is zero",
            "subtract this constant",
        )
    # While the gap closes, a dashpot increases the force; while the gap opens, it decreases the force by the same
    # amount. The mean of these two forces is therefore the force of the springs.
    spring = 0.5 * (found.push[:, : STEPS + 1] + found.push[:, : STEPS - 1 : -1])
    slope = np.diff(spring[:, FIRST_STEP:]) / np.diff(depth[FIRST_STEP : STEPS + 1])
    told = np.maximum(found.stiffness[:, FIRST_STEP:STEPS, 0], found.stiffness[:, FIRST_STEP + 1 : STEPS + 1, 0])
    short = slope * TOLD_SHARE - told
    if short.max() > ROUNDING * told.max():
        place = np.unravel_index(short.argmax(), short.shape)
        refuse(
            f"{name}.stiffness()",
            f"k_n = {told[place]:.3g} N/m at an overlap of {depth[FIRST_STEP + place[1]]:.3g} m",
            f"must be at least the slope of force(), which is {slope[place]:.3g} N/m, so that steps are stable",
            "return the derivative of the force with respect to the overlap",
        )
    # `stress` is F / d^2, where d is the diameter of the stones and F is the force of a linear spring at the overlap d.
    # The deepest overlap of the path is DEEPEST d / 2, so F is 2 / DEEPEST times the force there.
    stress = push[-1] * (2 / DEEPEST) / (2 * depth.max() / DEEPEST) ** 2
    if stress > 0 and not 1 / STRESS_FACTOR < law.stress_scale / stress < STRESS_FACTOR:
        warn(
            f"{name}.stress_scale = {law.stress_scale:.3g} Pa: force() gives a stress of {stress:.3g} Pa in a deep "
            "contact; return F / d^2, where F is the force between two stones of diameter d at the overlap d"
        )


def _check_work(law: ContactLaw, found: SimpleNamespace, depth: np.ndarray) -> None:
    """Check that the work done against the force on a path equals the change of the stored energy plus the energy lost.

    `found` contains the results of :func:`_march` along the path, and `depth` is the overlap at each of its steps [m].
    """
    name = type(law).__name__
    step = found.work.copy()
    step[:, 0] = step[:, 1]  # At a gap of exactly 0, some laws return no force yet. Use the next step instead.
    step = 0.5 * (step[:, 1:] + step[:, :-1])
    work, scale = np.cumsum(step, axis=1), np.cumsum(np.abs(step), axis=1)
    lost = np.cumsum(found.lost[:, 1:], axis=1)
    stored = found.energy[:, 1:] - found.energy[:, :1]
    error = np.where(
        np.arange(step.shape[1]) < FIRST_STEP, 0.0, np.abs(stored + lost - work) - ENERGY_TOLERANCE * scale
    )
    wall, k = np.unravel_index(error.argmax(), error.shape)
    if error[wall, k] <= ROUNDING * scale.max() * ENERGY_TOLERANCE:
        return
    what, overlap = ("at a wall" if wall else "between two spheres"), depth[k + 1]
    right, now = work[wall, k] - lost[wall, k], stored[wall, k]
    if k < STEPS and abs(lost[wall, k]) < ENERGY_TOLERANCE * scale[wall, k]:
        opposite = abs(now + right) < 2 * ENERGY_TOLERANCE * scale[wall, k]
        refuse(
            f"{name}.energy()",
            f"{now:.3g} J at an overlap of {overlap:.3g} m {what}",
            f"must be {right:.3g} J there, the work done against force() since the overlap was 0",
            "return the opposite sign" if opposite else "integrate the force over the overlap, without dashpots",
        )
    refuse(
        f"{name}.force()",
        f"an energy loss of {lost[wall, k]:.3g} J up to an overlap of {overlap:.3g} m {what}",
        f"must be {work[wall, k] - now:.3g} J, the work done against the force minus the change of energy()",
        "return as third value the energy that dashpots and slip dissipate in the step; energy that a spring stores "
        "belongs to energy()",
    )


def _check_motion(law: ContactLaw, where: Circumstances, depth: np.ndarray, speed: float) -> None:
    """Check that dashpots and friction act against the motion and that `stiffness` is large enough for them.

    The bodies approach, separate and slide at the `speed` [m/s]; each motion is tested at the overlaps `depth` [m].
    """
    name = type(law).__name__
    dt = 1e-3 * depth[0] / speed
    closing, opening = (_march(law, where, dt, 0, -depth, sign * speed, 0.0) for sign in (-1, 1))
    sliding, slid = (_march(law, where, step, 0, -depth, 0.0, speed) for step in (0.0, dt))
    size = np.abs(slid.force).max()
    dashpot = (closing.push - opening.push) / (2 * speed)
    if dashpot.min() * speed < -ROUNDING * size:
        refuse(
            f"{name}.force()",
            f"a normal dashpot of {dashpot.min():.3g} N s/m",
            "must resist the motion; touch.velocity is the velocity of body b relative to body a",
            "return the opposite sign of the normal dashpot",
        )
    if slid.side.min() < -ROUNDING * np.abs(slid.side).max():
        refuse(
            f"{name}.force()",
            f"a shear force of {slid.side.min():.3g} N on body a, positive in the direction in which body b slides",
            "must be positive, because body b drags body a along; touch.velocity is the velocity of body b relative to "
            "body a",
            "return the opposite sign of the shear force",
        )
    if not law.has_shear and np.abs(slid.along).max() > ROUNDING * size:
        refuse(
            f"{name}.has_shear",
            False,
            f"must be True, because force() returns a shear force of "
            f"{np.abs(slid.along).max():.3g} N, which turns the bodies",
            "set has_shear = True",
        )
    if not law.has_history and np.abs(slid.history).max() > 0:
        refuse(
            f"{name}.has_history",
            False,
            "must be True, because force() returns a new history",
            "set has_history = True, or return the history unchanged",
        )
    spring = (slid.side - sliding.side) / (speed * dt)
    for number, acts in ((1, spring), (2, dashpot), (3, sliding.side / speed)):
        label, unit = STIFFNESSES[number]
        told = closing.stiffness[..., number]
        short = TOLD_SHARE * acts - told
        if short.max() > ROUNDING * np.abs(acts).max():
            place = np.unravel_index(short.argmax(), short.shape)
            refuse(
                f"{name}.stiffness()",
                f"{label} = {told[place]:.3g} {unit} at an overlap of {depth[place[1]]:.3g} m",
                f"must be at least {acts[place]:.3g} {unit}, the value that follows from force(), for stable steps",
                f"return a larger {label} from stiffness(), whose four values are k_n, k_s, c_n and c_s, in this order",
            )


def _check_gap(law: ContactLaw, found: SimpleNamespace) -> None:
    """Check that a law returned no force at positive gaps, where scenes with bonds call it.

    `found` contains the results of :func:`_march` along a path of positive gaps.
    """
    most = np.abs(found.force).max()
    if most > 0:
        refuse(
            f"{type(law).__name__}.force()",
            f"{most:.3g} N at a positive gap",
            "must be 0 N there, because the law is also called for bonded bodies that do not touch",
            "multiply the force by wp.where(touch.gap < 0, 1, 0)",
        )
