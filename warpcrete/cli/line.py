"""`warpcrete line`: the pressure that a line of pipes needs."""

from __future__ import annotations

from pathlib import Path

import click

from ..core.amounts import amount
from ..core.files import next_folder
from ..core.progress import ProgressBar
from ..mix.mix import mix_named
from ..mps.mixes import concrete_of
from ..studies.line_result import lines_of
from ..studies.line_run import LAYER_FACTOR, run_line
from ..studies.lines import read_line, with_stone
from .run import CHECK_FAILED, INTERRUPTED
from .theory import growth_of


def run(
    line: str, *, concrete: str | None, flow: str | None, theory: bool, layer_factor: float | None, cells: int,
    out: Path | None, known: Path | None, device: str | None, threads: int | None, quiet: bool,
    rest: float | None, thixotropy: float | None,
) -> None:  # fmt: skip
    """Run the parts of a line and print what it needs."""
    given = read_line(line)
    if flow is None and given.flow is None:
        raise click.UsageError("flow: neither the line nor an option has it; --flow '30 m3/h'")
    if concrete is None and given.concrete is None:
        raise click.UsageError("concrete: neither the line nor an option has it; --concrete no1, or a file")
    rate = amount("flow", flow, "m3/s") if flow is not None else given.flow
    assert rate is not None
    name = str(concrete or given.concrete)
    chosen, mix = concrete_of(name), mix_named(name)
    if mix is not None and given.largest_stone is None:
        given = with_stone(given, mix.given.largest)
    growth = growth_of(rest, thixotropy)
    restart = [] if rest is None else [given.restart(chosen, rest, growth, each) / 1e5 for each in (0.0, rate)]
    progress = ProgressBar()
    folder = out or (None if theory else next_folder("line"))
    try:
        found = run_line(
            given, chosen, rate, out=folder, known=known, simulate=not theory,
            cells=cells, layer_factor=LAYER_FACTOR if layer_factor is None else layer_factor,
            band=mix.band if mix is not None and layer_factor is None else None, device=device, threads=threads,
            progress=None if quiet else progress,
        )  # fmt: skip
    except KeyboardInterrupt:
        if folder is not None and (folder / "parts").is_dir():
            click.echo(f"interrupted; parts that are finished are taken by: warpcrete line {line} --known {folder}")
        raise SystemExit(INTERRUPTED) from None
    finally:
        progress.close()
    click.echo("\n" + "\n".join(lines_of(found)))
    if restart:
        click.echo(f"\nafter {rest:g} s of rest, grown by {growth:g} Pa/s, it moves from {restart[0]:.4g} bar on; "
                   f"{restart[1]:.4g} bar set it going at that flow at once (theory)")  # fmt: skip
    if found.folder is not None:
        click.echo(f"\nfolder: {found.folder}; simulated in {sum(found.took.values()):.0f} s")
    if found.failed:
        raise SystemExit(CHECK_FAILED)
