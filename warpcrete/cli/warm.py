"""Command `warpcrete warm`: compile the kernels of scenes before their first run."""

from __future__ import annotations

import time
from typing import Any

import click

from ..core.device.device import find_device
from ..methods import method_of
from ..studies.tradeoffs.explain import explain
from .options import check_scene


def run(names: tuple[str, ...], modules: dict[str, Any], device: str | None) -> None:
    """Compile the kernels that the default runs of the named scenes need, or those of all scenes if no name is given.

    Raises :class:`warpcrete.SceneError` for an
    unknown scene or device before anything is compiled.
    """
    for name in names:
        check_scene(name, modules)
    found = find_device(device)
    for name in names or modules:
        scene = modules[name].scene()
        started = time.perf_counter()
        # A forecast takes the first steps of a small copy of the scene, measures it and draws a frame, so it compiles
        # all kernels of a run.
        explain(scene, device=str(found), cache=False)
        click.echo(f"{name:12s} {method_of(scene).name:10s} {time.perf_counter() - started:5.1f} s")
    click.echo(f"kernels for {found} are ready; later runs of these scenes with their features start without compiling")
