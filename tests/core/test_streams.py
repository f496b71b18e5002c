"""Standard streams that are closed or full, the end of the terminal, and a cache of kernels that cannot be written."""

import io
import os
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest

from warpcrete.cli.console import prepare_streams
from warpcrete.core.device import device
from warpcrete.core.device.interrupts import StopAtSample
from warpcrete.core.device.kernel_files import kernel_cache_errors
from warpcrete.core.errors import DeviceError, DiskFullError
from warpcrete.core.run.progress import ProgressBar
from warpcrete.studies.api import study_progress

PREPARE = """\
from warpcrete.cli.console import prepare_streams
prepare_streams()
"""
SAY = f"""\
import os, sys
{PREPARE}
print("x" * 99999, file=sys.stderr, flush=True)
sys.stderr.isatty(), os.fstat(0), os.fstat(1), os.fstat(2)
print("done", flush=True)
"""


@pytest.mark.posix
@pytest.mark.parametrize("closed", [(2,), (0, 2), (0, 1, 2), ("full",), ("broken",)])
def test_messages_that_cannot_be_written_end_nothing(closed):
    def close():
        for number in closed:
            if number == "full":
                os.dup2(os.open("/dev/full", os.O_WRONLY), 2)
            elif number == "broken":
                there, here = os.pipe()
                os.close(there)
                os.dup2(here, 2)
            else:
                os.close(number)

    done = subprocess.run([sys.executable, "-c", SAY], stdout=subprocess.PIPE, preexec_fn=close)
    assert done.returncode == 0 and done.stdout == (b"" if 1 in closed else b"done\n")


@pytest.mark.posix
def test_a_report_for_a_terminal_that_is_closed_ends_nothing():
    """Writing to a closed terminal fails, but an interrupted run must keep its exit code."""
    there, terminal = os.openpty()
    say = "os.write(2, b'ready')\nsys.stdin.read()\nprint('report', flush=True)\nsys.exit(130)"
    words = [sys.executable, "-c", f"import os, sys\n{PREPARE}{say}"]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=terminal, stderr=subprocess.PIPE) as process:
        os.close(terminal)
        assert process.stderr.read(5) == b"ready"
        os.close(there)
        process.communicate()
    assert process.returncode == 130


def test_the_stream_that_is_replaced_stays_open(monkeypatch, tmp_path):
    with (tmp_path / "log").open("w", encoding="utf-8") as log:
        monkeypatch.setattr(sys, "stderr", io.TextIOWrapper(log.buffer, "utf-8"))
        prepare_streams()
        print("über", file=sys.stderr, flush=True)
        monkeypatch.undo()
    assert (tmp_path / "log").read_text(encoding="utf-8") == "über\n"


def test_a_program_without_standard_error_shows_no_bar(monkeypatch):
    monkeypatch.setattr(sys, "stderr", None)
    with study_progress(quiet=False) as tell:
        tell("running", 0.5, {})
    ProgressBar()("running", 0.5)


@pytest.mark.posix
def test_the_end_of_the_terminal_stops_a_run_once(monkeypatch):
    # Both signals are ignored in a background job without a terminal.
    before = {number: signal.signal(number, signal.default_int_handler) for number in (signal.SIGHUP, signal.SIGINT)}
    simulation = SimpleNamespace(finishing=False, stop_requested=False)
    try:
        with StopAtSample([simulation]):
            signal.raise_signal(signal.SIGHUP)
            signal.raise_signal(signal.SIGHUP)
            assert simulation.stop_requested
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_a_kernel_cache_that_cannot_be_written_is_named(monkeypatch):
    def refuse():
        raise PermissionError(13, "Permission denied", "/cache/1.19.0")

    monkeypatch.setattr(device.wp, "init", refuse)
    with pytest.raises(DeviceError, match=r"kernel cache = '/cache/1\.19\.0': cannot be used .*WARP_CACHE_PATH"):
        device.quiet_init()
    with pytest.raises(DiskFullError, match=r"cannot be written \(No space left"), kernel_cache_errors():
        raise OSError(28, "No space left on device")


def test_a_backend_of_matplotlib_that_is_missing_costs_no_picture(tmp_path):
    words = [sys.executable, "-m", "warpcrete", "line", "burj-khalifa", "--theory", "--out", "line"]
    subprocess.run(words, cwd=tmp_path, env=os.environ | {"MPLBACKEND": "nope"}, capture_output=True, check=True)
    assert (tmp_path / "line" / "line.png").is_file()
