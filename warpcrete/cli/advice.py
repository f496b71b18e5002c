"""Option `--accuracy` of `warpcrete run`: settings chosen from a measured trade-off of speed and accuracy."""

import math
import re
from pathlib import Path

import click

from ..core.device.device import find_device
from ..core.errors import RunFolderError
from ..core.records import SceneArguments
from ..core.run.folder_kinds import wrong_folder
from ..core.run.scene_module import SceneModule
from ..studies.tradeoffs.advice import advise, nearest_shipped


def chosen(
    name: str,
    module: SceneModule,
    parameters: SceneArguments,
    accuracy: str | None,
    trade: Path | None,
    device: str | None,
) -> SceneArguments:
    """Return the parameters to change so that the run reaches the requested accuracy in the shortest time.

    The settings were found in an earlier measurement of speed and accuracy. `trade` is the folder of this measurement;
    if it is None, use the measurement of a similar scene that comes with the package. `name`, `module` and `parameters`
    describe the scene of the run: its name, its Python module and the parameters that the user set.

    The function prints the chosen settings and their expected error to stderr. It also prints the parameters in which
    the scene differs from the measured scene, because the error may be larger for this scene. Raises
    :class:`click.UsageError` if no measurement is available or `accuracy` is not a percentage.
    """
    if accuracy is None:
        raise click.UsageError(f"trade = '{trade}': has no effect without --accuracy; add, for example, --accuracy 5%")
    if trade is not None and not (trade / "trade.json").is_file():
        raise RunFolderError(f"trade = '{trade}': {wrong_folder(trade, 'trade.json', resumed=False)}")
    try:
        part = float(accuracy.strip().removesuffix("%")) / 100
    except ValueError:
        raise click.UsageError(
            f"accuracy = {accuracy!r}: must be a percentage above 0 % and below 100 %, such as 5%"
        ) from None
    source = trade or nearest_shipped(name, module, parameters, find_device(device).is_cuda)
    if source is None:
        raise click.UsageError(
            f"accuracy = {accuracy!r}: needs --trade FOLDER, because warpcrete contains no measured trade-off "
            f"for a similar scene {name}; create this folder with 'warpcrete trade {name} --budget 20min' and the same "
            "parameters"
        )
    advice = advise(source, name, module, parameters, part)
    quantities = " and ".join(advice.quantities)
    if trade is None:
        version = f" with version {advice.version}" if re.fullmatch(r"[\d.]+", advice.version) else ""
        click.echo(
            f"note: settings from the shipped trade {source.stem!r}, measured{version} on {advice.machine}", err=True
        )
    if advice.left_out:
        click.echo(
            f"note: {advice.setting}, without {'; '.join(advice.left_out)}: the error of this combination is unknown",
            err=True,
        )
    else:
        there = f" ({advice.time:.2g} s on that machine)" if math.isfinite(advice.time) else ""
        click.echo(f"note: {advice.setting}: {quantities} within {100 * advice.promised:.2g} %, "
                   f"in {advice.ratio:.2g} times the wall time{there}", err=True)  # fmt: skip
    if advice.tried:
        click.echo(f"note: also measured for {', '.join(advice.tried)}", err=True)
    if advice.outside:
        click.echo(f"note: not measured with {', '.join(advice.outside)}, so the error may be larger", err=True)
    return advice.changes
