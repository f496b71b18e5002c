"""Mixes in scenes, lines and commands, with other flow laws and factors of age."""

import math
import warnings

import numpy as np
import pytest
from click.testing import CliRunner
from mixes import BULK, SPREADING, STONES, written

from warpcrete import SceneError, scenes
from warpcrete.cli.main import cli
from warpcrete.core.errors import PlausibilityWarning
from warpcrete.core.inputs.amounts import GALLON, POUND
from warpcrete.core.inputs.concretes import concrete
from warpcrete.core.inputs.yaml_files import yaml_text
from warpcrete.dem.scene.concretes import COVERAGE
from warpcrete.mix.mix import completed, mix_of, read_mix
from warpcrete.mps.common.mixes import concrete_of
from warpcrete.studies.lines.losses import line_of
from warpcrete.studies.lines.run import run_line
from warpcrete.theory.bands import combined
from warpcrete.theory.suspension import mortar_of


def test_factors_of_age_reach_the_band_of_a_mix(tmp_path):
    """The concrete and the ends of its bands are those of the mix, multiplied by what `flow` states."""
    text = "mix: {density: 2350, spread: 600 mm, t500: 4 s, water_binder: 0.4}\n"
    (tmp_path / "plain.yaml").write_text(text, encoding="utf-8")
    (tmp_path / "old.yaml").write_text(text + "flow: {yield_factor: 2, viscosity_factor: 1.5}\n", encoding="utf-8")
    plain, old = (read_mix(tmp_path / f"{name}.yaml") for name in ("plain", "old"))
    assert old.concrete.yield_stress == pytest.approx(2 * plain.concrete.yield_stress)
    assert old.concrete.slip_viscosity == pytest.approx(1.5 * plain.concrete.slip_viscosity)
    assert old.variants.keys() == plain.variants.keys() and len(plain.variants) > 1
    for cause, ends in plain.variants.items():
        for one, other in zip(ends, old.variants[cause], strict=True):
            assert other.viscosity == pytest.approx(1.5 * one.viscosity)
            assert other.slip_yield == pytest.approx(2 * one.slip_yield)
    done = CliRunner().invoke(cli, ["mix", str(tmp_path / "old.yaml"), "--out", str(tmp_path / "written.yaml")])
    written = concrete(str(tmp_path / "written.yaml")).flow
    assert done.exit_code == 0 and float(written["yield_stress"]) == pytest.approx(old.concrete.yield_stress, rel=1e-3)


def test_every_scene_takes_it(tmp_path):
    path = written(tmp_path, SPREADING | STONES)
    mix = read_mix(path)
    pipe, tube, slump = (make(concrete=path) for make in (scenes.pipe, scenes.tube, scenes.slump))
    kept = pipe.parameters
    assert (kept["sizes"], kept["shapes"], kept["bulk_density"]) == ("4:0,8:0.4,16:1", "reference", 2300.0)
    assert kept["layer_viscosity"] * COVERAGE == pytest.approx(mix["slip viscosity"].value)
    assert kept["wall_friction"] == 0.0
    assert tube.concrete == slump.concrete == mix.concrete
    assert scenes.part(concrete=path).concrete == mix.concrete
    assert concrete_of(str(path)) == mix.concrete
    two = scenes.tube(concrete=path, aggregates=True)
    assert two.aggregates.fraction == 0.36 and two.aggregates.density == 2650
    assert two.aggregates.mortar.viscosity == pytest.approx(mortar_of(mix.concrete, 0.36, 2650.0).viscosity)
    path.unlink()  # a record holds all that followed
    assert scenes.pipe(**pipe.parameters).parameters == kept
    assert scenes.tube(**two.parameters).aggregates == two.aggregates


def test_own_entries_go_before_the_mix_and_that_before_the_base(tmp_path):
    own = {"elements": {"layer_viscosity": 700.0, "shapes": "shape-2"}, "flow": {"viscosity": 9}}
    path = written(tmp_path, SPREADING | STONES, base="zhan", **own)
    kept = scenes.pipe(concrete=path).parameters
    assert (kept["layer_viscosity"], kept["sizes"]) == (700.0, "4:0,8:0.4,16:1")
    assert kept["shapes"] == completed(str(path)).elements["shapes"] == "shape-2"
    assert kept["wall_friction"] == 0.0 and kept["friction"] == concrete("zhan").elements["friction"]
    assert scenes.tube(concrete=path).concrete.viscosity == 9
    child = tmp_path / "child.yaml"
    child.write_text("base: mix.yaml\nflow: {slip_yield: 5}\n", encoding="utf-8")
    found = scenes.tube(concrete=child).concrete
    assert (found.slip_yield, found.viscosity) == (5, 9) and found.yield_stress == read_mix(path).concrete.yield_stress


def test_a_file_has_the_last_word_on_what_its_base_says_besides_a_mix(tmp_path):
    written(tmp_path, SPREADING | STONES, name="base.yaml", flow={"slip_yield": 3, "slip_viscosity": 700})
    child = tmp_path / "child.yaml"
    child.write_text("base: base.yaml\nflow: {slip_yield: 5}\n", encoding="utf-8")
    for found in (completed(str(child)).flow, read_mix(child).flow, concrete(str(child)).mix.flow):
        assert (found["slip_yield"], found["slip_viscosity"]) == (5, 700)


def test_the_command_prints_and_writes_a_concrete(tmp_path):
    path, plain = written(tmp_path, SPREADING | STONES, name="mix.yaml", source="site"), tmp_path / "plain.yaml"
    done = CliRunner().invoke(cli, ["mix", str(path), "--out", str(plain)])
    assert done.exit_code == 0, done.output
    mix = read_mix(path)
    assert mix._repr_html_().count("<tr>") == len(mix.rows()) + 1 == len(mix.text().splitlines())
    pytest.importorskip("pandas")
    table, spread = mix.table(), mix["yield stress"]
    assert list(table.index) == [each.name for each in mix.figures] and table.loc["yield stress", "low"] == spread.low
    assert tuple(table.loc["yield stress", ["value", "unit", "from"]]) == (spread.value, "Pa", spread.way)
    row = next(line for line in done.output.splitlines() if line.startswith("yield stress"))
    stress = mix["yield stress"]
    assert f"{stress.value:.4g}" in row and f"{stress.low:.3g} to {stress.high:.3g}" in row and "Roussel" in row
    names = ("concrete", "seed")
    one, other = (scenes.pipe(concrete=each).parameters for each in (path, plain))
    assert {k: v for k, v in one.items() if k not in names} == {k: v for k, v in other.items() if k not in names}
    assert scenes.tube(concrete=plain).concrete.viscosity == mix["viscosity"].value
    again = CliRunner().invoke(cli, ["mix", str(path), "--out", str(plain)])
    assert "must be the path of a .yaml file that does not exist yet" in str(again.exception)
    assert "has no section 'mix'" in str(CliRunner().invoke(cli, ["mix", "no1"]).exception)


def test_a_line_has_the_band_of_its_mix(tmp_path):
    path, site = written(tmp_path, BULK | STONES), tmp_path / "site.yaml"
    bend = {"bend": {"to": "up", "radius": "0.5 m", "factor": 1}}
    parts = [{"straight": "10 m"}, bend, {"straight": "5 m"}]
    site.write_text(
        yaml_text({"diameter": "125 mm", "flow": "20 m3/h", "concrete": "mix.yaml", "parts": parts}), encoding="utf-8"
    )
    mix, line = read_mix(path), line_of({"diameter": "125 mm", "parts": parts})
    found = run_line(line, mix.concrete, 20 / 3600, simulate=False, variants=mix.variants)
    ends = {cause: tuple(run_line(line, each, 20 / 3600, simulate=False).pressure for each in pair)
            for cause, pair in mix.variants.items()}  # fmt: skip
    expected = combined(found.pressure, ends)
    assert (found.band().low, found.band().high) == pytest.approx((expected.low, expected.high))
    assert dict(found.band().shares) == pytest.approx(dict(expected.shares))
    assert found.record()["layer_factor"] is None
    assert "comes from the slip layer; fit it to pressures" in found.record()["band"]
    done = CliRunner().invoke(cli, ["line", str(site), "--theory"])
    assert done.exit_code == 0, done.output
    assert f"{found.band().low / 1e5:.4g} to " in done.output and "comes from the slip layer" in done.output
    given = CliRunner().invoke(cli, ["line", str(site), "--theory", "--layer-factor", "1.5"])
    assert "100 % of the band of " in given.output and "comes from the slip layer" in given.output
    assert "layer_factor = 0.0" in str(CliRunner().invoke(cli, ["line", str(site), "--layer-factor", "0"]).exception)
    written(tmp_path, BULK | {"sizes": ["20 mm", "130 mm"]})
    assert "largest_stone = '130 mm': does not pass through part 1" in str(
        CliRunner().invoke(cli, ["line", str(site)]).exception
    )


def test_theory_says_how_far_a_fit_is_off(tmp_path):
    """The concrete is not sheared, so wall stress over mean velocity is the straight line of its slip layer."""
    flows, pressures = np.array([0.002, 0.005, 0.008]), np.array([1.0e5, 1.9e5, 3.1e5])
    points = tmp_path / "points.csv"
    own = ["--concrete", "own", "--density", "2300", "--viscosity", "50", "--yield-stress", "9e4"]
    pipe = ["--diameter", "0.125", "--length", "20", "--rise", "0"]

    def said(count):
        rows = [f"{q},{p}" for q, p in zip(flows[:count], pressures)]
        points.write_text("\n".join(["flow,pressure", *rows]) + "\n", encoding="utf-8")
        return CliRunner().invoke(cli, ["theory", *own, *pipe, "--fit", str(points)]).output

    _, covariance = np.polyfit(flows / (math.pi * 0.0625**2), pressures * 0.0625 / 40, 1, cov=True)
    eta, tau = np.sqrt(np.diag(covariance))
    assert f"; standard errors {eta:.2g} Pa s/m and {tau:.2g} Pa" in said(3)
    assert "; two points give no standard errors" in said(2)


def test_a_mix_states_another_law(tmp_path):
    """A file, its record and all flows have the law; the share of aggregate scales it to that of the mortar."""
    section = {"density": 2300, "aggregate": "36 %",
               "concrete": {"yield_stress": 40, "viscosity": "25 Pa s", "flow_index": 1.3},
               "layer": {"yield_stress": 10, "viscosity": 700, "quadratic_viscosity": "300 Pa s2/m2"}}  # fmt: skip
    path = written(tmp_path, section)
    mix = read_mix(path)
    assert mix["flow index"].value == 1.3 and mix["slip quadratic viscosity"].unit == "Pa s2/m2"
    assert mix.concrete.flow_index == 1.3 and mix.concrete.slip_quadratic_viscosity == 300.0
    assert "flow index" in mix.text()
    for made in (scenes.tube, scenes.slump, scenes.part):
        assert made(concrete=path).concrete == mix.concrete
    two = scenes.channel(concrete=path, aggregates=True).aggregates.mortar
    alone = mortar_of(mix.concrete, 0.36, 2650.0)
    assert two.flow_index == 1.3 and two.viscosity == pytest.approx(alone.viscosity)
    kept = scenes.tube(concrete=path).parameters
    path.unlink()  # a record holds the law
    assert scenes.tube(**kept).concrete == mix.concrete


@pytest.mark.parametrize("law", [{"flow_index": 0.9}, {"quadratic_viscosity": "20 Pa s2/m2"}])
def test_the_command_prints_a_mix_whose_layer_has_another_law(tmp_path, law):
    """Elements have no such layer, so the written file has no section for them, and flows read it."""
    layer = {"yield_stress": 20, "viscosity": 800, **law}
    path = written(tmp_path, {"density": 2300, "concrete": {"yield_stress": 40, "viscosity": 30}, "layer": layer})
    done = CliRunner().invoke(cli, ["mix", str(path), "--out", str(tmp_path / "o.yaml")])
    assert done.exit_code == 0 and "can only have a linear slip layer" in done.output
    assert "run pipe (elements)" not in done.output
    flow = scenes.tube(concrete=tmp_path / "o.yaml").concrete
    assert all(getattr(flow, f"slip_{key}") == float(str(value).split()[0]) for key, value in law.items())


def test_a_flow_states_another_law(tmp_path):
    path = tmp_path / "law.yaml"
    path.write_text("base: no1\nflow: {flow_index: 0.8, slip_flow_index: 1.2}\n", encoding="utf-8")
    found = scenes.tube(concrete=path)
    assert (found.concrete.flow_index, found.concrete.slip_flow_index) == (0.8, 1.2)
    assert scenes.tube(concrete=path, flow_index=1.0).concrete.flow_index == 1.0
    whole = {name: getattr(found.concrete, name) for name in ("density", "viscosity", "yield_stress", "slip_viscosity",
                                                              "slip_yield")}  # fmt: skip
    assert scenes.tube(concrete=path, **whole).concrete.flow_index == 0.8
    path.unlink()
    assert scenes.tube(concrete=path, **whole).concrete.flow_index == 1.0  # as in records of earlier versions


def test_elements_have_no_layer_that_is_not_linear(tmp_path):
    path = tmp_path / "law.yaml"
    path.write_text("base: no1\nflow: {slip_flow_index: 0.8}\n", encoding="utf-8")
    section = "elements: {layer_yield: 100, layer_viscosity: 900}\n"
    if not concrete("no1").elements:
        with pytest.raises(SceneError, match=r"slip_flow_index = 0\.8: cannot be simulated with discrete elements"):
            scenes.pipe(concrete=path)
    path.write_text(f"base: no1\nflow: {{slip_flow_index: 0.8}}\n{section}", encoding="utf-8")
    assert scenes.pipe(concrete=path).parameters["layer_viscosity"] == 900


def test_age_and_temperature_are_factors_that_a_file_states(tmp_path):
    """They scale stresses and viscosities of bulk and layer once, in scenes, records, lines and elements."""
    path = tmp_path / "old.yaml"
    path.write_text(
        "base: no1\nsource: measured after 60 min\nflow: {yield_factor: 1.5, viscosity_factor: 1.2}\n", encoding="utf-8"
    )
    fresh, old = scenes.tube().concrete, scenes.tube(concrete=path).concrete
    assert (old.yield_stress, old.slip_yield) == (1.5 * fresh.yield_stress, 1.5 * fresh.slip_yield)
    assert (old.viscosity, old.slip_viscosity) == (1.2 * fresh.viscosity, 1.2 * fresh.slip_viscosity)
    again = scenes.tube(**scenes.tube(concrete=path).parameters).concrete
    assert again == old == concrete_of(str(path)) and scenes.slump(concrete=path).concrete == old
    assert scenes.tube(concrete=path, yield_factor=1.0).concrete.yield_stress == fresh.yield_stress
    elements = scenes.pipe(concrete=path, size_max=0.016).parameters
    assert elements["layer_viscosity"] == pytest.approx(1.2 * fresh.slip_viscosity / COVERAGE)
    law = {"flow_index": 0.8, "slip_quadratic_viscosity": 100.0}
    thin = scenes.channel(viscosity_factor=2.0, **law).concrete
    assert (thin.flow_index, thin.slip_quadratic_viscosity) == (0.8, 200.0)
    assert scenes.channel(yield_factor=1, viscosity_factor=1).concrete == scenes.channel().concrete
    mix = written(tmp_path, {"density": 2300, "concrete": {"yield_stress": 40, "viscosity": 25}},
                  flow={"yield_factor": 2})  # fmt: skip
    assert scenes.tube(concrete=mix).concrete.yield_stress == 80.0
    for given, says in (({"yield_factor": 0.0}, "yield_factor = 0.0: must be"),
                        ({"viscosity_factor": 2e3}, "viscosity_factor = 2000.0: is impossible")):  # fmt: skip
        with pytest.raises(SceneError, match=says):
            scenes.tube(**given)


def test_factors_of_age_and_temperature_have_a_source(tmp_path, capsys):
    """The answers of mix and line state the source of the factors; factors without a source give a warning."""
    path, again = tmp_path / "old.yaml", tmp_path / "again.yaml"
    head = "mix: {density: 2350, slump: 180 mm}\nflow: {viscosity_factor: 1.2"
    path.write_text(head + ", factor_source: cone after\n  60 min}\n", encoding="utf-8")
    again.write_text("base: old.yaml\n", encoding="utf-8")
    words = "which multiply yield stresses by 1 and viscosities by 1.2 (source: cone after 60 min)"
    line = ["line", "--diameter", "125mm", "--length", "100m", "--flow", "30m3/h", "--concrete"]
    with warnings.catch_warnings():
        warnings.simplefilter("error", PlausibilityWarning)
        assert concrete(str(again)).factor_source == concrete(str(path)).factor_source == "cone after 60 min"
        for asked in (["mix", str(path)], [*line, str(path)], [*line, str(again)]):
            done = CliRunner().invoke(cli, asked)
            assert done.exit_code == 0 and words in done.output, done.output
        assert "factors" not in CliRunner().invoke(cli, [*line, "no1"]).output
    assert CliRunner().invoke(cli, ["mix", str(path), "--out", str(tmp_path / "new.yaml")]).exit_code == 0
    assert words in concrete(str(tmp_path / "new.yaml")).source
    path.write_text(head + "}\n", encoding="utf-8")
    with pytest.warns(PlausibilityWarning, match="old: viscosity_factor without a source; state where"):
        assert "(no source stated)" in read_mix(path).remarks[-1]
    path.write_text(head + ", factor_source: [1, 2]}\n", encoding="utf-8")
    with pytest.raises(SceneError, match=r"factor_source = \[1, 2\]: must be a text"):
        read_mix(path)


def test_factors_of_a_base_keep_their_source(tmp_path):
    """Along a chain of bases, each factor keeps its own source; a base's factors also hold for a mix of one's own."""
    flows = {
        "a": {"yield_factor": 1.5, "factor_source": "cone"},
        "b": {"viscosity_factor": 1.2, "factor_source": "rheometer"},
        "c": {"yield_factor": 2, "factor_source": "vane"}, "d": {"yield_factor": 3}, "e": {"factor_source": "nobody"},
    }  # fmt: skip
    for name, flow in flows.items():
        base = {"a": "no1", "e": "b.yaml"}.get(name, f"{chr(ord(name) - 1)}.yaml")
        (tmp_path / f"{name}.yaml").write_text(yaml_text({"base": base, "flow": flow}), encoding="utf-8")

    def source(name):
        return concrete(str(tmp_path / f"{name}.yaml")).factor_source

    assert source("a") == "cone" and source("b") == "yield_factor: cone; viscosity_factor: rheometer"
    assert source("c") == "yield_factor: vane; viscosity_factor: rheometer"
    with pytest.warns(PlausibilityWarning, match="concrete d: yield_factor without a source"):
        assert source("d") == "viscosity_factor: rheometer"
    with pytest.warns(PlausibilityWarning, match="concrete e: factor_source has no effect, because"):
        assert source("e") == source("b")
    path = tmp_path / "own.yaml"
    path.write_text("base: b.yaml\nmix: {density: 2350, slump: 180 mm}\n", encoding="utf-8")
    mix = read_mix(path)
    assert mix.factors == (1.5, 1.2) and source("b") in mix.remarks[-1]
    assert scenes.tube(concrete=path).concrete.yield_stress == 1.5 * mix["yield stress"].value


def test_a_dosage_per_hundred_pounds_of_cement_is_an_amount_per_cubic_yard(tmp_path):
    """With 500 lb of cement and 100 lb of fly ash in a cubic yard, 4 oz/cwt are 24 oz/yd3, and limestone counts not."""
    parts = {"cement": "500 lb/yd3", "fly ash": "100 lb/yd3", "limestone powder": "100 lb/yd3", "water": "33 gal/yd3",
             "sand": "1300 lb/yd3", "stone": "1750 lb/yd3"}  # fmt: skip
    plain, *others = (mix_of({"parts": parts | {"water reducer": dose}, "slump": "5 in"}) for dose in (
        "24 oz/yd3", "4 oz/cwt", "4 fl. oz. / cwt", "4 fl oz per cwt", "4 oz/100 lb", "4 oz. per 100 lbs",
        f"{4 * GALLON / 128 / POUND * 1e6:.5f} ml/100 kg"))  # fmt: skip
    for own in others:
        assert own.given.parts == pytest.approx(plain.given.parts, rel=1e-6)
    wrong = parts | {"fly ash": "100 lbs/acre", "water reducer": "4 oz/cwt"}
    path = written(tmp_path, {"slump": "5 in", "parts": wrong})
    line = next(k for k, text in enumerate(path.read_text(encoding="utf-8").splitlines(), 1) if "acre" in text)
    with pytest.raises(SceneError, match=rf"^{path.name}, line {line}: mix parts: fly ash = '100 lbs/acre'"):
        read_mix(path)
    for dose, of, unit in (("250 ml/100 kg", "kg", "ml/m3"), ("0.8 kg/100 kg", "kg", "kg/m3"),
                           ("800 g per 100 kg", "kg", "g/m3"), ("0.5 lb/cwt", "lb", "lb/yd3"),
                           ("4 fl. oz. / cwt", "lb", "oz/yd3"), ("4oz/cwt", "lb", "oz/yd3")):  # fmt: skip
        with pytest.raises(SceneError, match=rf"'{dose}': is an amount per 100 {of} of cement, but .* write {unit}$"):
            mix_of({"parts": {"water reducer": dose}, "slump": "5 in"})
    load = {name: text.replace("/yd3", "") for name, text in parts.items()} | {"water reducer": "4 fl oz/cwt"}
    loaded = mix_of({"volume": "1 yd3", "parts": load, "slump": "5 in"})
    assert loaded.given.parts == pytest.approx(plain.given.parts)


@pytest.mark.parametrize("text", ["mix: {density: 2350, factors: 2}\n", "base: no1\nyield_factor: 2\n"])
def test_factors_outside_the_section_flow_are_refused_with_an_example(tmp_path, text):
    (tmp_path / "a.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(SceneError, match=r"belong to the section 'flow' of the concrete's file: 'flow: \{yield_fac"):
        read_mix(tmp_path / "a.yaml")


@pytest.mark.parametrize(
    ("stones", "low", "high"),
    [
        (STONES, 0.004, 0.016),
        ({"aggregate": "36 %", "sizes": "#57"}, 0.00475, 0.025),
        ({"aggregate": "36 %", "sizes": ["5 mm", "20 mm"]}, 0.005, 0.02),
        ({"aggregate": "36 %", "sizes": "20 mm"}, 0.004, 0.02),
    ],
)
@pytest.mark.parametrize(("stress", "law"), [(60, "mortar"), (900, "plastic")])
def test_the_command_that_simulates_a_cone_has_the_constants_and_stones_of_the_mix(
    tmp_path, stones, low, high, stress, law
):
    """Concrete with the yield stress of 900 Pa would not slump under the law for mortar."""
    constants = {"yield_stress": stress, "viscosity": "40 Pa s", "uncertainty": "10 %"}
    path = written(tmp_path, {"density": 2300, "concrete": constants} | stones)
    output = CliRunner().invoke(cli, ["mix", str(path)]).output
    command = (
        f"warpcrete run slump --method dem --law {law} --bulk-density 2300 --yield-stress {stress} --viscosity 40 "
    )
    assert f"{command}--size-min {low:g} --size-max {high:g}\n" in output
