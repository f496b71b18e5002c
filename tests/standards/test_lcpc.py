"""LCPC box: a test whose record and whose scenes for both methods are in one file."""

import importlib
import pickle
import subprocess
import sys

import numpy as np
import pytest
from click.testing import CliRunner
from made_runs import RUNS, vessel

from warpcrete import SceneError, Simulation, scenes
from warpcrete.cli.main import cli
from warpcrete.core.run.method import report_of
from warpcrete.core.units import number
from warpcrete.methods import method_of
from warpcrete.mps.free.quantities import start_volume
from warpcrete.studies.api import module_of

OWN = dict(concrete="own", density=2300.0, viscosity=20.0, yield_stress=200.0)


def test_one_file_holds_the_scenes_of_both_methods():
    both = scenes.lcpc, scenes.lcpc_dem
    assert [each.name for each in both] == ["lcpc", "lcpc-dem"]
    assert [scenes.by_method("lcpc", method) for method in ("mps", "dem")] == ["lcpc", "lcpc-dem"]
    for each in both:
        name, module = module_of(each)
        assert module is scenes.modules()[name] is importlib.import_module(module.__name__)
        assert method_of(each()) is method_of(module.scene())
    assert both[0]().test is both[1]().vessel.test
    told = CliRunner().invoke(cli, ["list"]).output.splitlines()
    assert sum("LCPC" in line for line in told if line.startswith("lcpc")) == 2
    for method, option in (("mps", "--surfaces"), ("dem", "--shell-modulus")):
        helped = CliRunner().invoke(cli, ["run", "lcpc", "--method", method, "--help-all"])
        assert helped.exit_code == 0 and option in helped.output and "--column-length" in helped.output


def test_another_process_finds_both_scenes_and_their_test():
    """A worker of a study imports a scene's module by its name, and takes records of tests from a pickle."""
    record = pickle.dumps(scenes.lcpc().test)
    code = (
        "import importlib, pickle\n"
        f"assert pickle.loads({record!r}).name == 'lcpc'\n"
        "assert importlib.import_module('warpcrete.scenes.lcpc_dem').scene.name == 'lcpc-dem'"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8")
    assert done.returncode == 0, done.stderr


def test_the_box_holds_six_litres():
    assert 2 * start_volume(scenes.lcpc()) == pytest.approx(6e-3, rel=1e-9)
    assert scenes.lcpc_dem().fill.container.volume == pytest.approx(6e-3, rel=1e-9)


@pytest.mark.parametrize("name", ["lcpc", "lcpc-dem"])
def test_the_yield_stress_follows_from_the_length_short_of_the_far_end(name):
    made = RUNS[name]()
    made.series["front"] = np.where(made.series["time"] > 0, 0.7, 0.2)
    thin = made.run()["apparent_yield_stress"]
    made.series["front"][-1] = 0.5
    assert made.run()["apparent_yield_stress"] > 2 * thin
    made.series["front"][-1] = 0.25  # the theory would have it rest deeper than the column in which it started
    assert "apparent_yield_stress" not in made.run().result
    made.series["front"][-1] = 0.2  # concrete that keeps the form of its column bears an unknown yield stress
    assert "apparent_yield_stress" not in made.run().result
    made.series["front"][-1] = 1.19
    assert "apparent_yield_stress" not in made.run().result


def test_elements_of_mortar_stand_beside_closed_forms_and_others_do_not():
    """Elements report the closed forms that a flow reports, for the density of the filled vessel."""
    mortar = vessel("lcpc-dem", law="mortar", yield_stress=200.0, bulk_density=2300.0).run()
    wanted = method_of(scenes.lcpc()).expected(scenes.lcpc(**OWN))
    assert "spread_length" in wanted  # stiffer concrete would rest deeper than its column, where no closed form holds
    assert "spread_length" not in method_of(scenes.lcpc()).expected(scenes.lcpc(**OWN | {"yield_stress": 1000.0}))
    told = dict(report_of(method_of(mortar.scene).quantities, mortar))
    for name, suffix in (("spread_length", "theory"), ("h0", "theory"), ("apparent_yield_stress", "given")):
        assert number(mortar.result[f"{name}_{suffix}"]) == pytest.approx(wanted[name], rel=1e-9)
    assert told["spread length"].endswith("(slow flow: 423 mm)")
    assert "slump_theory" in vessel("slump-dem", law="plastic").run().result
    for law in ("rolling", "bonds"):
        assert "spread_length_theory" not in vessel("lcpc-dem", law=law).run().result


@pytest.mark.parametrize(
    ("name", "given", "field"),
    [
        ("lcpc", {"length": 0.25}, "length"), ("lcpc", {"spacing": 0.03}, "spacing"),
        ("lcpc", {"lift_time": 0.0}, "lift_time"), ("lcpc", {"surfaces": "wet"}, "surfaces"),
        ("lcpc-dem", {"length": 0.25}, "length"), ("lcpc-dem", {"size_max": 0.04}, "size_max"),
        ("lcpc-dem", {"height": 0.05}, "size_max"),
    ],
)  # fmt: skip
def test_what_the_box_refuses(name, given, field):
    with pytest.raises(SceneError, match=f"^{field} = "):
        scenes.modules()[name].scene(**given)


@pytest.mark.thorough
def test_a_slow_flow_comes_to_rest_where_its_yield_stress_bears_it(device):
    """Measured with these coarse cells: 400 mm for 423, 118 mm for 113, and 232 Pa for 200."""
    run = Simulation(scenes.lcpc(**OWN, spacing=0.025, lift_time=2.0), device=device).run()
    assert all(good for good, _ in scenes.modules()["lcpc"].check(run).values())
    assert run["spread_length"] == pytest.approx(run["spread_length_theory"], abs=0.04)
    assert run["h0"] == pytest.approx(run["h0_theory"], rel=0.08)
    assert run["apparent_yield_stress"] == pytest.approx(200.0, rel=0.25)


@pytest.mark.thorough
def test_grains_spread_along_the_box(device):
    """A small one: grains leave through the gate, lie lower where they were poured, and stay in the box."""
    small = dict(column_length=0.1, width=0.1, height=0.1, length=0.4, lift_time=0.4, duration=1.6, law="mortar")
    run = Simulation(scenes.lcpc_dem(**small, yield_stress=50.0), device=device, threads=1).run()
    assert 0.15 < run["spread_length"] < 0.41 and 0.02 < run["h0"] < 0.09
    assert run.result["strays"] < 0.02 and {"spread_length_theory", "h0_theory"} <= set(run.result)
