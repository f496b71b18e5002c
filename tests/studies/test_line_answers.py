"""Answers about a line: power, pump, units, rules of practice, and the command that prints them."""

import json
import math
import re
import subprocess
import sys

import pytest
from click.testing import CliRunner
from plug_lines import FLOW, METRE, PLUG, line, pumped

from warpcrete import SceneError, WarpcreteError
from warpcrete.cli.main import cli
from warpcrete.core.inputs.customary import METRIC_SIZES
from warpcrete.geometry.pumps import Pump, pump_of
from warpcrete.mix.blocking import VERDICTS
from warpcrete.studies.lines.answers import EFFICIENCY, pressure_text, time_text
from warpcrete.studies.lines.fittings import methods_on_bends
from warpcrete.studies.lines.losses import line_of
from warpcrete.studies.lines.pressures import Stop
from warpcrete.studies.lines.result import lines_of
from warpcrete.studies.lines.run import run_line


@pytest.mark.parametrize(
    ("length", "jsce", "jgj"),
    [(1.5, 6.0, 1.0), (3.0, 12.0, 2.0), (5.0, 20.0, 2.0), (6.5, 20.0, 2.6), (8.0, 20.0, 3.2), (16.0, 40.0, 6.4)],
)
def test_hoses_of_other_lengths_than_in_a_rule_count_in_proportion(length, jsce, jgj):
    """A hose of 1.5 m once counted as 20 m of level pipe by the rule of the JSCE, and as 2 bar by JGJ/T 10."""
    rows = {row.rule: row for row in pumped({"straight": 2}, {"hose": length}).practice()[1]}
    assert rows["JSCE"].pressures["hose"] == pytest.approx(jsce * METRE)
    assert rows["JGJ/T 10"].pressures["hose"] == pytest.approx(jgj * 1e5)
    for rule, shortest, longest in (("JSCE", 5, 8), ("JGJ/T 10", 3, 5)):
        said = "a shorter or longer hose counts in proportion" in rows[rule].implies
        assert said == (not shortest <= length <= longest)


@pytest.mark.parametrize(
    "part", [{"bend": {"to": "up"}}, {"reducer": {"to": "100 mm", "length": 2}}, {"hose": {"length": 6}}, {"valve": {}},
             {"straight": {"length": 10}}]
)  # fmt: skip
@pytest.mark.parametrize("stated", [{"factor": 4}, {"equivalent": 30}])
def test_rules_of_practice_use_the_friction_that_the_file_states(part, stated):
    """They once used their own figures even if the file of the line stated the friction of a part."""
    ((kind, entries),) = part.items()
    found = pumped({"straight": 2}, {kind: entries | stated})
    rows, loss = {row.rule: row for row in found.practice()[1]}, found.losses[1]
    metres = (4 * loss.part.length) if "factor" in stated else 30
    wanted = {"AIJ": metres * loss.straight / loss.part.length, "JSCE": metres * loss.straight / loss.part.length,
              "JGJ/T 10": 5e3 * metres}  # fmt: skip
    for rule, friction in wanted.items():
        beside = 2 * (5e3 if rule == "JGJ/T 10" else METRE) if kind == "straight" else 0
        assert rows[rule].pressures[kind] == pytest.approx(friction + loss.weight + beside), rule


def test_rules_of_practice_say_which_parts_they_do_not_cover():
    rows = {row.rule: row for row in pumped({"straight": 2}, {"valve": {}}, {"reducer": "100 mm"}).practice()[1]}
    assert "valves count as straight pipe" in rows["AIJ"].implies and "valves count as" in rows["JSCE"].implies
    assert "reducers count as straight pipe" in rows["JGJ/T 10"].implies
    assert "28 bar for the pump itself" in rows["JGJ/T 10"].implies
    stated = pumped({"straight": 2}, {"valve": {"equivalent": 3}}).practice()[1]
    assert not any("count as straight pipe" in row.implies for row in stated)


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
        ({"presure": "85 bar"}, r"^pump's key = 'presure': must be one of pressure, flow, power; did you"),
        ("85 kW", r"^pump pressure = '85 kW': must be a number with one of the units Pa, bar"),
        (0, r"^pump pressure = 0\.0: must be a finite number above 0 Pa"),
        (
            {"pressure": "85 bar", "power": "110 bar"},
            r"^pump power = '110 bar': must be a number with one of the units W, kW, hp",
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
    """Amounts in the text are followed by US ones, and 60 yd3/h are 45.87 m3/h. The table has US units only."""
    stop = Stop(1200.0, 0.5, None)
    ours = run_line(line_of(US_LINE), PLUG, 60 * 0.9144**3 / 3600, simulate=False, layer_factor=2.0, stop=stop)
    text = "\n".join(lines_of(ours))
    band, psi = ours.band(), 6894.757293
    for each in (
        f"{ours.line.length:.4g} m ({ours.line.length / 0.3048:.4g} ft)",
        "at 45.87 m3/h (60 yd3/h)",
        f"{band.low / 1e5:.4g} to {band.high / 1e5:.4g} bar ({band.low / psi:.4g} to {band.high / psi:.4g} psi)",
        "delivers 85.01 bar (1233 psi)", "the motor has 149 kW (200 hp)", "its flow of up to 53.52 m3/h (70 yd3/h)",
        "| 1 | straight | 5 | 330 | 0 |", "| 2 | bend of 90 degrees, radius 1.64 ft | 5 | 2.577 |", "friction [psi]",
        f"bar, or {ours.restart().value / psi:.4g} (",
    ):  # fmt: skip
        assert each in text, each
    metric = line_of({**US_LINE, "diameter": "127 mm", "pump": "85 bar", "parts": [{"straight": "100 m"}]})
    plain = "\n".join(lines_of(run_line(metric, PLUG, 0.01, simulate=False, layer_factor=2.0)))
    assert ours.line.customary and not metric.customary and "yd3" not in plain and plain.count("psi") == 1


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0, "0 s"), (119, "119 s"), (120, "2 min"), (5400, "90 min"), (3 * 3600, "3 h"), (86400, "24 h")],
)
def test_long_times_are_in_hours(seconds, text):
    assert time_text(seconds) == text


def test_rules_of_practice_let_falling_concrete_separate():
    """The table shows the pressure of the answer, and the rule of AIJ counts from zero before the fall, by hand.

    Friction of 30 m of fall with a bend is less than its weight, so only 10 m before it need a pressure.
    """
    found = pumped({"straight": 10}, {"bend": "down"}, {"straight": 30}, {"bend": "level"}, {"straight": 2})
    ours, rows = found.practice()
    bend, weight = 0.25 * math.pi * METRE, 2400 * 9.81
    assert 32 * METRE + 3 * bend < 30.5 * weight and 3 * bend > 0.5 * weight
    first = 3 * bend - 0.5 * weight + 10 * METRE
    assert rows[0].rule == "AIJ" and rows[0].pressure == pytest.approx(first)
    # Half of the bend adds 0.09 %.
    assert ours.pressure == found.pressure == pytest.approx(10 * METRE, rel=1e-3)
    assert sum(ours.pressures.values()) < 0
    text = "\n".join(lines_of(found, practice=True))
    assert f"| this result | {found.pressure / 1e5:.3g} |" in text and "43.57 m, 31 m down, concrete at" in text


def test_parts_of_a_line_in_us_units_are_named_as_the_file_states_them():
    parts = [{"straight": "30 ft"}, {"bend": {"to": "up", "radius": "18 in"}}, {"reducer": "4 1/2 in"},
             {"reducer": {"to": "100 mm", "length": "2 ft"}}, {"bend": {"to": "level", "angle": 45}},
             {"straight": "10 ft"}, {"reducer": "3.5 in"}, {"hose": "12 ft"}]  # fmt: skip
    line = line_of({"diameter": "5 in", "parts": parts})
    assert [part.label for part in line.parts] == [
        "straight", "bend of 90 degrees, radius 18 in", "5 in to 4 1/2 in", "4 1/2 in to 3.937 in",
        "bend of 45 degrees, radius 1.64 ft", "straight, rises 7.07 ft", "3.937 in to 3.5 in", "hose, rises 8.49 ft",
    ]  # fmt: skip
    metric = line_of({"diameter": "125 mm", "parts": [{"reducer": "100 mm"}, {"bend": "up"}]})
    assert [part.label for part in metric.parts] == ["125 to 100 mm", "bend of 90 degrees, radius 0.5 m"]


def test_a_straight_line_in_us_units_and_rules_of_practice_have_us_units():
    call = ["line", "--slump", "7 in", "--diameter", "5 in", "--length", "480 ft", "--rise", "65 ft"]
    call += ["--flow", "40 yd3/h"]
    said = CliRunner().invoke(cli, [*call, "--practice"], catch_exceptions=False).output
    assert "| 1 | straight, rises 65 ft | 5 | 480 | 65 |" in said and "| | pressure [psi] | straight pipe |" in said
    assert "narrowest part 1, straight, rises 65 ft, 127 mm (5 in)" in said
    # 7 in are 177.8 mm, and 28 bar are 406 psi. Every metric amount of an answer is followed by a US one.
    assert "slump 177.8 mm (7 in); 100 to 160 mm (3.937 to 6.299 in) are usual" in said and "28 bar (406 psi)" in said
    lines = [line.rsplit(" (", 1)[0] if line.startswith(VERDICTS) else line for line in said.split("\n")]
    units = "|".join((*METRIC_SIZES, "m3/h", "kW", "m3"))
    alone = [
        found
        for line in lines
        for found in re.findall(rf"[0-9] (?:{units})\b(?! \(|/|, or| over)(?!, [0-9.]* psi)", line)
    ]
    assert not alone, (alone, lines)


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
    assert (
        "| JGJ/T 10 | 17.7 |" in text
        and methods_on_bends() in text
        and "rise counts as 4 times its length of level pipe" in text
    )
    down = pumped({"straight": 10}, {"bend": "down"}, {"straight": 20}).practice()[1]
    assert down[1].pressures["straight"] == pytest.approx(30 * METRE) and down[2].pressures["straight"] == 150e3


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
    assert "pump pressure = '85 kg': must be a number with one of the units Pa, bar" in str(wrong.exception)
    for more, says in ((["--cells", "9"], "cells = 9: has no effect without a simulation; add --simulate"),
                       (["--theory", "--simulate"], "--theory: cannot be combined with --simulate")):  # fmt: skip
        refused = CliRunner().invoke(cli, ["line", str(path), *more])
        assert refused.exit_code == 2 and says in refused.output
    none = CliRunner().invoke(cli, ["line", str(path), "--method", "dem", "--practice"])
    assert none.exit_code == 2 and "practice = True: has no effect with --method dem" in none.output


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
