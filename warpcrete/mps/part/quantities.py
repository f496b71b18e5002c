"""Result quantities of a flow through a part of a pump line."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...core.run.method import Quantity
from ...core.run.run import Run
from ...core.units import number
from .scene import PartScene


@dataclass(frozen=True)
class RunData:
    """Scene and series from which the quantities of a run are computed."""

    scene: PartScene
    series: dict[str, np.ndarray]
    """Time series by column name; each column has two values or more."""

    def final(self, name: str) -> float:
        """Return the last value of a column of the time series, which is the result of the run."""
        return float(self.series[name][-1])

    @property
    def has_middle(self) -> bool:
        """True if the simulated part of the pump line has a bend, a taper or another change of the bore."""
        begin, end = self.scene.middle
        return end > begin

    @property
    def as_straight(self) -> float:
        """Theoretical frictional loss [Pa] of a straight pipe with the length and bores of the middle of this part.

        The middle is the stretch of the part that contains all its bends and tapers.
        """
        return self.scene.friction_loss(*self.scene.middle)


def _weight(scene: PartScene) -> float:
    """Return the pressure that lifts the concrete from the inlet to the outlet [Pa]; negative if the pipe descends."""
    return scene.density * scene.gravity * scene.rise


def _pressure_of_theory(k: RunData) -> float:
    return k.scene.friction_loss(0.0, k.scene.axis.length) + _weight(k.scene)


def _gradient_text(name: str):
    def words(run: Run) -> str:
        ours, theory = number(run.result[name]), number(run.result[f"{name}_theory"])
        return f"{ours / 1e3:.3g} kPa/m   (straight pipe by theory: {theory / 1e3:.3g})"

    return words


def _pressure_text(run: Run) -> str:
    theory = number(run.result["pressure_theory"])
    return f"{number(run.result['pressure']) / 1e3:.4g} kPa   (the whole part as straight pipe: {theory / 1e3:.4g})"


def _friction_text(run: Run) -> str:
    theory = number(run.result["pressure_theory"]) - number(run.result["weight"])
    return f"{number(run.result['friction']) / 1e3:.4g} kPa   (the whole part as straight pipe: {theory / 1e3:.4g})"


def _weight_text(run: Run) -> str:
    added = "" if run.scene.insert is None else ", with the straight pipes before and behind the mesh"
    return (
        f"{number(run.result['weight']) / 1e3:.4g} kPa   (rise {run.scene.rise:.3g} m{added}; gravity "
        f"{run.scene.gravity:g} m/s2)"
    )


def _middle_text(run: Run) -> str:
    result = run.result
    return (
        f"{number(result['middle_loss']) / 1e3:.3g} kPa, {result['middle_ratio']:.3f} times the loss of straight pipe "
        "of the same length and bore"
    )


QUANTITIES = (
    Quantity("pressure", "Pa", lambda k: k.final("pressure"), "pressure", _pressure_text, True,
             meaning="Pressure at the inlet, which balances friction and weight"),
    Quantity("pressure_theory", "Pa", _pressure_of_theory,
             meaning="Theoretical pressure at the inlet if the whole part were straight pipe of the same bore"),
    Quantity("friction", "Pa", lambda k: k.final("pressure") - _weight(k.scene), "due to friction", _friction_text,
             True,
             meaning="Part of the pressure at the inlet that balances friction"),
    Quantity("weight", "Pa", lambda k: _weight(k.scene), "due to weight", _weight_text,
             meaning="Part of the pressure at the inlet that lifts the concrete to the height of the outlet; negative "
                     "if the pipe descends"),
    Quantity("upstream_gradient", "Pa/m", lambda k: k.final("upstream_gradient"), "friction upstream",
             _gradient_text("upstream_gradient"), True,
             meaning="Friction per length of the straight pipe before the bend, taper or bore, without weight"),
    Quantity("upstream_gradient_theory", "Pa/m", lambda k: k.scene.theory(0.0).pressure,
             meaning="Theoretical friction per length of the straight pipe before the bend, taper or bore"),
    Quantity("middle_loss", "Pa", lambda k: k.final("middle_loss") if k.has_middle else None, "bend, taper, bore",
             _middle_text, True,
             meaning="Pressure loss by friction in the bend, taper or bore: the difference between straight lines "
                     "fitted to the pressure before and behind it"),
    Quantity("middle_ratio", "1", lambda k: k.final("middle_loss") / k.as_straight if k.has_middle else None,
             compared=True,
             meaning="`middle_loss` divided by the theoretical loss of straight pipe of the same length and bore"),
    Quantity("middle_excess", "Pa", lambda k: k.final("middle_loss") - k.as_straight if k.has_middle else None,
             "excess over straight",
             meaning="`middle_loss` minus the theoretical loss of straight pipe of the same length and bore"),
    Quantity("downstream_gradient", "Pa/m", lambda k: k.final("downstream_gradient"), "friction downstream",
             _gradient_text("downstream_gradient"), True,
             meaning="Friction per length of the straight pipe behind the bend, taper or bore, without weight"),
    Quantity("downstream_gradient_theory", "Pa/m", lambda k: k.scene.theory(k.scene.axis.length).pressure,
             meaning="Theoretical friction per length of the straight pipe behind the bend, taper or bore"),
    Quantity("outflow_error", "1", lambda k: k.final("outflow_error"),
             meaning="Difference between outflow and inflow, divided by the inflow"),
)  # fmt: skip


def report(run: Run) -> Iterator[tuple[str, str]]:
    """Yield further lines of the report: the loss of each section of the part, and a note if the flow is not steady."""
    parts = run.result.get("parts", ()) if run.scene.parts else ()
    for count, part in enumerate(parts, 1):
        ours, theory = number(part["loss"]), number(part["loss_theory"])
        yield (
            f"part {count}",
            (f"{ours / 1e3:.4g} kPa, {ours / theory:.3f} times the loss of straight pipe   ({part['what']})"),
        )
    if run.finished and not run.result["steady"]:
        yield "not steady", f"the pressure was still changing after {run.series['time'][-1]:.3g} s"
