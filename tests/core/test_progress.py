"""Progress in a terminal, in a notebook and in a log file."""

import re
import sys
from functools import partial
from types import SimpleNamespace

import pytest
import tqdm.auto
from pumping import command

from warpcrete import SceneError, scenes
from warpcrete.core.device import kernel_files, launching
from warpcrete.core.run import progress
from warpcrete.core.run.progress import ProgressBar
from warpcrete.mps.simulation import FluidSimulation


@pytest.fixture
def clock(monkeypatch):
    """A clock that stands still until a test sets it."""
    now = SimpleNamespace(time=100.0)
    monkeypatch.setattr(progress, "time", SimpleNamespace(monotonic=lambda: now.time))
    return now


def lines_of(capsys) -> list[str]:
    text = capsys.readouterr().err
    assert "\r" not in text
    return text.splitlines()


def test_a_log_gets_a_line_per_tenth(clock, capsys):
    bar = ProgressBar()
    for step in range(1001):
        clock.time = 100.0 + 0.1 * step
        bar("running", step / 1000, {"pressure": 31_740.0, "steps_per_s": 1234.5})
    bar.close()
    lines = lines_of(capsys)
    assert [line.partition(",")[0] for line in lines] == [f"running: {10 * k} %" for k in range(1, 11)]
    assert lines[2] == "running: 30 %, 00:30 elapsed, about 01:10 left, pressure 31.7 kPa, steps/s 1234"
    assert lines[-1] == "running: 100 %, 01:40 elapsed, pressure 31.7 kPa, steps/s 1234"


def test_a_resumed_run_counts_what_this_process_does(clock, capsys):
    """Each percent beyond 80 % takes 60 s, so that ten minutes are left at 90 %."""
    bar = ProgressBar()
    for minute in range(21):
        clock.time = 100.0 + 60 * minute
        bar("running", 0.8 + 0.01 * minute, {})
    lines = lines_of(capsys)
    assert lines[0] == "running: 81 %, 01:00 elapsed, about 19:00 left"
    assert "running: 90 %, 10:00 elapsed, about 10:00 left" in lines


def test_a_resumed_run_that_stands_still_counts_what_this_process_does(clock, capsys):
    """One of the 20 % that are left takes 90 s with a pause of 30 s, so that the last 19 % need 1710 s."""
    bar = ProgressBar()
    for elapsed, fraction in ((0, 0.8), (30, 0.8), (60, 0.81), (90, 0.81)):
        clock.time = 100.0 + elapsed
        bar("running", fraction, {})
    assert lines_of(capsys) == [
        "running: 80 %, 00:30 elapsed", "running: 81 %, 01:00 elapsed, about 09:30 left",
        "running: 81 %, 01:30 elapsed, about 28:30 left",
    ]  # fmt: skip


def test_the_time_left_follows_a_pace_that_changes(clock, capsys):
    """The first tenth takes 30 s and the second 60 s, so that the remaining eight need 480 s."""
    bar = ProgressBar()
    for elapsed, fraction in ((0, 0.0), (30, 0.1), (90, 0.2)):
        clock.time = 100.0 + elapsed
        bar("running", fraction, {})
    assert lines_of(capsys)[-1] == "running: 20 %, 01:30 elapsed, about 08:00 left"


def test_a_run_that_may_end_early_says_so(clock, capsys):
    bar = ProgressBar()
    for minute in range(4):
        clock.time = 100.0 + 60 * minute
        bar("running", 0.1 + 0.1 * minute, {"steps_per_s": 0.4711, "at_most": 1.0})
    assert (
        lines_of(capsys)[-1]
        == "running: 40 %, 03:00 elapsed, about 06:00 left unless the flow ends earlier, steps/s 0.47"
    )


def test_the_pace_of_a_run_leaves_out_preparation_and_compilation(monkeypatch):
    """Two steps between measurements take a second, but the first ones also 10 s to prepare and 50 s to compile.

    The wall time contains the preparation and not the compilation, and the pace contains neither.
    """
    now, told = [0.0], []
    monkeypatch.setattr(kernel_files, "time", SimpleNamespace(perf_counter=lambda: now[0]))
    monkeypatch.setattr(kernel_files._loading, "seconds", 0.0)

    class Slow(FluidSimulation):
        def reaching(self, time):
            if not self.stepper.steps:
                now[0] += 10.0
                with kernel_files.stop_run_clock():
                    now[0] += 50.0
            now[0] += 1.0
            yield from super().reaching(time)

    scene = scenes.channel(spacing=20e-3, duration=0.012, sample_interval=4e-3, time_step=2e-3)
    run = Slow(scene, device="cpu", progress=lambda phase, fraction, figures: told.append((phase, figures))).run()
    speeds = [figures.get("steps_per_s") for phase, figures in told if phase == "running"]
    assert run.result["steps"] == 6 and speeds == [None, 2.0, 2.0]
    assert run.result["speed"]["steps_per_second"]["value"] == 2.0
    assert run.result["speed"]["wall_time"]["value"] == 13.0
    assert "at_most" not in told[-1][1] and FluidSimulation(scenes.channel(), device="cpu").may_end_early


def test_the_time_left_leaves_out_compiling(clock, capsys):
    """Each tenth takes 10 s; compiling takes 40 s before the first and 100 s after the third."""
    bar = ProgressBar()
    calls = [(0, "packing", 0.0), (20, "compiling", 0.5), (40, "compiling", 1.0)]
    calls += [(40, "packing", 0.0), (50, "packing", 0.1), (60, "packing", 0.2), (70, "packing", 0.3)]
    calls += [(150, "compiling", 0.9), (170, "compiling", 1.0), (170, "packing", 0.3), (180, "packing", 0.4)]
    for elapsed, phase, fraction in calls:
        clock.time = 100.0 + elapsed
        bar(phase, fraction, {})
    lines = lines_of(capsys)
    assert lines[0] == "compiling: 50 %, 00:20 elapsed, about 00:20 left"  # 20 s passed before the first call
    assert [line.partition("%, ")[2] for line in lines if line.startswith("packing")] == [
        "00:10 elapsed, about 01:30 left", "00:20 elapsed, about 01:20 left", "00:30 elapsed, about 01:10 left",
        "00:40 elapsed, about 01:00 left",
    ]  # fmt: skip


def test_preparing_a_run_reports_compiling(monkeypatch):
    """Commands call `begin` themselves, before `run`."""
    told = []
    run = FluidSimulation(scenes.channel(), device="cpu", progress=lambda phase, *more: told.append(phase))
    monkeypatch.setattr(run, "prepare", lambda: launching._compile_callback.get()("compiling", 0.5))
    run.begin()
    assert told == ["compiling"]


def test_a_log_of_slow_work_gets_a_line_every_30_seconds(clock, capsys):
    bar = ProgressBar()
    for second in range(0, 7201):
        clock.time = 100.0 + second
        bar("running", second / 72000, {})
    lines = lines_of(capsys)
    assert len(lines) == 7200 // 30
    assert lines[0] == "running: 0 %, 00:30 elapsed, about 19:59:30 left"
    assert lines[-1] == "running: 10 %, 2:00:00 elapsed, about 18:00:00 left"


def test_a_log_of_fast_work_gets_at_most_a_line_a_second(clock, capsys):
    bar = ProgressBar()
    for phase, seconds in (("packing", 0.9), ("running", 2.0)):
        start = clock.time
        for step in range(101):
            clock.time = start + seconds * step / 100
            bar(phase, step / 100, {})
    assert lines_of(capsys) == ["running: 50 %, 00:01 elapsed, about 00:01 left", "running: 100 %, 00:02 elapsed"]


@pytest.mark.parametrize("where", ["terminal", "notebook", "disabled"])
def test_terminals_and_notebooks_get_a_bar(where, monkeypatch, capsys):
    if where == "notebook":
        shell = SimpleNamespace(config={"IPKernelApp": {}})
        monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    else:
        monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    bar = ProgressBar()
    monkeypatch.undo()
    if where == "disabled":  # as by the environment variable TQDM_DISABLE
        monkeypatch.setattr("tqdm.auto.tqdm", partial(tqdm.auto.tqdm, disable=True))
    bar("running", 0.5, {"pressure": 2000.0})
    bar.close()
    text = capsys.readouterr().err
    if where == "disabled":
        assert text == ""
        return
    assert "\r" in text and re.search(r"running +50% \|.*pressure=2.0 kPa", text)


def test_the_command_writes_no_bar_into_a_pipe(tmp_path):
    done = command("run", "channel", "--duration", "0.02", "--spacing", "0.01", "--length", "0.1", "--device", "cpu",
                   "--no-usd", "--no-rerun", "--out", tmp_path / "run")  # fmt: skip
    assert "\r" not in done.stderr and all(re.match(r"(\w+: \d+ %, |note: )", x) for x in done.stderr.splitlines())


def test_compiling_is_announced_once_without_a_progress_bar(capsys, monkeypatch):
    monkeypatch.setattr(progress, "_announced", False)
    for phase in ("packing", "compiling", "compiling"):
        progress.announce_compiling(phase, 0.5)
    assert capsys.readouterr().err == ("compiling kernels, which can take minutes; later runs find them in the cache\n")
    monkeypatch.setattr(progress, "_announced", False)
    progress.no_progress("compiling", 0.5)
    assert capsys.readouterr().err == ""


def test_a_simulation_of_your_own_may_pass_its_settings_on():
    """A class that accepts any setting passes it on, and only a class that lists its settings suggests names."""

    class Own(FluidSimulation):
        def __init__(self, scene, **settings):
            super().__init__(scene, **settings)

    assert str(Own(scenes.channel(), device="cpu").device) == "cpu"
    with pytest.raises(TypeError, match="devise"):
        Own(scenes.channel(), devise="cpu")
    with pytest.raises(SceneError, match=r"setting = 'devise': is not a setting of .*did you mean 'device'"):
        FluidSimulation(scenes.channel(), devise="cpu")
