"""Tables, records and figures of studies with made-up results, kept (see `kept`), and settings of their runs."""

import importlib
import json
from types import SimpleNamespace

import kept
import pytest
from made_studies import FAILED, measured

from warpcrete.core.run.method import Quantity
from warpcrete.scenes import modules
from warpcrete.studies.cases import cases_of
from warpcrete.studies.study_result import Study
from warpcrete.studies.study_table import columns_of

QUANTITIES = [
    Quantity("peak_pressure", "Pa", lambda known: None, compared=True),
    Quantity("end_pressure", "Pa", lambda known: None, compared=True),
    Quantity("coordination_number", "1", lambda known: None, compared=True),
    Quantity("blocked", "1", lambda known: None, compared=True, rare=True),
    Quantity("never", "s", lambda known: None, compared=True),
]
VARIED = {
    "numbers": dict(varied={"velocity": [0.1, 0.3], "diameter": [0.1, 0.2]}, repeat=2),
    "words": dict(
        varied={"shapes": ["spheres", "reference"], "friction": [0.1, 0.2]},
        one_at_a_time=True,
        defaults={"shapes": "spheres", "friction": 0.1},
        repeat=2,
    ),
    "seeds": dict(varied={}, repeat=3),
}


@pytest.mark.parametrize("kind", VARIED)
def test_a_study_is_kept(tmp_path, kind):
    base = {"unit": "A", "concrete": "zhan", "flow": 0.0053, "seed": 4}
    cases = cases_of(base, **VARIED[kind])
    study = Study(tmp_path, "pipe", cases, QUANTITIES, {"velocity": "m/s", "diameter": "m", "flow": "m3/s"})
    for k, case in enumerate(cases[:-1]):
        study.results[case.name] = measured(k, blocked=float(k == 1), checks=FAILED if k in (0, 3) else {})
    lost = cases[1].name
    study.results.pop(lost)
    study.failures[lost], study.not_at_fault = "the worker died", {lost}
    study.write(figure=False)
    kept.compare(
        f"study-{kind}",
        {
            "cases": [[case.name, case.varied, case.parameters] for case in cases],
            "study": study,
            "rows": study.rows(),
            "table": columns_of(study),
            "csv": (tmp_path / "study.csv").read_text(encoding="utf-8").splitlines(),
            "markdown": (tmp_path / "study.md").read_text(encoding="utf-8").splitlines(),
            "repr": repr(study)[:50],
            "figure": kept.drawn(study.plot()),
        },
    )


def test_every_setting_of_a_study_reaches_its_runs(tmp_path, monkeypatch):
    """No setting is exchanged with another, dropped, or replaced by its default on the way down."""
    study = importlib.import_module("warpcrete.studies.study")
    running = importlib.import_module("warpcrete.studies.running")
    tube = modules()["tube"]
    got = {}
    monkeypatch.setattr(study, "run_listed", lambda *cases, **settings: got.update(settings, cases=cases))
    given = dict(
        device="cpu",
        precision="float64",
        processes=3,
        frames=7.0,
        checkpoint_every=11.0,
        scheduler=None,
        workers=None,
        progress=print,
        rerun=True,
        usd=False,
    )
    study.run_study("tube", tube, {"flow": [1e-3, 2e-3]}, base={"diameter": 0.1}, out=tmp_path / "s", **given)
    name, module, cases = got.pop("cases")
    assert got == given | {"out": tmp_path / "s", "units": {}} and (name, module) == ("tube", tube)
    assert [case.varied for case in cases] == [{"flow": 1e-3}, {"flow": 2e-3}]
    assert all(case.parameters["precision"] == "float64" and case.parameters["diameter"] == 0.1 for case in cases)
    seeds = dict(base={"seed": 5, "aggregates": True}, out=tmp_path / "s", repeat=3)
    study.run_study("tube", tube, {"flow": [1e-3, 2e-3], "diameter": [0.1, 0.2, 0.3]}, **seeds)
    assert len(got["cases"][2]) == 18 and {case.parameters["seed"] for case in got["cases"][2]} == {5, 6, 7}
    study.run_study("tube", tube, {"flow": [1e-3, 2e-3], "diameter": [0.1, 0.2, 0.3]}, one_at_a_time=True, **seeds)
    assert [tuple(case.varied.values()) for case in got["cases"][2][::3]] == [
        (1e-3, 0.1),
        (2e-3, 0.1),
        (None, 0.1),
        (None, 0.2),
        (None, 0.3),
    ]
    monkeypatch.undo()
    record = {}
    monkeypatch.setattr(
        study,
        "_continue",
        lambda out, module, processes, cluster, progress: record.update(
            json.loads((out / "study.json").read_text(encoding="utf-8")),
            got=(out, module, processes, cluster, progress),
        ),
    )
    study.run_listed("tube", tube, cases, out=tmp_path / "t", figure=False, **given)
    assert record["got"] == (tmp_path / "t", tube, 3, None, print)
    assert record["command"] == {"frames": 7.0, "checkpoint_every": 11.0, "rerun": True, "usd": False}
    assert (record["scene"], record["device"], record["precision"], record["figure"]) == (
        "tube",
        "cpu",
        "float64",
        False,
    )
    assert [case["parameters"]["flow"] for case in record["cases"]] == [1e-3, 2e-3]
    made = {}

    class Recorded(SimpleNamespace):
        def __init__(self, scene, **settings):
            super().__init__(scene=scene, **settings)
            made.update(settings, scene=scene)

    monkeypatch.setattr(running, "Simulation", Recorded)
    for every, frames, threads in ((11.0, 4.0, 2), (0.0, None, None)):
        record["command"] |= {"checkpoint_every": every, "frames": frames}
        record |= {"threads": threads} if threads else {}
        simulation, checkpoint = running.simulation_of(record, tube, tmp_path / "t", cases[1], print)
        assert made["scene"].parameters["flow"] == 2e-3 and made["device"] == "cpu" and made["precision"] == "float64"
        assert made["threads"] == 2 and made["progress"] is print and simulation.shares_cores and checkpoint is None
        assert made["frame_interval"] == (0.25 if frames else None) and made["checkpoint_every"] == every
        file = tmp_path / "t" / cases[1].name / "checkpoint.npz"
        assert made["checkpoint_path"] == (file if every else None)
    file.parent.mkdir()
    file.touch()
    assert running.simulation_of(record, tube, tmp_path / "t", cases[1], print)[1] == file
    del record["threads"]
    running.simulation_of(record, tube, tmp_path / "t", cases[1], print)
    assert made["threads"] == 1
