"""Command `warpcrete line`: the pressure that a pipeline needs at its start."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from ..core.errors import positive
from ..core.inputs.amounts import amount
from ..core.inputs.fingerprints import fingerprint
from ..core.inputs.limits import check_limit, check_velocity, check_whole
from ..core.run.files import atomic_file, next_folder
from ..core.run.progress import ProgressBar
from ..geometry.pumps import pump_of
from ..mix.mix import completed, mix_named
from ..mps.mixes import concrete_of
from ..studies.lines.elements import ElementLine, Elements, element_table_lines, run_elements
from ..studies.lines.folder import PARTS, line_folder
from ..studies.lines.losses import PipeLine, friction, read_line, with_stone
from ..studies.lines.result import LineResult, Stop, lines_of
from ..studies.lines.run import CELLS, LAYER_FACTOR, run_line
from .run import CHECK_FAILED, INTERRUPTED
from .theory import THIXOTROPY_BAND, growth_of, option_amount


def run(
    line: str, *, concrete: str | None, flow: str | None, theory: bool, layer_factor: float | None, cells: int,
    method: str, shapes: str, coarse: float | None, stiffer: float, seeds: int, out: Path | None, known: Path | None,
    device: str | None, threads: int | None, quiet: bool, rest: str | None, thixotropy: str | None,
    pump_pressure: str | None, pump_flow: str | None, pump_power: str | None, practice: bool,
) -> None:  # fmt: skip
    """Simulate the parts of a pipeline and print the pressure that it needs."""
    stood, grown = option_amount("rest", rest, "s"), option_amount("thixotropy", thixotropy, "Pa/s")
    given = _with_pump(read_line(line), pressure=pump_pressure, flow=pump_flow, power=pump_power)
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
        {"cells": cells != CELLS, "layer_factor": layer_factor is not None, "rest": rest is not None,
         "pump": given.pump is not None and any((pump_pressure, pump_flow, pump_power)), "practice": practice} \
        if method == "dem" else {}  # fmt: skip
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
    stop = None if stood is None else Stop(stood, growth, THIXOTROPY_BAND if grown is None else None)
    progress = ProgressBar()
    folder = out or (None if theory else next_folder("line"))
    where: dict[str, Any] = {"out": folder, "known": known, "device": device, "threads": threads}
    asked = {"line": given.name, "parts": fingerprint(given.parts), "concrete": name, "flow": rate, "method": method,
             "cells": cells, "elements": fingerprint(elements)}  # fmt: skip
    found, packed = None, None
    try:
        with line_folder(folder, asked):
            if method != "dem":
                found = run_line(
                    given, concrete_of(name), rate, simulate=not theory,
                    cells=cells, layer_factor=LAYER_FACTOR if layer_factor is None else layer_factor,
                    variants=mix.variants if mix is not None and layer_factor is None else None,
                    progress=None if quiet else progress, stop=stop, **where,
                )  # fmt: skip
            if method != "flow":
                tell = None if quiet else (lambda phase, fraction: progress(phase, fraction, {}))
                packed = run_elements(given, name, rate, elements=elements, progress=tell, **where)
            _print(given, name, rate, found, packed, folder, practice)
    except KeyboardInterrupt:
        if folder is not None and (folder / PARTS).is_dir():
            click.echo(f"interrupted; continue with the same command and --out {folder}")
        raise SystemExit(INTERRUPTED) from None
    finally:
        progress.close()
    if (found is not None and found.failed) or (packed is not None and packed.failed):
        raise SystemExit(CHECK_FAILED)


def _with_pump(line: PipeLine, **limits: str | None) -> PipeLine:
    """Return the line with the pump that options state, which replace entries of the line's own pump."""
    stated = {key: value for key, value in limits.items() if value is not None}
    if not stated:
        return line
    if line.pump is not None:
        own = {key: getattr(line.pump, key) for key in limits if getattr(line.pump, key) is not None}
        stated = {**own, **stated}
    return replace(line, pump=pump_of(stated))


def _print(
    line: PipeLine, name: str, rate: float, found: LineResult | None, packed: ElementLine | None, folder: Path | None,
    practice: bool,
) -> None:  # fmt: skip
    if found is not None:
        click.echo("\n" + "\n".join(lines_of(found, practice)))
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
