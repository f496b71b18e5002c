"""Pipe flow of a concrete whose aggregate is apart: known limits, continuity, the published trend, the command."""

import math
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from warpcrete import SceneError
from warpcrete.cli import cli
from warpcrete.theory.pipe import CONCRETES, Concrete, Line, steady, steady_of_stress
from warpcrete.theory.segregated import Segregated
from warpcrete.theory.suspension import SUSPENSIONS, thickening

PIPE = Line(radius=0.0625, length=1.0, rise=0.0)


@pytest.mark.parametrize("thickness", [0.0, 2e-3, 0.04])
@pytest.mark.parametrize("name", CONCRETES)
def test_even_concrete_is_buckingham_and_reiners(name, thickness):
    line = replace(PIPE, slip_thickness=thickness)
    for flow in (1e-4, 5e-3, 0.05):
        known = steady(CONCRETES[name], line, flow)
        found = Segregated(CONCRETES[name], line, 0.36, 0.0).steady(flow)
        assert found.wall_stress == pytest.approx(known.wall_stress, rel=1e-12)
        assert found.pressure == pytest.approx(known.pressure, rel=1e-12)
    known = steady_of_stress(CONCRETES[name], line, 400.0)
    found = Segregated(CONCRETES[name], line, 0.36, 0.0).of_stress(400.0)
    assert (found.flow, found.slip_velocity, found.plug_radius) == pytest.approx(
        (known.flow, known.slip_velocity, known.plug_radius), rel=1e-12
    )


def test_without_yield_stress_it_is_flow_of_a_core_in_an_annulus():
    """Q = pi G / 8 ((R^4 - a^4) / mu_outer + a^4 / mu_inner), of two Newtonian fluids."""
    fluid = Concrete(density=2300, viscosity=80.0, yield_stress=0.0, slip_viscosity=1e12, slip_yield=0.0)
    apart = Segregated(fluid, PIPE, 0.36, -0.3)
    inner, outer = (80.0 * thickening(share, *SUSPENSIONS["spheres"])[0] / thickening(0.36, *SUSPENSIONS["spheres"])[0]
                    for share in (0.36 * 1.225, 0.36 * 0.925))  # fmt: skip
    stress, radius = 500.0, PIPE.radius
    gradient, core = 2 * stress / radius, radius / 2
    exact = math.pi * gradient / 8 * ((radius**4 - core**4) / outer + core**4 / inner)
    assert apart.of_stress(stress).flow == pytest.approx(exact, rel=1e-8)


def test_flow_is_the_integral_of_the_shear_rate():
    """The flow equals a quadrature of the shear rate, also where the inner zone yields before the outer zone does."""
    for index in (-0.4, 0.4, 1.0):
        apart = Segregated(replace(CONCRETES["no1"], yield_stress=250.0), PIPE, 0.36, index)
        edges = np.concatenate([np.linspace(0, 0.5, 40001)[:-1], np.linspace(0.5, 1, 40001)]) * PIPE.radius
        middle, width = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
        zones = [apart.zones[int(r > 0.5 * PIPE.radius)] for r in middle[[0, -1]]]
        outside = middle > 0.5 * PIPE.radius
        yields = np.where(outside, zones[1].yield_stress, zones[0].yield_stress)
        viscosity = np.where(outside, zones[1].viscosity, zones[0].viscosity)
        rate = np.maximum(600.0 * middle / PIPE.radius - yields, 0.0) / viscosity
        slip = (600.0 - apart.concrete.slip_yield) / apart.concrete.slip_viscosity
        exact = math.pi * np.sum(middle**2 * rate * width) + math.pi * PIPE.radius**2 * slip
        assert apart.of_stress(600.0).flow == pytest.approx(exact, rel=1e-7)


@pytest.mark.parametrize("slip_viscosity", [800.0, 1e9])
def test_aggregate_that_leaves_the_wall_lowers_the_pressure(slip_viscosity):
    """The pressure falls, as measured on a model concrete (Materials 13 (2020), PMC7084984)."""
    concrete = replace(CONCRETES["no3"], slip_viscosity=slip_viscosity)
    stresses = [Segregated(concrete, PIPE, 0.36, index).steady(8e-3).wall_stress for index in (-0.8, -0.5, 0.0, 0.5)]
    assert np.all(np.diff(stresses) > 0)
    assert sum(Segregated(concrete, PIPE, 0.36, -0.5).shares * np.array([0.25, 0.75])) == pytest.approx(0.36)


def test_steady_is_the_inverse_of_stress():
    apart = Segregated(CONCRETES["no2"], PIPE, 0.3, -0.2)
    for stress in (200.0, 600.0, 3000.0):
        assert apart.steady(apart.of_stress(stress).flow).wall_stress == pytest.approx(stress, rel=1e-9)


@pytest.mark.parametrize(
    ("fraction", "index", "message"),
    [
        (0.36, -0.9, "segregation = -0.9"),
        (0.36, 1.4, "segregation = 1.4"),
        (0.6, 0.0, "aggregate = 0.6"),
        (0.0, 0.0, "aggregate = 0"),
        (0.36, float("nan"), "segregation = nan"),
    ],
)
def test_what_cannot_be_is_refused(fraction, index, message):
    with pytest.raises(SceneError, match=message):
        Segregated(CONCRETES["no1"], PIPE, fraction, index)


def test_command_prints_what_segregation_does(tmp_path):
    done = CliRunner().invoke(cli, ["theory", "--concrete", "example-scc", "--diameter", "0.125", "--rise", "0",
                                    "--flow", "0.008", "--segregation", "-0.2", "--segregation", "0"])  # fmt: skip
    assert done.exit_code == 0, done.output
    rows = [line.split() for line in done.output.splitlines() if line.strip().startswith(("-0.2 ", "0 "))]
    assert [row[0] for row in rows] == ["-0.2", "0"]
    assert float(rows[0][-1]) < float(rows[1][-1]) == 1
    for options, message in (
        (["--segregation", "-0.2"], "aggregate = None"),
        (["--aggregate", "0.3"], "has no effect without --segregation"),
    ):
        refused = CliRunner().invoke(cli, ["theory", "--concrete", "no1", *options])
        assert refused.exit_code != 0 and message in refused.output + str(refused.exception)
