"""The report of a reproduction: the paper beside ours, each trend judged in words, and a figure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ..core.files import whole_file, write_json
from ..core.units import number
from .papers import CONCRETES, PIPELINES, PRINTED, UNITS, XU_PRINTED, ZHAN, Row, xu_cases
from .reproduction import Reproduction, judged, key_of, unit_case

WHAT = {
    "literal": "Table 1 as it is printed",
    "calibrated": "with a wall layer of 1190 Pa s/m and a wall friction of 0.034, fitted to the ends of units A and B "
    "only; all else is predicted",
    "stiff stones": "contacts of 1e7 Pa packed to a solid fraction of 0.62 instead of 1e5 Pa and 1 kPa; the layer, "
    "1660 Pa s/m, fitted to the same ends",
}

VARIED = {"flow": "flow", "resolution": "spacing", "slip layer": "slip_thickness"}
"""What a group of Xu's cases varies."""


def write(found: Reproduction) -> None:
    """reproduction.md, reproduction.png and results.json, of what there is."""
    text = "\n".join(_zhan(found) if found.paper == "zhan" else _xu(found))
    with whole_file(found.folder / "reproduction.md") as partial:
        partial.write_text(text.rstrip() + "\n")
    kept = {key: _plain(result) for key, result in found.results.items()}
    write_json(found.folder / "results.json", {"results": kept, "failures": found.failures})
    if found.paper == "zhan" and found.results:
        with whole_file(found.folder / "reproduction.png") as partial:
            draw(found).savefig(partial, dpi=120, format="png")


def _plain(result: Mapping[str, Any]) -> dict[str, float]:
    """Numbers of a result.json in SI units."""
    found = {}
    for name, entry in result.items():
        if isinstance(entry, dict) and "value" in entry and isinstance(entry["value"], int | float):
            found[name] = number(entry)
        elif isinstance(entry, int | float) and not isinstance(entry, bool):
            found[name] = float(entry)
    return found


def ran(found: Reproduction) -> list[str]:
    """Concretes of which there are runs."""
    return [name for name in CONCRETES if any(key.startswith(f"{name}: ") for key in found.results)]


def _zhan(found: Reproduction) -> Iterator[str]:
    yield "# Zhan et al. 2019, reproduced"
    yield ""
    sizes = (
        "coarse spheres of 15 to 40 mm for its clumps of 5 to 20 (--quick)" if found.quick else "four clump templates"
    )
    yield f"{len(found.results)} runs, {found.seeds} seed(s) each, {sizes}."
    for name in ran(found):
        yield f"- **{name}**: {WHAT[name]}."
    yield ""
    yield "## Units: largest pressure and pressure at the end [kPa]"
    yield ""
    yield "| unit | paper | " + " | ".join(ran(found)) + " |"
    yield "|---|---|" + "---|" * len(ran(found))
    for letter, unit in zip("ABCD", UNITS):
        cells = []
        for name in ran(found):
            case = {**unit_case(unit, found.quick), **CONCRETES[name]}
            cells.append(_pair(*(found.values(name, case, q) for q in ("peak_pressure", "end_pressure"))))
        yield f"| {letter} {unit} | {_printed(*PRINTED[unit])} | " + " | ".join(cells) + " |"
    yield ""
    yield from _pipelines(found)
    yield "## Parameters, on unit D: largest pressure [kPa]"
    for row in ZHAN:
        yield from _row(found, row)
    if found.failures:
        yield ""
        yield "## Runs that stopped"
        yield ""
        for key, why in found.failures.items():
            yield f"- {key}: {why}"


def _printed(peak: float | None, end: float | None) -> str:
    return f"{_kpa(peak)} / {_kpa(end)}"


def _kpa(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value / 1e3:.1f}"


def _pair(peaks: list[float], ends: list[float]) -> str:
    return " / ".join(_with_scatter(values) for values in (peaks, ends))


def _with_scatter(values: list[float]) -> str:
    """Mean over seeds [kPa], with their standard deviation where there are several."""
    if not values:
        return "-"
    scatter = f" +- {np.std(values, ddof=1) / 1e3:.2f}" if len(values) > 1 else ""
    return f"{np.mean(values) / 1e3:.1f}{scatter}"


def _pipelines(found: Reproduction) -> Iterator[str]:
    """The paper's Eq. 13 from ends of A and B of one metre."""
    yield "Eq. 13, a whole pipeline from a metre up and a metre along [MPa]:"
    yield ""
    yield "| pipeline | recorded | paper | " + " | ".join(ran(found)) + " |"
    yield "|---|---|---|" + "---|" * len(ran(found))
    for place, (up, along, paper, recorded) in PIPELINES.items():
        cells = []
        for name in ran(found):
            a, b = (found.mean(name, {**unit_case(unit, found.quick), **CONCRETES[name]}, "end_pressure")
                    for unit in UNITS[:2])  # fmt: skip
            cells.append(f"{(up * a + along * b) / 1e6:.1f}" if math.isfinite(a + b) else "-")
        yield f"| {place} | {recorded / 1e6:.1f} | {paper / 1e6:.2f} | " + " | ".join(cells) + " |"
    yield ""


def _row(found: Reproduction, row: Row) -> Iterator[str]:
    done = [(name, *judged(found, row, name)) for name in ran(found)]
    done = [(name, means, verdict) for name, means, verdict in done if any(map(math.isfinite, means))]
    yield ""
    yield f"**{row.name[0].upper()}{row.name[1:]}.** The paper: {row.claim}."
    yield ""
    if not done:
        yield "Not run."
        return
    yield f"| {row.parameter} | " + " | ".join(f"{place:g}" for place in row.places) + " |"
    yield "|---|" + "---|" * len(row.places)
    if row.printed:
        yield "| paper | " + " | ".join(_kpa(row.printed.get(value)) for value in row.values) + " |"
    for name, means, _ in done:
        yield f"| {name} | " + " | ".join(map(_kpa, means)) + " |"
    yield ""
    for name, _, verdict in done:
        yield f"- {name}: {verdict}."


def _verdict(errors: list[float], count: int) -> str:
    """Of the errors of pressures, of `count` runs."""
    if len(errors) < count:
        return f"Not judged: {count - len(errors)} of {count} runs are missing."
    worst = float(np.max(errors))
    return f"Pressure {'holds' if worst < 0.03 else 'differs'}: at most {100 * worst:.2f} % off its closed form."


def draw(found: Reproduction) -> Any:
    """A panel for each parameter: ours as lines, what the paper prints as crosses."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 6.5), layout="constrained")
    panels = figure.subplots(2, 4).ravel()
    for row, axes in zip(ZHAN, panels):
        for name in ran(found):
            means, _ = judged(found, row, name)
            if any(map(math.isfinite, means)):
                axes.plot(row.places, np.array(means) / 1e3, "o-", ms=4, label=name)
        if row.printed:
            axes.plot(list(row.printed), [value / 1e3 for value in row.printed.values()], "kx", ms=8, label="paper")
        if row.parameter == "hydration_modulus":
            axes.set_xscale("log")
        axes.set(title=row.claim, xlabel=row.parameter, ylabel="largest pressure [kPa]")
        axes.title.set_fontsize(8)
        axes.set_ylim(bottom=0)
    panels[0].legend(fontsize=8)
    for axes in panels[len(ZHAN) :]:
        axes.set_visible(False)
    return figure


def _xu(found: Reproduction) -> Iterator[str]:
    yield "# Xu, Li & Jiang 2021, reproduced"
    yield ""
    yield (
        "Channel: between planes, as the paper computes; tube: the round pipe that it means. Theory is the closed form "
        "of that geometry. The paper reports errors below 3 %, and pairs a pipe's flow with a channel's balance of "
        "forces."
    )
    for group, cases in xu_cases(found.quick).items():
        yield ""
        yield f"## {group[0].upper()}{group[1:]}"
        yield ""
        yield "| scene | concrete | varied | pressure [kPa] | theory | error | slip velocity [cm/s] | theory |"
        yield "|---|---|---|---|---|---|---|---|"
        errors = []
        for scene, case in cases:
            key = key_of(f"{group}, {scene}", {**case, "seed": 0})
            shown = f"{VARIED[group]} {case[VARIED[group]]:g}" if group in VARIED else "mortar and grains"
            if key not in found.results:
                why = found.failures.get(key, "not run")
                yield f"| {scene} | {case['concrete']} | {shown} | {why} | | | | |"
                continue
            result = found.results[key]
            pressure, theory, slip, slip_theory = (
                number(result[name])
                for name in ("pressure", "pressure_theory", "slip_velocity", "slip_velocity_theory")
            )
            errors.append(abs(pressure / theory - 1))
            yield (
                f"| {scene} | {case['concrete']} | {shown} | {pressure / 1e3:.3f} | {theory / 1e3:.3f} | "
                f"{100 * (pressure / theory - 1):+.2f} % | {100 * slip:.2f} | {100 * slip_theory:.2f} |"
            )
        yield ""
        yield _verdict(errors, len(cases))
    yield ""
    yield (
        f"The paper prints {XU_PRINTED['pressure'] / 1e3:.2f} kPa and {100 * XU_PRINTED['slip_velocity']:.1f} cm/s for "
        "no. 1 at 1500 cm3/s."
    )
