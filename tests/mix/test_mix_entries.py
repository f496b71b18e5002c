"""Entries of a mix: their names and units, what an ingredient is, and what is refused."""

import warnings

import pytest
import yaml
from click.testing import CliRunner
from mixes import BULK, SPREADING, written

from warpcrete import SceneError, scenes
from warpcrete.cli.main import cli
from warpcrete.core.errors import PlausibilityWarning
from warpcrete.mix.ingredients import (
    check_volume,
    density_of,
    is_plasticizer,
    is_thickener,
    paste_volumes,
    sand_and_stone_masses,
)
from warpcrete.mix.mix import mix_of, read_mix
from warpcrete.mix.stones import read_sizes

LOAD = {"cement": 573, "fly ash": 101, "water": 295, "sand": 1315, "gravel": 1702}
"""Ingredients of a cubic yard [lb]."""


def test_the_largest_stone_alone_suffices(tmp_path):
    """The smallest is then that which the option --stone of `warpcrete line` assumes."""
    given = mix_of(SPREADING | {"sizes": "20 mm"}).given
    assert given.sizes == (0.004, 0.02) == mix_of(SPREADING | {"sizes": ["4 mm", "20 mm"]}).given.sizes
    with pytest.raises(SceneError, match=r"largest of mix sizes = '6 mm': must be in \[0\.008, 0\.3\] m"):
        mix_of(SPREADING | {"sizes": "6 mm"})
    for name in ("stone", "largest_stone"):
        with pytest.raises(SceneError, match=rf"mix key = '{name}': is called 'sizes' in a mix; write 'sizes: 20 m"):
            mix_of(SPREADING | {name: "20 mm"})
    other = ((value, "20 mm") for value in (None, {"a": 1}, [5, 20], "coarse", "0.02 mm", 0, 0.75, 2000, -0.02, True))
    same = ((value, "20 mm") for value in (20, "20", 0.02, "0.02", "2e-2", "0,02"))
    for value, size in (*other, *same, (0.0125, "12.5 mm"), (32, "32 mm"), (0.3, "300 mm"), ("3/4 in", "3/4 in")):
        with pytest.raises(SceneError, match=rf"is called 'sizes' in a mix; write 'sizes: {size}'$"):
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


def test_an_ingredient_that_may_be_powder_leaves_the_paste_unknown():
    """A US name of cement is known; under another name 330 kg of it would be missing in the paste."""
    parts = {"water": "33 gal/yd3", "fly ash": "141 lb/yd3", "sand": "1420 lb/yd3", "gravel": "1780 lb/yd3"}
    named = mix_of({"parts": parts | {"Type I/II": "564 lb/yd3"}, "slump": "6 in"})
    assert named["slip viscosity"].value == mix_of({"parts": parts | {"cement": "564 lb/yd3"}, "slump": "6 in"})[
        "slip viscosity"].value  # fmt: skip
    with pytest.warns(PlausibilityWarning, match="is taken neither for powder nor for aggregate"):
        unknown = mix_of({"parts": parts | {"CX-7": "564 lb/yd3"}, "slump": "6 in"})
    assert unknown["slip viscosity"].way.startswith("slump")


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("crushed limestone", "stone"), ("limestone 8/16", "stone"), ("No. 57 limestone", "stone"),
        ("#67", "stone"), ("rock flour", "powder"),
        ("limestone 4-16 mm", "stone"),
        ("limestone powder", "powder"), ("limestone", "powder"), ("limestone sand", "stone"),
        ("crushed quartz", "stone"), ("Type I/II cement", "powder"), ("Type I/II", "powder"),
        ("limestone 0/0.063 mm", "powder"), ("limestone 10-63 um", "powder"), ("expansive agent", "powder"),
        ("viscosity-modifying admixture", "liquid"), ("anti-washout agent", "liquid"),
    ],
)  # fmt: skip
def test_words_of_an_ingredient_say_what_it_is(name, kind):
    """The paste of 300 kg of cement and 180 kg of water grows by what belongs to it, and by nothing else."""
    alone, more = paste_volumes({"cement": 300, "water": 180}), paste_volumes({"cement": 300, "water": 180, name: 100})
    powder, liquid = more[0] - alone[0], more[1] - alone[1]
    assert (powder > 1e-6, liquid > 1e-6) == (kind == "powder", kind == "liquid")


@pytest.mark.parametrize(
    ("name", "density"),
    [
        ("limestone powder", 2700), ("quartz powder", 2700), ("stone powder", 2700), ("crushed limestone powder", 2700),
        ("slag powder", 2900), ("fly ash powder", 2250), ("silica powder", 2250), ("powder", 3100), ("binder", 3100),
        ("Type II", 3100), ("superplasticizer powder", 1100), ("barite sand 0/4", 4200), ("magnetite gravel", 4900),
        ("hematite 8/16", 4900), ("barytes", 4200), ("limestone sand", 2650), ("PP fibres", None),
        ("steel fibres", 7850),
    ],
)  # fmt: skip
def test_the_density_is_that_of_the_kind_of_powder_or_rock(name, density):
    assert density_of(name) == density


@pytest.mark.parametrize(
    ("name", "masses"),
    [
        ("fine gravel 4/8", (0, 1)), ("fine aggregate", (1, 0)), ("coarse sand", (1, 0)), ("granite sand", (1, 0)),
        ("sand and gravel 0/16", (0, 0)), ("barite sand", (1, 0)), ("magnetite stone", (0, 1)), ("barite 0/8", (0, 0)),
    ],
)  # fmt: skip
def test_sand_is_told_from_stones(name, masses):
    """A mixture of both, and heavy rock without either word, leave the share of sand unknown."""
    assert sand_and_stone_masses({name: 1.0}) == masses


@pytest.mark.parametrize(("share", "warned"), [("36 %", False), ("980 kg/m3", False), ("20 %", True), ("50 %", True)])
def test_a_share_of_aggregate_that_contradicts_the_stones_causes_a_warning(share, warned):
    """980 kg of gravel fill 37 % of a cubic metre."""
    parts = {"cement": 330, "fly ash": 60, "water": 175, "sand": 800, "gravel": 980, "superplasticizer": 3}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        mix_of({"parts": parts, "aggregate": share, "slump": "180 mm"})
    assert any("but the stones in 'parts' fill 37 %" in str(each.message) for each in caught) == warned


def test_heavy_concrete_fills_its_volume():
    """350 kg of cement, 175 of water, 1,200 of sand and 1,850 of gravel of barite fill 1.014 m3, by hand."""
    heavy = {"cement": 350, "water": 175, "barite sand": 1200, "barite gravel": 1850}
    by_hand = 350 / 3100 + 175 / 1000 + 3050 / 4200
    assert by_hand == pytest.approx(1.0141, abs=1e-4)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_volume(heavy, 2650.0, None)
    with pytest.warns(PlausibilityWarning, match=f"fill {by_hand + 0.05:.3f} m3 instead of 1 m3, including 5 % of air"):
        check_volume(heavy, 2650.0, 0.05)
    stated = 350 / 3100 + 175 / 1000 + 1200 / 4200 + 1850 / 4700
    with pytest.warns(PlausibilityWarning, match=f"fill {stated + 0.08:.3f} m3 instead of 1 m3, including 8 % of air"):
        check_volume(heavy, 4700.0, 0.08)


def test_a_hydration_stabilizer_thickens_nothing():
    assert is_thickener("viscosity-modifying admixture") and is_thickener("VMA") and is_thickener("stabilizer")
    assert not is_thickener("hydration stabilizer") and not is_thickener("viscosity-reducing admixture")
    assert not is_thickener("retarder") and not is_thickener("superplasticizer")


def test_ounces_of_admixture_are_fluid_ounces():
    load = {"volume": "1 yd3", "parts": {"cement": "564 lb", "water": "33 gal", "sand": "1420 lb", "gravel": "1780 lb"}}
    with_ounces = dict(load, parts=load["parts"] | {"water reducer admixture": "20 oz"})
    more = mix_of(with_ounces | {"slump": "6 in"})["density"].value - mix_of(load | {"slump": "6 in"})["density"].value
    assert more == pytest.approx(20 * 29.5735e-6 * 1100 / 0.764555, rel=1e-5)


def test_a_small_volume_with_a_trade_name_is_a_liquid_admixture():
    """39 fluid ounces in a cubic yard are 1.51 l/m3, which have 1100 kg/m3."""
    parts = {"cement": 340, "water": 170, "sand": 800, "gravel": 1050}
    with pytest.warns(PlausibilityWarning, match="'MasterGlenium 7920' is not a known ingredient"):
        named = mix_of({"parts": parts | {"MasterGlenium 7920": "39 oz/yd3"}, "slump": "180 mm"})
    plain = mix_of({"parts": parts | {"superplasticizer": "39 oz/yd3"}, "slump": "180 mm"})
    assert named["density"].value == pytest.approx(plain["density"].value)
    assert named["slip viscosity"].value == pytest.approx(plain["slip viscosity"].value, rel=0.02)


@pytest.mark.parametrize(
    ("section", "says"),
    [
        ({}, "mix = {}: is empty"),
        ({"density": 2350, "W/C": 0.45}, "mix key = 'W/C': is called 'water_binder' in a mix; write 'water_"),
        ({"parts": {"cement CEM II 42": None, "5 R": 340, "water": 170}}, "has no amount; a comma inside braces"),
        ({"parts": {"cement": 340, "superplasticizer": None}}, "= None: has no amount; state the amount, as"),
        ({"parts": {"cement": 340, "superplasticizer": True}}, "= True: has no amount; state the amount, as"),
        ({"parts": {"cement": 340, "superplasticizer": "yes"}}, "= 'yes': has no amount; state the amount, as"),
        ({"parts": {"cement": 340, "superplasticizer": "0.8 %"}}, "is a percentage, but must be a mass per volume "
         "of concrete; multiply it by the kilograms of cement"),
        ({"density": 2350, "slump": "S4"}, "mix slump = 'S4': is a class of EN 206, with a slump of 160 to 210 mm; "
         "write the measured slump, or the middle of the class, as in 'slump: 185 mm'"),
        ({"density": 2350, "spread": "sf2"}, "with a spread of 660 to 750 mm"),
        ({"density": 2350, "slump": "F5"}, "mix slump = 'F5': is a flow table class"),
        ({"density": 2350, "slump": "120 to 150 mm"}, "is a range, but must be one value"),
        ({"density": 2350, "slump": "5-6 in"}, "is a range, but must be one value"),
        ({"density": 2350, "consistency class": "S3"}, "is called 'slump' in a mix; write 'slump: S3'"),
        ({"density": 2350, "Dmax": 16}, "mix key = 'Dmax': is called 'sizes' in a mix; write 'sizes: 16 mm'"),
        ({"density": 2350, "max. aggregate size": "3/4 in"}, "is called 'sizes' in a mix; write 'sizes: 3/4 in'"),
        ({"parts": {"cement": "6 sacks"}}, "is a number of sacks, but must be a mass per volume of concrete; a US "
         "sack of cement has 94 lb: write '564 lb/yd3'"),
        ({"parts": {"cement": 564, "water": 280, "sand": 1300, "stone": 1800}, "slump": "5 in"},
         "or write units behind the numbers, as in '564 lb/yd3'"),
        ({"parts": {"cement": 340, "sand": 800, "gravel": 1000}, "slump": "5 in"}, "cubic metre, in kg/m3, includ"),
        ({"parts": {"cement": 340, "Total": 2310}}, "mix parts: Total = 2310: is a sum, not an ingredient; remove it"),
        ({"parts": {"cement": 340, "water": 170, "sand": 800, "gravel": 1000, "xyz": 1000}, "slump": "5 in"},
         "contain 1000 kg/m3 of unknown density, for which there is no room, because the other parts fill 0.959 m3 of"),
        ({"parts": {"cement": 340, "air": "2 %"}}, "is the entry 'air' of a mix, not an ingredient; move it out of"),
        ({"parts": {"cement": 340, "w/c": 0.5}}, "is the entry 'water_binder' of a mix, not an ingredient"),
        ({"parts": {"OPC": 340, "water": 170, "FA": 800, "gravel": 1000}, "slump": "5 in"},
         "mix parts = 'FA': is an abbreviation that is not known; write the name"),
        ({"parts": {"cement": 340, "slag": "30 %"}}, "is a percentage, but must be a mass per volume"),
        ({"Sand moisture": "4 %"}, "mix key = 'Sand moisture': is not an entry of a mix; subtract the surface"),
        ({"slump flow": "26 in"}, "mix key = 'slump flow': is called 'spread' in a mix; write 'spread: 26 in'"),
        ({"parts": {"cement": 340, "water": 170, "Sikka 12": "30 l/m3"}}, "is a volume, which is accepted for water"),
        ({"volume": "8 yd3", "parts": {"cement": "4,794 lb", "water": "265 lb"}, "slump": "5 in"},
         "cement = '4,794 lb': must be a number with one of the units kg, t, g, lb for the whole load"),
        (["density"], "mix = ['density']: must consist of 'key: value' lines"),
        (SPREADING | {"density": "1e400 kg/m3"}, "mix density = '1e400 kg/m3': must be a number"),
        ({"parts": {"cement": 400, "water": 180, "sand": 700, "expanded clay 4/8": 420}, "aggregate": "420 kg/m3"},
         "mix aggregate = '420 kg/m3': is a mass, so the density of 'expanded clay 4/8' must be stated; add '"),
        ({"density": 2300, "slump": 0.1, "volume": "9 yd3"}, "mix volume = '9 yd3': has no effect without 'parts'"),
        ({"density": 2300}, "mix = 'density': contains no entry from which the yield stress of"),
        ({"spread": 0.6}, "mix density: must be stated in a mix without 'parts'"),
        ({"densty": 2300}, "mix key = 'densty': must be one of density"),
        (SPREADING | {"density": 2.3},
         "mix density = 2.3: must be in [1000, 5000] kg/m3; write a unit other than kg/m3 behind the"),
        (SPREADING | {"density": "2300 kg/cm3"}, "'2300 kg/cm3': must be a number with one of the units kg/m3"),
        (SPREADING | {"spread": "60 mn"}, "mix spread = '60 mn': must be a number with one of the units m, mm, cm"),
        (SPREADING | {"spread": 600}, "mix spread = 600.0: must be in [0.35, 1.2] m"),
        (SPREADING | {"spread": 0.45}, "mix t500 = '4 s': needs a final spread of 500 mm or more"),
        ({"density": 2300, "t500": 3}, "mix t500 = 3: needs a final spread"),
        ({"density": 2300, "slump": "29.5 cm"},
         "mix slump = '29.5 cm': must be in [0.01, 0.29] m; write the unit, as in '180 mm' or '7 in', and"),
        ({"density": 2300, "slump": "50 mm", "spread": "700 mm"}, "contradicts"),
        ({"parts": {"cement": 320, "420 lb/yd3": None}, "slump": 0.15},
         "mix parts = '420 lb/yd3': is an amount without a name; a comma inside braces separates entries"),
        ({"parts": {"cement": 420, "water": 20, "sand": 900, "gravel": 1060}, "slump": 0.15},
         "mix parts = '20 kg/m3 of water': is too little for the powder"),
        (SPREADING | {"aggregate": 0.7}, "mix aggregate = 0.7: is 0.7 of the volume, more than the share 0.57"),
        (SPREADING | {"aggregate": "57 %"}, "is 0.57 of the volume, more than the share 0.57 that"),
        (SPREADING | {"aggregate": 950}, "mix aggregate = 950: must be a share of the volume below 1, or"),
        (SPREADING | {"aggregate": "1900 kg/m3"}, "is 0.717 of the volume, more than the share 0.57"),
        (SPREADING | {"aggregate": "0.4", "density": 1700}, "mix density = 1700.0: implies a density of the mortar"),
        (SPREADING | {"parts": {"cement": 300, "water": 200}}, "contradicts 'parts', which add up to 500"),
        (SPREADING | {"sieve": {4: 0, 8: 0.6, 12: 0.5, 16: 1}}, "falls from 0.6 at 8 mm to 0.5 at 12 mm"),
        (SPREADING | {"sieve": {4: 0.1, 16: 1}}, "must have shares that rise from 0 to 1"),
        (SPREADING | {"sieve": {0.063: 0, 4: 0.4, 16: 1}}, "begins below 1 mm, but sand is simulated as part of"),
        (SPREADING | {"sieve": {16: 0, 4: 1}}, "must have increasing openings above 0"),
        (SPREADING | {"sieve": {4: 0, 16: 1}, "sizes": [0.004, 0.016]}, "cannot be combined with 'sieve'"),
        (SPREADING | {"sizes": [5, 20]}, "largest of mix sizes = 20.0: must be in [0.001, 0.3] m; write"),
        (SPREADING | {"shape": "pointy"}, "mix shape = 'pointy': must be one of spheres, round"),
        (SPREADING | {"mortar": {"viscosity": 9}}, "needs 'aggregate', the share of coarse aggregate"),
        (BULK | {"aggregate": 0.36, "mortar": {"viscosity": "40 Pa s", "uncertainty": 0.1}},
         "mix viscosity = '40 (36 to 44) Pa s from concrete': contradicts 158 (134 to 280) Pa s from mortar"),
        (BULK | {"aggregate": 0.3, "mortar": {"density": 2600}}, "but the density of the mortar is given as 2600"),
        (BULK | {"concrete": {"viscosity": "40 Pa.m"}}, "mix concrete: viscosity = '40 Pa.m': must be a number"),
        (BULK | {"concrete": {"viscosity": 40, "yeild_stress": 6}}, "mix concrete: key = 'yeild_stress'"),
        (BULK | {"layer": {"viscosity": 900}}, "must have 'yield_stress' and 'viscosity', or 'points', or"),
        (BULK | {"layer": {"points": "none.csv", "diameter": 0.1, "length": 1}}, "none.csv': cannot be read"),
        (BULK | {"layer": {"points": "points.csv", "length": 1}}, "mix layer: diameter: is missing; add the"),
        (BULK | {"layer": {"tribometer": [[0.1, 50]]}}, "must have points at two or more different values of 'speed'"),
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


@pytest.mark.parametrize(
    ("section", "says"),
    [
        ({"concrete": {"yield_stress": 40, "flow_index": 1.3}}, "mix viscosity: is missing, but"),
        ({"viscometer": [[2, 140], [5, 260]], "concrete": {"flow_index": 1.3}}, "mix viscosity: is missing, but"),
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


@pytest.mark.parametrize(("number", "sizes"), [
    ("#57", (4.75e-3, 25e-3)), ("# 8", (2.36e-3, 9.5e-3)), *((text, (4.75e-3, 19e-3)) for text in (
        "No. 67", "no 67", "No.67 stone", "67 stone", "67 crushed limestone", "#67s", "number 67", "Size 67",
        "size no. 67 stone")), ("#57 (5-20 mm)", (5e-3, 20e-3)),
])  # fmt: skip
def test_size_numbers_of_astm_are_sizes(number, sizes):
    assert read_sizes(number) == sizes


def test_a_number_sign_without_quotes_is_explained(tmp_path):
    path = tmp_path / "mix.yaml"
    for text, says in (("mix:\n  density: 2350\n  sizes: #57\n", "because # starts a comment"),
                       ("mix: {density: 2350, sizes: #57}\n", "put quotes around a value with #")):  # fmt: skip
        path.write_text(text, encoding="utf-8")
        with pytest.raises(SceneError, match=says):
            read_mix(path)
    with pytest.raises(SceneError, match=r"mix sizes = '#99': must be one of #1, #2, #3, #357"):
        read_sizes("No. 99 stone")
    with pytest.raises(SceneError, match=r"mm', or a size number of ASTM C33 as in '#67'"):
        read_sizes(67)


def test_a_mix_that_leaves_much_air_points_to_moist_sand():
    parts = {"cement": 320, "water": 150, "sand": 760, "gravel": 980}
    with pytest.warns(
        PlausibilityWarning, match=r"if the sand was weighed moist, move its surface water to 'water' \(not"
    ):
        mix_of({"parts": parts, "slump": "180 mm", "sizes": "20 mm"})


@pytest.mark.parametrize(
    ("names", "more", "sizes"),
    [
        (["#67 stone"], {}, (0.00475, 0.019)), (["# 57 limestone", "#8 pea gravel"], {}, (0.00236, 0.025)),
        (["#67 stone"], {"sizes": "10 mm"}, (0.004, 0.01)), (["gravel"], {}, None), (["#99 stone"], {}, None),
        (["#67 stone"], {"sieve": {4: 0, 16: 1}}, None), (["gravel", "sand #8"], {}, None),
        (["67 stone"], {}, (0.00475, 0.019)), (["No. 57"], {}, (0.00475, 0.025)),
        (["No 8 rock"], {}, (0.00236, 0.0095)), (["16 gravel"], {}, None), (["8 gravel"], {}, None),
        (["gravel 2/8", "gravel 8/16"], {}, (0.002, 0.016)),
        (["limestone 5,6/11,2"], {}, (0.0056, 0.0112)), (["aggregate 10-20"], {}, (0.01, 0.02)),
        (["20mm aggregate"], {}, (0.004, 0.02)), (["1 1/2 in stone"], {}, (0.004, 0.0381)),
        (["gravel 3/8"], {}, None), (["stone 3/4"], {}, None), (["aggregate 0/16"], {}, None),
        (["gravel 0/16"], {}, (0.004, 0.016)), (["gravel, max 350 mm"], {}, None),
        *(([name], {}, (0.005, 0.02)) for name in (
            "gravel size 5-20 mm", "gravel no. 2 (5-20 mm)", "gravel size 5-20", "gravel size 5 to 20 mm",
            "#5-20 mm stone", "gravel size 5 mm - 20 mm", "gravel No. 20 (5\u201320 mm)", "GRAVEL SIZE 5/20 MM",
            "gravel no 5/20")),
        *(([name], {}, (0.004, 0.0254)) for name in (
            "stone, max size 1 in", 'stone size 1"', "#57 stone, 1 inch", "stone 1 in to No. 4")),
        *(([name], {}, (0.004, 0.01905)) for name in (
            "stone size 3/4 in", '#67 3/4" stone', "stone No. 4 to 3/4 in", "stone No.4-3/4 in")),
        *(([name], {}, (0.004, 0.0381)) for name in ("stone size 1 1/2 in", "stone size 1-1/2 in", "#4 stone 1.5 in")),
        (["aggregate 0 to 16 mm"], {}, None), (["aggregate 0 mm - 16 mm"], {}, None),
        (["crushed stone size 20 mm"], {}, (0.004, 0.02)), (["stone size 9.5 mm"], {}, (0.004, 0.0095)),
        *(([name], {}, (0.004, 0.02)) for name in (
            "limestone 20 mm", "gravel,20 mm", "gravel max.20 mm", "#57 stone - 20 mm")),
        *(([name], {}, (0.00475, 0.019)) for name in ("stone, 19.0 to 4.75 mm", "stone 4.75-9.5 mm, 9.5-19 mm")),
        (["stone .75 in"], {}, (0.004, 0.01905)), (["stone size 1-2 in"], {}, (0.0254, 0.0508)),
        (["stone size 3/4"], {}, None), (["stone size 1 1/2"], {}, None), (["gravel 32/56"], {}, (0.032, 0.056)),
        (["32/56 gravel"], {}, (0.032, 0.056)), (["#57/67 stone"], {}, (0.00475, 0.025)),
        (["#57 limestone"], {}, (0.00475, 0.025)), (["number 57 rock"], {}, (0.00475, 0.025)),
        (["size no. 8 stone"], {}, (0.00236, 0.0095)),
    ],
)  # fmt: skip
def test_a_size_number_in_the_name_of_a_part_is_the_size_of_the_stones(names, more, sizes):
    """A ticket that names its stone as '#67 stone' once left the largest stone unknown."""
    parts = {"cement": 340, "water": 180, "sand": 790, **dict.fromkeys(names, 1040 / len(names))}
    with warnings.catch_warnings(record=True) as caught:
        given = mix_of({"parts": parts, "slump": "120 mm", **more}).given
    assert given.sizes == (None if sizes is None else pytest.approx(sizes)) and given.water_binder == pytest.approx(
        180 / 340
    )
    messages = "".join(str(each.message) for each in caught)
    assert ("is no size number of ASTM C33" in messages) == ("#99" in names[0])


@pytest.mark.parametrize(
    ("text", "command", "says"),
    [
        ("mix: {density: 2300, slump: 15 cm}", "line", "describes a concrete, not a line; give this file as --conc"),
        ("air: 2 %\nslump: 15 cm", "line", "line's key = 'air': describes a concrete, not a line"),
        ("slump: 15 cm\nparts: [straight: 5 m]", "line", "name this file as 'concrete', or use the option --slump"),
        ("density: 2300\nparts: {cement: 340}\nslump: 15 cm", "line", "not a line; give this file as --concrete"),
        ("flwo: 3\nslump: 15 cm\nparts: [straight: 5 m]", "line", "line's key = 'slump': describes a concrete"),
        ("flwo: 3\nparts: [straight: 5 m]", "line", "line's key = 'flwo': must be one of name, source, recorded"),
        ("stone: 16 mm\nparts: [straight: 5 m]", "line", "is called 'largest_stone' in a line; write 'largest_stone"),
        ("diameter: 5 in\nparts: [straight: 5 ft]", "mix", "a file with a diameter describes a line; use it as 'warp"),
        ("density: 2300\nslump: 15 cm", "mix", "unknown key 'density'; it belongs to the section 'mix': write 'mix:'"),
    ],
)  # fmt: skip
def test_a_file_in_the_wrong_place_is_explained(tmp_path, text, command, says):
    path = tmp_path / "file.yaml"
    path.write_text(f"{text}\n", encoding="utf-8")
    assert says in str(CliRunner().invoke(cli, [command, str(path)]).exception)


def test_an_ingredient_without_a_unit_beside_customary_ones_is_questioned():
    parts = {"cement": 335, "water": "33 gal/yd3", "sand": "1420 lb/yd3", "gravel": "1780 lb/yd3"}
    with pytest.warns(PlausibilityWarning, match=r"cement: 335: .* in kg/m3, .* in lb/yd3; did you mean '335 lb/yd3'"):
        mix_of({"parts": parts, "slump": "7 in"})


def test_a_number_that_a_comma_has_split_is_shown_as_it_was_typed():
    parts = yaml.safe_load("{cement: 564 lb/yd3, sand: 1,260 lb/yd3, water: 33 gal/yd3}")
    with pytest.raises(SceneError, match="write 1260 lb/yd3 without a comma"):
        mix_of({"parts": parts})
