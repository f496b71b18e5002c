"""Amounts with units: values, texts that are refused, and agreement between the parser and the schemas of files."""

import re
import time

import pytest
from schema_builder import text_pattern

from warpcrete import SceneError
from warpcrete.core.inputs.amounts import LONGEST, UNITS, amount, bare_number, is_amount, is_customary, unit_names
from warpcrete.mix.ingredients import mass_per_volume
from warpcrete.mix.mix import mix_of

YARD = 0.764554857984
"""Volume of a cubic yard [m3]."""
RIGHT = [
    ("40 yd3/hr", "m3/s", 40 * YARD / 3600), ("0.65 yd3/min", "m3/s", 0.65 * YARD / 60),
    ("0,5 m3/min", "m3/s", 1 / 120), ("132 gal/min", "m3/s", 132 * 3.785411784e-3 / 60),
    ("132 gpm", "m3/s", 132 * 3.785411784e-3 / 60), ("500 L/min", "m3/s", 500e-3 / 60),
    ("1200 psi", "Pa", 8273708.75), ("85 kPa", "Pa", 85e3), ("4 1/2 in", "m", 0.1143), ("4-1/2 in", "m", 0.1143),
    ("1/2 in", "m", 0.0127), ('5"', "m", 0.127), ('4 1/2"', "m", 0.1143), ("5 in.", "m", 0.127),
    ("6 ft 3 in", "m", 1.905), ("6'3\"", "m", 1.905), ("6' 3 1/2\"", "m", 1.9177), ("-6 ft 3 in", "m", -1.905),
    ("6 ft 0.5 in", "m", 1.8415), ("3/4 ft", "m", 0.2286), ("12,5 m", "m", 12.5), ("0,125 m", "m", 0.125),
    ("0,125", "m", 0.125), ("12,50 bar", "Pa", 1.25e6), ("1234,567 Pa", "Pa", 1234.567), ("1,2345 m", "m", 1.2345),
    ("12,5 %", "1", 0.125), ("30\u00a0m3/h", "m3/s", 30 / 3600), ("564 lb/yd3", "kg/m3", 334.6079),
    ("145 pcf", "kg/m3", 2322.677), ("33 gal/yd3", "m3/m3", 0.16338735), ("8 yd3", "m3", 8 * YARD),
    ("128 fl oz", "m3", 3.785411784e-3), ("128 floz", "m3", 3.785411784e-3), ("128 oz", "m3", 3.785411784e-3),
    ("75 hp", "W", 55927.49), ("20 lb", "kg", 9.0718474), ("-4 1/2 in", "m", -0.1143), ("-1/2 in", "m", -0.0127),
    ("+4-1/2 in", "m", 0.1143), ("-4-1/2 ft", "m", -1.3716), ("-6' 3 1/2\"", "m", -1.9177), ("-0' 1/2\"", "m", -0.0127),
]  # fmt: skip
WRONG = [
    ("1,234", "m", "the comma in 1,234 may separate decimals or thousands; write 1.234 or 1234"),
    ("1,234 m", "m", "the comma in 1,234 may separate"), ("-1,234 bar", "Pa", "the comma in -1,234 may separate"),
    ("1,234.5 m", "m", "leave out separators of thousands"), ("1.234,5 m", "m", "leave out separators of thousands"),
    ("0.2,", "m/s", "leave out the comma at the end"), ("2 m;", "m", "leave out the semicolon at the end"),
    ("5 kg,", "m", "ft, yd; a number"), ("abc,", "m", "ft, yd; a number"), (",", "m", "ft, yd; a number"),
    ("1,234,", "m", "write 1.234 or 1234"), ("2 m ,", "m", "leave out the comma"), ("5 inchs;", "m", "mean 'inch"),
    ("1,234,567 m", "m", "leave out separators"), ("1/2", "m", "write fractions of inches or feet as '4 1/2 in'"),
    ("1/2 m", "m", "write fractions of inches"), ("4 1/3 in", "m", "halves to sixty-fourths"),
    ("4 9/8 in", "m", "write fractions"), ("1/2 bar", "Pa", "write a decimal number instead of a fraction"),
    ("6 ft 15 in", "m", "with one of the units m, mm"), ("6.5 ft 3 in", "m", "with one of the units"),
    ("6 ft 3 m", "m", "with one of the units"),
    ("30 m3/hor", "m3/s", "did you mean 'm3/h"), ("5 inchs", "m", "did you mean 'inch"),
    ("1/0 in", "m", "write fractions"), ("", "m", "with one of the units"),
    ("-", "m", "with one of the units"), ("1" * 400, "m", "left out"), ("1e999 m", "m", "with one of the units"),
    ("5 km 3 m", "m", "with one of the units"), ("3 '", "s", "with one of the units s, ms, min, h;"),
]  # fmt: skip


@pytest.mark.parametrize(("given", "unit", "value"), RIGHT)
def test_units_and_notations_of_building_sites(given, unit, value):
    assert amount("it", given, unit) == pytest.approx(value, rel=1e-6)
    assert re.match(text_pattern(unit), given), "the schema refuses what the parser accepts"
    assert is_amount(given, unit) == (given != "0,125")


@pytest.mark.parametrize(("given", "unit", "says"), WRONG)
def test_other_texts_are_refused_in_one_short_line(given, unit, says):
    with pytest.raises(SceneError) as caught:
        amount("it", given, unit)
    text = str(caught.value)
    assert text.startswith("it = ") and says in text and "\n" not in text and len(text) < 600
    assert not is_amount(given, unit)


@pytest.mark.parametrize("unit", UNITS)
def test_every_unit_is_read_by_all_its_names(unit):
    for name, factor in UNITS[unit].items():
        for text in (f"3 {name}", f" 3.0  {name} ", *([] if name == "1" else [f"3{name}"])):
            assert amount("it", text, unit) == pytest.approx(3 * factor, rel=1e-14)
            assert re.match(text_pattern(unit), text)
    assert {UNITS[unit][name] for name in unit_names(unit)} == set(UNITS[unit].values())


def test_long_texts_take_no_time():
    begin = time.process_time()
    for text in (
        "1" * LONGEST,
        "1," * 50,
        "1 " * 50,
        "1-" * 50,
        "1/2" * 33,
        "1 ft " * 20,
        " " * 99 + "1",
        "9" * 99 + ",",
    ):
        for unit in ("m", "Pa"):
            with pytest.raises(SceneError) if text.strip() not in ("1" * LONGEST, "1") else _nothing():
                amount("it", text, unit)
    assert time.process_time() - begin < 0.5


def test_digits_of_other_scripts_are_digits():
    assert amount("it", "\uff12\uff10 m3/h", "m3/s") == amount("it", "\u0662\u0660 m3/h", "m3/s") == 20 / 3600
    assert amount("it", "\u0663", "m") == 3.0


class _nothing:
    def __enter__(self):
        return self

    def __exit__(self, *_):
        return False


def test_a_load_of_a_truck_gives_the_same_mix_as_amounts_per_volume():
    """A ticket of 8 cubic yards in pounds and gallons is the mix in kilograms per cubic metre."""
    load = {"cement": "4512 lb", "water": "264 gal", "sand": "11200 lb", "gravel": "14400 lb"}
    per_yard = {"cement": "564 lb/yd3", "water": "33 gal/yd3", "sand": "1400 lb/yd3", "gravel": "1800 lb/yd3"}
    metric = {"cement": 334.608, "water": 163.387, "sand": 830.588, "gravel": 1067.899}
    found = [
        mix_of({"parts": parts, "slump": "6 in", "air": "2 %", **more})
        for parts, more in ((load, {"volume": "8 yd3"}), (per_yard, {}), (metric, {}))
    ]
    for other in found[1:]:
        assert other.flow == pytest.approx(found[0].flow, rel=1e-4)
    assert found[0].flow["density"] == pytest.approx(2396.48, rel=1e-5)
    for unit in ("oz/yd3", "oz/cy", "fl oz/yd3", "fl oz/cy"):
        assert mass_per_volume("superplasticizer", f"40 {unit}") == pytest.approx(1100 * 40 * 2.95735296e-5 / YARD)
    share = mix_of({"density": 2350, "slump": "6 in", "aggregate": "1800 lb/yd3"}).given.share
    assert share == pytest.approx(1067.9 / 2650, rel=1e-4)


@pytest.mark.parametrize(
    ("parts", "volume", "says"),
    [
        (
            {"cement": "4512 lb"},
            {},
            r"^mix parts: cement = '4512 lb': must be .* kg/m3.*; or add the volume of the load, as in 'volume: 8 yd3'",
        ),
        ({"water": "264 gal"}, {}, r"^mix parts: water = '264 gal': must be .*'volume: 8 yd3'"),
        ({"sand": "300 l/m3"}, {}, r"^mix parts: sand = '300 l/m3': is a volume, which is accepted for water"),
        ({"sand": "3 yd3"}, {"volume": "8 yd3"}, r"^mix parts: sand = '3 yd3': is a volume"),
        ({"water": "18 %"}, {}, r"^mix parts: water = '18 %': is a percentage, but must be a mass per volume"),
        (
            {"water reducer": "4 oz/cwt"},
            {},
            r"^mix parts: water reducer = '4 oz/cwt': is an amount per 100 lb of cement",
        ),
        ({"cement": 340}, {"volume": 0}, r"^mix volume = 0.*: must be in \[0\.001, 10000\] m3"),
        ({"cement": 340}, {"volume": "8 kg"}, r"^mix volume = '8 kg': must be a number with one of the units m3, l"),
    ],
)
def test_amounts_that_are_no_mass_per_volume_are_refused(parts, volume, says):
    with pytest.raises(SceneError, match=says):
        mix_of({"parts": parts, "slump": "150 mm", **volume})


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("5 in", True), ("4 1/2 in", True), ("330 ft", True), ("6 ft 3 in", True), ('3"', True), ("1200 psi", True),
        ("60 yd3/h", True), ("200 gpm", True), (".5 in", True), ("564 lb/yd3", True),
        ("275 gal", True), ("4 oz/cwt", False), ({"parts": {"sand": "1200 lb"}}, True), ("60 t", False),
        ({"bend": {"radius": "20 in"}}, True),
        ("125 mm", False), ("30 m3/h", False), ("85 bar", False), ("3 min", False), ("5", False), ("bend in", False),
        ([1, "1 m"], False), (5.0, False), (None, False), ("12 inc", False), ("3 m, 5 inside", False),
    ],
)  # fmt: skip
def test_us_units_are_recognised_wherever_they_stand(value, expected):
    assert is_customary(value) is expected


@pytest.mark.parametrize(
    ("given", "unit", "value"),
    [("35m3/h", "m3/s", 35 / 3600), ("26 yd3/h", "m3/s", 26 * 0.764554857984 / 3600), ("5 ft", "m", 1.524),
     ("4 inches", "m", 0.1016), ("1000 psi", "Pa", 6894757.293), ("147 lb/ft3", "kg/m3", 2354.714),
     ("10 min", "s", 600.0), ("1 h", "s", 3600.0), ("5 %", "1", 0.05), ("2 GPa", "Pa", 2e9)],
)  # fmt: skip
def test_units_of_other_countries(given, unit, value):
    assert amount("it", given, unit) == pytest.approx(value, rel=1e-6)


def test_a_long_text_is_no_amount():
    """A long text is refused: the time to find a number in a text grows with the cube of the length of the text."""
    for text in ("1" + " " * 2000 + "x\n", " " * 2000 + "1"):
        with pytest.raises(SceneError, match="must be a number with one of the units m, mm"):
            amount("diameter", text, "m")
        assert not bare_number(text)
    assert amount("diameter", "  125  mm ", "m") == 0.125 and bare_number(" 1e3 ")
    with pytest.raises(SceneError, match="must be a number without a unit, or with %"):
        amount("share", "1 m", "1")
