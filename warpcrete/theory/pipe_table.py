"""Text tables of the theory of pipe flow, for the command line."""

from collections.abc import Sequence

from ..core.errors import SceneError
from .laws import BINGHAM
from .pipe import FORMS, Concrete, Line, Steady, after_rest, flow_of_pressure, kaplan, restart, steady

MEANINGS = (
    "forms: pipe = round pipe; plane = channel between two planes, as wide as the pipe; paper = equations for two "
    "dimensions as Xu, Li & Jiang (2021) print them, only for comparison with their figures"
)
"""Line below a table that explains the forms of the theory."""
KAPLAN_MEANING = "; kaplan = simplified equations for a round pipe by Kaplan, de Larrard & Sedran (2005)"
"""Addition to this line for a table that has a row of Kaplan's model."""


def restart_table(concrete: Concrete, line: Line, rest: float, thixotropy: float, flow: float) -> str:
    """Return a text table of the restart pressures after `rest` [s], one row for each form of the theory.

    Each row contains the smallest pressure at which concrete moves, the peak pressure at `flow` [m3/s], and the peak
    pressure divided by the steady pressure at this flow.
    """
    grown = after_rest(concrete, rest, thixotropy)
    lines = [
        f"after {rest:g} s at rest with a growth rate of {thixotropy:g} Pa/s: yield stress "
        f"{grown.yield_stress:g} Pa, of the slip layer {grown.slip_yield:g} Pa",
        f"{'form':8s}{'starts at [Pa]':>16s}{'starts at [Pa/m]':>18s}{f'at {flow:.5g} m3/s [Pa]':>24s}"
        f"{'ratio to steady flow':>22s}",
    ]
    for form in FORMS:
        least = restart(concrete, line, rest, thixotropy, form=form).pressure
        peak = restart(concrete, line, rest, thixotropy, flow, form).pressure
        over = peak / steady(concrete, line, flow, form).pressure
        lines.append(f"{form:8s}{least:16.6g}{least / line.length:18.6g}{peak:24.6g}{over:22.4g}")
    return "\n".join(lines)


def _pipe_text(line: Line) -> str:
    """Return length, diameter and direction of a pipe as text, and its gravity if this is unusual."""
    ways = {1.0: "upright", 0.0: "level", -1.0: "downward"}
    way = ways.get(line.rise, f"rising {line.rise:g} m per m")
    gravity = "" if line.gravity == Line().gravity else f", gravity {line.gravity:g} m/s2"
    return f"pipe: {line.length:g} m long, {2e3 * line.radius:.4g} mm wide, {way}{gravity}"


def table(concrete: Concrete, line: Line, flows: Sequence[float] = (), pressures: Sequence[float] = ()) -> str:
    """Return a text table of pressure and slip velocity at `flows` [m3/s], or of the flow at `pressures` [Pa].

    Each form of the theory has a row. For each flow, Kaplan's model has a row too, if all laws are Bingham's. If the
    pressure is too low for flow in one form, the row of this form says so. Raises :class:`SceneError` if nothing flows
    in any form.
    """
    lines = [
        f"{concrete.name}: density {concrete.density:g} kg/m3, viscosity {concrete.viscosity:g} Pa s, yield stress "
        f"{concrete.yield_stress:g} Pa{concrete.bulk_law.words}; slip layer {concrete.slip_viscosity:g} Pa s/m, "
        f"{concrete.slip_yield:g} Pa{concrete.layer_law.words}",
        _pipe_text(line),
        f"{'form':8s}{'flow [m3/s]':>14s}{'pressure [Pa]':>15s}{'wall stress [Pa]':>18s}{'slip [m/s]':>12s}"
        f"{'plug radius [m]':>17s}",
    ]

    def line_of(s: Steady) -> str:
        return (
            f"{s.form:8s}{s.flow:14.5g}{s.pressure:15.6g}{s.wall_stress:18.5g}{s.slip_velocity:12.5g}"
            f"{s.plug_radius:17.4g}"
        )

    has_kaplan = len(flows) > 0 and concrete.bulk_law.name == concrete.layer_law.name == BINGHAM
    for flow in flows:
        lines += [line_of(steady(concrete, line, flow, form)) for form in FORMS]
        if has_kaplan:
            lines.append(line_of(kaplan(concrete, line, flow)))
    for pressure in pressures:
        standing = []
        for form in FORMS:
            try:
                lines.append(line_of(flow_of_pressure(concrete, line, pressure, form)))
            except SceneError as error:
                standing.append(error)
                lines.append(f"{form:8s}{0:14.5g}{pressure:15.6g}   {str(error).partition(': ')[2].partition(' (')[0]}")
        if len(standing) == len(FORMS):
            raise standing[-1]
    return "\n".join([*lines, MEANINGS + (KAPLAN_MEANING if has_kaplan else "")])
