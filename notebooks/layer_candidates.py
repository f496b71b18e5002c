"""Comparison of the ways to estimate the slip layer of a concrete from its mix, on the same measured cases.

    python notebooks/layer_candidates.py

Prints two Markdown tables, which notebooks/validation/measurements-more.md shows and discusses. The cases of the first
table are the level lines of `warpcrete validate` (twelve families of concretes and Zhao et al. 2024) and the slip
layers of three concretes of Xu, Li & Jiang (2021). The second table compares frictions of one concrete relative to
another. For each case, only the slip layer differs between the candidates. The yield stress and the viscosity of the
bulk are those that `warpcrete mix` derives.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from warpcrete.core.inputs.amounts import amount
from warpcrete.mix.layer import (
    ASSUMED,
    ASSUMED_ERROR_FACTOR,
    ASSUMPTION,
    ESTIMATE,
    FILM_ERROR_FACTOR,
    PASTE_ERROR_FACTOR,
    PASTE_YIELD,
    SLUMP_ERROR_FACTOR,
    THICKENER_ERROR,
    THICKENER_FACTOR,
    TRIBOMETER_RATIO,
    film_layer,
    paste_layer,
    slump_layer,
)
from warpcrete.mix.mix import Mix
from warpcrete.mix.reading import USUAL_AIR
from warpcrete.mix.rheology import HEAP_CENTRE_MEDIAN, unknown_viscosity
from warpcrete.studies.validation.cases import Case, held_out_groups, shipped_cases
from warpcrete.studies.validation.predictions import mix_of_case
from warpcrete.theory.inverse import BASE, HEIGHT, TOP
from warpcrete.theory.pipe import Line, steady
from warpcrete.theory.vessels import tall_cone_slump

WATER = 170.0
"""Water [kg/m3] assumed for concretes of which only the ratio of water to binder is published. The film between the
aggregates depends on it."""
RATIO_POWER = -1.5
"""Exponent of the ratio of water to binder in the simplest candidate."""
BEST_FIT = (150.0, 0.95)
"""Layer's viscosity without powder [Pa s/m] and densest packing of powder that fit nine families best."""
ORDINARY = 0.4
"""Ratio of water to binder above which a family counts as ordinary concrete; all other families are below 0.3."""


@dataclass(frozen=True)
class Layer:
    """Estimated slip layer: viscosity over thickness [Pa s/m] and yield stress [Pa], each as (value, low, high)."""

    viscosity: tuple[float, float, float]
    stress: tuple[float, float, float]


Candidate = Callable[[Case, Mix], Layer | None]


def of_factor(value: float, error: float, stress: tuple[float, float, float] = PASTE_YIELD) -> Layer:
    """Return a layer whose viscosity may be wrong by the factor `error`."""
    return Layer((value, value / error, value * error), stress)


def slump_of(mix: Mix) -> float:
    """Return the measured slump [m], or the slump that the program predicts from the yield stress of the mix."""
    if mix.given.slump is not None:
        return mix.given.slump
    concrete = mix.concrete
    return tall_cone_slump(TOP, BASE, HEIGHT, concrete.yield_stress, concrete.density) - HEAP_CENTRE_MEDIAN


def assumed(case: Case, mix: Mix) -> Layer:
    """Return the layer that the program assumes for a concrete without any data."""
    return of_factor(ASSUMED[0], ASSUMED_ERROR_FACTOR, (ASSUMED[1], 0.0, 5 * ASSUMED[1]))


def of_xu(case: Case, mix: Mix) -> Layer:
    """Return the mean layer of Xu, Li & Jiang (2021), which earlier versions used for all mixes, with their band."""
    return of_factor(886.0, 3.0, (231.0, 77.0, 693.0))


def of_slump(case: Case, mix: Mix) -> Layer:
    """Return the layer by JGJ/T 10, after Morinaga (1973)."""
    value, stress = slump_layer(slump_of(mix))
    return of_factor(value, SLUMP_ERROR_FACTOR, (stress, stress / SLUMP_ERROR_FACTOR, stress * SLUMP_ERROR_FACTOR))


def of_film(case: Case, mix: Mix) -> Layer | None:
    """Return the layer of paste between the aggregates; None if the viscosity of the concrete was not measured."""
    return None if mix["viscosity"].way.startswith((ASSUMPTION, ESTIMATE)) else film(mix)


def film(mix: Mix) -> Layer | None:
    """Return the layer of paste between the aggregates, with 170 kg/m3 of water if the amount is not published."""
    aggregate = mix.given.sand_and_stone
    if aggregate is None:
        if mix.given.paste_solids is None:
            return None
        powder = WATER / 1000 * mix.given.paste_solids / (1 - mix.given.paste_solids)
        aggregate = 1 - WATER / 1000 - powder - USUAL_AIR
    viscosity = mix["viscosity"]
    value, low, high = (film_layer(x, aggregate) for x in (viscosity.value, viscosity.low, viscosity.high))
    return Layer((value, low / FILM_ERROR_FACTOR, high * FILM_ERROR_FACTOR), PASTE_YIELD)


def of_guessed_film(case: Case, mix: Mix) -> Layer | None:
    """Return the layer of paste between the aggregates with the viscosity that the program assumes without data."""
    figure = unknown_viscosity(replace(mix.given, paste_solids=None, sand_and_stone=None))
    figures = tuple(figure if each.name == "viscosity" else each for each in mix.figures)
    return film(replace(mix, figures=figures))


def of_ratio(constant: float) -> Candidate:
    """Return the candidate `constant` (w/b)^-1.5, with the band of the powder in the paste."""

    def candidate(case: Case, mix: Mix) -> Layer | None:
        ratio = mix.given.water_binder
        return None if ratio is None else of_factor(constant * ratio**RATIO_POWER, PASTE_ERROR_FACTOR)

    return candidate


def of_best_fit(case: Case, mix: Mix) -> Layer | None:
    """Return the layer from the powder in the paste with the constants that fit the families best."""
    solids = mix.given.paste_solids
    if solids is None:
        return None
    constant, densest = BEST_FIT
    return of_factor(constant * (1 - solids / densest) ** (-2.5 * densest), PASTE_ERROR_FACTOR)


def of_paste(case: Case, mix: Mix) -> Layer | None:
    """Return the layer from the powder in the paste, without a factor for admixtures."""
    solids = mix.given.paste_solids
    return None if solids is None else of_factor(paste_layer(solids), PASTE_ERROR_FACTOR)


def of_paste_and_agent(case: Case, mix: Mix) -> Layer | None:
    """Return the layer from the powder in the paste, times a stated factor for a viscosity-modifying admixture."""
    plain = of_paste(case, mix)
    if plain is None or not mix.given.thickener:
        return plain
    return of_factor(THICKENER_FACTOR * plain.viscosity[0], PASTE_ERROR_FACTOR * THICKENER_ERROR)


def measured_layer(case: Case, mix: Mix) -> Layer | None:
    """Return the layer that the case states, as measured by a tribometer."""
    own = mix.given.layer.constants
    if own is None:
        return None
    ends = (1.0, *TRIBOMETER_RATIO)
    eta, tau = (own.values[key] for key in ("viscosity", "yield_stress"))
    return Layer((eta, eta * ends[1], eta * ends[2]), (tau, tau * ends[1], tau * ends[2]))


def value_of(case: Case, mix: Mix, viscosity: float, stress: float) -> float:
    """Return the friction per metre [Pa/m] of the case's pipe, or the wall stress [Pa] of its layer."""
    concrete = replace(mix.concrete, slip_viscosity=viscosity, slip_yield=min(stress, mix.concrete.yield_stress))
    if case.kind == "layer":
        return float(concrete.layer_law.stress(amount("speed", case.test["speed"], "m/s")))
    line = Line(radius=amount("diameter", case.test["diameter"], "m") / 2, length=1.0, rise=0.0)
    return steady(concrete, line, case.flows[0]).pressure


@dataclass(frozen=True)
class Score:
    """Prediction of one case by one candidate."""

    case: Case
    held_out: bool
    value: float
    low: float
    high: float

    @property
    def error(self) -> float:
        """Logarithm of the factor between prediction and measurement."""
        return abs(math.log(self.value / self.case.measured[0]))

    @property
    def inside(self) -> float:
        """Share of the case's concretes inside the band; those of a family are spread evenly between its ends."""
        if self.case.ends is None:
            return float(self.low <= self.case.measured[0] <= self.high)
        first, last = self.case.ends
        below, above = max(first, self.low), min(last, self.high)
        return math.log(above / below) / math.log(last / first) if above > below else 0.0


def score(case: Case, held_out: bool, candidate: Candidate) -> Score | None:
    """Return the prediction of a case by a candidate; None if the case lacks the data that the candidate needs."""
    mix = mix_of_case(case)
    layer = candidate(case, mix)
    if layer is None:
        return None
    value, low, high = (value_of(case, mix, layer.viscosity[k], layer.stress[k]) for k in range(3))
    return Score(case, held_out, value, low, high)


def ratio_of(scores: Sequence[Score], measured: bool) -> float:
    """Return the median friction of self-compacting families over that of ordinary families, over all pairs."""
    values = {True: [], False: []}
    for each in scores:
        ordinary = float(each.case.mix["water_binder"]) > ORDINARY
        values[ordinary].append(each.case.measured[0] if measured else each.value)
    return float(np.median([a / b for a, b in itertools.product(values[False], values[True])]))


def percent(scores: Sequence[Score]) -> str:
    """Return the median error of predictions as text."""
    return f"{100 * (math.exp(float(np.median([each.error for each in scores]))) - 1):.0f} %" if scores else "-"


def candidates_of(fitted: Sequence[Case]) -> dict[str, Candidate]:
    """Return the candidates by their description; the constant of one of them is fitted to the cases `fitted`."""
    logs = []
    for case in fitted:
        plain = value_of(case, mix_of_case(case), 1000.0, PASTE_YIELD[0])
        logs.append(math.log(1000 * case.measured[0] / plain / float(case.mix["water_binder"]) ** RATIO_POWER))
    constant = math.exp(float(np.median(logs)))
    return {
        "mean layer of Xu, Li & Jiang for all concretes, 886 Pa s/m and 231 Pa": of_xu,
        "assumption without data, 850 Pa s/m": assumed,
        "slump: JGJ/T 10, after Morinaga": of_slump,
        "film between the aggregates, viscosity of 70 Pa s guessed": of_guessed_film,
        "film between the aggregates, viscosity measured": of_film,
        f"{constant:.0f} (water/binder)^-1.5 Pa s/m": of_ratio(constant),
        "powder in the paste, constants 150 and 0.95": of_best_fit,
        "powder in the paste": of_paste,
        "powder in the paste, times 3.0 for a viscosity-modifying admixture": of_paste_and_agent,
        "tribometer": measured_layer,
    }


def friction_rows(candidates: dict[str, Candidate], chosen: Sequence[Case], held: set[tuple[str, str]]) -> list[str]:
    """Return the table of frictions and layers as lines of Markdown."""
    found = ["| slip layer from | families, fitted | families, held out | self-compacting over ordinary | inside | "
             "factor of band | Xu no1 to no3 | Zhao 2024 |", "|---" * 8 + "|"]  # fmt: skip
    for name, candidate in candidates.items():
        scores = [score(case, (case.kind, case.group) in held, candidate) for case in chosen]
        known = [each for each in scores if each is not None]
        families = [each for each in known if each.case.ends is not None]
        cells = [name, *(percent([x for x in families if x.held_out == held_out]) for held_out in (False, True))]
        if families:
            count = sum(each.case.concretes for each in families)
            share = sum(each.case.concretes * each.inside for each in families) / count
            factor = np.median([math.sqrt(x.high / x.low) for x in families])
            cells += [f"{ratio_of(families, False):.2f}", f"{100 * share:.0f} %", f"{factor:.2f}"]
        else:
            cells += ["-"] * 3
        for kind in ("layer", "pipe"):
            single = [each for each in known if each.case.kind == kind and each.case.ends is None]
            cells.append(", ".join(f"{each.value / each.case.measured[0]:.2f}" for each in single) or "-")
        found.append(f"| {' | '.join(cells)} |")
    return found


def ratio_rows(candidates: dict[str, Candidate], cases: Sequence[Case]) -> list[str]:
    """Return the table of frictions relative to another concrete as lines of Markdown."""
    found = [f"| slip layer from | {' | '.join(case.name for case in cases)} |", "|---" * (len(cases) + 1) + "|"]
    found.append(f"| measured | {' | '.join(f'{case.measured[0]:.2f}' for case in cases)} |")
    for name, candidate in candidates.items():
        cells = [name]
        for case in cases:
            values = []
            for section in (case.mix, case.test["reference"]):
                mix = mix_of_case(case, section)
                layer = candidate(replace(case, mix=section), mix)
                values.append(None if layer is None else value_of(case, mix, layer.viscosity[0], layer.stress[0]))
            over, under = values
            cells.append("-" if over is None or under is None else f"{over / under:.2f}")
        found.append(f"| {' | '.join(cells)} |")
    return found


def main() -> None:
    """Score all candidates and print the tables."""
    cases = shipped_cases()
    held = held_out_groups(cases)
    chosen = [case for case in cases if case.kind in ("pipe", "layer")]
    families = [case for case in chosen if case.ends is not None]
    candidates = candidates_of([case for case in families if ("pipe", case.group) not in held])
    print("\n".join(friction_rows(candidates, chosen, held)))
    published = [each for case in families if (each := score(case, False, of_paste)) is not None]
    print(f"\nself-compacting over ordinary in the published values: {ratio_of(published, True):.2f}\n")
    print("\n".join(ratio_rows(candidates, [case for case in cases if case.kind == "ratio"])))


if __name__ == "__main__":
    main()
