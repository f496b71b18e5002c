"""Pistons that stop: their motion, what a rest grows, and what a run makes of it."""

import functools
import math

import numpy as np
import pytest
from conftest import bonds_of
from pumping import SMALL

from warpcrete import SceneError, Simulation, scenes
from warpcrete.core.run.recorder import Recorder
from warpcrete.dem.batch_run import run_batch
from warpcrete.dem.engine.pairs import listed_pairs
from warpcrete.dem.engine.state_data import state_hash
from warpcrete.dem.laws import Contact, LubricationLayer
from warpcrete.dem.scene.clumps import ClumpTemplate
from warpcrete.dem.scene.concretes import COVERAGE
from warpcrete.dem.scene.scene import Bodies, PipeUnit, PlaneWall, Prescribed, Rest, Scene, Stops, TimeStep
from warpcrete.dem.scene.strokes import held, peaks, strokes_of

RAMP, STROKE, PAUSE, COUNT = 0.013, 0.047, 0.021, 3
STOPPING = SMALL | dict(settle=0.05, length=0.12, travel=0.04, ramp=5e-3, strokes=2, pause=0.06)


def gone(time: float, ramp=RAMP, stroke=STROKE, pause=PAUSE, count=COUNT) -> float:
    """Distance at unit speed, from the areas under the trapezoids of speed that have begun, one by one."""
    total = 0.0
    for number in range(count + 1):
        t = time - number * (stroke + pause)
        if t <= 0:
            break
        total += 0.5 * t * t / ramp if t < ramp else t - 0.5 * ramp
        slows = stroke - ramp
        if number < count and t > slows:  # what full speed would have given, less what the speed has lost
            late = min(t, stroke) - slows
            total -= 0.5 * late * late / ramp + max(0.0, t - stroke)
    return total


def moving_scene(**motion) -> Scene:
    walls = (
        PlaneWall(name="piston", point=(0, 0, 0), normal=(0, 0, 1),
                  motion=Prescribed(velocity=(0, 0, 0.3), ramp_time=RAMP, **motion)),
        PlaneWall(name="turner", point=(1, 0, 0), normal=(0, 0, 1),
                  motion=Prescribed(spin=(0, -2.0, 0), ramp_time=RAMP, start_time=0.004, **motion)),
    )  # fmt: skip
    return Scene(name="walls", duration=1, walls=walls, time_step=TimeStep(fixed=1e-4), gravity=(0, 0, 0),
                 bodies=(Bodies(positions=[[5, 5, 5]], sizes=0.01),))  # fmt: skip


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_motion_with_stops_follows_its_closed_form(start, precision):
    stepper = start(moving_scene(stops=Stops(count=COUNT, stroke_time=STROKE, pause=PAUSE)), precision)
    walls, before, standing = stepper.state.walls, stepper.time, 0
    for _ in range(300):
        stepper.take(10)
        now = stepper.time
        place, turned = walls.position_exact.numpy().reshape(-1, 3)
        way, angle = 0.3 * gone(now), 2.0 * gone(now - 0.004)
        assert place == pytest.approx([0, 0, way], abs=1e-15)  # measured 1e-17
        assert turned == pytest.approx([math.cos(angle), 0, math.sin(angle)], abs=3e-15)
        assert walls.travel.numpy() == pytest.approx([way, angle], abs=3e-15)
        # Speeds are means over the last step.
        speed = (0.3 * gone(now) - 0.3 * gone(now - 1e-4)) / 1e-4
        assert walls.velocity_exact.numpy()[0][2] == pytest.approx(speed, abs=1e-11)
        standing += speed == 0 and walls.velocity_exact.numpy()[0][2] == 0
        before = now
    assert before > COUNT * (STROKE + PAUSE) + RAMP and 40 < standing < COUNT * PAUSE / 1e-3 + 5
    assert walls.velocity_exact.numpy()[0][2] == pytest.approx(0.3, abs=1e-12)


def test_stops_that_cannot_be():
    with pytest.raises(
        SceneError, match=r"stroke_time = 0.02: must be at least two ramps of 0.013 s; reduce 'ramp_time'"
    ):
        moving_scene(stops=Stops(count=1, stroke_time=0.02, pause=0.0))
    with pytest.raises(SceneError, match="pause = -1"):
        Stops(count=1, stroke_time=0.02, pause=-1.0)
    with pytest.raises(SceneError, match="stops = 0: must be a whole number"):
        Stops(count=0, stroke_time=0.02, pause=1.0)
    # Without a ramp the piston stops at once, and every number of stops goes as far.
    assert gone(1.0, 1e-12, 0.1, 0.05, 3) == pytest.approx(1.0 - 0.15, abs=1e-9)


def dragged(rest: Rest) -> Scene:
    """A heavy tripod stands on a floor that is pulled away under it; the layer between has a yield stress."""
    feet = 0.4 * np.array([[1, 0, 0], [-0.5, math.sqrt(0.75), 0], [-0.5, -math.sqrt(0.75), 0]])
    tripod = ClumpTemplate("tripod", feet, np.full(3, 0.2), np.full(3, 0.1))
    size = 0.05
    floor = PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1), motion=Prescribed(velocity=(0.1, 0, 0)))
    radius = size * tripod.radii[0]
    sink = 1e-4
    layer = LubricationLayer(contact=Contact(friction=0.0, normal_damping_ratio=1.0), yield_stress=40.0)
    return Scene(
        name="drag", duration=1, walls=(floor,), contacts={("aggregate", "wall"): layer}, rest=rest,
        time_step=TimeStep(fixed=1e-5), gravity=(0, 0, -9.81),
        bodies=(Bodies(positions=[[0, 0, radius - sink]], sizes=size, template=tripod, density=1e4),),
    )  # fmt: skip


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_layer_bears_what_it_gained_at_rest_and_slip_wears_it_off(start, precision):
    rest = Rest(at=0.0, duration=300.0, growth=0.5, breakdown=2e-3, wall="floor")
    stepper = start(dragged(rest), precision)
    area = 3 * math.pi * float(stepper.state.spheres.position.numpy()[0, 3]) ** 2
    stepper.take(200)
    own = stepper.state.walls.force.numpy()[0, 0]
    assert own == pytest.approx(-40.0 * area, rel=1e-4)
    begun = stepper.apply_rest()
    assert begun == pytest.approx(0.1 * stepper.time, rel=1e-12)
    stepper.take(600)  # the spring first has to be stretched as far again
    bore = []
    for _ in range(4):
        stepper.take(1000)
        slip = 0.1 * (stepper.time - 1e-5) - begun  # by which the stress of the last step went
        expected = (40.0 + 150.0 * math.exp(-slip / 2e-3)) * area
        assert -stepper.state.walls.force.numpy()[0, 0] == pytest.approx(expected, rel=2e-4)
        bore.append(expected / area)
    assert bore[0] > 100 and bore[-1] < 70


def test_a_rest_bonds_what_touches_and_keeps_the_loads_of_bonds(device):
    scene = scenes.pipe(rest=600.0, thixotropy=0.25, tensile_strength=1e3, cohesion=800.0, **STOPPING)
    simulation = Simulation(scene, device=device)
    simulation.prepare()
    simulation.stepper.advance(scene.rest.at)
    kinds = simulation.model.bond_kinds
    assert kinds[-1].tensile_strength == kinds[0].tensile_strength + 150
    assert kinds[-1].cohesion == kinds[0].cohesion + 150

    def bonds():
        i, j, entry = listed_pairs(simulation.state)
        ids = simulation.state.spheres.id.numpy()
        kind, force = (each[entry] for each in bonds_of(simulation.state))
        place = simulation.state.spheres.position.numpy()
        gap = np.linalg.norm(place[i, :3] - place[j, :3], axis=1) - place[i, 3] - place[j, 3]
        return {(min(a, b), max(a, b)): (k, tuple(f), g) for a, b, k, f, g in zip(ids[i], ids[j], kind, force, gap)}

    before = bonds()
    assert simulation.stepper.apply_rest() == pytest.approx(0.02, rel=1e-12)
    after = bonds()
    grown, made = len(kinds), 0
    for pair, (kind, force, gap) in before.items():
        if kind == 1:
            assert after[pair][:2] == (grown, force)  # carries on what it carried
        elif kind <= 0 and gap <= 0:
            assert after[pair][:2] == (grown, (0.0,) * 8)
            made += 1
        elif pair in after:  # lists drop what has gone far
            assert after[pair][0] == kind
    kept = sum(kind == 1 for kind, _, _ in before.values())
    assert made > 30 and kept > 1000, (made, kept)  # of 28 packings 38 to 166 and 1255 to 1499


def test_a_restart_takes_more_than_the_first_start_and_balances_hold(device):
    plain = Simulation(scenes.pipe(energy_balance=True, **STOPPING), device=device).run()
    run = Simulation(scenes.pipe(energy_balance=True, rest=600.0, **STOPPING), device=device).run()
    assert run["first_peak_pressure"] == plain["first_peak_pressure"]
    assert run["held_pressure"] == plain["held_pressure"]
    assert run["restart_pressure"] > 1.1 * plain["restart_pressure"]  # measured 1.17
    assert run["held_pressure"] < 0.6 * run["first_peak_pressure"]
    assert run["momentum_balance_error"] < 3e-5 and abs(run["energy_balance_error"]) < 6e-4  # 4e-6, 1e-4
    assert run.series["travel"][-1] == pytest.approx(0.04, abs=2e-4)
    assert set(run.result["strokes"]) == {"1", "2"} and run.result["strokes"]["1"]["held_pressure"]["value"] > 0


@pytest.mark.thorough
def test_a_layer_grown_at_rest_takes_its_stress_times_its_area(device):
    """Where slip wears nothing off, the pressure rises by the stress on pi r^2 of every contact, over the section."""
    given = STOPPING | dict(travel=0.06, settle=0.1, shapes="reference", concrete="no2", unit="horizontal", bonds=False)
    rise, area = 0.0, 0.0
    for seed in range(3):  # one packing is 8 to 12 % off, by the waves of the column and what presses harder
        ends = []
        for more in ({}, dict(rest=600.0, breakdown=1e3)):
            simulation = Simulation(scenes.pipe(**given | more, seed=seed), device=device)
            ends.append(simulation.run()["end_pressure"])
            _, y, z, radius = simulation.state.spheres.position.numpy().astype(float).T
            area += 0.5 * math.pi * np.sum(radius[np.hypot(y, z) + radius > 0.04] ** 2)
        rise += ends[1] - ends[0]
    # 3.4 % more on a CPU.
    assert rise == pytest.approx(300.0 / COVERAGE * area / (math.pi * 0.04**2), rel=0.08)


def test_strokes_without_a_pause_are_the_plain_run(device):
    short = STOPPING | dict(travel=0.012, pause=0.0)
    plain = {name: value for name, value in short.items() if name not in ("strokes", "pause")}
    runs = [Simulation(scenes.pipe(**each), device=device).run() for each in (short, plain)]
    assert runs[0].result["state_hash"] == runs[1].result["state_hash"]
    assert "restart_pressure" not in runs[0].result


class CutAt(Recorder):
    """Stops after the row at a time."""

    def __init__(self, time):
        self.time = time

    def sample(self, simulation, row):
        simulation.stop_requested = row["time"] >= self.time


@functools.cache
def uncut(device):
    return Simulation(scenes.pipe(rest=600.0, **STOPPING), device=device).run()


@pytest.mark.parametrize("cut", [0.12, 0.17, 0.185])  # in the pause, just after the rest, on the way
def test_a_run_cut_in_a_pause_or_after_a_rest_goes_on_with_the_same_bits(device, tmp_path, cut):
    scene, whole = scenes.pipe(rest=600.0, **STOPPING), uncut(device)
    first = Simulation(scene, device=device, checkpoint_path=tmp_path / "c.npz", recorders=[CutAt(cut)])
    assert not first.run().finished
    second = Simulation(scene, device=device)
    second.resume(tmp_path / "c.npz")
    rest = second.run()
    assert rest.finished and rest.result["state_hash"] == whole.result["state_hash"] == state_hash(second.state)
    for name in whole.series:
        assert np.array_equal(whole.series[name], rest.series[name], equal_nan=True), name


@pytest.mark.thorough
def test_strokes_in_a_batch_hold_the_bits_of_runs_alone(device):
    several = [
        scenes.pipe(**STOPPING | more)
        for more in (dict(rest=600.0), dict(rest=60.0, pause=0.03), dict(rest=600.0, travel=0.045, strokes=3))
    ]
    alone = [Simulation(scene, device=device, threads=1).run() for scene in several]
    batch = run_batch([Simulation(scene, device=device, threads=1) for scene in several])
    assert [run.result["state_hash"] for run in batch] == [run.result["state_hash"] for run in alone]
    assert len({run.result["state_hash"] for run in alone}) == 3


def test_a_bend_stops_too(device):
    run = Simulation(scenes.pipe(unit="C", rest=60.0, **STOPPING), device=device).run()
    assert run.finished and run.series["travel"][-1] == pytest.approx(0.04, abs=2e-4)
    standing = run.series["travel"][(run.series["time"] > 0.1) & (run.series["time"] < 0.13)]
    assert len(standing) > 2 and np.ptp(standing) == 0 and standing[0] == pytest.approx(0.02, rel=1e-12)
    assert run["momentum_balance_error"] < 1e-4


def test_peaks_and_what_is_held_of_made_up_strokes():
    stops = Stops(count=1, stroke_time=1.0, pause=0.4)
    pipe = PipeUnit(name="vertical", axis=None, radius=0.1, concrete_length=1, velocity=1, ramp=0.1, travel=1.8,
                    stops=stops)  # fmt: skip
    time = np.arange(0, 24) / 10
    pressure = np.where(time < 1.05, 5.0, np.where(time < 1.25, 3.0, np.where(time < 1.45, 2.0, 7.0)))
    pressure[4], pressure[20] = 9.0, 11.0
    series = {"time": time, "pressure": pressure}
    assert peaks(pipe, series) == [9.0, 11.0] and held(pipe, series) == [2.0]
    moving = [each.moving for each in strokes_of(pipe, time)]
    assert not np.any(moving[0] & moving[1]) and moving[0].sum() + moving[1].sum() == 24 - 4
    assert peaks(pipe, {"time": time[:13], "pressure": pressure[:13]}) == [9.0]
    assert pipe.stroke == 0.9 and [pipe.begun(x) for x in (0.0, 0.5, 0.9, 1.0, 1.8)] == [0, 0, 0.9, 0.9, 0.9]


@pytest.mark.parametrize(
    "bad, message",
    [
        (dict(stroke=0.1), "stroke = 0.1: has no effect unless 'strokes' is 2 or more"),
        (dict(rest=10.0), "rest = 10.0: has no effect unless 'strokes' is 2 or more"),
        (dict(strokes=2, pause=-0.1), "pause = -0.1: must be"),
        (
            dict(strokes=2, pause=0.0, rest=5.0),
            "rest = 5.0: takes place in the last stop between strokes, and there is no stop; set 'pause' above 0",
        ),
        (dict(strokes=2, thixotropy=0.3), "thixotropy = 0.3: has no effect unless 'rest' is above 0"),
        (dict(strokes=2, rest=-1.0), "rest = -1.0: must be"),
        (dict(strokes=2, stroke=0.5), "stroke = 0.5: must hold two ramps of 0.3 m, one from rest and one to rest"),
        (
            dict(strokes=2, stroke=0.7, travel=1.4),
            "travel = 1.4: is already set by 2 strokes of 0.7 m; leave out 'travel'",
        ),
        (
            dict(strokes=2, rest=9.0, bonds=False, concrete="zhan-table1"),
            "rest = 9.0: has no effect, because there are",
        ),
        (
            dict(unit="C", strokes=2, stroke=0.4, ramp=0.1),
            "stroke = 0.4: is too long, because 2 strokes together must not exceed the length of the bend's arc",
        ),
        (dict(strokes=0), "strokes = 0: must"),
    ],
)
def test_strokes_that_cannot_be_are_refused_in_one_line(bad, message):
    with pytest.raises(SceneError) as caught:
        scenes.pipe(**bad)
    assert str(caught.value).startswith(message) and "\n" not in str(caught.value)
