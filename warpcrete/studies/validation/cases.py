"""Measured cases: their files, entries and sources, and the choice of cases that are held out (never fitted)."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...core.errors import SceneError, known_names, one_of, positive, refuse
from ...core.inputs.amounts import amount
from ...core.inputs.limits import check_limit
from ...core.inputs.text_files import errors_in_file, errors_located_at, read_mapping
from .kinds import AMOUNTS, BLOCKING, TESTS, UNITS

SHIPPED = Path(__file__).parents[2] / "measured" / "cases"
FILE_KEYS = ("sources", "lines", "cases")
KEYS = ("id", "kind", "group", "source", "where", "mix", "flow", "measured", "scatter", "uncertainty", "note",
        "test", "basis")  # fmt: skip
"""Entries of a measured case in a file. The prediction is made from `mix`, `test` and `flow`. If `flow` lists several
values, `measured` lists one measured value for each of them."""
BASES = ("measurement", "model", "guideline")
"""Possible origins of the value with which a prediction is compared: a measurement (the default), a model that was
fitted to measurements, or a guideline with empirical relations between properties of concrete."""
SCATTER_KEYS = ("concretes", "from", "to")
"""Entries of a case's section `scatter`, which describes the concretes of which the measured value is the mean."""
BY_FLOW = ("pipe", "ratio", "line", "fitting", "profile")
"""Kinds of cases whose prediction depends on a flow rate."""
HELD_OUT_SHARE = 3
"""Number n such that one of n groups of cases is held out. The cases of a held-out group are not used to fit
constants."""
FITTED = {
    "slump": ("yeh-2007", "ferraris-1998"),
    "fitting": ("park-2020", "calibe"),
    "layer": ("suzuki-2004",),
    "blocking": ("tuutti-1976", "coils-10mm", "coils-20mm", "coils-30mm", "concrete-construction", "nara"),
}
"""Groups of cases, by kind, that determined constants or rules of the program and are therefore never held out.

The slump cases determined the height at the centre of a heap and the uncertainty bands of yield stresses. The other
cases determined the range of the friction of bends, the factor of a viscosity-modifying admixture, and limits of the
rules against blocking. Most groups were used before the held-out groups were chosen. Two groups led to the rule on
lightweight aggregate: the earlier rules missed a blockage in `concrete-construction`, and `nara` is the publication
that states the rule.
"""

ADDED = {
    "funnel": ("efnarc-2005",),
    "blocking": (
        "frankfurt-1977", "calibe", "houston-1979", "mayco", "sahara-1994", "uchino-1973", "matsuo-1986",
    ),
}  # fmt: skip
"""Groups of cases that were added after all constants of the program had been chosen, by kind. All of them are held
out."""


@dataclass(frozen=True)
class Case:
    """Measured case: the measured values, and the inputs that a user would have known before the measurement."""

    name: str
    kind: str
    group: str
    """Name of the mix, line or laboratory that several cases share. Either all cases of a group are fitted, or all of
    them are held out."""
    source: str
    """Publication that reports the measurement, with the table, figure or section."""
    mix: Mapping[str, Any]
    """Section `mix` of a concrete's file, as a user would write it."""
    test: Mapping[str, Any]
    """Dimensions of the pipe, the part, the line or the apparatus in which the case was measured."""
    flows: tuple[float, ...]
    """Flow rates at which the values were measured [m3/s], one for each value; empty if the kind needs no flow."""
    measured: tuple[float, ...]
    """Measured values, in the SI unit that belongs to the kind of the case."""
    concretes: int = 1
    """Number of concretes whose mean is the measured value."""
    ends: tuple[float, float] | None = None
    """Smallest and largest value among the concretes whose mean is `measured`, in the SI unit of the case's kind; None
    if the case is a single concrete."""
    basis: str = BASES[0]
    """Origin of the values in `measured`: a measurement, a model or a guideline (:data:`BASES`)."""
    note: str = ""
    lines: Mapping[str, Any] = field(default_factory=dict, repr=False)
    """Descriptions of the pump lines in the case's file; the keys are the lines' names."""
    folder: Path = SHIPPED


def held_out_groups(cases: Sequence[Case]) -> set[tuple[str, str]]:
    """Return the groups of cases that are held out, as pairs of kind and group. No fit of a constant uses these cases.

    Two kinds of groups are held out:

    - For each kind of measurement, about a third of the groups that were known when constants were fitted. A hash of
      the groups' names selects them, so that nobody can choose groups after seeing the results.
    - All groups that were added after the fits (:data:`ADDED`).
    """
    found = set()
    for kind in {case.kind for case in cases}:
        added = {case.group for case in cases if case.kind == kind and case.group in ADDED.get(kind, ())}
        groups = {case.group for case in cases if case.kind == kind} - added
        count = round(len(groups) / HELD_OUT_SHARE)
        free = sorted(groups - set(FITTED.get(kind, ())), key=lambda name: hashlib.sha256(name.encode()).hexdigest())
        found |= {(kind, name) for name in (*free[:count], *added)}
    return found


def shipped_cases() -> list[Case]:
    """Return all cases that are shipped with the package, in the order of their files."""
    return [case for path in sorted(SHIPPED.glob("*.yaml")) for case in read_cases(path)]


def read_cases(path: Path) -> list[Case]:
    """Read the measured cases in a file.

    Raises :class:`SceneError` if an entry is unknown or missing, or if two cases have the same name.
    """
    given = read_mapping(path, "cases")
    with errors_in_file(path):
        return _cases(given, path.parent)


def _cases(given: Mapping[str, object], folder: Path) -> list[Case]:
    """Return the cases in the contents `given` of a file; paths in the contents are relative to `folder`."""
    for key in given:
        with errors_located_at(given, key):
            one_of("key of a file of cases", key, FILE_KEYS)
    entries = given.get("cases")
    with errors_located_at(given, "cases"):
        if not isinstance(entries, Sequence) or isinstance(entries, str) or not entries:
            problem = "must be a list of measured cases"
            refuse("cases", entries, problem, "for example '- {id: a, kind: slump, source: smith, measured: 200 mm}'")
    sources, lines = (_mapping(given, key) for key in ("sources", "lines"))
    found = []
    for number, entry in enumerate(entries):
        with errors_located_at(entries, number):
            found.append(_case(entry, sources, lines, folder))
    names = [case.name for case in found]
    for number, name in enumerate(names):
        if name in names[:number]:
            with errors_located_at(entries, number):
                refuse("case id", name, "is used twice", "give every case its own id")
    return found


def _case(given: object, sources: Mapping[str, object], lines: Mapping[str, object], folder: Path) -> Case:
    if not isinstance(given, Mapping):
        refuse("case", given, "must consist of 'key: value' lines", "begin with 'id: ...'")
    for key in given:
        with errors_located_at(given, key):
            one_of("key of a case", key, KEYS)
    for key in ("id", "kind", "source", "measured"):
        if key not in given:
            refuse("case", str(given.get("id", "")), f"has no {key!r}", f"add '{key}: ...'")
    one_of("case kind", given["kind"], UNITS)
    one_of("case source", given["source"], sources)
    basis = given.get("basis", BASES[0])
    one_of("case basis", basis, BASES)
    unit = UNITS[given["kind"]]
    with errors_located_at(given, "flow"):
        flows = tuple(amount("case flow", x, "m3/s") for x in _listed(given.get("flow", [])))
        for flow in flows:
            check_limit("case flow", flow, "m3/s", "flow")
    with errors_located_at(given, "measured"):
        measured = _measured(given["measured"], given["kind"], unit)
    if given["kind"] in BY_FLOW and not flows:
        raise SceneError(
            f"case flow: is missing in a case of kind {given['kind']!r}; add it, for example 'flow: 30 m3/h'"
        )
    if flows and len(flows) != len(measured):
        problem = f"must have one value for each of the {len(flows)} flows"
        refuse("case measured", f"{len(measured)} values", problem, "list the values in the order of the flows")
    concretes, ends = _scatter(_mapping(given, "scatter"), unit)
    usable = len(measured) == 1 and given["kind"] not in ("line", BLOCKING)
    if ends is not None and not (usable and ends[0] <= measured[0] <= ends[1]):
        refuse("case scatter", dict(given["scatter"]), "needs a single measured value, which lies between 'from' and "
               "'to', and a case of another kind than 'line' and 'blocking'", "leave out 'scatter'")  # fmt: skip
    where = str(given.get("where", ""))
    return Case(
        name=str(given["id"]),
        kind=str(given["kind"]),
        group=str(given.get("group", given["id"])),
        source=f"{sources[given['source']]}{', ' + where if where else ''}",
        mix=_mapping(given, "mix"),
        test=_test(_mapping(given, "test"), given["kind"], str(given["id"])),
        flows=flows,
        measured=measured,
        concretes=concretes,
        ends=ends,
        basis=basis,
        note=str(given.get("note", "")),
        lines=lines,
        folder=folder,
    )


def _scatter(given: Mapping[str, object], unit: str) -> tuple[int, tuple[float, float] | None]:
    """Return the number of concretes over which a mean was taken, and their smallest and largest value in `unit`."""
    if not given:
        return 1, None
    for key in given:
        one_of("key of a scatter", key, SCATTER_KEYS)
    for key in SCATTER_KEYS:
        if key not in given:
            refuse(
                "case scatter", dict(given), f"has no {key!r}", "for example {concretes: 6, from: 5 kPa/m, to: 8 kPa/m}"
            )
    concretes = given["concretes"]
    if not isinstance(concretes, int) or concretes < 2:
        problem = "must be a whole number of at least 2, because one concrete alone has no scatter"
        refuse("case scatter: concretes", concretes, problem, "for one concrete, leave out 'scatter'")
    low, high = (amount(f"case scatter: {key}", given[key], unit) for key in ("from", "to"))
    if not 0 < low < high:
        problem = "must reach from a positive value to a larger one"
        refuse("case scatter", dict(given), problem, "write the smallest value under 'from'")
    return concretes, (low, high)


def _measured(given: object, kind: str, unit: str) -> tuple[float, ...]:
    """Return the measured values of a case in `unit` after checking them."""
    found = tuple(amount("case measured", each, unit) for each in _listed(given))
    if not found:
        refuse("case measured", given, "has no value", "write the measured value with its unit")
    for value in found:
        if kind != BLOCKING:
            positive("case measured", value, unit)
        elif value not in (0.0, 1.0):
            refuse("case measured", value, "must be 1 if the concrete blocked, or 0 if it did not")
        if kind == "profile" and value > 1:
            refuse("case measured", value, "must be at most 1, because it is a share of the largest velocity")
    return found


def _test(given: Mapping[str, Any], kind: str, name: str) -> Mapping[str, Any]:
    """Return the section `test` of the case `name` after checking it.

    The section must have exactly the entries that `kind` needs. Amounts must be positive, and the reference, another
    concrete, must be a section like `mix`.
    """
    for key in given:
        with errors_located_at(given, key):
            if key not in TESTS[kind]:
                needed = known_names(key, TESTS[kind]) if TESTS[kind] else "leave it out"
                refuse("case test", key, f"is not an entry of a case of kind {kind!r}", needed)
    for key in TESTS[kind]:
        if key not in given:
            refuse("case test", name, f"has no {key!r}", f"add '{key}: ...'")
        with errors_located_at(given, key):
            if key in AMOUNTS:
                positive(f"case test: {key}", amount(f"case test: {key}", given[key], AMOUNTS[key]), AMOUNTS[key])
            if key == "reference" and not (isinstance(given[key], Mapping) and given[key]):
                hint = "describe the other concrete like 'mix', for example {spread: 650 mm, density: 2350}"
                refuse("case test: reference", given[key], "must consist of 'key: value' entries", hint)
    return given


def _mapping(given: Mapping[str, object], key: str) -> Mapping[str, Any]:
    """Return the mapping under `key`, or an empty mapping if the entry is missing; refuse any other value."""
    found = given.get(key) or {}
    with errors_located_at(given, key):
        if not isinstance(found, Mapping):
            refuse(f"cases {key}", found, "must consist of 'key: value' lines")
    return found


def _listed(given: object) -> Sequence[Any]:
    """Return a list of values as it is, and a single value as a list with one entry."""
    return given if isinstance(given, Sequence) and not isinstance(given, str) else [given]
