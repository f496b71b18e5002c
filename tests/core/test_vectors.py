"""Contacts in vector registers: the compiler widens the loop over lanes, whatever the law; lanes hold any rows."""

import dataclasses
import functools
import math
import platform
import re
from pathlib import Path

import numpy as np
import pytest
import warp as wp
from conftest import by_id
from test_laws import LAWS

from warpcrete import Simulation
from warpcrete.core.device.device import quiet_init
from warpcrete.dem.batch_run import run_batch
from warpcrete.dem.laws import Contact, RollingResistance
from warpcrete.dem.scene.scene import Bodies, Bonds, Scene, TimeStep, Watch
from warpcrete.kernels.common.types import SPAN, cpu_flags
from warpcrete.kernels.dem.contacts import contact_kernel

WIDE = {"float32": b"\x04\x0c\x14\x1c", "float64": b"\x05\x0d\x15\x1d"}
"""Lowest bits of the last byte before the code of an instruction on 256 bits of single or double numbers, by which
register it also reads."""

avx2 = pytest.mark.skipif(
    platform.machine() not in ("x86_64", "AMD64") or "x86-64-v3" not in cpu_flags(),
    reason="needs a processor with AVX2, whose instructions the tests count in the compiled kernels",
)


def wide_roots_and_divisions(kernel, precision: str) -> int:
    """How many instructions of a compiled kernel take the roots or quotients of 256 bits of numbers."""
    quiet_init()
    wp.load_module(kernel.module, device="cpu")
    folder = Path(wp.config.kernel_cache_dir, kernel.module.get_module_identifier(1))
    (code,) = (path.read_bytes() for path in folder.glob("*.o"))
    last = bytes(high | low for high in range(0, 256, 32) for low in WIDE[precision])
    short, long = b"\xc5[%s][\x51\x5e]" % re.escape(last), b"\xc4.[%s][\x51\x5e]" % re.escape(last)
    return len(re.findall(short, code, re.DOTALL)) + len(re.findall(long, code, re.DOTALL))


@functools.cache
def compiled(law, precision: str, bonds: bool, mixed: bool, energies: bool = False):
    return contact_kernel(getattr(wp, precision), law, True, bonds, False, False, energies, mixed)


@avx2
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_contacts_are_evaluated_in_vector_registers(precision):
    law = type(LAWS["linear"])
    assert wide_roots_and_divisions(compiled(law, precision, False, False), precision) >= 5
    # With a law that is read in the loop it is not widened, which is how this test is known to see it.
    assert wide_roots_and_divisions(compiled(law, precision, False, True), precision) <= 1


@avx2
@pytest.mark.thorough
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("bonds", [False, True], ids=["plain", "bonded"])
@pytest.mark.parametrize("law", sorted({RollingResistance, *map(type, LAWS.values())}, key=lambda law: law.__name__))
def test_no_law_keeps_contacts_from_vector_registers(law, bonds, precision):
    for energies in (False, True):
        assert wide_roots_and_divisions(compiled(law, precision, bonds, False, energies), precision) >= 5


def test_every_pair_of_materials_has_the_law_of_that_pair(start):
    """Pairs of three kinds by turns, more than there are lanes, each pushed apart by its own spring."""
    radius, density, depth, count = 0.01, 2500.0, 1e-4, 25
    modulus = {("light", "light"): 1e5, ("light", "heavy"): 3e5, ("heavy", "heavy"): 7e5}
    pairs = [pair for _ in range(count) for pair in modulus]
    places = np.array([[0.05 * k, side * (2 * radius - depth), 0.0] for k in range(len(pairs)) for side in (0, 1)])
    names = np.array([name for pair in pairs for name in pair])
    bodies = tuple(
        Bodies(positions=places[names == name], sizes=2 * radius, density=density, material=name)
        for name in ("light", "heavy")
    )
    laws = {pair: Contact(effective_modulus=value, friction=0) for pair, value in modulus.items()}
    scene = Scene(
        name="pairs", duration=1.0, gravity=(0.0, 0.0, 0.0), bodies=bodies, contacts=laws,
        time_step=TimeStep(fixed=1e-6),
    )  # fmt: skip
    stepper = start(scene)
    stepper.take(1)
    mass = density * 4 / 3 * math.pi * radius**3
    force = by_id(stepper.state, "velocity")[:, 1] * mass / (0.5 * stepper.dt)
    wanted = np.array([side * modulus[pair] * math.pi * radius / 2 * depth for pair in pairs for side in (-1, 1)])
    order = np.concatenate([np.flatnonzero(names == name) for name in ("light", "heavy")])
    assert force == pytest.approx(wanted[order], rel=1e-9)


def crowd(count: int, seed: int) -> Scene:
    """A large sphere in a shell of small ones, which touch it and roll about it: its row is longer than a block."""
    random = np.random.default_rng(seed)
    turn = math.pi * (3 - math.sqrt(5)) * np.arange(count)
    height = 1 - (2 * np.arange(count) + 1) / count
    around = np.stack([np.sqrt(1 - height**2) * np.cos(turn), np.sqrt(1 - height**2) * np.sin(turn), height], axis=1)
    places = np.concatenate([np.zeros((1, 3)), 0.0595 * around])
    return Scene(
        name="crowd", duration=0.02, gravity=(0.0, 0.0, 0.0), energy_balance=True, watch=Watch(overlap=None),
        time_step=TimeStep(fixed=1e-4),
        bodies=(Bodies(
            positions=places, sizes=np.array([0.1] + [0.02] * count), density=2500.0,
            velocities=np.concatenate([np.zeros((1, 3)), random.uniform(-0.5, 0.5, (count, 3))]),
        ),),
        contact=Contact(effective_modulus=1e4, friction=0.5, stiffness_ratio=20.0),  # springs are loaded when they part
    )  # fmt: skip


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_rows_longer_than_lanes_have_the_same_bits_in_a_batch(device, precision):
    # Lanes begin anew after every SPAN spheres: alone before the long row's first neighbours, here among them.
    crowds = [crowd(count, seed) for seed, count in enumerate((90, 70))]
    far = np.stack([*np.divmod(np.arange(SPAN - 20), 32), np.ones(SPAN - 20)], axis=1) * 0.04
    body = dataclasses.replace(crowds[0].bodies[0], positions=far, sizes=0.02, velocities=0.0 * far)
    some = [dataclasses.replace(crowds[0], bodies=(body,)), *crowds]
    alone_ones = [Simulation(scene, device=device, precision=precision, threads=1) for scene in some]
    alone = [simulation.run() for simulation in alone_ones]
    together = [Simulation(scene, device=device, precision=precision, threads=1) for scene in some]
    batched = run_batch(together)
    assert max(np.diff(together[1].stepper.state.pairs.start.numpy())) > 31  # a block
    for one, other, simulation, apart in zip(alone, batched, together, alone_ones, strict=True):
        assert one.result["state_hash"] == other.result["state_hash"] and one.result["steps"] == other.result["steps"]
        lost, wanted = (s.stepper.state.spheres.dissipated_energy.numpy() for s in (simulation, apart))
        assert np.array_equal(lost, wanted)
    assert lost.sum() > 0


def test_a_bond_that_is_none_spoils_no_contact(start):
    """Spheres in one place touch, but have no bond: a bond's stretch would be none over none."""
    places = np.array([[0.0, 0, 0], [0, 0, 0], [0.1, 0, 0], [0.119, 0, 0]])
    scene = Scene(
        name="one place", duration=1.0, gravity=(0.0, 0.0, 0.0), time_step=TimeStep(fixed=1e-6), bonds=Bonds(),
        bodies=(Bodies(positions=places, sizes=0.02, density=2500.0),), watch=Watch(overlap=None),
    )  # fmt: skip
    stepper = start(scene)
    stepper.take(1)
    velocity = by_id(stepper.state, "velocity")
    assert np.isfinite(velocity).all()
    assert velocity[0, 2] == -velocity[1, 2] != 0 and velocity[2, 0] == -velocity[3, 0] < 0
    assert not np.any(stepper.state.pairs.load.numpy())
