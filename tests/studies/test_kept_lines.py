"""Lines whose parts are simulated: scenes of the parts, and what their results come to, kept (see `kept`)."""

import importlib
import json
from dataclasses import replace
from types import SimpleNamespace

import kept
import numpy as np
import pytest
import trimesh

from warpcrete.core.run.files import write_json
from warpcrete.core.units import quantity
from warpcrete.dem.scene.checks import OUTFLOW_CHECK
from warpcrete.geometry.axis import Axis, Line
from warpcrete.geometry.lines import line_of
from warpcrete.mps.common.mixes import concrete_of
from warpcrete.record.run_folder import TableRecorder
from warpcrete.scenes import modules
from warpcrete.studies.lines import blocking as by_blocking
from warpcrete.studies.lines import elements as by_elements
from warpcrete.studies.lines.blocking import BlockingProbability, _counted, _parameters, run_blocking
from warpcrete.studies.lines.element_line import ElementLine, SeedResult, WallLaw, element_table_lines
from warpcrete.studies.lines.elements import Elements, part_parameters
from warpcrete.studies.lines.fittings import library_factor, range_of
from warpcrete.studies.lines.folder import part_simulation, previous_run
from warpcrete.studies.lines.pressures import Stop
from warpcrete.studies.lines.result import lines_of
from warpcrete.studies.lines.run import run_line
from warpcrete.studies.running import outcome_of

run_module = importlib.import_module("warpcrete.studies.lines.run")
FLOW = 30 / 3600
PARTS = [
    {"straight": 10},
    {"bend": {"to": "up", "radius": 0.5}},
    {"straight": 20},
    {"reducer": {"to": 0.1, "length": 1}},
    {"straight": 2},
    {"bend": {"to": "level", "angle": 4, "radius": 0.4}},
    {"valve": {"equivalent": 20}},
    {"hose": {"length": 4, "factor": 2.5}},
    {"straight": 5},
    {"bend": {"to": "right", "angle": 60, "radius": 0.12}},
    {"straight": 5},
]


@pytest.fixture
def line(tmp_path):
    return line_of({"diameter": 0.125, "largest_stone": 0.016, "parts": PARTS})


@pytest.fixture
def meshed(tmp_path):
    """Return a line with a bore that is wider than it is high."""
    vertices, faces = Axis((0, 0, 0), (1, 0, 0), (Line(0.3),)).swept(np.linspace(0, 0.3, 7), 0.0625, 32)
    middle = np.sin(np.pi * vertices[:, 0] / 0.3) ** 2
    vertices[:, 2] *= 1 - 0.2 * middle
    trimesh.Trimesh(vertices, faces, process=False).export(tmp_path / "valve.stl")
    path = tmp_path / "valve.stl"
    return line_of(
        {"diameter": 0.125, "parts": [{"straight": 2}, {"bore": {"file": str(path), "length": 0.3}}, {"straight": 1}]}
    )


def result_of(scene):
    """Return a made-up result that depends on the scene only."""
    size = scene.parameters["spacing"] * scene.parameters["flow"]
    return {
        "finished": True,
        "wall_stress": quantity(1e7 * size, "Pa"),
        "middle_loss": quantity(3e8 * size, "Pa"),
        "speed": {"wall_time": quantity(2.0, "s")},
        "checks": {"steady": {"passed": scene.name != "part", "found": "no"}},
    }


@pytest.mark.parametrize("kind", ["line", "meshed"])
def test_a_simulated_line_is_kept(kind, line, meshed, monkeypatch):
    line = {"line": line, "meshed": meshed}[kind]
    asked, told = [], []

    def part_simulation(scene, check, out, called, digest, **settings):
        asked.append(
            [
                called,
                scene.name,
                check.__module__,
                len(digest),
                settings["device"],
                settings["threads"],
                {k: v for k, v in scene.parameters.items() if v is not None and k != "wall"},
            ]
        )
        settings["progress"]("running", 0.5, {})
        done = SimpleNamespace(finished=True, result=result_of(scene))
        return SimpleNamespace(begin=lambda checkpoint: None, run=lambda: done), None

    monkeypatch.setattr(run_module, "part_simulation", part_simulation)
    settings = dict(simulate=True, cells=10, layer_factor=1.5, device="cpu", threads=2)
    found = run_line(
        line,
        concrete_of("no1"),
        FLOW,
        stop=Stop(600.0, 0.4, (0.1, 0.9)),
        **settings,
        progress=lambda phase, fraction, figures: told.append([phase, fraction]),
    )
    some = run_line(line, concrete_of("no2"), FLOW, unless_known=True, **settings)
    columns, units = found._columns()
    kept.compare(
        f"line-{kind}",
        {
            "asked": asked,
            "told": told,
            "record": found.record(),
            "lines": lines_of(found, True),
            "columns": columns,
            "units": units,
            "figure": kept.drawn(found.plot()),
            "recorded": kept.drawn(replace(found, line=replace(line, recorded=3e5)).plot())["axes0"]["lines"],
            "took": found.took,
            "failed": found.failed,
            "some": [
                [loss.friction, loss.theory, loss.weight, loss.at(0), loss.at(1), loss.range] for loss in some.losses
            ],
            "course": found.course(lambda loss: loss.friction),
            "volume": [found.volume, found.residence_time, found.power],
            "restart": [found.restart(), found.restart(FLOW)],
            "library": [[library_factor(part), range_of(part, 1e3)] for part in line.parts],
        },
    )
    assert found.volume == pytest.approx(line.bores.volume(0, line.length))


def seed_result(line, seed):
    laws = {d: WallLaw(d, 100.0 + 10 * seed, 0.03, 4e4, 9e4) for d in (0.125, 0.1)}
    ratios = {part.loss_key: 1.1 + 0.1 * seed for part in line.parts if part.kind in ("bend", "reducer")}
    blocked = {part.loss_key: part.kind == "reducer" and seed == 1 for part in line.parts}
    return SeedResult(laws, ratios, 2300.0 + seed, blocked)


def test_a_line_by_elements_is_kept(line, monkeypatch):
    elements = Elements(shapes="reference", seeds=2, stiffer=4.0)
    found = ElementLine(
        line, "zhan", FLOW, [seed_result(line, 0), seed_result(line, 1)], ["a remark"], {"bend": 3.0}, 4.0
    )
    kinds = dict(by_elements._kinds(line))
    parameters = [
        part_parameters(part, key[-1] == by_elements.PRESSED_RUN, line, concrete, FLOW, given, 3)
        for key, part in kinds.items()
        for concrete, given in (("zhan", elements), ("zhan", Elements(coarse=1.5)))
    ]
    columns = {
        "axial_stress": np.array([np.nan, 1e3, 2e3, 5e3]),
        "wall_stress": np.array([1.0, 50.0, 70.0, 110.0]),
        "bulk_density": np.array([np.nan, 2300.0, 2310.0, 2290.0]),
    }
    law = WallLaw.of(0.1, columns, 6e3)
    runs = {
        key: SimpleNamespace(
            tables={"stations": SimpleNamespace(columns=columns)},
            result={"middle_ratio": 1.2 + 0.1 * k},
            scene=SimpleNamespace(parameters={"modulus": 1e5 * (k + 1)}),
        )
        for k, key in enumerate(kinds)
    }
    kept.compare(
        "line-elements",
        {
            "record": found.record(),
            "table": element_table_lines(found, {"flow": [1e3 * k for k in range(len(line.parts))]}),
            "pressures": found.pressures,
            "course": found.packed[1].course(line),
            "blocked": found.blocked(),
            "repr": repr(found),
            "law": law,
            "gradients": [law.gradient(p) for p in (0.0, 1e3, 5.5e3, 2e4)],
            "seed": by_elements._seed_result(kinds, runs),
            "names": [by_elements._run_name(key, part, 2) for key, part in kinds.items()],
            "parameters": parameters,
            "blocking": _parameters(line.parts[3], line, "zhan", FLOW, elements, 4),
        },
    )


@pytest.mark.parametrize("kind", ["line", "meshed"])
def test_runs_of_a_line_by_elements_are_kept(kind, line, meshed, tmp_path, monkeypatch):
    """Two seeds of each kind of part, with runs that are made up; the first of them is known from an earlier line."""
    line = {"line": line, "meshed": meshed}[kind]
    asked, told, known = [], [], []

    def run_of(scene):
        own = scene.parameters
        k = own["seed"] + len(asked) % 3
        columns = {
            "axial_stress": np.array([np.nan, 1e3, 2e3, 5e3]) * (1 + 0.1 * k),
            "wall_stress": np.array([1.0, 50.0, 70.0, 110.0]) / own["diameter"] ** 0.1,
            "bulk_density": np.array([np.nan, 2300.0, 2310.0, 2290.0 + k]),
        }
        result = {
            "middle_ratio": quantity(1.2 + 0.1 * k, "1"), "blocked": float(own["unit"] != "horizontal" and k > 1),
            "flux_ratio": quantity(0.5 + 0.25 * k, "1"), "speed": {"wall_time": quantity(2.0 + k, "s")},
            "checks": {"energy": {"passed": k < 2, "found": f"{k} %"}},
        }  # fmt: skip
        tables = {"stations": SimpleNamespace(columns=columns)}
        return SimpleNamespace(finished=True, result=result, tables=tables, scene=SimpleNamespace(parameters=own))

    def part_simulation(scene, check, out, called, digest, **settings):
        asked.append([called, scene.name, check.__module__, out.name, len(digest), *settings.values()])
        return SimpleNamespace(scene=scene), called

    def run_many(simulations, checkpoints, progress):
        assert list(checkpoints) == [each[0] for each in asked]
        progress("running", 0.5)
        return [run_of(each.scene) for each in simulations]

    def previous(folders, scene, digest):
        known.append([[None if each is None else each.name for each in folders], len(digest)])
        return scene if len(known) == 1 else None

    clock = iter(range(100))
    monkeypatch.setattr(by_elements, "wall_clock", SimpleNamespace(perf_counter=lambda: 2.5 * next(clock)))
    monkeypatch.setattr(by_elements, "part_simulation", part_simulation)
    monkeypatch.setattr(by_elements, "method_of", lambda scene: SimpleNamespace(run_many=run_many))
    monkeypatch.setattr(by_elements, "previous_run", previous)
    monkeypatch.setattr(by_elements, "load", run_of)
    monkeypatch.setattr(by_elements, "check_known", lambda folder: known.clear())
    found = by_elements.run_elements(
        line, "zhan", FLOW, elements=Elements(seeds=2), out=tmp_path / "out", known=tmp_path / "known", device="cpu",
        threads=2, progress=lambda *each: told.append(each),
    )  # fmt: skip
    assert json.loads((tmp_path / "out" / "line-dem.json").read_text(encoding="utf-8")) == found.record()
    kept.compare(
        f"line-runs-{kind}",
        {"asked": asked, "told": told, "known": known, "record": found.record(), "remarks": found.remarks,
         "failed": found.failed, "took": found.took},
    )  # fmt: skip
    for failed, error in ((SimpleNamespace(finished=False), KeyboardInterrupt), (ValueError("burst"), ValueError)):
        many = SimpleNamespace(run_many=lambda simulations, *rest, failed=failed: [failed] * len(simulations))
        monkeypatch.setattr(by_elements, "method_of", lambda scene, many=many: many)
        with pytest.raises(error):
            by_elements.run_elements(line, "zhan", FLOW, out=tmp_path / "other", device="cpu")


@pytest.mark.parametrize(("ratio", "fails"), [(0.4, False), (1.5, True), (float("nan"), True), (None, False)])
def test_only_too_small_an_outflow_of_a_part_is_a_remark(line, monkeypatch, ratio, fails):
    """An outflow larger than the inflow is no compression, so it stays a failed check; old runs have no checks."""
    columns = {"axial_stress": np.array([0.0, 1e3, 2e3, 5e3]), "wall_stress": np.array([1.0, 50.0, 70.0, 110.0]),
               "bulk_density": np.full(4, 2300.0)}  # fmt: skip

    def run_of(scene):
        checks = {} if ratio is None else {"checks": {OUTFLOW_CHECK: {"passed": False, "found": "much"}}}
        result = {"middle_ratio": quantity(1.2, "1"), "flux_ratio": quantity(ratio or 1.0, "1"), **checks}
        return SimpleNamespace(result=result, tables={"stations": SimpleNamespace(columns=columns)}, scene=scene)

    monkeypatch.setattr(by_elements, "previous_run", lambda folders, scene, digest: scene)
    monkeypatch.setattr(by_elements, "load", run_of)
    found = by_elements.run_elements(line, "zhan", FLOW)
    names = [by_elements._run_name(key, part, 0) for key, part in by_elements._kinds(line)]
    assert found.failed == ({name: [f"{OUTFLOW_CHECK}: much"] for name in names} if fails else {})
    remarks = [remark for remark in found.remarks if remark.endswith(": much") and "FAILED" not in remark]
    assert remarks == ([f"{name}: much" for name in dict.fromkeys(names)] if ratio == 0.4 else [])


def test_a_probability_of_blocking_is_kept(line):
    own = _parameters(line.parts[3], line, "zhan", FLOW, Elements(coarse=1.0), 0)
    results = {
        str(k): {"blocked": float(k % 3 == 0), "slowest_advance": 0.05 * k, "packing": {"bodies": 900 + k}}
        for k in range(9)
    }
    study = SimpleNamespace(results=results, failures={"x": "burst"}, cases=[SimpleNamespace(parameters=own)])
    found = _counted(study, line.parts[3], Elements(coarse=1.0))
    enlarged = BlockingProbability(line.parts[1], 20, 0, 0, 0, 500, 0.02, 2.0, 0.5)
    kept.compare(
        "line-blocking",
        {"record": found.record(), "lines": found.lines, "enlarged": enlarged.lines, "interval": enlarged.interval},
    )


def test_the_study_of_a_blocking_is_kept(line, tmp_path, monkeypatch):
    """The narrowest part with so many seeds, or the study of before; runs are made up."""
    asked, resumed = [], []

    def study_of(cases, finished=True):
        results = {
            case.name: {"blocked": float(k == 1), "slowest_advance": 0.1, "packing": {"bodies": 800}}
            for k, case in enumerate(cases)
        }
        return SimpleNamespace(results=results, failures={}, cases=cases, finished=finished)

    def run_listed(scene, module, cases, *, out, **settings):
        asked.append([scene, module.__name__, [[c.name, c.varied, c.parameters] for c in cases], settings])
        asked.append([str(out.relative_to(tmp_path)), study_of(cases).finished])
        return study_of(cases, finished=len(cases) != 2)

    monkeypatch.setattr(by_blocking, "run_listed", run_listed)

    def resume_study(folder, module, **settings):
        resumed.append([str(folder.relative_to(tmp_path)), module.__name__, settings])
        own = _parameters(line.parts[3], line, "zhan", FLOW, Elements(), 0)
        return study_of([SimpleNamespace(name="a", parameters=own)])

    monkeypatch.setattr(by_blocking, "resume_study", resume_study)
    out = tmp_path / "line"
    out.mkdir()
    found = run_blocking(line, "zhan", FLOW, 3, out=out, elements=Elements(stiffer=3.0), device="cpu", processes=2)
    files = [path.name for path in out.iterdir()]
    record = json.loads(next(out.glob("*.json")).read_text(encoding="utf-8"))
    kept.compare("line-blocking-study", {"asked": asked, "record": record, "lines": found.lines, "files": files})
    with pytest.raises(KeyboardInterrupt):
        run_blocking(line, "zhan", FLOW, 2, out=out, device="cpu")
    folder = out / asked[1][0].partition("/")[2]
    folder.mkdir(parents=True)
    (folder / "study.json").touch()
    assert run_blocking(line, "zhan", FLOW, 3, out=out, processes=4).runs == 1
    assert resumed == [[asked[1][0], "warpcrete.scenes.part_dem", {"processes": 4, "progress": None}]]


def folder_with(path, result=None, checkpoint=False, failed=""):
    path.mkdir()
    if result is not None:
        (path / "result.json").write_text(json.dumps(result), encoding="utf-8")
    if checkpoint:
        (path / "checkpoint.npz").touch()
    if failed:
        (path / "failed.txt").write_text(f"{failed}\n", encoding="utf-8")
    return path


def test_what_a_folder_says_of_its_run(tmp_path):
    """Only a finished run with checks, and without a checkpoint left, is an outcome; an error is one, too."""
    good = {"finished": True, "checks": {}}
    assert outcome_of(folder_with(tmp_path / "good", good)) == good
    assert outcome_of(folder_with(tmp_path / "cut", good, checkpoint=True)) is None
    assert outcome_of(folder_with(tmp_path / "unchecked", {"finished": True})) is None
    assert outcome_of(folder_with(tmp_path / "unfinished", {"finished": False, "checks": {}})) is None
    assert outcome_of(folder_with(tmp_path / "empty")) is None
    assert str(outcome_of(folder_with(tmp_path / "failed", good, failed="it burst"))) == "it burst"


def test_runs_of_parts_are_used_again_if_they_are_the_same(tmp_path):
    """Another number, another file, another mesh or a modified scene is another run."""
    channel = modules()["channel"]
    scene = channel.scene(spacing=0.02)
    parts = tmp_path / "line" / "parts"
    record = {"parameters": json.loads(json.dumps(dict(scene.parameters))), "files": scene.parameters.files}

    def stored(name, result={"finished": True}, checkpoint=False, **more):  # noqa: B006
        parts.mkdir(parents=True, exist_ok=True)
        folder = folder_with(parts / name, result, checkpoint)
        write_json(folder / "scene.json", record | more)
        return folder

    def found(digest=""):
        return previous_run([None, tmp_path / "nothing", tmp_path / "line"], scene, digest)

    assert found() is None
    stored("a", modified={"x": 1})
    stored("b", parameters=record["parameters"] | {"spacing": 0.03})
    stored("c", files={"x.stl": "0"})
    stored("d", result=None)
    stored("e", result={"finished": False})
    begun = stored("f", checkpoint=True)
    assert found() is None
    simulation, checkpoint = part_simulation(scene, channel.check, tmp_path / "line", "new", device="cpu", threads=1)
    assert checkpoint is None and isinstance(simulation.recorders[0], TableRecorder)
    assert simulation.recorders[0].folder == parts / "d"  # the first that is the same and not complete
    for name in "de":
        (parts / name / "scene.json").unlink()
    simulation, checkpoint = part_simulation(scene, channel.check, tmp_path / "line", "new", device="cpu", threads=1)
    assert checkpoint == begun / "checkpoint.npz" and simulation.checkpoint_path == checkpoint
    (begun / "scene.json").unlink()
    for _ in range(2):  # no folder is made before the run begins
        simulation, checkpoint = part_simulation(scene, channel.check, tmp_path / "line", "a", device="cpu", threads=1)
        assert checkpoint is None and simulation.recorders[0].folder.name == "a-2"
    whole = stored("g-0123")
    assert found() == whole and found("0123") == whole and found("4567") is None
    simulation, checkpoint = part_simulation(scene, channel.check, None, "a", device="cpu", threads=1)
    assert checkpoint is None and len(simulation.recorders) == 1


def test_a_part_whose_run_was_interrupted_gives_no_loss(monkeypatch):
    """The line stops with its first unfinished run, and starts no further one."""
    begun = []

    def part_simulation(scene, *given, **settings):
        run = SimpleNamespace(finished=False, result={})
        return SimpleNamespace(begin=lambda checkpoint: begun.append(scene), run=lambda: run), None

    monkeypatch.setattr(importlib.import_module("warpcrete.studies.lines.run"), "part_simulation", part_simulation)
    line = line_of({"diameter": 0.1, "parts": [{"straight": 3}, {"bend": "up"}, {"straight": 2}]})
    with pytest.raises(KeyboardInterrupt):
        run_line(line, concrete_of("no1"), FLOW, simulate=True, device="cpu")
    assert len(begun) == 1
