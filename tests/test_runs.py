"""Runs as Python has them: read back from a folder, quantities by name, tables, plots, the viewer."""

import json
import shutil
import sys

import numpy as np
import pytest
from click.testing import CliRunner

import warpcrete
from warpcrete import RunFolderError, SceneError, Simulation, WarpcreteError, scenes
from warpcrete.cli.main import cli
from warpcrete.core.run import viewer
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
    assert "finished, 0.02 s" in repr(back) and "<table>" in back._repr_html_()
    assert "pressure" in back._ipython_key_completions_() and "finished" not in back._ipython_key_completions_()
    with pytest.raises(KeyError, match=r"'presure'; it has pressure"):
        back["presure"]


def test_a_killed_run_comes_back_as_far_as_it_got(ran, tmp_path):
    """No result, and a last row of which half is there, as a kill leaves them."""
    cut = tmp_path / "cut"
    shutil.copytree(ran.folder, cut)
    (cut / "result.json").unlink()
    text = (cut / "series.csv").read_text()
    rows = text.splitlines()
    (cut / "series.csv").write_text("\n".join(rows[:3]) + "\n" + rows[3][:5])
    back = warpcrete.load(cut)
    assert not back.finished and back.result == {} and "not finished" in repr(back)
    assert len(back.series["time"]) == 2
    assert back.series["pressure"] == pytest.approx(ran.series["pressure"][:2], rel=1e-8, nan_ok=True)
    (cut / "series.csv").write_text("")
    assert warpcrete.load(cut).series == {}
    for text in (b"time [s],pressure [Pa]\n1,two\n", b"time [s],pressure [Pa]\n1\n2\n", b"time [s]\n\xff\n"):
        (cut / "series.csv").write_bytes(text)
        says = r"series\.csv': (is no series of a run|cannot be read .line 2: is no UTF-8 text)"
        with pytest.raises(RunFolderError, match=says):
            warpcrete.load(cut)


def test_what_is_no_run_folder_is_refused(ran, tmp_path):
    with pytest.raises(RunFolderError, match=r"none': is no folder$"):
        warpcrete.load(tmp_path / "none")
    with pytest.raises(RunFolderError, match=r"is no run folder \(it holds no scene\.json\)$"):
        warpcrete.load(tmp_path)
    study = tmp_path / "study"
    shutil.copytree(ran.folder, study / "001")
    with pytest.raises(RunFolderError, match=r"holds no scene\.json\); runs are in 001"):
        warpcrete.load(study)
    (study / "parts").mkdir()
    (study / "001").rename(study / "parts" / "bend")
    with pytest.raises(RunFolderError, match=r"runs are in parts/bend"):
        warpcrete.load(study)


def test_a_run_whose_scene_cannot_be_made_again_comes_back(ran, tmp_path):
    """As one whose mesh file has gone."""
    moved = tmp_path / "moved"
    shutil.copytree(ran.folder, moved)
    record = json.loads((moved / "scene.json").read_text())
    record["parameters"]["spacing"] = 5.0
    (moved / "scene.json").write_text(json.dumps(record))
    back = warpcrete.load(moved)
    assert back["pressure"] == ran["pressure"] and back.scene.name == "channel" and "channel" in repr(back)
    record["scene"] = ["channel"]
    (moved / "scene.json").write_text(json.dumps(record))
    with pytest.raises(RunFolderError, match="names no scene of this version"):
        warpcrete.load(moved)


def test_a_series_is_a_table(ran, monkeypatch):
    table = ran.table()
    assert table.index.name == "time" and list(table.columns) == [name for name in ran.series if name != "time"]
    assert (
        table["pressure"].to_numpy() == pytest.approx(ran.series["pressure"], nan_ok=True)
        and table.attrs["units"] == ran.units
    )
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(WarpcreteError, match=r"pip install 'warpcrete\[notebook\]'; run\.series has the same"):
        ran.table()


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


def test_a_viewer_says_what_it_lacks(ran, tmp_path, monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(RunFolderError, match=r"holds no run\.rrd; record one"):
        ran.view()
    with pytest.raises(RunFolderError, match=r"the run has no folder"):
        Simulation(scenes.channel(duration=0.001, spacing=0.01, length=0.1), device="cpu", threads=1).run().view()
    for name in ("run.rrd", "run-001.rrd"):
        (tmp_path / name).write_bytes(b"")
    refused = CliRunner().invoke(cli, ["view", str(tmp_path)])
    assert "there is no screen here (DISPLAY is not set); --web" in str(refused.exception)
    assert viewer(tmp_path, web=True)[2:] == [
        "rerun", str(tmp_path / "run.rrd"), str(tmp_path / "run-001.rrd"), "--web-viewer",
    ]  # fmt: skip
    monkeypatch.setenv("DISPLAY", ":0")
    assert "--web-viewer" not in viewer(tmp_path)
