"""Share of bands of a fit that contain the true values, over invented trial lines with known answers.

The errors are drawn as the bands assume them: an error of each gauge, a scatter of its readings, a yield stress of the
slip layer in the range that is known of it, and a friction of bends and hoses in the range of published measurements.
"""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from warpcrete import SceneError
from warpcrete.studies.lines.fit import fit_line
from warpcrete.studies.lines.fittings import MODEL_ERRORS
from warpcrete.studies.lines.losses import line_of, straight_friction, with_layer_factor
from warpcrete.studies.lines.taps import Tap
from warpcrete.studies.lines.theory_line import line_by_theory
from warpcrete.theory.pipe import Concrete

NORMAL = 1.96
"""Standard deviations of a normal distribution between which 95 % of the values lie."""
LAYER = 1.7
"""Factor of the band of the slip layer from the paste, which contains nine of ten layers."""
KNOWN_YIELD = 251.0
"""Largest yield stress [Pa] of a slip layer if no mix states one."""
RATIOS = (0.5, 1.0, 2.0)
"""Ratios of the flows of the predictions to the mean flow of the gauges."""


def drawn_site(rng):
    """Return a trial line with up to five bends or risers, and in half of all cases a hose at its end."""
    parts = [{"straight": rng.uniform(10, 60)}]
    for k in range(rng.integers(0, 6)):
        if rng.random() < 0.35:
            parts += [{"bend": "up"}, {"straight": rng.uniform(5, 40)}, {"bend": "level"}]
        else:
            parts.append({"bend": ("left", "right")[k % 2]})
        parts.append({"straight": rng.uniform(5, 40)})
    if rng.random() < 0.5:
        parts.append({"hose": rng.uniform(4, 10)})
    return line_of({"diameter": "125 mm", "parts": parts})


def drawn_factor(rng, kind, value):
    """Return a true friction of fittings over straight pipe, with `value` as median and the range as 95 % limits."""
    error, deviation = MODEL_ERRORS[kind], rng.normal() / NORMAL
    return value * (error.high / value if deviation > 0 else value / error.low) ** deviation


def drawn_trial(rng, site, flows, places):
    """Return a trial line, its true copy, the expected and the true concrete, and the readings of gauges.

    The line has gauges at so many `places`, which are read at so many `flows`.
    """
    line = site(rng)
    expected = Concrete(
        density=2400.0, viscosity=np.exp(rng.uniform(np.log(20), np.log(120))),
        yield_stress=np.exp(rng.uniform(np.log(60), np.log(800))),
        slip_viscosity=np.exp(rng.uniform(np.log(200), np.log(2500))), slip_yield=rng.uniform(5, 50),
    )  # fmt: skip
    nine_of_ten = 1.645
    true = replace(
        expected, slip_viscosity=expected.slip_viscosity * LAYER ** (rng.normal() / nine_of_ten),
        slip_yield=rng.uniform(0, min(KNOWN_YIELD, expected.yield_stress)),
    )  # fmt: skip
    factors = {"bend": drawn_factor(rng, "bend", 1.04), "hose": drawn_factor(rng, "hose", 2.0)}
    actual = replace(line, parts=tuple(replace(part, factor=factors.get(part.kind)) for part in line.parts))
    rates = rng.choice([15, 20, 25, 30, 35, 40, 45], size=flows, replace=False) / 3600
    distances = [rng.uniform(0, 5), *rng.uniform(5, 0.75 * line.length, places - 1)]
    exact = {}
    for flow in rates:
        ends, course = line_by_theory(actual, true, flow).course(lambda x: x.friction + x.weight)
        exact |= {(place, flow): np.interp(place, ends, course) for place in distances}
    largest, scatter = max(exact.values()), rng.choice([0.002, 0.01, 0.02])
    errors = {place: 0.04 / NORMAL * largest * rng.normal() for place in distances}
    taps = [Tap(place, pressure + errors[place] + scatter * largest * rng.normal(), flow, row)
            for row, ((place, flow), pressure) in enumerate(exact.items(), 2)]  # fmt: skip
    return line, actual, expected, true, taps


def coverage(count, site=drawn_site, seed=0, flows=None, places=None):
    """Return the shares of bands that contain the true value, over `count` lines.

    The keys are the ratios of :data:`RATIOS` for the pressure at the pump, "viscosity" and "yield" for the constants of
    the fitted layer, and "later" for the friction of straight pipe with a layer for later use, at the worst of the
    three flows. Lines whose drawn errors are impossible, so that the fit refuses them, are drawn again.
    """
    rng, inside, number = np.random.default_rng(seed), Counter(), Counter()
    while number[1.0] < count:
        of_flows, of_places = flows or rng.integers(1, 4), places or rng.integers(1, 6)
        if of_flows * of_places < 2:
            continue
        line, actual, expected, true, taps = drawn_trial(rng, site, of_flows, of_places)
        known = with_layer_factor(expected, 1 / LAYER), with_layer_factor(expected, LAYER)
        try:
            fit = fit_line(line, expected, taps, known if rng.random() < 0.5 else None)
        except SceneError:
            continue
        own, mean = fit.concrete(expected), np.mean([tap.flow for tap in taps])
        for ratio in RATIOS:
            flow = ratio * mean
            answer = line_by_theory(fit.line(line), own, flow, variants=fit.variants(expected), fit=fit)
            inside[ratio] += answer.band().contains(line_by_theory(actual, true, flow).pressure)
            number[ratio] += 1
            low, friction, high = (straight_friction(line.parts[0], each, flow) for each in (
                with_layer_factor(own, 1 / (1 + fit.later_uncertainty)), true,
                with_layer_factor(own, 1 + fit.later_uncertainty)))  # fmt: skip
            inside["later", ratio] += low <= friction <= high
        for name, constant, value in zip(
            ("viscosity", "yield"), fit.constants[:2], (true.slip_viscosity, true.slip_yield), strict=True
        ):
            if constant.fitted:
                inside[name] += constant.low <= value <= constant.high
                number[name] += 1
    found = {key: inside[key] / number[key] for key in number}
    return found | {"later": min(inside["later", ratio] for ratio in RATIOS) / count}


def straight(rng):
    """Return a straight level line, on which only the gauges have errors."""
    return line_of({"diameter": "125 mm", "parts": [{"straight": 150}]})


def test_bands_contain_the_true_values_of_a_few_lines():
    """Count the first 16 lines of the next test. All shares are at least 0.93.

    The band of the fitted viscosity once contained the true one on 10 of these lines only.
    """
    assert min(coverage(16).values()) >= 0.9


@pytest.mark.thorough
def test_bands_contain_the_true_values_as_often_as_they_say():
    """Count 240 lines; a share of 0.95 has a standard error of 0.014.

    Measured: 0.967, 0.942 and 0.975 for the pressure, 0.975 and 0.969 for the constants, and 0.967 for later use.

    Before, the band of the fitted viscosity contained the true one in half of all cases, because it left out the errors
    of the fittings and of an unknown yield stress.
    """
    assert {key: share for key, share in coverage(240).items() if not 0.91 <= share <= 0.995} == {}


@pytest.mark.thorough
@pytest.mark.parametrize(("flows", "places"), [(2, 2), (3, 1), (3, 5)])
def test_errors_of_gauges_count_once_and_never_too_little(flows, places):
    """Count 100 straight lines, and compare with the once measured shares at half, one and two times the mean flow.

    Two gauges at two flows once gave 0.78, 0.99 and 0.91, because single readings then had no error of their own. Five
    gauges at three flows gave 0.98, with bands 1.3 times as wide, because errors of the gauges counted as scatter too.
    """
    shares = coverage(100, straight, flows=flows, places=places)
    assert all(0.9 <= shares[ratio] <= 1 for ratio in RATIOS), shares
