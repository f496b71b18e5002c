"""Recorders that fail, disks that are full, and the order in which a run writes its files."""

import errno
import json
import os
import re

import pytest
from run_folders import flow, same

from warpcrete import Simulation
from warpcrete.cli.run import PipelineRecorder
from warpcrete.core.errors import DiskFullError
from warpcrete.core.run import checkpoint
from warpcrete.core.run.files import LOCK, cannot_write
from warpcrete.core.run.recorder import Recorder
from warpcrete.record.checks import CheckRecorder
from warpcrete.record.loading import is_finished
from warpcrete.record.run_folder import TableRecorder

METHODS = ("start", "sample", "frame", "checkpoint", "write", "finish", "tidy")


class Failing(Recorder):
    """Fails in one of its methods, from a moment on."""

    expendable = True

    def __init__(self, method, error):
        self.closed = 0

        def fail(simulation, *arguments):
            if method not in ("sample", "frame", "checkpoint", "write") or len(simulation.rows) > 2:
                raise error
            return None

        setattr(self, method, fail)

    def close(self, simulation):
        self.closed += 1


@pytest.mark.parametrize("method", METHODS)
def test_a_recording_that_fails_costs_itself_alone(tmp_path, undisturbed_folder, method):
    failing = Failing(method, ValueError("no paint"))
    with pytest.warns(
        UserWarning, match="^Failing failed, and the run continues without its output: no paint$"
    ) as told:
        run = flow(tmp_path / "run", failing).run()
    assert run.finished and same(tmp_path / "run", undisturbed_folder) and len(told) == 1 and failing.closed == 1


@pytest.mark.parametrize("method", METHODS)
def test_a_full_disk_ends_the_run_which_goes_on_when_there_is_room(tmp_path, undisturbed_folder, method):
    full = cannot_write(tmp_path / "run" / "film", OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
    with pytest.raises(DiskFullError) as told:
        flow(tmp_path / "run", Failing(method, full)).run()
    assert str(told.value).startswith(f"'{tmp_path / 'run' / 'film'}': cannot be written (No space left on device); ")
    kept = float(re.search(r"; the checkpoint at t = (\S+) s is saved; free some space", str(told.value))[1])
    assert not is_finished(tmp_path / "run") and not (tmp_path / "run" / LOCK).exists()
    again = flow(tmp_path / "run")
    again.begin(tmp_path / "run" / "checkpoint.npz")
    assert again.stepper.time == pytest.approx(kept, abs=1e-9) and (kept > 0) == (method != "start")
    assert again.run().finished and same(tmp_path / "run", undisturbed_folder)


def test_every_file_that_could_not_be_written_is_named(tmp_path, monkeypatch):
    """The state is tried first, then the result and the series, then recordings; each is tried whatever came before."""
    tried = []

    def write(path, *given):
        tried.append("state")
        raise cannot_write(path, OSError(errno.ENOSPC, "full"))

    def write_json(path, data):
        tried.append(path.name)
        if path.name == "result.json":
            raise cannot_write(path, OSError(errno.EDQUOT, "quota"))
        path.write_text(json.dumps(data), encoding="utf-8")

    class Film(Recorder):
        expendable = True

        def finish(self, simulation, run):
            tried.append("film")
            raise cannot_write(tmp_path / "film", OSError(errno.EFBIG, "too large"))

    simulation = flow(tmp_path / "run", Film(), every=1e9)
    monkeypatch.setattr(checkpoint, "write_partial", write)
    monkeypatch.setattr("warpcrete.record.run_folder.write_json", write_json)
    monkeypatch.setattr(Simulation, "_checkpoint", lambda self: None)
    with pytest.raises(DiskFullError) as told:
        simulation.run()
    assert tried[:4] == ["scene.json", "state", "result.json", "film"]
    text = str(told.value)
    assert "result.json': cannot be written (quota); neither can" in text and f"'{tmp_path / 'film'}'" in text
    assert "no checkpoint was saved" in text and "\n" not in text


def test_a_checkpoint_writes_state_result_and_recordings_in_this_order(tmp_path, monkeypatch):
    order = []
    monkeypatch.setattr(checkpoint, "write_partial", lambda *given: order.append("state"))
    monkeypatch.setattr(checkpoint, "commit", lambda path: order.append("commit"))
    monkeypatch.setattr(TableRecorder, "write", lambda self, simulation: order.append("result"))

    class Film(Recorder):
        expendable = True

        def write(self, simulation):
            order.append("film")

    flow(tmp_path / "run", Film()).run()
    assert order[:2] == ["state", "commit"] == order[-2:]  # at t = 0 and at the end
    assert order[2:-2] == ["state", "result", "film", "commit"] * (len(order[2:-2]) // 4) and len(order) > 8


def test_checks_finish_before_the_table_that_writes_them(tmp_path):
    folder = tmp_path / "run"
    simulation = flow(folder, CheckRecorder(lambda run: {"any": (True, "found")}))
    simulation.run()
    assert json.loads((folder / "result.json").read_text(encoding="utf-8"))["checks"]["any"]["found"] == "found"


def test_a_pipeline_that_cannot_be_computed_costs_only_itself(tmp_path, monkeypatch):
    def fails(*arguments):
        raise KeyError("concrete_length")

    monkeypatch.setattr("warpcrete.cli.run.pipeline_estimate", fails)
    simulation = flow(tmp_path / "run", PipelineRecorder(10.0, None, {}))
    with pytest.warns(
        UserWarning,
        match=r"but the pressure of the whole pipeline was not computed: KeyError\('concrete_length'\)$",
    ):
        run = simulation.run()
    result = json.loads((tmp_path / "run" / "result.json").read_text(encoding="utf-8"))
    assert run.finished and result["finished"] and "pipeline_estimate" not in result
    assert not (tmp_path / "run" / "checkpoint.npz").exists()
