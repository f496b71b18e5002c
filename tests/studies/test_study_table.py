"""Studies as tables: DataFrame, Parquet, HTML; and read back from their folders."""

import importlib
from dataclasses import replace

import numpy as np
import pytest
from test_batch import SMALL

import warpcrete
from warpcrete import RunFolderError
from warpcrete.cli.study import report as report_study
from warpcrete.core.run.method import Quantity
from warpcrete.studies.cases import MAX_NAME_LENGTH, Case, short_name
from warpcrete.studies.study import run_study
from warpcrete.studies.study_result import Study
from warpcrete.studies.study_table import columns_of, write_parquet

pipe_module = importlib.import_module("warpcrete.scenes.pipe")
BASE = SMALL | dict(travel=0.012, ramp=0.008, settle=0.0)


@pytest.fixture
def study(tmp_path):
    """Two seeds of two shapes: one failed, one that is not finished."""
    cases = [
        Case(f"{n:03d}", {"shapes": shapes, "velocity": v}, {"seed": seed})
        for n, (shapes, v, seed) in enumerate([("spheres", 0.1, 0), ("spheres", 0.1, 1), (3, 0.3, 0), (3, 0.3, 1)])
    ]
    peak = Quantity("peak_pressure", "Pa", lambda known: None, compared=True)
    checks = {"finished": {"passed": False, "found": "no"}}
    results = {
        "000": {"peak_pressure": {"value": 2e4, "unit": "Pa"}, "steps": 5, "finished": True, "scene": "pipe",
                "part": 0.5, "speed": {"memory": {"value": 1.0, "unit": "B"}}, "checks": checks},
        "001": {"peak_pressure": {"value": 3e4, "unit": "Pa"}, "steps": 7, "finished": True},
    }  # fmt: skip
    return Study(tmp_path, "pipe", cases, [peak], {"velocity": "m/s", "diameter": "m"}, results, {"002": "t = 1 s: no"})


def test_a_row_is_a_case_with_every_number_it_came_to(study):
    columns, units = columns_of(study)
    assert units == {"velocity": "m/s", "peak_pressure": "Pa"}
    assert columns == {
        "case": ["000", "001", "002", "003"],
        "outcome": ["finished", "finished", "failed", "not finished"],
        "seed": [0, 1, 0, 1],
        "shapes": ["spheres", "spheres", 3, 3],
        "velocity": [0.1, 0.1, 0.3, 0.3],
        "peak_pressure": [2e4, 3e4, None, None],
        "steps": [5.0, 7.0, None, None],
        "part": [0.5, None, None, None],
        "failed_checks": ["finished", "", "", ""],
        "error": ["", "", "t = 1 s: no", ""],
    }


def test_a_dataset_has_every_case_with_units(study):
    """Two cases with the same values cannot share a place of a grid, so the cases stay in a row."""
    pytest.importorskip("xarray", reason="needs xarray, which the extra [test] installs")
    study.cases[1] = replace(study.cases[1], parameters={"seed": 0})
    found = study.to_xarray()
    columns, units = columns_of(study)
    assert found["case"].to_numpy().tolist() == columns["case"] and set(found.data_vars) == set(columns) - {"case"}
    assert {name: each.attrs["units"] for name, each in found.data_vars.items() if "units" in each.attrs} == units
    assert "units" not in found["outcome"].attrs
    assert np.array_equal(found["peak_pressure"], [2e4, 3e4, np.nan, np.nan], equal_nan=True)


def test_a_dataset_has_a_dimension_for_each_varied_parameter_and_the_seed(study):
    pytest.importorskip("xarray", reason="needs xarray, which the extra [test] installs")
    found = study.to_xarray()
    assert found["peak_pressure"].dims == ("shapes", "velocity", "seed")
    assert found["velocity"].to_numpy().tolist() == [0.1, 0.3] and found["velocity"].attrs["units"] == "m/s"
    assert found["peak_pressure"].attrs["units"] == "Pa"
    assert found["peak_pressure"].sel(velocity=0.1).isel(shapes=0).to_numpy().tolist() == [2e4, 3e4]
    # The study has no case of spheres at 0.3 m/s, and that of the other shape at this velocity failed.
    assert np.isnan(found["peak_pressure"].sel(velocity=0.3)).all()
    assert found["outcome"].sel(velocity=0.3, seed=0).to_numpy().tolist() == ["", "failed"]
    # A few cases far apart in a large grid stay in a row.
    for n, case in enumerate(study.cases):
        study.cases[n] = replace(case, varied={"shapes": f"shape-{n}", "velocity": 0.1 * n})
    assert study.to_xarray().sizes == {"case": 4}


def test_parquet_keeps_units_and_what_has_no_one_type(study):
    from pyarrow import parquet

    path = study.folder / "study.parquet"
    write_parquet(study, path)
    read = parquet.read_table(path)
    columns, _ = columns_of(study)
    assert read["shapes"].to_pylist() == ["spheres", "spheres", "3", "3"]
    assert all(read[name].to_pylist() == values for name, values in columns.items() if name != "shapes")
    assert read.schema.field("peak_pressure").metadata == {b"unit": b"Pa"}
    assert read.schema.field("steps").metadata is None and read.schema.metadata[b"scene"] == b"pipe"
    pandas = pytest.importorskip("pandas", reason="needs pandas, which the extra [test] installs")
    assert pandas.read_parquet(path).attrs["units"] == {"velocity": "m/s", "peak_pressure": "Pa"}


def test_a_study_shows_itself(study):
    pytest.importorskip("pandas", reason="needs pandas, which the extra [test] installs")
    table = study.table()
    assert table.loc["001", "peak_pressure"] == 3e4 and table.attrs["units"]["peak_pressure"] == "Pa"
    assert np.isnan(table.loc["003", "peak_pressure"])
    html = study._repr_html_()
    assert html.count("<tr>") == 3 and "<th>velocity [m/s]</th>" in html and "<td>25 +- 7.1</td>" in html
    assert study._ipython_key_completions_() == ["000", "001", "002", "003"]
    with pytest.raises(KeyError, match="has no case '9'; its cases are 000, 001"):
        study["9"]


@pytest.mark.thorough
def test_a_study_comes_back_with_its_runs(tmp_path):
    pandas = pytest.importorskip("pandas", reason="needs pandas, which the extra [test] installs")
    out = tmp_path / "study"
    made = run_study("pipe", pipe_module, {"velocity": [0.3, 0.6]}, base=BASE, out=out, device="cpu", processes=1)
    (out / made.cases[1].name / "result.json").unlink()
    files = sorted(path.relative_to(out) for path in out.rglob("*"))
    back = warpcrete.load(out)
    assert files == sorted(path.relative_to(out) for path in out.rglob("*"))  # not even what was cut is cleared away
    assert isinstance(back, Study) and not back.finished and repr(back).startswith("<Study of scene 'pipe': 1 of 2")
    first = back.cases[0].name
    run = back[first]
    assert list(back.runs()) == [first] and back.runs()[first].folder == run.folder
    assert run.scene.parameters["velocity"] == 0.3 and len(run.series["time"]) > 3
    assert back.table().loc[first, "peak_pressure"] == run["peak_pressure"] and back.plot().axes
    whole = made.table()
    read = pandas.read_parquet(out / "study.parquet").set_index("case")
    pandas.testing.assert_frame_equal(read, whole, check_dtype=False)
    (out / "study.json").write_text('{"scene": "none"}', encoding="utf-8")
    with pytest.raises(RunFolderError, match="does not exist in this version, which has"):
        warpcrete.load(out)


def test_names_of_folders_stay_short_and_different():
    """Names of the carried settings of a trade name every constant of a concrete."""
    long = "-".join(f"constant_{k}={k}" for k in range(40))
    names = {short_name(long), short_name(long + "-last=1"), short_name(long + "-last=2")}
    assert len(names) == 3 and {len(each) for each in names} == {MAX_NAME_LENGTH}
    assert short_name("concrete=no2-spacing=0.02") == "concrete=no2-spacing=0.02"


def test_a_study_of_sizes_says_that_its_trend_contradicts_the_paper(study, capsys):
    report_study(study)
    assert "Zhan" not in capsys.readouterr().out
    study.cases[:] = [replace(case, varied={"size_max": 0.01 * (n + 1)}) for n, case in enumerate(study.cases)]
    report_study(study)
    assert (
        "note: with the default stiffness of aggregates, pressures by discrete elements fall" in capsys.readouterr().out
    )
