"""Verification of the stable time step: energy growth with time steps below and above the estimate.

All contact laws are tested, with spheres, clumps and bonds.
"""

import math
from dataclasses import replace

import numpy as np

from ..core.device.device import find_device
from ..core.errors import InstabilityError
from ..dem.engine.model import build_model
from ..dem.engine.state import State
from ..dem.engine.stepper import Stepper
from ..dem.laws import BinghamMortar, Contact, ContactLaw, HertzMindlin, LubricationLayer
from ..dem.measure.probes import body_sums, contact_sums
from ..dem.packing import pack
from ..dem.scene.bodies import BodyTable, placed_bodies
from ..dem.scene.clumps import ClumpTemplate, reference, sphere
from ..dem.scene.containers import Fill, PipeContainer
from ..dem.scene.scene import Bodies, Bonds, Scene, TimeStep
from ..dem.scene.sizes import Uniform
from ..geometry.axis import Axis, Line
from .case import Case, Row

STEPS = 3000
CHUNK = 30
FRACTIONS = (0.6, 0.8, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0, 2.3, 2.6, 3.0, 4.0, 5.0, 6.0, 8.0)
GROWN = 2.0
"""Ratio of the energy at the end of a run to the energy at its start, from which on the energy counts as grown."""
AXIS = Axis((0, 0, 0), (0, 0, 1), (Line(0.05),))
LAWS: dict[str, ContactLaw] = {
    "linear": Contact(friction=10.0, normal_damping_ratio=0.0),
    "linear, damped": Contact(friction=10.0, normal_damping_ratio=0.5, shear_damping_ratio=0.2),
    "Hertz-Mindlin": HertzMindlin(effective_modulus=1e6, effective_shear_modulus=3e5, friction=10.0, restitution=1.0),
    "lubrication layer": LubricationLayer(
        contact=Contact(friction=0.1, normal_damping_ratio=0.1), yield_stress=50.0, viscosity=1500.0
    ),
    "Bingham mortar": BinghamMortar(effective_modulus=1e6, shell_modulus=2e4, yield_stress=50.0, plastic_viscosity=3.0),
}


def dense_block(law: ContactLaw, shape: ClumpTemplate, device, precision) -> tuple[Scene, BodyTable]:
    """Return scene and bodies of a packing of about 120 bodies in a short pipe, so dense that the bodies overlap.

    All bodies have the `shape` and the contact law `law`.
    """
    fill = Fill(
        container=PipeContainer(AXIS, 0.025, 0.05), sizes=Uniform(8e-3, 12e-3), solid_fraction=0.66, templates=(shape,)
    )
    table, _ = pack(fill, device=device, precision=precision, seed=4)
    walls = fill.container.walls("wall")
    scene = Scene(name="block", duration=1.0, gravity=(0, 0, 0), fill=fill, walls=walls, contact=law)
    return scene, table


def growth(scene: Scene, table, fraction: float, device, precision, bonds: Bonds | None = None) -> float:
    """Return the largest energy in the last fifth of a run, divided by the largest energy in the first fifth.

    `table` holds the bodies, and `bonds` the bonds between touching bodies, if there are any. The result is infinite if
    the run diverges. The run has `STEPS` time steps, whose size is `fraction` times the estimated stable step. Near the
    stability limit, the energy of a stable leapfrog integration oscillates, but it does not grow.
    """
    model = build_model(scene, find_device(device), precision)
    stepper = Stepper(model, State(model, table), TimeStep(safety=10.0))
    if bonds is not None:
        stepper.bond(bonds, 1)
    estimate = stepper.estimate()
    stepper.time_step = TimeStep(fixed=fraction * estimate, safety=10.0, interval=10**9)
    stepper.choose_dt()
    before = _energy(model, stepper.state)
    energies = []
    try:
        for _ in range(STEPS // CHUNK):
            stepper.take(CHUNK)
            energies.append(_energy(model, stepper.state))
            if not energies[-1] < 1e6 * before:
                return math.inf
    except InstabilityError:
        return math.inf
    fifth = len(energies) // 5
    return max(energies[-fifth:]) / max(energies[:fifth])


def _energy(model, state) -> float:
    sums = contact_sums(model, state)
    return body_sums(model, state).kinetic_energy + sums.elastic_energy + sums.bond_energy


def shake(table: BodyTable, seed: int = 5) -> None:
    """Give the bodies in `table` random velocities and spins.

    This random motion excites all modes of vibration, including the stiffest modes, which become unstable first.
    """
    random = np.random.default_rng(seed)
    table.velocity = random.normal(scale=0.05, size=table.velocity.shape)
    table.spin = random.normal(scale=10.0, size=table.spin.shape)


def bonded_pair() -> Scene:
    """Return a scene of two bonded spheres that oscillate in the stiffest mode of their bond.

    This mode couples shear and rotation.
    """
    bonds = Bonds(effective_modulus=1e5, stiffness_ratio=0.5, tensile_strength=1e12, cohesion=1e12, gap=1e-6)
    return Scene(
        name="pair", duration=1.0, gravity=(0, 0, 0), contact=LAWS["linear"], bonds=bonds,
        bodies=(Bodies(positions=[[0.0, 0, 0], [0.01, 0, 0]], sizes=0.01, spins=[[0.0, 0, 1], [0.0, 0, 1]]),),
    )  # fmt: skip


def limits(device, precision) -> list[Row]:
    """Find the largest time step, as a multiple of the estimated stable step, at which the energy does not grow.

    Several fractions of the estimate are tried for every contact law and shape of bodies. The estimate must be safe for
    all of them.
    """
    pair = bonded_pair()
    block_bonds = Bonds(effective_modulus=1e5, tensile_strength=1e12, cohesion=1e12, gap=1e-3)
    blocks = [(f"{name}, spheres", law, sphere(), None) for name, law in LAWS.items()] + [
        ("linear, clumps", LAWS["linear"], reference()[1], None),
        ("linear, damped, clumps", LAWS["linear, damped"], reference()[1], None),
        ("linear, bonded spheres", LAWS["linear"], sphere(), block_bonds),
    ]
    LIMITS.curves.clear()
    LIMITS.curves["linear, one bonded pair"] = np.array(
        [growth(pair, placed_bodies(pair), fraction, device, precision, pair.bonds) for fraction in FRACTIONS]
    )
    for label, law, shape, bonds in blocks:
        scene, table = dense_block(law, shape, device, precision)
        scene = replace(scene, bonds=bonds)
        shake(table)
        LIMITS.curves[label] = np.array([growth(scene, table, s, device, precision, bonds) for s in FRACTIONS])
    rows = []
    for label, curve in LIMITS.curves.items():
        stable = curve < GROWN
        first = len(FRACTIONS) if stable.all() else int(np.argmin(stable))
        limit = FRACTIONS[first - 1] if first else 0.0
        # Growth of energy may begin only at or above the estimated stable step, because the estimate must be safe. A
        # larger limit is reported, but it is not an error.
        rows.append(Row(f"{label}: stable up to this fraction of the estimate", limit, 1.0, 0.0, at_least=True))
    return rows


LIMITS = Case("stability limit", "the estimate of the stable step", limits, "stability", slow=True)
CASES = [LIMITS]
