"""The theory of Bingham flow with slip, against the paper's figures, its own integrals and its limits."""

import dataclasses
import functools

import numpy as np
import pytest
from click.testing import CliRunner

from warpcrete.cli.main import cli
from warpcrete.core.errors import SceneError
from warpcrete.theory.pipe import (
    CONCRETES,
    FORMS,
    Concrete,
    Line,
    _flow_at,
    after_rest,
    flow_of_pressure,
    kaplan,
    least_stress,
    measured_layer,
    restart,
    steady,
    steady_of_stress,
    velocity,
)

LINE = Line()
FLOW = 1500e-6


@pytest.mark.parametrize(
    ("name", "form", "pressure", "slip"),
    [
        # Xu, Li & Jiang 2021 print 9.40 kPa and 18.6 cm/s for the first; the others are ours, worked by hand.
        ("no1", "paper", 9428.5, 0.1857), ("no1", "plane", 9423.2, 0.1847), ("no1", "pipe", 11929.3, 0.1857),
        ("no2", "paper", 9269.5, 0.1845), ("no3", "paper", 9119.9, 0.1835),
    ],
)  # fmt: skip
def test_published_case(name, form, pressure, slip):
    state = steady(CONCRETES[name], LINE, FLOW, form)
    assert state.pressure == pytest.approx(pressure, abs=0.1)
    assert state.slip_velocity == pytest.approx(slip, abs=6e-5)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("thickness", [0.0, 4e-3])
@pytest.mark.parametrize("name", CONCRETES)
def test_flow_is_the_integral_of_the_profile(name, thickness, form):
    line = Line(slip_thickness=thickness)
    state = steady(CONCRETES[name], line, FLOW, form)
    assert state.flow == pytest.approx(FLOW, rel=1e-12)
    inner = line.radius - thickness
    r = (np.arange(200_000) + 0.5) / 200_000 * inner
    above = velocity(CONCRETES[name], line, state, r) - state.slip_velocity
    weight = np.ones_like(r) / line.radius if form == "plane" else 2 * r / line.radius**2
    mean = state.slip_velocity + float(np.sum(above * weight)) * inner / len(r)
    assert np.pi * line.radius**2 * mean == pytest.approx(FLOW, rel=1e-8)


@pytest.mark.parametrize("layer_law", [{}, {"slip_flow_index": 0.8}, {"slip_quadratic_viscosity": 30.0}])
@pytest.mark.parametrize("form", FORMS)
def test_the_flow_that_the_search_uses_has_the_bits_of_the_steady_state(form, layer_law):
    """Compare at the least stress, just above the yield stress, and far beyond both."""
    random = np.random.default_rng(3)
    for _ in range(100):
        viscosity, yields, layer, slip_yield = (10.0 ** random.uniform((-1, 0, 1, 0), (3, 3, 6, 3))).tolist()
        concrete = Concrete(density=2300.0, viscosity=viscosity, yield_stress=yields, slip_viscosity=layer,
                            slip_yield=slip_yield, **layer_law)  # fmt: skip
        for line in (Line(radius=0.07), Line(radius=0.07, slip_thickness=1e-3)):
            flow_at, least = _flow_at(concrete, line, form), least_stress(concrete, line)
            for stress in (least, yields, 1.00001 * yields, least + 1.0, 3.7 * least, 1e9):
                assert flow_at(stress) == steady_of_stress(concrete, line, stress, form).flow


def test_profile_is_level_in_the_plug_and_falls_to_the_slip_velocity():
    state = steady(CONCRETES["no1"], LINE, FLOW)
    assert state.plug_radius == pytest.approx(22.79e-3, abs=1e-5)
    inside = velocity(CONCRETES["no1"], LINE, state, [0.0, 0.99 * state.plug_radius])
    assert inside[0] == inside[1]
    assert velocity(CONCRETES["no1"], LINE, state, [LINE.radius])[0] == pytest.approx(state.slip_velocity, rel=1e-12)
    # tau = tau_b + mu |dv/dr| between
    r = np.array([0.03, 0.04])
    slope = (
        velocity(CONCRETES["no1"], LINE, state, r - 1e-6) - velocity(CONCRETES["no1"], LINE, state, r + 1e-6)
    ) / 2e-6
    assert 190 + 397 * slope == pytest.approx(state.wall_stress * r / LINE.radius, rel=1e-6)


@pytest.mark.parametrize("form", FORMS)
def test_pressure_and_flow_are_inverse(form):
    for flow in (1e-6, 1e-4, 3e-3):
        state = steady(CONCRETES["no2"], LINE, flow, form)
        assert flow_of_pressure(CONCRETES["no2"], LINE, state.pressure, form).flow == pytest.approx(flow, rel=1e-9)


def test_what_yields_first_flows_first():
    # The bulk of No.1 is sheared from 190 Pa on, the layer slips from 251 Pa on; with a stiffer bulk it is a plug.
    assert steady_of_stress(CONCRETES["no1"], LINE, 190.0).flow == 0
    stuck = steady_of_stress(CONCRETES["no1"], LINE, 250.0)
    assert stuck.slip_velocity == 0 and stuck.flow > 0
    stiff = dataclasses.replace(CONCRETES["no1"], yield_stress=2000.0)
    plug = steady_of_stress(stiff, LINE, 300.0)
    assert plug.flow == pytest.approx(np.pi * LINE.radius**2 * 49 / 893, rel=1e-12)
    assert velocity(stiff, LINE, plug, [0.0, LINE.radius]) == pytest.approx(plug.slip_velocity, rel=1e-12)


def test_newtonian_limit_is_poiseuille():
    water = Concrete(density=1000, viscosity=1.0, yield_stress=0, slip_viscosity=1e15, slip_yield=0)
    level = Line(rise=0, length=1.0)
    assert steady(water, level, 1e-4).pressure == pytest.approx(8 * 1e-4 / (np.pi * 0.05**4), rel=1e-9)
    plane = steady(water, level, np.pi * 0.05**2 * 0.1, "plane")  # mean velocity 0.1 m/s between planes 0.1 m apart
    assert plane.pressure == pytest.approx(3 * 0.1 / 0.05**2, rel=1e-9)


def test_constants_of_thicker_slip_layers():
    """Table 3: eta_L falls with the assumed thickness, tau_L0 hardly."""
    printed = {"no1": (889, 885, 882), "no2": (839, 834, 831), "no3": (914, 908, 902)}
    for name, concrete in CONCRETES.items():
        stresses = np.linspace(1.05 * concrete.slip_yield, concrete.slip_yield + 0.4 * concrete.slip_viscosity, 8)
        states = [steady_of_stress(concrete, LINE, s) for s in stresses]
        flows, pressures = [s.flow for s in states], [s.pressure for s in states]
        found = measured_layer(concrete, LINE, flows, pressures)
        constants = concrete.slip_viscosity, concrete.slip_yield
        assert (found.slope, found.offset) == pytest.approx(constants, rel=1e-9)
        for thickness, eta in zip((2e-3, 4e-3, 6e-3), printed[name]):
            found = measured_layer(concrete, Line(slip_thickness=thickness), flows, pressures)
            assert found.slope == pytest.approx(eta, rel=7e-3)  # flows of the measurement are not printed
            assert found.offset == pytest.approx(concrete.slip_yield, abs=1.0)


def test_kaplan_is_the_theory_without_its_last_term():
    slow = steady(CONCRETES["no1"], LINE, 1e-5)
    assert slow.wall_stress > CONCRETES["no1"].yield_stress
    for flow in (FLOW, 5e-3, 2e-2):
        ours, theirs = steady(CONCRETES["no1"], LINE, flow), kaplan(CONCRETES["no1"], LINE, flow)
        x = CONCRETES["no1"].yield_stress / ours.wall_stress
        assert abs(theirs.wall_stress / ours.wall_stress - 1) < x**4 / 3
    stiff = dataclasses.replace(CONCRETES["no1"], yield_stress=2000.0)
    plug = kaplan(stiff, LINE, FLOW)
    assert plug.slip_velocity == pytest.approx(FLOW / (np.pi * LINE.radius**2), rel=1e-12)
    assert plug.wall_stress == pytest.approx(steady(stiff, LINE, FLOW).wall_stress, rel=1e-9)


def test_refusals():
    limit = 2354 * 9.81 * 0.3 + 2 * 190 * 0.3 / 0.05
    with pytest.raises(SceneError, match=f"nothing flows below {limit:.6g} Pa"):
        flow_of_pressure(CONCRETES["no1"], LINE, 9000.0)
    with pytest.raises(SceneError, match="viscosity = 0"):
        Concrete(density=2000, viscosity=0, yield_stress=1, slip_viscosity=1, slip_yield=1)
    with pytest.raises(SceneError, match="slip_thickness"):
        Line(slip_thickness=0.05)
    with pytest.raises(SceneError, match="flow = -1"):
        steady(CONCRETES["no1"], LINE, -1.0)
    with pytest.raises(SceneError, match="form = 'round'"):
        steady(CONCRETES["no1"], LINE, 1e-3, "round")
    with pytest.raises(SceneError, match="flows"):
        measured_layer(CONCRETES["no1"], LINE, [1e-3], [1e4])
    with pytest.raises(SceneError, match="radius"):
        velocity(CONCRETES["no1"], LINE, steady(CONCRETES["no1"], LINE, FLOW), [0.06])


def test_command():
    def run(*arguments):
        return CliRunner().invoke(cli, ["theory", *arguments])

    shown = run("--flow", "0.0015", "--flow", "0.001")
    assert shown.output.splitlines()[1] == "pipe: 0.3 m long, 100 mm wide, upright"
    rows = [line.split() for line in shown.output.splitlines()[3:]]
    assert [row[0] for row in rows] == ["pipe", "plane", "paper", "kaplan"] * 2 + ["forms:"]
    assert float(rows[0][2]) == pytest.approx(11929.3, abs=0.1)
    assert "9000" in run("--pressure", "9000", "--concrete", "no2", "--rise", "0").output
    assert "pipe: 2 m long, 125 mm wide, rising 0.5 m per m, gravity 0 m/s2" in run(
        "--length", "2", "--diameter", "0.125", "--rise", "0.5", "--gravity", "0").output  # fmt: skip
    refused = run("--concrete", "no4")
    assert isinstance(refused.exception, SceneError) and "no1, no2, no3" in str(refused.exception)
    assert "viscosity = 0" in str(run("--viscosity", "0").exception)


def test_the_rise_of_a_pipe_may_be_its_height():
    """An upright pipe of 60 ft has the same pressure whether its rise is a height or a rise per length."""
    run = functools.partial(CliRunner().invoke, cli)
    pipe = ["theory", "--diameter", "5in", "--length", "60 ft", "--flow", "30 m3/h"]
    (upright,) = {run([*pipe, "--rise", rise]).output for rise in ("60ft", "1", "100 %", "18.288 m")}
    steady_one = steady(CONCRETES["no1"], Line(radius=0.0635, length=18.288, rise=1.0), 30 / 3600)
    assert f"{steady_one.pressure:g}" in upright
    half = {run([*pipe, "--rise", rise]).output for rise in ("-30 ft", "-0.5")}
    assert len(half) == 1 and half != {upright}
    for rise in ("61 ft", "60 kg", "1.5", "nan"):
        with pytest.raises(SceneError, match=r"^rise = .*: must be"):
            run([*pipe, "--rise", rise], catch_exceptions=False)


def test_a_printed_fit_repeats_its_pressure_with_factors_of_age(tmp_path):
    """The options for the slip layer are divided by the factors that multiply them in the next call."""
    (tmp_path / "points.csv").write_text("flow [m3/h],pressure [bar]\n10,0.6\n20,1.0\n30,1.4\n", encoding="utf-8")
    pipe = ["theory", "--concrete", "no2", "--viscosity-factor", "2", "--yield-factor", "1.5", "--diameter", "0.125",
            "--length", "10", "--rise", "0"]  # fmt: skip
    done = CliRunner().invoke(cli, [*pipe, "--fit", str(tmp_path / "points.csv")])
    options = done.output.split(" points: ")[1].split(" (before the factors")[0].split()
    again = CliRunner().invoke(cli, [*pipe, *options, "--flow", "20 m3/h"])
    pressure = float(next(each for each in again.output.splitlines() if each.startswith("pipe  ")).split()[2])
    assert pressure == pytest.approx(1e5, rel=2e-3)  # Measured: 1.2e-3.


def test_the_command_fits_a_slip_layer_to_what_was_measured(tmp_path):
    """Points that concrete no. 1 with another layer gives, in the units of a site, columns the other way round."""
    from dataclasses import replace

    known = replace(CONCRETES["no1"], slip_viscosity=640.0, slip_yield=75.0)
    line = Line(radius=0.0625, length=20.0, rise=0.0)
    rows = [f"{steady(known, line, q / 3600).pressure / 1e5!r}, {q}" for q in (8, 15, 30, 45)]
    points = tmp_path / "points.csv"
    points.write_text("\n".join(["pressure [bar],flow [m3/h]", *rows]) + "\n", encoding="utf-8")
    pipe = ["--diameter", "0.125", "--length", "20", "--rise", "0"]
    given = ["theory", "--concrete", "no1", *pipe, "--fit", str(points)]
    done = CliRunner().invoke(cli, given)
    assert done.exit_code == 0, done.output
    assert "fitted to 4 points: --slip-viscosity 640 --slip-yield 75;" in done.output
    assert done.output.count("\npipe ") == 4
    points.write_text("\n".join(["pressure [bar],flow [m3/h]", *rows * 9]) + "\n", encoding="utf-8")
    logged = CliRunner().invoke(cli, given)
    assert "fitted to 36 points" in logged.output and logged.output.count("\npipe ") == 4

    own = ["--concrete", "own", "--density", "2354", "--viscosity", "397", "--yield-stress", "190"]
    bulk = CliRunner().invoke(cli, ["theory", *own, *pipe, "--fit", str(points)])
    assert "--slip-viscosity 640 --slip-yield 75;" in bulk.output  # no. 1 without its layer

    def refused(text):
        points.write_text(text, encoding="utf-8")
        return str(CliRunner().invoke(cli, given).exception)

    assert "has no column 'pressure'; " in refused("flow [m3/h],p [bar]\n1,2\n")
    assert "line 3: has 1 values where the header names 2 columns" in refused("flow [m3/h],pressure [bar]\n1,2\n2\n")
    assert "must be two or more different flows" in refused("flow [m3/h],pressure [bar]\n1,2\n")
    assert "line 2: flow = '1 m3/hx': must be a number" in refused("flow [m3/hx],pressure [bar]\n1,2\n2,3\n")
    assert "line 3: flow = '0 m3/h': must be a finite number above 0 m3/s; leave out points without flow" in refused(
        "flow [m3/h],pressure [bar]\n20,2\n0,0\n"
    )
    assert "line 4: pressure = 'x bar': must be a number" in refused("flow [m3/h],pressure [bar]\n\n1,2\n2,x\n")
    assert "but the viscosity must be above 0" in refused("flow [m3/h],pressure [bar]\n10,4\n20,3\n")
    points.unlink()
    assert "cannot be read" in str(CliRunner().invoke(cli, given).exception)


def test_a_restart_takes_what_the_structure_bears():
    # Calculated by hand: a plug with 20 Pa on its layer, after 600 s at 0.3 Pa/s, 10 m up a pipe of 0.1 m.
    plug = Concrete(density=2400, viscosity=30, yield_stress=500, slip_viscosity=1000, slip_yield=20)
    line = Line(radius=0.05, length=10.0)
    least = restart(plug, line, 600.0, 0.3)
    assert least.pressure == pytest.approx(2400 * 9.81 * 10 + 4 * (20 + 180) / 0.1 * 10, rel=1e-12)
    assert least.flow == 0.0 and least.slip_velocity == 0.0
    moving = restart(plug, line, 600.0, 0.3, flow=1e-3)  # slip alone: the bulk bears 680 Pa
    speed = 1e-3 / (np.pi * 0.05**2)
    assert moving.pressure - least.pressure == pytest.approx(4 * 1000 * speed / 0.1 * 10, rel=1e-12)
    assert after_rest(plug, 600.0, 0.3) == dataclasses.replace(plug, yield_stress=680.0, slip_yield=200.0)
    # A layer that bears more than the bulk: the bulk is sheared first (no. 1: 190 and 251 Pa).
    level = Line(rise=0.0)
    assert restart(CONCRETES["no1"], level, 60.0, 1.0).pressure == pytest.approx(4 * 250 / 0.1 * 0.3, rel=1e-12)
    assert restart(CONCRETES["no1"], level, 0.0, 1.0, FLOW) == steady(CONCRETES["no1"], level, FLOW)
    for bad in ((-1.0, 0.3), (600.0, -0.3), (float("nan"), 0.3)):
        with pytest.raises(SceneError):
            restart(plug, line, *bad)


def test_theory_prints_a_restart():
    plain = CliRunner().invoke(cli, ["theory", "--rise", "0"])
    found = CliRunner().invoke(cli, ["theory", "--rise", "0", "--rest", "60", "--thixotropy", "1"])
    assert found.exit_code == 0 and found.output.startswith(plain.output.rstrip())
    row = found.output.split(
        "after 60 s at rest with a growth rate of 1 Pa/s: yield stress 250 Pa, of the slip layer 311 Pa\n"
    )[1]
    assert row.splitlines()[1].split()[:3] == ["pipe", "3000", "10000"]
    for given in (["--thixotropy", "1"], ["--rest", "-5"]):
        bad = CliRunner().invoke(cli, ["theory", *given])
        assert bad.exit_code != 0 and "pipe" not in bad.output


def test_captions_name_constants_beyond_those_of_bingham():
    given = dict(name="own", density=2300.0, viscosity=20.0, yield_stress=100.0, slip_viscosity=900.0, slip_yield=20.0)
    assert Concrete(**given).words == "own (100 Pa, 20 Pa s)"
    assert Concrete(**given, flow_index=1.3).words == "own (100 Pa, 20 Pa s, flow index 1.3)"
