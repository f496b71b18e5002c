"""Command `warpcrete line`: the pressure that a pipeline needs at its start."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click

from ..core.errors import positive
from ..core.inputs.amounts import amount
from ..core.inputs.fingerprints import fingerprint
from ..core.inputs.limits import check_limit, check_velocity, check_whole
from ..core.run.files import atomic_file, next_folder
from ..core.run.progress import ProgressBar
from ..mix.mix import completed, mix_named
from ..mps.mixes import concrete_of
from ..studies.lines.blocking import run_blocking
from ..studies.lines.elements import ElementLine, Elements, element_table_lines, run_elements
from ..studies.lines.folder import PARTS, line_folder
from ..studies.lines.losses import PipeLine, friction, read_line, restart, with_stone
from ..studies.lines.result import LineResult, lines_of
from ..studies.lines.run import CELLS, LAYER_FACTOR, run_line
from .blocking import print_rules
from .run import CHECK_FAILED, INTERRUPTED
from .theory import growth_of, option_amount


def run(
    line: str, *, concrete: str | None, flow: str | None, theory: bool, layer_factor: float | None, cells: int,
    method: str, shapes: str, coarse: float | None, stiffer: float, seeds: int, out: Path | None, known: Path | None,
    device: str | None, threads: int | None, quiet: bool, rest: str | None, thixotropy: str | None,
    blocking: int | None = None,
) -> None:  # fmt: skip
    """Simulate the parts of a pipeline and print the pressure that it needs."""
    stood, grown = option_amount("rest", rest, "s"), option_amount("thixotropy", thixotropy, "Pa/s")
    given = read_line(line)
    if flow is None and given.flow is None:
        raise click.UsageError("flow: is missing; set it in the file of the line, or with --flow '30 m3/h'")
    if concrete is None and given.concrete is None:
        raise click.UsageError("concrete: is missing; set it in the file of the line, or with --concrete no1 or a file")
    if theory and method != "flow":
        raise click.UsageError("--theory: cannot be combined with --method dem or both; leave out one of them")
    elements = Elements(shapes=shapes, coarse=coarse, seeds=seeds, stiffer=stiffer)
    usual = Elements()
    unused = {"shapes": shapes != usual.shapes, "coarse": coarse is not None, "seeds": seeds != usual.seeds,
              "stiffer": stiffer != usual.stiffer} if method == "flow" else \
        {"cells": cells != CELLS, "layer_factor": layer_factor is not None} if method == "dem" else {}  # fmt: skip
    if blocking is not None:
        unused = {name: found and name in ("seeds", "cells", "layer_factor") for name, found in unused.items()}
    for option in (name for name, given_so in unused.items() if given_so):
        raise click.UsageError(f"{option}: has no effect with --method {method}; use --method both, or leave it out")
    rate = given.flow
    if flow is not None:
        rate = amount("flow", flow, "m3/s")
        positive("flow", rate, "m3/s")
        check_limit("flow", rate, "m3/s")
        narrow = min(part.narrow for part in given.parts)
        check_velocity("flow", rate, 4 * rate / (math.pi * narrow**2))
    assert rate is not None
    for name, value in (("layer_factor", layer_factor), ("coarse", coarse), ("stiffer", stiffer)):
        if value is not None:
            check_limit(name, value, "")
    check_whole("cells", cells)
    check_whole("seeds", seeds)
    name = str(concrete or given.concrete)
    mix = mix_named(name)
    if mix is not None and given.largest_stone is None:
        given = with_stone(given, mix.given.largest)
    growth = growth_of(stood, grown)
    moved = [] if stood is None else [restart(given, concrete_of(name), stood, growth, q) / 1e5 for q in (0.0, rate)]
    progress = ProgressBar()
    folder = out or (None if theory and blocking is None else next_folder("line"))
    where: dict[str, Any] = {"out": folder, "known": known, "device": device, "threads": threads}
    asked = {"line": given.name, "parts": fingerprint(given.parts), "concrete": name, "flow": rate, "method": method,
             "cells": cells, "elements": fingerprint(elements)}  # fmt: skip
    if blocking is not None:
        asked["blocking"] = blocking
    found, packed = None, None
    try:
        with line_folder(folder, asked):
            if method != "dem":
                found = run_line(
                    given, concrete_of(name), rate, simulate=not theory,
                    cells=cells, layer_factor=LAYER_FACTOR if layer_factor is None else layer_factor,
                    variants=mix.variants if mix is not None and layer_factor is None else None,
                    progress=None if quiet else progress, **where,
                )  # fmt: skip
            if method != "flow":
                tell = None if quiet else (lambda phase, fraction: progress(phase, fraction, {}))
                packed = run_elements(given, name, rate, elements=elements, progress=tell, **where)
            _print(given, name, rate, found, packed, folder)
            print_rules(given, mix, folder)
            if blocking is not None and folder is not None:
                chance = run_blocking(given, name, rate, blocking, out=folder, elements=elements, device=device,
                                      processes=threads, progress=None if quiet else progress)  # fmt: skip
                click.echo("\n" + "\n".join(chance.lines))
    except KeyboardInterrupt:
        if folder is not None and (folder / PARTS).is_dir():
            click.echo(f"interrupted; continue with the same command and --out {folder}")
        raise SystemExit(INTERRUPTED) from None
    finally:
        progress.close()
    if moved:
        click.echo(f"\nafter {stood:g} s of rest, with a yield stress that grows by {growth:g} Pa/s, the concrete "
                   f"starts to move at {moved[0]:.4g} bar, at full flow with {moved[1]:.4g} bar (theory)")  # fmt: skip
    if (found is not None and found.failed) or (packed is not None and packed.failed):
        raise SystemExit(CHECK_FAILED)


def _print(
    line: PipeLine, name: str, rate: float, found: LineResult | None, packed: ElementLine | None, folder: Path | None
) -> None:
    if found is not None:
        click.echo("\n" + "\n".join(lines_of(found)))
    if packed is not None:
        others = {} if found is None else {"flow": [x.friction for x in found.losses]}
        if completed(name).flow:
            others["theory"] = [friction(part, concrete_of(name), rate) for part in line.parts]
        text = element_table_lines(packed, others)
        click.echo("\n" + "\n".join(text))
        if folder is not None:
            with atomic_file(folder / "line-dem.md") as partial:
                partial.write_text("\n".join(text) + "\n", encoding="utf-8")
    took = (0.0 if found is None else sum(found.took.values())) + (0.0 if packed is None else packed.elapsed)
    if folder is not None:
        click.echo(f"\nfolder: {folder}; simulations took {took:.0f} s")
