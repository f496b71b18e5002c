"""Files with the results of a fit to a trial line: the concrete and the factor of bends, for use in another line."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ...core.inputs.concretes import FACTOR_KEYS, FACTOR_SOURCE, MixSection, NamedConcrete
from ...core.inputs.yaml_files import yaml_text
from ...core.records import Record
from ...core.run.files import atomic_file
from ...mix.entries import MixEntries
from ...mix.mix import Mix
from ...mps.common.mixes import LAW_DEFAULTS
from ...theory.pipe import Concrete
from .line_fit import LineFit

CONCRETE_FILE, BENDS_FILE = "concrete.yaml", "bends.yaml"
"""Names of the files with the fitted slip layer and with the fitted factor of bends, in the folder of a line."""
LAYER_KEYS = ("slip_viscosity", "slip_yield", "slip_flow_index", "slip_quadratic_viscosity")
"""Constants of the slip layer in the section `flow` of a concrete's file. They are not copied to the new file, where
they would replace the fitted layer."""


def fitted_concrete(
    fit: LineFit, concrete: Concrete, mix: Mix | None, source: NamedConcrete | None, line: str
) -> Record:
    """Return the contents of a concrete's file with the fitted slip layer and its uncertainty.

    `concrete` is the concrete before the fit, and `mix` its mix, if it has one. `source` is the file or the shipped
    description of the concrete, whose other entries are copied; it is None if the user stated only the slump or spread.
    `line` is the name of the trial line.
    """
    origin = f"slip layer fitted to {len(fit.taps)} pressures of {line}"
    origin += "" if fit.contradiction is None else ", which contradict each other"
    contents: Record = {"name": concrete.name, "source": origin}
    layer = fit.layer_entry((1.0, 1.0) if mix is None else mix.factors)
    section = None if source is None else source.mix
    if mix is None:
        entries = _plain_entries(concrete)
    elif section is None:
        entries = _slumped_entries(mix.given)
    else:
        entries = _plain(section.values) | _points(section, mix.given)
    contents["mix"] = entries | {"layer": layer}
    # If the concrete had no mix, its flow constants are now in the section `mix`, so the section `flow` stays empty.
    flow = {} if section is None else _plain(section.flow)
    if source is not None and source.factor_source and any(key in flow for key in FACTOR_KEYS):
        flow[FACTOR_SOURCE] = source.factor_source
    others = {
        "elements": {} if source is None else _plain(source.elements if section is None else section.elements),
        "flow": {key: value for key, value in flow.items() if key not in LAYER_KEYS},
    }
    return contents | {name: values for name, values in others.items() if values}


def write_fit(
    folder: Path, fit: LineFit, concrete: Concrete, mix: Mix | None, source: NamedConcrete | None, line: str
) -> list[str]:
    """Write the files of a fit into `folder`, and return lines of text that tell the user how to use them.

    :func:`fitted_concrete` explains the other arguments.
    """
    _write(folder / CONCRETE_FILE, fitted_concrete(fit, concrete, mix, source, line))
    warning = "; do not use it before you have found out why the gauges contradict each other"
    said = [f"the fitted layer for another line: --concrete {folder / CONCRETE_FILE}"]
    if fit.bend_factor is not None:
        factor = fit.constants[2]
        entry = {"factor": f"{factor.value:.4g}", "low": f"{factor.low:.4g}", "high": f"{factor.high:.4g}"}
        _write(folder / BENDS_FILE, {"bend_factor": {key: float(value) for key, value in entry.items()}})
        said.append(
            f"the fitted factor of bends: copy the entry 'bend_factor' of {folder / BENDS_FILE} into the file "
            "of the other line"
        )
    return said if fit.contradiction is None else [f"{each}{warning}" for each in said]


def _write(path: Path, contents: Mapping[str, object]) -> None:
    with atomic_file(path) as partial:
        partial.write_text(yaml_text(contents), encoding="utf-8")


def _plain_entries(concrete: Concrete) -> Record:
    """Return the entries of a section `mix` that states the constants of a concrete as measured values."""
    bulk = {"viscosity": concrete.viscosity, "yield_stress": concrete.yield_stress}
    bulk |= {key: getattr(concrete, key) for key in ("flow_index", "quadratic_viscosity")
             if getattr(concrete, key) != LAW_DEFAULTS[key]}  # fmt: skip
    return {"density": concrete.density, "concrete": {key: _short(value) for key, value in bulk.items()}}


def _slumped_entries(given: MixEntries) -> Record:
    """Return the entries of a mix for which the user stated only slump or spread, and perhaps the largest stone."""
    entries: Record = {"density": given.density}
    entries |= {key: _short(getattr(given, key)) for key in ("slump", "spread") if getattr(given, key) is not None}
    return entries if given.sizes is None else entries | {"sizes": [_short(size) for size in given.sizes]}


def _points(section: MixSection, given: MixEntries) -> Record:
    """Return the entry `viscometer` with the measured points as numbers; empty if the mix has no such entry.

    The entry may instead be the path of a file with the points, relative to the folder of the concrete's file. This
    path would be wrong in the new file, which is in another folder.
    """
    if "viscometer" not in section.values or given.viscometer_points is None:
        return {}
    return {"viscometer": [list(pair) for pair in zip(*given.viscometer_points, strict=True)]}


def _short(value: float) -> float:
    """Return a number with nine digits, because a conversion of units yields 0.17779999999999999 m for 7 in."""
    return float(f"{value:.9g}")


def _plain(value: object) -> Any:
    """Convert the entries of a file to plain dictionaries and lists, because only these can be written as YAML."""
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(each) for each in value]
    return value
