"""Rules of practice against blocking: their limits, cases that blocked and that did not, and what is missing."""

import json

import pytest
from click.testing import CliRunner

from warpcrete.cli.main import cli
from warpcrete.core.inputs.yaml_files import yaml_text
from warpcrete.mix.blocking import (
    FINE_SAND,
    SELF_COMPACTING,
    behind_reducers,
    blocking_rules,
    line_rules,
    narrowest,
    rule_lines,
    worst,
)
from warpcrete.mix.mix import mix_of, read_mix
from warpcrete.studies.lines.losses import line_of

ORDINARY = {
    "parts": {"cement": 340, "water": 180, "sand": 790, "gravel": 1040},
    "aggregate": "1040 kg/m3",
    "sizes": ["4 mm", "20 mm"],
    "shape": "crushed",
    "slump": "120 mm",
    "fine_sand": "18 %",
}


LIGHT = {"density": 1850, "sizes": [0.005, 0.015]}
LIGHT_PARTS = {"lightweight coarse aggregate": 470, "sand": 800, "water": 180}


@pytest.mark.parametrize(
    ("entries", "verdict"),
    [
        ({**LIGHT, "slump": 0.18}, "risky"), ({**LIGHT, "slump": 0.181}, "fine"), ({**LIGHT, "spread": 0.6}, "fine"),
        ({**LIGHT, "density": 1999, "slump": 0.1}, "risky"), ({**LIGHT, "density": 2000, "slump": 0.1}, None),
        ({"slump": 0.2, "parts": {**LIGHT_PARTS, "cement": 320}}, "risky"),
        ({"slump": 0.2, "parts": {**LIGHT_PARTS, "cement": 321}}, "fine"),
        ({"slump": 0.2, "parts": {**LIGHT_PARTS, "cement": 200, "fly ash": 130}}, "risky"),
        ({**LIGHT, "concrete": {"yield_stress": 100, "viscosity": 30}}, "unknown"),
    ],
)  # fmt: skip
def test_lightweight_concrete_needs_slump_and_cement(entries, verdict):
    """No rule once knew that lightweight aggregate absorbs water under the pressure of the pump."""
    found = {each.rule: each.verdict for each in blocking_rules(mix_of(entries).given, 0.125)}
    assert found.get("lightweight aggregate") == verdict


def verdicts(bore=0.125, **changes):
    mix = mix_of({key: value for key, value in (ORDINARY | changes).items() if value is not None})
    return {each.rule: each for each in blocking_rules(mix.given, bore)}


def parts(**masses):
    return ORDINARY["parts"] | masses


def test_an_ordinary_mix_is_fine():
    found = verdicts()
    assert {each.verdict for each in found.values()} == {"fine"} and len(found) == 7
    assert not any(each.change for each in found.values()) and all(each.source for each in found.values())


@pytest.mark.parametrize(
    ("stone", "shape", "spread", "bore", "verdict"),
    [
        (30, "crushed", None, 125, "fine"),  # 0.24: fifteen flows through a coil of 125 mm
        (20, "crushed", None, 125, "fine"),
        (25.4, "crushed", None, 101.6, "fine"),  # 0.25: hard to pump over a long distance, but it passed
        (38, "rounded", None, 102, "risky"),  # the example that ACI 304.2R allows
        (38, "crushed", None, 102, "blocks"),
        (38, None, None, 102, "blocks"),  # an unknown shape counts as crushed
        (38, "rounded", 650, 102, "blocks"),  # self-compacting concrete has no allowance for round stones
        (25, "rounded", 650, 90, "risky"),
        (42, "rounded", None, 102, "blocks"),
    ],
)
def test_the_stone_in_the_bore(stone, shape, spread, bore, verdict):
    changes = {} if spread is None else {"slump": None, "spread": f"{spread} mm"}
    found = verdicts(bore / 1e3, sizes=["4 mm", f"{stone} mm"], shape=shape, **changes)["stone in bore"]
    assert found.verdict == verdict
    assert bool(found.change) == (verdict != "fine") and "ACI 304.2R" in found.source


@pytest.mark.parametrize(
    ("stones", "density", "share"),
    [
        ({"lightweight coarse aggregate": 470}, 1250, 41.3),  # 59.8 % by mass
        ({"magnetite gravel": 2000}, 4900, 39.3),  # 25.9 % by mass
        ({"magnetite gravel": 2000}, None, 39.3),
        ({"gravel": 1000}, 2750, 41.2),  # a usual rock: by mass, as the rules state it
        ({"recycled coarse aggregate": 1000}, None, 41.2),
        ({"lightweight coarse aggregate": 470}, None, None),
    ],
)
def test_the_share_of_sand_is_by_volume_if_the_stones_are_light_or_heavy(stones, density, share):
    """Compare with a computation by hand: 264 litres of sand, 376 of light stones and 408 of magnetite."""
    changes = {"aggregate": None, "aggregate_density": density}
    found = verdicts(parts={"cement": 400, "water": 180, "sand": 700, **stones}, **changes)["sand"]
    if share is None:
        assert found.verdict == "unknown"
    else:
        assert found.verdict == "fine" and found.found.startswith(f"{share:.3g} % of the aggregate")


@pytest.mark.parametrize(("cement", "verdict"), [(240, "blocks"), (270, "risky"), (300, "fine"), (320, "fine")])
def test_powder_by_tuutti(cement, verdict):
    gravel = 1040 + 0.9 * (340 - cement)
    found = verdicts(parts=parts(cement=cement, gravel=gravel), aggregate=f"{gravel} kg/m3")
    assert found["powder"].verdict == verdict


def test_paste_fills_the_voids():
    lean = parts(cement=210, water=130, sand=860, gravel=1190)
    assert verdicts(parts=lean, aggregate="1190 kg/m3")["paste and voids"].verdict == "risky"
    measured = verdicts(parts=lean, aggregate="1190 kg/m3", voids="30 %")["paste and voids"]
    assert measured.verdict == "blocks" and "measured" in measured.found
    # Calculated by hand: 0.777 m3 of aggregate with 28 % of voids contains 302 l/m3 of voids.
    aggregate = 1 - 210 / 3100 - 0.13 - 0.02
    assert f"{1e3 * aggregate * 0.28 / 0.72:.3g}" in measured.found
    assert verdicts(parts=lean, aggregate="1190 kg/m3", voids="15 %")["paste and voids"].verdict == "fine"


@pytest.mark.parametrize("slurry", [0.278, 0.325, 0.389])
def test_coils_that_ran_are_not_said_to_block(slurry):
    """Smallest and largest paste of 403 flows that were measured, at a ratio of water to binder of 0.44."""
    powder = slurry / (1 / 3.1 + 0.44) * 1e3 / 1e3
    masses = {"cement": 1e3 * powder, "water": 440 * powder}
    left = (0.98 - slurry) * 2650
    for share in (0.366, 0.518):
        own = masses | {"sand": share * left, "gravel": (1 - share) * left}
        found = verdicts(parts=own, aggregate=f"{(1 - share) * left} kg/m3", shape=None)
        assert {each.verdict for each in found.values()} == {"fine"}


def test_bleeding_and_what_holds_the_water():
    wet = parts(cement=300, water=210, sand=760)
    assert verdicts(parts=wet)["bleeding"].verdict == "risky"
    held = verdicts(parts=wet | {"vma": 1})["bleeding"]
    assert held.verdict == "fine" and "viscosity-modifying" in held.found
    assert verdicts(parts=wet | {"sand": 710, "limestone": 60})["bleeding"].verdict == "fine"


def test_sand_without_fines_holds_no_water():
    """A stated share of 0 % counts, although the rule assumes another one if none is stated."""
    wet = parts(cement=300, water=210, sand=760)
    none, unstated = (verdicts(parts=wet, fine_sand=share)["bleeding"].found for share in ("0 %", None))
    assert f"fine sand {300 / 210:.2f} times the water" in none
    assert f"fine sand {(300 + FINE_SAND[0] * 760) / 210:.2f} times the water" in unstated


def test_a_ratio_of_water_to_binder_without_masses():
    """The ratio alone is judged, because nothing is known of what holds the water."""
    for ratio, verdict in ((0.5, "fine"), (0.7, "risky")):
        entries = {"density": "2350 kg/m3", "aggregate": "36 %", "sizes": ["4 mm", "16 mm"], "spread": "600 mm"}
        mix = mix_of(entries | {"water_binder": ratio})
        (found,) = [each for each in blocking_rules(mix.given, 0.125) if each.rule == "bleeding"]
        assert found.verdict == verdict and found.found.startswith(f"water-binder ratio {ratio:.2f}; ")
        assert "times the water" not in found.found


@pytest.mark.parametrize(("slump", "admixture", "verdict"),
                         [(40, False, "blocks"), (80, False, "risky"), (120, False, "fine"), (200, False, "risky"),
                          (200, True, "fine")])  # fmt: skip
def test_the_slump(slump, admixture, verdict):
    own = parts(superplasticizer=2) if admixture else parts()
    found = verdicts(parts=own, slump=f"{slump} mm")["consistency"]
    assert found.verdict == verdict
    assert ("100 to 160 mm are usual; a superplasticizer, as in this mix, allows more" in found.found) == admixture


@pytest.mark.parametrize(
    ("slump", "verdict"), [(120, "fine"), (160, "fine"), (161, "unknown"), (60, "risky"), (40, "blocks")]
)
def test_a_slump_alone_does_not_tell_whether_a_plasticizer_is_in_the_mix(slump, verdict):
    mix = mix_of({"density": 2350, "slump": f"{slump} mm"})
    (found,) = [each for each in blocking_rules(mix.given) if each.rule == "consistency"]
    assert found.verdict == verdict and ("superplasticizer" in found.change) == (verdict == "unknown")


def test_sand_and_its_fines():
    stony = parts(sand=600, gravel=1230)
    assert verdicts(parts=stony, aggregate="1230 kg/m3")["sand"].verdict == "risky"
    assert verdicts(fine_sand="8 %")["fine sand"].verdict == "risky"
    assert verdicts(fine_sand="40 %")["fine sand"].verdict == "risky"


def test_a_rule_without_data_names_the_entry():
    found = {
        each.rule: each for each in blocking_rules(mix_of({"density": 2350, "concrete": {"yield_stress": 60}}).given)
    }
    assert {each.verdict for each in found.values()} == {"unknown"}
    for rule, entry in (("stone in bore", "sieve"), ("powder", "parts"), ("paste and voids", "parts"),
                        ("sand", "parts"), ("fine sand", "fine_sand"), ("bleeding", "water_binder"),
                        ("consistency", "slump")):  # fmt: skip
        assert entry in found[rule].change
    assert "80 mm" in verdicts(bore=None)["stone in bore"].found  # without a bore, the rule says how wide it must be
    assert worst(list(found.values())) == "unknown" and worst([]) == "unknown"


LINE = {
    "diameter": "125 mm", "largest_stone": "32 mm",
    "parts": [{"straight": "10 m"}, {"reducer": {"to": "100 mm", "length": "1 m"}}, {"straight": "1 m"},
              {"bend": {"to": "up", "radius": "0.5 m"}}, {"straight": "5 m"}],
}  # fmt: skip


@pytest.mark.parametrize(
    ("kinds", "number"),
    [
        ("valve straight", 2), ("valve hose", 2), ("straight valve", 1), ("straight hose", 1),
        ("straight valve bend bend", 3), ("reducer straight bend", 1), ("valve", 1),
    ],
)  # fmt: skip
def test_among_equally_narrow_parts_the_likeliest_to_block_is_judged(kinds, number):
    """Stones arch in a cone, then in a bend; other parts follow in their order, and a valve is the last."""
    entries = {"valve": 0.5, "straight": 2, "hose": 3, "bend": {"to": "left", "radius": 0.5},
               "reducer": {"to": 0.1, "length": 1}}  # fmt: skip
    parts = [{kind: entries[kind]} for kind in kinds.split()]
    line = line_of({"diameter": 0.125 if "reducer" in kinds else 0.1, "parts": parts})
    assert narrowest(line).number == number


def test_a_line_is_judged_at_its_narrowest_part():
    line = line_of(LINE)
    assert narrowest(line).number == 2
    found = line_rules(line, None)
    assert [(each.rule, each.verdict) for each in found] == [("stone in bore", "risky"), ("behind a reducer", "risky")]
    longer = LINE | {"parts": [*LINE["parts"][:2], {"straight": "5 m"}, *LINE["parts"][3:]]}
    assert [each.rule for each in line_rules(line_of(longer), None)] == ["stone in bore"]
    text = rule_lines(found, "narrowest part 2")
    assert text[0] == "will it block? perhaps, by rules of practice (2 risky; narrowest part 2)"
    assert any("->" in x for x in text)
    assert rule_lines([])[0].startswith("will it block? no rule of practice says so, but not all could be applied")


NARROWING, UP = {"reducer": {"to": "100 mm", "length": "1 m"}}, {"bend": {"to": "up", "radius": "0.5 m"}}


@pytest.mark.parametrize(
    ("parts", "run"),
    [
        ([NARROWING, {"straight": "1 m"}, UP], "1 m"), ([NARROWING, UP, {"straight": "9 m"}], "0 m"),
        ([NARROWING, {"straight": "2 m"}, {"straight": "2.9 m"}, UP], "4.9 m"),
        ([NARROWING, {"straight": "2 m"}, {"straight": "3 m"}, UP], None), ([NARROWING, {"straight": "1 m"}], None),
        ([{"reducer": {"to": "150 mm", "length": "1 m"}}, {"straight": "1 m"}, UP], None),
    ],
)  # fmt: skip
def test_five_metres_of_straight_pipe_must_follow_a_reducer_that_narrows(parts, run):
    """Nothing is asked for at the end of a line, where no bend follows, or behind a part that widens."""
    found = list(behind_reducers(line_of(LINE | {"parts": parts})))
    assert [each.found.partition(" of straight pipe behind part 1")[0] for each in found] == ([run] if run else [])


def test_the_commands_print_the_rules(tmp_path):
    path = tmp_path / "mix.yaml"
    path.write_text(yaml_text({"mix": ORDINARY}), encoding="utf-8")
    found = CliRunner().invoke(cli, ["mix", str(path), "--bore", "2 in"]).output
    assert (
        "will it block? yes, by rules of practice (1 blocks, 6 fine; bore of 50.8 mm (2 in))" in found
        and "-> use a bore of 80 mm (3.15 in), or stones up to 12.7 mm (0.5 in)" in found
    )
    assert "bore" in str(CliRunner().invoke(cli, ["mix", str(path), "--bore", "-2"]).exception)
    site = tmp_path / "site.yaml"
    site.write_text(yaml_text(LINE | {"flow": "20 m3/h", "concrete": str(path)}), encoding="utf-8")
    done = CliRunner().invoke(cli, ["line", str(site), "--theory", "--out", str(tmp_path / "line")])
    assert done.exit_code == 0 and "narrowest part 2" in done.output
    record = json.loads((tmp_path / "line" / "blocking.json").read_text(encoding="utf-8"))
    assert record["worst"] == "risky" and record["narrowest_part"] == 2 and len(record["rules"]) == 8
    assert (
        "all rules on the mix" in CliRunner().invoke(cli, ["line", str(site), "--theory", "--concrete", "no1"]).output
    )


def test_self_compacting_by_its_spread():
    assert (read_mix("example-scc").given.spread or 0) >= SELF_COMPACTING
    wet = verdicts(slump=None, spread="850 mm")["consistency"]
    assert wet.verdict == "risky" and wet.change


@pytest.mark.parametrize(
    ("entries", "verdict"),
    [({"slump": None}, "unknown"), ({"slump": "200 mm"}, "fine"), ({"slump": None, "spread": "560 mm"}, "fine")],
)
def test_a_small_spread_may_be_that_of_a_flow_table(entries, verdict):
    """Concrete that spreads by 480 mm only under the jolts of a flow table is much stiffer than it looks."""
    found = verdicts(**{"spread": "480 mm", **entries})["consistency"]
    assert found.verdict == verdict and ("flow table" in found.change) == (verdict == "unknown")


def test_bleeding_is_unknown_if_only_the_sand_is():
    """300 kg of powder are 1.67 times 180 kg of water; with 15 % of 790 kg of sand they are 2.33 times."""
    aggregates = {"aggregate": None, "fine_sand": None}
    whole = verdicts(parts={"cement": 300, "water": 180, "aggregate": 1870}, **aggregates)["bleeding"]
    assert whole.verdict == "unknown" and "fine sand 1.67 times the water" in whole.found
    apart = verdicts(parts={"cement": 300, "water": 180, "sand": 790, "gravel": 1080}, **aggregates)["bleeding"]
    assert apart.verdict == "fine" and "2.33 times" in apart.found
    wet = verdicts(parts={"cement": 290, "water": 185, "aggregate": 1870}, **aggregates)["bleeding"]
    assert wet.verdict == "risky"
