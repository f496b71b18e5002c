"""Report of a reproduction: simulated results next to the paper's results, a verdict on each trend, and a figure."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING

import numpy as np

from ...core.drawing.style import MEASURED, SERIES, new_figure, open_frame, rgb
from ...core.run.files import atomic_file, write_json
from ...core.units import number
from ...scenes import modules
from .papers import (
    CONCRETES,
    OPEN_ASSUMPTIONS,
    PIPELINES,
    PRINTED,
    PRINTED_TRAVEL,
    UNITS,
    XU_PRINTED,
    ZHAN,
    Row,
    column_parameters,
    xu_cases,
)
from .state import Reproduction, key_of, pressures, unit_case, verdict_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WHAT = {
    "literal": "Table 1 as printed",
    "calibrated": (
        "with a wall layer of 1190 Pa s/m and a wall friction of 0.034, fitted to the final pressures of units A and "
        "B only; everything else is predicted"
    ),
    "stiff stones": (
        "contacts of 1e7 Pa, packed to a solid fraction of 0.62, instead of contacts of 1e5 Pa packed to "
        "1 kPa; the layer of 1660 Pa s/m is fitted to the same final pressures"
    ),
}
"""Descriptions of the concretes in the report."""

VARIED = {"flow": "flow", "resolution": "spacing", "slip layer": "slip_thickness"}
"""Name of the parameter that varies within each group of the cases of Xu, Li & Jiang 2021."""


def write(found: Reproduction) -> None:
    """Write the results so far to reproduction.md, reproduction.png and results.json."""
    text = "\n".join(_zhan(found) if found.paper == "zhan" else _xu(found))
    with atomic_file(found.folder / "reproduction.md") as partial:
        partial.write_text(text.rstrip() + "\n", encoding="utf-8")
    kept = {key: _plain(result) for key, result in found.results.items()}
    write_json(found.folder / "results.json", {"results": kept, "failures": found.failures})
    if found.paper == "zhan" and found.results:
        with atomic_file(found.folder / "reproduction.png") as partial:
            draw(found).savefig(partial, dpi=150, format="png")


def _plain(result: Mapping[str, object]) -> dict[str, float]:
    """Return all numbers in the contents of a result.json, in SI units; entries that are not numbers are left out."""
    numbers = {}
    for name, entry in result.items():
        if isinstance(entry, dict) and "value" in entry and isinstance(entry["value"], int | float):
            numbers[name] = number(entry)
        elif isinstance(entry, int | float) and not isinstance(entry, bool):
            numbers[name] = float(entry)
    return numbers


def columns_with_results(found: Reproduction, names: Iterable[str] = CONCRETES) -> list[str]:
    """Return the names of report columns, out of `names`, for which at least one run has a result."""
    return [
        name for name in names if any(key.startswith((f"{name}: ", f"{name}, hydrated: ")) for key in found.results)
    ]


def _zhan(reproduction: Reproduction) -> Iterator[str]:
    yield "# Zhan et al. 2019, reproduced"
    yield ""
    sizes = (
        "coarse spheres of 15 to 40 mm instead of clumps of 5 to 20 mm (--quick)"
        if reproduction.quick
        else "four clump templates"
    )
    yield f"{len(reproduction.results)} results, {reproduction.seeds} seed(s) each, {sizes}."
    for name in columns_with_results(reproduction):
        yield f"- **{name}**: {WHAT[name]}."
    yield ""
    yield from _units(reproduction)
    yield from _pipelines(reproduction)
    yield from _open(reproduction)
    yield "## Parameters, on unit D: largest pressure [kPa]"
    for row in ZHAN:
        yield from _row(reproduction, row)
    if reproduction.failures:
        yield ""
        yield "## Runs that stopped"
        yield ""
        for key, why in reproduction.failures.items():
            yield f"- {key}: {why}"


def _of_unit(reproduction: Reproduction, name: str, unit: str, quantity: str) -> list[float]:
    return reproduction.values(name, {**unit_case(unit, reproduction.quick), **column_parameters(name)}, quantity)


def _units(reproduction: Reproduction) -> Iterator[str]:
    yield "## Units: largest pressure and pressure at the end [kPa]"
    yield ""
    yield "| unit | paper | " + " | ".join(columns_with_results(reproduction)) + " |"
    yield "|---|---|" + "---|" * len(columns_with_results(reproduction))
    for letter, unit in zip("ABCD", UNITS):
        cells = [
            _pair(
                _of_unit(reproduction, name, unit, "peak_pressure"), _of_unit(reproduction, name, unit, "end_pressure")
            )
            for name in columns_with_results(reproduction)
        ]
        yield f"| {letter} {unit} | {_printed(*PRINTED[unit])} | " + " | ".join(cells) + " |"
    for letter, unit in zip("AB", UNITS):
        cells = [
            _metres(_of_unit(reproduction, name, unit, "peak_travel")) for name in columns_with_results(reproduction)
        ]
        yield (
            f"| {letter}, travel at the largest pressure [m] | {PRINTED_TRAVEL[unit]:.2f} |" + " | ".join(cells) + " |"
        )
    yield ""


def _open(reproduction: Reproduction) -> Iterator[str]:
    """Yield the lines of the report's section on details that the paper leaves open.

    The section shows how the results change with other assumptions about these details.
    """
    names = columns_with_results(reproduction, OPEN_ASSUMPTIONS)
    if not names:
        return
    yield "## What the paper leaves open: units with the calibrated concrete, without a new fit"
    yield ""
    for name in names:
        yield f"- **{name}**: {OPEN_ASSUMPTIONS[name][2]}."
    yield ""
    yield "| | " + " | ".join("ABCD") + " | travel at the largest pressure of A [m] | of B |"
    yield "|---|---|---|---|---|---|---|"
    for name in [*(["calibrated"] if "calibrated" in columns_with_results(reproduction) else []), *names]:
        cells = [
            _pair(
                _of_unit(reproduction, name, unit, "peak_pressure"), _of_unit(reproduction, name, unit, "end_pressure")
            )
            for unit in UNITS
        ]
        cells += [_metres(_of_unit(reproduction, name, unit, "peak_travel")) for unit in UNITS[:2]]
        yield f"| {name} | " + " | ".join(cells) + " |"
    yield ""


def _printed(peak: float | None, end: float | None) -> str:
    return f"{_kpa(peak)} / {_kpa(end)}"


def _kpa(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value / 1e3:.1f}"


def _metres(values: list[float]) -> str:
    return f"{np.mean(values):.2f}" if values else "-"


def _pair(peaks: list[float], ends: list[float]) -> str:
    return " / ".join(_with_scatter(values) for values in (peaks, ends))


def _with_scatter(values: list[float]) -> str:
    """Return the mean over the seeds of pressures [Pa] as text in kPa, or a dash if there are no pressures.

    For two or more seeds, the text also contains the standard deviation.
    """
    if not values:
        return "-"
    scatter = f" +- {np.std(values, ddof=1) / 1e3:.2f}" if len(values) > 1 else ""
    return f"{np.mean(values) / 1e3:.1f}{scatter}"


def _pipelines(reproduction: Reproduction) -> Iterator[str]:
    """Yield the lines of a table with the pressures of whole pipelines.

    Eq. 13 of Zhan et al. (2019) computes these pressures from the final pressures of the simulated vertical and
    horizontal pipe (units A and B).
    """
    yield "Eq. 13, pressure of a whole pipeline from one metre of vertical and one metre of horizontal pipe [MPa]:"
    yield ""
    yield "| pipeline | recorded | paper | " + " | ".join(columns_with_results(reproduction)) + " |"
    yield "|---|---|---|" + "---|" * len(columns_with_results(reproduction))
    for place, (up, along, paper, recorded) in PIPELINES.items():
        cells = []
        for name in columns_with_results(reproduction):
            a, b = (
                reproduction.mean(
                    name, {**unit_case(unit, reproduction.quick), **column_parameters(name)}, "end_pressure"
                )
                for unit in UNITS[:2]
            )
            cells.append(f"{(up * a + along * b) / 1e6:.1f}" if math.isfinite(a + b) else "-")
        yield f"| {place} | {recorded / 1e6:.1f} | {paper / 1e6:.2f} | " + " | ".join(cells) + " |"
    yield ""


def _row(reproduction: Reproduction, row: Row) -> Iterator[str]:
    done = [
        (name, *verdict_of(reproduction, row, name))
        for name in columns_with_results(reproduction, [*CONCRETES, *OPEN_ASSUMPTIONS])
    ]
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
    for name, *_ in done:
        yield f"| {name} | " + " | ".join(map(_with_scatter, pressures(reproduction, row, name))) + " |"
    yield ""
    for name, _, verdict in done:
        yield f"- {name}: {verdict}."


def _verdict(errors: list[float], count: int) -> str:
    """Return a sentence that says whether the simulated pressures agree with the closed form.

    The pressures agree if every relative error in `errors` is below 3 %. If runs are missing, so that there are fewer
    than `count` errors, the pressures are not judged.
    """
    if len(errors) < count:
        return f"Not judged: {count - len(errors)} of {count} runs are missing."
    worst = float(np.max(errors))
    return f"Pressure {'holds' if worst < 0.03 else 'differs'}: at most {100 * worst:.2f} % off the closed form."


def draw(found: Reproduction) -> Figure:
    """Return a figure with a panel for each parameter; lines show simulated pressures, crosses show published ones."""
    panels_down = -(-(len(ZHAN) + 1) // 2)  # The last panel holds the legend.
    figure = new_figure("unit D (bend to vertical); titles state claims of Zhan et al. (2019)", *[2.8] * panels_down)
    panels, fields = figure.subplots(panels_down, 2).ravel(), modules()["pipe"].scene.fields({})
    for row, axes in zip(ZHAN, panels):
        for number_of, name in enumerate([*CONCRETES, *OPEN_ASSUMPTIONS]):
            each = pressures(found, row, name)
            means = np.array([np.mean(values) if values else np.nan for values in each]) / 1e3
            scatter = np.array([np.std(values, ddof=1) if len(values) > 1 else 0.0 for values in each]) / 1e3
            if np.any(np.isfinite(means)):
                axes.errorbar(row.places, means, yerr=scatter, fmt="o-" if name in CONCRETES else "s--", ms=4,
                              capsize=3, color=rgb(SERIES[number_of % len(SERIES)]), label=name)  # fmt: skip
        if row.printed:
            printed = [value / 1e3 for value in row.printed.values()]
            axes.plot(list(row.printed), printed, "x", color=rgb(MEASURED), ms=8, label="paper")
        if row.parameter == "hydration_modulus":
            axes.set_xscale("log")
        axes.set_title(textwrap.fill(row.claim, 30), fontsize="medium")
        unit = fields[row.parameter].unit.strip()
        axes.set(xlabel=f"{row.name} [{unit}]" if unit else row.name, ylabel="largest pressure [kPa]")
        axes.set_ylim(bottom=0)
        axes.set_visible(axes.has_data())
        open_frame(axes)
    lines = {label: handle for axes in panels for handle, label in zip(*axes.get_legend_handles_labels())}
    for axes in panels[len(ZHAN) :]:
        axes.set_axis_off()
    panels[-1].legend(lines.values(), lines.keys(), loc="center", frameon=False)
    return figure


def _xu(reproduction: Reproduction) -> Iterator[str]:
    yield "# Xu, Li & Jiang 2021, reproduced"
    yield ""
    yield (
        "Channel: between planes, as computed in the paper; tube: the round pipe that the paper describes. Theory is "
        "the closed form of each geometry. The paper reports errors below 3 %, and combines the flow of a pipe with "
        "the balance of forces of a channel."
    )
    for group, cases in xu_cases(reproduction.quick).items():
        yield ""
        yield f"## {group[0].upper()}{group[1:]}"
        yield ""
        yield "| scene | concrete | varied | pressure [kPa] | theory | error | slip velocity [cm/s] | theory |"
        yield "|---|---|---|---|---|---|---|---|"
        errors = []
        for scene, case in cases:
            key = key_of(f"{group}, {scene}", {**case, "seed": 0})
            shown = f"{VARIED[group]} {case[VARIED[group]]:g}" if group in VARIED else "mortar and grains"
            if key not in reproduction.results:
                why = reproduction.failures.get(key, "not run")
                yield f"| {scene} | {case['concrete']} | {shown} | {why} | | | | |"
                continue
            result = reproduction.results[key]
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
