"""Scenes built in Python: general checks, the warning about a coarse step, and what a loaded run offers."""

import dataclasses
import math
import pickle
import re
import warnings
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

import warpcrete
from warpcrete.cli.run import report
from warpcrete.core.errors import InstabilityError, SceneError
from warpcrete.dem.engine.failures import unstable
from warpcrete.dem.laws import BinghamMortar, Contact, LubricationLayer, RollingResistance, own_laws
from warpcrete.dem.measure import watch
from warpcrete.dem.packing import pack
from warpcrete.dem.scene.checks import energy_check, overlap_words, warn_of_coarse_step
from warpcrete.dem.scene.clumps import sphere
from warpcrete.dem.scene.containers import Fill, PipeContainer
from warpcrete.dem.scene.scene import Bodies, TimeStep, Watch
from warpcrete.dem.scene.sizes import Uniform
from warpcrete.dem.simulation import ElementRun
from warpcrete.geometry.axis import Axis, Line
from warpcrete.geometry.walls import PlaneWall
from warpcrete.kernels.common.types import types
from warpcrete.kernels.dem.contact_law import contact_functions

FLOOR = PlaneWall(name="floor", point=(0, 0, 0), normal=(0, 0, 1))


def drop(**changes):
    """Return a scene in which one sphere falls 42 mm on a plane and rebounds."""
    settings = {"name": "drop", "duration": 0.14, "contact": Contact(effective_modulus=1e6), "walls": (FLOOR,),
                "bodies": (Bodies(positions=[[0, 0, 0.05]], sizes=0.015),), "energy_balance": True}  # fmt: skip
    return warpcrete.Scene(**settings | changes)


def run(scene, **settings):
    return warpcrete.Simulation(scene, device="cpu", threads=1, **settings).run()


@pytest.mark.parametrize("kind", ["safety", "fixed"])
def test_a_coarse_step_is_named_with_its_cure_and_the_cure_works(kind, tmp_path):
    coarse = TimeStep() if kind == "safety" else TimeStep(fixed=2e-4)
    with pytest.warns(
        UserWarning, match="the time step is too coarse for the impacts in this run: energy balance"
    ) as told:
        first = run(drop(time_step=coarse), out=tmp_path / "coarse")
    assert first["energy_balance_error"] > 0.1  # 0.25 and 0.23
    cure = re.search(rf"in Python TimeStep\({kind}=(\S+)\)", str(told[0].message))
    assert cure
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        second = run(drop(time_step=TimeStep(**{kind: float(cure[1])})), out=tmp_path / "fine")
    assert 0.004 < second["energy_balance_error"] < 0.01
    checks = [each.result["checks"] for each in (first, second)]
    assert list(checks[0]) == list(checks[1]) == ["no body swallowed", "momentum balance", "energy balance"]
    assert [name for name, check in checks[0].items() if not check["passed"]] == ["energy balance"]
    assert all(check["passed"] for check in checks[1].values())


def test_a_swallowed_body_fails_its_check(tmp_path):
    pair = Bodies(positions=[[0, 0, 0.05], [0.005, 0, 0.05]], sizes=[0.03, 0.005])  # the small one is inside
    soft = drop(bodies=(pair,), duration=0.01, energy_balance=False, watch=Watch(overlap=None, energy=None))
    checks = run(soft, out=tmp_path / "soft").result["checks"]
    assert not checks["no body swallowed"]["passed"] and "stiffer contacts" in checks["no body swallowed"]["found"]
    assert "energy balance" not in checks


def test_a_loaded_run_of_an_own_scene_offers_what_every_run_offers(tmp_path):
    run(drop(energy_balance=False, sample_interval=0.001), out=tmp_path / "run")
    back = warpcrete.load(tmp_path / "run")
    assert back.plot().get_suptitle() == back.plot("kinetic_energy", "largest_overlap").get_suptitle() == "drop"
    assert "of scene 'drop': finished" in repr(back) and "<table>" in back._repr_html_()
    assert len(back.table()) == len(back.to_xarray()["time"]) == 141
    assert back.quantities["momentum_balance_error"] == back["momentum_balance_error"] < 0.01
    copy = warpcrete.load(back.save(tmp_path / "copy"))
    assert copy.result == back.result and copy.scene.modified


def test_a_loaded_run_says_where_its_bodies_are(tmp_path):
    out = warpcrete.RunFolder(tmp_path / "run", recordings=["usd"])
    done = run(drop(energy_balance=False), out=out)
    back = warpcrete.load(tmp_path / "run")
    file = tmp_path / "run" / "scene.usdc"
    with pytest.raises(AttributeError, match=re.escape(f"their recorded frames are in {file}; ")):
        _ = back.bodies
    assert not hasattr(back, "body") and "energy_balance_error" not in pickle.loads(pickle.dumps(back)).quantities
    file.unlink()
    with pytest.raises(AttributeError, match="the folder has no recording of them"):
        _ = back.bodies
    assert len(done.bodies) == 1


def test_the_page_draws_the_final_state_from_the_recording(tmp_path, monkeypatch):
    """Run the lines of the page with the folder of a short run, and compare with the bodies of the run."""
    out = warpcrete.RunFolder(tmp_path / "my-run", recordings=["usd"])
    done = run(drop(energy_balance=False), out=out)
    page = (Path(__file__).parents[2] / "notebooks" / "how-to" / "view.md").read_text(encoding="utf-8")
    (lines,) = (block for block in re.findall(r"```python\n(.*?)```", page, re.S) if "PointInstancer" in block)
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(lines, names)
    assert names["position"] == pytest.approx(done.bodies.position, abs=1e-7)
    assert names["size"] == pytest.approx(done.bodies.size, rel=1e-6)
    assert (tmp_path / "final.png").stat().st_size > 1000


class Bookkeeper(warpcrete.Recorder):
    """Read the bodies as the page on recorders shows, at every row."""

    def __init__(self):
        self.rows, self.momentum = [], []

    def sample(self, simulation, row):
        bodies = simulation.result(finished=False).bodies
        stones = np.array([group != "plug" for group in bodies.group])
        mass, velocity = bodies.mass[stones], bodies.velocity[stones]
        self.rows.append([row["time"], *(mass @ velocity / mass.sum())])
        self.momentum.append([(bodies.mass @ bodies.velocity)[2], row["momentum_z"]])


def test_a_recorder_reads_the_bodies_without_the_plug():
    """One body falls for 0.05 s, and a ball of the plug flies upwards far from it."""
    ball = Bodies(positions=[[0.5, 0, 0.05]], sizes=0.03, velocities=[[0, 0, 2.0]], group="plug")
    scene, reader = drop(duration=0.05, energy_balance=False), Bookkeeper()
    run(dataclasses.replace(scene, bodies=(*scene.bodies, ball)), recorders=[reader])
    rows, momentum = np.array(reader.rows), np.array(reader.momentum)
    assert rows[:, 3] == pytest.approx(-9.81 * rows[:, 0], abs=9.81 * 3e-4)  # half a step of 2e-4 s late
    assert momentum[:, 0] == pytest.approx(momentum[:, 1], rel=0.01) and abs(momentum[-1, 0]) > 1e-3


def test_help_shows_the_meaning_and_the_unit_of_every_field():
    for documented in (warpcrete.Scene, Bodies, Fill, warpcrete.RunFolder):
        listed = re.findall(r"^- `(\w+)`: .{20}", documented.__doc__, re.M)
        assert listed == [field.name for field in dataclasses.fields(documented)]
    assert "`positions`: Centroids of the bodies [m], shape (n, 3)." in Bodies.__doc__
    assert "any of `rerun`, `usd` and `paraview`" in warpcrete.RunFolder.__doc__


def test_a_fill_says_which_shapes_it_has_and_how_to_get_spheres():
    assert "The default is the four clumps" in Fill.__doc__
    container = PipeContainer(Axis((0, 0, 0), (0, 0, 1), (Line(0.1),)), 0.05, 0.1)
    for wrong in ((), sphere()):
        with pytest.raises(SceneError, match=r"for single spheres: \(warpcrete.dem.scene.clumps.sphere\(\),\)"):
            Fill(container=container, templates=wrong, solid_fraction=0.5)


def test_an_own_law_is_told_about_bonds_and_coats():
    class Other(Contact):
        pass

    words = "bonds of mortar act in addition to the contact law; --no-bonds"
    for bonds in (True, False):
        remarks = warpcrete.scenes.pipe(contact=BinghamMortar(), bonds=bonds).remarks
        assert any(words in remark for remark in remarks) is bonds
    assert not any(words in remark for remark in warpcrete.scenes.pipe().remarks)
    texts = [overlap_words(drop(contact=law), 0.35) for law in (Contact(), BinghamMortar(), Other())]
    assert texts[0] == "largest overlap 0.35 of the smaller radius"
    assert texts[1] == f"{texts[0]}, of which shells of mortar are 0.2 in spheres of equal size"
    assert texts[2] == f"{texts[0]}, including coats that Other may have"


class Own(Contact):
    """The linear law as a class from outside of the package."""


class Pulling(Own):
    """The linear law with the wrong sign of the force."""

    @classmethod
    def device_functions(cls, scalar, parameters):
        functions = super().device_functions(scalar, parameters)
        right, Touch, P, vec3 = functions["force"], contact_functions(scalar).Touch, parameters, types(scalar).vec3

        @wp.func
        def force(p: P, touch: Touch, history: vec3, dt: scalar):
            on_a, new_history, lost = right(p, touch, history, dt)
            return -on_a, new_history, lost

        return functions | {"force": force}


def test_an_energy_balance_that_fails_names_a_law_from_outside_of_the_package():
    words = "or energy() and the losses of Own are inconsistent with its force()"
    for law, told in ((Own(), True), (Contact(), False)):
        done = ElementRun(drop(contact=law), {}, {}, {"energy_balance_error": 0.02}, True)
        ((passed, found),) = energy_check(done).values()
        assert not passed and "usual cure: --safety 0.32" in found and (words in found) is told
        with pytest.warns(
            UserWarning, match="in this run, or the contact law is wrong: en" if told else "this run: en"
        ):
            warn_of_coarse_step(done)
    within = drop(contacts={("aggregate", "wall"): LubricationLayer(contact=Own())})
    assert own_laws(within.laws()) == "Own" and own_laws([BinghamMortar(), RollingResistance()]) == ""


def test_an_unstable_run_names_a_law_from_outside_of_the_package(monkeypatch):
    hint = "or the opposite sign in force() of Own, if that force pulls where it should push"
    for law, told in ((Own(), True), (Contact(), False)):
        assert (hint in str(unstable(0.1, 0, "a speed", scene=drop(contact=law)))) is told
        watched = SimpleNamespace(model=SimpleNamespace(scene=drop(contact=law)), state=None, limits=Watch())
        monkeypatch.setattr(watch, "fastest_body", lambda model, state: 0)
        with pytest.raises(InstabilityError, match="pressure is not a finite number") as error:
            watch.Watch.__call__(watched, {"time": 0.1, "pressure": math.nan})
        assert (hint in str(error.value)) is told


def test_a_packing_refuses_a_law_with_the_wrong_sign_of_the_force():
    axis = Axis((0, 0, 0), (0, 0, 1), (Line(0.1),))
    fill = Fill(
        container=PipeContainer(axis, 0.05, 0.1), sizes=Uniform(0.012, 0.016), templates=(sphere(),), pressure=500.0
    )
    with pytest.raises(SceneError, match=r"Pulling\.force\(\) = 'a pull of .*must push overlapping stones apart"):
        pack(fill, contact=Pulling(effective_modulus=1e6), device="cpu")


def test_a_report_tells_the_time_that_the_run_does_not_account_for(capsys):
    speed = {"wall_time": {"value": 8.0, "unit": "s"}, "packing_time": {"value": 2.0, "unit": "s"}}
    speed |= {"steps_per_second": {"value": 50.0, "unit": "1/s"}}
    result = {"speed": speed, "steps": 400, "provenance": {"device": "cpu"}, "simulated_time": 1.0}
    done = ElementRun(drop(), {"time": np.zeros(0)}, {}, result, True)
    for took, words in ((10.6, ""), (21.0, ", and 11 s to compile kernels, set up and write files")):
        report(done, took=took)
        (line,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("time "))
        assert line.endswith(f"10 s for 400 steps on cpu (50 per second while the steps run){words}")


def test_a_warning_that_is_an_error_keeps_the_results(tmp_path):
    folder = tmp_path / "run"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(UserWarning, match="coarse for the impacts"):
            run(drop(time_step=TimeStep()), out=folder)
    assert warpcrete.load(folder).finished and not (folder / ".lock").exists()
