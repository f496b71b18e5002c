"""JSON schemas of the files that users write, derived from the declarations that also check these files.

The package ships the schemas in the folder `warpcrete/schemas`. `python tests/studies/test_schemas.py` updates this
folder, and a test compares it with the output of :func:`schemas`.
"""

from collections.abc import Iterable, Mapping
from dataclasses import MISSING
from typing import Any

from ingredient_schema import parts_schema

from warpcrete.core.inputs.amounts import patterns
from warpcrete.core.inputs.concretes import FACTOR_SOURCE, SECTIONS, TEXTS
from warpcrete.core.inputs.limits import LARGEST_INTEGER, LARGEST_SEED, limit_of
from warpcrete.core.inputs.parameters import Above, CompositeRule, Field, OneOf, Within, declared_fields
from warpcrete.dem.pumping.parameters import PipeParameters
from warpcrete.geometry.line_entries import (
    AMOUNTS,
    BEGINS,
    BEND_FACTOR,
    MOST_PARTS,
    MOST_POINTS,
    PARTS,
    WAYS,
    WITHOUT_ENTRIES,
)
from warpcrete.geometry.line_entries import KEYS as LINE_KEYS
from warpcrete.geometry.line_entries import TEXTS as LINE_TEXTS
from warpcrete.geometry.pumps import PUMP
from warpcrete.methods import METHODS
from warpcrete.mix import entries as mixes
from warpcrete.mix import measurements, stones
from warpcrete.mix.mix import FACTORS
from warpcrete.mix.points import PUMPED
from warpcrete.mix.reading import PER_BINDER
from warpcrete.mps.common.mixes import ConcreteParameters
from warpcrete.scenes import modules
from warpcrete.studies.calibration.targets import TARGET_KEYS
from warpcrete.theory.pipe import Concrete

Schema = dict[str, Any]
DRAFT = "http://json-schema.org/draft-07/schema#"
"""Draft of the JSON Schema standard that most editors support."""
TEXT: Schema = {"type": ["string", "number"]}
"""Schema of a text entry, which YAML may have read as a number."""
TEXT_DESCRIPTIONS = {
    "name": "name of the concrete",
    "source": "origin of the numbers",
    "calibrated": "parameters that were fitted, and to which targets",
    "base": "name or file of a concrete whose missing parameters this file adds",
}
"""Descriptions of the text entries of a concrete's file."""


def schemas() -> dict[str, Schema]:
    """Return the schema of each kind of file by its name."""
    return {"concrete": concrete_schema(), "mix": mix_schema(), "line": line_schema(), "targets": targets_schema()}


def concrete_schema() -> Schema:
    """Return the schema of a concrete's file."""
    fields = declared_fields(PipeParameters)
    _, known = PipeParameters.of_concrete()
    constants = declared_fields(Concrete) | {name: declared_fields(ConcreteParameters)[name] for name in FACTORS}
    source = TEXT | {"description": "source of the factors for another age or temperature"}
    texts = [{"type": "string", "pattern": text_pattern(unit)} for unit in ("kg/m3", "m3/m3", "kg", "m3")]
    texts.append({"type": "string", "pattern": rf"^\s*{PER_BINDER.pattern}\s*$"})
    found = {
        **{name: TEXT | {"description": TEXT_DESCRIPTIONS[name]} for name in TEXTS},
        "elements": _object({name: field_schema(fields[name]) for name in known}, "parameters of discrete elements"),
        "flow": _object({name: field_schema(field) for name, field in constants.items()} | {FACTOR_SOURCE: source},
                        "constants of a yield stress fluid with a slip layer"),
        "mix": _mix_section(),
    }  # fmt: skip
    needed = [{"required": [key]} for key in (*SECTIONS, "mix", "base")]
    amount: Schema = {"anyOf": [{"type": "number"}, *texts]}
    return _file("A concrete of warpcrete", found) | {"anyOf": needed, "definitions": {"amount_of_ingredient": amount}}


def mix_schema() -> Schema:
    """Return the schema of a concrete's file with a mix design."""
    return concrete_schema() | {"title": "A mix of warpcrete", "required": ["mix"]}


def line_schema() -> Schema:
    """Return the schema of a pump line's file."""
    found = {name: TEXT | {"description": text} for name, text in LINE_TEXTS.items()}
    found |= {name: quantity(unit, text) for name, (unit, text) in AMOUNTS.items()}
    pump = {name: quantity(unit, text) for name, (unit, text) in PUMP.items()}
    found["pump"] = {"description": "data sheet of the pump, or its largest pressure",
                     "anyOf": [pump["pressure"], _object(pump, "", ["pressure"])]}  # fmt: skip
    factors = {name: quantity("1", text) for name, text in BEND_FACTOR.items()}
    found["bend_factor"] = {"description": BEND_FACTOR["factor"],
                            "anyOf": [factors["factor"], _object(factors, "", ["factor"])]}  # fmt: skip
    found["begin"] = {"enum": list(BEGINS), "description": "direction in which the line begins"}
    parts = [_object({kind: _part(kind)}, f"a {kind}", [kind]) for kind in PARTS]
    parts.append({"enum": list(WITHOUT_ENTRIES), "description": "a part without entries"})
    found["parts"] = {"type": "array", "minItems": 1, "maxItems": MOST_PARTS, "items": {"anyOf": parts},
                      "description": "parts in the order of the flow"}  # fmt: skip
    return _file("A pumping line of warpcrete", {name: found[name] for name in LINE_KEYS}) | {
        "required": ["diameter", "parts"]
    }


def targets_schema() -> Schema:
    """Return the schema of a calibration's file of targets."""
    known = {name: declared_fields(module.scene.parameters) for name, module in modules().items()}
    numbers = sorted({n for fields in known.values() for n, f in fields.items() if f.kind in (int, float)} - {"seed"})
    of_scene = {name: _object(_parameters(fields.values()), f"parameters of scene {name}") | _own_parameters(fields)
                for name, fields in known.items()}  # fmt: skip
    quantities = sorted({each.name for method in METHODS for each in method.quantities})
    end = {"type": ["number", "string"]}
    ends = {"type": "array", "items": end, "minItems": 2, "maxItems": 2}
    spread = _object({"low": end, "high": end, "scale": {"enum": ["log", "linear"]}}, "", ["low", "high"])
    target = _object(
        {
            "scene": {"enum": list(known), "description": "scene that measures the quantity"},
            "quantity": {"enum": quantities, "description": "quantity of the scene's result"},
            "value": end | {"description": "measured value, in SI units or with its unit"},
            "uncertainty": end | {"description": "standard deviation, in the unit of the value or as '5%' of it"},
            "parameters": {"type": "object", "description": "parameters of the scene"},
            "held_out": {"type": "boolean", "description": "predicted and compared, but not fitted"},
        },
        "a measured quantity of a scene",
        list(TARGET_KEYS[:4]),
    )
    target["allOf"] = [
        {
            "if": {"properties": {"scene": {"const": name}}},
            "then": {"properties": {"parameters": {"$ref": f"#/definitions/{name}"}}},
        }
        for name in known
    ]
    found = {
        "base": TEXT | {"description": ("name or file of the concrete that supplies all parameters which are not "
                                       "varied")},
        "vary": {"type": "object", "minProperties": 1, "propertyNames": {"enum": numbers},
                 "additionalProperties": {"anyOf": [ends, spread]}, "description": "free parameters and their ranges"},
        "targets": {"type": "array", "minItems": 1, "items": target, "description": "measured quantities"},
    }  # fmt: skip
    schema = _file("Targets of a calibration of warpcrete", found) | {"required": ["vary", "targets"]}
    return schema | {"definitions": of_scene}


def quantity(unit: str, text: str, number: Mapping[str, Any] | None = None) -> Schema:
    """Return the schema of a number in `unit`, or a text with a number and a common unit, such as "125 mm"."""
    shown = f"{text} [{unit}]" if unit != "1" and f"[{unit}]" not in text else text
    return {
        "description": shown,
        "anyOf": [{"type": "number", **(number or {})}, {"type": "string", "pattern": text_pattern(unit)}],
    }


def text_pattern(unit: str) -> str:
    """Return a regular expression for texts that hold an amount in `unit`, for a schema."""
    return rf"^\s*(?:{'|'.join(patterns(unit))})\s*$"


def field_schema(field: Field) -> Schema:
    """Return the schema of a declared parameter."""
    found: Schema = {"description": field.help}
    if field.kind is float:
        found = quantity(field.units, field.help, _bounds(field))
    elif field.kind is int:
        most = LARGEST_SEED if field.name == "seed" else LARGEST_INTEGER
        found |= {"type": "integer", "maximum": most, **_bounds(field)}
    elif field.kind is bool:
        found["type"] = "boolean"
    else:
        choices = next((list(rule.choices) for rule in field.of_kind(OneOf)), None)
        found |= {"enum": choices} if choices else {"type": "string"}
    if field.optional:
        found = {"description": field.help, "anyOf": [found, {"type": "null"}]}
    if field.default not in (MISSING, None):
        found["default"] = field.default
    return found


def _bounds(field: Field) -> Schema:
    """Return the smallest and largest allowed value of a parameter, as entries of its JSON schema.

    The two values follow from the rules of the parameter and, for a floating-point number, from the table of limits.
    """
    found: Schema = {}
    limit = limit_of(field.name, field.unit.strip())
    if field.kind is float and limit is not None:
        found = {"minimum": -limit.high, "maximum": limit.high}
    for rule in field.rules:
        if isinstance(rule, Above):
            found.pop("minimum", None)
            found["exclusiveMinimum"] = rule.lower
        if isinstance(rule, Within):
            if rule.lower > found.get("minimum", float("-inf")) and "exclusiveMinimum" not in found:
                found["minimum"] = rule.lower
            found["maximum"] = min(rule.upper, found.get("maximum", float("inf")))
    return {name: value for name, value in found.items() if abs(value) != float("inf")}


def _parameters(fields: Iterable[Field]) -> dict[str, Schema]:
    """Return the schemas of a scene's parameters by name."""
    return {field.name: field_schema(field) for field in fields}


def _own_parameters(fields: Mapping[str, Field]) -> Schema:
    """Return the part of a JSON schema that allows all names beginning with `contact_`, if `contact` is a parameter.

    Such names are parameters of an object, here of the contact law. The same holds for other objects.
    """
    prefixes = [name for name, field in fields.items() if any(field.of_kind(CompositeRule))]
    return {"patternProperties": {f"^{name}_": {} for name in prefixes}} if prefixes else {}


def _part(kind: str) -> Schema:
    """Return the schema of the entries that describe a part of a pump line; `kind` is its kind, such as "bend"."""
    special: dict[str, Schema] = {
        "to": {"enum": list(WAYS)},
        "file": {"type": "string"},
        "points": {"type": "array", "minItems": 1, "maxItems": MOST_POINTS,
                   "items": {"type": "array", "items": quantity("m", "coordinate"), "minItems": 3, "maxItems": 3}},
    }  # fmt: skip
    found = {}
    for name, (unit, text) in PARTS[kind].items():
        plain = name in special and (name != "to" or kind == "bend")
        found[name] = special[name] | {"description": text} if plain else quantity(unit, text)
    single = [found[next(iter(found))]] + ([found["points"]] if kind == "hose" else [])
    empty: list[Schema] = [{"type": "null"}] if kind in WITHOUT_ENTRIES else []
    return {"anyOf": [*single, _object(found), *empty]}


def _mix_section() -> Schema:
    """Return the schema of the section `mix` of a concrete's file."""
    amounts = {name: quantity(each.unit, each.help) for name, each in mixes.NUMBERS.items()}
    constants, of_concrete, of_layer = (
        {name: quantity(unit, name.replace("_", " ")) for name, unit in units.items()}
        for units in (measurements.UNITS, measurements.CONCRETE_UNITS, measurements.LAYER_UNITS)
    )
    off = {"uncertainty": quantity("1", "uncertainty of the values, as '15 %'")}
    passing = quantity("1", "fraction of the mass that passes")
    ingredient: Schema = {"description": "mass [kg/m3], or with its unit",
                          "allOf": [{"$ref": "#/definitions/amount_of_ingredient"}]}  # fmt: skip
    special: dict[str, Schema] = {
        "parts": parts_schema(ingredient),
        "aggregate": {"type": ["number", "string"]},
        "sieve": {"type": "object", "minProperties": 2, "additionalProperties": passing,
                  "propertyNames": {"pattern": text_pattern("m")}},
        "sizes": {"anyOf": [
            quantity("m", "diameter"),
            {"type": "array", "items": quantity("m", "diameter"), "minItems": 2, "maxItems": 2},
        ]},
        "shape": {"anyOf": [{"enum": list(stones.SHAPES)}, {"type": "number", "minimum": 1, "maximum": 20}]},
        "concrete": _object(of_concrete | off),
        "mortar": _object(constants | off | {"density": quantity("kg/m3", "density")}),
        "viscometer": _points(measurements.SHEARED),
        "thickener": {"type": "boolean"},
        "layer": {"anyOf": [
            _object({**of_layer, "viscosity": quantity("Pa s/m", "viscosity divided by thickness"), **off,
                     "from": {"enum": ["tribometer", "pipe"], "description": "origin of the constants"},
                     "gauges": {"enum": [measurements.CONTRADICTORY],
                                "description": "gauges of the pipe, if they contradict each other"}}, "",
                    ["yield_stress", "viscosity"]),
            _object({"points": _points(PUMPED), **{name: quantity("m", f"{name} of the pipe")
                                                   for name in ("diameter", "length", "rise")}}, "",
                    ["points", "diameter", "length"]),
            _object({"tribometer": _points(measurements.SLIPPED)}, "", ["tribometer"]),
        ]},
    }  # fmt: skip
    others = {name: special[name] | {"description": text} for name, text in mixes.OTHERS.items()}
    found = _object({name: {**amounts, **others}[name] for name in mixes.KEYS}, "known data of a mix")
    return found | {"anyOf": [{"required": ["density"]}, {"required": ["parts"]}]}


def _points(columns: Mapping[str, str]) -> Schema:
    """Return the schema of a list of number pairs, or of the path of a CSV file."""
    pair = [quantity(unit, name) for name, unit in columns.items()]
    pairs = {"type": "array", "minItems": 2,
             "items": {"type": "array", "items": pair, "minItems": 2, "maxItems": 2}}  # fmt: skip
    return {"anyOf": [{"type": "string"}, pairs]}


def _object(properties: Mapping[str, Schema], text: str = "", required: list[str] | None = None) -> Schema:
    found: Schema = {"type": "object", "additionalProperties": False, "properties": dict(properties)}
    if text:
        found["description"] = text
    return found | ({"required": required} if required else {})


def _file(title: str, properties: Mapping[str, Schema]) -> Schema:
    return {"$schema": DRAFT, "title": title, **_object(properties)}
