"""Output files of a calibration: tables, a figure, and the calibrated concrete."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ...core.drawing.style import RUN, SECOND, WIDTH, legend_above, new_figure, rgb
from ...core.inputs.parameters import Field, declared_fields
from ...core.inputs.yaml_files import yaml_text
from ...core.records import Record
from ...core.run.files import atomic_file, write_json
from ...core.run.scene_module import SceneModule
from .calibration import Calibration
from .posterior import confounded_pairs
from .targets import Target

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SMOOTH = 60
"""Number of bins in a histogram of the posterior. It is so large that the histogram looks like a smooth curve."""


def write(found: Calibration, modules: Mapping[str, SceneModule]) -> None:
    """Write calibration.md and, if a posterior exists, calibration.png, answer.json and concrete.yaml."""
    with atomic_file(found.folder / "calibration.md") as partial:
        partial.write_text(report(found) + "\n", encoding="utf-8")
    if found.posterior is None:
        return
    write_json(found.folder / "answer.json", answer(found))
    with atomic_file(found.folder / "calibration.png") as partial:
        draw(found, modules).savefig(partial, dpi=150, format="png")
    concrete = concrete_of(found, modules)
    if concrete:
        with atomic_file(found.folder / "concrete.yaml") as partial:
            partial.write_text(yaml_text(concrete), encoding="utf-8")


def report(found: Calibration) -> str:
    """Return a Markdown report with the parameters, the targets, and the findings of a calibration.

    The findings (:attr:`.Calibration.findings`) name, for example, parameters that the measurements do not determine.
    """
    lines = ["# Calibration", ""]
    if found.posterior is None:
        return "\n".join([*lines, f"No answer yet: {len(found.trials)} trials done."])
    lines += [*parameter_table(found), "", *target_table(found)]
    coarse = f"; coarse trials before them: {len(found.coarse)}" if found.coarse else ""
    lines += ["", f"Trials: {len(found.searched)}{coarse}; runs that verify the answer: {len(found.verifying)}."]
    lines += ["", *(f"- {said[0].upper()}{said[1:]}." for said in found.findings)]
    return "\n".join(lines).rstrip()


def parameter_table(found: Calibration) -> list[str]:
    """Return a Markdown table with the likeliest value and the 95 % interval of each free parameter."""
    assert found.posterior is not None
    lines = [
        "| parameter | range | most likely | 95 % of the posterior | width relative to the range |",
        "|---|---|---|---|---|",
    ]
    for place, free in enumerate(found.task.free):
        low, high = found.posterior.interval(place)
        lines.append(
            f"| {free.name} | {free.low:g} to {free.high:g} | {found.best[free.name]:.4g} | {low:.4g} to "
            f"{high:.4g} | {found.posterior.relative_width(place):.2f} |"
        )
    return lines


def target_table(found: Calibration) -> list[str]:
    """Return a Markdown table that compares each target with the verification runs and the posterior's prediction."""
    lines = [
        "| target | measured | runs with the most likely parameters | predicted | closed form | deviation / standard "
        "deviation |",
        "|---|---|---|---|---|---|",
    ]
    for target in found.task.targets:
        mean, deviation = _predicted(found, target)
        predicted = f"{target.words(mean)} +- {_shown(target, deviation)}" if np.isfinite(mean) else "too few runs"
        runs = found.verification_values(target)
        scatter = f" +- {_shown(target, float(np.std(runs, ddof=1)))}" if len(runs) > 1 else ""
        tried = f"{target.words(float(np.mean(runs)))}{scatter}" if runs else "not run"
        closed = target.words(found.closed_forms[target]) if target in found.closed_forms else "none"
        held = " (held out)" if target.held_out else ""
        lines.append(
            f"| {target.label}{held} | {target.words(target.value)} +- {_shown(target, target.uncertainty)} "
            f"| {tried} | {predicted} | {closed} | {found.off(target):+.1f} |"
        )
    return lines


def _predicted(calibration: Calibration, target: Target) -> tuple[float, float]:
    assert calibration.posterior is not None
    return calibration.posterior.predicted(target)


def _shown(target: Target, deviation: float) -> str:
    return target.words(deviation).partition(" ")[0]


def answer(found: Calibration) -> Record:
    """Return the parameters, targets and findings of a calibration for answer.json, in SI units."""
    assert found.posterior is not None
    return {
        "finished": found.finished,
        "settled": found.settled,
        "trials": len(found.searched),
        "coarse_trials": len(found.coarse),
        "parameters": {
            free.name: {
                "likeliest": found.best[free.name],
                "interval_95": list(found.posterior.interval(place)),
                "narrowing": found.posterior.relative_width(place),
            }
            for place, free in enumerate(found.task.free)
        },
        "targets": [
            {
                "target": target.label, "held_out": target.held_out, "unit": target.unit, "measured": target.value,
                "uncertainty": target.uncertainty, "runs": found.verification_values(target),
                "predicted": dict(zip(("mean", "deviation"), _predicted(found, target))),
                "closed_form": found.closed_forms.get(target), "off": found.off(target),
            }
            for target in found.task.targets
        ],
        "not_told_apart": [list(pair) for pair in confounded_pairs(found.posterior)],
        "findings": found.findings,
    }  # fmt: skip


def concrete_of(found: Calibration, modules: Mapping[str, SceneModule]) -> Record:
    """Return the contents of a file of the calibrated concrete.

    The file states those properties that have the same value in all scenes of the calibration. The result is empty if
    no free parameter is a property of the concrete.
    """
    sections: dict[str, Record] = {}
    names: set[Any] = set()
    for target in found.task.targets:
        scene = modules[target.scene].scene
        section, known = scene.parameters.of_concrete()
        given = found.task.parameters(target, found.best, modules[target.scene])
        names.add(given.get("concrete"))
        values = {name: value for name, value in scene.completed(given).items() if name in known and value is not None}
        if section and section in sections:
            both = sections[section]
            sections[section] = {name: both[name] for name in both if values.get(name) == both[name]}
        elif section:
            sections[section] = values
    if not any(name in section for section in sections.values() for name in found.best):
        return {}
    fitted = ", ".join(f"{target.label} = {target.words(target.value)}" for target in found.task.fitted)
    base = names.pop() if len(names) == 1 else found.task.base
    rounded = {
        section: {name: float(f"{value:.6g}") if isinstance(value, float) else value for name, value in values.items()}
        for section, values in sections.items()
    }
    head = {"calibrated": f"{', '.join(found.best)}, on {fitted}"}
    return head | ({} if base in (None, "own") else {"base": base}) | rounded


def draw(found: Calibration, modules: Mapping[str, SceneModule]) -> Figure:
    """Return a Matplotlib figure of the posterior, with the trials as points.

    The panels on the diagonal show the histogram of each parameter, and the panels below show pairs of parameters.
    """
    assert found.posterior is not None
    task, free = found.task, len(found.task.free)
    known = {name: field for target in task.targets
             for name, field in declared_fields(modules[target.scene].scene.parameters).items()}  # fmt: skip
    titles = [_title(known[each.name]) for each in task.free]
    samples = np.array([[f.value(u) for f, u in zip(task.free, row)] for row in found.posterior.samples])
    trials = np.array([[f.value(u) for f, u in zip(task.free, trial.units)] for trial in found.searched])
    turned = 0 if free < 3 else 90  # The numbers below narrow panels are turned by 90 degrees to avoid overlaps.
    figure = new_figure("posterior of the parameters: dark where values are likely", WIDTH)
    axes = figure.subplots(free, free, squeeze=False)
    for row in range(free):
        for column in range(free):
            here = axes[row][column]
            if column > row:
                here.set_visible(False)
                continue
            across, up = task.free[column], task.free[row]
            if row == column:
                here.hist(samples[:, column], bins=_bins(across), color="0.6")
                here.axvline(found.best[across.name], color=rgb(RUN), label="likeliest")
                here.plot(
                    trials[:, column], np.zeros(len(trials)), "|", color=rgb(SECOND), clip_on=False, label="trials"
                )
                here.set_yticks([])
            else:
                here.hist2d(samples[:, column], samples[:, row], bins=[_bins(across), _bins(up)], cmap="Greys")
                here.plot(trials[:, column], trials[:, row], ".", color=rgb(SECOND), ms=4)
                here.plot(found.best[across.name], found.best[up.name], "x", color=rgb(RUN), ms=8, mew=2)
                here.set(ylim=(up.low, up.high), yscale="log" if up.log else "linear",
                         ylabel=titles[row] if column == 0 else "")  # fmt: skip
            here.set(xlim=(across.low, across.high), xscale="log" if across.log else "linear",
                     xlabel=titles[column] if row == free - 1 else "")  # fmt: skip
            here.tick_params(axis="x", labelrotation=turned)
            for axis, of in ((here.xaxis, across), (here.yaxis, up)):
                if of.log and (axis is here.xaxis or row != column):
                    _few_ticks(axis)
    legend_above(axes[0][0])
    return figure


def _title(field: Field) -> str:
    """Return the name of a parameter with its unit, for the label of an axis."""
    return field.name.replace("_", " ") + (f" [{field.unit.strip()}]" if field.unit else "")


def _few_ticks(axis: Any) -> None:
    """Put ticks at 1, 2 and 5 times each power of ten, labelled with plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FuncFormatter(lambda value, place: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _bins(free: Any) -> np.ndarray:
    return (np.geomspace if free.log else np.linspace)(free.low, free.high, SMOOTH + 1)
