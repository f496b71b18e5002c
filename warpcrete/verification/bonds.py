"""Verification of bonds: chains and beam theory, torsional oscillation, and the load at which a bond breaks."""

import math

import numpy as np

from ..dem.laws import Contact
from ..dem.scene.scene import AxisDrive, Bodies, Bonds, Scene, TimeStep
from ..geometry.axis import Axis, Line
from .case import Case, Row, start

RADIUS, DENSITY, GAP = 0.01, 2500.0, 1e-6
LENGTH = 2 * RADIUS
MASS = DENSITY * 4 / 3 * math.pi * RADIUS**3
CONTACT = Contact(friction=0.0, normal_damping_ratio=0.0)
HEAVY = 1e15


def stiffnesses(bonds: Bonds) -> tuple[float, float, float, float]:
    """Return the stiffnesses of a bond between two spheres (Zhan et al. 2019, Eq. 10).

    The result contains the normal and shear stiffness [N/m] and the bending and torsional stiffness [N m].
    """
    normal = bonds.effective_modulus / LENGTH * math.pi * RADIUS**2
    bending = normal * RADIUS**2 / 4
    return normal, normal / bonds.stiffness_ratio, bending, 2 * bending / bonds.stiffness_ratio


def cantilever(device, precision) -> list[Row]:
    """Compare the static deflection of a bonded chain of six spheres with exact and with Timoshenko beam theory.

    The first sphere is too heavy to move, and a force acts on the last sphere.
    """
    bonds = Bonds(effective_modulus=1e6, tensile_strength=1e12, cohesion=1e12, gap=10 * GAP)
    normal, shear, bending, _ = stiffnesses(bonds)
    count, pull, push = 6, 1.0, 0.01
    joints = count - 1
    rows = []
    for label, direction, force in (("tension", (1.0, 0, 0), pull), ("bending", (0, 0, 1.0), push)):
        x = np.arange(count) * (LENGTH + GAP)
        points = np.stack([x, 0 * x, 0 * x], 1)
        line = Axis(tuple(points[-1] - 0.5 * np.array(direction)), direction, (Line(1.0),))
        scene = Scene(
            name="beam", duration=1.0, gravity=(0, 0, 0), contact=CONTACT, bonds=bonds, local_damping=0.3,
            drives=(AxisDrive(group="tip", axis=line, force=force),),
            bodies=(
                Bodies(positions=points[:1], sizes=2 * RADIUS, density=HEAVY),
                Bodies(positions=points[1:-1], sizes=2 * RADIUS, density=DENSITY),
                Bodies(positions=points[-1:], sizes=2 * RADIUS, density=DENSITY, group="tip"),
            ),
        )  # fmt: skip
        stepper = start(scene, device, precision)
        stepper.bond(bonds, 1)
        stepper.change(local_damping=0.3)
        stepper.advance(3.0)
        order = np.argsort(stepper.state.bodies.id.numpy())
        tip = stepper.state.bodies.position.numpy()[order][-1].astype(float) - points[-1]
        if label == "tension":
            allowed = 5e-4 if precision == "float32" else 1e-5
            rows.append(Row("elongation of the chain under tension", tip[0], joints * force / normal, allowed, "m"))
        else:
            levers = np.sum((np.arange(joints) + 0.5) ** 2)
            exact = joints * force / shear + force * LENGTH**2 / bending * levers
            beam = force * (joints * LENGTH) ** 3 / (3 * bending * LENGTH) + joints * force / shear
            rows.append(Row("deflection of the tip, exact for a chain", tip[2], exact, 2e-4, "m"))
            # The tolerance is large because a chain with five joints deflects 1 % less than a continuous beam.
            rows.append(Row("deflection of the tip, Timoshenko beam", tip[2], beam, 1.1e-2, "m"))
    return rows


def torsion(device, precision) -> list[Row]:
    """Compare the torsional oscillation of a sphere with the exact solution.

    The sphere oscillates about the axis of its bond to another sphere, which is too heavy to rotate.
    """
    bonds = Bonds(effective_modulus=1e5, tensile_strength=1e12, cohesion=1e12, gap=10 * GAP)
    twisting = stiffnesses(bonds)[3]
    inertia = 0.4 * MASS * RADIUS**2
    omega = math.sqrt(twisting / inertia)
    scene = _pair(bonds, spins=[[0, 0, 0], [5.0, 0, 0]], densities=(HEAVY, DENSITY), dt=2 * math.pi / omega / 2000)
    stepper = start(scene, device, precision)
    stepper.bond(bonds, 1)
    rows = []
    for turns in (1 / 3, 10 + 1 / 3):
        stepper.advance(turns * 2 * math.pi / omega)
        middle = omega * (stepper.time - 0.5 * stepper.dt)
        spin = float(stepper.state.bodies.spin.numpy()[np.argsort(stepper.state.bodies.id.numpy())][1, 0])
        rows.append(
            Row(f"spin after {turns:.2f} periods of torsion", spin, 5.0 * math.cos(middle), 6e-5, "rad/s", scale=5.0)
        )
    return rows


def _pair(bonds, *, spins=None, velocities=None, densities=(HEAVY, HEAVY), dt=1e-5) -> Scene:
    places = np.array([[0.0, 0, 0], [LENGTH + GAP, 0, 0]])
    return Scene(
        name="pair", duration=1.0, gravity=(0, 0, 0), contact=CONTACT, bonds=bonds, time_step=TimeStep(fixed=dt),
        bodies=tuple(
            Bodies(positions=places[k][None], sizes=2 * RADIUS, density=densities[k],
                   spins=None if spins is None else np.array(spins[k], float)[None],
                   velocities=None if velocities is None else np.array(velocities[k], float)[None])
            for k in (0, 1)
        ),
    )  # fmt: skip


def breakage(device, precision) -> list[Row]:
    """Compare the load at which a bond breaks with its strength, in tension, shear, bending and torsion.

    Two heavy bonded spheres move slowly relative to each other.
    """
    strength, cohesion, angle = 1e4, 6e3, 30.0
    area = math.pi * RADIUS**2
    section = area * RADIUS / 4
    speed, rate = 1e-3, 0.2
    rows = []
    loads = {
        "tension": (dict(velocities=[[0, 0, 0], [speed, 0, 0]]), 3, "force", strength * area, 0),
        "shear": (dict(velocities=[[0, 0, 0], [0, speed, 0]]), 1, "force", cohesion * area, 1),
        "bending": (dict(spins=[[0, 0, 0], [0, 0, rate]]), 2, "moment", strength * section, 0),
        "torsion": (dict(spins=[[0, 0, 0], [rate, 0, 0]]), 3, "moment", cohesion * 2 * section, 1),
        "shear under tension": (dict(velocities=[[0, 0, 0], [0.3 * speed, speed, 0]]), 1, "force", 0.0, 1),
    }
    for label, (motion, component, kind, expected, flag) in loads.items():
        # A rotation that bends the bond also shears it. Choose a very low shear stiffness, so that the bond is loaded
        # in bending only.
        ratio = 1e6 if label == "bending" else 2.0
        bonds = Bonds(
            effective_modulus=3e7,
            stiffness_ratio=ratio,
            tensile_strength=strength,
            cohesion=cohesion,
            friction_angle=angle,
            gap=10 * GAP,
        )
        normal, shear, bending, twisting = stiffnesses(bonds)
        step = {"tension": normal * speed, "shear": shear * speed, "bending": bending * rate,
                "torsion": twisting * rate, "shear under tension": shear * speed}[label]  # fmt: skip
        if label == "shear under tension":
            # The normal stress sigma and the shear stress tau both increase in proportion to the displacement. The
            # shear strength c - sigma tan(phi) therefore decreases. The bond breaks when tau reaches this strength.
            slope = 0.3 * normal / shear * math.tan(math.radians(angle))
            expected = cohesion * area / (1 + slope)
        dt = 5e-4 * expected / step
        stepper = start(_pair(bonds, dt=dt, **motion), device, precision)
        stepper.bond(bonds, 1)
        place = component if kind == "force" else 4 + component
        last = 0.0
        for _ in range(2600):
            stepper.take(1)
            if stepper.state.spheres.broken.numpy().sum(0)[flag]:
                break
            last = abs(float(stepper.state.pairs.load.numpy()[0, place]))
        # The load grows by 5e-4 of its final value in each time step, so the measured load may be too low by this
        # fraction. In double precision, loads in tension, bending and torsion reach the bond's strength exactly at the
        # end of a step, and their error is much smaller.
        sheared = label.startswith("shear") or precision == "float32"
        allowed, unit = 1.2e-3 if sheared else 1e-7, "N" if kind == "force" else "N m"
        rows.append(Row(f"load at breakage in {label}", last, expected, allowed, unit))
    return rows


CASES = [
    Case("bonded cantilever", "exact for a chain of bonds; Timoshenko beam", cantilever, "bonds"),
    Case("bonded pair in torsion", "exact solution", torsion, "bonds"),
    Case("breakage", "Zhan et al. 2019, Eqs. 11-12", breakage, "bonds"),
]
