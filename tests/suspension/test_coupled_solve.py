"""Coupled solve of mortar, spheres and pressure: its number of iterations, search directions and new contacts."""

import dataclasses
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from warpcrete import Simulation, scenes
from warpcrete.core.errors import ConvergenceError
from warpcrete.kernels.mps.conjugate_gradient import ITERATIONS
from warpcrete.suspension import solve
from warpcrete.suspension.aggregates import Aggregates
from warpcrete.suspension.solve import CoupledSolve, Tolerances
from warpcrete.verification.suspensions import DENSITY, RADIUS, mortar_flow
from warpcrete.verification.suspensions_many import suspension

WIDTH = RADIUS / 2


def heap(device, precision="float32", **given):
    """A box with eight heavy spheres at gaps of a tenth of a cell, which fall onto each other and the floor."""
    places = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), -1).reshape(8, 3)
    centres = places * (RADIUS + 0.05 * WIDTH) - [0.0, 0.0, 3.9 * WIDTH - 0.05 * WIDTH]
    # The upper layer is shifted, so that each of its spheres rests on several of the lower ones.
    centres[centres[:, 2] > centres[:, 2].mean(), :2] += 0.3 * RADIUS
    spheres = Aggregates(centres, np.full(8, RADIUS), DENSITY + 8000)
    return mortar_flow((12, 12, 16), WIDTH, spheres, device, precision, **{"time_step": 0.1} | given)


def test_touching_spheres_need_few_iterations(device):
    """The first step starts from rest and finds contacts late, so it has two solves; the others have one."""
    flow, counts, contacts = heap(device), [], 0
    assert flow.holdings["aggregates"] is flow.aggregates and flow.holdings["coupled solve"] is flow.coupled.directions
    for _ in range(6):
        flow.take(1)
        counts.append(flow.coupled.outer)
        contacts += np.count_nonzero(flow.aggregates.pairs.touching.numpy())
    assert contacts > 10
    # Measured on a CPU: 33, and 15 to 19 in the other steps.
    assert counts[0] <= 36 and max(counts[1:]) <= 21
    assert flow.coupled.error <= 1e-4


@pytest.mark.thorough
def test_a_mortar_that_has_not_yielded_needs_few_iterations(device):
    """The first step from rest of a slump test, in which most cells are 1000 times as viscous as sheared mortar."""
    scene = scenes.slump(
        concrete="own", density=2220.0, viscosity=10.6, yield_stress=35.5, regularisation=1e3, lift_time=0.0,
        plate_radius=0.34, step_error=0.01, spacing=7.5e-3, aggregate_fraction=0.3, aggregate_smallest=0.03,
        aggregate_largest=0.03, aggregate_density=2650.0,
    )  # fmt: skip
    simulation = Simulation(scene, device=device, precision="float32")
    simulation.begin()
    simulation.flow.take(1)
    # Measured on a CPU: 14, and 31 with viscous solves to 0.5 instead of 0.25.
    assert simulation.flow.coupled.outer <= 20


def test_pressure_solves_of_long_steps_need_few_iterations(device, monkeypatch):
    """Faces within aggregates have no viscous resistance, so that their inertia alone must not count in long steps."""
    counts, precondition = [], CoupledSolve._precondition

    def counted(self, residual, change):
        precondition(self, residual, change)
        counts.append(int(self.flow.projection.arrays.outcome.numpy()[int(ITERATIONS)]))

    monkeypatch.setattr(CoupledSolve, "_precondition", counted)
    flow = suspension(0.4, 0, device, "float32", wide=4, long=4, rate=1e-5)
    # At the usual tolerance, every solve stops after one or two iterations, however slowly it converges.
    flow.coupled.tolerances = dataclasses.replace(flow.coupled.tolerances, pressure=0.1)
    flow._build_stages()
    flow.take(1)
    # Measured: 3, and 25 with the diagonal as preconditioner. With inertia alone, the numbers were 101 and 245.
    assert max(counts) <= (30 if wp.get_device(device).is_cuda else 5)


def test_contacts_that_are_certain_early_do_not_change_the_result(device, monkeypatch):
    """Without an early look for contacts, more iterations give the same velocities within the solver's tolerance."""
    found, counts = [], []
    for error in (solve.ROUGH_ERROR, 1e-8):
        monkeypatch.setattr(solve, "ROUGH_ERROR", error)
        flow, count = heap(device, "float64", tolerances=Tolerances(coupled=1e-7)), 0
        for _ in range(4):
            flow.take(1)
            count += flow.coupled.outer
        found.append(flow.aggregates.bodies.velocity.numpy())
        counts.append(count)
    assert np.abs(found[0] - found[1]).max() < 1e-5 * np.abs(found[1]).max()
    # Measured: 122 and 155 iterations.
    assert counts[0] < 0.9 * counts[1]


def test_the_known_directions_keep_their_effects_when_pairs_touch(device):
    """After new contacts, each stored effect is the product of the changed matrix and its direction."""
    flow = heap(device, "float64")
    flow.set_goal(steps=2)
    flow.begin_goal()
    flow.take_step()
    coupled, directions = flow.coupled, flow.coupled.directions
    flow.aggregates.pairs.touching.zero_()
    for number in range(directions.known):
        coupled._multiply(*directions[number])
    before = directions[1][1].linear.numpy().copy()
    # Spheres that approach each other by half a radius within the step overlap at its end.
    speed = np.zeros((8, 3))
    speed[:4, 0] = 0.5 * RADIUS / 0.1
    coupled.solution.linear.assign(speed - flow.aggregates.bodies.velocity.numpy())
    assert coupled._new_contacts()
    product = coupled._vector()
    for number in range(directions.known):
        change, effect = directions[number]
        coupled._multiply(change, product)
        expected = product.linear.numpy()
        assert effect.linear.numpy() == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
    assert np.abs(directions[1][1].linear.numpy() - before).max() > 0


@pytest.mark.parametrize(("known", "orthogonal", "iterations", "begins"), [(0, 0, 5, 1), (7, 0, 12, 1), (7, 9, 14, 0)])
def test_a_repeated_solve_gets_as_many_new_iterations_as_the_first(known, orthogonal, iterations, begins):
    """Known directions cost little, so they do not count; only the others are preconditioned and multiplied."""

    class Numbered(SimpleNamespace):
        def __getitem__(self, number):
            return number, number

    directions = Numbered(known=known, orthogonal=orthogonal)
    done = []

    def orthogonalise(number):
        done.append(("orthogonalise", number))
        directions.orthogonal += 1
        return 0.5

    solver = SimpleNamespace(
        directions=directions, error=1.0, outer=0, tolerances=Tolerances(outer=5), flow=SimpleNamespace(time=0.25),
        direction="direction", product="product", residual="residual",
        _advance=lambda factor, change, effect: done.append(("advance", factor, change)) or 1.0,
        _precondition=lambda residual, change: done.append(("precondition", change)),
        _multiply=lambda change, effect: done.append(("multiply", change)), _orthogonalise=orthogonalise,
    )  # fmt: skip
    with pytest.raises(ConvergenceError, match="the coupled solve did not converge") as raised:
        CoupledSolve._iterate(solver, 1e-4)
    new = iterations - max(known, orthogonal)
    assert raised.value.iterations == iterations - orthogonal and solver.outer == new == 5
    assert [each[1] for each in done if each[0] == "orthogonalise"] == list(range(orthogonal, iterations))
    for name in ("precondition", "multiply"):
        assert [each[1] for each in done if each[0] == name] == list(range(max(known, orthogonal), iterations))
    assert done.count(("advance", 0.0, "direction")) == begins and directions.known == iterations


# A wider tolerance than the default of 1e-4 launches the same kernels, a third as often.
BOUNDS_CHECKED = """
import warp as wp
wp.config.mode = "debug"
from warpcrete.core.device.device import divide_work_like_gpu
from warpcrete.verification.suspensions_many import suspension
with divide_work_like_gpu():
    flow = suspension(0.2, 0, "cpu", "float32", wide=2, long=2, rate=10.0, coupled=1e-2)
    flow.take(2)
print(flow.aggregates.count, "aggregates")
"""


@pytest.mark.thorough
def test_kernels_of_a_gpu_stay_within_their_arrays():
    """Whole blocks of threads run past the last aggregate. In debug mode, Warp ends the process at a wrong index."""
    done = subprocess.run([sys.executable, "-c", BOUNDS_CHECKED], capture_output=True, text=True, encoding="utf-8")
    assert done.returncode == 0 and "3 aggregates" in done.stdout, done.stderr[-500:]
