"""Lines from a few options, without any file: values, and one line for each missing or impossible option."""

import json
import math
import re

import pytest
from click.testing import CliRunner

from warpcrete import SceneError
from warpcrete.cli.main import cli, main
from warpcrete.core.errors import PlausibilityWarning
from warpcrete.mix.layer import slump_layer
from warpcrete.mix.mix import mix_of
from warpcrete.theory.pipe import Line, steady

PIPE = ["--diameter", "125mm", "--length", "190m", "--rise", "20 m", "--flow", "30m3/h"]


def called(*words):
    return CliRunner().invoke(cli, ["line", *words])


def test_a_slump_and_a_straight_pipe_suffice(tmp_path):
    """The pressure is that of the closed form for the layer of JGJ/T 10, and the weight of 2,350 kg/m3."""
    done = called("--slump", "180mm", "--stone", "20mm", *PIPE, "--out", str(tmp_path / "out"))
    assert done.exit_code == 0, done.output
    mix = mix_of({"density": 2350, "slump": "180 mm"})
    eta, tau = slump_layer(0.18)
    assert (mix.concrete.slip_viscosity, mix.concrete.slip_yield) == pytest.approx((eta, tau))
    friction = steady(mix.concrete, Line(radius=0.0625, length=190.0, rise=0.0), 30 / 3600).pressure
    record = json.loads((tmp_path / "out" / "line.json").read_text(encoding="utf-8"))
    assert record["pressure"]["value"] == pytest.approx(friction + 2350 * 9.81 * 20, rel=1e-9)
    assert record["pressure_low"]["value"] < record["pressure"]["value"] / 1.4
    assert "slump 180mm at 30 m3/h" in done.output and "20 mm in a bore of 125 mm has the ratio 0.16" in done.output
    assert "bends, reducers and hoses are not counted" in done.output
    assert "alone says little about the slip layer: the parts of the mix give a better estimate" in done.output


def test_us_units_and_a_spread_suffice_as_well():
    """A line in US units has the pressure of the equal line in metres."""
    us = called(
        "--spread", "24 in", "--diameter", "5 in", "--length", "600 ft", "--rise", "-30 ft", "--flow", "40 yd3/hr"
    )
    si = called("--spread", "609.6 mm", "--diameter", "127 mm", "--length", "182.88 m", "--rise", "-9.144 m",
                "--flow", f"{40 * 0.764554857984} m3/h")  # fmt: skip
    pressures = [done.output.split("pressure at the pump ")[1].split(" bar")[0] for done in (us, si)]
    assert us.exit_code == si.exit_code == 0 and pressures[0] == pressures[1]
    assert math.isfinite(float(pressures[0]))


def test_without_a_flow_pressures_at_usual_flows_are_printed():
    """The pressures are those of runs with each flow; in US units, flows are in cubic yards per hour."""
    words = ["--slump", "180mm", "--stone", "20mm", "--diameter", "125mm", "--length", "190m"]
    done = called(*words)
    lines = [each for each in done.output.splitlines() if each.startswith("- ")]
    assert done.exit_code == 0 and [each.split(":")[0] for each in lines] == [
        f"- {rate} m3/h" for rate in (10, 20, 30, 45, 60)
    ]
    whole = called(*words, "--flow", "30 m3/h").output
    pressure = whole.split("pressure at the pump ")[1].split(";")[0]
    assert lines[2].split(": ")[1].split(";")[0] == pressure and "stone in bore" in done.output
    us = called("--slump", "7in", "--diameter", "5in", "--length", "480ft")
    assert us.exit_code == 0 and "- 15 yd3/h: " in us.output and us.output.count(" psi)") == 10


def test_an_assumed_density_is_stated(tmp_path):
    """The weight of 20 m of concrete follows from it, with and without a flow; a file of a concrete states its own."""
    remark = "remark: a slump or spread alone says nothing about the density: 2350 kg/m3 is assumed"
    pipe = ["--diameter", "125mm", "--length", "190m", "--rise", "20m"]
    (tmp_path / "taps.csv").write_text("place [m],pressure [bar],flow [m3/h]\n0,22,30\n90,12,30\n", encoding="utf-8")
    for more in (["--flow", "30m3/h"], [], ["--flow", "30m3/h", "--fit", str(tmp_path / "taps.csv")]):
        done = called("--slump", "180mm", *pipe, *more)
        assert done.exit_code == 0 and done.output.count(remark) == 1, done.output
    (tmp_path / "own.yaml").write_text("mix: {density: 2300, slump: 180 mm}\n", encoding="utf-8")
    done = called("--concrete", str(tmp_path / "own.yaml"), *pipe, "--flow", "30m3/h")
    assert done.exit_code == 0 and "is assumed" not in done.output
    us = called("--slump", "7in", "--diameter", "5in", "--length", "480ft")
    assert "2350 kg/m3 (3961 lb/yd3) is assumed" in us.output


def test_a_slump_replaces_the_concrete_of_a_file():
    own, other = called("burj-khalifa"), called("burj-khalifa", "--slump", "220 mm")
    assert own.exit_code == other.exit_code == 0 and "slump 220 mm at" in other.output and "no1 at" in own.output
    for name, total in (("burj-khalifa", 183), ("shanghai-tower", 189)):
        words = called(name).output.split("the concrete is unknown: this file assumes no1, while ")[1]
        assert f"predicts {total} bar)" in words.splitlines()[0]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([], "line: is missing; give its file, or a straight line as --diameter '125 mm'"),
        (["--diameter", "5 in"], "length: is missing; a line without a file needs --length"),
        (["--length", "5 m"], "diameter: is missing; a line without a file needs --diameter"),
        (["--concrete", "no1", "--diameter", "125mm", "--length", "190m"], "flow: is missing; set it in the file"),
        (
            ["--slump", "18cm", "--diameter", "125mm", "--length", "9m", "--rest", "5 min"],
            "flow: is missing; without a flow, the command prints only pressures at usual flows",
        ),
        (PIPE, "concrete: is missing; set it in the file of the line, with --concrete no1 or a file, or with --slump"),
        (["--slump", "180mm", *PIPE, "--rise", "200 m"], "rise = '200 m': must be in [-190, 190] m"),
        (["--slump", "180 m", *PIPE], "mix slump = '180 m': must be in [0.01, 0.29] m"),
        (["--slump", "18", *PIPE], "mix slump = 18.0: must be in"),
        (["--slump", "30mm", "--spread", "700mm", *PIPE], "contradicts 1480 (591 to 2110) Pa from slump of 30 mm"),
        (["--slump", "180mm", "--stone", "2mm", *PIPE], "stone = '2mm': must be at least 0.008 m"),
        (["--slump", "180mm", "--stone", "130mm", *PIPE], "largest_stone = '130mm': does not pass through part 1"),
        (["--slump", "180mm", "--concrete", "no1", *PIPE], "slump = '180mm': cannot be given together with --concrete"),
        (["--slump", "180mm", *PIPE, "--simulate"], "slump: a slump or spread alone is not enough for a simulation"),
        (
            ["--slump", "180mm", *PIPE, "--length", "190 l"],
            "length = '190 l': must be a number with one of the units m, mm",
        ),
        (["burj-khalifa", "--length", "3 m"], "length = '3 m': cannot be given together with the file of a line"),
        (["--slump", "180mm", *PIPE, "--diameter", "0"], "diameter = 0.0: must be a finite number above 0 m"),
    ],
)
def test_options_that_are_missing_or_impossible_are_told_in_one_line(words, says):
    done = called(*words)
    text = str(done.exception) if done.exit_code == 1 else done.output
    assert done.exit_code != 0 and says in text


def test_every_option_that_has_no_answer_without_a_flow_is_named(tmp_path):
    options = ["--rest", "5 min", "--pump-pressure", "85 bar", "--pump-flow", "60 m3/h", "--pump-power", "110 kW",
               "--practice", "--out", str(tmp_path / "out")]  # fmt: skip
    done = called("--slump", "18cm", "--diameter", "125mm", "--length", "9m", *options)
    needing = "--rest and --pump-pressure and --pump-flow and --pump-power and --practice and --out"
    assert done.exit_code != 0 and done.output.strip().endswith(f"as in --flow '30 m3/h', or leave out {needing}")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--shapes", "reference"], "shapes = 'reference': has no effect with --method flow"),
        (["--known", "foo"], "known = 'foo': has no effect without a simulation"),
        (["--gauge", "1 bar"], "gauge = '1 bar': has no effect without --fit"),
        (["--seeds", "3"], "seeds = 3: has no effect with --method flow"),
    ],
)
def test_refused_options_have_quotes_around_texts_only(options, says):
    assert says in called("burj-khalifa", *options).output


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("layer_factor", 1.5), ("rest", "5 min"), ("pump_pressure", "85 bar"), ("pump_flow", "60 m3/h"),
        ("pump_power", "110 kW"), ("cells", 9),
    ],
)  # fmt: skip
def test_options_of_theory_and_flow_are_refused_with_discrete_elements(option, value):
    done = called("burj-khalifa", "--method", "dem", f"--{option.replace('_', '-')}", str(value))
    assert done.exit_code != 0
    assert f"{option} = {value!r}: has no effect with --method dem; use --method both" in done.output


def test_a_misplaced_diameter_is_questioned_and_starts_no_large_simulation(tmp_path):
    """The reducer from 1 m to 5 inches needs a million cells, and more with finer cells."""
    site = tmp_path / "site.yaml"
    parts = "parts:\n  - straight: 10\n  - reducer: {to: 5 in, length: 0.8 m}\n  - straight: 10\n"
    site.write_text(f"diameter: 1000 mm\nflow: 30 m3/h\nconcrete: no1\n{parts}", encoding="utf-8")
    with pytest.warns(PlausibilityWarning, match=r"diameter = 1000 mm: is unusual: concrete pipes have diameters of"):
        done = CliRunner().invoke(cli, ["line", str(site)])
    assert isinstance(done.exception, SceneError)
    assert re.search(
        r"part 2 = .* with 980,000 cells may take hours; .*--simulate simulates every part of the line",
        str(done.exception),
    )
    with pytest.warns(PlausibilityWarning):
        done = CliRunner().invoke(cli, ["line", str(site), "--simulate", "--cells", "40", "--out", str(tmp_path / "x")])
    assert isinstance(done.exception, SceneError) and "at most 5,000,000 are possible" in str(done.exception)
    with pytest.warns(PlausibilityWarning):
        assert CliRunner().invoke(cli, ["line", str(site), "--theory"]).exit_code == 0


def test_lengths_without_a_unit_beside_feet_are_questioned(tmp_path):
    site = tmp_path / "site.yaml"
    text = (
        "diameter: 5 in\nflow: 30 m3/h\nconcrete: no1\nparts:\n  - straight: 100 ft\n  - bend: up\n  - straight: {}\n"
    )
    site.write_text(text.format("120"), encoding="utf-8")
    with pytest.warns(PlausibilityWarning, match=r"part 3, straight: 120: .* is in m, .* in ft; did you mean '120 ft'"):
        assert CliRunner().invoke(cli, ["line", str(site)]).exit_code == 0
    site.write_text(text.format("120 ft"), encoding="utf-8")
    assert "did you mean" not in CliRunner().invoke(cli, ["line", str(site)]).output


@pytest.mark.parametrize(("rest", "minutes"), [("30 minutes", 30), ("1 hour", 60), ("1800 seconds", 30)])
def test_units_of_time_may_be_written_out(rest, minutes):
    done = CliRunner().invoke(cli, ["line", "--slump", "180 mm", *PIPE, "--rest", rest])
    assert done.exit_code == 0 and f"after {minutes} min of rest" in done.output


def test_a_unit_after_a_space_is_not_taken_as_a_file():
    done = CliRunner().invoke(cli, ["line", "--slump", "180", "mm", *PIPE])
    assert done.exit_code == 2 and "'mm' was taken as this file; write an amount without a space" in done.output


def test_concrete_that_cannot_be_pumped_is_named_before_its_pressure():
    done = CliRunner().invoke(cli, ["line", "--slump", "30 mm", *PIPE])
    assert done.output.lstrip().startswith("WARNING: consistency: slump 30 mm") and done.exit_code == 0
    assert done.output.index("cannot be pumped") < done.output.index("pressure at the pump")
    assert "WARNING" not in CliRunner().invoke(cli, ["line", "--slump", "120 mm", *PIPE]).output


def test_an_assumed_air_content_is_named_beside_the_pressure(tmp_path):
    mix = tmp_path / "mix.yaml"
    text = "mix: {{slump: 150 mm, {}parts: {{cement: 340, water: 170, sand: 800, gravel: 1050}}}}\n"
    said = []
    for air in ("", "air: 2 %, "):
        mix.write_text(text.format(air), encoding="utf-8")
        said.append(called(*PIPE, "--concrete", str(mix)).output)
    assert "remark: the mix states no air content: 2 % is assumed" in said[0] and "remark:" not in said[1]


def test_a_number_sign_that_a_shell_reads_as_a_comment_is_explained(monkeypatch, capsys):
    """The shell drops `#57` from `--stone #57`, so that the option has no argument."""
    monkeypatch.setattr("sys.argv", ["warpcrete", "line", "--stone"])
    monkeypatch.setattr("signal.signal", lambda *given: None)
    with pytest.raises(SystemExit):
        main()
    assert "put a value that begins with # in quotes, as in --stone '#57'" in capsys.readouterr().err
