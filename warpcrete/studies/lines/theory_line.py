"""Pressure of a pump line, calculated in a tenth of a second without any simulation.

The friction of straight pipe follows from closed forms. The friction of bends and reducers, relative to straight pipe,
was found in earlier simulations of such parts. This module must not import the simulations, because the import of Warp
takes longer than the calculation.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from ...core.errors import between, positive
from ...core.run.files import atomic_file, write_json
from ...geometry.pipe_line import PipeLine
from ...theory.pipe import Concrete
from .figure import draw
from .fittings import library_factor
from .line_fit import LineFit
from .losses import GRAVITY, friction
from .pressures import Loss, Stop
from .result import LineResult, lines_of

LAYER_FACTOR = 2.0
"""Default factor by which the resistance of an unmeasured slip layer may be wrong, in both directions."""


def check_settings(flow: float, layer_factor: float) -> None:
    """Raise an error if the flow [m3/s] is not positive or the uncertainty factor of the slip layer is below 1."""
    positive("flow", flow, "m3/s")
    between("layer_factor", layer_factor, 1, math.inf)


def line_by_theory(
    line: PipeLine,
    concrete: Concrete,
    flow: float,
    *,
    out: Path | None = None,
    layer_factor: float = LAYER_FACTOR,
    variants: Mapping[str, tuple[Concrete, Concrete]] | None = None,
    band_origin: str = "",
    stop: Stop | None = None,
    fit: LineFit | None = None,
) -> LineResult:
    """Compute the pressure that a `line` needs at a `flow` [m3/s] of a `concrete` without any simulation.

    The pressure of straight pipe follows from the closed form. For bends and reducers, the pressure of straight pipe is
    multiplied by factors from earlier simulations.

    The uncertainty band has two causes: the error of these factors, and the concrete. The uncertainty of the concrete
    is either the factor `layer_factor` by which the resistance of the slip layer may be wrong, or, if given, the pairs
    of concretes in `variants` with their origin `band_origin` (see :attr:`warpcrete.mix.mix.Mix.variants`).

    With a `stop`, the result includes the pressures that restart the line. If `line` and `concrete` come from a fit to
    measured pressures, `fit` is this fit, so that the report can describe it. With a folder `out`, the result is
    written there. Raises :class:`SceneError` for an impossible flow or setting.
    """
    check_settings(flow, layer_factor)
    losses = []
    for part in line.parts:
        theory = friction(part, concrete, flow)
        losses.append(Loss(part, theory * library_factor(part), theory, concrete.density * GRAVITY * part.rise))
    result = LineResult(
        line, concrete, flow, losses, layer_factor, False, variants, stop, folder=out, fit=fit, band_origin=band_origin
    )
    if out is not None:
        write_result(result, out)
    return result


def write_result(result: LineResult, out: Path) -> None:
    """Write the files line.json, line.md and line.png of a result into a folder."""
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "line.json", result.record())
    write_lines(lines_of(result), out)
    with atomic_file(out / "line.png") as partial:
        draw(result).savefig(partial, dpi=150, format="png")


def write_lines(lines: Sequence[str], out: Path) -> None:
    """Write lines of text to the file line.md in the folder of a line, and replace the earlier contents of the file."""
    with atomic_file(out / "line.md") as partial:
        partial.write_text("\n".join(lines) + "\n", encoding="utf-8")
