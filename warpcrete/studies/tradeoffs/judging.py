"""Errors of the settings and of the reference setting of a trade-off study, and bounds for errors in other scenes."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...core.inputs.knobs import Knob
from ...core.run.method import Quantity
from .fronts import Error, difference, distance_to_limit, mean_interval, prediction_bound
from .points import REFERENCE, Setting


class Judging(ABC):
    """Base class of trade-off studies, which computes errors and their bounds from the results of all settings."""

    knobs: list[Knob]
    quantities: list[Quantity]
    exact: bool
    """True if a closed form gives the expected results."""
    record: Mapping[str, Any]
    """Contents of the study's file trade.json. The optional entry `rounding` holds, for each quantity, the relative
    difference between two runs of the same setting that differ only by rounding errors."""
    points: list[Setting]
    tried: list[Setting]
    """Settings that were run in variants of the scene. A variant is the study's scene with some parameters changed that
    are not accuracy parameters."""

    @property
    @abstractmethod
    def seeds(self) -> list[int]:
        """Random seeds with which every setting is run; only 0 if the scene's results do not depend on the seed."""

    @abstractmethod
    def alone(self, knob: Knob, level: int) -> Setting | None:
        """Return the setting in which only `knob` differs from the user's scene, or None if it was not created.

        A knob is a parameter that trades accuracy for run time, and `level` is the index of one of its values.
        """

    @property
    def reference(self) -> Setting | None:
        """Reference setting, in which all accuracy parameters are as fine as the budget allowed.

        The value is None if a closed form serves as the reference.
        """
        return next((point for point in self.points if point.origin == REFERENCE), None)

    def complete(self, point: Setting, seeds: Sequence[int]) -> bool:
        """Return whether a setting has a result for every seed."""
        return not point.failure and all(seed in point.results for seed in seeds)

    def judge(self) -> None:
        """Compute the errors of every setting.

        The expected values come from a closed form if there is one, otherwise from the reference setting.
        """
        for point in self.points:
            point.errors = self.errors_of(point, self.seeds)

    def errors_of(self, point: Setting, seeds: Sequence[int]) -> list[Error]:
        """Return the errors of a setting in its runs with the given seeds, one for each measured quantity."""
        measured_errors = []
        ran = sum(seed in point.results for seed in seeds)
        for each in self.quantities if ran else ():
            values = point.values(each.name, seeds)
            if len(values) < ran:
                # A run gave no value for this quantity, so its error counts as infinite.
                measured_errors.append(Error(each.name, math.inf, 0.0))
            elif self.exact:
                errors = point.values(f"{each.name}_error", seeds)
                mean, half_width = mean_interval(errors)
                measured_errors.append(Error(each.name, mean, half_width))
            elif (finest := self.reference_of(point)) is not None:
                reference = finest.values(each.name, self.seeds)
                if reference:
                    measured_errors.append(difference(each.name, values, reference))
        return measured_errors

    def reference_of(self, point: Setting) -> Setting | None:
        """Return the reference setting with which a setting is compared; None if there is none yet.

        For a run of a variant, this is the reference setting of the same variant.
        """
        if not point.variant or self.reference is None:
            return self.reference
        levels = self.reference.levels
        return next((p for p in self.tried if p.variant == point.variant and p.levels == levels), None)

    def shift(self, knob: Knob, level: int) -> float:
        """Return the error that a knob causes at one of its levels, relative to the finest measured level of this knob.

        A knob is an accuracy parameter such as the time step, and a level is one of its values. The result is the
        largest error of all measured quantities, or infinity if a run failed. A difference that the scatter between
        seeds explains counts as zero, because the difference need not be caused by the knob.
        """
        point = self.alone(knob, level)
        finest = next((p for k in reversed(range(len(knob.levels))) if (p := self.alone(knob, k)) is not None
                       and self.complete(p, self.seeds)), None)  # fmt: skip
        if point is None or finest is None or not point.results or point.failure:
            return math.inf
        found = []
        for each in self.quantities:
            values, reference = (p.values(each.name, self.seeds) for p in (point, finest))
            if len(values) < len(self.seeds) or len(reference) < len(self.seeds):
                return math.inf
            error = difference(each.name, values, reference)
            found.append(0.0 if error.within_scatter else error.size)
        return max(found)

    @property
    def reference_errors(self) -> dict[str, float]:
        """Estimated relative error of the reference setting's own results, by the name of the quantity.

        The results at all measured widths of cells, or distances of particles, are extrapolated to the width 0. The
        error is the difference of the reference result from this limit. If the effect of rounding errors is known, the
        two errors are combined as the square root of the sum of their squares. The result is empty if there is no
        reference setting, or if no accuracy parameter is a width or distance.
        """
        knobs = [knob for knob in self.knobs if knob.resolution]
        if self.reference is None or not knobs:
            return {}
        found = {}
        for each in self.quantities:
            reference = self.reference.values(each.name, self.seeds)
            errors = [distance_to_limit(*self._converging(knob, each.name), float(np.mean(reference)))
                      for knob in knobs if reference]  # fmt: skip
            rounding = self.record.get("rounding", {}).get(each.name, 0.0)
            found[each.name] = math.hypot(max(errors, default=math.inf), rounding)
        return found

    def _converging(self, knob: Knob, quantity: str) -> tuple[list[float], list[float]]:
        """Return the measured values of a knob, and the mean of a result quantity at each of them.

        A knob is a parameter that trades accuracy for run time. The values are those with a result for every seed, in
        runs that change no other knob.
        """
        widths, means = [], []
        for number, level in enumerate(knob.levels):
            point = self.alone(knob, number)
            if point is not None and self.complete(point, self.seeds):
                (width,), values = level.changes.values(), point.values(quantity, self.seeds)
                if values:
                    widths.append(float(str(width)))
                    means.append(float(np.mean(values)))
        return widths, means

    def promised(self, point: Setting) -> float:
        """Return an upper bound for the error of a setting.

        The bound is the error of the reference setting plus the larger of two values. The first value is the measured
        error with its confidence interval. The second value is the sum of the errors that were measured when only one
        knob (accuracy parameter) was changed at a time; the sum covers all knobs that the setting changes. The sum is
        considered because errors that cancel in this scene need not cancel in another one.
        """
        if point.worst is None:
            return math.inf
        by_name = {knob.name: knob for knob in self.knobs}
        alone = sum(self.shift(by_name[name], k) for name, k in point.levels.items())
        return max(point.worst.bound, alone) + max(self.reference_errors.values(), default=0.0)

    def bound_in_variants(self, point: Setting, variants: Sequence[Setting]) -> float:
        """Return a bound for a setting's errors in other scenes, estimated from its errors in `variants` of the scene.

        The errors of a quantity in the original scene and in its variants are treated as a random sample, which gives a
        95 % prediction interval for the error in another, similar scene. The result is the largest bound of all
        quantities, plus the error of the reference setting.
        """
        found = []
        for each in self.quantities:
            errors = [e for p in (point, *variants) for e in self.errors_of(p, self.seeds) if e.quantity == each.name]
            found.append(prediction_bound([e.shift for e in errors]))
        return max(found) + max(self.reference_errors.values(), default=0.0)
