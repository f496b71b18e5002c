"""`warpcrete run SCENE --accuracy 5% --trade FOLDER`: settings by what a trade measured, and how far that carries."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ..core.errors import RunFolderError
from ..studies.advice import advise


def chosen(
    name: str, module: Any, parameters: dict[str, Any], accuracy: str | None, trade: Path | None
) -> dict[str, Any]:
    """Parameters to change for the wanted accuracy; says on stderr what, what to expect of it, and where not."""
    if accuracy is None:
        raise click.UsageError(f"trade = '{trade}': means nothing without --accuracy, as --accuracy 5%")
    if trade is None:
        raise click.UsageError(
            f"accuracy = {accuracy!r}: needs --trade FOLDER; make one with 'warpcrete trade {name} --budget 20min'"
        )
    if not (trade / "trade.json").is_file():
        raise RunFolderError(f"trade = '{trade}': is no trade's folder (it holds no trade.json)")
    try:
        part = float(accuracy.strip().removesuffix("%")) / 100
    except ValueError:
        raise click.UsageError(f"accuracy = {accuracy!r}: must be per cent, as 5%") from None
    found = advise(trade, name, module, parameters, part)
    quantities = " and ".join(found.quantities)
    if found.left_out:
        click.echo(f"note: {found.setting}, without {'; '.join(found.left_out)}: nothing is promised of that", err=True)
    else:
        click.echo(f"note: {found.setting}: {quantities} within {100 * found.promised:.2g} %, "
                   f"in {found.ratio:.2g} of the time", err=True)  # fmt: skip
    if found.outside:
        click.echo(f"note: not measured with {', '.join(found.outside)}: there the error may be larger", err=True)
    return found.changes
