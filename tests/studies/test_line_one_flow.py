"""Fit to gauges that were all read at one flow, and its band at other flows."""

from dataclasses import replace

import numpy as np
import pytest
from test_line_fit import KNOWN, TRUE, known, taps

from warpcrete.studies.lines.fit import fit_line
from warpcrete.studies.lines.fit_report import fit_lines
from warpcrete.studies.lines.losses import line_of
from warpcrete.studies.lines.taps import Tap
from warpcrete.studies.lines.theory_line import line_by_theory

FLAT = line_of({"diameter": "125 mm", "parts": [{"straight": 150}]})
GUESS = replace(TRUE, yield_stress=200.0, slip_viscosity=600.0, slip_yield=40.0)


def inside(count, seed=1):
    """Return how many of `count` bands contain the true pressure, at 0.5, 1 and 2 times the flow of the gauges."""
    rng, flow, found = np.random.default_rng(seed), 30 / 3600, np.zeros(3)
    for _ in range(count):
        true = replace(GUESS, slip_viscosity=rng.uniform(100, 2000), slip_yield=rng.uniform(0, 150))
        course = line_by_theory(FLAT, true, flow).pressure
        points = [Tap(x, course * (1 - x / 150) + 0.02 * course * rng.normal(), flow, 0) for x in (0.0, 50.0, 100.0)]
        fit = fit_line(FLAT, GUESS, points)
        for k, ratio in enumerate((0.5, 1.0, 2.0)):
            own = line_by_theory(FLAT, fit.concrete(GUESS), ratio * flow, variants=fit.variants(GUESS), fit=fit)
            found[k] += own.band().contains(line_by_theory(FLAT, true, ratio * flow).pressure)
    return found / count


def test_the_band_at_other_flows_covers_the_pressures_of_unknown_layers():
    found = inside(60)
    assert np.all(found >= 0.88), found


def test_one_flow_leaves_the_band_at_this_flow_and_widens_it_at_others():
    one, two = (fit_line(KNOWN, TRUE, taps(flows=flows), known(TRUE, 2)) for flows in ((30,), (20, 30)))
    assert one.later_uncertainty is not None and one.later_uncertainty > 1.1 * one.uncertainty

    def factor(flow, cause):
        ends = {"slip layer": one.variants(TRUE)["slip layer"]} if cause else one.variants(TRUE)
        return line_by_theory(KNOWN, one.concrete(TRUE), flow / 3600, variants=ends, fit=one).band().factor

    assert factor(30, False) == pytest.approx(factor(30, True), rel=1e-6)
    for flow in (15, 60):
        # The ratio is 2.04 at half the flow, and 1.47 at twice the flow.
        assert factor(flow, False) - 1 > 1.4 * (factor(flow, True) - 1)
    text = "\n".join(fit_lines(one, KNOWN))
    assert "All gauges were read at 30 m3/h; at another flow the band is wider, because" in text
    assert f"uncertainty: {100 * one.later_uncertainty:.3g} %, from: pipe" in text
    assert "All gauges" not in "\n".join(fit_lines(two, KNOWN))


def test_the_report_compares_the_fit_with_what_was_expected():
    before = replace(TRUE, slip_viscosity=200.0)
    text = "\n".join(fit_lines(fit_line(KNOWN, before, taps(), known(before, 1.5)), KNOWN))
    assert "times that expected from the concrete's file; outside of the band expected from it: slip viscosity" in text
