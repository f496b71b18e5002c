"""A concrete described as a mix: what follows from it against known answers, what a paper has, and what is refused."""

import math

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from warpcrete import SceneError, Simulation, scenes
from warpcrete.cli.main import cli
from warpcrete.core.errors import PlausibilityWarning
from warpcrete.core.inputs.concretes import concrete
from warpcrete.core.inputs.yaml_files import yaml_text
from warpcrete.core.units import number
from warpcrete.dem.scene.concretes import COVERAGE
from warpcrete.mix.ingredients import is_plasticizer, is_thickener, paste_volumes
from warpcrete.mix.mix import completed, mix_of, read_mix
from warpcrete.mps.common.mixes import concrete_of
from warpcrete.studies.lines.losses import line_of
from warpcrete.studies.lines.run import run_line
from warpcrete.theory.bands import combined
from warpcrete.theory.fits import straight_line
from warpcrete.theory.inverse import (
    BASE,
    HEIGHT,
    SPREADS,
    TOP,
    VOLUME,
    viscosity_of_t500,
    viscosity_of_t500_sedran,
    yield_of_heap,
    yield_of_long_heap,
    yield_of_slump,
    yield_of_slump_measured,
)
from warpcrete.theory.pipe import CONCRETES, Concrete, Line, steady
from warpcrete.theory.suspension import mortar_of, thickening
from warpcrete.theory.vessels import heap_at_rest, long_heap_spread, tall_cone_slump

SPREADING = {"density": "2300 kg/m3", "spread": "600 mm", "t500": "4 s"}
STONES = {"aggregate": "36 %", "sieve": {4: 0, 8: 0.4, 16: 1}, "shape": "crushed"}
BULK = {"density": 2300, "concrete": {"yield_stress": 60, "viscosity": "40 Pa s", "uncertainty": "10 %"}}


LOAD = {"cement": 573, "fly ash": 101, "water": 295, "sand": 1315, "gravel": 1702}
"""Ingredients of a cubic yard [lb]."""


def test_the_largest_stone_alone_suffices(tmp_path):
    """The smallest is then that which the option --stone of `warpcrete line` assumes."""
    given = mix_of(SPREADING | {"sizes": "20 mm"}).given
    assert given.sizes == (0.004, 0.02) == mix_of(SPREADING | {"sizes": ["4 mm", "20 mm"]}).given.sizes
    with pytest.raises(SceneError, match=r"largest of mix sizes = 0\.006: must be in \[0\.008, 0\.3\] m"):
        mix_of(SPREADING | {"sizes": "6 mm"})
    for name in ("stone", "largest_stone"):
        with pytest.raises(SceneError, match=rf"mix key = '{name}': is the entry 'sizes' of a mix; write 'sizes: 20 m"):
            mix_of(SPREADING | {name: "20 mm"})
    for value in (None, {"a": 1}, [5, 20], "coarse"):
        with pytest.raises(SceneError, match=r"is the entry 'sizes' of a mix; write 'sizes: 20 mm'"):
            mix_of({"density": 2350, "stone": value})


def test_the_sieve_curve_that_a_warning_suggests_is_accepted(tmp_path):
    with pytest.warns(PlausibilityWarning, match="has no sieve curve") as caught:
        scenes.pipe(concrete=str(written(tmp_path, SPREADING)))
    text = next(str(each.message) for each in caught if "sieve curve" in str(each.message))
    entry = yaml.safe_load(text.split("in a mix '")[1].split("'")[0])
    assert mix_of(SPREADING | entry).given.largest == 0.016
    assert "sizes='4:0,8:0.4,16:1'" in text and scenes.pipe(sizes="4:0,8:0.4,16:1")


@pytest.mark.parametrize("unit", ["lb/yd3", "lbs/yd3", "lbs/cy", "pcy"])
@pytest.mark.parametrize("admixture", ["HRWR", "high-range water reducer", "superplasticizer", "WRDA 64"])
def test_names_and_units_of_an_american_ticket(unit, admixture):
    parts = {name: f"{mass} {unit}" for name, mass in LOAD.items()} | {admixture: "80 oz/yd3"}
    given = mix_of({"parts": parts, "slump": "8 in"}).given
    assert given.parts["cement"] == pytest.approx(573 * 0.5932764, rel=1e-6)
    assert given.parts[admixture] == pytest.approx(1100 * 80 * 3.86807e-5, rel=1e-4)
    assert given.plasticizer and not given.thickener
    assert given.water_binder == pytest.approx(295 / 674)


def test_a_reducer_of_other_things_than_water_is_no_plasticizer():
    assert not is_plasticizer("shrinkage reducer") and not is_plasticizer("viscosity reducer")


def written(folder, section, name="mix.yaml", **more):
    path = folder / name
    path.write_text(yaml_text({"mix": section, **more}), encoding="utf-8")
    return path


@pytest.mark.parametrize("stress", [8.0, 50.0, 200.0])
def test_a_spread_tells_the_yield_stress_that_made_it(stress):
    assert yield_of_heap(2 * heap_at_rest(VOLUME, stress, 2300.0)[0], 2300.0) == pytest.approx(stress, rel=1e-9)
    assert yield_of_long_heap(long_heap_spread(VOLUME, stress, 2300.0), 2300.0) == pytest.approx(stress, rel=1e-12)
    found = mix_of({"density": 2300, "spread": 2 * heap_at_rest(VOLUME, stress, 2300.0)[0]})["yield stress"]
    assert found.value == pytest.approx(stress, rel=1e-9) and found.low < stress < found.high


@pytest.mark.parametrize("bears", [math.sqrt(3), 2.0])
@pytest.mark.parametrize("stress", [200.0, 900.0])
def test_a_slump_tells_the_yield_stress_that_made_it(stress, bears):
    slump = tall_cone_slump(TOP, BASE, HEIGHT, stress, 2300.0, bears=bears)
    assert yield_of_slump(slump, 2300.0, bears) == pytest.approx(stress, rel=1e-6)


def test_what_was_measured_of_slumps():
    """Ferraris & de Larrard 1998 by hand: 2400 x 12 / 34.7 + 212."""
    assert yield_of_slump_measured(0.18, 2400.0) == pytest.approx(1041.97, abs=0.01)
    found = mix_of({"density": 2400, "slump": "18 cm"})["yield stress"]
    assert found.low < yield_of_slump(0.18, 2400.0, 2.0) < found.value < 1041.97 < found.high


def test_t500_against_a_fluid_without_yield_stress_and_against_sedran():
    """Widest spreads come near Huppert's viscous heap about an axis, and every one is below what a rheometer had."""
    huppert = 3 * 0.25**8 / (0.894**8 * VOLUME**3)  # time times rho g / viscosity at a radius of 250 mm
    assert viscosity_of_t500(1.0, 1.2, 2300.0) * huppert / (2300 * 9.81) == pytest.approx(0.85, abs=0.01)
    assert viscosity_of_t500_sedran(3.0, 0.65, 2300.0) == pytest.approx(98.2, abs=0.1)  # by hand
    for spread in SPREADS[1:]:
        ratio = viscosity_of_t500_sedran(1.0, spread, 2300.0) / viscosity_of_t500(1.0, spread, 2300.0)
        assert 1.3 < ratio < 2.2


@pytest.mark.thorough
def test_t500_of_a_simulated_cone_tells_its_viscosity(device):
    """A third of the viscosity and another yield stress than the relation was measured with."""
    scene = scenes.slump(concrete="own", density=2300.0, viscosity=100.0, yield_stress=27.0, spacing=12.5e-3,
                         lift_time=1.0, duration=6.0)  # fmt: skip
    t500 = number(Simulation(scene, device=device).run().result["t500"])
    spread = 2 * heap_at_rest(VOLUME, 27.0, 2300.0)[0]
    assert viscosity_of_t500(t500, spread, 2300.0) == pytest.approx(100.0, rel=0.1)
    found = mix_of({"density": 2300, "spread": spread, "t500": t500})["viscosity"]
    assert found.low < 100 < found.high


def test_aggregate_thickens_by_its_limits():
    """Nothing of nothing; Einstein's 2.5 at first; without bound at the densest packing; Chateau's root."""
    assert thickening(0.0, 2.5, 0.6) == (1.0, 1.0)
    viscosity, stress = thickening(1e-6, 2.5, 0.6)
    assert (viscosity - 1) / 1e-6 == pytest.approx(2.5, rel=2e-5)
    assert (stress - 1) / 1e-6 == pytest.approx(0.75, rel=1e-5)
    assert thickening(0.6 - 1e-9, 2.5, 0.6)[0] > 1e12
    viscosity, stress = thickening(0.3, 2.5, 0.6)
    assert viscosity == pytest.approx(2 * math.sqrt(2)) and stress == pytest.approx(math.sqrt(0.7 * viscosity))
    with pytest.raises(SceneError, match="aggregate fraction"):
        thickening(0.6, 2.5, 0.6)


def test_mortar_and_back():
    """A mortar's mix has the constants of which mortar_of finds that mortar again."""
    mortar = {"yield_stress": 20, "viscosity": "8 Pa s", "uncertainty": 0}
    mix = mix_of({"density": 2350, "aggregate": "340 l/m3", "aggregate_density": 2700, "mortar": mortar})
    back = mortar_of(mix.concrete, 0.34, 2700.0)
    assert (back.viscosity, back.yield_stress) == (pytest.approx(8.0), pytest.approx(20.0))
    assert mix["mortar's density"].value == pytest.approx(back.density)
    other = mix_of({"density": 2350, "aggregate": "34 %", "aggregate_density": 2700,
                    "concrete": {"yield_stress": back.yield_stress * thickening(0.34, 2.5, 0.6)[1],
                                 "viscosity": mix.concrete.viscosity}})  # fmt: skip
    assert other["mortar's viscosity"].value == pytest.approx(8.0)
    assert mix["viscosity"].low == pytest.approx(8 * thickening(0.34, 2.5, 0.65)[0])
    assert mix["viscosity"].high == pytest.approx(8 * thickening(0.34, 3.25, 0.57)[0])


def test_as_much_aggregate_as_there_can_be():
    """Short of packing every end of the band is finite."""
    mix = mix_of({"density": 2500, "aggregate": 0.569, "mortar": {"yield_stress": 20, "viscosity": 8}})
    assert mix["viscosity"].value < mix["viscosity"].high < 1e8


def test_a_line_through_points_and_its_errors():
    random = np.random.default_rng(3)
    x = np.linspace(1, 9, 8)
    y = 5 + 3 * x + random.normal(size=8)
    fit = straight_line(x, y)
    best, covariance = np.polyfit(x, y, 1, cov=True)
    assert (fit.slope, fit.offset) == (pytest.approx(best[0]), pytest.approx(best[1]))
    assert (fit.slope_error, fit.offset_error) == tuple(pytest.approx(e) for e in np.sqrt(np.diag(covariance)))
    assert math.isnan(straight_line([1, 2], [1, 2]).slope_error)


def test_a_layer_from_points_of_a_pipe(tmp_path):
    """Those that a known layer gives, with and without scatter: it comes back, inside its band."""
    known = Concrete(name="known", density=2300, viscosity=40, yield_stress=60, slip_viscosity=640, slip_yield=30)
    line = Line(radius=0.0625, length=12.0, rise=0.25)
    flows = np.array([10, 20, 30, 40]) / 3600
    pressures = np.array([steady(known, line, q).pressure for q in flows])
    section = BULK | {"layer": {"points": "points.csv", "diameter": "125 mm", "length": "12 m", "rise": "3 m"}}

    def fitted(pressures):
        rows = "\n".join(f"{3600 * q!r},{p / 1e5!r}" for q, p in zip(flows.tolist(), pressures.tolist()))
        (tmp_path / "points.csv").write_text(f"flow [m3/h],pressure [bar]\n{rows}\n", encoding="utf-8")
        return read_mix(written(tmp_path, section))

    exact = fitted(pressures)
    assert exact["slip viscosity"].value == pytest.approx(640, rel=1e-6)
    assert exact["slip yield"].value == pytest.approx(30, rel=1e-5)
    assert exact["slip viscosity"].high == pytest.approx(1.3 * 640) and exact["slip yield"].low == pytest.approx(
        30 / 1.3
    )
    rough = fitted(pressures * [1.01, 0.99, 1.01, 0.99])
    eta = rough["slip viscosity"]
    assert eta.low < 640 < eta.high == pytest.approx(1.3 * eta.value)
    rougher = fitted(pressures * [1.04, 0.96, 1.04, 0.96])["slip viscosity"]
    assert rougher.low < 640 < rougher.high and rougher.high > 1.5 * rougher.value


def test_points_of_tribometer_and_viscometer():
    mix = mix_of({"density": 2300, "viscometer": [[2, 140], [5, 260], ["10 1/s", "0.46 kPa"]],
                  "layer": {"tribometer": [["10 cm/s", 110], [0.3, 290]]}})  # fmt: skip
    assert [mix[name].value for name in ("viscosity", "yield stress", "slip viscosity", "slip yield")] == pytest.approx(
        [40, 60, 900, 20])  # fmt: skip
    assert "a tribometer differs from pipes" in mix["slip yield"].source
    assert (mix["slip viscosity"].low, mix["slip viscosity"].high) == pytest.approx((0.3 * 900, 2 * 900))


@pytest.mark.parametrize(("stresses", "student"), [((100, 141, 178), 12.706), ((100, 141, 178, 220), 4.303)])
def test_a_line_through_several_points_has_the_interval_of_student(stresses, student):
    """The standard error of a slope times the quantile for as many degrees of freedom as there are points less two."""
    rate, stress = np.arange(1.0, 1 + len(stresses)), np.array(stresses)
    slope, offset = np.polyfit(rate, stress, 1)
    variance = np.sum((stress - slope * rate - offset) ** 2) / (len(rate) - 2)
    error = math.sqrt(variance / np.sum((rate - rate.mean()) ** 2))
    found = mix_of({"density": 2300, "viscometer": np.transpose([rate, stress]).tolist()})["viscosity"]
    assert found.value == pytest.approx(slope) and found.high - slope == pytest.approx(student * error, rel=2e-3)


def test_an_ingredient_that_may_be_powder_leaves_the_paste_unknown():
    """A US name of cement is known; under another name 330 kg of it would be missing in the paste."""
    parts = {"water": "33 gal/yd3", "fly ash": "141 lb/yd3", "sand": "1420 lb/yd3", "gravel": "1780 lb/yd3"}
    named = mix_of({"parts": parts | {"Type I/II": "564 lb/yd3"}, "slump": "6 in"})
    assert named["slip viscosity"].value == mix_of({"parts": parts | {"cement": "564 lb/yd3"}, "slump": "6 in"})[
        "slip viscosity"].value  # fmt: skip
    with pytest.warns(PlausibilityWarning, match="counts neither as powder nor as stone"):
        unknown = mix_of({"parts": parts | {"CX-7": "564 lb/yd3"}, "slump": "6 in"})
    assert unknown["slip viscosity"].way.startswith("slump")


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("crushed limestone", "stone"), ("limestone 8/16", "stone"), ("limestone 4-16 mm", "stone"),
        ("limestone powder", "powder"), ("limestone", "powder"), ("limestone sand", "stone"),
        ("crushed quartz", "stone"), ("Type I/II cement", "powder"), ("Type I/II", "powder"),
        ("limestone 0/0.063 mm", "powder"), ("expansive agent", "powder"),
        ("viscosity-modifying admixture", "liquid"), ("anti-washout agent", "liquid"),
    ],
)  # fmt: skip
def test_words_of_an_ingredient_say_what_it_is(name, kind):
    """The paste of 300 kg of cement and 180 kg of water grows by what belongs to it, and by nothing else."""
    alone, more = paste_volumes({"cement": 300, "water": 180}), paste_volumes({"cement": 300, "water": 180, name: 100})
    powder, liquid = more[0] - alone[0], more[1] - alone[1]
    assert (powder > 1e-6, liquid > 1e-6) == (kind == "powder", kind == "liquid")


def test_a_hydration_stabilizer_thickens_nothing():
    assert is_thickener("viscosity-modifying admixture") and is_thickener("VMA") and is_thickener("stabilizer")
    assert not is_thickener("hydration stabilizer") and not is_thickener("viscosity-reducing admixture")
    assert not is_thickener("retarder") and not is_thickener("superplasticizer")


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


def test_ounces_of_admixture_are_fluid_ounces():
    load = {"volume": "1 yd3", "parts": {"cement": "564 lb", "water": "33 gal", "sand": "1420 lb", "gravel": "1780 lb"}}
    with_ounces = dict(load, parts=load["parts"] | {"water reducer admixture": "20 oz"})
    more = mix_of(with_ounces | {"slump": "6 in"})["density"].value - mix_of(load | {"slump": "6 in"})["density"].value
    assert more == pytest.approx(20 * 29.5735e-6 * 1100 / 0.764555, rel=1e-5)


def test_the_viscosity_is_a_guess_if_nothing_tells_it():
    assert mix_of({"density": 2300, "slump": "100 mm"})["viscosity"].way.startswith("assumption")


def test_a_mix_of_the_literature_beside_what_it_published():
    """Xu, Li & Jiang 2021: pressure of their case 9.40 kPa, mortar 2190 kg/m3 (Table 4), all of no1's constants."""
    mix = read_mix("xu-no1")
    assert mix.concrete == Concrete(name="xu-no1", **concrete("no1").flow)
    assert mix.given.share == 946 / 2630
    assert steady(mix.concrete, Line(), 1500e-6, "paper").pressure == pytest.approx(9400, rel=0.005)
    assert mix["mortar's density"].value == pytest.approx(2190, rel=0.005)
    low, high = (steady(each, Line(), 1500e-6, "paper").pressure for each in mix.variants["slip layer"])
    assert low < 9400 < high


@pytest.mark.parametrize(("name", "slump"), [("no1", 130), ("no2", 180), ("no3", 220)])
def test_slumps_of_the_literature_fit_the_rheometer(name, slump):
    """The rheometer of Xu, Li & Jiang 2021 reads less than a homogeneous cone implies, within the slump's band."""
    own = CONCRETES[name]
    section = {"density": own.density, "slump": f"{slump} mm"}
    both = mix_of(section | {"concrete": {"yield_stress": own.yield_stress, "viscosity": own.viscosity}})
    assert both["yield stress"].value == own.yield_stress and not any("sieve" not in each for each in both.remarks)
    alone = mix_of(section)["yield stress"]
    assert alone.low < own.yield_stress < alone.value


def test_a_rheometer_may_read_five_times_the_yield_stress_of_a_heap():
    """The band of a measured yield stress reaches down to a fifth, unless its uncertainty is stated."""
    section = {"density": 2350, "concrete": {"yield_stress": "900 Pa", "viscosity": "60 Pa s"}}
    found = mix_of(section)["yield stress"]
    assert (found.low, found.value, found.high) == pytest.approx((180, 900, 1080)) and "slumps" in found.source
    viscosity = mix_of(section)["viscosity"]
    assert (viscosity.low, viscosity.high) == pytest.approx((48, 72))
    section["concrete"]["uncertainty"] = "10 %"
    stated = mix_of(section)["yield stress"]
    assert (stated.low, stated.high) == pytest.approx((810, 990)) and stated.source == "as given"


def test_a_small_volume_with_a_trade_name_is_a_liquid_admixture():
    """39 fluid ounces in a cubic yard are 1.51 l/m3, which have 1100 kg/m3."""
    parts = {"cement": 340, "water": 170, "sand": 800, "gravel": 1050}
    with pytest.warns(PlausibilityWarning, match="'MasterGlenium 7920' is not a known ingredient"):
        named = mix_of({"parts": parts | {"MasterGlenium 7920": "39 oz/yd3"}, "slump": "180 mm"})
    plain = mix_of({"parts": parts | {"superplasticizer": "39 oz/yd3"}, "slump": "180 mm"})
    assert named["density"].value == pytest.approx(plain["density"].value)
    assert named["slip viscosity"].value == pytest.approx(plain["slip viscosity"].value, rel=0.02)


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
    assert mix._repr_html_().count("<tr>") == len(mix.rows()) + 1 == len(mix.table().splitlines())
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
    assert "largest_stone = 0.13: does not pass through part 1" in str(
        CliRunner().invoke(cli, ["line", str(site)]).exception
    )


def test_theory_says_how_far_a_fit_is_off(tmp_path):
    """Of a concrete that is not sheared, so that stress over mean velocity is the straight line."""
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


@pytest.mark.parametrize(
    ("section", "says"),
    [
        ({}, "mix = {}: is empty"),
        ({"density": 2350, "W/C": 0.45}, "mix key = 'W/C': is the entry 'water_binder' of a mix; write 'water_"),
        ({"parts": {"cement CEM II 42": None, "5 R": 340, "water": 170}}, "has no amount; a comma inside braces"),
        ({"slump flow": "26 in"}, "mix key = 'slump flow': is the entry 'spread' of a mix; write 'spread: 26 in'"),
        ({"parts": {"cement": 340, "water": 170, "Sikka 12": "30 l/m3"}}, "is a volume, which is accepted for water"),
        ({"volume": "8 yd3", "parts": {"cement": "4,794 lb", "water": "265 lb"}, "slump": "5 in"},
         "cement = '4,794 lb': must be a number with one of kg, t, g, lb for the whole load"),
        (["density"], "mix = ['density']: must consist of 'key: value' lines"),
        (SPREADING | {"density": "1e400 kg/m3"}, "mix density = '1e400 kg/m3': must be a number"),
        ({"density": 2300}, "mix = 'density': does not determine the yield stress of the concrete"),
        ({"spread": 0.6}, "mix density: is missing, and the mix lists no 'parts'"),
        ({"densty": 2300}, "mix key = 'densty': must be one of density"),
        (SPREADING | {"density": 2.3},
         "mix density = 2.3: must be in [1000, 5000] kg/m3; write units other than kg/m3 behind the"),
        (SPREADING | {"density": "2300 kg/cm3"}, "mix density = '2300 kg/cm3': must be a number with one of kg/m3"),
        (SPREADING | {"spread": "60 mn"}, "mix spread = '60 mn': must be a number with one of m, mm, cm"),
        (SPREADING | {"spread": 600}, "mix spread = 600.0: must be in [0.35, 1.2] m"),
        (SPREADING | {"spread": 0.45}, "mix t500 = '4 s': needs a final spread of 500 mm or more"),
        ({"density": 2300, "t500": 3}, "mix t500 = 3: needs a final spread"),
        ({"density": 2300, "slump": "29.5 cm"},
         "mix slump = 0.295: must be in [0.01, 0.29] m; write the unit, as in '180 mm', and give 'spread'"),
        ({"density": 2300, "slump": "50 mm", "spread": "700 mm"}, "contradicts"),
        ({"parts": {"cement": 320, "420 lb/yd3": None}, "slump": 0.15},
         "mix parts = '420 lb/yd3': is an amount without a name; a comma inside braces separates entries"),
        ({"parts": {"cement": 420, "water": 20, "sand": 900, "gravel": 1060}, "slump": 0.15},
         "mix parts = '20 kg/m3 of water': is too little for the powder"),
        (SPREADING | {"aggregate": 0.7}, "mix aggregate = 0.7: is 0.7 of the volume, more than the share 0.57"),
        (SPREADING | {"aggregate": "57 %"}, "is 0.57 of the volume, more than the share 0.57 that"),
        (SPREADING | {"aggregate": 950}, "mix aggregate = 950: must be a share of the volume, below 1, or"),
        (SPREADING | {"aggregate": "1900 kg/m3"}, "is 0.717 of the volume, more than the share 0.57"),
        (SPREADING | {"aggregate": "0.4", "density": 1700}, "mix density = 1700.0: leaves 1067 kg/m3 for the density"),
        (SPREADING | {"parts": {"cement": 300, "water": 200}}, "= 2300.0: contradicts 'parts', which add up to 500"),
        (SPREADING | {"sieve": {4: 0, 8: 0.6, 12: 0.5, 16: 1}}, "falls from 0.6 at 8 mm to 0.5 at 12 mm"),
        (SPREADING | {"sieve": {4: 0.1, 16: 1}}, "must rise from 0 to 1"),
        (SPREADING | {"sieve": {0.063: 0, 4: 0.4, 16: 1}}, "begins below 1 mm, but sand belongs to the mortar"),
        (SPREADING | {"sieve": {16: 0, 4: 1}}, "must have increasing openings above 0"),
        (SPREADING | {"sieve": {4: 0, 16: 1}, "sizes": [0.004, 0.016]}, "is given together with 'sieve'"),
        (SPREADING | {"sizes": [5, 20]}, "largest of mix sizes = 20.0: must be in [0.001, 0.3] m; write"),
        (SPREADING | {"shape": "pointy"}, "mix shape = 'pointy': must be one of spheres, round"),
        (SPREADING | {"mortar": {"viscosity": 9}}, "needs the share of coarse aggregate in the concrete"),
        (BULK | {"aggregate": 0.36, "mortar": {"viscosity": "40 Pa s", "uncertainty": 0.1}},
         "mix viscosity = '40 (36 to 44) Pa s from concrete': contradicts 158 (134 to 280) Pa s from mortar"),
        (BULK | {"aggregate": 0.3, "mortar": {"density": 2600}}, "but the density of the mortar is given as 2600"),
        (BULK | {"concrete": {"viscosity": "40 Pa.m"}}, "mix concrete: viscosity = '40 Pa.m': must be a number"),
        (BULK | {"concrete": {"viscosity": 40, "yeild_stress": 6}}, "mix concrete: key = 'yeild_stress'"),
        (BULK | {"layer": {"viscosity": 900}}, "must have 'yield_stress' and 'viscosity', or 'points', or"),
        (BULK | {"layer": {"points": "none.csv", "diameter": 0.1, "length": 1}}, "none.csv': cannot be read"),
        (BULK | {"layer": {"points": "points.csv", "length": 1}}, "mix layer: diameter = None: must be the diameter"),
        (BULK | {"layer": {"tribometer": [[0.1, 50]]}}, "must have two or more different values"),
        (BULK | {"layer": {"tribometer": [[-0.1, 50], [0.2, 90]]}}, "must be 0 or more"),
        (BULK | {"layer": {"tribometer": [[0.1, 50], [0.2, -90]]}}, "must be 0 or more"),
        (BULK | {"layer": {"tribometer": [[0.1, 50], [0.3, 40]]}},
         "mix slip viscosity = -50.0: follows from a straight line"),
        (BULK | {"concrete": {"yield_stress": 500}, "spread": "700 mm"},
         "contradicts 19.3 (17 to 26.7) Pa from spread of 700 mm; leave out"),
    ],
)  # fmt: skip
def test_contradictory_and_empty_mixes_are_refused_in_one_line(tmp_path, section, says):
    path = written(tmp_path, section)
    for make in (scenes.tube, scenes.pipe):
        with pytest.raises(SceneError) as refused:
            make(concrete=path)
        assert says in str(refused.value) and "\n" not in str(refused.value)
    done = CliRunner().invoke(cli, ["mix", str(path), "--out", str(tmp_path / "plain.yaml")])
    assert isinstance(done.exception, SceneError) and not (tmp_path / "plain.yaml").exists()


# Other flow laws.


def test_a_mix_states_another_law(tmp_path):
    """A file, its record and all flows have the law; the share of aggregate scales it to that of the mortar."""
    section = {"density": 2300, "aggregate": "36 %",
               "concrete": {"yield_stress": 40, "viscosity": "25 Pa s", "flow_index": 1.3},
               "layer": {"yield_stress": 10, "viscosity": 700, "quadratic_viscosity": "300 Pa s2/m2"}}  # fmt: skip
    path = written(tmp_path, section)
    mix = read_mix(path)
    assert mix["flow index"].value == 1.3 and mix["slip quadratic viscosity"].unit == "Pa s2/m2"
    assert mix.concrete.flow_index == 1.3 and mix.concrete.slip_quadratic_viscosity == 300.0
    assert "flow index" in mix.table()
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
    assert done.exit_code == 0 and "elements have a linear slip layer only" in done.output
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
        with pytest.raises(SceneError, match=r"slip_flow_index = 0\.8: describes a slip layer that discrete elements"):
            scenes.pipe(concrete=path)
    path.write_text(f"base: no1\nflow: {{slip_flow_index: 0.8}}\n{section}", encoding="utf-8")
    assert scenes.pipe(concrete=path).parameters["layer_viscosity"] == 900


@pytest.mark.parametrize(
    ("section", "says"),
    [
        ({"concrete": {"yield_stress": 40, "flow_index": 1.3}}, "mix viscosity = None: must be stated beside a flow"),
        ({"viscometer": [[2, 140], [5, 260]], "concrete": {"flow_index": 1.3}}, "mix viscosity = None: must be stated"),
        ({"concrete": {"yield_stress": 40, "viscosity": 25, "flow_index": 9}}, "mix concrete: flow_index = 9.0: is"),
        ({"spread": 0.6, "layer": {"flow_index": 0.7}}, "mix layer = {'flow_index': 0.7}: must have 'yield_stress'"),
        ({"concrete": {"yield_stress": 40, "viscosity": 25, "flow_index": 1.2, "quadratic_viscosity": 1}},
         "flow_index = 1.2: cannot be combined with quadratic_viscosity"),
    ],
)  # fmt: skip
def test_laws_that_a_mix_cannot_have(section, says):
    with pytest.raises(SceneError) as caught:
        mix_of({"density": 2300, **section})
    assert str(caught.value).startswith(says) and "\n" not in str(caught.value)


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
