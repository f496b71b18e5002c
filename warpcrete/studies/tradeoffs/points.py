"""Settings tried in a trade-off study, the results of their runs, and the error bound promised for the best of them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from ...core.records import Record, SceneArguments
from ...core.units import number
from ...record.checks import failed_checks
from .fronts import Error, worst

WANTED_ERRORS = (0.2, 0.1, 0.05, 0.02, 0.01)
"""Error limits (relative errors) that users may require. For each one, a study looks for the cheapest setting within
this limit."""
GIVEN, REFERENCE, COMBINED, CARRIED = "as given", "finest", "combined", "carried"
"""Origins of those settings of a trade-off study that do not just change a single accuracy parameter. In this order,
they are the user's scene, the finest setting that the budget allows, a combination of several changed parameters, and
a setting that is repeated in a variant of the scene."""


@dataclass
class Setting:
    """One choice of values for the accuracy parameters of a scene, and the results of its runs."""

    origin: str
    """Name of the accuracy parameter that differs from the user's scene, if it is the only one. Otherwise one of these
    words: "as given" (the user's scene), "finest" (all accuracy parameters as fine as the budget allows), "combined"
    (several parameters changed), or "carried" (a setting repeated in a variant of the scene)."""
    levels: dict[str, int]
    """Index of the level (value) of each accuracy parameter that differs from the user's scene, by the parameter's
    name."""
    parameters: SceneArguments
    """All keyword arguments of the scene function, without the seed."""
    results: dict[int, Record] = field(default_factory=dict)
    """Contents of result.json by seed; the key is 0 if the scene has no seeds."""
    failures: dict[int, str] = field(default_factory=dict)
    """Errors that ended runs, by seed. These runs are not repeated."""
    left_out: str = ""
    """Reason why the setting was not run; empty if it was run. A resumed study may run it."""
    errors: list[Error] = field(default_factory=list)
    converted: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Conversions that make results of runs with this setting comparable with results of the user's scene, by the
    name of the quantity. A pipe of half the length, for example, needs about half the pressure. A conversion is a pair
    (offset, factor); it replaces a value by offset + factor * (value - offset)."""
    variant: str = ""
    """Description of the variant, which is the trade-off study's scene with some parameters changed; empty for the
    scene itself."""
    full: SceneArguments = field(default_factory=dict)
    """All parameters that have an effect on the scene, including those with default values."""
    timed: bool = True
    """True if the wall time in the results was measured. If it is only an estimate, the setting is not recommended."""

    def values(self, quantity: str, seeds: Sequence[int]) -> list[float]:
        """Return the values of a result quantity in the runs with the given seeds.

        If an accuracy parameter of this setting changes the meaning of the quantity, as a shorter pipe changes the
        meaning of its pressure, the values are converted to the user's scene (:attr:`converted`).
        """
        found = [number(self.results[s][quantity]) for s in seeds if self.results.get(s, {}).get(quantity) is not None]
        offset, factor = self.converted.get(quantity, (0.0, 1.0))
        return [offset + factor * (value - offset) for value in found]

    @property
    def failure(self) -> str:
        """Message of the failed run with the lowest seed, or the reason why no run was made; empty without failure."""
        return self.failures[min(self.failures)] if self.failures else self.left_out

    @property
    def cost(self) -> float:
        """Median wall time of a run, including packing and settling [s]; NaN without a run."""
        parts = ("packing_time", "settling_time", "wall_time")
        times = [sum(number(r["speed"][p]) for p in parts if p in r["speed"]) for r in self.results.values()]
        return float(np.median(times)) if times else math.nan

    @property
    def work(self) -> float:
        """Median cost of a run: number of time steps times number of spheres (or particles); NaN without a run.

        This measure of cost does not depend on the machine.
        """
        counts = [float(r["steps"]) * (r.get("spheres") or r["particles"]) for r in self.results.values()]
        return float(np.median(counts)) if counts else math.nan

    @property
    def memory(self) -> float:
        """Device memory that a run occupies at its end [B], as the median over the runs; NaN without a run."""
        taken = [number(r["speed"]["memory"]) for r in self.results.values() if "memory" in r["speed"]]
        return float(np.median(taken)) if taken else math.nan

    @property
    def worst(self) -> Error | None:
        """Error of the quantity whose error has the largest upper bound; None if no errors are known."""
        return worst(self.errors)

    @property
    def suspect(self) -> list[str]:
        """Names of the plausibility checks that at least one run failed."""
        return sorted({name for result in self.results.values() for name in failed_checks(result)})


@dataclass(frozen=True)
class Promise:
    """The cheapest setting found within one error limit, and the result of its test with new random seeds."""

    target: float
    point: Setting | None
    found: Error | None = None
    """Error in runs with new random seeds; None if the scene has no seeds or the time ran out."""
    carried: dict[str, Error | None] = field(default_factory=dict)
    """Largest error in each variant of the scene, by the description of the variant; None if the run of the variant
    failed. A variant is the scene with some parameters changed. If a run failed plausibility checks, the description
    lists them."""
    bound: float = math.inf
    """Promised upper bound of the relative error of all result quantities, as a fraction; infinite if no setting is
    promised."""
