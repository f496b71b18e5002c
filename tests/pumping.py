"""A small pumping scene for tests, the command as a user calls it, and waiting for what it does."""

import contextlib
import functools
import importlib
import os
import signal
import subprocess
import sys
import tempfile
import time
import warnings

import numpy as np
import psutil
import pytest
import trimesh

from warpcrete import Simulation, scenes
from warpcrete.cli import main
from warpcrete.geometry.axis import Axis, Line

INTERRUPTIBLE = (
    "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from warpcrete.cli import main; main()"
)
"""Program that runs the command in a process that Ctrl-C interrupts. Without it, the processes that a shell begins in
the background ignore Ctrl-C, and a test that sends it would wait for ever."""

# A thin, short pipe that runs in seconds.
SMALL = dict(
    diameter=0.08, length=0.16, travel=0.08, ramp=0.03, elbow_radius=0.15, settle=0.5, size_min=8e-3, size_max=16e-3
)
TINY = dict(
    length=0.1, diameter=0.06, ramp=0.005, travel=0.01, settle=0.02, size_min=8e-3, size_max=12e-3, plug="plate"
)


@functools.cache
def small_run(device, precision="float32"):
    """A run of the scene `SMALL`, shared by all tests that compare another run with it; change nothing in it."""
    return Simulation(scenes.pipe(**SMALL), device=device, precision=precision).run()


@contextlib.contextmanager
def to_file(number, redirect):
    """Redirect an output stream of this process, given by its file descriptor, and yield the file that receives it."""
    kept = os.dup(number)
    try:
        with tempfile.TemporaryFile("w+", encoding="utf-8") as file, redirect(file):
            os.dup2(file.fileno(), number)
            yield file
    finally:
        os.dup2(kept, number)
        os.close(kept)


def command(*arguments):
    """Call the `warpcrete` command in this process, which spares the start of an interpreter.

    Returns exit code, standard output and standard error as :func:`command_process` does. Use that function where
    the process itself matters: its folder, environment, signals or imports.
    """
    words, texts = ["warpcrete", *map(str, arguments)], []
    handler, code = signal.getsignal(signal.SIGTERM), 0
    with (
        pytest.MonkeyPatch.context() as patched, warnings.catch_warnings(),
        to_file(1, contextlib.redirect_stdout) as out, to_file(2, contextlib.redirect_stderr) as err,
    ):  # fmt: skip
        # Show the warnings that a Python program shows, whatever pytest makes of them.
        warnings.simplefilter("default")
        for kind in (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning):
            warnings.simplefilter("ignore", kind)
        patched.setattr(sys, "argv", words)
        # After a full disk, the command would end this process.
        patched.setattr(importlib.import_module("warpcrete.cli.main"), "EXIT_TIMEOUT", 1e6)
        try:
            main()
        except SystemExit as ended:
            code = ended.code or 0
        finally:
            signal.signal(signal.SIGTERM, handler)
        for file in (out, err):
            file.seek(0)
            texts.append(file.read())
    return subprocess.CompletedProcess(words, code, *texts)


def command_process(*arguments, timeout=300, **options):
    """Call the `warpcrete` command in a process of its own, as a user does."""
    return subprocess.run(
        [sys.executable, "-c", "from warpcrete.cli import main; main()", *map(str, arguments)],
        capture_output=True,
        encoding="utf-8",
        timeout=timeout,
        **options,
    )


def small_options(**changes):
    values = SMALL | changes
    return [text for name, value in values.items() for text in (f"--{name.replace('_', '-')}", str(value))]


def alive(process: psutil.Process) -> bool:
    try:
        return process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def wait_until(condition, seconds: float) -> bool:
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.2)
    return False


def open_tube(path, hole: bool):
    axis = Axis((0, 0, 0), (0, 0, 1), (Line(0.4),))
    vertices, faces = axis.tube(0.04, 32)
    if hole:
        faces = np.delete(faces, [5, 6], axis=0)
    trimesh.Trimesh(vertices, faces, process=False).export(path)
    return path
