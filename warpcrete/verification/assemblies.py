"""Verification with many bodies: conserved momenta, energy balance, Janssen's silo, and angle of repose."""

import math
from dataclasses import replace

import numpy as np

from ..core.run.recorder import Recorder
from ..core.run.simulation_base import SimulationBase
from ..dem.laws import Contact
from ..dem.scene.clumps import reference
from ..dem.scene.containers import Fill, PipeContainer
from ..dem.scene.scene import Bodies, Bonds, Scene, Settle, TimeStep
from ..dem.scene.sizes import Gaussian, Uniform
from ..dem.simulation import ElementSimulation
from ..geometry.axis import Axis, Line
from ..geometry.walls import Driven, PipeWall, PlaneWall, Prescribed
from .case import Case, Row, start

UP = (0.0, 0.0, 1.0)


def cloud(device, precision) -> list[Row]:
    """Check that momentum and angular momentum are conserved while a thousand spinning clumps collide.

    The clumps fly towards each other without gravity or walls.
    """
    random = np.random.default_rng(7)
    count = 1000
    grid = np.stack(np.meshgrid(*[np.arange(10.0)] * 3, indexing="ij"), -1).reshape(-1, 3) - 4.5
    places = 0.011 * grid + random.normal(scale=5e-4, size=grid.shape)
    speeds = -3.0 * places / 0.05 + random.normal(scale=0.3, size=grid.shape)
    spins = random.normal(scale=60.0, size=grid.shape)
    shapes = reference()
    scene = Scene(
        name="cloud",
        duration=1.0,
        gravity=(0, 0, 0),
        contact=Contact(effective_modulus=1e6, friction=0.4, shear_damping_ratio=0.2),
        bodies=tuple(
            Bodies(positions=places[k::4], sizes=0.009, template=shapes[k], velocities=speeds[k::4], spins=spins[k::4])
            for k in range(4)
        ),
    )
    stepper = start(scene, device, precision)
    before = _momenta(stepper.state)
    stepper.advance(0.05)
    after = _momenta(stepper.state)
    state = stepper.state
    moved = float(np.sum(state.bodies.mass.numpy().astype(float) * np.linalg.norm(speeds, axis=1).mean()))
    turned = float(np.abs(before[2]).sum())
    tolerance = 3e-7 if precision == "float32" else 1e-14
    slowed = float(np.linalg.norm(state.bodies.velocity.numpy(), axis=1).mean() / np.linalg.norm(speeds, axis=1).mean())
    linear, angular = (float(np.linalg.norm(after[k] - before[k])) for k in (0, 1))
    label = f"change of the momentum of {count} clumps, divided by the sum of its magnitudes"
    return [
        Row(label, linear / moved, 0.0, tolerance, scale=1.0),
        Row(
            "change of the angular momentum, divided by the sum of its magnitudes",
            angular / turned,
            0.0,
            tolerance,
            scale=1.0,
        ),
        Row("collisions: the mean speed fell below half (1: yes)", float(slowed < 0.5), 1.0, 0.0),
    ]


def _momenta(state):
    order = np.argsort(state.bodies.id.numpy())
    mass, x, v, turn = (
        getattr(state.bodies, name).numpy()[order].astype(float)
        for name in ("mass", "position", "velocity", "angular_momentum")
    )
    orbital = mass[:, None] * np.cross(x, v)
    return (
        (mass[:, None] * v).sum(0),
        (orbital + turn).sum(0),
        np.linalg.norm(orbital, axis=1) + np.linalg.norm(turn, axis=1),
    )


def pumping(device, precision) -> list[Row]:
    """Check the energy balance of a pumping run: the work done equals the stored energy plus the dissipated energy.

    A piston pushes a column of bonded bodies up a pipe. At the upper end of the pipe, the column pushes a loaded plate.
    """
    axis = Axis((0, 0, 0), UP, (Line(0.4),))
    radius, length = 0.035, 0.1
    area = math.pi * radius**2
    scene = Scene(
        name="pump", duration=0.25, energy_balance=True, seed=1, settle=Settle(duration=0.3),
        fill=Fill(container=PipeContainer(axis, radius, length), sizes=Gaussian(0.011, 0.005, 6e-3, 16e-3),
                  templates=reference(), solid_fraction=0.62),
        walls=(
            PlaneWall(name="piston", point=(0, 0, 0), normal=UP,
                      motion=Prescribed(velocity=(0, 0, 0.3), ramp_time=0.1)),
            PlaneWall(name="plate", point=(0, 0, length), normal=(0, 0, -1),
                      motion=Driven(direction=(0, 0, -1), force=2e3 * area, mass=0.5, damping=20.0)),
            PipeWall(name="pipe", axis=axis, radius=radius),
        ),
        contact=Contact(friction=0.3, shear_damping_ratio=0.1),
        # The bonds are strong enough to store a noticeable energy, and weak enough to break.
        bonds=Bonds(effective_modulus=5e4, tensile_strength=800.0, cohesion=400.0),
    )  # fmt: skip
    errors, steps = [], []
    for safety in (0.8, 0.2):
        run = ElementSimulation(
            replace(scene, time_step=TimeStep(safety=safety)), device=device, precision=precision
        ).run()
        errors.append(run.result["energy_balance_error"])
        steps.append(run.result["steps"])
        broken = run.series["broken_tension"][-1] + run.series["broken_shear"][-1]
    return [
        Row(
            "stored + dissipated energy - work, divided by the work, default time step",
            abs(errors[0]),
            0.0,
            3e-4,
            scale=1.0,
        ),
        Row("the same with a quarter of the time step", abs(errors[1]), 0.0, 1e-4, scale=1.0),
        Row("error of the momentum balance of the run", run.result["momentum_balance_error"], 0.0, 1e-6, scale=1.0),
        Row("bonds broke during the run (1: yes)", float(broken > 50), 1.0, 0.0),
    ]


def janssen(device, precision) -> list[Row]:
    """Compare the load on the floor of a silo of spheres with Janssen's theory.

    The floor sinks slowly, so that the friction of the wall is fully mobilised. Vertical equilibrium with the wall
    friction mu and the measured ratio K of wall stress to vertical stress gives a load of m_s g (1 - exp(-m/m_s)) on
    the floor. Here m is the mass of the spheres and m_s = rho_b pi R^3 / (2 mu K), with the bulk density rho_b and the
    radius R of the silo.
    """
    radius, height, friction = 0.03, 0.15, 0.4
    axis = Axis((0, 0, 0), UP, (Line(0.5),))
    rows = []
    scene = Scene(
        name="silo", duration=0.5, seed=2, settle=Settle(duration=0.4, local_damping=0.3),
        fill=Fill(container=PipeContainer(axis, radius, height), sizes=Uniform(5.5e-3, 6.5e-3), solid_fraction=0.6),
        walls=(
            PlaneWall(name="floor", point=(0, 0, 0), normal=UP,
                      motion=Prescribed(velocity=(0, 0, -8e-3), ramp_time=0.05)),
            PipeWall(name="pipe", axis=axis, radius=radius),
        ),
        # The mode "slip-cut" of the linear contact law turns the shear dashpot off while a contact slips. Otherwise the
        # sum of friction and damping force at the wall could exceed the Coulomb limit.
        contact=Contact(effective_modulus=3e5, friction=friction, shear_damping_ratio=0.3, dashpot="slip-cut"),
    )  # fmt: skip
    gauge = _WallGauge(radius)
    run = ElementSimulation(scene, device=device, precision=precision, recorders=[gauge]).run()
    late = run.series["time"] > 0.5 * run.series["time"][-1]
    floor = float(-run.series["floor_force_z"][late].mean())
    shear = float(-run.series["pipe_force_z"][late].mean())
    weight = float(run.bodies.mass.sum()) * 9.81
    normal = float(np.array(gauge.loads)[late].mean())
    top = float(np.sort(run.bodies.position[:, 2])[-30:].mean())
    bottom = float(np.sort(run.bodies.position[:, 2])[:30].mean())
    filled = top - bottom
    # K is the mean stress on the wall, divided by the mean vertical stress that follows from Janssen's profile.
    wall = normal / (2 * math.pi * radius * filled)
    area = math.pi * radius**2
    mean_vertical = _mean_vertical(weight, floor, area)
    ratio = wall / mean_vertical
    limit = weight / filled * radius / (2 * friction * ratio)
    rows += [
        Row("load on floor and wall together, divided by the weight", (floor + shear) / weight, 1.0, 1e-3),
        Row("wall friction, divided by mu times the normal force", shear / (friction * normal), 1.0, 0.03),
        Row("load on the floor", floor, limit * (1 - math.exp(-weight / limit)), 0.03, "N"),
    ]
    return rows


def _mean_vertical(weight: float, floor: float, area: float) -> float:
    """Return the average of the vertical stress over the filling height [Pa], according to Janssen's profile.

    The profile follows from the `weight` of the spheres [N] and the load on the `floor` [N]. `area` is the
    cross-section of the silo [m2].
    """
    # Janssen's profile of the vertical force is F(m) = m_s (1 - exp(-m/m_s)), where m is the weight of the spheres
    # above. Find m_s such that F(weight) equals the load on the floor, then average F over the height.
    low, high = 1e-3 * weight, 1e3 * weight
    limit = low
    for _ in range(200):
        limit = math.sqrt(low * high)
        if limit * (1 - math.exp(-weight / limit)) < floor:
            low = limit
        else:
            high = limit
    return limit * (1 - limit / weight * (1 - math.exp(-weight / limit))) / area


class _WallGauge(Recorder):
    """Recorder of the sum of the normal forces on a vertical pipe [N].

    The forces are computed from the overlaps of spheres and pipe each time that the run takes measurements.
    """

    def __init__(self, radius: float) -> None:
        self.radius = radius
        self.loads: list[float] = []

    def sample(self, simulation: SimulationBase, row: dict[str, float]) -> None:
        assert isinstance(simulation, ElementSimulation)
        position = simulation.state.spheres.position.numpy().astype(float)
        overlap = np.hypot(position[:, 0], position[:, 1]) + position[:, 3] - self.radius
        modulus = simulation.scene.contact.stress_scale
        self.loads.append(float(np.sum(np.maximum(overlap, 0) * modulus * math.pi * position[:, 3])))


def repose(device, precision) -> list[Row]:
    """Check that columns of spheres collapse into steeper heaps if the friction between the spheres is higher.

    The heaps lie on a rough floor.
    """
    angles = []
    values = (0.05, 0.2, 0.6)
    rough = Contact(effective_modulus=1e5, friction=1.0, shear_damping_ratio=0.3, dashpot="slip-cut")
    for friction in values:
        axis = Axis((0, 0, 0), UP, (Line(0.2),))
        scene = Scene(
            name="heap",
            duration=0.6,
            seed=3,
            fill=Fill(container=PipeContainer(axis, 0.025, 0.06), sizes=Uniform(4.5e-3, 5.5e-3), solid_fraction=0.58),
            walls=(PlaneWall(name="floor", point=(0, 0, 0), normal=UP),),
            contact=replace(rough, friction=friction),
            contacts={("aggregate", "wall"): rough},
        )
        run = ElementSimulation(scene, device=device, precision=precision).run()
        angles.append(_slope(run.bodies.position, float(run.bodies.volume.sum()) / 0.6))
    REPOSE.curves.update(friction=np.array(values), angle=np.array(angles))
    shown = ", ".join(f"{a:.1f}" for a in angles)
    rises = float(np.sum(np.diff(angles) > 1.0))
    return [
        Row(f"rises by more than 1 degree; {shown} degrees at friction {', '.join(map(str, values))}", rises, 2.0, 0.0)
    ]


def _slope(position: np.ndarray, volume: float) -> float:
    """Return the slope [degrees] of the cone that has the heap's bulk volume [m3] and mean height.

    `position` holds the centres of the spheres [m], shape (n, 3). A cone of height h and radius R has a mean height of
    h/4 and a volume of pi R^2 h/3.
    """
    height = 4 * float(position[:, 2].mean())
    return float(np.degrees(np.arctan(height / math.sqrt(3 * volume / (math.pi * height)))))


REPOSE = Case("angle of repose", "trend known from experiment: steeper with friction", repose, "assemblies", slow=True)
CASES = [
    Case("momentum", "conservation", cloud, "assemblies"),
    Case("energy of a pumping run", "conservation", pumping, "assemblies"),
    Case("Janssen's silo", "Janssen 1895, with the measured stress ratio", janssen, "assemblies", slow=True),
    REPOSE,
]
