"""Command `warpcrete line`: the pressure that a pipeline needs at its start.

This module does not import the simulations, because they take longer to load than an answer by theory takes. The module
`line_simulated` imports them, and is loaded only when a simulation is requested.
"""

import importlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from ..core.errors import between, quoted
from ..core.inputs.amounts import amount, bare_number
from ..core.inputs.customary import beside, both
from ..core.inputs.fingerprints import fingerprint
from ..core.inputs.limits import check_limit, check_whole
from ..core.records import Record
from ..core.run.files import next_folder, write_json
from ..geometry.pipe_line import PipeLine
from ..mix.blocking import RuleVerdict, line_rules, narrowest, rule_lines, rule_records
from ..mix.measurements import Layer
from ..mix.mix import NO_AIR, Mix, factors_text
from ..studies.lines.answers import pressure_text
from ..studies.lines.fit import fit_line
from ..studies.lines.fit_files import write_fit
from ..studies.lines.fit_report import fit_lines
from ..studies.lines.fittings import cells_of, check_cells, count_text, is_in_library
from ..studies.lines.line_folder import PARTS, line_folder
from ..studies.lines.losses import ASSUMED_DENSITY, with_layer_factor
from ..studies.lines.pressures import Stop
from ..studies.lines.result import lines_of
from ..studies.lines.taps import Tap, foreign_columns, read_taps
from ..studies.lines.theory_line import LAYER_FACTOR, line_by_theory, write_lines
from ..theory.pipe import Concrete
from .exits import CHECK_FAILED, INTERRUPTED
from .line_inputs import LineInputs, line_inputs
from .option_amounts import HIGHEST_THIXOTROPY, THIXOTROPY_BAND, growth_of, option_amount

ELEMENT_OPTIONS = {"shapes": "spheres", "coarse": None, "seeds": 1, "stiffer": 1.0}
"""Options of `warpcrete line` that affect only simulations by discrete elements, with their default values."""
FLOW_OPTIONS = {"cells": 12, "known": None, "device": None, "threads": None}
"""Options of `warpcrete line` that have no effect if nothing is simulated, with their default values."""

SHORTEST_REST = 120.0
"""Smallest value of `--rest` that is accepted without a unit [s]. A smaller number without a unit probably means
minutes, because a stop of so few seconds hardly changes the pressure."""
USUAL_FLOWS = {False: ("m3/h", (10, 20, 30, 45, 60)), True: ("yd3/h", (15, 25, 40, 60, 80))}
"""Unit and values of the flows for which the pressure of a line is printed if the user states no flow. The entry under
the key True is for users whose amounts have customary US units."""


def run(line: str | None, *, method: str, simulate: bool, theory: bool, out: Path | None, **settings: Any) -> None:
    """Print the pressure that a pipeline needs, by theory or by simulation.

    `line` is the name or file of the pipeline; None for a straight pipeline that options describe. The other arguments
    are the values of the command's options.
    """
    _check_rest(settings["rest"])
    rest, grown = (option_amount(key, settings[key], u) for key, u in (("rest", "s"), ("thixotropy", "Pa/s")))
    _check_options(method, simulate, theory, settings)
    growth = growth_of(rest, grown)
    assumed = (THIXOTROPY_BAND, HIGHEST_THIXOTROPY) if grown is None else ()
    stop = None if rest is None else Stop(rest, growth, *assumed)
    given = line_inputs(line, settings)
    if settings["blocking"] is not None:
        if given.guessed:
            raise click.UsageError(
                f"{_stated('blocking', settings)}: needs the file of a concrete; write a mix "
                "file, and give it as --concrete"
            )
        out = out or next_folder("line")
    requested = simulate or method != "flow"
    at_once = theory or given.guessed or settings["fit"] is not None
    unknown = [] if requested or at_once else [part for part in given.line.parts if not is_in_library(part)]
    for part in unknown:
        check_cells(part, settings["cells"], asked=False)
    for part in unknown:
        click.echo(f"note: part {part.number}, {part.label}, is sharper than all parts in the table of simulated "
                   f"parts, so it is simulated now, with {count_text(cells_of(part, settings['cells']))} cells; this "
                   "takes minutes, and --theory skips it", err=True)  # fmt: skip
    needed = () if settings["blocking"] is None else ("device", "threads")
    for name, usual in () if requested or unknown else FLOW_OPTIONS.items():
        if name not in needed and settings[name] != usual:
            raise click.UsageError(
                f"{_stated(name, settings)}: has no effect without a simulation; add --simulate, or leave out --{name}"
            )
    if requested or unknown:
        if _simulated(given, method, out, stop, settings, unless_known=not requested):
            raise SystemExit(CHECK_FAILED)
        return
    pipes, concrete, layer, fit = given.line, given.concrete, _layer(given.mix, settings), None
    said: list[str] = []
    if settings["fit"] is not None:
        taps = read_taps(settings["fit"], pipes, given.flow)
        fit = fit_line(pipes, concrete, taps, _known_layer(given, layer), _gauge(settings["gauge"], taps),
                       None if given.mix is None else given.mix.layer_yields)  # fmt: skip
        said = [*fit_lines(fit, pipes, given.factors, given.mix is not None), ""]
        if ignored := foreign_columns(settings["fit"]):
            said[:0] = [
                f"ignored columns of {settings['fit'].name}, which a fit does not use: {', '.join(ignored)}",
                "",
            ]
        layer = {"variants": fit.variants(concrete, layer.get("variants"))}
        pipes, concrete = fit.line(pipes), fit.concrete(concrete)
    if given.flow is None:
        if needing := _options_that_need_a_flow(None if fit is not None else out, settings):
            beyond = "the fit" if fit is not None else "pressures at usual flows"
            raise click.UsageError(
                f"flow: is missing; without a flow, the command prints only {beyond}; add a flow, as in --flow '30 "
                f"m3/h', or leave out {' and '.join(needing)}"
            )
        if fit is None:
            verdicts = _verdicts(given)
            usual = _at_usual_flows(pipes, concrete, layer)
            said = [*_warnings(verdicts), *usual, *_assumptions(given), "", *_rules(verdicts, given, None)]
        elif out is not None:
            with line_folder(out, {"line": pipes.name, "concrete": given.name, "flow": None, "method": "theory"}):
                said += write_fit(out, fit, given.concrete, given.mix, given.source, pipes.name)
                write_lines(said, out)
        click.echo("\n" + "\n".join(said))
        return
    request = {"line": pipes.name, "parts": fingerprint(pipes.parts), "concrete": given.name, "flow": given.flow}
    if settings["blocking"] is not None:
        request |= {key: settings[key] for key in ("blocking", "shapes", "coarse", "stiffer")}
    with _interruptible(out), line_folder(out, {**request, "method": "theory"}):
        result = line_by_theory(pipes, concrete, given.flow, out=out, stop=stop, fit=fit, **layer)
        said += lines_of(result, settings["practice"])
        if line is None:
            said += [
                "",
                "bends, reducers and hoses are not counted; to count them, write a file (warpcrete line --help)",
            ]
        if given.guessed and settings["fit"] is None:
            said += ["", "a slump or spread alone says little about the slip layer: the parts of the mix give a better "
                     "estimate, which may differ much from this one (warpcrete mix --help)"]  # fmt: skip
        if fit is not None and out is not None:
            said += ["", *write_fit(out, fit, given.concrete, given.mix, given.source, pipes.name)]
        _finish(said, pipes, given, out, settings)
    if out is not None:
        click.echo(f"\nfolder: {out}")


def _stated(name: str, settings: Mapping[str, object]) -> str:
    """Return the name and the value of an option for a message, such as "gauge = '1 bar'", with quotes around texts."""
    value = settings[name]
    return f"{name} = {quoted(str(value) if isinstance(value, Path) else value)}"


def _check_rest(stated: str | None) -> None:
    """Refuse a time of rest that has no unit and is below `SHORTEST_REST`, because it is most likely in minutes."""
    number = amount("rest", stated, "s") if bare_number(stated) else 0.0
    if 0 < number < SHORTEST_REST:
        raise click.UsageError(
            f"rest: {number:g} without a unit is {number:g} s; did you mean '{number:g} min'? For "
            f"seconds, write '{number:g} s'"
        )


def _options_that_need_a_flow(out: Path | None, settings: Mapping[str, object]) -> list[str]:
    """Return those options in the user's command that need a flow, such as '--rest'.

    `settings` holds the value of each option. `out` is the folder for the result; the option `--out` counts only if
    `out` is not None.
    """
    names = ("rest", "blocking", "pump_pressure", "pump_flow", "pump_power")
    chosen = [name for name in names if settings[name] is not None]
    chosen += [name for name, is_chosen in (("practice", settings["practice"]), ("out", out is not None)) if is_chosen]
    return [f"--{name.replace('_', '-')}" for name in chosen]


def _at_usual_flows(line: PipeLine, concrete: Concrete, layer: Mapping[str, object]) -> list[str]:
    """Return lines of text with the pressure of a pump line, and its uncertainty, at usual flows.

    `layer` describes the uncertainty of the concrete; it is passed to :func:`.line_by_theory` as keyword arguments.
    """
    unit, rates = USUAL_FLOWS[line.customary]
    texts = [f"no flow is stated; pressure at the pump for usual flows (--flow '{rates[2]} {unit}' prints the whole "
             "answer for one):", ""]  # fmt: skip
    for rate in rates:
        band = line_by_theory(line, concrete, amount("flow", f"{rate} {unit}", "m3/s"), **layer).band()
        ends = f"{band.low / 1e5:.3g} to {band.high / 1e5:.3g} bar"
        texts.append(
            f"- {rate} {unit}: {pressure_text(band.value)}; {ends}{beside(line.customary, 'psi', band.low, band.high)}"
        )
    return texts


def _check_options(method: str, simulate: bool, theory: bool, settings: Mapping[str, object]) -> None:
    """Refuse command-line options that contradict each other, or that have no effect because of another option."""
    if theory and method != "flow":
        raise click.UsageError(
            "--theory: cannot be combined with '--method dem' or '--method both'; leave out --theory or --method"
        )
    if theory and simulate:
        raise click.UsageError("--theory: cannot be combined with --simulate; leave out --theory or --simulate")
    heavy = simulate or method != "flow"
    if settings["gauge"] is not None and settings["fit"] is None:
        raise click.UsageError(
            f"{_stated('gauge', settings)}: has no effect without --fit; leave out --gauge, or add --fit FILE"
        )
    if settings["fit"] is not None and heavy:
        raise click.UsageError(
            f"{_stated('fit', settings)}: holds pressures that are fitted with theory only, not with simulations; "
            "leave out --simulate and --method"
        )

    def changed(options: Mapping[str, object]) -> list[str]:
        return [name for name, usual in options.items() if settings[name] != usual]

    only_dem = ELEMENT_OPTIONS if settings["blocking"] is None else {"seeds": ELEMENT_OPTIONS["seeds"]}
    for name in changed(only_dem) if method == "flow" else ():
        raise click.UsageError(
            f"{_stated(name, settings)}: has no effect with --method flow; use --method both, or leave out --{name}"
        )
    others = dict.fromkeys(("layer_factor", "rest", "pump_pressure", "pump_flow", "pump_power"))
    for name in changed({**others, "cells": 12, "practice": False}) if method == "dem" else ():
        raise click.UsageError(
            f"{_stated(name, settings)}: has no effect with --method dem; use --method both, or "
            f"leave out --{name.replace('_', '-')}"
        )
    for name in ("layer_factor", "coarse", "stiffer"):
        if settings[name] is not None:
            check_limit(name, settings[name], "")
    check_whole("cells", settings["cells"])
    check_whole("seeds", settings["seeds"])


def _layer(mix: Mix | None, settings: Mapping[str, object]) -> Record:
    """Return the uncertainty of the concrete, as keyword arguments of the functions that compute a line's pressure.

    If the concrete has a mix and the user did not state `--layer-factor`, the result contains `variants`. These are two
    concretes for each cause of uncertainty, whose affected properties are at the lower and at the upper ends of their
    uncertainty bands. Otherwise, the result contains `layer_factor`, the factor by which the resistance of the slip
    layer may be wrong.
    """
    factor = settings["layer_factor"]
    if mix is not None and factor is None:
        return {"variants": mix.variants, "band_origin": mix.band_origin}
    return {"layer_factor": LAYER_FACTOR if factor is None else factor}


def _gauge(stated: str | None, taps: Sequence[Tap]) -> float | None:
    """Return the error limit of the gauges [Pa], or None if the option `--gauge` is missing.

    The text `stated` is the value of the option: a pressure such as "1 bar", or a percentage of the largest pressure in
    `taps`.
    """
    if stated is None:
        return None
    if not stated.strip().endswith("%"):
        error = amount("gauge", stated, "Pa")
        between("gauge", error, 0, max(tap.pressure for tap in taps), "Pa", "state it as '4 %' or '1 bar'")
        return error
    share = amount("gauge", stated, "1")
    between("gauge", share, 0, 1, "", "state it as '4 %' or '1 bar'")
    return share * max(tap.pressure for tap in taps)


def _known_layer(given: LineInputs, layer: Mapping[str, Any]) -> tuple[Concrete, Concrete] | None:
    """Return two concretes that bound the slip layer before it is fitted to pressures, or None.

    The slip layers of the two concretes are at the lower and at the upper end of the layer's uncertainty band. `layer`
    is the result of :func:`_layer`. The result is None if the mix states the layer, because that layer may come from an
    earlier fit to the same pressures.
    """
    if given.mix is not None and given.mix.given.layer != Layer():
        return None
    if "variants" in layer:
        return layer["variants"].get("slip layer")
    low, high = (with_layer_factor(given.concrete, x) for x in (1 / layer["layer_factor"], layer["layer_factor"]))
    return low, high


def _simulated(
    given: LineInputs, method: str, out: Path | None, stop: Stop | None, settings: Mapping[str, object],
    unless_known: bool,
) -> bool:  # fmt: skip
    """Simulate the parts of a line, print the line's pressure, and return whether a check of a simulation failed.

    With `unless_known`, only parts whose friction cannot be found without a simulation are simulated. The friction of
    all other parts comes from the line's file, a model, or the package's table of parts that were simulated before.
    `stop` is a rest of the concrete, after which the line restarts; None for no rest.
    """
    if given.guessed:
        raise click.UsageError(
            "slump: a slump or spread alone is not enough for a simulation; write a mix file, and give it as --concrete"
        )
    job = importlib.import_module(f"{__package__}.line_simulated")
    folder = out or next_folder("line")
    with _interruptible(folder):
        return job.run(given, method, folder, _layer(given.mix, settings), stop, settings,
                       lambda said: _finish(said, given.line, given, folder, settings), unless_known)  # fmt: skip


@contextmanager
def _interruptible(folder: Path | None) -> Iterator[None]:
    """Handle Ctrl-C in a `with` block: print how to continue, and exit with the exit code of an interruption."""
    try:
        yield
    except KeyboardInterrupt:
        if folder is not None and (folder / PARTS).is_dir():
            click.echo(f"interrupted; continue with the same command and --out {folder}")
        raise SystemExit(INTERRUPTED) from None


def _finish(
    said: Sequence[str], line: PipeLine, given: LineInputs, folder: Path | None, settings: Mapping[str, object]
) -> None:
    """Print the report on a pump line, and write it to the file line.md in `folder`.

    The report consists of the lines of text in `said`, the pressures for other estimates of the slip layer, and the
    verdicts of the rules against blocking. The file is written before the report is printed, so the file is complete
    even if printing fails. With the option `--blocking`, the probability of a blockage is then simulated, printed and
    added to the file.
    """
    others = [] if settings["fit"] is not None else _other_layers(line, given)
    verdicts = _verdicts(given)
    said = [
        *_warnings(verdicts),
        *said,
        *_factors(given),
        *_assumptions(given),
        *others,
        "",
        *_rules(verdicts, given, folder),
    ]
    if folder is not None:
        write_lines(said, folder)
    click.echo("\n" + "\n".join(said))
    if settings["blocking"] is not None and folder is not None:
        assert given.flow is not None
        blocked = importlib.import_module(f"{__package__}.line_blocked")
        more = blocked.run(line, given.name, given.flow, folder, settings)
        write_lines([*said, "", *more], folder)
        click.echo("\n" + "\n".join(more))


def _warnings(verdicts: Iterable[RuleVerdict]) -> list[str]:
    """Return lines of text on each rule by which the concrete blocks the line; they stand above all other lines."""
    return [text for each in verdicts if each.verdict == "blocks"
            for text in (f"WARNING: {each.rule}: {each.found}", "")]  # fmt: skip


def _verdicts(given: LineInputs) -> list[RuleVerdict]:
    """Return the verdicts of all rules of practice on whether the concrete of `line_inputs` blocks the line."""
    return line_rules(given.line, None if given.mix is None else given.mix.given)


def _assumptions(given: LineInputs) -> list[str]:
    """Return lines of text on properties of the concrete that are assumed: the air content, or the density."""
    remarks = [] if given.mix is None else [remark for remark in given.mix.remarks if remark.startswith(NO_AIR)]
    if given.guessed:
        density = both(given.line.customary, "kg/m3", ASSUMED_DENSITY)
        remarks.append(
            f"a slump or spread alone says nothing about the density: {density} is assumed, which gives the weight of "
            "the concrete; to state another density, write a file of the concrete (warpcrete mix --help)"
        )
    return [line for remark in remarks for line in ("", f"remark: {remark}")]


def _factors(given: LineInputs) -> list[str]:
    """Return lines of text on the factors for another age or temperature that the concrete's file states."""
    if given.source is None or given.factors == (1.0, 1.0):
        return []
    return ["", f"all numbers include {factors_text(given.factors, given.source.factor_source)}"]


def _other_layers(line: PipeLine, given: LineInputs) -> list[str]:
    """Return lines of text on each slip layer that the mix allows besides the one used, with the resulting pressure."""
    texts = []
    for eta, tau in () if given.mix is None else given.mix.other_layers:
        assert given.mix is not None and given.flow is not None
        stresses, viscosities = given.mix.factors
        concrete = replace(given.concrete, slip_viscosity=viscosities * eta.value, slip_yield=stresses * tau.value)
        pressure = line_by_theory(line, concrete, given.flow).pressure
        layer = given.mix.given.layer
        measured = layer.pipe or layer.pipe_points is not None or layer.tribometer_points is not None
        texts += [
            "",
            f"another estimate of the slip layer, {concrete.slip_viscosity:.3g} Pa s/m from {eta.way}, would "
            f"give {pressure / 1e5:.3g} bar{beside(line.customary, 'psi', pressure)}; "
            f"{'the measured layer is used instead' if measured else 'measure the layer to decide between them'}",
        ]
    return texts


def _rules(verdicts: Sequence[RuleVerdict], given: LineInputs, folder: Path | None) -> list[str]:
    """Return lines of text on whether the line and its concrete satisfy the rules of practice against blocking.

    If `folder` is not None, also write the `verdicts` of these rules to the file blocking.json in this folder.
    """
    part = narrowest(given.line)
    where = f"narrowest part {part.number}, {part.label}, {both(given.line.customary, 'mm', part.narrow)}"
    text = rule_lines(verdicts, where)
    if given.mix is None:
        text.append(
            "unknown  all rules on the mix: the concrete has no mix; 'warpcrete mix --help' shows how to write it"
        )
    if folder is not None:
        write_json(folder / "blocking.json", rule_records(verdicts) | {"narrowest_part": part.number})
    return text
