"""Figures and tables of studies for papers: theory, order of series, axes, units."""

import importlib
from dataclasses import replace

import numpy as np
import pytest

from warpcrete.core.drawing.style import THEORY, rgb
from warpcrete.core.errors import SceneError
from warpcrete.core.inputs.amounts import written_unit
from warpcrete.core.run.method import Quantity
from warpcrete.core.units import rounded
from warpcrete.studies.cases import Case, cases_of
from warpcrete.studies.drawing import THEORY_POINTS
from warpcrete.studies.study import written_units
from warpcrete.studies.study_result import Study
from warpcrete.theory.pipe import CONCRETES, Line, steady


def by_theory(flow, stress):
    """Return the pressure of Xu's first concrete with another yield stress in a tube [Pa], by the closed form."""
    return steady(replace(CONCRETES["no1"], yield_stress=stress), Line(), flow).pressure


def flows_of(folder, concrete="no1"):
    """Return a study of three flows and two yield stresses, whose last case failed, with theory beside the pressure."""
    points = [(flow / 3600, stress) for stress in (100.0, 25.0) for flow in (20.0, 5.0, 10.0)]
    cases = [Case(f"{k}", {"flow": q, "yield_stress": y}, {"concrete": concrete}) for k, (q, y) in enumerate(points)]
    quantities = [Quantity(n, "Pa", lambda k: None, compared=True) for n in ("pressure", "pressure_theory")]
    results = {
        case.name: {"pressure": {"value": 0.98 * by_theory(q, y), "unit": "Pa"},
                    "pressure_theory": {"value": by_theory(q, y), "unit": "Pa"}}
        for case, (q, y) in zip(cases[:-1], points)
    }  # fmt: skip
    return Study(folder, "tube", cases, quantities, {"flow": "m3/s", "yield_stress": "Pa"}, results, {"5": "no"},
                 written={"flow": "m3/h"})  # fmt: skip


def test_theory_is_dashed_and_grey_and_series_are_sorted_without_those_that_failed(tmp_path):
    # Without the file of the concrete, theory is known at the cases only, where short dashes show it.
    figure = flows_of(tmp_path, concrete="/some/where/mine.yaml").plot("pressure", x="flow")
    assert not [line for line in figure.axes[0].lines if line.get_linestyle() == "--"]
    assert len([line for line in figure.axes[0].lines if line.get_marker() == "_" and len(line.get_xdata())]) >= 2
    study = flows_of(tmp_path)
    (axes,) = study.plot("pressure", x="flow").axes
    assert figure.get_suptitle() == "tube, concrete mine with other yield stress"
    assert [text.get_text() for text in axes.get_legend().get_texts()] == [
        "pressure, yield stress 25 Pa", "pressure, yield stress 100 Pa", "pressure theory", "a case failed"
    ]  # fmt: skip
    dashed = [line for line in axes.lines if line.get_linestyle() == "--"]
    for line, stress, flows in zip(dashed, (25.0, 100.0), ((5, 20), (5, 20))):
        exact = [by_theory(flow / 3600, stress) / 1e3 for flow in line.get_xdata()]
        assert line.get_xdata()[[0, -1]] == pytest.approx(flows) and line.get_ydata() == pytest.approx(exact)
    assert len(dashed) == 2 and all(line.get_color() == rgb(THEORY) for line in dashed)
    assert all(container.lines[0].get_linestyle() == "None" for container in axes.containers)
    assert axes.get_ylim()[0] == 0 and axes.get_ylim()[1] > 1.05 * max(max(line.get_ydata()) for line in dashed)
    lonely = study.plot("pressure", x="yield_stress").axes[0]
    labels = [text.get_text() for text in lonely.get_legend().get_texts()]
    assert labels[:3] == [f"pressure, flow {flow} m3/h" for flow in (5, 10, 20)]
    del study.results["2"]
    labels = [t.get_text() for t in study.plot("pressure", x="yield_stress").axes[0].get_legend().get_texts()]
    assert "pressure, flow 10 m3/h" not in labels


def test_a_figure_of_a_study_has_the_wanted_axes_and_units(tmp_path):
    study = flows_of(tmp_path)
    (axes,) = study.plot("pressure", x="flow", unit="l/min", y_unit="bar").axes
    assert axes.get_xlabel() == "flow [l/min]" and axes.get_ylabel() == "pressure [bar]"
    assert axes.get_xticks() == pytest.approx(np.array([5, 10, 20]) * 1e3 / 60)
    assert max(axes.lines[0].get_xdata()) == pytest.approx(20e3 / 60)
    assert axes.get_ylim()[1] == pytest.approx(1.06e-5 * by_theory(20 / 3600, 100.0), rel=0.01)
    study.written = {}
    assert [axes.get_xlabel() for axes in study.plot().axes] == ["flow [m3/h]"]  # three flows, but two yield stresses
    assert all(len(axes.get_xticks()) <= 6 for axes in study.plot().axes)
    for given, words in (
        (
            ("velocity",),
            "quantity = 'velocity': is not the name of a number in the results of this study; must be one of pressure, "
            "pressure_theory",
        ),
        ((None, "flw"), "x = 'flw': must be one of flow, yield_stress"),
        ((None, "flow", "mm"), "unit = 'mm': must be one of m3/s, m3/h"),
        (("pressure", "flow", "kPa"), "'unit' is the unit of the horizontal axis; 'y_unit' is that of the quantity"),
        ((None, None, "m3/h"), "unit = 'm3/h': needs 'x'"),
        (("pressure", "flow", None, "m"), "y_unit = 'm': must be one of Pa, bar"),
    ):
        with pytest.raises(SceneError, match=words):
            study.plot(*given)


def test_the_table_of_a_study_has_the_units_that_the_user_stated(tmp_path):
    study = flows_of(tmp_path)
    assert study.markdown().startswith("| flow [m3/h] | yield_stress [Pa] |") and "| 20 | 100 |" in study.markdown()
    study.written = {}
    assert "| flow [m3/s] |" in study.markdown() and "| 0.005556 | 100 |" in study.markdown()
    tube = importlib.import_module("warpcrete.scenes.tube").scene
    stated = {"flow": ["5 m3/h", "10m³/h"], "diameter": ["50 mm"], "length": ["1 m", 2.0], "concrete": ["no1"]}
    assert written_units(tube, stated) == {"flow": "m3/h", "diameter": "mm"}
    assert written_unit(["5 m3/h", "3 l/s"], "m3/s") is None and written_unit(["5'"], "m") == "ft"
    assert [rounded(x) for x in (0.00138888, 20000.0, 5.0, 1e-7)] == ["0.001389", "20000", "5", "1e-07"]


def test_a_figure_leaves_out_deviations_from_theory_unless_they_are_wanted(tmp_path):
    study = flows_of(tmp_path)
    study.quantities.append(Quantity("pressure_error", "1", lambda k: None, compared=True))
    for result in study.results.values():
        result["pressure_error"] = 1e-4
    assert len([axes for axes in study.plot(x="flow").axes if axes.get_visible()]) == 1
    assert study.plot("pressure_error", x="flow").axes[0].get_ylabel() == "pressure error [%]"


def test_a_figure_has_theory_that_tables_leave_out_and_short_legends(tmp_path):
    study = flows_of(tmp_path)
    study.quantities = [Quantity(name, "Pa", lambda k: None, compared=True) for name in ("pressure", "friction")]
    for result in study.results.values():
        result["friction"] = {"value": 0.5 * result["pressure"]["value"], "unit": "Pa"}
    (axes,) = study.plot().axes
    dashed = [line for line in axes.lines if line.get_linestyle() == "--"]
    exact = [by_theory(flow / 3600, 100.0) / 1e3 for flow in np.linspace(5, 20, THEORY_POINTS)]
    assert len(dashed) == 2 and list(dashed[1].get_ydata()) == pytest.approx(exact)
    texts = [text.get_text() for text in axes.get_legend().get_texts()]
    assert texts[:4] == ["yield stress 25 Pa", "yield stress 100 Pa", "pressure", "friction"] and len(texts) == 6


def test_theory_that_no_closed_form_gives_joins_its_values_at_the_cases(tmp_path):
    """Discrete elements have no closed form between the cases, but their results state the friction by theory."""
    study = flows_of(tmp_path)
    study.scene = "pipe"
    study.quantities = [Quantity("pressure", "Pa", lambda k: None, compared=True)]
    dashed = [line for line in study.plot().axes[0].lines if line.get_linestyle() == "--"]
    exact = [by_theory(flow / 3600, 100.0) / 1e3 for flow in (5, 10, 20)]
    assert len(dashed) == 2 and list(dashed[1].get_ydata()) == pytest.approx(exact)


@pytest.mark.parametrize(("one_at_a_time", "panels"), [(True, ["flow", "yield_stress"]), (False, ["flow"])])
def test_a_study_of_one_parameter_at_a_time_has_a_panel_for_each(tmp_path, one_at_a_time, panels):
    """All combinations of four flows and three yield stresses need one panel only, with a series for each stress."""
    varied = {"flow": [1e-3, 2e-3, 4e-3, 8e-3], "yield_stress": [25.0, 50.0, 100.0]}
    cases = cases_of({"flow": 2e-3, "yield_stress": 50.0}, varied, one_at_a_time=one_at_a_time, seeded=False)
    results = {case.name: {"pressure": {"value": 1e3 + k, "unit": "Pa"}} for k, case in enumerate(cases)}
    pressure = Quantity("pressure", "Pa", lambda k: None, compared=True)
    study = Study(tmp_path, "tube", cases, [pressure], {}, results)
    assert [axes.get_xlabel().replace(" ", "_") for axes in study.plot().axes] == panels


def test_a_figure_shows_any_number_in_the_results_of_the_runs(tmp_path):
    """Only some numbers are compared in the table, but a user may draw all others as well."""
    study = flows_of(tmp_path)
    for k, result in enumerate(study.results.values()):
        result |= {"end_pressure": {"value": 2e3 + k, "unit": "Pa"}, "contacts": 7 + k, "finished": True, "name": "x"}
    (axes,) = study.plot("end_pressure", x="flow", y_unit="bar").axes
    assert axes.get_ylabel() == "end pressure [bar]"
    heights = sorted(float(y) for each in axes.containers for y in each.lines[0].get_ydata())
    assert heights == pytest.approx([0.02 + 1e-5 * k for k in range(5)])
    assert study.plot("contacts", x="flow").axes[0].get_ylabel() == "contacts"
    assert "end_pressure" not in study.markdown() and list(study.rows()[0]) == list(flows_of(tmp_path).rows()[0])
    for name in ("finished", "name", "end_presure"):
        with pytest.raises(SceneError, match=f"^quantity = '{name}': is not the name of a number in the results"):
            study.plot(name)


def test_a_mean_of_some_of_the_runs_says_so(tmp_path):
    """One of three runs has no pressure, and one has a pressure that is not a number."""
    cases = [Case(f"{k}", {"flow": flow}, {"seed": k}) for k, flow in enumerate((0.1, 0.1, 0.1, 0.2))]
    values = {"0": 4e3, "2": 6e3, "3": 5e3}
    results = {name: {"pressure": {"value": value, "unit": "Pa"}} for name, value in values.items()}
    study = Study(tmp_path, "tube", cases, [Quantity("pressure", "Pa", lambda k: None, compared=True)], results=results)
    for missing in ({}, {"pressure": {"value": float("nan"), "unit": "Pa"}}):
        results["1"] = missing or {"other": 1}
        assert "| 0.1 | 5 +- 1.4 (2 of 3 runs) | 3 | 0 | 0 |" in study.markdown()
        assert "| 0.2 | 5 | 1 | 0 | 0 |" in study.markdown()
    (axes,) = study.plot().axes
    (ring,) = (line for line in axes.lines if line.get_label() == "some runs have no value")
    assert list(ring.get_xdata()) == [0.1] and list(ring.get_ydata()) == [5.0]
    study.write(figure=False)
    head, first, second = (tmp_path / "study.csv").read_text(encoding="utf-8").splitlines()
    assert head.split(",")[-4:] == ["pressure_runs", "runs", "failed", "suspect"]
    assert first.split(",")[-4:] == ["2", "3", "0", "0"] and second.split(",")[-4:] == ["", "1", "0", "0"]


def test_quantities_by_theory_share_their_scenes(tmp_path, monkeypatch):
    """A closed form returns all quantities of a scene at once, so a series needs one scene for each of its points."""
    study, tube = flows_of(tmp_path), importlib.import_module("warpcrete.scenes.tube")
    study.quantities += [Quantity(n, "Pa/m", lambda k: None, compared=True) for n in ("gradient", "gradient_theory")]
    for result in study.results.values():
        result |= {name: {"value": 1e4, "unit": "Pa/m"} for name in ("gradient", "gradient_theory")}
    made, scene = [], tube.scene

    def counted(**given):
        made.append(given["flow"])
        return scene(**given)

    monkeypatch.setattr(tube, "scene", counted)
    figure = study.plot(x="flow")
    dashed = [line for axes in figure.axes for line in axes.lines if line.get_linestyle() == "--"]
    series = {label: [line.get_xdata() for line in dashed[k::2]] for k, label in enumerate(("25 Pa", "100 Pa"))}
    assert len(dashed) == 4 and len(made) == len(series) * THEORY_POINTS
    # The two series have other flows, since the last case of the first one failed; both quantities have the same.
    assert all(np.array_equal(*lines) for lines in series.values())
    whole = [steady(replace(CONCRETES["no1"], yield_stress=25.0), Line(), flow / 3600) for flow in series["25 Pa"][0]]
    assert dashed[0].get_ydata() * 1e3 == pytest.approx([each.pressure for each in whole])
    # The gradient is 2 tau / R with the wall stress tau.
    assert dashed[2].get_ydata() * 1e3 == pytest.approx([2 * each.wall_stress / Line().radius for each in whole])
