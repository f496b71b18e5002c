"""Fittings of a line with their uncertainty, rules of practice, and answers about pump and restart."""

import json
import math
import subprocess
import sys

import pytest
import yaml
from click.testing import CliRunner

from warpcrete import SceneError, WarpcreteError
from warpcrete.cli.main import cli
from warpcrete.geometry.pumps import Pump, pump_of
from warpcrete.mix.mix import mix_of
from warpcrete.studies.lines.answers import EFFICIENCY, band_sentences, pressure_text
from warpcrete.studies.lines.fittings import METHODS_ON_BENDS, MODEL_ERRORS, VALVE_PRESSURE, library_factor
from warpcrete.studies.lines.losses import line_of
from warpcrete.studies.lines.pressures import Stop
from warpcrete.studies.lines.result import lines_of
from warpcrete.studies.lines.run import run_line
from warpcrete.studies.lines.theory_line import line_by_theory
from warpcrete.theory.bands import Band
from warpcrete.theory.pipe import Concrete

PLUG = Concrete(density=2400.0, viscosity=1e6, yield_stress=1e9, slip_viscosity=1000.0, slip_yield=50.0)
"""A plug that slides along the wall: friction per metre is 4 (50 + 1000 v) / d."""
FLOW = 0.005
SOFT = Concrete(density=2400.0, viscosity=30.0, yield_stress=60.0, slip_viscosity=1000.0, slip_yield=20.0)
BEND = 0.25 * math.pi * (1 + 0.023 + 0.1 / 0.15 * 0.019)
"""Metres of straight pipe for a bend of radius 0.5 m, by the table of simulated bends."""
METRE = 4 * (50 + 1000 * FLOW / (math.pi * 0.125**2 / 4)) / 0.125
"""Friction per metre of a pipe of 125 mm [Pa/m]."""


def line(*parts, **more):
    return line_of({"diameter": "125 mm", "parts": list(parts), **more})


def pumped(*parts, factor=1.0, stop=None, **more):
    return run_line(line(*parts, **more), PLUG, FLOW, simulate=False, layer_factor=factor, stop=stop)


@pytest.mark.parametrize(
    ("entry", "kind", "length", "friction"),
    [
        ({"hose": "8 m"}, "hose", 8.0, 2 * 8 * METRE), ({"hose": {"length": 8, "layer": 1}}, "hose", 8.0, 16 * METRE),
        ({"hose": {"length": 8, "factor": 3}}, "hose", 8.0, 24 * METRE),
        ({"valve": "0.4 m"}, "valve", 0.4, 0.4 * METRE),
        ({"valve": {"equivalent": "20 m"}}, "valve", 0.5, 20 * METRE), ({"valve": {}}, "valve", 0.5, 0.5 * METRE),
        ({"bend": "right"}, "bend", 0.25 * math.pi, BEND * METRE),
        ({"bend": {"to": "up", "equivalent": 6}}, "bend", 0.25 * math.pi, 6 * METRE),
        ({"bend": {"to": "up", "factor": "150 %"}}, "bend", 0.25 * math.pi, 0.375 * math.pi * METRE),
        ({"straight": {"length": 10, "factor": 1.2}}, "straight", 10.0, 12 * METRE),
        ({"hose": [[1, 0, 0], [2, 0, 0]]}, "hose", 2.0, 2 * METRE),
    ],
)  # fmt: skip
def test_parts_have_the_friction_that_is_stated_or_modelled(entry, kind, length, friction):
    found = pumped({"straight": 2}, entry)
    part, loss = found.line.parts[1], found.losses[1]
    assert part.kind == kind and part.length == pytest.approx(length)
    assert loss.friction == pytest.approx(friction)
    assert loss.friction == pytest.approx(loss.straight * part.relative * library_factor(part))


def test_a_reducer_with_an_equivalent_length_has_the_friction_of_straight_pipe_of_its_bores():
    plain, stated = (pumped({"reducer": {"to": "100 mm", "length": 1, **more}}) for more in ({}, {"equivalent": 3}))
    assert stated.pressure == pytest.approx(3 * plain.losses[0].straight)
    assert plain.pressure == pytest.approx(plain.losses[0].straight * (1 + 0.047 * 12.5 / 20.8))


def test_the_default_bend_is_at_least_two_diameters_wide():
    assert line_of({"diameter": 0.4, "parts": [{"bend": "left"}]}).parts[0].radius == 0.8
    assert line({"bend": "left"}).parts[0].radius == 0.5


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        (
            {"bend": {"to": "up", "factor": 2, "equivalent": "6 m"}},
            r"bend: factor = 2: cannot be given together with 'eq",
        ),
        ({"bend": {"to": "up", "factor": 0}}, r"bend: factor = 0\.0: must be in \[0\.1, 100\]"),
        ({"bend": {"to": "up", "factor": "2 m"}}, r"bend: factor = '2 m': must be a number"),
        ({"valve": {"equivalent": -3}}, r"valve: equivalent = -3\.0: must be a finite number above 0 m"),
        ({"valve": {"radius": 1}}, r"valve: key = 'radius': must be one of length, factor, equivalent"),
        ({"hose": {"length": 3, "points": [[1, 0, 0]]}}, r"hose: length = 3: cannot be given together with 'points'"),
        (
            {"hose": {"layer": 0.5}},
            r"hose: points = None: must be a list of points; .*or a length, as in 'hose: 8",
        ),
        ({"hose": "8 kg"}, r"hose: length = '8 kg': must be a number with one of m, mm"),
        ({"hose": 0}, r"hose: length = 0\.0: must be a finite number above 0 m"),
        (
            {"straight": {"length": 12, "5 m": None}},
            r"straight: key = '5 m': must be one of .*put an amount with a decim",
        ),
        ({"bend": 45}, r"bend: to = 45: must be one of up, down, left"),
        ({"bend": 90}, r"bend: to = 90: must be .*; write the direction.* as in 'bend: \{to: up, angle: 90\}'"),
        ({"bend": {"angle": 30}}, r"bend: to = None: must be .*; write .* as in 'bend: \{to: up, angle: 30\}'"),
        ({"bend": "rigth"}, r"bend: to = 'rigth': must be one of .*did you mean 'right'\?"),
    ],
)
def test_fittings_that_cannot_be_are_refused_in_one_line(entry, says):
    with pytest.raises(SceneError, match=rf"^part 2, {says}") as caught:
        line({"straight": 2}, entry)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("kind", "says"),
    [("horizontal", "write 'straight: 10 m'"), ("vertical", "write 'bend: up' and then 'straight: 10 m'"),
     ("elbow", "write 'bend: up', or"), ("taper", "write 'reducer: "), ("tip", "write 'hose: 5 m'")],
)  # fmt: skip
def test_other_words_for_parts_are_refused_with_the_right_one(kind, says):
    with pytest.raises(SceneError, match=rf"^part 1 = '{kind}': must be one of straight, .*; {says}"):
        line({kind: "5 m"})


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


@pytest.mark.parametrize(("length", "jgj"), [(3.0, 2.0), (5.0, 2.0), (5.01, 2.004), (10.0, 4.0)])
def test_a_hose_longer_than_that_of_the_rule_counts_in_proportion(length, jgj):
    rows = pumped({"straight": 2}, {"hose": length}).practice()[1]
    assert next(row for row in rows if row.rule == "JGJ/T 10").pressures["hose"] == pytest.approx(jgj * 1e5)


def test_power_volume_and_time_follow_from_pressure_and_bore():
    found = pumped({"straight": 30}, {"reducer": {"to": "100 mm", "length": 1}}, {"straight": 10})
    cone = math.pi / 12 * (0.125**2 + 0.125 * 0.1 + 0.1**2)
    assert found.volume == pytest.approx(math.pi / 4 * (0.125**2 * 30 + 0.1**2 * 10) + cone, rel=1e-9)
    assert found.residence_time == pytest.approx(found.volume / FLOW)
    bar, cubic_metres = found.pressure / 1e5, 3600 * FLOW
    assert found.motor_power == pytest.approx(1e3 * bar * cubic_metres / 25) == pytest.approx(found.power / EFFICIENCY)
    assert pytest.approx(0.694, abs=1e-3) == EFFICIENCY


def test_a_pump_is_compared_with_its_data_sheet():
    needed = 100 * METRE
    for pump, verdict in (
        ({"pressure": 2.5 * needed}, "strong enough"), ({"pressure": 1.5 * needed}, "perhaps too weak"),
        ({"pressure": 0.9 * needed}, "too weak"), ({"pressure": 9 * needed, "flow": 0.9 * FLOW}, "too weak"),
        ({"pressure": 9 * needed, "power": 1.5 * needed * FLOW / EFFICIENCY}, "perhaps too weak"),
        ({"pressure": 9 * needed, "power": 0.9 * needed * FLOW / EFFICIENCY}, "too weak"),
        ({"pressure": 9 * needed, "power": 9 * needed * FLOW, "flow": 2 * FLOW}, "strong enough"),
    ):  # fmt: skip
        found = pumped({"straight": 100}, factor=2.0, pump=pump)
        assert found.margin is not None and found.margin.verdict == verdict, pump
        assert found.margin.factor == pytest.approx(pump["pressure"] / needed)
        assert f"the pump is {verdict}: " in "\n".join(lines_of(found))
        assert found.record()["pump"]["verdict"] == verdict
    assert pumped({"straight": 100}).margin is None
    assert pump_of("85 bar") == Pump(8.5e6) == pump_of({"pressure": "8.5 MPa"})


@pytest.mark.parametrize(
    ("pump", "says"),
    [
        (
            {"flow": "90 m3/h"},
            r"^pump = \{'flow': '90 m3/h'\}: has no 'pressure'; add the largest pressure from the data sheet",
        ),
        (
            {"presure": "85 bar"},
            r"^pump's key = 'presure': must be one of pressure, flow, power; did you",
        ),
        ("85 kW", r"^pump pressure = '85 kW': must be a number with one of Pa, bar"),
        (0, r"^pump pressure = 0\.0: must be a finite number above 0 Pa"),
        (
            {"pressure": "85 bar", "power": "110 bar"},
            r"^pump power = '110 bar': must be a number with one of W, kW, hp",
        ),
        ([85], r"^pump pressure = \[85\]: must be a number"),
    ],
)
def test_pumps_that_cannot_be_are_refused(pump, says):
    with pytest.raises(SceneError, match=says):
        line({"straight": 1}, pump=pump)


def test_a_pressure_that_no_pump_delivers_is_remarked():
    assert not any("no concrete pump" in x for x in pumped({"straight": 100}).remarks())
    far = pumped({"straight": 50e5 / METRE * 11})
    assert far.pressure > 500e5 and any("deliver more than 500 bar" in x for x in far.remarks())
    assert pressure_text(6894757.0) == "68.95 bar (6.89 MPa, 1000 psi)"


US_LINE = {"diameter": "5 in", "pump": {"pressure": "1233 psi", "flow": "70 yd3/h", "power": "200 hp"},
           "parts": [{"straight": "330 ft"}, {"bend": "up"}, {"straight": "65 ft 6 in"}]}  # fmt: skip


def test_a_line_in_us_units_is_answered_in_both_units():
    """Metric amounts stay as they are, and US ones follow: 330 ft are 100.584 m, and 60 yd3/h are 45.87 m3/h."""
    stop = Stop(1200.0, 0.5, None)
    ours = run_line(line_of(US_LINE), PLUG, 60 * 0.9144**3 / 3600, simulate=False, layer_factor=2.0, stop=stop)
    text = "\n".join(lines_of(ours))
    band, psi = ours.band(), 6894.757293
    for each in (
        f"{ours.line.length:.4g} m ({ours.line.length / 0.3048:.4g} ft)",
        "at 45.87 m3/h (60 yd3/h)",
        f"{band.low / 1e5:.4g} to {band.high / 1e5:.4g} bar ({band.low / psi:.4g} to {band.high / psi:.4g} psi)",
        "delivers 85.01 bar (1233 psi)", "the motor has 149 kW (200 hp)", "its flow of up to 53.52 m3/h (70 yd3/h)",
        "| 1 | straight | 127 (5) | 100.6 (330) | 0 (0) |", "friction [kPa (psi)]",
        f"bar, or {ours.restart().value / psi:.4g} (",
    ):  # fmt: skip
        assert each in text, each
    metric = line_of({**US_LINE, "diameter": "127 mm", "pump": "85 bar", "parts": [{"straight": "100 m"}]})
    plain = "\n".join(lines_of(run_line(metric, PLUG, 0.01, simulate=False, layer_factor=2.0)))
    assert ours.line.customary and not metric.customary and "yd3" not in plain and plain.count("psi") == 1


SHARP = """\
diameter: 125 mm
flow: 20 m3/h
concrete: no1
parts:
  - straight: 10 m
  - bend: {to: left, radius: 0.5 m}
  - reducer: {to: 100 mm, length: 0.1 m}
"""


def test_parts_that_no_table_covers_are_simulated(tmp_path, monkeypatch):
    """The command simulates them without being asked, but not with --theory, and not if the table covers all parts."""
    path, calls = tmp_path / "sharp.yaml", []
    path.write_text(SHARP, encoding="utf-8")
    monkeypatch.setattr("warpcrete.cli.line_simulated.run", lambda *given: calls.append(given[-1]))
    done = CliRunner().invoke(cli, ["line", str(path), "--out", str(tmp_path / "out")])
    assert done.exit_code == 0 and calls == [True], done.output
    assert "note: part 3, 125 to 100 mm, is sharper than all parts in the table" in done.output
    CliRunner().invoke(cli, ["line", str(path), "--simulate", "--out", str(tmp_path / "all")])
    assert calls == [True, False]
    CliRunner().invoke(cli, ["line", str(path), "--device", "cpu", "--out", str(tmp_path / "cpu")])
    assert calls == [True, False, True]
    answer = CliRunner().invoke(cli, ["line", str(path), "--theory"])
    assert "sharper than all parts of the library" in answer.output
    path.write_text(SHARP.replace("0.1 m", "1 m"), encoding="utf-8")
    assert "pressure at the pump" in CliRunner().invoke(cli, ["line", str(path)]).output and len(calls) == 3


@pytest.mark.thorough
def test_other_parts_keep_the_answer_of_the_table(device):
    """Only the sharp reducer is simulated; the pipe and the bend have the friction of the answer by theory."""
    made = line({"straight": 10}, {"bend": "left"}, {"reducer": {"to": 0.1, "length": 0.1}})
    plain = run_line(made, SOFT, FLOW)
    found = run_line(made, SOFT, FLOW, simulate=True, unless_known=True, cells=8, device=device)
    assert [x.friction for x in found.losses[:2]] == [x.friction for x in plain.losses[:2]] and len(found.took) == 1
    assert found.losses[2].friction == pytest.approx(plain.losses[2].friction, rel=0.3)
    assert found.losses[2].friction > found.losses[2].theory


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


def test_rules_of_practice_count_parts_as_they_say():
    """10 m level, a bend, 20 m up, a reducer and a hose, by hand."""
    found = pumped({"straight": 10}, {"bend": {"to": "up", "radius": 0.5}}, {"straight": 20}, {"bend": "level"},
                   {"hose": 8}, {"valve": 0.5})  # fmt: skip
    ours, rows = found.practice()
    aij, jsce, jgj = rows
    bend, weight = 0.25 * math.pi, 2400 * 9.81
    assert ours.pressure == pytest.approx(found.pressure)
    assert aij.pressure == pytest.approx(METRE * (30.5 + 3 * 2 * bend + 2 * 8) + weight * 21, rel=1e-9)
    assert jsce.pressure == pytest.approx(METRE * (10 + 4 * 20 + 2 * 6 + 20 + 0.5), rel=1e-9)
    assert jgj.pressure == pytest.approx(5e3 * 10 + 20e3 * 20 + 2 * 0.1e6 + 8 / 5 * 0.2e6 + 0.8e6, rel=1e-9)
    assert [row.rule for row in rows] == ["AIJ", "JSCE", "JGJ/T 10"] and all("http" in row.source for row in rows)
    text = "\n".join(lines_of(found, practice=True))
    assert "| JGJ/T 10 | 17.7 |" in text and METHODS_ON_BENDS in text and "a metre of rise counts as 4 m" in text
    down = pumped({"straight": 10}, {"bend": "down"}, {"straight": 20}).practice()[1]
    assert down[1].pressures["straight"] == pytest.approx(30 * METRE) and down[2].pressures["straight"] == 150e3


def test_fittings_outside_the_library_are_told():
    """A bend of 0.6 diameters and a blunt reducer; a pipe that widens costs nothing beyond its length."""
    found = pumped({"straight": 1}, {"bend": {"to": "left", "radius": 0.1}}, {"straight": 1},
                   {"reducer": {"to": "100 mm", "length": 0.1}}, {"straight": 1},
                   {"reducer": {"to": "125 mm", "length": 0.1}})  # fmt: skip
    assert [r.split(",")[0] for r in found.remarks()] == ["part 2", "part 4"] and "--simulate" in found.remarks()[0]
    assert [library_factor(x.part) for x in found.losses] == [1, 1.125, 1, 1.452, 1, 1]


def test_the_answer_by_theory_imports_no_simulation_and_takes_a_tenth_of_a_second():
    """Warp is not imported; the limit is generous, because the machine may be busy."""
    code = """
import sys, time
from click.testing import CliRunner
from warpcrete.cli.main import cli
import warpcrete.cli.line
begin = time.process_time()
done = CliRunner().invoke(cli, ["line", "burj-khalifa", "--concrete", "example-scc", "--practice", "--rest", "600"])
print(done.exit_code, "warp" in sys.modules, "matplotlib" in sys.modules, time.process_time() - begin)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, encoding="utf-8", check=True)
    status, warp, plots, seconds = done.stdout.split()
    assert (status, warp, plots) == ("0", "False", "False") and float(seconds) < 0.5, done.stdout


def test_the_command_shows_pump_stop_and_practice(tmp_path):
    path = tmp_path / "site.yaml"
    path.write_text('diameter: 5"\nflow: 40 yd3/hr\nconcrete: no1\npump: 85 bar\nparts:\n  - straight: 30 ft\n'
                    "  - bend: up\n  - straight: 60 ft\n  - hose: 12 ft\n", encoding="utf-8")  # fmt: skip
    given = ["line", str(path), "--theory", "--pump-power", "110 kW", "--rest", "20 min", "--practice", "--out"]
    done = CliRunner().invoke(cli, [*given, str(tmp_path / "line")])
    assert done.exit_code == 0, done.output
    for words in ("pressure at the pump ", "of the band of", "comes from the slip layer; fit it",
                  "the motor has 110 kW", "(efficiency 0.69: bar times m3/h over 25)", "after 20 min of rest",
                  "the line holds 0.404 m3", "| JSCE |"):  # fmt: skip
        assert words in done.output
    record = json.loads((tmp_path / "line" / "line.json").read_text(encoding="utf-8"))
    assert record["pump"]["motor_power_limit"]["value"] == 110e3 and record["pump"]["pressure_limit"]["value"] == 8.5e6
    along = record["along"]
    assert along["pressure"]["values"][0] == record["pressure"]["value"] and along["pressure"]["values"][-1] == 0
    assert len(along["place"]["values"]) == 5 == len(along["pressure_high"]["values"])
    assert set(record["band_shares"]) == {"slip layer", "bends", "hoses"}
    wrong = CliRunner().invoke(cli, ["line", str(path), "--theory", "--pump-pressure", "85 kg"])
    assert "pump pressure = '85 kg': must be a number with one of Pa, bar" in str(wrong.exception)
    for more, says in ((["--cells", "9"], "cells: has no effect without a simulation; add --simulate"),
                       (["--theory", "--simulate"], "--theory: cannot be combined with --simulate")):  # fmt: skip
        refused = CliRunner().invoke(cli, ["line", str(path), *more])
        assert refused.exit_code == 2 and says in refused.output
    none = CliRunner().invoke(cli, ["line", str(path), "--method", "dem", "--practice"])
    assert none.exit_code == 2 and "practice: has no effect with '--method dem'" in none.output


def test_a_line_is_a_dataset_of_its_parts_and_places(monkeypatch):
    pytest.importorskip("xarray", reason="needs xarray, which the extra [test] installs")
    made = pumped({"straight": 10}, {"bend": "up"}, {"straight": 5}, factor=1.5, name="yard")
    found = made.to_xarray()
    assert found.sizes == {"number": 3, "place": 4} and found["number"].to_numpy().tolist() == [1, 2, 3]
    assert found["friction"].to_numpy() == pytest.approx([loss.friction for loss in made.losses])
    assert found["friction"].attrs == {"units": "Pa", "long_name": "friction"}
    low, high = found["over_straight_low"].to_numpy(), found["over_straight_high"].to_numpy()
    assert (low[1], high[1]) == made.losses[1].range and all(map(math.isnan, (low[0], high[0], low[2], high[2])))
    places, bands = made.bands()
    for name, end in (("pressure", "value"), ("pressure_low", "low"), ("pressure_high", "high")):
        assert found[name].dims == ("place",) and found[name].attrs["units"] == "Pa"
        assert found[name].to_numpy() == pytest.approx([getattr(band, end) for band in bands])
    assert found["place"].to_numpy() == pytest.approx(places) and found["place"].attrs["units"] == "m"
    assert found.attrs["line"] == "yard" and json.loads(found.attrs["concrete"])["slip_yield"] == 50.0
    assert json.loads(found.attrs["quantities"])["pressure"] == made.pressure
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(WarpcreteError, match=r"pip install xarray, or use line\.record\(\)"):
        made.to_xarray()
