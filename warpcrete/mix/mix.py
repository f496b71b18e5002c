"""Mix of a concrete, built from a mapping (`mix_of`) or a file (`read_mix`), and the parameters that follow from it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..core.drawing.html import html_table
from ..core.errors import SceneError, between, positive, refuse
from ..core.inputs.amounts import amount
from ..core.inputs.concretes import FACTOR_KEYS, NamedConcrete, concrete, known_only
from ..core.inputs.customary import both
from ..core.inputs.text_files import errors_in_file, errors_located_at
from ..core.inputs.yaml_files import merged
from ..core.records import SceneArguments
from ..core.run.tables import dataframe
from ..theory.pipe import Concrete, scaled
from .entries import MixEntries
from .figures import Figure, around, reconciled, short
from .layer import ASSUMPTION, OF_PASTE, layers
from .measurements import Layer
from .reading import DENSITY_TOLERANCE, USUAL_AIR, read
from .rheology import mortar, unknown_viscosity, viscosities, yield_stresses

FLOW = {"density": "density", "viscosity": "viscosity", "yield_stress": "yield stress",
        "slip_viscosity": "slip viscosity", "slip_yield": "slip yield"}  # fmt: skip
"""Names of the constants in the section `flow` of a concrete's file, each mapped to the name of the same property of a
mix."""
LAWS = {"flow_index": "flow index", "quadratic_viscosity": "quadratic viscosity", "slip_flow_index": "slip flow index",
        "slip_quadratic_viscosity": "slip quadratic viscosity"}  # fmt: skip
"""Names of the constants that only flow laws other than Bingham's have; each is mapped to the name of the same property
of a mix. A mix has such a constant only if its description states the value."""
FACTORS = dict.fromkeys(FACTOR_KEYS, 1.0)
"""Names and default values of two factors on yield stresses and viscosities. The section `flow` of a concrete's file
may state them, to describe the concrete at another age or temperature."""
CAUSES = {"slip layer": ("slip_viscosity", "slip_yield"), "viscosity of the bulk": ("viscosity",),
          "yield stress of the bulk": ("yield_stress",), "density": ("density",)}  # fmt: skip
"""Causes of uncertainty, each with the constants of the concrete whose uncertainty it causes.

If several constants have one cause, all of them are assumed to be at the lower ends of their uncertainty bands, or all
at the upper ends.
"""
BULK = ("viscosity of the bulk", "yield stress of the bulk")
"""Causes of uncertainty that are left out if the slip layer was fitted to a trial line with this concrete. The fitted
layer then compensates an error in the viscosity or the yield stress of the bulk, because the fit makes bulk and layer
give the measured pressures."""
UNITS = {"density": "kg/m3", "viscosity": "Pa s", "yield_stress": "Pa", "slip_viscosity": "Pa s/m", "slip_yield": "Pa",
         "flow_index": "1", "quadratic_viscosity": "Pa s2", "slip_flow_index": "1",
         "slip_quadratic_viscosity": "Pa s2/m2", **dict.fromkeys(FACTORS, "1")}  # fmt: skip
WEIGHING = 0.01
"""Relative uncertainty of a density that the mix states."""
GAUGES_CONTRADICT = (
    "the slip layer was fitted to a trial line whose gauges contradict each other; find out why before you use it"
)
"""Remark on a slip layer that was fitted to gauge pressures which contradict each other."""
COLUMNS = ("quantity", "value", "unit", "band", "from", "source")


NO_AIR = "the mix states no air content"
"""Beginning of the remark on a mix without the entry `air`."""


@dataclass(frozen=True, repr=False)
class Mix:
    """Mix of a concrete, with all properties calculated from it."""

    name: str
    source: str
    given: MixEntries
    figures: tuple[Figure, ...]
    """All properties calculated from the mix, in SI units."""
    remarks: tuple[str, ...] = ()
    """Warnings about the mix that are printed with the results."""
    other_layers: tuple[tuple[Figure, Figure], ...] = ()
    """Estimates of the slip layer that are not used, each a pair of viscosity and yield stress."""
    factors: tuple[float, float] = (1.0, 1.0)
    """Factors on yield stresses and on viscosities that account for another age or temperature of the concrete, from
    the section `flow` of the concrete's file."""

    def __repr__(self) -> str:
        return f"<Mix {self.name!r}: {', '.join(f'{f.name} {f.span}' for f in self.figures[:5])}>"

    def _repr_html_(self) -> str:
        """Return the table of properties as HTML, for notebooks."""
        return html_table((tuple(row.values()) for row in self.rows()), COLUMNS)

    def __getitem__(self, name: str) -> Figure:
        """Return the property called `name`, such as 'yield stress' or 'slip viscosity'."""
        known = {figure.name: figure for figure in self.figures}
        if name not in known:
            refuse("figure", name, f"must be one of {', '.join(known)}")
        return known[name]

    @property
    def concrete(self) -> Concrete:
        """Concrete of the mix, a yield stress fluid with a slip layer, at the age and temperature set by `factors`."""
        return scaled(self._plain, *self.factors)

    @property
    def _plain(self) -> Concrete:
        """Concrete of the mix before its constants are multiplied by the factors for another age or temperature."""
        return Concrete(name=self.name, **self.flow)

    @property
    def _constants(self) -> dict[str, str]:
        """Names of the constants of the concrete's flow law, each mapped to the name of the property of the mix.

        An example is "slip_yield", mapped to "slip yield". Constants that only flow laws other than Bingham's have,
        such as "flow_index", are included only if the mix states them.
        """
        known = {figure.name for figure in self.figures}
        return FLOW | {key: name for key, name in LAWS.items() if name in known}

    @property
    def variants(self) -> dict[str, tuple[Concrete, Concrete]]:
        """Pairs of concretes that differ in one cause of uncertainty, by the name of the cause.

        A cause, such as "slip layer", comprises properties of the concrete. The first concrete of a pair has these
        properties at the lower ends of their bands, and the second at the upper ends. All other properties have
        their best values. A cause whose bands have no width is left out. The causes that concern the bulk are also left
        out if the layer was fitted to a trial line.
        """
        pairs = {}
        for cause, keys in CAUSES.items():
            if cause in BULK and self.given.layer.is_of_this_delivery:
                continue
            ends = [{key: getattr(self[FLOW[key]], end) for key in keys} for end in ("low", "high")]
            if ends[0] != ends[1]:
                low, high = (scaled(replace(self._plain, **end), *self.factors) for end in ends)
                pairs[cause] = (low, high)
        return pairs

    @property
    def layer_yields(self) -> tuple[float, float] | None:
        """Range of the slip layer's yield stress [Pa], as (lowest, highest).

        None if the layer's constants were fitted to pressures of a pipe, or if the yield stress has no uncertainty. If
        the mix contains measurements of the layer, the range is the band of the measured value. Otherwise it contains
        the bands of all estimates, because the estimate from the paste holds for self-compacting concrete only, and
        the layer of a stiffer concrete has a larger yield stress. If the mix states no slump, the range extends to the
        yield stress of the concrete. The range never exceeds the upper end of the band of this yield stress.
        """
        own, concrete, measured = self["slip yield"], self["yield stress"].high, self.given.layer
        if measured.pipe or own.low == own.high:
            return None
        low, high = own.low, own.high
        if measured == Layer():
            others = [tau for _, tau in self.other_layers]
            low, high = min(each.low for each in (own, *others)), max(each.high for each in (own, *others))
            high = min(high if self.given.slump is not None else max(high, concrete), concrete)
        return self.factors[0] * low, self.factors[0] * high

    @property
    def band_origin(self) -> str:
        """Origin of the uncertainty band of the slip viscosity: 'fit', 'contradicted', 'paste' or 'other'.

        - 'fit': fit to a trial line. The band contains the pressures in 95 % of cases.
        - 'contradicted': fit to a trial line whose gauges contradict each other. The confidence is unknown.
        - 'paste': composition of the paste. The band contains the measured values of nine of ten concretes.
        - 'other': any other estimate or measurement.
        """
        if self.given.layer.contradicted:
            return "contradicted"
        if self.given.layer.is_of_this_delivery:
            return "fit"
        return "paste" if self["slip viscosity"].way.endswith(OF_PASTE) else "other"

    @property
    def flow(self) -> dict[str, float]:
        """Constants for the section `flow` of a concrete's file, such as the yield stress.

        The constants are not yet multiplied by the factors for another age or temperature of the concrete.
        """
        return {key: self[name].value for key, name in self._constants.items()}

    @property
    def elements(self) -> SceneArguments:
        """Sizes and shapes of aggregates for the section `elements` of a concrete's file.

        This section needs neither density nor slip layer, because they follow from the section `flow`.
        """
        given, entries = self.given, {}
        if given.sieve is not None:
            entries["sizes"] = ",".join(f"{1e3 * opening:.6g}:{passing:.6g}" for opening, passing in given.sieve)
        elif given.sizes is not None:
            entries |= {"size_min": given.sizes[0], "size_max": given.sizes[1]}
        if given.shape is not None:
            entries["shapes"] = given.shape
        return entries

    @property
    def aggregates(self) -> dict[str, float]:
        """Parameters of the coarse aggregate in a two-phase flow; empty if the share of coarse aggregate is unknown."""
        if self.given.share is None:
            return {}
        return {
            "aggregate_fraction": self.given.share,
            "aggregate_density": self.given.aggregate_density,
            "mortar_viscosity": self["mortar's viscosity"].value,
            "mortar_yield": self["mortar's yield stress"].value,
        }

    def rows(self) -> list[dict[str, str]]:
        """Return the rows of the table of properties; each maps the column names (:data:`COLUMNS`) to text.

        The last rows describe the aggregate's share, sizes and shape.
        """
        table = []
        for each in self.figures:
            band = f"{short(each.low)} to {short(each.high)}" if each.low < each.high else ""
            table.append((each.name, f"{each.value:.4g}", each.unit, band, each.way, each.source))
        given = self.given
        if given.share is not None:
            table.append(("aggregate", f"{given.share:.4g}", "of the volume", "", "aggregate",
                          f"{given.aggregate_density:g} kg/m3"))  # fmt: skip
        for name, value in self.elements.items():
            table.append((name, f"{value:g}" if isinstance(value, float) else value,
                          "m" if name.startswith("size_") else "mm:passing" if name == "sizes" else "", "",
                          "shape" if name == "shapes" else "sieve" if given.sieve else "sizes",
                          "as simulated with discrete elements"))  # fmt: skip
        return [dict(zip(COLUMNS, row, strict=True)) for row in table]

    def table(self) -> Any:
        """Return the properties as a pandas DataFrame in SI units, with the name of the quantity as index.

        The columns are value, ends of the uncertainty band, unit, origin and source. Raises :class:`WarpcreteError` if
        pandas is not installed.
        """
        figures = self.figures
        columns = {key: [getattr(each, key) for each in figures] for key in ("value", "low", "high", "unit", "source")}
        columns = {"quantity": [each.name for each in figures], **columns, "from": [each.way for each in figures]}
        return dataframe(columns, {}, "quantity", "mix.rows() or mix.text()")

    def text(self) -> str:
        """Return the table of properties as plain text."""
        rows = [dict(zip(COLUMNS, COLUMNS, strict=True)), *self.rows()]
        wide = {name: max(len(row[name]) for row in rows) for name in COLUMNS[:-1]}
        return "\n".join("  ".join([*(row[name].ljust(wide[name]) for name in wide), row["source"]]) for row in rows)


def read_mix(name: Path | str) -> Mix:
    """Read a mix from a file, or the mix of a shipped concrete by its name.

    Raises :class:`SceneError` if the mix contradicts itself or does not determine the concrete.
    """
    mix = mix_in(concrete(str(name)))
    if mix is None:
        refuse("mix", str(name), "has no section 'mix'", "'warpcrete mix --help' shows an example")
    return mix


def mix_named(name: str) -> Mix | None:
    """Return the mix of a concrete that is given by its name or the path of its file.

    The result is None if the concrete's file has no section `mix`, and for the name `own`, under which users state all
    constants themselves.
    """
    return None if name == "own" else mix_in(concrete(name))


def mix_in(found: NamedConcrete) -> Mix | None:
    """Return the mix of a concrete, or None if the concrete has no mix.

    Constants in the concrete's own section `flow` take precedence over constants that are calculated from the mix.
    """
    if found.mix is None:
        return None
    stated = known_only("flow", found.mix.flow, {**FLOW, **LAWS, **FACTORS}, found.name)
    for key, value in stated.items():
        with errors_located_at(stated, key):
            stated[key] = _flow_amount(key, value)
    yields, viscous = (stated.pop(key, plain) for key, plain in FACTORS.items())
    with errors_in_file(getattr(found.mix.values, "path", None)):
        mix = mix_of(found.mix.values, found.mix.folder, found.name, found.source, stated)
    if yields == viscous == 1.0:
        return mix
    said = f"the table does not include {factors_text((yields, viscous), found.factor_source)}"
    return replace(mix, factors=(yields, viscous), remarks=(*mix.remarks, said))


def factors_text(factors: tuple[float, float], source: str) -> str:
    """Return a text on the `factors` on yield stresses and viscosities that a concrete's file states.

    `source` is the source of the factors; empty if the file states none.
    """
    origin = f"source: {source}" if source else "no source stated"
    return (
        f"the factors in the section 'flow', which multiply yield stresses by {factors[0]:g} and viscosities by "
        f"{factors[1]:g} ({origin})"
    )


def mix_of(
    given: Mapping[str, object], folder: Path = Path(), name: str = "mix", source: str = "",
    stated: Mapping[str, float] | None = None,
) -> Mix:  # fmt: skip
    """Build a mix from the entries of a section `mix`.

    Paths of files with measured points are relative to `folder`. `stated` are constants of the flow, which replace
    calculated constants. Raises :class:`SceneError` if the entries contradict each other or do not determine the yield
    stress.
    """
    entries = read(given, folder)
    way = "sum of the parts" if entries.summed else "density"
    error = DENSITY_TOLERANCE if entries.summed else WEIGHING
    bulk = {"density": around("density", entries.density, error, "kg/m3", way, "as given")}
    bulk |= {_named(key, value).name: _named(key, value) for key, value in (stated or {}).items()}
    laws = _laws(entries, bulk)
    thickens = {key: laws[name].value for key, name in LAWS.items() if name in laws}
    bends = any(key in thickens for key in ("flow_index", "quadratic_viscosity"))
    remarks = []
    for wanted, candidates in (("yield stress", yield_stresses(entries)), ("viscosity", viscosities(entries))):
        tells = list(candidates) if wanted not in bulk else []
        if wanted == "viscosity" and bends:
            # Slump flow and the straight line through a viscometer's points determine the viscosity of a Bingham fluid
            # only. For a law whose flow curve is not straight, the mix must state the viscosity itself.
            tells = [each for each in tells if each.way == "concrete"]
            if not tells and wanted not in bulk:
                raise SceneError(
                    "mix viscosity: is missing, but must be stated if the mix has a flow index or a "
                    "quadratic viscosity; add 'viscosity' to the same section"
                )
        if tells:
            bulk[wanted], more = reconciled(tells)
            remarks += more
    if "yield stress" not in bulk:
        hint = "add a measurement: 'spread', 'slump', 'viscometer', 'mortar' or 'concrete'"
        refuse("mix", ", ".join(given), "contains no entry from which the yield stress of the concrete follows", hint)
    bulk.setdefault("viscosity", unknown_viscosity(entries))
    fluid = Concrete(
        name=name, density=bulk["density"].value, viscosity=bulk["viscosity"].value,
        yield_stress=bulk["yield stress"].value, slip_viscosity=1.0, slip_yield=0.0, **thickens,
    )  # fmt: skip
    first, *others = layers(entries, fluid, bulk["viscosity"])
    slip = {figure.name: figure for figure in first} | bulk
    others = tuple(pair for pair in others if pair[0].way != ASSUMPTION)
    remarks += [f"another estimate of the slip viscosity: {each.span} from {each.way}" for each, _ in others]
    figures = [*(slip[each] for each in FLOW.values()), *laws.values()]
    if entries.layer.contradicted:
        remarks.append(GAUGES_CONTRADICT)
    if entries.sand_and_stone is not None and given.get("air") is None:
        left = both(entries.customary, "l/m3", entries.sand_and_stone, digits=3)
        remarks.append(
            f"{NO_AIR}: {100 * USUAL_AIR:g} % is assumed, which leaves {left} for sand "
            "and stones; state it as in 'air: 2 %'"
        )
    if entries.sieve is None and entries.sizes is None:
        remarks.append(
            "the mix has no sieve curve: simulations with discrete elements use the sizes that the scene "
            "states, by default 5 to 20 mm"
        )
    return Mix(name, source, entries, (*figures, *mortar(entries, fluid, bulk)), tuple(remarks), others)


def _laws(entries: MixEntries, bulk: Mapping[str, Figure]) -> dict[str, Figure]:
    """Return the stated constants of flow laws other than Bingham's, by the name of the property."""
    figures = {}
    slip = entries.layer.constants.values if entries.layer.constants is not None else {}
    for key, name in LAWS.items():
        part, own = ("layer", slip) if key.startswith("slip_") else ("concrete", entries.concrete.values)
        entry = key.removeprefix("slip_")
        if name in bulk:
            figures[name] = bulk[name]
        elif entry in own:
            figures[name] = Figure(name, own[entry], own[entry], own[entry], UNITS[key], part, "as given")
    return figures


def _named(key: str, value: object) -> Figure:
    """Return a constant that the section `flow` of a concrete's file states, as a property without uncertainty."""
    value = _flow_amount(key, value)
    return Figure({**FLOW, **LAWS}[key], value, value, value, UNITS[key], "flow", "as given")


def _flow_amount(key: str, value: object) -> float:
    """Return the entry `key` of the section `flow` of a concrete's file as a number in its SI unit, after checks."""
    number = amount(f"concrete flow {key}", value, UNITS[key])
    if key in ("yield_stress", "slip_yield", "quadratic_viscosity", "slip_quadratic_viscosity"):
        between(f"concrete flow {key}", number, 0, math.inf, UNITS[key])
    else:
        positive(f"concrete flow {key}", number, UNITS[key])
    return number


def flow_amounts(found: NamedConcrete) -> dict[str, float]:
    """Return the flow constants and factors given in the description of a concrete, as numbers in SI units.

    Raises :class:`SceneError` for an unknown constant, and for an impossible value.
    """
    flow = known_only("flow", found.flow, UNITS, found.name)
    for key, value in flow.items():
        with errors_located_at(found.flow, key):
            flow[key] = _flow_amount(key, value)
    return flow


def completed(name: str) -> NamedConcrete:
    """Return the concrete with a given name or file path, including the sections that follow from its mix.

    Entries that the concrete's own file states take precedence over entries that follow from its mix. Entries from the
    mix take precedence over entries of the concrete on which the file is based.
    """
    known_concrete = concrete(name)
    mix = mix_in(known_concrete)
    if known_concrete.mix is None or mix is None:
        return known_concrete
    elements = merged(known_concrete.elements, mix.elements, known_concrete.mix.elements)
    flow = merged(known_concrete.flow, mix.flow, known_concrete.mix.flow)
    return replace(known_concrete, elements=elements, flow=flow)
