"""Knobs and variants of trades, and the errors that their promises contain."""

import importlib
import json
import math
from types import SimpleNamespace

import kept
import pytest

from warpcrete.methods import method_of
from warpcrete.scenes import modules
from warpcrete.studies.tradeoffs.fronts import Error
from warpcrete.studies.tradeoffs.points import GIVEN, REFERENCE, Setting
from warpcrete.studies.tradeoffs.state import Trade

channel, pipe, slump = (importlib.import_module(f"warpcrete.scenes.{name}") for name in ("channel", "pipe", "slump"))
FURTHER = {"channel": {"aggregates": True}, "pipe": {"shapes": "reference", "wall": "mesh", "hydration": 0.1}}


def test_variants_of_a_flow_are_other_scenes_that_can_be_made():
    given = channel.scene.parameters()
    variants = channel.trading.variants(given)
    assert {"twice the flow", "a concrete that shears", "concrete no2", "concrete no3"} <= set(variants)
    made = {name: channel.scene(**changes) for name, changes in variants.items()}
    assert len({(s.concrete, s.radius, s.velocity) for s in made.values()}) == len(made)
    sheared = made["a concrete that shears"]
    theory = sheared.theory()
    assert theory.slip_velocity / sheared.velocity == pytest.approx(0.72, abs=0.02)
    assert channel.trading.variants(channel.scene.parameters(aggregates=True)) == {}


def test_variants_of_a_vessel_are_compared_with_their_own_reference(tmp_path):
    """Without a closed form, the reference of a variant is the variant with the knobs as fine as in the reference."""
    record = {"scene": "slump", "parameters": {}, "quantities": ["slump"], "knobs": ["spacing", "precision"],
              "repeat": 1, "seeded": False, "device": "cpu", "threads": 1, "provenance": {}}  # fmt: skip
    trade = Trade(tmp_path, slump, record)
    assert not trade.exact and not trade.has_seeds
    variants = slump.trading.variants(trade.declared)
    assert variants["half the yield stress"] == {"yield_stress": 95.0}
    coarse, finest = trade.point("spacing", {"spacing": 0}), trade.point(REFERENCE, {"spacing": 4, "precision": 1})
    stiff = variants["twice the viscosity"]
    other, reference = (trade.carried(point, "twice the viscosity", stiff) for point in (coarse, finest))
    assert other.parameters["viscosity"] == reference.parameters["viscosity"] == 794.0
    assert other.parameters["spacing"] == coarse.parameters["spacing"] != reference.parameters["spacing"]
    for point, value in ((coarse, 0.2), (finest, 0.21), (other, 0.11)):
        point.results[0] = {"slump": {"value": value, "unit": "m"}}
    assert trade.errors_of(other, [0]) == []  # The variant's reference has not run, so the error is unknown.
    reference.results[0] = {"slump": {"value": 0.1, "unit": "m"}}
    assert [e.shift for e in trade.errors_of(other, [0])] == [pytest.approx(0.1)]
    assert [e.shift for e in trade.errors_of(coarse, [0])] == [pytest.approx(-0.01 / 0.21)]


def test_the_interval_about_a_closed_form_has_95_per_cent(tmp_path):
    """Three errors of 1, 2 and 3 %: their mean is known to 4.303 s / sqrt(3), with s = 1 %."""
    record = {"scene": "tube", "parameters": {}, "quantities": ["pressure"], "knobs": [],
              "repeat": 3, "seeded": True, "device": "cpu", "threads": 1, "provenance": {}}  # fmt: skip
    trade = Trade(tmp_path, modules()["tube"], record)
    assert trade.exact
    point = trade.point(GIVEN, {})
    for seed, error in enumerate((0.01, 0.02, 0.03)):
        point.results[seed] = {"pressure": {"value": 1.0, "unit": "Pa"},
                               "pressure_error": {"value": error, "unit": "1"}}  # fmt: skip
    (found,) = trade.errors_of(point, trade.seeds)
    assert (found.shift, found.interval) == pytest.approx((0.02, 4.303 * 0.01 / 3**0.5))
    (single,) = trade.errors_of(point, [0])
    assert (single.shift, single.interval) == (0.01, 0.0)


def test_promises_contain_the_own_error_of_the_reference(tmp_path):
    record = {"scene": "slump", "parameters": {}, "quantities": ["slump"], "knobs": ["spacing", "step error"],
              "repeat": 1, "seeded": False, "device": "cpu", "threads": 1, "provenance": {}}  # fmt: skip
    trade = Trade(tmp_path, slump, record)
    trade.point(GIVEN, {})
    coarse, finest = trade.point("spacing", {"spacing": 0}), trade.point(REFERENCE, {"spacing": 3})
    loose = trade.point("step error", {"step error": 0})
    widths = {point.full["spacing"]: point for point in (trade.given, coarse, finest)}
    assert trade.reference_errors == {"slump": math.inf}  # Nothing is known before two widths have run.
    for width, point in widths.items():
        point.results[0] = {"slump": {"value": 0.2 * (1 + 10 * width), "unit": "m"}}
    loose.results[0] = {"slump": {"value": 1.01 * 0.2 * (1 + 10 * trade.given.full["spacing"]), "unit": "m"}}
    trade.judge()
    own = 10 * finest.full["spacing"]
    assert trade.reference_errors["slump"] == pytest.approx(own)
    # This error is added to the error against the reference, or to the change by the knob alone.
    shift = (1 + 10 * coarse.full["spacing"]) / (1 + own) - 1
    assert trade.promised(coarse) == pytest.approx(shift + own)
    against = 1.01 * (1 + 10 * trade.given.full["spacing"]) / (1 + own) - 1
    assert trade.promised(loose) == pytest.approx(against + own)
    assert trade.bound_in_variants(finest, []) == pytest.approx(own)


def test_a_setting_that_no_variant_tested_is_not_promised(tmp_path, monkeypatch):
    from warpcrete.studies.tradeoffs import trade as phases

    point = Setting("x", {}, {})
    trading = SimpleNamespace(variants=lambda given: {"twice the viscosity": {"viscosity": 2.0}})
    trade = SimpleNamespace(
        exact=True, has_seeds=False, seeds=[0], chosen_knobs=(), measured=[point], promises=[], reference=None,
        declared=None, module=SimpleNamespace(trading=trading), promised=lambda point: 0.0,
        errors_of=lambda point, seeds: [],
    )  # fmt: skip
    for carried, promised in (({}, None), ({"twice the viscosity": Error("slump", 0.0, 0.0)}, point)):
        trade.promises.clear()
        monkeypatch.setattr(phases, "_test_variants", lambda *_, carried=carried: (carried, 0.0))
        phases._find_promises(trade, lambda *_: None)  # type: ignore
        assert all(promise.point is promised for promise in trade.promises) and trade.promises


def test_pressures_of_a_shorter_unit_count_by_its_length(tmp_path):
    record = {"scene": "pipe", "parameters": {}, "quantities": ["plateau_pressure"], "knobs": ["length"], "repeat": 1,
              "seeded": True, "device": "cpu", "threads": 1, "provenance": {}}  # fmt: skip
    trade = Trade(tmp_path, pipe, record)
    assert not trade.chosen_knobs
    half = trade.point("length", {"length": 1})
    half.results[0] = {"plateau_pressure": {"value": 11e3, "unit": "Pa"}}
    assert half.parameters["length"] == 0.5
    assert half.values("plateau_pressure", [0]) == [1e3 + 2 * 10e3]  # the plug's 1 kPa stays what it is
    assert not any(k.name == "length" for k in pipe.trading.knobs(pipe.scene.parameters(unit="D")))


def test_a_promise_is_tried_with_seeds_that_no_other_run_had(monkeypatch):
    """A promise is tested with 3 seeds. The seeds 7, 8, and 9, by which the setting was chosen, are not among them."""
    from warpcrete.studies.tradeoffs import trade as phases

    monkeypatch.setattr(phases, "_test_variants", lambda *_: ({}, 0.0))
    ran: list[int] = []
    point = Setting("x", {}, {})
    trade = SimpleNamespace(
        exact=False, has_seeds=True, seeds=[7, 8, 9], chosen_knobs=(), measured=[point], promises=[],
        reference=point,
        promised=lambda point: 0.0, run=lambda point, seeds, tell: ran.extend(seeds) or True,
        errors_of=lambda point, seeds: [Error("pressure", 0.01, 0.0)] if list(seeds) == ran[:3] else [],
    )  # fmt: skip
    phases._find_promises(trade, lambda *_: None)  # type: ignore
    assert len(trade.promises) == len(phases.WANTED_ERRORS) > 0
    assert all(p.point is point and p.found == Error("pressure", 0.01, 0.0) for p in trade.promises)
    assert phases.FRESH_SEEDS == 3 and len(set(ran[:3])) == 3 and not set(ran) & set(trade.seeds)


@pytest.mark.parametrize("name", sorted(modules()))
def test_every_level_of_every_knob_makes_another_scene(name):
    module = modules()[name]
    for base in ({}, FURTHER.get(name, {})):
        given = module.scene.parameters(**base)
        for knob in module.trading.knobs(given):
            assert len(knob.levels) > 1 and len({level.label for level in knob.levels}) == len(knob.levels)
            made = [module.scene(**module.scene.effective_values(base | dict(level.changes))) for level in knob.levels]
            texts = [json.dumps(scene.parameters, sort_keys=True, default=str) for scene in made]
            assert len(set(texts)) == len(texts), knob.name
            own = json.dumps(module.scene(**base).parameters, sort_keys=True, default=str)
            assert own in texts, f"{knob.name}: no level is the scene as given"
        known = {each.name for each in method_of(module.scene(**base)).quantities}
        assert set(module.trading.quantities) <= known


def test_kept_knobs_and_variants():
    """Variations of a trade in each scene: settings, their levels and costs; and the scenes that try its promises."""
    found = {}
    for name, module in modules().items():
        others = FURTHER | {"jring-dem": {"bars": 24}}  # narrow gaps limit the size of stones
        for place, base in enumerate(({}, others.get(name, {"seed": 3}))):
            given = module.scene.parameters(**base)
            found[f"{name}{place}"] = {
                "knobs": [
                    [
                        f"{knob.name}, physical {knob.physical}, chosen {knob.chosen}, resolution {knob.resolution}",
                        *(f"{level.label}: {dict(level.changes)} at {level.cost:.6g}" for level in knob.levels),
                    ]
                    for knob in module.trading.knobs(given)
                ],
                "variants": module.trading.variants(given),
                "marks": [module.trading.quantities, module.trading.tolerance, module.trading.closed_form(given)],
            }
    kept.compare("knobs", found)
