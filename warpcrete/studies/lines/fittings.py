"""Friction of bends, reducers, hoses, valves and changes of bore, divided by the friction of straight pipe.

For each kind of part, this module holds the range of this ratio, and the source of the range.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ...core.errors import refuse
from ...core.inputs.customary import both
from ...geometry.course import BEND_EXTRA_LOSS
from ...geometry.pipe_line import Part

AIJ = "AIJ, rule for pumping (https://ga40077.com/concrete-engineer/calculation-pumping-load)"
JGJ = "JGJ/T 10, table of pressure losses (https://www.wendadaohang.com/zd/A5nWWn53n31WG51WdKW.html)"
JSCE = "JSCE, rule for pumping (https://ga40077.com/concrete-engineer/calculation-pumping-load)"
CALIBE = "Kaplan and CALIBE (NIST, Materials science of concrete 2000: 150 m, 12 elbows, more than 50 concretes)"
PARK = "Park et al., ACI Mater. J. 117-3 (2020) 205 (133, 369 and 560 m, four concretes)"
AHEAD_DIAMETERS = 2.5
"""Length of straight pipe before and behind a simulated bend or reducer, divided by the larger of the part's
diameters."""
MOST_UNASKED, MOST_CELLS = 3e5, 5e6
"""Two limits for the number of cells of a simulated part. MOST_CELLS applies if the user requested the simulation
(`--simulate`), and MOST_UNASKED applies otherwise. A bend of 125 mm with a radius of 0.125 m has 4,500 cells, and a
million cells need 6 GB of memory."""
VALVE_PRESSURE = 0.8e6
"""Pressure loss of a stop valve [Pa] (JGJ/T 10)."""
REDUCER_EXTRA_LOSS = ((0.0, 0.0208, 0.025, 0.0417, 0.05, 0.0833), (0.0, 0.047, 0.082, 0.117, 0.161, 0.452))
"""Additional pressure loss of a reducer, as a fraction of the loss in straight pipe of the same bores and length. The
first tuple holds changes of radius divided by the length of the reducer, and the second tuple holds the additional loss
for each change. Source: simulated flows of the concrete no1 at 20 and 30 m3/h through reducers from 150 to 125 mm and
from 125 to 100 mm over 0.15 to 0.6 m, with 12 cells across. In a pipe that widens from 100 to 125 mm over 0.5 m, the
simulated loss is 0.993 times the loss in straight pipe."""


@dataclass(frozen=True)
class ModelError:
    """Lowest and highest friction of one kind of part, divided by the friction of straight pipe of the same length."""

    cause: str
    """Plural name of the kind of part, such as 'bends'. Tables of the causes of a pressure's uncertainty show it."""
    low: float
    high: float
    source: str
    """Publications and rules of practice that give the lower and the upper end of the range."""


MODEL_ERRORS = {
    "bend": ModelError("bends", 1.0, 3.0, f"1: {CALIBE}; 2: {PARK}; 3: {AIJ}"),
    "reducer": ModelError("reducers", 1.0, 2.0, f"2: {AIJ}"),
    "hose": ModelError("hoses", 1.0, 2.0, f"2: {AIJ}"),
    "bore": ModelError("bores", 1.0, 2.0, f"as a reducer, 2: {AIJ}"),
    "valve": ModelError("valves", 1.0, 1.0, f"from straight pipe to 0.8 MPa: {JGJ}"),
}
"""Lowest and highest friction of each kind of part, divided by the friction of straight pipe of the same length. For a
valve, the highest friction is the pressure loss :data:`VALVE_PRESSURE`, unless straight pipe has a larger friction."""


def methods_on_bends(customary: bool = False) -> str:
    """Return a sentence for site engineers that compares the friction of bends from two kinds of simulations.

    Bends in pipes of 150 mm were simulated as a fluid, and with stones as discrete elements. If `customary` is true,
    the sentence also states lengths in feet.
    """
    wide, tight = (both(customary, "m", radius, digits=3) for radius in (0.5, 0.25))
    return (
        "In simulations as a fluid, a bend of 90 degrees has 2 to 13 % more friction than straight pipe of its length. "
        f"With stones, it has the same friction for a radius of {wide} or more, and 1.5 times as much for {tight}. "
        "Therefore calculate a bend as straight pipe of its length, but also check the line with three times this "
        "friction."
    )


def range_of(part: Part, straight: float) -> tuple[float, float] | None:
    """Return the lowest and the highest possible friction of a part, divided by the friction of straight pipe.

    The straight pipe has the same length and bores as the part, and `straight` is its friction [Pa]. The result depends
    on the origin of the part's friction:

    - Fit to pressures measured on a trial line: the range from the fit.
    - Entry in the file of the line: the range that the entry states, or None if it states none.
    - Straight pipe: None.
    - All other parts: the range of :data:`MODEL_ERRORS`. The pressure loss of a valve may also reach
      :data:`VALVE_PRESSURE`, so its upper end is at least this pressure divided by `straight`.
    """
    error = MODEL_ERRORS.get(part.kind)
    if part.factor is not None:
        return part.factor_range
    if error is None:
        return None
    return error.low, max(error.high, VALVE_PRESSURE / straight) if part.kind == "valve" else error.high


def uncertain_kinds(parts: Iterable[Part]) -> tuple[str, ...]:
    """Return the kinds of parts with uncertain friction, such as 'bend', in the order in which they occur in a line."""
    return tuple(dict.fromkeys(p.kind for p in parts if p.kind in MODEL_ERRORS and _is_uncertain(p)))


def _is_uncertain(part: Part) -> bool:
    return part.factor is None or part.factor_range is not None


def library_factor(part: Part) -> float:
    """Return the friction of a bend or reducer, divided by the friction of straight pipe of its length and bores.

    The factor is interpolated between the factors of bends or reducers that were simulated with different sharpness.
    The result is 1 for other kinds of parts, and for a part for which the line's file states a factor.
    """
    if part.factor is not None:
        return 1.0
    if part.kind == "bend":
        return 1 + float(np.interp(part.diameter / part.radius, *BEND_EXTRA_LOSS))
    if part.kind == "reducer":
        # The first entry of the table is the loss at constant radius, which is zero. The interpolation also returns
        # zero for a pipe that widens, because the change of radius is then negative.
        return 1 + float(np.interp((part.diameter - part.outlet) / 2 / part.length, *REDUCER_EXTRA_LOSS))
    return 1.0


def is_in_library(part: Part) -> bool:
    """Return whether the friction of a pipe part can be found without a simulation.

    The friction of a bend or reducer can be found if the line's file states its factor, or if the table of simulated
    parts covers the part. The table covers all bends and reducers that are not sharper than the sharpest simulated one.
    The result is True for all other kinds of parts.
    """
    if part.factor is not None or part.kind not in ("bend", "reducer"):
        return True
    if part.kind == "bend":
        return part.diameter / part.radius <= BEND_EXTRA_LOSS[0][-1]
    return (part.diameter - part.outlet) / 2 / part.length <= REDUCER_EXTRA_LOSS[0][-1]


def cells_of(part: Part, cells: int) -> float:
    """Return the number of cells in which a bend or reducer is simulated, with straight pipe before and behind it.

    `cells` is the number of cells across the narrowest bore. Half of the part is simulated, because it is symmetrical.
    """
    ahead = AHEAD_DIAMETERS * max(part.diameter, part.outlet)
    squares = part.diameter**2 * (ahead + 0.5 * part.length) + part.outlet**2 * (ahead + 0.5 * part.length)
    return 0.5 * math.pi / 4 * squares / (part.narrow / cells) ** 3


def count_text(count: float) -> str:
    """Return a large count as a text with two significant digits, such as "980,000"."""
    return f"{float(f'{count:.2g}'):,.0f}"


def check_cells(part: Part, cells: int, asked: bool = True) -> None:
    """Refuse to simulate a bend or reducer with too many cells; the limit is higher if the user requested it (`asked`).

    Raises :class:`SceneError` with the number of cells.
    """
    count, most = cells_of(part, cells), MOST_CELLS if asked else MOST_UNASKED
    if part.kind not in ("bend", "reducer") or count <= most:
        return
    problem = f"would be simulated with {count_text(count)} cells, but at most {most:,.0f} are possible"
    hint = (
        "check the diameters of the line, state a 'factor' of the part, or simulate no part (with the command --theory "
        "instead of --simulate, in Python simulate=False)"
    )
    if not asked:
        problem = (
            f"is sharper than all parts in the table, and its simulation with {count_text(count)} cells may take hours"
        )
        hint = "check the diameters of the line, or add the option --theory or a 'factor' of the part"
        hint += "; --simulate simulates every part of the line" if count <= MOST_CELLS else ""
    refuse(f"part {part.number}", part.label, problem, hint)
