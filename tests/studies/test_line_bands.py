"""Bands of a line's pressure and restart, split by cause, and the measurements that would make them narrower."""

import itertools
import math
from dataclasses import replace

import pytest
import yaml
from click.testing import CliRunner
from plug_lines import FLOW, METRE, PLUG, line, pumped

from warpcrete.cli.main import cli
from warpcrete.geometry.lines import line_of
from warpcrete.mix.mix import mix_of
from warpcrete.studies.lines.answers import band_sentences
from warpcrete.studies.lines.fittings import MODEL_ERRORS, VALVE_PRESSURE
from warpcrete.studies.lines.pressures import Stop
from warpcrete.studies.lines.theory_line import line_by_theory
from warpcrete.theory.bands import Band
from warpcrete.theory.pipe import Concrete


def test_every_fitting_has_a_band_with_its_cause():
    """One kind of part alone: the band reaches from once to so many times straight pipe, and its share is 1."""
    length = 0.25 * math.pi
    for entry, cause, low, high in (
        ({"bend": "left"}, "bends", length, 3 * length), ({"hose": 8}, "hoses", 8, 16),
        ({"reducer": {"to": "124.9 mm", "length": 4}}, "reducers", 4, 8),
        ({"valve": 0.5}, "valves", 0.5, VALVE_PRESSURE / METRE),
    ):  # fmt: skip
        band = pumped({"straight": 50}, entry).band()
        assert band.low == pytest.approx((50 + low) * METRE, rel=1e-3), cause
        assert band.high == pytest.approx((50 + high) * METRE, rel=1e-3), cause
        assert band.low <= band.value <= band.high and band.shares == {cause: 1.0}
    assert {error.cause for error in MODEL_ERRORS.values()} == {"bends", "reducers", "hoses", "bores", "valves"}
    assert pumped({"straight": 50}).band().shares == {}
    assert pumped({"straight": 50}, {"bend": {"to": "left", "factor": 2}}).band().shares == {}


def test_a_band_that_begins_at_zero_allows_any_factor():
    assert Band(20.0, 10.0, 40.0).factor == 2.0
    assert Band(1.0, 0.0, 2.0).factor == Band(1.0, -1.0, 2.0).factor == math.inf


def test_the_band_is_split_by_cause():
    """Two causes: deviations add in squares as logarithms, also below, where a bend is as good as straight pipe."""
    found = pumped({"straight": 20}, {"bend": "left"}, {"straight": 20}, factor=2.0)
    value, bend = found.pressure, 0.25 * math.pi * METRE
    up, both = math.log((40 * METRE + 3 * bend) / value), math.log(2)
    band = found.band()
    assert band.high == pytest.approx(value * math.exp(math.hypot(up, both)), rel=1e-6)
    down = math.log(value / (40 * METRE + bend))
    assert band.low == pytest.approx(value * math.exp(-math.hypot(down, both)), rel=1e-6)
    assert band.shares["slip layer"] == pytest.approx((2 * both) ** 2 / ((2 * both) ** 2 + (up + down) ** 2), rel=1e-6)
    first, *rest = band_sentences(band)
    assert first.startswith(f"{100 * band.shares['slip layer']:.0f} % of the band of ")
    assert rest == []
    assert band_sentences(Band(1e6, 1e6, 1e6)) == []
    mixed = band_sentences(Band(1e6, 5e5, 2e6, {"bends": 0.3, "slip layer": 0.62, "density": 0.08}))
    assert [each[:4] for each in mixed] == ["62 %", "30 %"] and "5 to 20 bar comes from the slip layer" in mixed[0]


def test_a_wider_layer_never_narrows_the_band_of_a_falling_line():
    """Friction and weight of the falling pipe nearly cancel: 7.29 bar less 7.03 bar.

    From a factor of 1.037 on, the weaker layer leaves no pressure. The band neither jumps there nor ends below zero,
    and it never exceeds the sum of the deviations that its two causes make alone.
    """
    concrete = Concrete(density=2350, viscosity=60, yield_stress=2000, slip_viscosity=1100, slip_yield=0)
    pipe = line_of({"diameter": 0.125, "begin": "down", "parts": [{"straight": 30}, {"valve": 0.5}]})
    results = [line_by_theory(pipe, concrete, 30 / 3600, layer_factor=1 + k / 200) for k in range(1, 200)]
    bands = [result.band() for result in results]
    value, valve = results[0].pressure, VALVE_PRESSURE - results[0].losses[1].friction
    pipes = results[0].losses[0].friction + results[0].losses[1].friction
    weight = 30.5 * 2350 * 9.81
    assert value == pytest.approx(pipes - weight) and 0.2e5 < value < 0.3e5
    for k, (band, wider) in enumerate(itertools.pairwise(bands), 1):
        assert 0 <= wider.low <= band.low <= value <= band.high < wider.high < 1.01 * band.high
        assert band.shares["slip layer"] < wider.shares["slip layer"] < band.shares["slip layer"] + 0.05
        assert band.high < value + valve + k / 200 * pipes
    assert bands[6].low > 0 and bands[9].low == 0


@pytest.mark.parametrize(
    ("layer", "slump", "advised"),
    [
        (None, None, "fit it"),
        ("{viscosity: 500, yield_stress: 10, from: tribometer}", None, "fit it"),
        ("{viscosity: 500, yield_stress: 10, from: pipe}", None, ""),
        (None, "180 mm", "fit it"),
    ],
)
def test_only_a_measurement_that_makes_the_band_narrower_is_recommended(tmp_path, layer, slump, advised):
    """The band that a measurement would give is that of a concrete whose layer has this measurement's band."""
    mix = {"density": 2350, "spread": "600 mm"} if slump is None else {"density": 2350, "slump": slump}
    if slump is None:
        mix["water_binder"] = 0.45
    if layer is not None:
        mix["layer"] = yaml.safe_load(layer)
    found = line_by_theory(line({"straight": 100}), (of := mix_of(mix)).concrete, FLOW, variants=of.variants)
    first = found.band_sentences()[0]
    assert "comes from the slip layer" in first and "tribometer" not in first
    assert ("fit it to pressures of a trial line" in first) == (advised == "fit it")
    for text in (x for x in first.split("which would give ")[1:]):
        low, high = (1e5 * float(x) for x in text.split(" bar")[0].split(" to "))
        assert high - low < found.band().high - found.band().low
        eta, tau = of.concrete.slip_viscosity, of.concrete.slip_yield
        fitted = {**mix, "layer": {"viscosity": eta, "yield_stress": tau, "from": "pipe"}}
        then = line_by_theory(line({"straight": 100}), mix_of(fitted).concrete, FLOW, variants=mix_of(fitted).variants)
        assert (low, high) == pytest.approx((then.band().low, then.band().high), rel=0.01)


def test_a_tribometer_is_recommended_where_its_band_is_narrower_than_a_guess():
    of = mix_of({"density": 2350, "spread": "600 mm"})
    first = line_by_theory(line({"straight": 100}), of.concrete, FLOW, variants=of.variants).band_sentences()[0]
    assert "with --fit, which would give" in first and "measure it with a tribometer, which would give" in first


def test_a_stated_slump_is_not_recommended():
    """The yield stress of the bulk makes most of the band of a stiff concrete whose slip layer was measured."""
    layer = {"viscosity": 605, "yield_stress": 0, "uncertainty": 0.02, "from": "tribometer"}
    of = mix_of({"density": 2368, "slump": "200 mm", "layer": layer})
    text = "; ".join(line_by_theory(line({"straight": 100}), of.concrete, FLOW, variants=of.variants).band_sentences())
    assert "from the yield stress of the bulk; measure it with a rheometer" in text and "slump" not in text


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ({"spread": "600 mm", "water_binder": 0.45}, " bar in about nine of ten cases"),
        ({"slump": "200 mm"}, " bar, a range without a known probability"),
    ],
)
def test_the_output_says_how_often_its_band_holds(tmp_path, entries, words):
    (tmp_path / "mix.yaml").write_text(yaml.safe_dump({"mix": {"density": 2350, **entries}}), encoding="utf-8")
    call = ["line", "--concrete", str(tmp_path / "mix.yaml"), "--diameter", "125 mm", "--length", "90 m", "--flow"]
    says = next(x for x in CliRunner().invoke(cli, [*call, "30 m3/h"]).output.splitlines() if "at the pump" in x)
    chosen = CliRunner().invoke(cli, [*call, "30 m3/h", "--layer-factor", "1.5"]).output
    assert says.endswith(words) and "cases" not in chosen and "probability" not in chosen


def test_a_line_tells_the_pressure_by_the_other_estimate_of_the_slip_layer(tmp_path):
    """With the parts of the mix and a slump, the other estimate is that of the slump alone."""
    mix = {"density": 2350, "slump": "200 mm"}
    (tmp_path / "mix.yaml").write_text(yaml.safe_dump({"mix": {**mix, "water_binder": 0.45}}), encoding="utf-8")
    pipe = ["--diameter", "125 mm", "--length", "190 m", "--flow", "30 m3/h"]
    both, alone = (CliRunner().invoke(cli, ["line", *more, *pipe]).output
                   for more in (["--concrete", str(tmp_path / "mix.yaml")], ["--slump", "200 mm"]))  # fmt: skip
    other = float(both.split("from slump of 200 mm, would give ")[1].split(" bar")[0])
    assert other == pytest.approx(float(alone.split("at the pump ")[1].split(" bar")[0]), rel=0.005)
    assert "another estimate" not in alone


def test_a_restart_has_a_band():
    """A plug of 100 m after 600 s: the wall bears 4 (50 + growth * 600) / d more, and the layer adds to it."""
    stop = Stop(600.0, 0.5, (0.1, 1.0))
    found = pumped({"straight": 100}, stop=stop)
    at_rest, flowing = found.restart(), found.restart(FLOW)
    assert at_rest.value == pytest.approx(4 * 350 * 100 / 0.125)
    assert (at_rest.low, at_rest.high) == pytest.approx((4 * 110 * 100 / 0.125, 4 * 650 * 100 / 0.125))
    assert at_rest.shares == {"thixotropy": 1.0}
    assert flowing.value == pytest.approx(at_rest.value + found.pressure - 4 * 50 * 100 / 0.125)
    both = pumped({"straight": 100}, {"bend": "left"}, stop=Stop(600.0, 0.5), factor=2.0).restart(FLOW)
    assert set(both.shares) == {"slip layer", "bends"} and both.low < both.value < both.high
    record = found.record()["restart"]
    assert record["begins"]["pressure_high"]["value"] == pytest.approx(at_rest.high)
    assert pumped({"straight": 100}).record()["restart"] is None


def test_a_lighter_concrete_needs_less_pressure_to_rise():
    """The density is uncertain by 10 %, which changes only the weight of 40 m of rise, and not the friction of a plug
    that flows, or whose layer bears 350 Pa after a rest."""
    concretes = replace(PLUG, density=2160.0), replace(PLUG, density=2640.0)
    stop, upright = Stop(600.0, 0.5), line({"straight": 40}, begin="up")
    found = line_by_theory(upright, PLUG, FLOW, variants={"density": concretes}, stop=stop)
    for band, friction in ((found.band(), 40 * METRE), (found.restart(), 4 * 350 * 40 / 0.125)):
        expected = [friction + density * 9.81 * 40 for density in (2160, 2400, 2640)]
        assert (band.low, band.value, band.high) == pytest.approx(expected)
        assert band.shares == {"density": 1.0}
