"""Parts of a calibration: uncertainties of targets, and what follows from samples of a posterior."""

import math

import numpy as np
import pytest

from warpcrete.scenes import modules
from warpcrete.studies.calibration.posterior import Emulator, Posterior, confounded_pairs, insensitive_targets
from warpcrete.studies.calibration.targets import FreeParameter, Target, Task, read_task

FREE = (FreeParameter("slip_yield", 0.0, 100.0, False, False), FreeParameter("viscosity", 1.0, 10000.0, True, False))
"""Free parameters on a linear and on a logarithmic scale."""


@pytest.mark.parametrize(("stated", "deviation"), [("5%", 600.0), (" .5 % ", 60.0), ("0.3 kPa", 300.0), ("250", 250.0)])
@pytest.mark.parametrize(("value", "pressure"), [("12e3", 12e3), ("-12 kPa", -12e3)])
def test_an_uncertainty_is_above_0_whatever_the_sign_of_the_value(tmp_path, stated, deviation, value, pressure):
    """The pressure of a falling pipe may be negative; a percentage is one of its magnitude."""
    path = tmp_path / "targets.yaml"
    path.write_text(
        "vary: {slip_viscosity: [500, 2000]}\n"
        "targets:\n"
        f"  - {{scene: tube, parameters: {{concrete: no1}}, quantity: pressure, value: {value}, "
        f"uncertainty: '{stated}'}}\n",
        encoding="utf-8",
    )
    (target,) = read_task(path, modules())[0].targets
    assert (target.value, target.uncertainty) == pytest.approx((pressure, deviation))


class Fake:
    """Emulator of a quantity that grows by `slope` with the first parameter, with the uncertainty 4 + 3 times it."""

    def __init__(self, slope: float, scatter: float) -> None:
        self.slope, self.scatter = slope, scatter

    def __call__(self, points):
        return 50 + self.slope * points[:, 0], 4 + 3 * points[:, 0]


def made(slope=20.0, scatter=0.0):
    target = Target("tube", "pressure", 60.0, 10.0, {}, False, "Pa")
    samples = np.array([[0.0, 0.1], [0.5, 0.3], [1.0, 0.2], [0.5, 0.4]])
    return target, Posterior(Task(None, FREE, (target,)), {target: Fake(slope, scatter)}, samples, np.array([0.5, 0.9]))


def test_a_prediction_has_the_spread_of_the_samples_and_the_error_of_the_emulator():
    """The predicted means are 50, 60, 70 and 60, their variance is 50, and the mean squared error (16 + 2 30.25 + 49) /
    4 = 31.375."""
    target, found = made()
    assert found.predicted(target) == pytest.approx((60.0, math.sqrt(50 + 31.375)))
    assert found.predicted(target, np.zeros((3, 2))) == pytest.approx((50.0, 4.0))
    assert found.emulator_error_ratio(target) == pytest.approx(math.sqrt(31.375) / 10)
    assert np.isnan(found.predicted(Target("tube", "flow", 1.0, 1.0, {}, True, "m3/s"))).all()


def test_intervals_are_in_the_scale_of_a_parameter_and_hold_the_likeliest_value():
    """Half of the samples lie between the places 0.375 and 0.625 of the first parameter. Of the second, the likeliest
    value, 0.9, lies above all of them."""
    _, found = made()
    assert found.interval(0, 0.5) == pytest.approx((37.5, 62.5))
    low, high = found.interval(1, 1.0)
    assert (low, high) == pytest.approx((10**0.4, 10**3.6))
    assert found.relative_width(0) == pytest.approx(math.sqrt(0.125 * 12))


def test_parameters_that_move_together_and_targets_that_nothing_moves_are_named():
    _, found = made()
    correlation = found.correlations()[0, 1]
    assert correlation == pytest.approx(np.cov(found.samples.T)[0, 1] / np.prod(found.samples.std(0, ddof=1)))
    assert confounded_pairs(found, abs(correlation) - 1e-9) == [("slip_yield", "viscosity", pytest.approx(correlation))]
    assert confounded_pairs(found, abs(correlation) + 1e-9) == []
    for slope, scatter, insensitive in ((2.1, 0.0, False), (1.9, 0.0, True), (20.0, 19.0, False), (20.0, 21.0, True)):
        target, found = made(slope, scatter)
        assert (target in insensitive_targets(found, [target])) == insensitive


def test_the_uncertainty_of_a_prediction_leaves_out_the_scatter_of_single_runs():
    """With twenty seeds at each of three places, the mean there is known to a fraction of the scatter, which is 5."""
    pytest.importorskip("sklearn")
    places = np.repeat([0.0, 0.5, 1.0], 20)[:, None]
    values = 100.0 + 40.0 * places[:, 0] + np.random.default_rng(4).normal(0.0, 5.0, 60)
    emulator = Emulator(places, values, 1e-3)
    assert emulator.scatter == pytest.approx(5.0, rel=0.15)
    mean, deviation = emulator(np.array([[0.0], [0.5], [1.0]]))
    assert np.all(deviation > 0) and np.all(deviation < 0.25 * emulator.scatter)
    assert mean == pytest.approx([100.0, 120.0, 140.0], abs=2.0)
