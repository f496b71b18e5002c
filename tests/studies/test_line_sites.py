"""Answers of `warpcrete line` for a site: restarts, complete files, pictures, and sparse inputs."""

import json
from dataclasses import replace

import pytest
import yaml
from click.testing import CliRunner

from warpcrete import SceneError
from warpcrete.cli.main import cli
from warpcrete.mix.mix import read_mix
from warpcrete.studies.lines.answers import ON_CONCRETE
from warpcrete.studies.lines.fit import fit_line
from warpcrete.studies.lines.losses import line_of
from warpcrete.studies.lines.pressures import Stop
from warpcrete.studies.lines.result import lines_of
from warpcrete.studies.lines.taps import Tap
from warpcrete.studies.lines.theory_line import line_by_theory
from warpcrete.theory.pipe import Concrete

TICKET = {"parts": {"cement": 320, "fly ash": 60, "water": 175, "sand": 780, "gravel": 1020, "superplasticizer": 3.2},
          "sizes": ["4 mm", "16 mm"], "slump": "200 mm"}  # fmt: skip
PARTS = [{"straight": 57}, {"bend": "up"}, {"straight": 24}, {"bend": "level"}, {"straight": 55},
         {"reducer": {"to": "100 mm"}}, {"hose": 4}]  # fmt: skip


@pytest.fixture
def site(tmp_path):
    """Return a function that calls `warpcrete line` with the files of a site, and returns what it prints."""
    (tmp_path / "ticket.yaml").write_text(yaml.safe_dump({"name": "C30/37", "mix": TICKET}), encoding="utf-8")
    entries = {"diameter": "125 mm", "flow": "35 m3/h", "concrete": "ticket.yaml", "pump": "85 bar", "parts": PARTS}
    (tmp_path / "site.yaml").write_text(yaml.safe_dump(entries), encoding="utf-8")

    def call(*options):
        done = CliRunner().invoke(cli, ["line", str(tmp_path / "site.yaml"), *map(str, options)])
        assert done.exit_code == 0, done.output
        return done.output

    return call


def result(tmp_path, bar, rest, growth=0.5, assumed=((0.1, 1.0),)):
    (tmp_path / "ticket.yaml").write_text(yaml.safe_dump({"mix": TICKET}), encoding="utf-8")
    mix = read_mix(tmp_path / "ticket.yaml")
    line = line_of({"diameter": "125 mm", "pump": f"{bar} bar", "parts": PARTS})
    stop = Stop(rest, growth, *assumed)
    return line_by_theory(line, mix.concrete, 35 / 3600, variants=mix.variants, stop=stop)


@pytest.mark.parametrize(("bar", "verdict"), [(200, "restarts"), (85, "may fail"), (50, "is too weak")])
def test_the_pump_is_compared_with_the_restart(tmp_path, bar, verdict):
    found = result(tmp_path, bar, 2400.0)
    begins, full = found.restart(), found.restart(found.flow)
    assert begins.value < 85e5 < full.high < 200e5 and begins.value > 50e5
    assert found.restart_margin.verdict == verdict and verdict in found.restart_margin.sentence()
    assert found.record()["restart"]["verdict"] == verdict
    longest = found.record()["restart"]["longest_stop"]["value"]
    assert (longest > 2400.0) == (verdict == "restarts")
    text = "\n".join(lines_of(found))
    assert f"longest stop after which the pump restarts the line: {longest // 60:.0f} min" in text


def test_the_longest_stop_just_needs_the_whole_pressure_of_the_pump(tmp_path):
    found = result(tmp_path, 85, 2400.0)
    longest = found.restart_margin.longest
    assert 60 < longest < 2400
    assert result(tmp_path, 85, longest).restart(found.flow).high == pytest.approx(85e5, rel=2e-3)
    assert f"move the concrete at least every {longest // 60:.0f} min" in found.restart_margin.sentence()
    weak = result(tmp_path, 30, 2400.0).restart_margin
    assert weak.longest is None and "do not interrupt the flow" in weak.sentence()
    assert weak.longest_sentence().endswith("restarts the line: less than 1 min")
    strong = result(tmp_path, 500, 600.0).restart_margin
    assert strong.longest == 3600 and strong.longest_sentence().endswith("at least 60 min")


def test_an_assumed_growth_is_judged_at_the_highest_published_rate_too(tmp_path):
    """The advice must agree with the answers for stated rates, whose bands contain no error of the rate."""
    found = result(tmp_path, 85, 900.0, assumed=((0.1, 1.0), 1.7))
    margin, stated = found.restart_margin, result(tmp_path, 85, 900.0, 1.7, ())
    assert margin.verdict == "restarts" and stated.restart_margin.verdict != "restarts"
    high, longest = stated.restart(stated.flow).high, stated.restart_margin.longest
    assert (margin.fast.high, margin.fast.longest) == pytest.approx((high, longest)) and high > 85e5
    for factor, verdict in ((0.99, "restarts"), (1.01, "may fail")):
        assert result(tmp_path, 85, 900.0, factor * margin.fast.bearable, ()).restart_margin.verdict == verdict
    assert f"if the yield stress grows by at most {margin.fast.bearable - 0.005:.2f} Pa/s" in margin.sentence()
    assert (f"at 1.7 Pa/s, the highest published rate, up to {high / 1e5:.4g} bar; in that case move the concrete at "
            f"least every {longest // 60:.0f} min") in margin.sentence()  # fmt: skip
    assert margin.longest_sentence().endswith(f"{margin.longest // 60:.0f} min (at 1.7 Pa/s: {longest // 60:.0f} min)")
    fast = found.record()["restart"]["fast_growth"]
    assert fast["longest_stop"]["value"] == longest and fast["bearable_growth"]["value"] == margin.fast.bearable
    assert "these bands assume a growth of 0.1 to 1 Pa/s" in "\n".join(lines_of(found))
    assert "these bands assume" not in "\n".join(lines_of(stated))
    enough = result(tmp_path, 300, 1200.0, assumed=((0.1, 1.0), 1.7)).restart_margin.sentence()
    assert enough.startswith("the pump restarts the line: ") and "in that case" not in enough


def test_without_a_pump_the_answer_says_which_pump_restarts_the_line(tmp_path):
    """It is the upper end of the band; at the highest published rate, it is that of this rate if a user states it."""
    found, fast = (result(tmp_path, 85, 1200.0, *growth) for growth in ((0.5, ((0.1, 1.0), 1.7)), (1.7, ())))
    wanted = [f"a pump must deliver {each.restart(each.flow).high / 1e5:.3g} bar" for each in (found, fast)]
    assert not any(each in "\n".join(lines_of(found)) for each in wanted)
    found, fast = (replace(each, line=replace(each.line, pump=None)) for each in (found, fast))
    said = next(each for each in lines_of(found) if wanted[0] in each)
    assert f", and {fast.restart(fast.flow).high / 1e5:.3g} bar at 1.7 Pa/s, the highest published rate" in said
    assert wanted[1] in "\n".join(lines_of(fast))


@pytest.mark.parametrize(
    ("options", "named"),
    [(["--out", "line"], "--out"), (["--pump-pressure", "85 bar"], "--pump-pressure"), (["--practice"], "--practice"),
     (["--rest", "20 min", "--practice"], "--rest and --practice")],
)  # fmt: skip
def test_options_that_need_a_flow_are_named(options, named):
    call = ["line", "--slump", "180 mm", "--diameter", "125 mm", "--length", "90 m", *options]
    done = CliRunner().invoke(cli, call)
    assert done.exit_code == 2 and f"leave out {named}" in " ".join(done.output.split()), done.output


def test_the_file_contains_all_that_is_printed(site, tmp_path):
    (tmp_path / "taps.csv").write_text("place [m],pressure [bar],flow [m3/h]\n5,30,35\n80,14,35\n", encoding="utf-8")
    for name, more in (("one", ["--practice", "--rest", "40 min"]), ("two", ["--fit", tmp_path / "taps.csv"])):
        printed = site("--out", tmp_path / name, *more)
        text = (tmp_path / name / "line.md").read_text(encoding="utf-8")
        assert printed.strip() == f"{text.strip()}\n\nfolder: {tmp_path / name}"
        assert "will it block?" in text and text.count(ON_CONCRETE) == 1
        assert (tmp_path / name / "blocking.json").is_file()
    assert "deviation [bar]" in text
    assert "JGJ/T 10" in (tmp_path / "one" / "line.md").read_text(encoding="utf-8")


def test_files_are_complete_before_anything_is_printed(site, tmp_path, monkeypatch):
    """A reader such as `head` may close the output after a few lines."""
    import click

    def closed(*_, **__):
        assert (tmp_path / "out" / "blocking.json").is_file()
        assert "will it block?" in (tmp_path / "out" / "line.md").read_text(encoding="utf-8")
        raise BrokenPipeError

    monkeypatch.setattr(click, "echo", closed)
    with pytest.raises(BrokenPipeError):
        CliRunner().invoke(cli, ["line", str(tmp_path / "site.yaml"), "--out", str(tmp_path / "out")],
                           catch_exceptions=False)  # fmt: skip


def caption(axes):
    return " ".join(axes.figure.get_suptitle().split())


def test_the_picture_shows_gauges_pump_and_restart_in_the_units_of_the_line(tmp_path):
    found = result(tmp_path, 85, 2400.0)
    axes = found.plot().axes[0]
    names = axes.get_legend_handles_labels()[1]
    assert "pump" in names and "restart after 40 min" in names
    assert {"bend", "reducer", "hose", "weight alone"} <= set(names)
    bar = next(each for each in axes.containers if each.get_label().startswith("restart"))
    assert 0 < bar[0].get_xdata()[0] < 0.05 * axes.get_xlim()[1]
    assert "diameter 125 to 100 mm" in caption(axes) and axes.get_ylabel() == "pressure [bar]"
    line = line_of({"diameter": "5 in", "pump": "1233 psi", "parts": [{"straight": "300 ft"}]})
    axes = line_by_theory(line, found.concrete, 0.01).plot().axes[0]
    assert axes.get_xlabel() == "position along the line [ft]" and axes.get_ylabel() == "pressure [psi]"
    assert axes.get_xlim()[1] == pytest.approx(300) and "diameter 5 in" in caption(axes)
    assert "weight alone" not in axes.get_legend_handles_labels()[1]


def test_the_picture_tells_gauges_at_the_flow_of_the_line_from_others():
    line = line_of({"diameter": "125 mm", "parts": [{"straight": 100}, {"hose": 4}]})
    concrete = Concrete(density=2400.0, viscosity=60.0, yield_stress=80.0, slip_viscosity=700.0, slip_yield=25.0)
    taps = [Tap(place, 8e5 * flow, flow / 100, 0) for place, flow in ((0, 1.0), (10, 1.0), (0, 0.5))]
    found = line_by_theory(line, concrete, 0.01, fit=fit_line(line, concrete, taps))
    shown = {x.get_label(): (list(x.get_xdata()), x.get_markerfacecolor()) for x in found.plot().axes[0].lines}
    assert shown["gauges"][0] == [0, 10] and shown["gauges at other flows"] == ([0], "white")
    assert shown["gauges"][1] != "white" and line.parts[1].label == "hose"


def test_the_name_in_the_file_of_a_concrete_is_that_of_the_result(site):
    assert "C30/37 at 35 m3/h" in site()


def test_a_reducer_without_a_length_is_one_metre_long():
    parts = [{"straight": 10}, {"reducer": {"to": "100 mm"}}]
    assert line_of({"diameter": "125 mm", "parts": parts}).parts[1].length == 1.0


@pytest.mark.parametrize(
    ("entries", "more", "says"),
    [
        ({"slump": "7 in", "sizes": "3/4 in"}, [], "add 'density: 2350 kg/m3' (147 lb/ft3)"),
        (
            TICKET | {"layer": {"points": [["35 m3/h", "21 bar"]], "diameter": "125 mm", "length": "75 m"}},
            [],
            "'1 point at one flow'",
        ),
        (TICKET, ["--rest", "40"], "did you mean '40 min'? For seconds, write '40 s'"),
    ],
)
def test_sparse_inputs_are_refused_in_plain_words(site, tmp_path, entries, more, says):
    (tmp_path / "ticket.yaml").write_text(yaml.safe_dump({"mix": entries}), encoding="utf-8")
    done = CliRunner().invoke(cli, ["line", str(tmp_path / "site.yaml"), *more])
    said = f"{done.output} {done.exception}"
    assert done.exit_code != 0 and says in said and "None" not in said


def test_a_slump_alone_is_too_little_for_the_rules_against_blocking():
    call = ["line", "--slump", "7 in", "--stone", "3/4 in", "--diameter", "5 in", "--length", "450 ft"]
    done = CliRunner().invoke(cli, [*call, "--flow", "40 yd3/h"])
    assert "will it block? too little is known about the concrete to say (6 unknown, 1 fine" in done.output


def test_the_record_holds_the_longest_stop(site, tmp_path):
    site("--rest", "40 min", "--out", tmp_path / "out")
    record = json.loads((tmp_path / "out" / "line.json").read_text(encoding="utf-8"))
    assert record["restart"]["longest_stop"]["unit"] == "s"


def test_a_hose_with_a_diameter_is_told_to_use_a_reducer():
    with pytest.raises(SceneError, match=r"diameter.*put 'reducer: \{to: 4 in\}' before it"):
        line_of({"diameter": "5 in", "parts": [{"straight": 3}, {"hose": {"length": 4, "diameter": "4 in"}}]})


def test_another_estimate_of_the_layer_is_of_the_same_age_as_the_concrete(site, tmp_path):
    """The layer of JGJ/T 10 for a slump of 200 mm, 234 Pa s/m and 90 Pa, is multiplied by the factors as well."""
    file = {"mix": TICKET, "flow": {"viscosity_factor": 2, "yield_factor": 1.5}}
    (tmp_path / "ticket.yaml").write_text(yaml.safe_dump(file), encoding="utf-8")
    plain = read_mix(tmp_path / "ticket.yaml").concrete
    other = replace(plain, slip_viscosity=2 * 1.17 * 200, slip_yield=1.5 * 0.9 * 100)
    expected = line_by_theory(line_of({"diameter": "125 mm", "parts": PARTS}), other, 35 / 3600).pressure
    said = next(each for each in site().splitlines() if each.startswith("another estimate"))
    assert f"468 Pa s/m from slump of 200 mm, would give {expected / 1e5:.3g} bar" in said
