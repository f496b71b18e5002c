"""Scenes at the edge: each stays within bounds or stops with an error that names time, body, quantity and cures."""

import dataclasses
import itertools

import numpy as np
import pytest

from warpcrete import Simulation
from warpcrete.core.errors import InstabilityError
from warpcrete.dem.laws import Contact
from warpcrete.dem.measure.watch import Watch as EnergyWatch
from warpcrete.dem.scene.scene import Bodies, Scene, TimeStep, Watch
from warpcrete.verification import extremes

CASES = list(extremes.scenes())
SINGLES = [case for case in CASES if not case[0].startswith("corner")]


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("case", SINGLES, ids=[case[0] for case in SINGLES])
def test_extreme(device, precision, case):
    name, make, steps = case
    found = extremes.outcome(name, make(), device, precision, steps)
    assert found.acceptable, found


CORNERS = [case for case in CASES if case[0].startswith("corner")]
# A quarter of all in which every three parameters meet in all their extremes (a fractional design, 2^(7-2), IV).
QUARTER = [
    case for case, up in zip(CORNERS, itertools.product((0, 1), repeat=7), strict=True)
    if up[5] == (up[0] + up[1] + up[2] + up[3]) % 2 and up[6] == (up[0] + up[1] + up[3] + up[4]) % 2
]  # fmt: skip


@pytest.mark.parametrize("corners", [QUARTER, pytest.param(CORNERS, marks=pytest.mark.slow)], ids=["quarter", "all"])
def test_corners_stay_within_bounds_or_stop(device, corners):
    found = [extremes.outcome(name, make(), device, "float32", steps) for name, make, steps in corners]
    assert len(found) in (2 ** len(extremes.AXES), 2 ** (len(extremes.AXES) - 2))
    wrong = [o for o in found if not o.acceptable]
    assert not wrong, wrong
    assert sum(not o.stopped for o in found) > len(found) / 2
    text = extremes.table(found)
    assert "corners of modulus" in text


@pytest.mark.slow
def test_a_million_spheres(device):
    ((name, make, steps),) = [c for c in extremes.scenes(large=True) if c[0] == "a million spheres"]
    found = extremes.outcome(name, make(), device, "float32", steps)
    assert found.acceptable and found.expected_outcome == "run", found


def one_sphere(**changes) -> Scene:
    body = Bodies(positions=[[0.0, 0, 0.02], [0.0, 0, 0.08]], sizes=0.01)
    return Scene(**(dict(name="one", duration=0.05, bodies=(body,)) | changes))


def test_nan_stops_a_run_in_the_step_it_appears(device):
    def with_nan(name, component):
        simulation = Simulation(one_sphere(), device=device)
        simulation.prepare()
        values = getattr(simulation.state.spheres, name).numpy().copy()
        values[1, component] = np.nan
        getattr(simulation.state.spheres, name).assign(values)
        return simulation

    with pytest.raises(InstabilityError, match=r"t = .*body 1: its speed rises in one step from nan .*usual cures"):
        with_nan("velocity", 2).stepper.take(1)
    with pytest.raises(InstabilityError, match=r"t = .*body 1: kinetic_energy is not a finite number"):
        with_nan("spin", 0).run()


def test_speed_limit_names_body_and_speed(device):
    scene = one_sphere(watch=Watch(speed=0.2), duration=0.1)
    with pytest.raises(InstabilityError, match=r"t = 0\.0.*body 0: its speed rises .* from 0\.1.*watch\.speed = 0\.2"):
        Simulation(scene, device=device).run()


def test_an_unstable_step_is_caught_by_its_energy_alone(device):
    # Undamped neighbours at 3 times the estimate: the energy tells before any speed would.
    scene = extremes.cup(restitution=1.0, sample_interval=1e-4)
    simulation = Simulation(scene, device=device)
    simulation.prepare()
    scene = dataclasses.replace(scene, time_step=TimeStep(fixed=3 * simulation.stepper.estimate(), safety=10.0))
    watch = Watch(overlap=None, speed=1e9, energy=0.5)
    with pytest.raises(InstabilityError, match="energy grew by"):
        Simulation(dataclasses.replace(scene, watch=watch, duration=0.1), device=device).run()


def test_the_watch_accepts_contact_laws_with_negative_energy(device):
    """Bodies that attract one another fall together: their energy passes from 0 over -2 J to rest, without gravity."""
    simulation = Simulation(one_sphere(gravity=(0.0, 0.0, 0.0)), device=device)
    simulation.prepare()
    watch = EnergyWatch(simulation.model, simulation.state)
    row = dict.fromkeys(("time", "kinetic_energy", "potential_energy", "elastic_energy", "bond_energy", "wall_work",
                         "drive_work", "deepest_overlap", "reach"), 0.0)  # fmt: skip
    watch(row)
    watch(row | {"time": 1.0, "elastic_energy": -2.0, "kinetic_energy": 1.5})
    watch(row | {"time": 2.0, "elastic_energy": -2.0})
    watch(row | {"time": 3.0, "elastic_energy": -2.0, "kinetic_energy": 0.5 * 3.5 * watch.limits.energy})
    with pytest.raises(InstabilityError, match=r"energy grew by 7 J without work"):
        watch(row | {"time": 4.0, "elastic_energy": 5.0})


def test_energy_that_grows_again_after_most_of_it_was_lost_is_noticed():
    """Rows by hand, in joules: what dampers took may not come back. Half of the largest energy may."""
    simulation = Simulation(one_sphere(gravity=(0.0, 0.0, 0.0)), device="cpu")
    simulation.prepare()
    watch = EnergyWatch(simulation.model, simulation.state)
    energies = ("potential_energy", "elastic_energy", "bond_energy")
    zero = dict.fromkeys(("deepest_overlap", "reach", "wall_work", "drive_work", *energies), 0.0)
    for time, kinetic in enumerate((100.0, 60.0, 10.0, 59.0)):
        watch(zero | {"time": float(time), "kinetic_energy": kinetic})
    watch(zero | {"time": 4.0, "kinetic_energy": 90.0, "wall_work": 40.0})
    with pytest.raises(InstabilityError, match="energy grew by 51 J"):
        watch(zero | {"time": 5.0, "kinetic_energy": 61.0})


def test_the_watch_can_be_told_to_let_it_be(device):
    scene = extremes.cup(modulus=1e4, duration=0.15)
    with pytest.raises(InstabilityError, match="a sphere overlaps"):
        Simulation(scene, device=device).run()
    assert Simulation(dataclasses.replace(scene, watch=Watch(overlap=None)), device=device).run().finished


def test_a_fixed_step_above_the_estimate_needs_a_word(device):
    from warpcrete.core.errors import SceneError

    pair = Bodies(positions=[[0.0, 0, 0], [0.0099, 0, 0]], sizes=0.01)
    scene = Scene(name="pair", duration=1e-3, bodies=(pair,), contact=Contact(friction=0))
    simulation = Simulation(scene, device=device)
    simulation.prepare()
    estimate = simulation.stepper.estimate()
    above = TimeStep(fixed=1.1 * estimate)
    with pytest.raises(SceneError, match="above the largest stable time step"):
        Simulation(dataclasses.replace(scene, time_step=above), device=device).run()
    overruled = TimeStep(fixed=1.1 * estimate, safety=1.2)
    assert Simulation(dataclasses.replace(scene, time_step=overruled), device=device).run().finished


def test_far_from_the_origin_small_steps_still_count(device):
    # 0.1 mm/s at 10 m: a step of 1e-6 s moves 1e-10 m, a ten-thousandth of what single precision resolves there.
    body = Bodies(positions=[[10.0, 0, 0]], sizes=0.1, velocities=np.array([[0.05, 0, 0]]))
    scene = Scene(name="far", duration=1.0, gravity=(0, 0, 0), bodies=(body,), time_step=TimeStep(fixed=1e-6))
    simulation = Simulation(scene, device=device, precision="float32")
    simulation.prepare()
    simulation.stepper.take(5000)
    assert simulation.state.bodies.position.numpy()[0, 0] - 10 == pytest.approx(0.05 * 5e-3, rel=5e-3)
