"""Test the verdicts on a paper's claims, and run reproductions that are small enough for a test."""

import json
import math

import pytest
from pumping import command

from warpcrete import RunFolderError, SceneError
from warpcrete.scenes import modules
from warpcrete.studies.reproduction import papers
from warpcrete.studies.reproduction.papers import (
    CONCRETES,
    OPEN_ASSUMPTIONS,
    ZHAN,
    column_parameters,
    judge_equal,
    judge_growing,
    judge_late_growth,
    judge_linear,
    judge_narrow,
    zhan_case,
)
from warpcrete.studies.reproduction.report import write
from warpcrete.studies.reproduction.reproduce import chosen, reproduce, resume_reproduction, zhan_studies
from warpcrete.studies.reproduction.state import Reproduction, key_of, verdict_of

SPEEDS = (0.1, 0.3, 0.5, 0.7, 0.9)


@pytest.mark.parametrize(
    ("judge", "values", "pressures", "holds"),
    [
        (judge_equal, SPEEDS, [10.0, 10.2, 10.0, 9.9, 10.1], True),
        (judge_equal, SPEEDS, [10.0, 10.2, 10.0, 9.9, 10.6], False),
        (judge_linear, SPEEDS, [10.0, 11.0, 12.0, 13.1, 14.0], True),
        (judge_linear, SPEEDS, [14.0, 13.0, 12.0, 11.0, 10.0], False),  # straight, but it falls
        (judge_linear, SPEEDS, [10.0, 10.1, 10.4, 11.5, 14.0], False),
        (judge_linear, SPEEDS, [10.0, 10.01, 10.02, 10.03, 10.04], False),  # straight, but it hardly grows
        (judge_growing, SPEEDS, [10.0, 10.2, 12.0, 12.0, 14.0], True),
        (judge_growing, SPEEDS, [10.0, 12.0, 11.0, 13.0, 14.0], False),
        (judge_narrow, (0.1, 0.125, 0.15, 0.175, 0.2), [70.0, 50.0, 40.0, 39.5, 40.0], True),
        (judge_narrow, (0.1, 0.125, 0.15, 0.175, 0.2), [50.0, 45.0, 40.0, 39.5, 40.0], False),
        (judge_narrow, (0.1, 0.125, 0.15, 0.175, 0.2), [70.0, 50.0, 40.0, 36.0, 33.0], False),
        (judge_late_growth, (10, 20, 40, 60), [40.0, 40.5, 46.0, 60.0], True),
        (judge_late_growth, (10, 20, 40, 60), [40.0, 45.0, 50.0, 60.0], False),
        (judge_late_growth, (10, 20, 40, 60), [40.0, 40.0, 39.0, 38.0], False),
    ],
)
def test_claims_are_judged(judge, values, pressures, holds):
    assert judge(values, pressures)[0] is holds


def test_every_case_of_the_paper_makes_a_scene():
    found = Reproduction(None, "zhan", False, 2, "cpu")
    pipe = modules()["pipe"].scene
    studies = zhan_studies(found)
    assert [group for group, *_ in studies] == [
        *CONCRETES,
        *OPEN_ASSUMPTIONS,
        "calibrated, hydrated",
        "literal, hydrated",
    ]
    for _, _, cases in studies:
        assert len({json.dumps(case, sort_keys=True) for case in cases}) == len(cases)
        for case in cases:
            assert pipe(**pipe.effective_values(case)).seed in (0, 1)
    # Four units and 22 values, of which four are the reference case itself.
    reference = zhan_case(ZHAN[4], 0.3, False)
    assert reference["unit"] == "bend-to-vertical" and len(studies[0][2]) >= 2 * (4 + 22 - 5)


def groups(*only, seeds=1, results=()):
    found = Reproduction(None, "zhan", False, seeds, "cpu", *chosen("zhan", only))
    found.results |= {key: {} for key in results}
    return {group: cases for group, _, cases in zhan_studies(found)}


def test_runs_are_limited_to_what_is_named():
    assert list(groups("velocity")) == [
        "literal",
        "calibrated",
        "stiff stones",
        "yielding layer",
        "half yielding layer",
    ]
    assert [case["velocity"] for case in groups("velocity", "literal")["literal"]] == list(SPEEDS)
    (units,) = groups("units", "faceted pipe").values()
    assert len(units) == 4 and all(case["wall"] == "mesh" and case["facets"] == 64 for case in units)
    assert len(groups("stiff stones")) == 1, "hydrated bonds of stiff stones only by name"
    hydrated = groups("stiff stones", "hydrated fraction")
    assert list(hydrated) == ["stiff stones, hydrated"] and len(hydrated["stiff stones, hydrated"]) == 5
    (cases,) = groups("literal", "velocity", seeds=2).values()
    known = [key_of("literal", case) for case in cases if case["seed"] == 0]
    (left,) = groups("literal", "velocity", seeds=2, results=known).values()
    assert len(cases) == 10 and [case["seed"] for case in left] == [1] * 5


def test_what_names_nothing_is_refused(tmp_path):
    with pytest.raises(SceneError, match="only = 'speed': must be one of literal, calibrated, stiff stones, equal"):
        reproduce("zhan", out=tmp_path / "out", only=["speed"])
    with pytest.raises(SceneError, match="combine 'faceted pipe' with one of units"):
        reproduce("zhan", out=tmp_path / "out", only=["faceted pipe", "velocity"])
    with pytest.raises(SceneError, match="has no effect for the paper 'xu', only for 'zhan'"):
        reproduce("xu", out=tmp_path / "out", only=["units"])
    with pytest.raises(RunFolderError, match="contains no results of a reproduction"):
        reproduce("zhan", out=tmp_path / "out", known=[tmp_path])
    assert not (tmp_path / "out").exists()


def test_known_results_are_taken_and_what_is_open_reported(tmp_path):
    first = Reproduction(tmp_path / "first", "zhan", False, 2, "cpu", ("yielding layer",), ("units",))
    first.folder.mkdir()
    (first.folder / "reproduction.json").write_text(json.dumps({"paper": "zhan", "quick": False}), encoding="utf-8")
    for place, case in enumerate(groups("yielding layer", "units", seeds=2)["yielding layer"]):
        pressure = {"value": 1e4 + 1e3 * place, "unit": "Pa"}
        first.results[key_of("yielding layer", case)] = {
            "peak_pressure": pressure, "end_pressure": pressure, "peak_travel": {"value": 0.1, "unit": "m"}
        }  # fmt: skip
    write(first)
    found = reproduce("zhan", out=tmp_path / "out", seeds=2, only=first.columns + first.rows, known=[first.folder])
    assert found.finished and len(found.results) == 8, "nothing is left to run"
    text = (found.folder / "reproduction.md").read_text(encoding="utf-8")
    # The table has the mean and the standard deviation of two seeds in kPa.
    assert "| yielding layer | 10.5 +- 0.71 / 10.5 +- 0.71 | 12.5 +- 0.71 / 12.5 +- 0.71 |" in text
    assert "| 0.10 | 0.10 |" in text and "as a yield stress of 357 Pa" in text
    assert resume_reproduction(found.folder).results == found.results
    with pytest.raises(SceneError, match="give a folder of 'warpcrete reproduce zhan --quick'"):
        reproduce("zhan", out=tmp_path / "quick", quick=True, known=[first.folder])


def test_results_are_kept_as_numbers_in_si_units(tmp_path):
    """True and false, such as `finished`, are no numbers."""
    found = Reproduction(tmp_path, "xu", True, 1, "cpu")
    found.results["one"] = {"pressure": {"value": 9e3, "unit": "Pa"}, "steps": 7, "finished": True, "scene": "tube",
                            "speed": {"wall_time": {"value": 1.0, "unit": "s"}}}  # fmt: skip
    write(found)
    kept = json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    assert kept == {"results": {"one": {"pressure": 9e3, "steps": 7.0}}, "failures": {}}


def test_what_is_open_stands_beside_the_calibrated_concrete():
    layer, zhan = OPEN_ASSUMPTIONS["yielding layer"][0], modules()["pipe"].scene(**CONCRETES["calibrated"]).parameters
    half = OPEN_ASSUMPTIONS["half yielding layer"][0]
    for each in (layer, half):
        stress = each["layer_yield"] + 0.3 * each["layer_viscosity"]
        assert stress == pytest.approx(0.3 * zhan["layer_viscosity"]), "the same at 0.3 m/s"
    for name in OPEN_ASSUMPTIONS:
        assert column_parameters(name)["concrete"] == "zhan"


def test_failed_cases_are_left_out_of_a_verdict(tmp_path, whole_pictures):
    (row,) = [row for row in ZHAN if row.parameter == "velocity"]
    found = Reproduction(tmp_path, "zhan", False, 2, "cpu")
    for value in row.values:
        for seed in (0, 1):
            key = key_of("calibrated", {**zhan_case(row, value, False), **CONCRETES["calibrated"], "seed": seed})
            if value == 0.9:
                found.failures[key] = "overlap of body 7"
            else:
                found.results[key] = {
                    "peak_pressure": {"value": 1e4 * (3 + value) + (2 * seed - 1) * 100, "unit": "Pa"}
                }
    means, verdict = verdict_of(found, row, "calibrated")
    assert means[:4] == pytest.approx([31e3, 33e3, 35e3, 37e3]) and math.isnan(means[4])
    assert verdict.startswith("holds for the finished runs (missing: 0.9)")
    assert verdict_of(found, row, "literal")[1] == ""
    (sizes,) = [row for row in ZHAN if row.parameter == "diameter"]
    for value in sizes.values[1:]:
        key = key_of("calibrated", {**zhan_case(sizes, value, False), **CONCRETES["calibrated"], "seed": 0})
        found.results[key] = {"peak_pressure": {"value": 4e4, "unit": "Pa"}}
    assert verdict_of(found, sizes, "calibrated")[1] == "too few runs finished (missing: 0.1)"
    write(found)
    text = (tmp_path / "reproduction.md").read_text(encoding="utf-8")
    assert "| calibrated | 31.0 +- 0.14 | 33.0 +- 0.14 | 35.0 +- 0.14 | 37.0 +- 0.14 | - |" in text
    assert "overlap of body 7" in text
    assert (tmp_path / "reproduction.png").stat().st_size > 5000


def test_an_unknown_paper_is_refused(tmp_path):
    with pytest.raises(SceneError, match="paper = 'smith': must be one of zhan, xu"):
        reproduce("smith", out=tmp_path / "out")
    with pytest.raises(SceneError, match="seeds = 0: must be from 1 to 10000"):
        reproduce("xu", out=tmp_path / "out", seeds=0)
    assert not (tmp_path / "out").exists()


def test_a_reproduction_runs_and_is_gone_on_with(tmp_path, monkeypatch):
    column = {"length": 0.2, "diameter": 0.1, "spacing": 0.02, "concrete": "no1"}
    cases = {"flow": [("channel", column | {"flow": flow}) for flow in (1e-3, 2e-3)]}
    cases["flow"].append(("channel", column | {"flow": 1e-3, "regularisation": 100.0}))  # the first again
    monkeypatch.setattr("warpcrete.studies.reproduction.reproduce.xu_cases", lambda quick: cases)
    monkeypatch.setattr("warpcrete.studies.reproduction.report.xu_cases", lambda quick: cases)
    found = reproduce("xu", out=tmp_path / "out", device="cpu", quick=True)
    assert found.finished and len(found.results) == 3 and not found.failures
    assert len([path for path in (found.folder / "flow-channel").iterdir() if path.is_dir()]) == 2
    text = (found.folder / "reproduction.md").read_text(encoding="utf-8")
    assert text.count("| channel | no1 | flow 0.00") == 3 and "Pressure holds" in text
    assert papers.XU_PRINTED["pressure"] == 9.40e3
    again = reproduce("xu", out=tmp_path / "again", device="cpu", quick=True, known=[tmp_path / "out"])
    assert again.finished and sorted(path.name for path in again.folder.glob("*/")) == [] and len(again.results) == 3
    assert (again.folder / "reproduction.md").read_text(encoding="utf-8") == text


@pytest.mark.thorough
def test_the_command_reproduces_xu_quickly(tmp_path):
    done = command("reproduce", "xu", "--quick", "--out", tmp_path / "out", "--device", "cpu", "--quiet")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("Pressure holds") == 4 and "differs" not in done.stdout
    assert "not run" not in done.stdout and "Not judged" not in done.stdout


def test_nothing_is_judged_that_did_not_run(tmp_path):
    write(Reproduction(tmp_path, "xu", True, 1, "cpu"))
    text = (tmp_path / "reproduction.md").read_text(encoding="utf-8")
    assert "Pressure holds" not in text and text.count("Not judged") == 4
