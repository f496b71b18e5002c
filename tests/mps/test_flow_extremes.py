"""Flows at the edge: each stays within bounds, is refused, or stops with an error that names time, quantity, cures."""

import dataclasses

import pytest

from warpcrete.core.errors import InstabilityError
from warpcrete.verification import flow_extremes

CASES = list(flow_extremes.scenes())
SINGLES = [case for case in CASES if not case[0].startswith("corner")]
CORNERS = [case for case in CASES if case[0].startswith("corner")]
SLOW = ("3D: no slip for 1 s", "3D: a concrete that shears, for 1 s", "3D: spacing of 20 across", "2D: aggregate 0.6")


@pytest.mark.thorough
@pytest.mark.parametrize(
    "case",
    [pytest.param(c, id=c[0], marks=pytest.mark.slow) if c[0] in SLOW else pytest.param(c, id=c[0]) for c in SINGLES],
)
def test_extreme_flow(device, case):
    name, make, steps = case
    found = flow_extremes.outcome(name, make, device, "float32", steps)
    assert found.acceptable, found


@pytest.mark.slow
@pytest.mark.parametrize("case", SINGLES, ids=[case[0] for case in SINGLES])
def test_extreme_flow_in_double_precision(device, case):
    name, make, steps = case
    found = flow_extremes.outcome(name, make, device, "float64", steps)
    assert found.acceptable, found


@pytest.mark.thorough
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_corners_of_flows_stay_within_bounds_or_stop(device, precision):
    found = [flow_extremes.outcome(name, make, device, precision, steps) for name, make, steps in CORNERS]
    assert len(found) == 2 ** len(flow_extremes.AXES)
    wrong = [o for o in found if not o.acceptable]
    assert not wrong, wrong
    assert sum(not o.stopped for o in found) > len(found) / 3
    assert f"of {len(found)} corners of viscosity" in flow_extremes.table(found)


def test_what_the_matrix_does_not_accept(monkeypatch):
    """A flow that bursts, crowds or loses volume without being stopped; one that stops without saying why."""
    good = flow_extremes.outcome("2D: x", flow_extremes.column, "cpu", "float32", 20)
    assert good.acceptable and good.closest > 0.9 and good.expected_outcome == "run"
    for changes in (dict(balance=0.3), dict(volume=0.02), dict(speed=5.0), dict(closest=0.1),
                    dict(expected_outcome="not converge"),
                    dict(stopped="t = 1 s: x; usual cures: y")):  # fmt: skip
        assert not dataclasses.replace(good, **changes).acceptable, changes
    with monkeypatch.context() as patch:  # an error that names no cure
        patch.setattr("warpcrete.mps.particles.MovingParticles.take",
                      lambda self, steps: (_ for _ in ()).throw(InstabilityError("t = 0 s: burst")))  # fmt: skip
        bad = flow_extremes.outcome("2D: y", flow_extremes.column, "cpu", "float32", 20)
    assert bad.stopped == "t = 0 s: burst" and not bad.acceptable
