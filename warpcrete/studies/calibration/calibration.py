"""Results of a calibration: its trials, the likeliest parameters, and findings about targets and parameters."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...core.drawing.html import html_table
from ...core.records import Record
from .posterior import Posterior, confounded_pairs, insensitive_targets
from .targets import Target, Task

Outcome = dict[Target, float]
"""Values of the targets in one run; targets without a value are left out."""
UNREACHABLE_DISTANCE = 3.0
"""Distance above which a target counts as unreachable: the difference between the target and the closest value that the
parameters can produce, in standard deviations of the target."""


@dataclass
class Trial:
    """One parameter set with one seed, which is run once in every scene for which the calibration has targets."""

    number: int
    units: list[float]
    """Values of the free parameters, each scaled to 0 to 1 over its range."""
    seed: int
    proof: bool = False
    """True if this trial only verifies the likeliest parameters; its results are not used in the fit."""
    coarse: bool = False
    """True if the flows of this trial were simulated with wider cells than usual, to save time."""
    values: Outcome = field(default_factory=dict)
    failure: str = ""
    """Reason why this trial yielded no value for a fitted target; empty if it yielded all of them."""
    suspect: list[str] = field(default_factory=list)
    """Names of the failed plausibility checks of the trial's runs."""
    doubtful: set[Target] = field(default_factory=set[Target])
    """Targets whose values come from runs that failed checks of their scenes."""


@dataclass(repr=False)
class Calibration:
    """A calibration, complete or still in progress."""

    folder: Path
    task: Task
    record: Record
    trials: list[Trial] = field(default_factory=list)
    posterior: Posterior | None = None
    coarsened: Mapping[str, Mapping[str, Any]] = field(default_factory=dict[str, Any])
    """Parameters that are changed in coarse trials, by the key of each group of targets (:attr:`.Target.key`); empty if
    there are no coarse trials."""
    coarse_posterior: Posterior | None = None
    """Posterior computed from the coarse trials only; it proposes the parameters of the first full trials."""
    settled: bool = False
    """True if the search has converged: further runs would hardly change the posterior."""
    finished: bool = False
    took: float = 0.0
    """Wall time of the last call of the function that ran or resumed the calibration [s]."""
    closed_forms: Outcome = field(default_factory=Outcome)
    """Closed-form predictions for the likeliest parameters, by target; targets without a closed form are left out."""

    def __repr__(self) -> str:
        fitted = ", ".join(f"{name} {value:.4g}" for name, value in self.best.items())
        return f"<Calibration of {len(self.task.free)} parameters: {fitted or 'no answer yet'}, folder '{self.folder}'>"

    def _repr_html_(self) -> str:
        """Return the likeliest parameters as an HTML table for notebooks."""
        rows = [(free.name, f"{self.best[free.name]:.4g}") for free in self.task.free if free.name in self.best]
        return html_table(rows, ["parameter", "likeliest"] if rows else (), repr(self))

    @property
    def best(self) -> dict[str, float]:
        """Likeliest values of the free parameters, by name; empty until a posterior exists."""
        return {} if self.posterior is None else self.task.values(self.posterior.best)

    @property
    def searched(self) -> list[Trial]:
        """Full trials that are used in the fit, without coarse trials and verification runs."""
        return [trial for trial in self.trials if not (trial.proof or trial.coarse)]

    @property
    def guide(self) -> Posterior | None:
        """Posterior that proposes the parameters of the next round; None as long as no posterior has been computed."""
        return self.posterior or self.coarse_posterior

    @property
    def coarse(self) -> list[Trial]:
        """Trials whose flows were simulated with wide cells."""
        return [trial for trial in self.trials if trial.coarse]

    @property
    def verifying(self) -> list[Trial]:
        """Trials that verify the likeliest parameters."""
        return [trial for trial in self.trials if trial.proof]

    def verification_values(self, target: Target) -> list[float]:
        """Return the values of a target in those verification runs that used the current likeliest parameters.

        Verification runs of earlier likeliest parameters are left out.
        """
        last = [trial for trial in self.verifying if trial.units == self.trials[-1].units]
        return [trial.values[target] for trial in last if target in trial.values]

    def off(self, target: Target) -> float:
        """Return the deviation of the calibrated model from a target, in standard deviations of the target.

        The deviation is the simulated minus the measured value. The simulated value is the mean of the verification
        runs; without such runs, the emulator's prediction for the likeliest parameters takes its place. The result is
        NaN if there is neither a verification run nor an emulator.
        """
        assert self.posterior is not None
        runs = self.verification_values(target)
        value = float(np.mean(runs)) if runs else self.posterior.predicted(target, self.posterior.best[None])[0]
        return (value - target.value) / target.uncertainty

    @property
    def findings(self) -> list[str]:
        """Sentences about targets that cannot be reached, parameters that remain undetermined, and runs that failed."""
        if self.posterior is None:
            return []
        posterior, task = self.posterior, self.task
        texts = []
        still = insensitive_targets(posterior, task.fitted)
        for target, (low, high) in still.items():
            names = ", ".join(free.name for free in task.free)
            between = f"{target.words(low)} and {target.words(high)}"
            texts.append(
                f"none of {names} changes the {target.label}: it stays between {between}, but the measured "
                f"value is {target.words(target.value)}"
            )
        for target in task.fitted:
            if target not in still and abs(self.off(target)) > UNREACHABLE_DISTANCE:
                texts.append(
                    f"no parameters within the ranges fit the {target.label} together with the other targets: "
                    f"it is {abs(self.off(target)):.1f} standard deviations off at best"
                )
        for place, free in enumerate(task.free):
            if posterior.relative_width(place) > 0.8:
                texts.append(f"the data do not determine {free.name}: its uncertainty is as large as its range")
        for one, other, correlation in confounded_pairs(posterior):
            way = "increasing one and decreasing the other" if correlation < 0 else "increasing both"
            texts.append(
                f"the data cannot distinguish {one} from {other}: {way} fits as well (correlation {correlation:.2f})"
            )
        for place, free in enumerate(task.free):
            edge = min(posterior.best[place], 1 - posterior.best[place])
            if edge < 0.02:
                texts.append(
                    f"{free.name} = {free.value(posterior.best[place]):.4g} lies at the edge of its range; "
                    "widen the range"
                )
        failed = [trial for trial in self.searched if trial.failure]
        if failed:
            texts.append(
                f"{len(failed)} of {len(self.searched)} trials failed and count as impossible; reason in the "
                f"first: {failed[0].failure}"
            )
        checks = sorted({check for trial in self.searched for check in trial.suspect})
        if checks:
            runs = sum(bool(trial.suspect) for trial in self.searched)
            texts.append(
                f"runs of {runs} of {len(self.searched)} trials fail checks of their scenes "
                f"({', '.join(checks)}); the fit gives their values a further uncertainty, as large as the "
                "target's"
            )
        checks = sorted({check for trial in self.verifying for check in trial.suspect})
        if checks:
            texts.append(
                f"runs of the most likely parameters fail checks of their scenes ({', '.join(checks)}), so do "
                "not rely on this answer; use a smaller 'spacing' or a longer 'duration' in the targets' "
                "parameters"
            )
        if not self.settled:
            texts.append("the search ended before it converged; continue it with more trials")
        return texts
