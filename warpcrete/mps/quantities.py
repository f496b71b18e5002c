"""Result quantities of a pipe flow, with their units and the values that theory gives."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..core.run.method import Quantity
from ..core.run.run import Run
from ..core.units import number, shown
from ..theory.pipe import Steady
from .common.run import largest
from .scene import FluidScene

AVERAGED_FRACTION = 0.2
"""If the scene states a duration, quantities are averaged over this last fraction of the simulated time. A run without
a stated duration ends when the flow is steady, and its quantities are taken from the last row of the time series.
"""
THEORY_COLUMNS = ("pressure", "slip_velocity", "wall_stress")
"""Columns of the time series for which theory gives a value."""
UNITS = {"pressure": "Pa", "slip_velocity": "m/s", "wall_stress": "Pa"}
MEANINGS = {
    "pressure": "Pressure on the piston, or pressure difference over the stretch; includes the weight of the concrete "
    "unless `gravity` is 0",
    "slip_velocity": "Velocity of the concrete at the wall",
    "wall_stress": "Mean shear stress on the wall",
}


@dataclass(frozen=True)
class RunData:
    """Scene, time series and theoretical steady state of a flow, from which its result quantities are computed."""

    scene: FluidScene
    series: dict[str, np.ndarray]
    """Columns of the time series by name, each with at least two values."""
    theory: Steady

    @property
    def chosen(self) -> np.ndarray:
        """Boolean mask of the rows of the time series over which quantities are averaged."""
        time = self.series["time"]
        if self.scene.duration is None:
            return np.arange(len(time)) == len(time) - 1
        return time >= time[-1] * (1 - AVERAGED_FRACTION)

    def mean(self, name: str) -> float:
        """Return the mean of a column of the time series over the rows that the mask `chosen` selects."""
        return float(self.series[name][self.chosen].mean())

    @property
    def friction(self) -> float:
        """Loss of pressure per length by friction on the wall, without the weight of the concrete [Pa/m]."""
        return self.scene.friction(self.mean("wall_stress"))

    def by_theory(self, name: str) -> float:
        """Return the value that theory predicts for a quantity."""
        return float(getattr(self.theory, name))

    def error(self, name: str) -> float:
        """Return the error of the mean of a column of the time series, divided by the value of theory.

        The error of the slip velocity is divided by the mean velocity of the flow instead, because the slip velocity
        may be near zero.
        """
        size = self.scene.velocity if name == "slip_velocity" else self.by_theory(name)
        return (self.mean(name) - self.by_theory(name)) / size


def expected(scene: FluidScene) -> dict[str, float]:
    """Return pressure, slip velocity, wall stress and friction that theory predicts for the steady flow, by name."""
    theory = scene.theory()
    predictions = {name: float(getattr(theory, name)) for name in UNITS}
    return predictions | {"gradient": scene.friction(theory.wall_stress)}


def _beside_theory(name: str):
    def words(run: Run) -> str:
        factor, unit = shown(UNITS[name])
        ours, theory = (number(run.result[key]) * factor for key in (name, f"{name}_theory"))
        error = 100 * run.result[f"{name}_error"]
        weight = run.scene.weight * factor if name == "pressure" else 0.0
        with_weight = f" with {weight:.4g} {unit} of weight" if weight else ""
        return f"{ours:.4g} {unit}{with_weight}   (theory, {run.result['theory']}: {theory:.4g}; {error:+.2f} %)"

    return words


def _of_column(name: str) -> tuple[Quantity, ...]:
    compared, label = name != "wall_stress", "" if name == "wall_stress" else name.replace("_", " ")
    divisor = "the mean velocity" if name == "slip_velocity" else "the latter"
    return (
        Quantity(name, UNITS[name], lambda k: k.mean(name), label, _beside_theory(name), compared,
                 meaning=MEANINGS[name]),
        Quantity(f"{name}_theory", UNITS[name], lambda k: k.by_theory(name), compared=name == "pressure",
                 meaning=f"Value of `{name}` by theory"),
        Quantity(f"{name}_error", "1", lambda k: k.error(name), compared=compared,
                 meaning=f"`{name}` minus its value by theory, divided by {divisor}"),
    )  # fmt: skip


def _friction_text(run: Run) -> str:
    ours = f"{number(run.result['gradient']) / 1e3:.4g} kPa/m without the weight of the concrete"
    # A result that an earlier version of the program has written lacks this entry.
    if "gradient_theory" not in run.result:
        return ours
    return f"{ours}   (theory: {number(run.result['gradient_theory']) / 1e3:.4g})"


def _restarted(of):
    return lambda known: of(known) if known.scene.gained else None


def _restart_text(run: Run) -> str:
    peak, whole = (number(run.result[name]) / 1e3 for name in ("restart_pressure", "restart_pressure_theory"))
    return (
        f"{peak:.4g} kPa, {run.result['restart_over_steady']:.3g} times the steady pressure by theory   (theory for "
        f"unbroken structure: {whole:.4g})"
    )


QUANTITIES = (
    *(quantity for name in THEORY_COLUMNS for quantity in _of_column(name)),
    Quantity("gradient", "Pa/m", lambda k: k.friction, "friction", _friction_text, True,
             meaning="Friction per length, without the weight of the concrete"),
    Quantity("gradient_theory", "Pa/m", lambda k: k.scene.friction(k.by_theory("wall_stress")), compared=True,
             meaning="Friction per length by theory, without the weight of the concrete"),
    Quantity("restart_pressure", "Pa", _restarted(lambda k: k.series["pressure"].max()), "peak of the restart",
             _restart_text, True,
             meaning="Largest pressure after the rest, with the weight of the concrete"),
    Quantity("restart_pressure_theory", "Pa", _restarted(lambda k: k.scene.restart().pressure),
             meaning="Theoretical pressure directly after the rest, before flow breaks the thixotropic structure"),
    Quantity("restart_over_steady", "1", _restarted(lambda k: k.series["pressure"].max() / k.theory.pressure),
             meaning="`restart_pressure` divided by the theoretical steady pressure"),
    Quantity("profile_error", "1", lambda k: k.mean("profile_deviation") / k.scene.velocity, "profile",
             lambda run: f"rms deviation from theory {100 * run.result['profile_error']:.2f} % of the mean velocity",
             True,
             meaning="Root mean square deviation of the velocity profile from theory, divided by the mean velocity"),
    Quantity("volume_error", "1", lambda k: largest(k.series["volume_error"]),
             meaning="Largest relative change of the volume of the concrete"),
    Quantity("force_balance_error", "1", lambda k: k.mean("force_balance_error"),
             meaning="Driving force minus weight, wall friction and inertia, divided by the driving force"),
)  # fmt: skip


def report(run: Run) -> Iterator[tuple[str, str]]:
    """Yield further lines of the report: the values of Xu, Li & Jiang 2021, and a note if the flow is not steady."""
    if run.scene.published and "pressure" in run.result:
        for name, value in run.scene.published.items():
            factor, unit = shown(UNITS[name])
            yield f"{name.replace('_', ' ')}, Xu", f"{value * factor:.4g} {unit} printed (Xu, Li & Jiang 2021)"
    if run.finished and not run.result["steady"]:
        yield (
            "not steady",
            (f"pressure, wall stress or slip velocity was still changing at {run.series['time'][-1]:.3g} s"),
        )
