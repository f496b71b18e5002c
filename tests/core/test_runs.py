"""Runs as Python has them: read back from a folder, quantities by name, tables, plots, the viewer."""

import copy
import dataclasses
import json
import os
import pickle
import re
import shutil
import subprocess
import sys
import urllib.request
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from pumping import alive, wait_until

import warpcrete
from warpcrete import RunFolderError, SceneError, Simulation, WarpcreteError, scenes
from warpcrete.core.errors import PlausibilityWarning
from warpcrete.core.run.columns import Columns
from warpcrete.core.run.quantities import Amount, Quantities, Result
from warpcrete.core.run.run import viewer
from warpcrete.core.run.tables import Table
from warpcrete.core.run.viewer import Viewer
from warpcrete.record import run_folder
from warpcrete.record.rerun import RerunRecorder
from warpcrete.record.run_folder import TableRecorder


@pytest.fixture(scope="module")
def ran(tmp_path_factory):
    """A short flow and its folder."""
    folder = tmp_path_factory.mktemp("runs") / "one"
    scene = scenes.channel(duration=0.02, spacing=0.01, length=0.1)
    return Simulation(scene, device="cpu", threads=1, recorders=[TableRecorder(folder)]).run()


def test_a_run_comes_back_from_its_folder(ran):
    back = warpcrete.load(str(ran.folder))
    assert back.finished and back.scene.name == "channel" and dict(back.scene.parameters) == dict(ran.scene.parameters)
    assert list(back.series) == list(ran.series) and back.units == ran.units
    for name, column in ran.series.items():
        assert back.series[name] == pytest.approx(column, rel=1e-8, nan_ok=True)
    assert back["pressure"] == ran["pressure"] == ran.result["pressure"]["value"]
    assert back["particles"] == ran.result["particles"]
    assert "finished (duration), 0.02 s" in repr(back) and "<table>" in back._repr_html_()
    assert "pressure" in back._ipython_key_completions_() and "finished" not in back._ipython_key_completions_()
    with pytest.raises(KeyError, match=r"'presure'; similar names are pressure"):
        back["presure"]


def test_further_tables_of_a_run_come_back_with_nine_digits(ran, tmp_path):
    """A run along a pipe has a table of its stations, which the same functions write and read as the series."""
    columns = {"place": np.array([1 / 3, 2 / 3]), "pressure": np.array([1234567.891, np.nan])}
    stations = Table(columns, {"place": "m", "pressure": "Pa"})
    shutil.copytree(ran.folder, tmp_path / "one")
    run_folder._write_table(tmp_path / "one" / "stations.csv", stations)
    back = warpcrete.load(tmp_path / "one").tables["stations"]
    assert back.units == stations.units and list(back.columns) == list(columns)
    for name, column in columns.items():
        assert back.columns[name] == pytest.approx(column, rel=1e-9, nan_ok=True)


def test_a_killed_run_comes_back_as_far_as_it_got(ran, tmp_path):
    """No result, and a last row of which half is there, as a kill leaves them."""
    cut = tmp_path / "cut"
    shutil.copytree(ran.folder, cut)
    (cut / "result.json").unlink()
    text = (cut / "series.csv").read_text(encoding="utf-8")
    rows = text.splitlines()
    (cut / "series.csv").write_text("\n".join(rows[:3]) + "\n" + rows[3][:5], encoding="utf-8")
    back = warpcrete.load(cut)
    assert not back.finished and back.result == {} and "not finished" in repr(back)
    with pytest.raises(KeyError, match="has no quantities, because it ended before its results were written"):
        back["pressure"]
    assert len(back.series["time"]) == 2
    assert back.series["pressure"] == pytest.approx(ran.series["pressure"][:2], rel=1e-8, nan_ok=True)
    (cut / "series.csv").write_text("", encoding="utf-8")
    assert warpcrete.load(cut).series == {}
    for text in (b"time [s],pressure [Pa]\n1,two\n", b"time [s],pressure [Pa]\n1\n2\n", b"time [s]\n\xff\n"):
        (cut / "series.csv").write_bytes(text)
        says = r"series\.csv': (is not the table of a run's samples|cannot be read .line 2: is not UTF-8 text)"
        with pytest.raises(RunFolderError, match=says):
            warpcrete.load(cut)


def test_what_is_no_run_folder_is_refused(ran, tmp_path):
    with pytest.raises(RunFolderError, match=r"none': does not exist$"):
        warpcrete.load(tmp_path / "none")
    with pytest.raises(RunFolderError, match=r"series\.csv': is a file; give its folder"):
        warpcrete.load(ran.folder / "series.csv")
    with pytest.raises(RunFolderError, match=r"is not the folder of a run \(it contains no scene\.json\)$"):
        warpcrete.load(tmp_path)
    study = tmp_path / "study"
    shutil.copytree(ran.folder, study / "001")
    with pytest.raises(RunFolderError, match=r"contains no scene\.json\); its runs are in 001"):
        warpcrete.load(study)
    (study / "parts").mkdir()
    (study / "001").rename(study / "parts" / "bend")
    with pytest.raises(RunFolderError, match=r"runs are in parts/bend"):
        warpcrete.load(study)


def test_a_run_whose_scene_cannot_be_made_again_comes_back(ran, tmp_path):
    """A run can be loaded although its scene cannot be made, for example because the scene's mesh file has gone."""
    moved = tmp_path / "moved"
    shutil.copytree(ran.folder, moved)
    record = json.loads((moved / "scene.json").read_text(encoding="utf-8"))
    record["parameters"]["spacing"] = 5.0
    (moved / "scene.json").write_text(json.dumps(record), encoding="utf-8")
    back = warpcrete.load(moved)
    assert back["pressure"] == ran["pressure"] and back.scene.name == "channel" and "channel" in repr(back)
    record["scene"] = ["channel"]
    (moved / "scene.json").write_text(json.dumps(record), encoding="utf-8")
    with pytest.raises(RunFolderError, match="is damaged: its entry 'scene' has the wrong value"):
        warpcrete.load(moved)


def test_a_series_is_a_table(ran, monkeypatch):
    table = ran.table()
    assert table.index.name == "time" and list(table.columns) == [name for name in ran.series if name != "time"]
    assert (
        table["pressure"].to_numpy() == pytest.approx(ran.series["pressure"], nan_ok=True)
        and table.attrs["units"] == ran.units
    )
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(WarpcreteError, match=r"pip install pandas, or use the arrays in run\.series"):
        ran.table()


def test_a_series_is_a_dataset(ran, tmp_path, monkeypatch):
    pytest.importorskip("xarray", reason="needs xarray, which the extra [test] installs")
    found = ran.to_xarray()
    assert set(found.data_vars) == set(ran.series) - {"time"} and found.sizes == {"time": len(ran.series["time"])}
    for name, column in ran.series.items():
        assert np.array_equal(found[name].to_numpy(), column, equal_nan=True)
        assert found[name].attrs == {"units": ran.units[name], "long_name": name.replace("_", " ")}
    assert found.attrs["scene"] == "channel"
    assert json.loads(found.attrs["parameters"])["spacing"] == 0.01
    assert json.loads(found.attrs["quantities"])["pressure"] == ran["pressure"]
    table = Table({"place": np.array([0.0, 1.0]), "stress": np.array([3.0, 4.0])}, {"place": "m", "stress": "Pa"})
    monkeypatch.setitem(ran.tables, "stations", table)
    places = ran.to_xarray("stations")
    assert places["stress"].sel(place=1.0) == 4.0 and places["place"].attrs["units"] == "m"
    with pytest.raises(SceneError, match=r"^table = 'radius': must be one of stations"):
        ran.to_xarray("radius")


def test_a_loaded_run_is_copied_in_a_new_process(ran, tmp_path):
    """A process that has simulated nothing has not imported the class of run folders yet."""
    code = f"import warpcrete; warpcrete.load({str(ran.folder)!r}).save({str(tmp_path / 'copy')!r})"
    subprocess.run([sys.executable, "-c", code], check=True)
    assert (tmp_path / "copy" / "series.csv").read_bytes() == (ran.folder / "series.csv").read_bytes()


def test_failed_checks_are_shown(ran):
    failed = copy.copy(ran)
    failed.result = ran.result | {"checks": {"steady": {"passed": False, "found": "no"}}}
    assert failed.failed_checks == ["steady"] and "failed checks: steady" in repr(failed)
    assert "<td>failed checks</td><td>steady</td>" in failed._repr_html_()


def test_a_quantity_is_no_column_of_a_plot(ran):
    with pytest.raises(SceneError, match=r"pressure_theory is a single number, run\['pressure_theory'\]"):
        ran.plot("pressure_theory")


@pytest.mark.parametrize(("name", "hint"), [
    ("slump", "write warpcrete.scenes.slump"), ("run", "write warpcrete.Simulation"), ("nothing", "'nothing'$"),
])  # fmt: skip
def test_the_package_names_what_to_write_instead(name, hint):
    with pytest.raises(AttributeError, match=hint):
        getattr(warpcrete, name)


def test_a_warning_names_the_line_of_the_user():
    with pytest.warns(PlausibilityWarning, match="yield_stress") as caught:
        scenes.slump(yield_stress="300 kPa")
    assert {warning.filename for warning in caught} == {__file__}


def test_the_lines_of_the_readme_need_no_further_packages(ran, tmp_path, monkeypatch, capsys):
    """A plain installation has neither pandas nor xarray. The run of the lines is replaced by a short one."""
    text = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.S)
    monkeypatch.chdir(tmp_path)
    for package in ("pandas", "xarray"):
        monkeypatch.setitem(sys.modules, package, None)
    simulation = SimpleNamespace(run=lambda: ran)
    monkeypatch.setattr(warpcrete, "Simulation", lambda *given, **settings: simulation, raising=False)
    monkeypatch.setattr(warpcrete, "load", lambda folder: SimpleNamespace(view=lambda: None), raising=False)
    exec(code.replace("end_pressure", "pressure"))
    assert "columns of" in capsys.readouterr().out and (tmp_path / "pressure.png").is_file()


def test_a_dataset_needs_xarray(ran, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(WarpcreteError, match=r"pip install xarray, or use the arrays in run\.series"):
        ran.to_xarray()


def test_quantities_know_their_units(ran):
    pressure = ran["pressure"]
    assert pressure == ran.result["pressure"]["value"] and type(pressure + 1) is float
    assert repr(pressure) == str(pressure) == f"{ran.result['pressure']['value']:.6g} Pa"
    assert (
        f"{pressure:.1f}" == f"{ran.result['pressure']['value']:.1f}" and json.loads(json.dumps(pressure)) == pressure
    )
    assert pressure.to("bar") == pytest.approx(pressure / 1e5) and pressure.to("Pa") == pressure
    assert pickle.loads(pickle.dumps(pressure)).unit == copy.copy(pressure).unit == "Pa"
    with pytest.raises(SceneError, match=r"^unit = 'm': must be one of Pa, bar"):
        pressure.to("m")
    assert pressure.to("kPa").unit == "kPa" and repr(pressure.to("kPa").to("Pa")) == repr(pressure)
    assert repr(Amount(16000.0, "Pa/m").to("kPa/m")) == "16 kPa/m"
    assert Amount(2.0, "J").to("J") == 2.0
    assert type(ran["particles"]) is float
    lines = repr(ran.quantities).splitlines()
    assert len(lines) == len(ran.quantities) and any(
        line.split() == ["pressure", *repr(pressure).split()] for line in lines
    )
    assert f"<td>{pressure!r}</td>" in ran.quantities._repr_html_()
    assert repr(Quantities()) == "no quantities"


def test_printed_series_and_results_are_summaries(ran):
    """A line for each column with unit, ends and range, instead of all numbers; a line for each result."""
    series = Columns(
        {"time": np.array([0.0, 0.5, 1.0]), "pressure": np.array([np.nan, 31_750.0, 2e4])},
        {"time": "s", "pressure": "Pa"}, "sample",
    )  # fmt: skip
    assert repr(series).splitlines() == [
        "2 columns of 3 samples",
        "column    unit  first   last  smallest  largest",
        "time      s         0      1         0        1",
        "pressure  Pa      nan  20000     20000    31750",
    ]
    assert "<td>31750</td>" in series._repr_html_() and "<th>largest</th>" in series._repr_html_()
    assert pickle.loads(pickle.dumps(series))._units == copy.copy(series)._units == {"time": "s", "pressure": "Pa"}
    assert repr(Columns({"wear": np.zeros(0)}, {})).splitlines()[0] == "1 column of 0 rows"
    assert repr(ran.series).startswith(f"{len(ran.series)} columns of {len(ran.series['time'])} samples\ncolumn")
    table = Table({"place": np.array([1.0]), "name": np.array(["hose"])}, {"place": "m"})
    copied = dataclasses.asdict(table)
    assert list(copied["columns"]) == ["place", "name"] and copied["units"] == {"place": "m"}
    assert repr(table).startswith("2 columns of 1 row\n") and "hose" in table._repr_html_()
    lines = dict(line.split("  ", 1) for line in repr(ran.result).splitlines())
    assert lines["pressure"].strip() == repr(ran["pressure"]) and lines["provenance.device"].strip() == "cpu"
    assert json.loads(json.dumps(ran.result))["pressure"]["unit"] == "Pa" and repr(Result()) == "no results"


def test_a_run_draws_its_columns(ran):
    """In the units that people read; columns of one unit share an axis."""
    (axes,) = ran.plot().axes
    assert axes.get_ylabel() == "pressure [kPa]" and axes.get_xlabel() == "time [s]"
    assert axes.lines[0].get_ydata() == pytest.approx(ran.series["pressure"] / 1e3, nan_ok=True)
    assert axes.lines[0].get_xdata() == pytest.approx(ran.series["time"])
    above, below = ran.plot("pressure", "slip_velocity", against="slip_velocity").axes
    assert below.get_ylabel() == below.get_xlabel() == "slip velocity [cm/s]"
    assert np.array(below.lines[0].get_xdata()) == pytest.approx(100 * ran.series["slip_velocity"], nan_ok=True)
    assert above.get_xlabel() == ""
    with pytest.raises(SceneError, match=r"^column = 'force': must be one of time, "):
        ran.plot("force")


@pytest.mark.parametrize("level", [None, "debug"])
def test_a_viewer_has_the_log_that_the_user_wants(tmp_path, monkeypatch, capfd, level):
    """Without RUST_LOG neither the viewer nor Rerun's library prints anything; the variable itself stays as it was."""
    if level:
        monkeypatch.setenv("RUST_LOG", level)
    else:
        monkeypatch.delenv("RUST_LOG", raising=False)
    told = tmp_path / "told"
    code = f"import os, sys; open({str(told)!r}, 'w').write(os.environ['RUST_LOG']); sys.stderr.write('a line')"
    assert Viewer([sys.executable, "-c", code], "nowhere").start().wait(60) == 0
    assert told.read_text(encoding="utf-8") == (level or "off") and capfd.readouterr().err == (
        "a line" if level else ""
    )
    RerunRecorder(tmp_path / "run.rrd")
    assert os.environ.get("RUST_LOG") == level


def test_a_viewer_says_what_it_lacks(ran, tmp_path, monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(RunFolderError, match=r"contains no recording \(run\.rrd\); record a new run"):
        ran.view()
    with pytest.raises(RunFolderError, match=r"the run has no folder"):
        Simulation(scenes.channel(duration=0.001, spacing=0.01, length=0.1), device="cpu", threads=1).run().view()
    for name in ("run.rrd", "run-001.rrd"):
        (tmp_path / name).write_bytes(b"RRF2")
    assert viewer(tmp_path).in_browser  # without a screen, a browser shows the recording
    served = viewer(tmp_path, web=True)
    place = served.command.index(str(tmp_path / "run.rrd"))
    assert served.command[place + 1 :][:4] == [str(tmp_path / "run-001.rrd"), "--serve-web", "--bind", "127.0.0.1"]
    assert served.address.startswith("http://127.0.0.1:") and {host for host, _ in served.endpoints} == {"127.0.0.1"}
    for bind, words in (("no address", "must be an IP address"), ("203.0.113.1", "is not an address of this machine")):
        with pytest.raises(SceneError, match=f"^bind = '{bind}': {words}"):
            viewer(tmp_path, web=True, bind=bind)
    monkeypatch.setenv("DISPLAY", ":0")
    assert not viewer(tmp_path).in_browser
    command = viewer(tmp_path, bind="::1").command
    assert "--serve-web" not in command and command[command.index("--bind") + 1] == "::1"


def listeners(process: psutil.Process) -> set[str]:
    """Addresses that a process and its children listen on."""
    every = [process, *process.children(recursive=True)]
    return {c.laddr.ip for each in every for c in each.net_connections("tcp") if c.status == psutil.CONN_LISTEN}


@pytest.mark.thorough
@pytest.mark.parametrize("option", [["--web"], []], ids=["asked for", "no screen"])
def test_a_recording_is_served_to_this_machine_alone(ran, tmp_path, option):
    """One line with the address, nothing of the server's log; the server ends with the command."""
    screens = ("DISPLAY", "WAYLAND_DISPLAY")
    environment = {name: value for name, value in os.environ.items() if name not in screens}
    Simulation(ran.scene, device="cpu", threads=1, recorders=[RerunRecorder(tmp_path / "run.rrd")]).run()
    code = "from warpcrete.cli import main; main()"
    process = subprocess.Popen(
        [sys.executable, "-uc", code, "view", str(tmp_path), *option], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        encoding="utf-8", env=environment,
    )  # fmt: skip
    try:
        address = process.stdout.readline().strip()
        assert urllib.request.urlopen(address.partition("?")[0], timeout=10).status == 200
        servers = psutil.Process(process.pid).children(recursive=True)
        assert servers and listeners(psutil.Process(process.pid)) == {"127.0.0.1"}
    finally:
        process.kill()
    said = process.communicate()
    assert said[0] == "" and len(said[1].splitlines()) == (not option)
    assert option or "has no screen (DISPLAY is not set); open the following address" in said[1]
    assert wait_until(lambda: not any(map(alive, servers)), 10)
