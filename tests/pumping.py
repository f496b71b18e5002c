"""A small pumping scene for tests, the command as a user calls it, and waiting for what it does."""

import subprocess
import sys
import time

import numpy as np
import psutil
import trimesh

from warpcrete.geometry.axis import Axis, Line

# A thin, short pipe that runs in seconds.
SMALL = dict(
    diameter=0.08, length=0.16, travel=0.08, ramp=0.03, elbow_radius=0.15, settle=0.5, size_min=6e-3, size_max=16e-3
)
TINY = dict(
    length=0.1, diameter=0.06, ramp=0.005, travel=0.01, settle=0.02, size_min=8e-3, size_max=12e-3, plug="plate"
)


def command(*arguments, timeout=300, **options):
    return subprocess.run(
        [sys.executable, "-c", "from warpcrete.cli import main; main()", *map(str, arguments)],
        capture_output=True,
        text=True,
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
