"""Scenes built in Python: general checks, the warning about a coarse step, and what a loaded run offers."""

import re
import warnings

import pytest

import warpcrete
from warpcrete.dem.laws import Contact
from warpcrete.dem.scene.scene import Bodies, TimeStep, Watch
from warpcrete.geometry.walls import PlaneWall

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
    with pytest.warns(UserWarning, match="the time step is coarse for the impacts in this run: energy balance") as told:
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
