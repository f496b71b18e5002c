"""Pressure of a pump line by flow simulation: each kind of part is simulated once, and the losses are added up."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...core.device.interrupts import StopAtSample
from ...core.errors import between
from ...core.records import SceneArguments
from ...core.run.files import check_new, read_json
from ...core.run.progress import Progress
from ...core.units import number
from ...geometry.pipe_line import Part, PipeLine
from ...mps.common.mixes import CONCRETE_CONSTANTS
from ...record.checks import failed_checks
from ...scenes import modules
from ...theory.pipe import Concrete
from .fittings import AHEAD_DIAMETERS, check_cells, is_in_library, library_factor
from .folder import check_known, part_simulation, previous_run
from .line_folder import LINE_RECORD
from .losses import GRAVITY, friction, with_layer_factor
from .pressures import Loss, Stop
from .result import LineResult
from .theory_line import LAYER_FACTOR, check_settings, line_by_theory, write_result

CELLS = 12
"""Default number of cells across the narrowest bore of a bend or reducer. In front of and behind bends of 125 mm and a
radius of 0.5 m, the friction of straight pipe deviates from theory by -0.5 to 1.4 % with 12 cells. These figures are
for the concrete no1, and for concretes with yield stresses of 310 and 600 Pa and a wall stress of 400 Pa. With 8 cells,
the friction deviates by 2.2 to 3.1 %."""
TUBE_CELLS = 20
"""Number of cells across the bore of a simulated straight pipe. It is larger than in bends and reducers because a
periodic pipe is short and cheap to simulate."""
CURE = "; usual cure: "
"""Text between the finding of a failed check and the scene parameters that usually avoid the failure."""
LINE_CURES = {"friction upstream": "a larger --cells", "friction downstream": "a larger --cells"}
"""Option of `warpcrete line` that helps if a check of a simulated part fails, by the name of the check."""


def run_line(
    line: PipeLine,
    concrete: Concrete,
    flow: float,
    *,
    out: Path | None = None,
    known: Path | None = None,
    simulate: bool = False,
    unless_known: bool = False,
    cells: int = CELLS,
    layer_factor: float = LAYER_FACTOR,
    variants: Mapping[str, tuple[Concrete, Concrete]] | None = None,
    band_origin: str = "",
    device: str | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
    stop: Stop | None = None,
) -> LineResult:
    """Compute the pressure that a `line` needs at a `flow` [m3/s] of a `concrete`.

    By default, :func:`line_by_theory` computes the answer. With `simulate`, each kind of part is simulated once,
    without gravity. A straight pipe is simulated with periodic ends. A bend or reducer is simulated between two
    straight pipes, whose friction is subtracted, with `cells` cells across the narrowest bore. With `unless_known`,
    only bends and reducers that are sharper than those in the table of earlier simulations are simulated, and the
    friction of all other parts, including bores from meshes, comes from :func:`line_by_theory`.

    The pressure has an uncertainty band with two causes: the model errors of fittings, and the concrete. The
    uncertainty of the concrete is either the factor `layer_factor` by which the resistance of the slip layer may be
    wrong, or, if given, the pairs of concretes in `variants` with their origin `band_origin` (see
    :attr:`warpcrete.mix.mix.Mix.variants`). With a `stop`, the result includes the pressure that restarts the line.

    Runs are stored in the folder `out`, which must be new or locked by
    :func:`warpcrete.studies.lines.line_folder.line_folder`. In a locked folder, interrupted runs continue. Finished
    runs in `known`, the folder of an earlier line, are reused. Raises :class:`SceneError` for an impossible flow or
    setting.

    For example, with a line and a mix from files::

        line, mix = read_line("site.yaml"), read_mix("ticket.yaml")
        found = run_line(line, mix.concrete, line.flow, variants=mix.variants, band_origin=mix.band_origin)
    """
    check_settings(flow, layer_factor)
    between("cells", cells, 8, math.inf)
    if out is not None and not (out / LINE_RECORD).is_file():
        check_new(out)
    check_known(known)
    if not simulate:
        return line_by_theory(
            line,
            concrete,
            flow,
            out=out,
            layer_factor=layer_factor,
            variants=variants,
            band_origin=band_origin,
            stop=stop,
        )
    tell = progress or (lambda phase, fraction, figures: None)
    kinds = {
        part.loss_key: part for part in line.parts if part.factor is None and not (unless_known and is_in_library(part))
    }
    for part in kinds.values():
        check_cells(part, cells)
    cases = {key: _scene_of_part(part, concrete, flow, cells) for key, part in kinds.items()}
    # Build all scenes before the first run, so that an impossible scene is refused at once.
    scenes = {key: modules()[name].scene(**parameters) for key, (name, parameters) in cases.items()}
    found: dict[tuple[Any, ...], float] = {}
    took: dict[str, float] = {}
    failed: dict[str, list[str]] = {}
    for place, (key, part) in enumerate(kinds.items()):

        def report_progress(phase: str, fraction: float, figures: dict[str, float], place: int = place) -> None:
            tell(phase, (place + fraction) / len(kinds) if phase == "running" else fraction, figures)

        called = folder_name(part) + ("" if part.is_by_length else f"-cells-{cells}")
        digest = part.mesh.digest if part.mesh else ""
        folder = previous_run((out, known), scenes[key], digest)
        result = None if folder is None else read_json(folder / "result.json")
        if result is None:
            simulation, checkpoint = part_simulation(
                scenes[key], modules()[cases[key][0]].check, out, called, digest, device=device, threads=threads,
                progress=report_progress,
            )  # fmt: skip
            simulation.begin(checkpoint)
            with StopAtSample([simulation]):
                run = simulation.run()
            if not run.finished:
                raise KeyboardInterrupt
            result = run.result
            took[called] = number(result["speed"]["wall_time"])
        if bad := failed_checks(result):
            failed[called] = [_failure(name, str(result["checks"][name]["found"])) for name in bad]
        found[key] = _loss_from_run(part, result)
    losses = []
    for part in line.parts:
        theory = friction(part, concrete, flow)
        if part.loss_key in found and part.factor is None:
            ours = found[part.loss_key] * (part.length * part.relative_loss if part.is_by_length else 1.0)
        else:
            ours = theory * library_factor(part)
        losses.append(Loss(part, ours, theory, concrete.density * GRAVITY * part.rise))
    result = LineResult(
        line,
        concrete,
        flow,
        losses,
        layer_factor,
        True,
        variants,
        stop,
        folder=out,
        took=took,
        failed=failed,
        band_origin=band_origin,
    )
    if out is not None:
        write_result(result, out)
    return result


def _failure(check: str, finding: str) -> str:
    """Return the finding of a failed check, and the option of `warpcrete line` that avoids the failure, as text."""
    text = f"{check}: {finding.split(CURE)[0]}"
    return f"{text}{CURE}{LINE_CURES[check]}" if check in LINE_CURES else text


def _scene_of_part(part: Part, concrete: Concrete, flow: float, cells: int) -> tuple[str, SceneArguments]:
    """Return the name of the scene that simulates a part without gravity, and the parameters of this scene.

    `cells` is the number of cells across the narrowest bore of a bend, a reducer or a mesh. A straight pipe has
    :data:`TUBE_CELLS` cells across.
    """
    concrete = with_layer_factor(concrete, part.layer)
    own = {"concrete": "own", **{name: getattr(concrete, name) for name in CONCRETE_CONSTANTS}}
    own |= {"diameter": part.diameter, "flow": flow, "gravity": 0.0}
    if part.is_by_length:
        spacing = part.diameter / TUBE_CELLS
        step = min(5e-4, 0.4 * spacing / (flow / (math.pi * part.diameter**2 / 4)))
        return "tube", {**own, "ends": "periodic", "spacing": spacing, "time_step": step}
    narrow, wide = part.narrow, max(part.diameter, part.outlet)
    spacing = narrow / cells
    fastest = flow / (math.pi * narrow**2 / 4)
    own |= {"spacing": spacing, "straight": AHEAD_DIAMETERS * wide, "time_step": min(5e-3, 0.5 * spacing / fastest)}
    if part.kind == "bend":
        return "part", {**own, "unit": "bend-level", "angle": max(part.angle, 5.0), "elbow_radius": part.radius}
    if part.mesh:
        return "part", {**own, "unit": "mesh", "wall": part.mesh.file, "wall_scale": part.mesh.scale}
    return "part", {**own, "unit": "horizontal", "outlet_diameter": part.outlet, "taper": part.length}


def _loss_from_run(part: Part, result: Mapping[str, object]) -> float:
    """Return the friction from the result of a part's simulation.

    For a straight pipe or a hose, this is the friction per metre [Pa/m]. For a bend, reducer or bore, it is the
    friction of the whole part [Pa].
    """
    if part.is_by_length:
        return 4 * number(result["wall_stress"]) / part.diameter
    return number(result["middle_loss"]) * (part.angle / max(part.angle, 5.0) if part.kind == "bend" else 1.0)


def folder_name(part: Part) -> str:
    """Return the name of the run folder for a kind of part."""
    if part.is_by_length:
        layer = "" if part.layer == 1 else f"-layer-{part.layer:g}"
        return f"straight-{1e3 * part.diameter:g}{layer}"
    if part.mesh:
        return f"bore-{1e3 * part.diameter:g}-{1e3 * part.outlet:g}-{part.length:g}-{part.mesh.digest}"
    shape = f"{part.angle:g}-{part.radius:g}" if part.kind == "bend" else f"{1e3 * part.outlet:g}-{part.length:g}"
    return f"{part.kind}-{1e3 * part.diameter:g}-{shape}"
