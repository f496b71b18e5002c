"""Command `warpcrete line`: the pressure that a pipeline needs at its start.

The answer by theory must not import the simulations; `line_simulated` does.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from ..core.errors import positive
from ..core.inputs.amounts import amount
from ..core.inputs.fingerprints import fingerprint
from ..core.inputs.limits import check_limit, check_velocity, check_whole
from ..core.run.files import next_folder, write_json
from ..geometry.pumps import pump_of
from ..mix.blocking import line_rules, narrowest, rule_lines, rule_records
from ..mix.mix import Mix, mix_named
from ..mps.mixes import concrete_of
from ..studies.lines.fit import fit_line, fit_lines, read_taps
from ..studies.lines.line_folder import PARTS, line_folder
from ..studies.lines.losses import PipeLine, read_line, with_stone
from ..studies.lines.result import Stop, lines_of
from ..studies.lines.theory_line import LAYER_FACTOR, line_by_theory
from .exits import CHECK_FAILED, INTERRUPTED
from .option_amounts import THIXOTROPY_BAND, growth_of, option_amount

ELEMENT_OPTIONS = {"shapes": "spheres", "coarse": None, "seeds": 1, "stiffer": 5.0}
"""Options that only discrete elements use, with their default values."""
FLOW_OPTIONS = {"cells": 12, "known": None}
"""Options that only simulations use, with their default values."""


def run(line: str, *, method: str, simulate: bool, theory: bool, out: Path | None, **settings: Any) -> None:
    """Print the pressure that a pipeline needs, by theory or by simulation."""
    rest, grown = (option_amount(key, settings[key], u) for key, u in (("rest", "s"), ("thixotropy", "Pa/s")))
    _check_options(method, simulate, theory, settings)
    pump = {key: settings[f"pump_{key}"] for key in ("pressure", "flow", "power")}
    given = _with_pump(read_line(line), pump)
    name = settings["concrete"] or given.concrete
    if settings["flow"] is None and given.flow is None and settings["fit"] is None:
        raise click.UsageError(
            "flow: is missing; set 'flow' in the file of the line, or add, for example, --flow '30 m3/h'"
        )
    if name is None:
        raise click.UsageError(
            "concrete: is missing; set 'concrete' in the file of the line, or add --concrete with a "
            "name, such as no1, or a file"
        )
    rate = given.flow if settings["flow"] is None else _flow(settings["flow"], given)
    mix = mix_named(str(name))
    if mix is not None and given.largest_stone is None:
        given = with_stone(given, mix.given.largest)
    growth = growth_of(rest, grown)
    stop = None if rest is None else Stop(rest, growth, THIXOTROPY_BAND if grown is None else None)
    if simulate or method != "flow":
        assert rate is not None
        failed = _simulated(given, str(name), rate, method, out, mix, stop, settings)
        if failed:
            raise SystemExit(CHECK_FAILED)
        return
    fit, concrete, layer = None, concrete_of(str(name)), _layer(mix, settings)
    if settings["fit"] is not None:
        fit = fit_line(given, concrete, read_taps(settings["fit"], given, rate))
        click.echo("\n" + "\n".join(fit_lines(fit, given)))
        given, layer = fit.line(given), {"variants": fit.variants(concrete)}
        concrete = fit.concrete(concrete)
        if rate is None:
            return
    asked = {"line": given.name, "parts": fingerprint(given.parts), "concrete": str(name), "flow": rate}
    with line_folder(out, {**asked, "method": "theory"}):
        assert rate is not None
        found = line_by_theory(given, concrete, rate, out=out, stop=stop, fit=fit, **layer)
        click.echo("\n" + "\n".join(lines_of(found, settings["practice"])))
        print_rules(given, mix, out)
    if out is not None:
        click.echo(f"\nfolder: {out}")


def _check_options(method: str, simulate: bool, theory: bool, settings: Mapping[str, Any]) -> None:
    """Refuse options that contradict each other or have no effect."""
    if theory and method != "flow":
        raise click.UsageError(
            "--theory: cannot be combined with '--method dem' or '--method both'; leave out --theory or --method"
        )
    if theory and simulate:
        raise click.UsageError("--theory: cannot be combined with --simulate; leave out --theory or --simulate")
    heavy = simulate or method != "flow"
    if settings["fit"] is not None and heavy:
        raise click.UsageError("--fit: compares measurements with theory only; leave out --simulate and --method")

    def changed(options: Mapping[str, Any]) -> list[str]:
        return [name for name, usual in options.items() if settings[name] != usual]

    for name in changed(ELEMENT_OPTIONS) if method == "flow" else ():
        raise click.UsageError(f"{name}: has no effect with '--method flow'; use '--method both', or leave out {name}")
    for name in () if heavy else changed(FLOW_OPTIONS):
        raise click.UsageError(f"{name}: has no effect without a simulation; add --simulate, or leave out {name}")
    others = dict.fromkeys(("layer_factor", "rest", "pump_pressure", "pump_flow", "pump_power"))
    for name in changed({**others, "cells": 12, "practice": False}) if method == "dem" else ():
        raise click.UsageError(f"{name}: has no effect with '--method dem'; use '--method both', or leave out {name}")
    for name in ("layer_factor", "coarse", "stiffer"):
        if settings[name] is not None:
            check_limit(name, settings[name], "")
    check_whole("cells", settings["cells"])
    check_whole("seeds", settings["seeds"])


def _flow(given: str, line: PipeLine) -> float:
    """Return the flow [m3/s] that an option states."""
    rate = amount("flow", given, "m3/s")
    positive("flow", rate, "m3/s")
    check_limit("flow", rate, "m3/s")
    narrow = min(part.narrow for part in line.parts)
    check_velocity("flow", rate, 4 * rate / (math.pi * narrow**2))
    return rate


def _layer(mix: Mix | None, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the uncertainty of the concrete: the bands of its mix, or the factor of its slip layer."""
    factor = settings["layer_factor"]
    if mix is not None and factor is None:
        return {"variants": mix.variants}
    return {"layer_factor": LAYER_FACTOR if factor is None else factor}


def _with_pump(line: PipeLine, limits: Mapping[str, str | None]) -> PipeLine:
    """Return the line with the pump that options state, which replace entries of the line's own pump."""
    stated = {key: value for key, value in limits.items() if value is not None}
    if not stated:
        return line
    if line.pump is not None:
        own = {key: getattr(line.pump, key) for key in limits if getattr(line.pump, key) is not None}
        stated = {**own, **stated}
    return replace(line, pump=pump_of(stated))


def _simulated(
    line: PipeLine, name: str, rate: float, method: str, out: Path | None, mix: Mix | None, stop: Stop | None,
    settings: Mapping[str, Any],
) -> bool:  # fmt: skip
    """Simulate the parts of a line, print its pressure, and return whether a check of a part failed."""
    job = importlib.import_module(f"{__package__}.line_simulated")
    folder = out or next_folder("line")
    try:
        layer = _layer(mix, settings)
        return job.run(line, name, rate, method, folder, layer, stop, settings, lambda: print_rules(line, mix, folder))
    except KeyboardInterrupt:
        if (folder / PARTS).is_dir():
            click.echo(f"interrupted; continue with the same command and --out {folder}")
        raise SystemExit(INTERRUPTED) from None


def print_rules(line: PipeLine, mix: Mix | None, folder: Path | None) -> None:
    """Print what the rules of practice say about blocking of the line, and write it to its folder."""
    verdicts = line_rules(line, None if mix is None else mix.given)
    part = narrowest(line)
    where = f"narrowest part {part.number}, {part.label}, {1e3 * part.narrow:.4g} mm"
    text = rule_lines(verdicts, where)
    if mix is None:
        text.append(
            "unknown  all rules on the mix: the concrete has no mix; 'warpcrete mix --help' shows how to write it"
        )
    click.echo("\n" + "\n".join(text))
    if folder is not None:
        write_json(folder / "blocking.json", rule_records(verdicts) | {"narrowest_part": part.number})
