"""Test results of runs: quantities of made-up series, pipeline pressures by hand, tables and figures of studies."""

import csv
import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from warpcrete import scenes
from warpcrete.core.errors import RunFolderError, SceneError
from warpcrete.core.run.method import Quantity, report_of, results_of
from warpcrete.core.run.run import Run
from warpcrete.dem.measure.quantities import QUANTITIES, Known, no_plateau, past_ramp
from warpcrete.dem.measure.quantities import report as element_report
from warpcrete.dem.measure.sampling import unit_of
from warpcrete.dem.scene.scene import Stops
from warpcrete.methods import METHODS
from warpcrete.record.checks import failed_checks
from warpcrete.studies.cases import Case
from warpcrete.studies.drawing import draw
from warpcrete.studies.lines.pipeline import check_pipeline, pipeline_estimate, pipeline_pressure
from warpcrete.studies.study_result import Study
from warpcrete.suspension.stretch.quantities import QUANTITIES as STRETCHES

PIPE = scenes.pipe(ramp=0.3, travel=1.0)


def known_of(travel, pressure, scene=PIPE, **columns) -> Known:
    zero = np.zeros(len(travel))
    wanted = [f"{prefix}_{axis}" for prefix in ("drive", "momentum") for axis in "xyz"]
    wanted += [f"{wall.name}_impulse_{axis}" for wall in scene.walls for axis in "xyz"]
    series = dict.fromkeys([*wanted, "largest_overlap"], zero)
    series |= {"time": 2.0 * np.asarray(travel), "travel": np.asarray(travel), "pressure": np.asarray(pressure)}
    contacts = SimpleNamespace(coordination_number=5.0)
    return Known(scene, scene.walls, series | columns, 1.0, contacts)  # type: ignore[arg-type]


def results(known) -> dict:
    return results_of(QUANTITIES, known)


def test_peak_and_plateau_of_a_made_up_series():
    travel = np.linspace(0, 1, 101)
    pressure = 20e3 + np.where(np.abs(travel - 0.1) < 0.005, 9e3, 0.0)
    found = results(known_of(travel, pressure))
    assert found["peak_pressure"] == {"value": 29e3, "unit": "Pa"}
    assert found["peak_travel"] == {"value": pytest.approx(0.1), "unit": "m"}  # where, not when: that is 0.2 s
    assert found["plateau_pressure"] == found["end_pressure"] == {"value": 20e3, "unit": "Pa"}
    assert found["plateau_from_travel"] == {"value": pytest.approx(0.8), "unit": "m"}
    assert found["plateau_scatter"]["value"] == 0 and found["coordination_number"] == 5.0


@pytest.mark.parametrize(
    ("travel", "slope", "plateau"),
    [
        (1.0, 0.0, True),
        (0.375, 0.0, True),  # the window begins where the ramp ends
        (0.37, 0.0, False),  # the piston still accelerates in the window
        (0.02, 0.0, False),
        (1.0, 0.4, True),  # 8 % from one fifth to the next
        (1.0, 2.0, False),  # an elbow whose pressure still rises
        (1.0, -0.4, False),
    ],
)
def test_no_plateau_before_the_piston_moves_steadily_or_while_the_pressure_changes(travel, slope, plateau):
    way = np.linspace(0, travel, 401)
    found = results(known_of(way, 10e3 * (1 + slope * way / travel)))
    assert ("plateau_pressure" in found) == plateau and "end_pressure" in found
    scene = dataclasses.replace(PIPE, pipe=dataclasses.replace(PIPE.pipe, travel=travel))
    run = SimpleNamespace(scene=scene, result=found, series={"travel": way}, packing=None, finished=True, wear=None)
    lines = dict(element_report(run))
    assert bool(no_plateau(run)) != plateau and ("plateau pressure" in lines) != plateau
    if travel < 0.375:
        assert "after the ramp of 0.3 m; move the piston 0.375 m or more" in lines["plateau pressure"]
        assert not past_ramp(scene, travel)
    elif not plateau:
        assert "still changes by more than 10 %" in lines["plateau pressure"]


def test_the_final_window_lies_within_the_last_stroke():
    """Raise the pressure in the last fifth of the second of two strokes, which is all that the window may hold."""
    stops = Stops(count=1, stroke_time=1.0, pause=0.5)
    pipe = dataclasses.replace(PIPE.pipe, travel=1.0, ramp=0.1, stops=stops)
    begun = pipe.begun(1.0)
    assert 0.4 < begun < 0.6
    way = np.linspace(0, 1.0, 1001)
    begins = begun + 0.8 * (1.0 - begun)
    known = known_of(way, np.where(way < begins - 1e-9, 10e3, 30e3), dataclasses.replace(PIPE, pipe=pipe))
    assert known.window_begin == pytest.approx(begins, rel=1e-12)
    assert results(known)["end_pressure"]["value"] == pytest.approx(30e3, rel=1e-12)


def test_the_plateau_of_a_later_stroke_is_compared_with_a_window_of_that_stroke():
    """The window and the equal travel before it are fifths of the second stroke: 0.1 m each, not 0.2 m."""
    stops = Stops(count=1, stroke_time=1.0, pause=0.5)
    pipe = dataclasses.replace(PIPE.pipe, velocity=0.55, travel=1.0, ramp=0.1, stops=stops)
    begun = pipe.begun(1.0)
    way, width = np.linspace(0, 1.0, 1001), 0.2 * (1.0 - begun)
    for place, plateau in ((1.0 - 2.1 * width, True), (1.0 - 1.5 * width, False)):
        pressure = np.where(way < place, 30e3, 10e3)
        assert known_of(way, pressure, dataclasses.replace(PIPE, pipe=pipe)).on_plateau == plateau


def wave(way, size, period=0.05):
    return size * np.sin(2 * np.pi * way / period)


@pytest.mark.parametrize(
    ("shape", "plateau"),
    [
        # Falls, then rises through the window, whose mean is nearly that before it: a pipe that is about to block.
        (lambda way: np.interp(way, [0, 0.6, 0.8, 1], [4.75, 4.0, 2.65, 3.6]), False),
        (lambda way: np.interp(way, [0, 0.6, 0.8, 1], [1.0, 2.4, 3.7, 2.65]), False),  # the other way round
        (lambda way: np.interp(way, [0, 0.8, 1], [3.0, 3.0, 3.25]), True),  # rises by 8 % at the end
        (lambda way: np.interp(way, [0, 0.8, 1], [3.0, 3.0, 3.4]), False),  # by 13 %
        (lambda way: np.interp(way, [0, 0.8, 1], [3.0, 3.0, 2.6]), False),
        (lambda way: np.interp(way, [0, 0.6, 0.601, 1], [3.5, 3.5, 3.0, 3.0]), True),  # a step before both parts
        (lambda way: np.interp(way, [0, 0.8, 0.801, 1], [3.5, 3.5, 3.0, 3.0]), False),  # and between them
        (lambda way: np.interp(way, [0, 0.8, 0.801, 1], [3.0, 3.0, 3.5, 3.5]), False),
        (lambda way: 3.0 + wave(way, 0.6), True),  # a wave, four times in the window
        (lambda way: np.where(way < 0.8, 2.5, 3.0) + wave(way, 0.6), False),  # a step between both parts, in such waves
        (lambda way: np.interp(way, [0, 0.8, 1], [3.0, 2.8, 3.2]) + wave(way, 0.6), True),  # a trend within its scatter
        (lambda way: np.interp(way, [0, 0.8, 1], [3.0, 2.6, 3.4]) + wave(way, 0.1), False),  # and beyond it
        (lambda way: np.where(way < 0.99, 3.0, 6.0), False),  # a pipe that blocks within the last twentieth
        (lambda way: np.interp(way, [0, 0.98, 1], [3.0, 3.0, 12.0]), False),
    ],
)  # fmt: skip
def test_a_plateau_neither_rises_nor_falls(shape, plateau):
    way = np.linspace(0, 1.0, 401)
    found = results(known_of(way, 1e3 * shape(way)))
    assert ("plateau_pressure" in found) == plateau and "end_pressure" in found


def test_momentum_balance_of_a_made_up_series():
    """Gravity and the floor in balance; then a floor that takes 1 % less than it must; then nothing to judge by."""
    time = np.linspace(0, 2, 21)
    scene = dataclasses.replace(PIPE, gravity=(0.0, 0.0, -10.0))
    down = 1.0 * 10.0 * time
    for factor, wanted in ((1.0, 0.0), (0.99, 0.01)):
        known = known_of(time / 2, np.ones(21), scene, piston_impulse_z=-factor * down)
        assert results(known)["momentum_balance_error"] == pytest.approx(wanted, abs=1e-12)
    assert math.isnan(results(known_of([0.0], [1.0]))["momentum_balance_error"])


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({}, 0.0),
        ({"dissipated_energy": 1.4}, -0.6 / 12),  # divided by the work
        ({"potential_energy": 12.0}, 3 / 12),
        ({"drive_work": -5.0, "dissipated_energy": 2.0}, 10 / 2),  # The work is only 2 J.
        ({"drive_work": -7.0, "dissipated_energy": -8.5}, 1.5 / 8.5),  # divided by the dissipation
        ({"kinetic_energy": 24.0, "dissipated_energy": -22.0 + 0.3}, 0.3 / 25),  # divided by that of motion and springs
        ({"bond_energy": 3.0, "wall_work": 10.0}, 0.0),
    ],
)
def test_energy_balance_of_a_made_up_series(changes, error):
    """A piston works 7 J and a driving force 5 J, which lift the concrete by 9 J, load its springs with 1 J and leave
    2 J for friction; all grow evenly."""
    time = np.linspace(0, 1, 21)
    ends = {"kinetic_energy": 0.0, "potential_energy": 9.0, "elastic_energy": 1.0, "bond_energy": 0.0,
            "dissipated_energy": 2.0, "wall_work": 7.0, "drive_work": 5.0} | changes  # fmt: skip
    columns = {name: end * time for name, end in ends.items()}
    known = known_of(time, np.ones(21), **columns)
    assert results(known)["energy_balance_error"] == pytest.approx(error, abs=1e-12)


def test_results_have_units_and_the_report_is_in_those_that_people_read():
    known = known_of(np.linspace(0, 1, 11), np.full(11, 12_345.0))
    result = results(known)
    for method in METHODS:
        assert len({each.name for each in method.quantities}) == len(method.quantities)
    run = Run(PIPE, known.series, {}, result, True)
    lines = dict(report_of(QUANTITIES, run))
    assert lines["peak pressure"] == "12.35 kPa at 0.000 m of piston travel   (Zhan et al. 2019: 38.93 kPa)"
    plain = Quantity("speed", "m/s", lambda known: 0.25, "speed")
    assert results_of([plain], None) == {"speed": {"value": 0.25, "unit": "m/s"}}
    assert dict(report_of([plain], Run(PIPE, {}, {}, {"speed": {"value": 0.25, "unit": "m/s"}}, True)))["speed"] == (
        "25 cm/s"
    )


def test_every_column_of_a_series_has_a_unit():
    columns = {
        "time": "s", "travel": "m", "pressure": "Pa", "kinetic_energy": "J", "bonds": "1", "largest_overlap": "1",
        "momentum_x": "kg m/s", "piston_force_z": "N", "piston_impulse_x": "N s", "piston_moment_y": "N m",
        "drive_z": "N", "dissipated_energy": "J", "wall_work": "J",
    }  # fmt: skip
    for name, unit in columns.items():
        assert unit_of(name, PIPE.walls) == unit, name
    with pytest.raises(KeyError, match="has no unit"):  # and becomes no force
        unit_of("viscosity", PIPE.walls)


# Pipelines (Zhan et al. 2019, Eq. 13).

MASS, GRAVITY = 12.0, 9.81


def straight(unit: str, plateau: float = 20e3):
    """A run of a straight unit, 2 m of concrete, with a plateau."""
    scene = dataclasses.replace(
        scenes.pipe(unit=unit, length=2.0, ramp=0.1), gravity=(0.0, 0.0, -GRAVITY), parameters={}
    )
    bodies = SimpleNamespace(mass=np.array([MASS - 2.0, 2.0, 5.0]), group=["", "", "plug"])
    result = {"plateau_pressure": {"value": plateau, "unit": "Pa"}}
    return SimpleNamespace(scene=scene, result=result, bodies=bodies)


def test_the_other_direction_has_less_or_more_weight():
    weight = MASS * GRAVITY / (math.pi * 0.075**2 * 2.0)  # [Pa/m], the plug is not concrete
    up, along = (pipeline_estimate(straight(unit), 100.0, 50.0) for unit in ("vertical", "horizontal"))
    assert up["vertical_per_metre"] == {"value": 10e3, "unit": "Pa/m"}
    assert up["horizontal_per_metre"]["value"] == pytest.approx(10e3 - weight)
    assert up["total_pressure"]["value"] == pytest.approx(100 * 10e3 + 50 * (10e3 - weight))
    assert "less the weight" in up["other_direction_from"]
    assert along["horizontal_per_metre"]["value"] == 10e3
    assert along["vertical_per_metre"]["value"] == pytest.approx(10e3 + weight)
    assert along["total_pressure"]["value"] == pytest.approx(100 * (10e3 + weight) + 50 * 10e3)
    assert "plus the weight" in along["other_direction_from"]
    assert pipeline_pressure(3.0, 5.0, 7.0, 11.0) == 3 * 7 + 5 * 11


def test_the_other_direction_may_come_from_a_run():
    other = {
        "finished": True, "unit": "horizontal", "plateau_pressure": {"value": 6e3, "unit": "Pa"},
        "concrete_length": {"value": 1.5, "unit": "m"},
    }  # fmt: skip
    run = straight("vertical")
    check_pipeline(run.scene, other, "there")
    estimate = pipeline_estimate(run, 10.0, 100.0, other)
    assert estimate["horizontal_per_metre"]["value"] == 4e3
    assert estimate["total_pressure"]["value"] == pytest.approx(10 * 10e3 + 100 * 4e3)
    assert estimate["other_direction_from"] == "plateau of the horizontal run"
    with pytest.raises(SceneError, match="unit of pipeline_other = 'horizontal'"):
        check_pipeline(straight("horizontal").scene, other, "there")
    with pytest.raises(RunFolderError, match="pipeline_other = 'there': is not a finished run of the scene pipe"):
        check_pipeline(run.scene, {"unit": "horizontal"}, "there")
    with pytest.raises(SceneError, match="unit = 'bend-to-vertical'"):
        check_pipeline(scenes.pipe(unit="D"), None, None)
    with pytest.raises(
        SceneError, match=r"travel = 0.02: is too short for a plateau of the pressure.*0\.375 m or more"
    ):
        check_pipeline(scenes.pipe(travel=0.02), None, None)
    with pytest.raises(SceneError, match="pipeline = 'channel'"):
        check_pipeline(scenes.channel(), None, None)


# Studies.


def study_of(folder, cases, values) -> Study:
    """A study of made-up peaks and plateaus [Pa]."""
    quantities = [each for each in QUANTITIES if each.compared]
    results = {
        case.name: {"peak_pressure": {"value": peak, "unit": "Pa"}, "plateau_pressure": {"value": level, "unit": "Pa"}}
        for case, (peak, level) in zip(cases, values)
    }
    return Study(folder, "pipe", cases, quantities, {"velocity": "m/s", "diameter": "m"}, results)


def test_a_table_shows_the_digits_of_small_and_large_numbers(tmp_path):
    """With two decimals, flows of litres per second and slow aggregates would be 0."""
    cases = [Case(f"{seed}", {}, {"seed": seed}) for seed in (0, 1)]
    compared = [each for each in STRETCHES if each.name in ("flow", "aggregate_velocity", "wall_stress")]
    runs = [{"flow": 3.7e-4, "aggregate_velocity": 2e-5, "wall_stress": 123456.0},
            {"flow": 3.9e-4, "aggregate_velocity": 2e-5, "wall_stress": 123456.0}]  # fmt: skip
    study = Study(tmp_path, "stretch", cases, compared, {}, dict(zip(("0", "1"), runs, strict=True)))
    assert study.markdown().splitlines()[0].startswith("| flow [m3/h] | wall stress [kPa] | aggregate velocity [cm/s]")
    assert study.markdown().splitlines()[2].startswith("| 1.368 +- 0.051 | 123.5 +- 0 | 0.002 +- 0 |")


def test_table_csv_and_figure_of_a_study_read_back(tmp_path):
    cases = [
        Case(f"{k}", {"velocity": v, "diameter": d}, {})
        for k, (v, d) in enumerate([(0.1, 0.1), (0.5, 0.1), (0.1, 0.2)])
    ]
    study = study_of(tmp_path, cases, [(20e3, 10e3), (80e3, 40e3), (200e3, 5e3)])
    lines = study.markdown().splitlines()
    assert lines[0] == "| velocity [m/s] | diameter [m] | peak [kPa] | plateau [kPa] | runs | failed | suspect |"
    assert lines[2] == "| 0.1 | 0.1 | 20 | 10 | 1 | 0 | 0 |"
    study.write()
    with (tmp_path / "study.csv").open(encoding="utf-8") as file:
        row = next(csv.DictReader(file))
    assert row["velocity [m/s]"] == "0.1" and float(row["peak_pressure [Pa]"]) == 20e3
    assert "plateau_pressure_scatter [Pa]" in row
    figure = draw(study)
    shown = [axes for axes in figure.axes if axes.get_visible()]
    assert [axes.get_xlabel() for axes in shown] == ["velocity [m/s]", "diameter [m]"]
    highest = {}
    for axes in shown:
        assert axes.get_ylabel() == "peak and plateau [kPa]" and axes.get_legend() is not None
        lower, upper = axes.get_ylim()
        for line in axes.lines:
            y = np.asarray(line.get_ydata(), float)
            if len(y):
                assert lower <= y.min() and y.max() <= upper, "a point is clipped"
                highest[axes] = max(highest.get(axes, 0.0), y.max())
    assert set(highest.values()) == {200.0}


def test_lines_of_a_study_have_colours_and_quantities_markers_of_their_own_and_failed_cases_have_marks(tmp_path):
    cases = [
        Case(f"{k}", {"velocity": v, "diameter": d}, {"concrete": "zhan"})
        for k, (v, d) in enumerate([(0.1, 0.1), (0.5, 0.1), (0.1, 0.2), (0.5, 0.2)])
    ]
    study = study_of(tmp_path, cases, [(20e3, 10e3), (80e3, 40e3), (200e3, 5e3), (1e3, 1e3)])
    del study.results["3"]
    study.failures["3"] = "it became unstable"
    figure = draw(study)
    axes = figure.axes[0]
    bars = [container.lines[0] for container in axes.containers]
    colours, markers = [line.get_color() for line in bars], [line.get_marker() for line in bars]
    assert markers == ["o", "o", "s", "s"] and colours[:2] == colours[2:] and colours[0] != colours[1]
    (mark,) = [line for line in axes.lines if line.get_label() == "a case failed"]
    assert list(mark.get_xdata()) == [0.5] and figure.get_suptitle() == "pipe, concrete zhan"


def test_words_of_a_study_are_not_joined_by_lines(tmp_path):
    cases = [Case(word, {"shapes": word}, {}) for word in ("spheres", "reference", "shape-2.5")]
    figure = draw(study_of(tmp_path, cases, [(3e4, 2e4), (2e4, 1e4), (4e4, 3e4)]))
    (axes,) = [axes for axes in figure.axes if axes.get_visible()]
    assert [tick.get_text() for tick in axes.get_xticklabels()] == ["spheres", "reference", "shape-2.5"]
    assert all(line.get_linestyle() == "None" for line in axes.lines)


def test_a_run_that_fails_its_check_is_suspect(tmp_path):
    cases = [Case("a", {"velocity": 0.1}, {}), Case("b", {"velocity": 0.2}, {})]
    study = study_of(tmp_path, cases, [(1.0, 1.0), (1.0, 1.0)])
    bad = {"momentum balance": {"passed": False, "found": "3 %"}, "finished": {"passed": True, "found": ""}}
    study.results["b"]["checks"] = bad
    assert failed_checks(study.results["b"]) == ["momentum balance"] and failed_checks(study.results["a"]) == []
    assert study.suspect == {"b": ["momentum balance"]}
    assert [row["suspect"] for row in study.rows()] == [0, 1]


def test_a_pressure_cut_within_the_ramp_blames_the_cut():
    """Not the travel, which would have been enough."""
    way = np.linspace(0, 0.1, 41)
    run = SimpleNamespace(scene=PIPE, result=results(known_of(way, 1e4 + way)), series={"travel": way})
    assert no_plateau(run) == "none: the run was stopped before the piston had moved steadily for long enough"


def test_a_loss_without_a_ratio_is_reported():
    """The first rows of a run may show a loss in a bend before the walls of the straight pipes brake the concrete."""
    run = Run(PIPE, {}, {}, {"middle_loss": {"value": 2500.0, "unit": "Pa"}}, True)
    label = next(each.label for each in QUANTITIES if each.name == "middle_loss")
    assert dict(report_of(QUANTITIES, run)) == {label: "2.5 kPa"}


def test_each_method_says_when_its_runs_have_a_quantity():
    """Blocked pipes of discrete elements and blocked parts of suspensions share names; flows know neither."""
    for scene, text in (
        (PIPE, "this quantity only if the pipe was blocked"),
        (scenes.part(**scenes.suspended("part")), "this quantity only if the part was blocked"),
        (scenes.slump(), "the run has no quantity 'blocked_at'; the run has steps"),
        # For a scene of no method, no condition is stated, because the methods disagree.
        (SimpleNamespace(name="pipe"), "the run has no quantity 'blocked_at'; the run has steps"),
    ):
        with pytest.raises(KeyError, match=text):
            Run(scene, {}, {}, {"steps": 3}, True)["blocked_at"]
    for scene in (scenes.slump(), scenes.slump_dem(), SimpleNamespace(name="slump")):
        with pytest.raises(KeyError, match="this quantity only if the spread grows to 500 mm before the run ends"):
            Run(scene, {}, {}, {"steps": 3}, True)["t500"]
    with pytest.raises(KeyError, match="has no quantity 't500'; the run has steps"):
        Run(scenes.tube(), {}, {}, {"steps": 3}, True)["t500"]
