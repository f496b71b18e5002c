"""Command `warpcrete explain`: memory, time step and run time of a scene before it runs."""

from pathlib import Path

import click

from ..core.errors import refuse
from ..core.run.scene_module import SceneModule
from ..studies.tradeoffs.explain import explain
from .options import check_scene
from .study import parameter_values, parsed, single

ONE = {"device": str, "threads": int, "trade": Path}


def run(arguments: list[str], modules: dict[str, SceneModule]) -> None:
    """Print the memory, the time step and the run time that are expected for a scene."""
    scene, options = parsed(arguments)
    settings = single(options, ONE)
    fresh = options.pop("fresh", None)
    if fresh:
        raise click.UsageError(f"--fresh = {' '.join(fresh)}: takes no value; leave out the text after --fresh")
    check_scene(scene, modules)
    values = parameter_values(modules[scene], options)
    for name, given in values.items():
        if len(given) > 1:
            refuse(name, ", ".join(map(str, given)), "must be a single value", "give the option once, with one value")
    built_scene = modules[scene].scene(**{name: given[0] for name, given in values.items()})
    click.echo(str(explain(built_scene, cache=fresh is None, announce=_announce, **settings)))


def _announce(text: str) -> None:
    """Print a note to standard error while the user waits for the result, which is printed to standard output."""
    click.echo(text, err=True)
