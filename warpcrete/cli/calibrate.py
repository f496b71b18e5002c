"""Command `warpcrete calibrate`: parameters of a concrete from measured quantities."""

from pathlib import Path
from typing import Any

import click

from ..core.device.device import PRECISIONS
from ..core.errors import RunFolderError, suggested
from ..core.inputs.by_name import trust_option
from ..core.run.files import next_folder
from ..core.run.folder_kinds import wrong_folder
from ..core.run.progress import progress_bar
from ..core.run.scene_module import SceneModule
from ..studies.calibration.calibrate import RECORD, resume_calibration, run_calibration
from ..studies.calibration.calibration import Calibration
from ..studies.calibration.report import parameter_table, target_table
from .exits import INTERRUPTED
from .study import ON_WORKERS, parsed, single

ONE = {
    "trials": int, "batch": int, "repeat": int, "seed": int, "out": Path, "resume": Path, "device": str,
    "precision": str, "processes": int, **ON_WORKERS,
}  # fmt: skip
CHANGEABLE_SETTINGS = ("trials", "processes", *ON_WORKERS)
"""Names of the command's settings that may be changed when an interrupted calibration continues."""


def run(arguments: list[str], modules: dict[str, SceneModule]) -> None:
    """Start a new calibration or continue an interrupted one, and print its results."""
    targets, options = parsed(arguments)
    quiet = options.pop("quiet", None) is not None
    settings = single(options, ONE)
    if options:
        wrong = next(iter(options))
        hint = suggested(wrong, ONE).replace("'", "'--", 1) or "set the parameters of scenes in the file of targets"
        raise click.UsageError(f"--{wrong}: is not an option of 'warpcrete calibrate'; {hint}")
    if settings.get("precision", PRECISIONS[0]) not in PRECISIONS:
        raise click.UsageError(f"precision = {settings['precision']!r}: must be {' or '.join(PRECISIONS)}")
    with progress_bar(quiet) as settings["progress"]:
        if "resume" in settings:
            calibration = _resumed(targets, settings, modules)
        elif targets is None:
            raise click.UsageError(
                "targets: the file of targets is missing; give its path, or continue a calibration with --resume FOLDER"
            )
        else:
            out = settings.pop("out", None) or next_folder("calibration")
            calibration = run_calibration(Path(targets), modules, out=out, **settings)
    report(calibration)


def _resumed(targets: str | None, settings: dict[str, Any], modules: dict[str, SceneModule]) -> Calibration:
    folder = settings.pop("resume")
    strange = [name for name in settings if name not in (*CHANGEABLE_SETTINGS, "progress")]
    if targets is not None or strange:
        raise click.UsageError(
            f"resume = '{folder}': a calibration continues with the settings with which it began, and "
            f"only {', '.join(f'--{name}' for name in CHANGEABLE_SETTINGS)} can be changed; leave out everything else"
        )
    if not (folder / RECORD).is_file():
        raise RunFolderError(f"resume = '{folder}': {wrong_folder(folder, RECORD)}")
    return resume_calibration(folder, modules, **settings)


def report(found: Calibration) -> None:
    """Print the tables of a calibration, the parameters that the data do not determine, and the path of its folder."""
    click.echo()
    if found.posterior is not None:
        click.echo("\n".join([*parameter_table(found), "", *target_table(found), ""]))
        for said in found.findings:
            click.echo(f"note: {said}")
    verified = f" and {len(found.verifying)} runs that verify the answer" if found.verifying else ""
    coarse = f" after {len(found.coarse)} trials with wide cells" if found.coarse else ""
    click.echo(
        f"\n{len(found.searched)} trials{coarse}{verified} in {found.took:.0f} s; calibration folder: {found.folder}"
    )
    if not found.finished:
        click.echo(f"continue with: warpcrete {trust_option(found.record)}calibrate --resume {found.folder}")
        raise SystemExit(INTERRUPTED)
