"""Run the simulations of `warpcrete line` by flows, by discrete elements, or by both, and print their results."""

from collections.abc import Callable, Mapping
from pathlib import Path

from ..core.inputs.fingerprints import fingerprint
from ..core.run.files import atomic_file
from ..core.run.progress import progress_bar
from ..geometry.pipe_line import PipeLine
from ..mix.mix import completed
from ..mps.common.mixes import concrete_of
from ..studies.lines.element_line import ElementLine, element_table_lines
from ..studies.lines.elements import Elements, run_elements
from ..studies.lines.line_folder import line_folder
from ..studies.lines.losses import friction
from ..studies.lines.pressures import Stop
from ..studies.lines.result import LineResult, lines_of
from ..studies.lines.run import run_line
from .line_inputs import LineInputs


def run(
    given: LineInputs, method: str, folder: Path, layer: Mapping[str, object], stop: Stop | None,
    settings: Mapping[str, object], finish: Callable[[list[str]], None], unless_known: bool = False,
) -> bool:  # fmt: skip
    """Simulate a line, call `finish` with the report, and return True if a simulated part failed a check.

    `method` is "flow", "dem" (discrete elements) or "both". `layer` holds the uncertainty of the concrete, as keyword
    arguments of `run_line`. `stop` is a rest of the concrete before a restart, or None. `settings` holds the options of
    the command by name. With `unless_known`, only parts whose friction cannot be found without a simulation are
    simulated. The line's folder is still locked when `finish` is called, so `finish` may write into it.
    """
    line, name, rate = given.line, given.name, given.flow
    assert rate is not None
    elements = Elements(**{key: settings[key] for key in ("shapes", "coarse", "seeds", "stiffer")})
    request = {"line": line.name, "parts": fingerprint(line.parts), "concrete": name, "flow": rate, "method": method,
             "cells": settings["cells"], "elements": fingerprint(elements)}  # fmt: skip
    if unless_known:
        request["simulated"] = "parts that no table covers"
    if settings["blocking"] is not None:
        request["blocking"] = settings["blocking"]
    where = {"out": folder, **{key: settings[key] for key in ("known", "device", "threads")}}
    result, packed = None, None
    with progress_bar(settings["quiet"]) as tell, line_folder(folder, request):
        if method != "dem":
            result = run_line(
                line, concrete_of(name), rate, simulate=True, unless_known=unless_known, cells=settings["cells"],
                stop=stop, progress=tell, **layer, **where,
            )  # fmt: skip
        if method != "flow":
            packed = run_elements(line, name, rate, elements=elements, progress=tell, **where)
        finish(_text(line, name, rate, result, packed, folder, settings["practice"]))
    return any(each is not None and bool(each.failed) for each in (result, packed))


def _text(
    line: PipeLine, name: str, rate: float, result: LineResult | None, packed: ElementLine | None, folder: Path,
    practice: bool,
) -> list[str]:  # fmt: skip
    """Return the results of all simulations as lines of text; write results of discrete elements into `folder`.

    `result` holds the results of flow simulations, and `packed` holds those of discrete elements; each is None without
    such simulations. `rate` is the volume flow [m3/s]. If `practice` is true, the text contains a comparison with rules
    of practice.
    """
    said = [] if result is None else lines_of(result, practice)
    if packed is not None:
        others = {} if result is None else {"flow": [x.friction for x in result.losses]}
        if completed(name).flow:
            concrete = concrete_of(name)
            others["theory"] = [friction(part, concrete, rate) for part in line.parts]
        text = element_table_lines(packed, others)
        said += ["", *text] if said else text
        with atomic_file(folder / "line-dem.md") as partial:
            partial.write_text("\n".join(text) + "\n", encoding="utf-8")
    took = (0.0 if result is None else sum(result.took.values())) + (0.0 if packed is None else packed.elapsed)
    return [*said, "", f"folder: {folder}; simulations took {took:.0f} s"]
