"""Meanings of the names of ingredients, and figures and rules of practice for many mixes, kept (see `kept`)."""

import dataclasses
import warnings

import kept

from warpcrete.core.errors import PlausibilityWarning, WarpcreteError
from warpcrete.mix import ingredients
from warpcrete.mix.blocking import blocking_rules, rule_lines, worst
from warpcrete.mix.mix import mix_of

NAMES = """cement; CEM II/A-LL 42.5 N; portland cement type I; ground granulated slag; limestone filler; crushed
limestone; limestone 4/16; fly ash; silica fume; quartz flour; quartz sand; water; ice; mixing water; river sand; fine
aggregate; coarse aggregate; aggregate; gravel 4/8; round stones; basalt chippings; sand and gravel; lightweight
aggregate; expanded clay; recycled aggregate; basaltic fibres; steel fibres; polypropylene fibres; superplasticizer;
PCE; high-range water reducer; shrinkage reducer; viscosity reducer; viscosity modifier; VMA; stabilizer; hydration
stabilizer; air entrainer; retarder; pigment; barite; magnetite; glenium 51; cemnt; latex""".replace("\n", " ")
AMOUNTS = (340, "340 kg/m3", "20 lb/yd3", "4 l/m3", "30 gal/yd3", "3 %", "6 oz/cwt", "1200 kg", "100 l", "5 x", None)
BASE = {
    "parts": {"cement": 340, "fly ash": 40, "water": 180, "sand": 790, "gravel": 1000, "superplasticizer": 3},
    "aggregate": "1000 kg/m3",
    "sizes": ["4 mm", "20 mm"],
    "shape": "crushed",
    "slump": "120 mm",
    "fine_sand": "18 %",
    "voids": "22 %",
}
MIXES = {
    "usual": {},
    "lean": {"parts": {"cement": 230, "water": 170, "sand": 820, "gravel": 1080}, "fine_sand": "12 %"},
    "sandy": {"parts": {"cement": 340, "water": 190, "sand": 1100, "gravel": 640}, "aggregate": "640 kg/m3"},
    "self-compacting": {"slump": None, "spread": "650 mm", "t500": "3 s", "voids": None},
    "heard of": {"parts": None, "density": 2350, "water_binder": 0.5, "aggregate": "38 %", "fine_sand": None},
    "large stones": {"sizes": ["8 mm", "40 mm"], "shape": "rounded", "thickener": True, "air": "5 %"},
    "sieve": {"sizes": None, "sieve": {4: 0, 8: 0.3, 16: 0.8, 22: 1}, "slump": "200 mm"},
    "stiff": {"slump": "40 mm", "shape": None, "air": "2 %"},
    "unsorted": {"parts": {"cement": 340, "water": 180, "aggregate": 1830}, "aggregate": "38 %"},
    "unsorted stones": {"parts": {"cement": 600, "water": 300, "aggregate": 1300}, "aggregate": "50 %", "air": 0.02},
    "measured": {"concrete": {"yield_stress": 300, "viscosity": 40, "uncertainty": "15 %"},
                 "layer": {"yield_stress": 30, "viscosity": 900, "uncertainty": "10 %"}},
}  # fmt: skip


def attempt(function, *arguments):
    """Return a result, or the message of a refusal; with a warning, return both."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", PlausibilityWarning)
        try:
            found = function(*arguments)
        except WarpcreteError as error:
            found = str(error)
    return [*(str(each.message) for each in caught), found] if caught else found


def constants(concrete):
    """Return the numbers that describe a concrete."""
    return [each for each in dataclasses.astuple(concrete) if not isinstance(each, str)]


def test_kept_meaning_of_names():
    found = {}
    for name in map(str.strip, NAMES.split(";")):
        one = {name: 100.0}
        found[name] = {
            "density": attempt(ingredients.density_of, name),
            "marks": [ingredients.is_thickener(name), ingredients.is_plasticizer(name)],
            "masses": [ingredients.powder_mass(one), ingredients.water_mass(one)],
            "aggregate": ingredients.sand_and_stone_masses(one),
            "paste": [ingredients.paste_volumes({name: mass, "water": 170.0}) for mass in (20.0, 21.0)],
        }
    for name in ("cement", "water", "superplasticizer", "glenium 51"):
        for value in AMOUNTS:
            found[f"{name}, {value}"] = [attempt(ingredients.mass_per_volume, name, value, load) for load in (None, 6)]
    for masses in ((340, 180, 800, 980), (340, 180, 870, 1060), (340, 180, 700, 850), (340, 180, 1000, 1200)):
        parts = dict(zip(("cement", "water", "sand", "gravel"), masses))
        found[f"volume of {masses}"] = [
            attempt(ingredients.check_volume, parts, *more) for more in ((2650.0, None), (2650.0, 0.02), (2900.0, 0.05))
        ]
    kept.compare("mix-names", found)


def test_kept_figures_and_rules_of_mixes():
    found = {}
    for name, changes in MIXES.items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", PlausibilityWarning)
            mix = mix_of({key: value for key, value in (BASE | changes).items() if value is not None})
        rules = [blocking_rules(mix.given, bore) for bore in (0.05, 0.1, 0.125)]
        found[name] = {
            "mix": [repr(mix), mix.text(), mix.band_origin],
            "bands": {each.name: [each.value, each.low, each.high] for each in mix.figures},
            "remarks": mix.remarks,
            "other layers": [[f"{each.span} from {each.way}" for each in pair] for pair in mix.other_layers],
            "variants": {cause: [constants(each) for each in pair] for cause, pair in mix.variants.items()},
            "parameters": [mix.flow, mix.elements, mix.aggregates],
            "given": mix.given,
            "rules": [[f"{each.verdict} {each.found}" for each in of_bore] for of_bore in rules],
            "records": [each.record() for each in rules[1]],
            "lines": rule_lines(rules[0]),
            "worst": [worst(of_bore) for of_bore in rules],
        }
    kept.compare("mix-rules", found)
