"""Command `warpcrete reproduce`: repeats the runs of a paper and compares their results with the paper's results."""

from collections.abc import Sequence
from pathlib import Path

import click

from ..core.errors import RunFolderError
from ..core.run.files import next_folder
from ..core.run.folder_kinds import wrong_folder
from ..core.run.progress import progress_bar
from ..studies.reproduction.reproduce import RECORD, reproduce, resume_reproduction
from .run import INTERRUPTED


def run(
    paper: str | None, *, quick: bool, seeds: int, only: Sequence[str], known: Sequence[Path], out: Path | None,
    resume: Path | None, device: str | None, processes: int | None, quiet: bool,
) -> None:  # fmt: skip
    """Start or continue the reproduction of a paper, and print its report.

    `paper` is "zhan" or "xu", or None if `resume` is the folder of a reproduction to continue. The other arguments are
    the values of the command's options.
    """
    with progress_bar(quiet) as tell:
        if resume is not None:
            if paper is not None or out is not None or device is not None or quick or seeds != 1 or only or known:
                raise click.UsageError(
                    f"resume = '{resume}': a reproduction continues with the settings with which it began, and only "
                    "--processes can be changed; leave out everything else"
                )
            if not (resume / RECORD).is_file():
                raise RunFolderError(f"resume = '{resume}': {wrong_folder(resume, RECORD)}")
            reproduction = resume_reproduction(resume, processes=processes, progress=tell)
        elif paper is None:
            raise click.UsageError(
                "paper: is missing; give 'zhan' or 'xu', or continue a reproduction with --resume FOLDER"
            )
        else:
            folder = out or next_folder(f"reproduce-{paper}")
            reproduction = reproduce(paper, out=folder, quick=quick, seeds=seeds, only=only, known=known, device=device,
                              processes=processes, progress=tell)  # fmt: skip
    click.echo("\n" + (reproduction.folder / "reproduction.md").read_text(encoding="utf-8"))
    click.echo(f"folder: {reproduction.folder}")
    if not reproduction.finished:
        click.echo(f"continue with: warpcrete reproduce --resume {reproduction.folder}")
        raise SystemExit(INTERRUPTED)
