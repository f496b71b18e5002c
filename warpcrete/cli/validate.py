"""Command `warpcrete validate`: comparison of blind predictions with measurements."""

from pathlib import Path

import click

from ..core.errors import SceneError
from ..core.run.files import check_new
from ..core.run.folders import new_folder
from ..core.run.progress import progress_bar
from ..studies.validation.cases import read_cases
from ..studies.validation.validate import Validation, validate


def run(
    kind: tuple[str, ...],
    quick: bool,
    cases: Path | None,
    out: Path | None,
    every: bool,
    device: str | None,
    quiet: bool,
) -> None:
    """Predict the measured cases and print the comparison; with `out`, also write tables and a figure into this folder.

    The other arguments are the values of the command's options. If `every` is true, the printed table has a row for
    each case. Raises :class:`SceneError` if the program refuses to predict all cases.
    """
    if out is not None:
        check_new(out)
    given = None if cases is None else read_cases(cases)
    with progress_bar(quiet) as tell:
        validation = validate(given, kinds=kind, quick=quick, device=device, progress=tell)
    if not (validation.comparisons or validation.blocking):
        _print_refused(validation)
        raise SceneError("cases: none was compared, for the reasons above; correct the file, or choose other cases")
    if every:
        click.echo(validation.table())
    else:
        click.echo("\n".join(validation.summary_lines()))
        if validation.blocking:
            click.echo("\n" + "\n".join(validation.blocking_lines()))
        _print_refused(validation)
    if out is not None:
        with new_folder(out):
            validation.write(out)
        click.echo(f"written: {out / 'validation.md'}")


def _print_refused(validation: Validation) -> None:
    """Print the cases that the program refuses to predict, with the reasons."""
    for name, why in validation.refused.items():
        click.echo(f"refused: {name}: {why}")
