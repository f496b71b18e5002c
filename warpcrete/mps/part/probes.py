"""Measurements of concrete that flows through a part of a pump line."""

from collections.abc import Iterator, Sequence

import numpy as np

from ...core.run.tables import Table
from ...kernels.mps.grid.cells import LIQUID
from ..grid.flow import GridFlow
from .layout import Frame, stations
from .scene import CLEARANCE, PartScene, Section

UNITS = {
    "time": "s",
    "pressure": "Pa",
    "upstream_gradient": "Pa/m",
    "middle_loss": "Pa",
    "downstream_gradient": "Pa/m",
    "outflow_error": "1",
    "fastest": "m/s",
    "viscosity_iterations": "1",
    "pressure_iterations": "1",
}
"""Units of the columns of the time series."""

LEAST_MORTAR = 1e-6
"""Minimum value of the fraction of mortar in a cell, when cells are weighted with this fraction in means over a
cross-section. It keeps the sum of the weights above zero."""
FULL = 0.3
"""Minimum filled fraction of the bore in a slice one cell thick. In slices with less concrete, no pressure is measured.

The filled volume of a slice is the sum of the open volumes of its cells with concrete.
"""


def friction_ahead(flow: GridFlow, mortar: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return arc lengths [m], and at each of them the mean axial stress of the cross-section without weight [Pa].

    The axial stress is the pressure minus the deviatoric normal stress along the axis, and positive in compression. In
    straight pipe, the slope of the axial stress equals the friction on the wall. The slope of the pressure differs from
    the friction by up to 6 % within about two diameters of an end or a bend, because the plug bears a deviatoric normal
    stress there, which fades with the distance. The solver leaves out the hydrostatic pressure, so the axial stress is
    the frictional loss from the cross-section to the end of the pipe. `mortar` is the fraction of each cell that is not
    filled by aggregates. Means are taken over the mortar only, because the pressure inside aggregates has no meaning.
    """
    scene: PartScene = flow.scene
    layout = flow.state.layout
    h, liquid = layout.spacing, flow.state.cells("liquid") > 0
    s = stations(scene, layout.room, liquid)
    weight = np.where((s > 0) & (s < scene.axis.length), flow.state.cells("room")[liquid], 0.0)
    bins = np.clip((s / h).astype(int), 0, int(scene.axis.length / h))
    stress = flow.state.cells("pressure")[liquid] - _deviatoric_stress(flow, liquid, s)
    whole, place = (np.bincount(bins, weight * values) for values in (np.ones_like(s), s))
    share = weight if mortar is None else weight * np.maximum(mortar[liquid], LEAST_MORTAR)
    mean = np.bincount(bins, share * stress) / np.maximum(np.bincount(bins, share), 1e-300)
    section = (0.5 if scene.is_half else 1.0) * np.pi * scene.bore((np.arange(len(whole)) + 0.5) * h) ** 2
    there = whole > FULL * section / h**2
    return place[there] / whole[there], mean[there]


def _deviatoric_stress(flow: GridFlow, liquid: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Return the deviatoric normal stress along the pipe's axis [Pa], positive in tension, in the cells of a mask.

    The stress is t (2 eta D) t with the tangent t of the axis, the apparent viscosity eta of the cell and the rate of
    deformation D. `liquid` is the mask of cells with concrete, and `s` holds their arc lengths [m].
    """
    h, state = flow.state.layout.spacing, flow.state
    tangent = flow.scene.axis.at(s)[1] @ Frame(flow.scene).axes.T
    velocity, moving = state.faces("velocity"), state.faces("kind") == int(LIQUID)
    inner, rate = (slice(1, -1),) * 3, np.zeros(len(s))
    means = []
    for axis in range(3):
        # A cell has the index of its lower face. Arrays store the axes in reverse order.
        above = tuple(slice(2, None) if k == 2 - axis else slice(1, -1) for k in range(3))
        low, high = velocity[axis][inner], velocity[axis][above]
        stretch = np.where(moving[axis][inner] & moving[axis][above], high - low, 0.0) / h
        rate += tangent[:, axis] ** 2 * stretch[liquid]
        means.append(0.5 * (low + high))
    for i in range(3):
        for j in range(3):
            if i != j and np.any(both := tangent[:, i] * tangent[:, j]):
                rate += both * _slope(means[i], liquid, 2 - j)[liquid] / h
    return 2 * state.cells("in_cell")[liquid] * rate


def _slope(values: np.ndarray, known: np.ndarray, axis: int) -> np.ndarray:
    """Return the change of a field per cell along an array axis: the mean of the changes from and to the neighbours.

    `known` is the mask of the cells with valid `values`. A change between two cells is used only if both values are
    valid. If a cell has no valid change, the result is 0.
    """
    total, count = np.zeros_like(values), np.zeros_like(values)
    low, high = (
        tuple(cut if k == axis else slice(None) for k in range(values.ndim))
        for cut in (slice(None, -1), slice(1, None))
    )
    both = known[low] & known[high]
    change = np.where(both, values[high] - values[low], 0.0)
    for side in (low, high):
        total[side] += change
        count[side] += both
    return total / np.maximum(count, 1)


def straight_lines(scene: PartScene, s: np.ndarray, pressure: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return lines fitted to the pressure in the straight pipes upstream and downstream of a part's middle.

    The middle is the stretch from the first to the last bend or taper. Each line is returned as its slope [Pa/m] and
    its value at arc length zero [Pa]. Points are not used if their distance from an end of a straight pipe is less than
    CLEARANCE times the pipe's radius. With fewer than three points, slope and value are NaN.
    """
    begin, end = scene.middle
    first, last = float(scene.bore(0.0)), float(scene.bore(scene.axis.length))
    lines = []
    for low, high in (
        (CLEARANCE * first, begin - CLEARANCE * first * (end > begin)),
        (end + CLEARANCE * last * (end > begin), scene.axis.length - CLEARANCE * last),
    ):
        chosen = (s > low) & (s < high)
        lines.append(np.polyfit(s[chosen], pressure[chosen], 1) if chosen.sum() > 2 else np.full(2, np.nan))
    return lines[0], lines[1]


def stations_of(scene: PartScene, s: np.ndarray, friction: np.ndarray) -> Table:
    """Return a table of the bore's radius, the remaining friction and the pressure at arc lengths `s` [m].

    `friction` is the frictional loss from each arc length to the end of this part of the pump line [Pa]. It becomes the
    column `friction_ahead`. The pressure includes the weight of the concrete.
    """
    columns = {"place": s, "radius": scene.bore(s), "friction_ahead": friction, "pressure": friction + scene.weight(s)}
    return Table(columns, {"place": "m", "radius": "m", "friction_ahead": "Pa", "pressure": "Pa"})


def losses(scene: PartScene, s: np.ndarray, pressure: np.ndarray) -> list[float]:
    """Return the frictional loss of each section of a part of a pump line [Pa].

    The loss is the difference of the pressures at the ends of the section. At the ends of straight pipes, the pressure
    is taken from a straight line, which is fitted to the pressures along the pipe except within one radius of its ends.
    At all other ends, and in pipes too short for a line, the pressure is the mean over the cross-section.
    """
    sections = scene.sections
    at = [float(np.interp(place, s, pressure)) for place in (0.0, *(x.end for x in sections))]
    for first, last in _stretches(sections):
        begin, end = sections[first].begin, sections[last].end
        low, high = (place + sign * CLEARANCE * float(scene.bore(place)) for place, sign in ((begin, 1), (end, -1)))
        chosen = (s > low) & (s < high)
        if chosen.sum() > 2:
            line = np.polyfit(s[chosen], pressure[chosen], 1)
            for k in range(first, last + 2):
                at[k] = float(np.polyval(line, sections[k].begin if k <= last else end))
    return [at[k] - at[k + 1] for k in range(len(sections))]


def _stretches(sections: Sequence[Section]) -> Iterator[tuple[int, int]]:
    """Yield the indices of the first and last section of each uninterrupted series of straight sections."""
    first = None
    for k, section in enumerate(sections):
        if section.straight and first is None:
            first = k
        if first is not None and (k + 1 == len(sections) or not sections[k + 1].straight):
            yield first, k
            first = None


def measured(
    flow: GridFlow, friction: tuple[np.ndarray, np.ndarray] | None = None, velocity: np.ndarray | None = None
) -> dict[str, float]:
    """Measure a flow through a part of a pump line and return a row of the time series.

    The entry `pressure` is the pressure at the start of the part that balances friction and weight. `friction`, if
    stated, is used instead of the result of `friction_ahead`. `velocity`, if stated, is used instead of the flow's
    velocities across cell faces [m/s], shape (3, *shape).
    """
    scene: PartScene = flow.scene
    if not flow.steps:
        return dict.fromkeys(UNITS, 0.0)
    before, behind = straight_lines(scene, *(friction or friction_ahead(flow)))
    begin, end = scene.middle
    outcomes = flow.outcomes()
    layout = flow.state.layout
    top = layout.shape[0] - 1
    velocity = flow.state.faces("velocity") if velocity is None else velocity
    out = velocity[2][top] * flow.state.faces("volume")[2][top]
    open_side = flow.state.faces("kind")[2][top] == int(LIQUID)
    # Only half of the control volume of a face on the open side lies in the grid. The area of the face is therefore the
    # volume of this half, divided by half a spacing.
    whole = float(np.sum(out, where=open_side)) / (0.5 * layout.spacing)
    half = 0.5 if scene.is_half else 1.0
    moving = flow.state.faces("kind") == int(LIQUID)
    weight = scene.density * scene.gravity * scene.rise
    return {
        "time": flow.time,
        "pressure": float(np.polyval(before, 0.0)) + weight,
        "upstream_gradient": -float(before[0]),
        "middle_loss": float(np.polyval(before, begin) - np.polyval(behind, end)),
        "downstream_gradient": -float(behind[0]),
        "outflow_error": whole / (half * scene.flow) - 1,
        "fastest": float(np.abs(np.where(moving, velocity, 0.0)).max()),
        "viscosity_iterations": outcomes["viscosity"]["iterations"],
        "pressure_iterations": outcomes["pressure"]["iterations"],
    }
