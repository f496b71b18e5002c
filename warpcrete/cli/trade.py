"""Command `warpcrete trade`: trade-off between speed and accuracy of a scene, measured within a limited time."""

import re
from pathlib import Path
from typing import Any

import click

from ..core.inputs.by_name import trust_option
from ..core.records import SceneArguments
from ..core.run.files import next_folder
from ..core.run.progress import progress_bar
from ..core.run.scene_module import SceneModule
from ..studies.tradeoffs.report import table
from ..studies.tradeoffs.state import Trade
from ..studies.tradeoffs.trade import resume_trade, run_trade
from .exits import INTERRUPTED
from .options import check_scene
from .study import ON_WORKERS, parameter_values, parsed, recorded_module, single

UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}
ONE = {"budget": str, "repeat": int, "out": Path, "resume": Path, "device": str, "threads": int, **ON_WORKERS}
SEVERAL = ("quantity", "knob")


def seconds(text: str) -> float:
    """Return the number of seconds in a text such as '90s', '20min' or '1.5h'."""
    match = re.fullmatch(r"([0-9.]+(?:e-?[0-9]+)?) ?(s|min|h)", text.strip())
    try:
        return float(match.group(1)) * UNITS[match.group(2)]  # type: ignore[union-attr]
    except (AttributeError, ValueError):
        raise click.UsageError(f"budget = {text!r}: must be a time such as 90s, 20min or 2h") from None


def run(arguments: list[str], modules: dict[str, SceneModule]) -> None:
    """Start or continue a trade-off between speed and accuracy, and print its tables."""
    scene, options = parsed(arguments)
    quiet = options.pop("quiet", None) is not None
    settings = single(options, ONE)
    lists = {name: options.pop(name) for name in SEVERAL if name in options}
    for name, values in lists.items():
        if not values:
            raise click.UsageError(f"--{name}: needs one or more names; write the names after it")
    anew = {name: settings.pop(name, None) for name in ON_WORKERS}
    anew["budget"] = seconds(settings.pop("budget", "20min"))
    with progress_bar(quiet) as tell:
        if "resume" in settings:
            trade = _resumed(scene, settings, options | lists, modules, anew | {"progress": tell})
        else:
            check_scene(scene, modules)
            values = parameter_values(modules[scene], options, (*ONE, *SEVERAL))
            for name, given in values.items():
                if len(given) > 1:
                    raise click.UsageError(
                        f"--{name} = {', '.join(map(str, given))}: must be a single value, because 'warpcrete trade' "
                        "varies only the settings that --knob names; give one value"
                    )
            trade = run_trade(
                scene, modules[scene], base={name: given[0] for name, given in values.items()}, progress=tell,
                out=settings.get("out") or next_folder("trade"), repeat=settings.get("repeat"),
                quantities=lists.get("quantity"), knobs=lists.get("knob"), device=settings.get("device"),
                threads=settings.get("threads"), **anew,
            )  # fmt: skip
    report(trade)


def _resumed(
    scene: str | None,
    settings: dict[str, Any],
    rest: SceneArguments,
    modules: dict[str, SceneModule],
    anew: SceneArguments,
) -> Trade:
    folder = settings.pop("resume")
    if scene is not None or settings or rest:
        raise click.UsageError(
            f"resume = '{folder}': a trade-off study continues with the settings with which it began, and only "
            "--budget, --scheduler and --workers can be changed; leave out everything else"
        )
    return resume_trade(folder, recorded_module(folder, "trade", modules), **anew)


def report(trade: Trade) -> None:
    """Print the tables of a speed-accuracy trade-off, the path of its folder, and the command that continues it."""
    click.echo()
    if trade.points and trade.given.results:
        click.echo(table(trade))
    left = [p for p in trade.points if not p.failure.startswith("failed") and not trade.complete(p, trade.seeds)]
    click.echo(f"\ntrade folder: {trade.folder}")
    if left or trade.interrupted:
        click.echo(
            f"{len(left)} settings not run; continue with: warpcrete {trust_option(trade.base)}trade --resume "
            f"{trade.folder} --budget 20min"
        )
    if trade.interrupted:
        raise SystemExit(INTERRUPTED)
