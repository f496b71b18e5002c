"""Results of a discrete element run: named numbers, each with its unit."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...core.run.method import Quantity
from ...core.run.run import Run
from ...core.units import number
from ...geometry.walls import Wall
from ...standards.standard_test import report_unrest
from ..scene.scene import Scene
from ..scene.strokes import held, peaks
from .blockage import BlockageWatch
from .blockage_results import QUANTITIES as OF_BLOCKAGE
from .blockage_results import blocked_words, not_blocked_words
from .probes import ContactSums
from .sampling import STORED
from .segregation import QUANTITIES as OF_SEGREGATION
from .segregation import words as segregation_words
from .station_losses import layer_gradient, losses
from .stations import StationLog
from .vessel_measures import quantities as of_vessels
from .wear import WearMap
from .wear_results import QUANTITIES as OF_WEAR
from .wear_results import report as report_wear

WINDOW = 0.2
"""Length of the final window, in which pressures are averaged, as a fraction of the piston's travel."""
LEVEL = 0.1
"""Largest change of the pressure on a plateau, divided by the mean pressure.

Two changes must stay within this limit. The first is the difference between the mean over the final window and the mean
over an equal window before it. The second is the rise of a straight line that is fitted to the pressure in the final
window.
"""
NOISE = 2.0
"""Tolerance for the change of the pressure in the final window, in standard deviations of the pressure's noise. The
tolerance is needed because a noisy pressure may rise or fall by chance in a short window."""
MEDIAN = 1.4826
"""Ratio of the standard deviation to the median absolute deviation of a normal distribution."""


@dataclass(frozen=True)
class Known:
    """Data of a run from which its results, which are named numbers with units, are computed."""

    scene: Scene
    walls: Sequence[Wall]
    series: dict[str, np.ndarray]
    mass: float
    """Total mass of all bodies [kg]."""
    contacts: ContactSums
    """Object with sums over all contacts at the end of the run: their number, the coordination number, overlaps,
    energies [J], and the numbers of bonds and of broken bonds."""
    wear: WearMap | None = None
    blockage: BlockageWatch | None = None
    """Outcome of the check for blockage during the run; None if the scene did not request this check."""
    log: StationLog | None = None
    """Measurements in slices (stations) along the pipe; None if the scene does not request them in every sample."""

    @cached_property
    def losses(self) -> dict[str, float]:
        """Friction losses along the pipe by name, averaged over the final window; empty if they were not measured.

        :func:`warpcrete.dem.measure.station_losses.losses` lists the names and their units.
        """
        if self.log is None or not self.pumped:
            return {}
        return losses(self.log.stations, self.log.table(self.window), self.scene.gravity)

    def along(self, name: str) -> float | None:
        """Return an entry of :attr:`losses`, the friction loss called `name`; None if it was not measured."""
        return self.losses.get(name)

    def theory_beside(self, name: str) -> float | None:
        """Return the gradient called `name` by the closed form for plug flow [Pa/m].

        The result is None if this gradient was not measured, or if the contact laws have no closed form.
        """
        if self.along(name) is None:
            return None
        edges = self.log.stations.edges  # type: ignore[union-attr]
        return layer_gradient(self.scene, edges[-1] if name == "downstream_gradient" else edges[0])

    @property
    def pumped(self) -> bool:
        """True if the run measured a piston pressure in two samples or more, and the piston has moved."""
        return "pressure" in self.series and len(self.series["pressure"]) > 1 and self.series["travel"][-1] > 0

    @property
    def peak(self) -> int:
        """Index of the sample (row of the time series) with the largest pressure on the piston."""
        return int(np.argmax(self.series["pressure"]))

    @property
    def window(self) -> np.ndarray:
        """Mask of the samples whose mean pressure is the final pressure, shape (samples,).

        These samples form the final window, the last fraction WINDOW of the piston's travel. If the piston stops
        between strokes, the window is the last fraction WINDOW of the travel in the last stroke.
        """
        return self.series["travel"] >= self.window_begin

    @property
    def window_begin(self) -> float:
        """Travel of the piston at which the final window, over which results are averaged, begins [m]."""
        travel = self.series["travel"][-1]
        begun = stroke_start(self.scene, travel)
        return begun + (1 - WINDOW) * (travel - begun)

    @property
    def on_plateau(self) -> bool:
        """True if the pressure is on a plateau in the final window.

        The pressure must be level in this window (see :func:`is_level`). The piston must also have moved at its final
        speed throughout the window.
        """
        if not self.pumped:
            return False
        travel, pressure = self.series["travel"], self.series["pressure"]
        if not past_ramp(self.scene, travel[-1]):
            return False
        gone = travel[-1] - stroke_start(self.scene, travel[-1])
        return is_level(travel, pressure, self.window_begin, WINDOW * gone)

    @property
    def restarted(self) -> bool:
        """True if the piston has moved again after the last prescribed stop."""
        pipe = self.scene.pipe
        return self.pumped and pipe is not None and pipe.stops is not None and len(self.peaks) > pipe.stops.count

    @property
    def peaks(self) -> list[float]:
        """Largest pressure of each stroke of the piston [Pa]."""
        return peaks(self.scene.pipe, self.series)

    @property
    def held(self) -> float | None:
        """Mean pressure at the end of the pause before the last stroke [Pa]; None if no sample was taken then."""
        pressure = held(self.scene.pipe, self.series)[-1]
        return pressure if np.isfinite(pressure) else None


def is_level(travel: np.ndarray, pressure: np.ndarray, begin: float, width: float) -> bool:
    """Return whether a pressure stays level while the piston travels from `begin` [m] to the end.

    All three conditions must hold:

    - The mean pressure after `begin` differs from the mean over the travel `width` [m] before `begin` by at most LEVEL
      times the mean after `begin`.
    - The least-squares line through the pressures after `begin` rises or falls by no more than a tolerance. The
      tolerance is LEVEL times the mean, or NOISE times the noise if that is more.
    - The mean over the last quarter of the travel after `begin` differs from the mean after `begin` by no more than the
      same tolerance.

    The noise is the standard deviation of the pressures from the line. It is computed from their median distance to the
    line, so that a few pressures far from the line, such as a jump at the end, do not increase it.
    """
    late, ahead = travel >= begin, (travel >= begin - width) & (travel < begin)
    if not ahead.any() or np.count_nonzero(late) < 2:
        return False
    mean = float(pressure[late].mean())
    x = travel[late] - travel[late].mean()
    slope = float(x @ pressure[late]) / max(float(x @ x), 1e-300)
    noise = MEDIAN * float(np.median(np.abs(pressure[late] - mean - slope * x)))
    change = abs(slope) * float(np.ptp(x))
    last = float(pressure[travel >= begin + 0.75 * (travel[-1] - begin)].mean())
    allowed = max(LEVEL * abs(mean), NOISE * noise)
    level = abs(mean - float(pressure[ahead].mean())) <= LEVEL * abs(mean)
    return level and change <= allowed and abs(last - mean) <= allowed


def stroke_start(scene: Scene, travel: float) -> float:
    """Return the piston's travel [m] at the beginning of the stroke in which it reaches `travel` [m]."""
    return scene.pipe.begun(travel) if scene.pipe is not None else 0.0


def past_ramp(scene: Scene, travel: float) -> bool:
    """Return whether the piston had its final speed throughout the final window of a run that ends at `travel` [m].

    The final window is the last fraction WINDOW of the piston's travel, or of its last stroke if the piston stops
    between strokes.
    """
    return scene.pipe is None or (1 - WINDOW) * (travel - scene.pipe.begun(travel)) >= scene.pipe.ramp


def momentum_balance(known: Known) -> float:
    """Return the relative error of the momentum balance of a run.

    The error is the impulse of walls, driving forces and gravity minus the change of momentum, divided by the largest
    of these impulses. It covers the second half of the run, or all of it for fewer than four samples. It is NaN for one
    sample.
    """
    series = known.series
    last = len(series["time"]) - 1
    if last < 1:
        return float("nan")
    first = (last + 1) // 2 if last >= 3 else 0
    span = series["time"][last] - series["time"][first]
    residual, size = np.zeros(3), np.zeros(3)
    for axis, letter in enumerate("xyz"):
        drive = np.trapezoid(series[f"drive_{letter}"][first:], series["time"][first:])
        wall = [-np.diff(series[f"{w.name}_impulse_{letter}"][[first, last]])[0] for w in known.walls]
        gravity = known.mass * known.scene.gravity[axis] * span
        change = series[f"momentum_{letter}"][last] - series[f"momentum_{letter}"][first]
        residual[axis] = gravity + drive + sum(wall) - change
        size[axis] = max([abs(gravity), abs(drive), *map(abs, wall)])
    return float(np.linalg.norm(residual) / max(np.linalg.norm(size), 1e-300))


def free_energy(series: dict[str, np.ndarray]) -> np.ndarray:
    """Return the energy stored in bodies, contacts and bonds minus the work of walls and driving forces [J].

    Only dissipation changes this difference.
    """
    return sum(series[name] for name in STORED) - series["wall_work"] - series["drive_work"]


def energy_balance(known: Known) -> float | None:
    """Return the relative error of the energy balance of a run.

    The error is the change of the stored energy plus the dissipated energy minus the work done, from the first to the
    last sample. It is divided by the work, the dissipation or the largest energy of motion and springs, whichever is
    largest. The result is None if dissipation was not summed (`Scene.energy_balance`), and NaN if nothing ever moved.
    """
    series = known.series
    if "dissipated_energy" not in series:
        return None
    if len(series["time"]) < 2:
        return float("nan")
    lost = series["dissipated_energy"][-1] - series["dissipated_energy"][0]
    residual = np.diff(free_energy(series)[[0, -1]])[0] + lost
    work = abs(series["wall_work"][-1] + series["drive_work"][-1])
    moving = float(np.max(series["kinetic_energy"] + series["elastic_energy"] + series["bond_energy"]))
    size = max(work, abs(lost), moving)
    return float(residual / size) if size > 0 else float("nan")


def _beside(run: Run, name: str) -> str:
    """Return a text with the published value of the pressure called `name`; empty if the scene has no such value."""
    published = run.scene.published
    value = getattr(published, name) if published else None
    return "" if value is None else f"   ({published.source}: {value / 1e3:.2f} kPa)"


def _peak_words(run: Run) -> str:
    peak, at = number(run.result["peak_pressure"]), number(run.result["peak_travel"])
    return f"{peak / 1e3:.2f} kPa at {at:.3f} m of piston travel{_beside(run, 'peak')}"


def _plateau_words(run: Run) -> str:
    return f"{number(run.result['plateau_pressure']) / 1e3:.2f} kPa{_beside(run, 'plateau')}"


def _gradient_words(name: str):
    def words(run: Run) -> str:
        measured = f"{number(run.result[name]) / 1e3:.3g} kPa/m"
        if f"{name}_theory" not in run.result:
            return measured
        theory = number(run.result[f"{name}_theory"])
        return f"{measured}   (straight pipe by theory, plug flow along the slip layer: {theory / 1e3:.3g})"

    return words


def _middle_words(run: Run) -> str:
    loss = f"{number(run.result['middle_loss']) / 1e3:.3g} kPa"
    # The result `middle_ratio` is missing if the wall stress is not positive at one end of the middle part.
    if "middle_ratio" not in run.result:
        return loss
    return f"{loss}, {run.result['middle_ratio']:.2f} times the loss of an equally long straight pipe next to it"


def no_plateau(run: Run) -> str:
    """Return why the pressure of a run has not reached a plateau; empty if it has, or if no pressure was measured."""
    if "end_pressure" not in run.result or "plateau_pressure" in run.result:
        return ""
    travel, pipe = float(run.series["travel"][-1]), run.scene.pipe
    if past_ramp(run.scene, travel):
        change = f"{100 * LEVEL:.0f} %"
        return (
            f"none: the pressure still changes by more than {change} within a fifth of the travel; move the piston "
            "further"
        )
    if past_ramp(run.scene, pipe.travel):
        return "none: the run was stopped before the piston had moved steadily for long enough"
    gone = travel - pipe.begun(travel)
    return (
        f"none: the last {WINDOW * gone:.3g} m of the travel of {gone:.4g} m must come after the ramp of "
        f"{pipe.ramp:g} m; move the piston {pipe.ramp / (1 - WINDOW):.3g} m or more, or shorten the ramp"
    )


def _moved(run: Run) -> str:
    return "the last stroke" if stroke_start(run.scene, float(run.series["travel"][-1])) > 0 else "the travel"


def _restart_words(run: Run) -> str:
    restart = number(run.result["restart_pressure"])
    steady = number(run.result[_steady(run)])
    return (
        f"{restart / 1e3:.2f} kPa, {restart / steady:.3g} times the pressure at the end; "
        f"first peak {number(run.result['first_peak_pressure']) / 1e3:.2f} kPa"
    )


def _steady(run: Run) -> str:
    return "plateau_pressure" if "plateau_pressure" in run.result else "end_pressure"


def _pumped(of):
    return lambda known: of(known) if known.pumped else None


def _restarted(of):
    return lambda known: of(known) if known.restarted else None


def _level(of):
    return lambda known: of(known) if known.on_plateau else None


ON_PLATEAU = (
    "the piston moves at its final speed throughout the last fifth of its travel and the pressure is level there "
    "('end_pressure' is the mean in any case)"
)
"""Text for users that says when a run has results about the plateau of its pressure."""
WITH_LAYER = (
    "the wall has a slip layer and no friction, and the stones are not single spheres without friction, which roll "
    "along the layer (spheres with little friction may roll, too; the theory is then an upper limit)"
)
"""Text for users that says when a run has a closed form of the friction."""

QUANTITIES = (
    Quantity("peak_pressure", "Pa", _pumped(lambda k: k.series["pressure"][k.peak]), "peak pressure",
             _peak_words, True,
             meaning="Largest pressure on the piston, including the weight of the concrete that it lifts"),
    Quantity("peak_travel", "m", _pumped(lambda k: k.series["travel"][k.peak]),
             meaning="Travel of the piston at the largest pressure"),
    Quantity("plateau_pressure", "Pa", _level(lambda k: k.series["pressure"][k.window].mean()), "plateau pressure",
             _plateau_words, True,
             meaning="Mean pressure on the piston over the last fifth of the travel", only_if=ON_PLATEAU),
    Quantity("plateau_scatter", "Pa", _level(lambda k: k.series["pressure"][k.window].std()),
             meaning="Standard deviation of the pressure over the last fifth of the travel", only_if=ON_PLATEAU),
    Quantity("plateau_from_travel", "m", _level(lambda k: k.series["travel"][k.window][0]),
             meaning="Travel of the piston at which the plateau begins", only_if=ON_PLATEAU),
    Quantity("end_pressure", "Pa", _pumped(lambda k: k.series["pressure"][k.window].mean()), compared=True,
             meaning="Mean pressure on the piston over the last fifth of the travel, level or not"),
    Quantity("first_peak_pressure", "Pa", _restarted(lambda k: k.peaks[0]),
             meaning="Largest pressure before the piston stops"),
    Quantity("held_pressure", "Pa", _restarted(lambda k: k.held), "pressure held at the stop",
             meaning="Pressure that remains on the piston while it stands still"),
    Quantity("restart_pressure", "Pa", _restarted(lambda k: k.peaks[-1]), "peak of the restart", _restart_words, True,
             meaning="Largest pressure after the piston starts again"),
    Quantity("restart_over_end", "1",
             _restarted(lambda k: k.peaks[-1] / k.series["pressure"][k.window].mean()),
             meaning="`restart_pressure` divided by `end_pressure`"),
    Quantity("gradient", "Pa/m", lambda k: k.along("gradient"), "friction", _gradient_words("gradient"), True,
             meaning="Friction per length of a straight pipe, without weight"),
    Quantity("gradient_theory", "Pa/m", lambda k: k.theory_beside("gradient"),
             meaning="Theoretical friction per length of straight pipe, in plug flow along the slip layer",
             only_if=WITH_LAYER),
    Quantity("upstream_gradient", "Pa/m", lambda k: k.along("upstream_gradient"), "friction upstream",
             _gradient_words("upstream_gradient"), True,
             meaning="Friction per length of the straight pipe before the bend, taper or bore, without weight"),
    Quantity("upstream_gradient_theory", "Pa/m", lambda k: k.theory_beside("upstream_gradient"),
             meaning="Theoretical friction per length of the straight pipe before the bend, taper or bore, in plug "
                     "flow along the slip layer",
             only_if=WITH_LAYER),
    Quantity("middle_loss", "Pa", lambda k: k.along("middle_loss"), "bend, taper, bore", _middle_words, True,
             meaning="Friction of the bend, taper or bore, without weight: the difference between the lines fitted "
                     "to the axial stress before and behind this middle part"),
    Quantity("middle_ratio", "1", lambda k: k.along("middle_ratio"), compared=True,
             meaning="`middle_loss` divided by the friction of an equally long straight pipe next to the middle"),
    Quantity("middle_excess", "Pa", lambda k: k.along("middle_excess"), "excess over straight",
             meaning="`middle_loss` minus the friction of an equally long straight pipe next to the middle"),
    Quantity("downstream_gradient", "Pa/m", lambda k: k.along("downstream_gradient"), "friction downstream",
             _gradient_words("downstream_gradient"), True,
             meaning="Friction per length of the straight pipe behind the bend, taper or bore, without weight"),
    Quantity("downstream_gradient_theory", "Pa/m", lambda k: k.theory_beside("downstream_gradient"),
             meaning="Theoretical friction per length of the straight pipe behind the bend, taper or bore, in plug "
                     "flow along the slip layer",
             only_if=WITH_LAYER),
    Quantity("flux_ratio", "1", lambda k: k.along("flux_ratio"), "outflow over inflow",
             lambda run: f"{100 * run.result['flux_ratio']:.0f} %",
             meaning="Volume flow of the aggregates behind the middle, divided by the volume flow before the middle"),
    Quantity("wall_stress", "Pa", lambda k: k.along("wall_stress"),
             meaning="Mean shear stress on the wall of a straight pipe"),
    Quantity("upstream_wall_stress", "Pa", lambda k: k.along("upstream_wall_stress"),
             meaning="Mean shear stress on the wall of the straight pipe before the middle"),
    Quantity("downstream_wall_stress", "Pa", lambda k: k.along("downstream_wall_stress"),
             meaning="Mean shear stress on the wall of the straight pipe behind the middle"),
    Quantity("coordination_number", "1", lambda k: k.contacts.coordination_number,
             meaning="Mean number of contacts of an aggregate at the end"),
    Quantity("largest_overlap", "1", lambda k: k.series["largest_overlap"].max(),
             meaning="Largest overlap of a contact during the run, divided by the radius of the smaller sphere"),
    Quantity("momentum_balance_error", "1", momentum_balance,
             meaning="Relative error of the balance of momentum during the run"),
    Quantity("energy_balance_error", "1", energy_balance,
             meaning="Relative error of the balance of energy during the run"),
    *OF_WEAR,
    *OF_BLOCKAGE,
    *OF_SEGREGATION,
)  # fmt: skip


def quantities() -> tuple[Quantity, ...]:
    """Return the definitions of all results of discrete element runs, including those of the standard tests."""
    return (*of_vessels(), *QUANTITIES)


def _plug_words(run: Run) -> str:
    """Return a phrase with the number of balls in the plug, which recordings show too; empty without such balls."""
    groups = run.bodies.group  # type: ignore[attr-defined]
    balls = sum(group == "plug" for group in groups)
    return f"; recordings show {len(groups)} bodies, with {balls} balls of the plug" if balls else ""


def report(run: Run) -> Iterator[tuple[str, str]]:
    """Yield titles and texts that the summary shows besides results: missing plateau, blockage, wear, packing."""
    if words := no_plateau(run):
        end = number(run.result["end_pressure"])
        yield "plateau pressure", words
        yield "pressure at the end", f"{end / 1e3:.2f} kPa, mean over the last fifth of {_moved(run)}"
    if run.scene.vessel is not None:
        yield from report_unrest(run, run.scene.vessel.test)
    if run.result.get("blocked"):
        yield "BLOCKED", blocked_words(run)
    elif "blockage_window" in run.result:
        yield "blockage", not_blocked_words(run)
    if "segregation" in run.result:
        yield "segregation", segregation_words(run)
    yield from report_wear(run)
    packing = run.packing  # type: ignore[attr-defined]
    if packing:
        yield (
            "packing",
            (
                f"{packing.bodies} aggregates, solid fraction {packing.solid_fraction:.3f}, "
                f"{packing.coordination_number:.1f} neighbours each{_plug_words(run)}"
            ),
        )
