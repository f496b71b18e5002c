"""Verification of suspensions of many spheres: viscosity, yield stress, volumes, momentum and energy.

The spheres lie in a box. Along the first axis, the box ends at two walls that move in opposite directions along the
third axis. Along the second axis, it ends at two planes of symmetry, and along the third axis it is periodic. Spheres
cannot cross walls and planes of symmetry, so fewer of them lie there. All results therefore refer to the core of the
box: the middle half along the first and second axis. The results are the stress on the part of the walls beside the
core, the shear rate in the core, and the volume fraction in the core.
"""

from dataclasses import dataclass

import numpy as np

from ..mps.grid.geometry import MIRROR, OPEN_SIDE, ROUGH, WALL
from ..mps.grid.layout import Motion
from ..suspension.aggregates import Aggregates
from ..suspension.balance import Balance, step_with_balance, wall_friction
from ..suspension.flow import SuspensionFlow
from ..suspension.placing import random_places
from ..suspension.solve import Tolerances
from .case import Case, Row
from .suspensions import DENSITY, RADIUS, VISCOSITY, mortar_flow, take

RATE = 1e-5
"""Shear rate [1/s], so low that the inertia of the mortar does not matter."""
YIELD_STEPS = 30
MOVING_STEPS = 10
SEEDS = 3
"""Number of random arrangements of spheres over which results are averaged."""


@dataclass(frozen=True)
class Core:
    """Mean values in the core of a sheared suspension; the core is the middle part of the simulated box."""

    stress: float
    """Mean shear stress in the core (middle part) of the box, divided by the viscosity of the mortar [1/s]."""
    rate: float
    """Mean shear rate in the core (middle part) of the box [1/s]."""
    fraction: float
    """Volume fraction of the spheres in the core (middle part) of the box."""

    @property
    def viscosity(self) -> float:
        """Viscosity of the suspension, divided by that of the mortar."""
        return self.stress / self.rate


def suspension(
    fraction: float, seed: int, device: str, precision: str, *, across: int = 4, wide: int = 8, long: int = 6,
    rate: float = RATE, strain: float = 0.01, extra_density: float = 0.0, yield_stress: float = 0.0,
    coupled: float = 1e-4, friction: float = 0.0,
) -> SuspensionFlow:  # fmt: skip
    """Return a suspension of equal spheres at random places between two moving walls.

    `fraction` is the volume fraction of the spheres, and `across` the number of cells across a sphere. The simulated
    box is `wide` sphere diameters wide along the first two axes, and `long` sphere diameters long along the third axis.
    Each time step shears the suspension by the shear strain `strain` at the shear rate `rate` [1/s]. `extra_density` is
    the density of the spheres minus that of the mortar [kg/m3], `yield_stress` the yield stress of the mortar [Pa],
    `coupled` the tolerance of the coupled solve, and `friction` the coefficient of friction of the spheres.
    """
    width = 2 * RADIUS / across
    cells = (wide * across, wide * across, long * across)
    high = 0.5 * width * np.array(cells)
    radii = np.full(round(fraction * wide * wide * long * 6 / np.pi), RADIUS)
    centres = random_places(
        radii, -high, high, lambda x: (high - np.abs(x))[:, :2].min(1), np.random.default_rng(seed), periodic=True
    )
    assert centres is not None
    speed = float(high[0]) * rate
    return mortar_flow(
        cells, width, Aggregates(centres, radii, DENSITY + extra_density), device, precision,
        tolerances=Tolerances(coupled=coupled), friction=friction,
        sides=((WALL, WALL), (MIRROR, MIRROR), (OPEN_SIDE, OPEN_SIDE)),
        walls=[(lambda x: x[:, 0] + high[0], ROUGH + 1), (lambda x: high[0] - x[:, 0], ROUGH + 2)],
        motions=(Motion((0.0, 0.0, -speed)), Motion((0.0, 0.0, speed))), periodic=True, speed=speed,
        yield_stress=yield_stress, time_step=strain / rate, regularisation=1e2 / rate,
    )  # fmt: skip


def core_of(flow: SuspensionFlow) -> Core:
    """Return the mean values in the core (middle part) of a suspension at the end of the last step."""
    layout, inner = flow.state.layout, (slice(1, -1),) * 3
    wide, deep, long = layout.room.cells
    middle = slice(deep // 4, deep - deep // 4)
    friction = wall_friction(flow)[0][2, 0][:, 1:-1][:, middle]
    half = friction.shape[2] // 2
    pull = 0.5 * float(friction[..., :half].sum() - friction[..., half:].sum())
    velocity = flow.state.faces("velocity")[2][inner][:, middle].mean((0, 1))
    solid = flow.aggregates.cover.solid.numpy()[: flow.state.slots].reshape(flow.state.shape)[inner] / 2**20
    x = (np.arange(wide) + 0.5 - 0.5 * wide) * layout.spacing
    near = np.abs(x) < 0.25 * wide * layout.spacing
    return Core(
        stress=pull / (VISCOSITY * velocity_area(long, middle, layout.spacing)),
        rate=float(np.polyfit(x[near], velocity[near], 1)[0]),
        fraction=float(solid[:, middle].mean((0, 1))[near].mean()),
    )


def velocity_area(long: int, middle: slice, width: float) -> float:
    """Return the area of that part of a box wall that lies beside the core (middle part) of the box [m2].

    `long` is the number of cells along the third axis, `middle` the range of the core's cells along the second axis,
    and `width` the edge length of a cell [m].
    """
    return long * (middle.stop - middle.start) * width**2


def mean_core(cores: list[Core]) -> Core:
    """Return the mean stress, shear rate and volume fraction over the cores (middle parts) of several suspensions."""
    return Core(*(float(np.mean([getattr(c, name) for c in cores])) for name in ("stress", "rate", "fraction")))


def random_structure(fraction: float, seed: int, device: str, precision: str) -> Core:
    """Return the mean values in the core (middle part) of a suspension of randomly placed spheres after one time step.

    `fraction` is the volume fraction of the spheres. Within this step the flow hardly changes their places.
    """
    flow = suspension(fraction, seed, device, precision)
    flow.take(1)
    return core_of(flow)


def yield_factor(fraction: float, seed: int, bingham: float, device: str, precision: str) -> tuple[float, float]:
    """Return the factor by which spheres at random places raise the yield stress, and the expected factor.

    `bingham` is the yield stress of the mortar, divided by its viscosity and by the shear rate of the box. The factor
    follows from the stress in the core (middle part) of the box minus the stress without yield stress at the same shear
    rate; the difference is divided by the yield stress of the mortar. The expected factor is sqrt((1 - fraction) f),
    where f is the computed relative viscosity of the same structure (Chateau, Ovarlez & Trung 2008).
    """
    plain = random_structure(fraction, seed, device, precision)
    flow = suspension(
        fraction, seed, device, precision, strain=1e-3, yield_stress=bingham * VISCOSITY * RATE, coupled=1e-3
    )
    flow.take(YIELD_STEPS)
    core = core_of(flow)
    factor = (core.stress - plain.viscosity * core.rate) / (bingham * RATE)
    return factor, float(np.sqrt((1 - plain.fraction) * plain.viscosity))


def high_frequency_viscosity(fraction: float) -> float:
    """Return the relative viscosity of a suspension whose spheres are arranged at random, as in a fluid at rest.

    `fraction` is the volume fraction of the spheres, which do not touch each other. The formula of Lionberger & Russel
    (1994) is a fit to the simulations of Ladd (1990).
    """
    part = fraction * (1 + fraction - 0.189 * fraction**2)
    return (1 + 1.5 * part) / (1 - part)


def balance_case(device: str, precision: str) -> list[Row]:
    """Check that power and momentum are balanced in steps with moving walls, weight, contacts and yield stress."""
    # The errors are proportional to the tolerance of the coupled solve, which single precision limits to about 1e-5.
    coupled, allowed = (3e-5, 5e-4) if precision == "float32" else (3e-10, 5e-9)
    flow = suspension(
        0.35, 0, device, precision, wide=4, long=4, rate=1.0, strain=0.05, extra_density=400.0, yield_stress=20.0,
        coupled=coupled,
    )  # fmt: skip
    steps: list[Balance] = [step_with_balance(flow) for _ in range(3)]
    power = max(abs(step.error) for step in steps)
    momentum = max(abs(step.momentum - step.impulse) / step.impulse_scale for step in steps)
    return [
        Row("supplied minus spent power, divided by the sum of all powers", power, 0.0, allowed, scale=1.0),
        Row("momentum minus impulse, divided by the sum of all forces", momentum, 0.0, allowed, scale=1.0),
    ]


def random_case(device: str, precision: str) -> list[Row]:
    """Compare the viscosity of a suspension of randomly placed spheres with Lionberger & Russel's formula (1994)."""
    rows = []
    for fraction, allowed in ((0.05, 0.06), (0.1, 0.06), (0.2, 0.06), (0.3, 0.06), (0.4, 0.12)):
        core = mean_core([random_structure(fraction, seed, device, precision) for seed in range(SEEDS)])
        expected = high_frequency_viscosity(core.fraction)
        rows.append(Row(f"viscosity at a fraction of {core.fraction:.3f}", core.viscosity, expected, allowed))
    return rows


WEAKEST = 0.04
"""Smallest relative effect of the spheres on the yield stress at a Bingham number of 10; 0.1 was computed."""


def yield_case(device: str, precision: str) -> list[Row]:
    """Compare the yield stress of a suspension with the law of Chateau, Ovarlez & Trung (2008).

    The law holds for Bingham numbers of 1 and below. At a Bingham number of 10, the mortar flows mostly in narrow bands
    between spheres, so that the yield stress must be smaller than that of the law, but larger than that of the mortar
    by at least the fraction `WEAKEST`.
    """
    rows = []
    for bingham in (0.3, 1.0, 10.0):
        factor, expected = yield_factor(0.2, 0, bingham, device, precision)
        name = f"yield stress, divided by that of the mortar, at a Bingham number of {bingham:g}"
        if bingham <= 1:
            rows.append(Row(name, factor, expected, 0.15))
        else:
            least = 1 + WEAKEST
            rows.append(Row(name, factor, 0.5 * (least + expected), 0.5 * (expected - least), scale=1.0))
    return rows


def settling_together(
    number: float, device: str, precision: str, tolerances: Tolerances, steps: int = MOVING_STEPS
) -> np.ndarray:
    """Return the velocities of four spheres that sink from rest [m/s], shape (steps, 4, 3).

    `number` is the viscous number dt mu / (rho h^2) of a time step dt, with the viscosity mu and the density rho of the
    mortar and the width h of a cell. `tolerances` are the tolerances of the coupled solve.
    """
    width = RADIUS / 2
    centres = RADIUS * np.array([[-1.3, -1.1, -1.4], [1.2, -1.0, -0.9], [-0.9, 1.3, 0.8], [1.1, 1.2, 1.7]])
    spheres = Aggregates(centres, np.full(4, RADIUS), DENSITY + 10)
    flow = mortar_flow(
        (16, 16, 20), width, spheres, device, precision, tolerances=tolerances,
        time_step=number * DENSITY * width**2 / VISCOSITY,
    )  # fmt: skip
    return np.array([take(flow, 1) for _ in range(steps)])


def moving_case(device: str, precision: str) -> list[Row]:
    """Compare velocities of spheres in mortar with those of a coupled solve with a much smaller tolerance.

    The spheres start from rest, and the following steps start with moving spheres. Each row states the largest error of
    a velocity, divided by the largest velocity of a sphere in the same step.
    """
    exact = Tolerances(coupled=1e-6 if precision == "float64" else 1e-5)
    rows = []
    for number in (1e2, 1e4):
        ours, reference = (settling_together(number, device, precision, each) for each in (Tolerances(), exact))
        errors = np.abs(ours - reference).max((1, 2)) / np.abs(reference).max((1, 2))
        for name, part in (("first step, from rest", errors[:1]), ("other steps, in motion", errors[1:])):
            rows.append(Row(f"viscous number {number:g}: {name}", float(part.max()), 0.0, 1e-3, scale=1.0))
    return rows


GROUP = "aggregates in mortar"
CASES = [
    Case("balance of many spheres", "conservation laws", balance_case, GROUP),
    Case("velocities of spheres in long steps", "coupled solve with a small tolerance", moving_case, GROUP),
    Case("viscosity of a random suspension", "Lionberger & Russel 1994", random_case, GROUP, slow=True),
    Case("yield stress of a suspension", "Chateau et al. 2008", yield_case, GROUP, slow=True),
]
