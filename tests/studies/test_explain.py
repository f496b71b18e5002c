"""Compare the forecasts of `explain` with the state of a run that begins. Only benchmarks compare times."""

import importlib
import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from pumping import command

import warpcrete
from warpcrete import Simulation, scenes
from warpcrete.core.device.footprint import footprint
from warpcrete.core.errors import RunFolderError, SceneError
from warpcrete.core.inputs.fingerprints import fingerprint
from warpcrete.dem.forecast import tiled
from warpcrete.dem.packing import pack
from warpcrete.dem.scene.containers import MeshContainer, PipeContainer
from warpcrete.geometry.axis import Arc, Axis, Line
from warpcrete.studies.tradeoffs.explain import _measured_savings, _time_step_savings, explain

SMALL = dict(diameter=0.1, size_min=12e-3, size_max=20e-3, length=0.5, ramp=0.02, travel=0.05, plug_ball=15e-3)
SHORT = SMALL | dict(length=0.1, solid_fraction=0.55)


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    """Nothing is kept in the user's cache, and times, which no test here looks at, are measured hastily."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for method in ("dem", "mps.common"):
        monkeypatch.setattr(f"warpcrete.{method}.forecast.TIMING_TIME", 0.02)


OTHERS = {"vertical": {}, "bend": dict(unit="D", elbow_radius=0.3),
          "clumps": dict(shapes="reference", precision="float64")}  # fmt: skip


@pytest.mark.thorough
@pytest.mark.parametrize("changes", OTHERS.values(), ids=OTHERS)
def test_what_is_foretold_of_elements_is_what_a_run_has(device, changes):
    """Measured with one seed each: spheres 0.98 to 0.99, step 0.92 to 1.05, memory 0.97 to 0.99 of the run's on a CPU;
    steps of clumps up to 17 % off on an H200."""
    scene = scenes.pipe(**SMALL | changes)
    told = explain(scene, device=device, threads=1, cache=False).forecast
    simulation = Simulation(scene, device=device, threads=1, precision=scene.precision)
    simulation.prepare()
    simulation.stepper.advance(5 * simulation.stepper.dt)
    simulation.measure()
    assert told.counts["spheres"] == pytest.approx(simulation.state.sphere_count, rel=0.03)
    off = 0.15 if device == "cpu" else 0.2
    assert told.time_step == pytest.approx(simulation.stepper.dt, rel=off)
    assert told.steps == pytest.approx(scene.duration / simulation.stepper.dt, rel=off)
    assert told.total_memory == pytest.approx(footprint(all=simulation)["all"], rel=0.05)
    assert set(told.parts) == {"packing", "settling", "steps", "list builds", "samples"}
    assert all(spent > 0 for spent in told.parts.values()), told.parts
    assert set(told.frame) == {"rerun", "usd"}


def test_what_is_foretold_of_a_flow_is_what_a_run_has(device):
    scene = scenes.channel(spacing=0.02)
    told = explain(scene, device=device, threads=1, cache=False).forecast
    run = Simulation(scene, device=device, threads=1).run()
    assert told.counts["particles"] == run.result["particles"] and told.steps == run.result["steps"]
    assert told.total_memory == pytest.approx(run.result["speed"]["memory"]["value"], rel=0.05)
    # For a flow with more particles, a coarser copy tells within two samples of 5 ms when the flow is steady.
    fine = explain(scenes.channel(spacing=2.5e-3), device=device, cache=False).forecast
    assert fine.steps == pytest.approx(Simulation(scenes.channel(spacing=2.5e-3), device=device).run().result["steps"],
                                       abs=20)  # fmt: skip
    assert explain(scenes.channel(duration=0.05), device=device, cache=False).forecast.steps == 100


FLOWS = {
    "particles": lambda: scenes.channel(spacing=0.02, duration=0.01),
    "free": lambda: scenes.slump(spacing=0.015, duration=0.1),
    "part": lambda: scenes.part(unit="horizontal", straight=0.15, spacing=0.0125, diameter=0.1),
}


@pytest.mark.thorough
@pytest.mark.parametrize("kind", FLOWS)
def test_a_forecast_of_a_flow_states_the_threads_that_it_uses(kind):
    scene = FLOWS[kind]()
    features = [explain(scene, device="cpu", threads=n, cache=False).forecast.features["threads"] for n in (1, 2)]
    simulation = Simulation(scene, device="cpu", threads=2)
    simulation.prepare()
    assert features == ["1", str(simulation.flow.threads)]
    assert features[1] == ("1" if kind == "particles" else "2"), "a small flow of particles uses one thread"


@pytest.mark.thorough
def test_dashpots_that_limit_the_step_are_a_saving(device):
    """For one contact, the step with a damping ratio b is sqrt(1 + b^2) - b of that without, here 0.62."""
    contacts = {**SMALL, "length": 0.2, "bonds": False, "plug": "none"}
    contacts.pop("plug_ball")
    told = explain(scenes.pipe(**contacts), device=device, threads=1, cache=False)
    limits = told.forecast.limits
    assert told.forecast.governing.startswith("contacts; their dashpots shorten the step by")
    ratio = limits["contacts"] / limits["contacts without dashpots"]
    assert math.sqrt(1.25) - 0.5 <= ratio < 0.85
    (saving,) = _time_step_savings(replace(told.forecast, parts={"steps": 1.0}))
    assert saving.what == "no dashpots, or less damping" and saving.ratio == pytest.approx(ratio)
    bare = explain(scenes.pipe(**contacts, normal_damping=0.0), device=device, threads=1, cache=False)
    assert "dashpots" not in bare.forecast.governing
    assert not list(_time_step_savings(replace(bare.forecast, parts={"steps": 1.0})))


@pytest.mark.thorough
def test_what_governs_the_step_and_what_to_do_about_it(device):
    scene = scenes.pipe(**SMALL | dict(hydration=0.1, hydration_modulus=1e8, length=0.2))
    rounds = explain(scene, device=device, threads=1, cache=False).forecast
    assert "rounds per step" in rounds.governing
    bounds = rounds.limits
    assert bounds["hydrated bonds, a round"] < 0.1 * bounds["contacts"]
    of_contacts = min(dt for name, dt in bounds.items() if name.startswith("contacts and"))
    assert bounds["all together"] == pytest.approx(0.5 * of_contacts, rel=0.05)
    scene = replace(scene, time_step=replace(scene.time_step, rounds=1))
    told = explain(scene, device=device, threads=1, cache=False)
    limits = told.forecast.limits
    assert told.forecast.governing.startswith("hydrated bonds, which shorten the step")
    assert limits["contacts and hydrated bonds"] < 0.1 * limits["contacts and bonds"]
    # Steps of a bond go with the root of its stiffness.
    softer = replace(scene, hydration=replace(scene.hydration, bonds=replace(scene.hydration.bonds,
                                                                            effective_modulus=1e8 / 4)))  # fmt: skip
    other = explain(softer, device=device, threads=1, cache=False).forecast.limits
    ratio = other["contacts and hydrated bonds"] / limits["contacts and hydrated bonds"]
    assert ratio == pytest.approx(2.0, rel=0.05)
    assert "dashpots" not in told.forecast.governing
    (saving,) = [s for s in told.savings if "dashpots" in s.what or "hydrated" in s.what]
    assert saving.what == "no hydrated bonds, or softer ones"
    assert saving.ratio < 0.8 and saving.error == "error not measured"
    assert limits["contacts without dashpots"] > 1.1 * limits["contacts"]
    assert "mm" in told.forecast.governing
    fixed = explain(replace(scene, time_step=replace(scene.time_step, fixed=1e-7)), device=device, cache=False)
    assert fixed.forecast.time_step == 1e-7 and fixed.forecast.governing == "the given time_step = 1e-07 s"


def test_features_are_those_that_are_compiled_in(device):
    def used(**changes) -> set[str]:
        scene = scenes.pipe(concrete="zhan-table1", **SHORT | changes)
        if not changes.get("bonds", True):  # of the plug, too
            scene = replace(scene, bodies=(), drives=(), group_bonds={})
        features = explain(scene, device=device, cache=False)
        return {name for name, why in features.forecast.features.items() if why != "left out"}

    bare, usual = used(bonds=False, friction=0.0), used()
    assert {"shear history", "rotation", "bonds", "clumps", "drives", "healing", "energy balance"}.isdisjoint(bare)
    assert usual - bare == {"shear history", "rotation", "bonds", "drives"}
    assert used(healing=True, shapes="reference", energy_balance=True) - usual == {"healing", "clumps",
                                                                                  "energy balance"}  # fmt: skip


def test_a_packing_is_repeated_along_a_pipe():
    axis = Axis((0, 0, 0), (1, 0, 0), (Arc(0.5, np.pi / 2, (0, 0, 1)), Line(1.0)))
    fill = replace(scenes.pipe(**SMALL).fill, container=PipeContainer(axis, 0.05, 0.15))
    table, _ = pack(fill, device="cpu")
    whole = tiled(table, axis, 0.15, 0.6)
    assert len(whole) == 4 * len(table) and len(tiled(table, axis, 0.15, 0.5)) < len(whole)
    np.testing.assert_allclose(whole.position[: len(table)], table.position, atol=1e-9)
    across = np.linalg.norm(whole.position - axis.nearest(whole.position), axis=1)
    np.testing.assert_allclose(across.reshape(4, -1), np.tile(across[: len(table)], (4, 1)), atol=1e-4)
    assert whole.size.sum() == pytest.approx(4 * table.size.sum()) and len(whole.material) == len(whole)


def test_a_forecast_is_kept_for_the_next_time(tmp_path, monkeypatch):
    scene = scenes.channel(spacing=0.02)
    first = warpcrete.explain(scene, device="cpu")
    (kept,) = (tmp_path / "cache").rglob("explain-*.json")
    assert str(explain(scene, device="cpu")) == str(first)
    before = kept.stat().st_mtime_ns
    kept.write_text("{", encoding="utf-8")  # a broken one counts as none
    assert explain(scene, device="cpu").forecast.counts == first.forecast.counts
    assert kept.stat().st_mtime_ns != before and json.loads(kept.read_text(encoding="utf-8"))["counts"]
    explain(scenes.channel(spacing=0.0195), device="cpu")
    assert len(list((tmp_path / "cache").rglob("explain-*.json"))) == 2


def test_savings_by_a_trade(tmp_path):
    def point(setting: str, origin: str, time: float, shift: float, suspect: tuple = ()) -> dict:
        errors = {"plateau_pressure": {"shift": shift, "interval": 0.001}}
        return dict(setting=setting, origin=origin, time={"value": time}, errors=errors, suspect=suspect)

    points = [point("as given", "as given", 2.0, 0.0), point("time step 1.2", "time step", 1.4, 0.003),
              point("wall 64 facets", "wall", 2.8, 0.001), point("both", "combined", 0.1, 0.1),
              point("stiffness 1 Pa", "stiffness", 0.1, 0.1, ("no aggregate swallowed",))]  # fmt: skip
    record = {"scene": "pipe", "machine": "some machine", "points": points}
    (tmp_path / "trade.json").write_text(json.dumps(record), encoding="utf-8")
    told = explain(scenes.pipe(**SHORT), device="cpu", trade=tmp_path)
    assert [(s.what, s.ratio, s.error) for s in told.savings if s.error != "error not measured"] == [
        ("time step 1.2", pytest.approx(0.7), "error of plateau_pressure +0.3 +- 0.1 %")
    ]
    assert "some machine" in str(told) and "time step 1.2: 0.7 of the wall time; error of plateau" in str(told)


def test_savings_are_those_of_settings_that_the_scene_shares_with_the_trade(tmp_path):
    def point(setting: str, origin: str, time: float) -> dict:
        errors = {"slump": {"shift": 0.01, "interval": None}}
        return dict(setting=setting, origin=origin, time={"value": time}, errors=errors, suspect=())

    points = [point("as given", "as given", 2.0), point("spacing 0.012 m", "spacing", 0.8),
              point("step error 0.01", "step error", 1.2)]  # fmt: skip
    record = {"scene": "slump", "machine": "some machine", "parameters": {}, "points": points}
    (tmp_path / "trade.json").write_text(json.dumps(record), encoding="utf-8")

    def savings(**changes) -> list[str]:
        return [saving.what for saving in _measured_savings(scenes.slump(**changes), tmp_path, False)[0]]

    assert savings() == ["spacing 0.012 m", "step error 0.01"]
    # Cells of 12 mm would make this scene slower, not faster by the ratio of the trade, whose cells have 7.5 mm.
    assert savings(spacing=0.0125) == ["step error 0.01"]
    assert savings(step_error=0.01) == ["spacing 0.012 m"]


def test_a_wrong_trade_is_refused_before_the_measurements(tmp_path, monkeypatch):
    def measured(*rest):
        raise AssertionError("measured in spite of a wrong trade")

    method = SimpleNamespace(forecast=measured)
    monkeypatch.setattr("warpcrete.studies.tradeoffs.explain.method_of", lambda scene: method)
    damaged = ({"points": [{}, {}]}, {"points": 3}, {"points": [1, 2]}, {"points": {"a": 1}})
    for record, kind, words in (
        ({"scene": "pipe"}, SceneError, "is a trade-off study of the scene 'pipe', not of 'channel'"),
        *(({"scene": "channel"} | each, RunFolderError, "trade.json") for each in damaged),
    ):
        (tmp_path / "trade.json").write_text(json.dumps(record), encoding="utf-8")
        with pytest.raises(kind, match=words):
            explain(scenes.channel(spacing=0.02), device="cpu", trade=tmp_path, cache=False)
    with pytest.raises(RunFolderError, match="does not exist; check the path"):
        explain(scenes.channel(spacing=0.02), device="cpu", trade=tmp_path / "none", cache=False)


def test_a_step_that_was_given_is_not_made_longer_by_softer_bonds(device):
    changes = SHORT | dict(hydration=0.1, hydration_modulus=1e8, time_step=1e-6)
    told = explain(scenes.pipe(**changes), device=device, threads=1, cache=False)
    assert not [saving for saving in told.savings if "bonds" in saving.what]
    assert told.forecast.governing == "the given time_step = 1e-06 s"


def test_the_largest_step_allowed_bounds_soft_scenes(device):
    scene = scenes.pipe(**SHORT)
    told = explain(replace(scene, time_step=replace(scene.time_step, largest=1e-5)), device=device, cache=False)
    assert told.forecast.governing.startswith("the largest allowed time step")
    assert told.forecast.time_step == told.forecast.limits["all together"] == 1e-5


def test_a_container_that_is_a_mesh_is_explained(tmp_path):
    base = scenes.pipe(concrete="zhan-table1", **SMALL)
    boxes = [trimesh.creation.box((0.1, 0.1, height)) for height in (0.1, 0.12)]
    made = [
        replace(base, bodies=(), drives=(), group_bonds={}, walls=(), pressure=None, pipe=None, duration=0.01,
                fill=replace(base.fill, container=MeshContainer(box)))
        for box in boxes
    ]  # fmt: skip
    assert fingerprint(made[0]) == fingerprint(made[0]) != fingerprint(made[1])
    told = explain(made[0], device="cpu", threads=1)
    assert told.forecast.counts["bodies"] > 50 and list((tmp_path / "cache").rglob("explain-*.json"))


def test_a_pipe_too_long_for_the_copy_counts_by_its_length(monkeypatch):
    scene = scenes.pipe(**SMALL)
    whole = explain(scene, device="cpu", threads=1, cache=False).forecast
    monkeypatch.setattr("warpcrete.dem.forecast.MAXIMUM_SPHERES", {True: 100, False: 100})
    part = explain(scene, device="cpu", threads=1, cache=False).forecast
    assert part.counts["spheres"] == pytest.approx(whole.counts["spheres"], rel=0.1)
    assert part.total_memory == pytest.approx(whole.total_memory, rel=0.2)


@pytest.mark.thorough
def test_the_command(tmp_path):
    done = command("explain", "channel", "--spacing", "0.02", "--device", "cpu", "--threads", "1")
    assert done.returncode == 0 and len(done.stderr.splitlines()) == 1
    assert done.stderr.startswith("measuring the first steps")
    for words in ("particles", "memory:", "time step: 0.0005 s", "wall time:", "largest possible savings of time"):
        assert words in done.stdout
    for arguments, words in (
        (("nothing",), "scene = 'nothing': must be one of"),
        (("channel", "--spacing", "0.02", "0.01"), "spacing = '0.02, 0.01': must be a single value"),
        (("channel", "--spacing", "-1"), "spacing = -1.0"),
        (("channel", "--fresh", "1"), "--fresh = 1: takes no value"),
        (("channel", "--trade", str(tmp_path)), "is not the folder of a trade-off study"),
    ):
        done = command("explain", *arguments, "--device", "cpu")
        said = done.stderr.strip().splitlines()
        assert done.returncode == 2 and len(said) == 1 and words in said[0]
    assert "beforehand" in command("explain", "--help").stdout


def test_who_waits_for_the_measurements_of_an_explanation_is_told(monkeypatch, tmp_path):
    """Compilation may take minutes; an explanation from the cache takes no time and announces nothing."""
    module, told = importlib.import_module("warpcrete.studies.tradeoffs.explain"), []

    def forecast(*rest):
        assert told == [module.MEASURING] and "compiled" in told[0]
        raise InterruptedError

    monkeypatch.setattr(module, "method_of", lambda scene: SimpleNamespace(forecast=forecast))
    with pytest.raises(InterruptedError):
        explain(scenes.channel(), device="cpu", cache=False, announce=told.append)
    told.clear()
    monkeypatch.setattr(module, "_cached", lambda *rest: tmp_path / "known.json")
    monkeypatch.setattr(module, "_read", lambda path: SimpleNamespace())
    monkeypatch.setattr(module, "_time_step_savings", lambda forecast: ())
    explain(scenes.channel(), device="cpu", announce=told.append)
    assert not told
