"""A trade: settings of a scene, what their runs came to, what they cost and err by."""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..core.device import find_device
from ..core.errors import InstabilityError, SceneError, WarpcreteError
from ..core.files import read_json
from ..core.interrupts import StopAtSample
from ..core.knobs import Knob
from ..core.method import Quantity
from ..core.parameters import declared_fields
from ..core.run_loop import Run
from ..core.units import number
from ..methods import Simulation, method_of
from ..record.checks import failed_checks
from ..record.recorders import recorders_of
from .cases import word_of
from .fronts import Error, difference, next_within, worst

FAILED = "failed.txt"
TARGETS = (0.2, 0.1, 0.05, 0.02, 0.01)
"""Errors for which settings are sought."""
GIVEN, REFERENCE, COMBINED, CARRIED = "as given", "finest", "combined", "carried"
"""Where a point comes from, besides a knob."""
Tell = Callable[[str, float, dict[str, Any]], None]


@dataclass
class Point:
    """One setting of the scene, and what its runs came to."""

    origin: str
    """A knob's name, or one of the words above."""
    levels: dict[str, int]
    """Level of each knob that is not as the scene has it."""
    parameters: dict[str, Any]
    """All that the scene function is given, without the seed."""
    results: dict[int, dict[str, Any]] = field(default_factory=dict)
    """result.json by seed (0 where there are no seeds)."""
    failure: str = ""
    """What ended a run, or why there is none."""
    errors: list[Error] = field(default_factory=list)
    converted: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Quantities of another meaning here: (offset, factor), as :class:`warpcrete.core.knobs.Level` has them."""
    variant: str = ""
    """In what the scene differs from that of the trade; empty if in nothing."""
    full: dict[str, Any] = field(default_factory=dict)
    """All parameters that mean something, defaults included."""

    def values(self, quantity: str, seeds: Sequence[int]) -> list[float]:
        """A quantity of the runs with these seeds."""
        found = [number(self.results[s][quantity]) for s in seeds if self.results.get(s, {}).get(quantity) is not None]
        offset, factor = self.converted.get(quantity, (0.0, 1.0))
        return [offset + factor * (value - offset) for value in found]

    @property
    def cost(self) -> float:
        """Median wall time of a run, packing and settling included [s]; NaN without one."""
        parts = ("packing_time", "settling_time", "wall_time")
        times = [sum(number(r["speed"][p]) for p in parts if p in r["speed"]) for r in self.results.values()]
        return float(np.median(times)) if times else math.nan

    @property
    def work(self) -> float:
        """Sphere-steps or particle-steps of a run, whatever the machine; NaN without one."""
        counts = [float(r["steps"]) * (r.get("spheres") or r["particles"]) for r in self.results.values()]
        return float(np.median(counts)) if counts else math.nan

    @property
    def memory(self) -> float:
        """What a run takes on the device at its end [B]; NaN without one."""
        taken = [number(r["speed"]["memory"]) for r in self.results.values() if "memory" in r["speed"]]
        return float(np.median(taken)) if taken else math.nan

    @property
    def worst(self) -> Error | None:
        """The largest error of the quantities."""
        return worst(self.errors)

    @property
    def suspect(self) -> list[str]:
        """Checks that a run failed."""
        return sorted({name for result in self.results.values() for name in failed_checks(result)})


@dataclass(frozen=True)
class Promise:
    """The cheapest setting found for a wanted error, and how it did with fresh seeds."""

    target: float
    point: Point | None
    found: Error | None = None
    """With seeds of its own; None where there was no time for them, or there are no seeds."""
    carried: dict[str, Error | None] = field(default_factory=dict)
    """Largest error in each variant of the scene that it was tried on, by what that is and which checks it fails; None
    where it does not run."""
    bound: float = math.inf
    """What is promised."""


class Trade:
    """A trade, finished or as far as the budget went."""

    def __init__(self, folder: Path, module: Any, record: Mapping[str, Any]) -> None:
        self.folder, self.module, self.record = folder, module, record
        self.scene_name: str = record["scene"]
        self.base: dict[str, Any] = dict(record["parameters"])
        if module.trading.tolerance:  # a setting may be as far off as anybody could want
            self.base.setdefault(module.trading.tolerance, TARGETS[0])
        self.repeat: int = record["repeat"]
        self.device: str = record["device"]
        self.threads: int = record["threads"]
        given = self.declared = module.scene.parameters(**self.base)
        self.has_seeds = bool(record["seeded"])
        self.first_seed = int(self.base.pop("seed", 0))
        self.knobs = [knob for knob in module.trading.knobs(given) if knob.name in record["knobs"]]
        self.exact: bool = module.trading.closed_form(given)
        known = {each.name: each for each in method_of(module.scene(**self.base)).quantities}
        self.quantities: list[Quantity] = [known[name] for name in record["quantities"]]
        self.points: list[Point] = []
        self.tried: list[Point] = []
        """In variants of the scene."""
        self.promises: list[Promise] = []
        self.spent = 0.0
        self.budget = math.inf
        self.interrupted = False
        self.gap = StopAtSample([])
        """Hears a Ctrl-C between runs."""

    def __repr__(self) -> str:
        done = sum(bool(point.results) for point in self.points)
        return (
            f"<Trade of scene {self.scene_name!r}: {done} of {len(self.points)} settings run, folder '{self.folder}'>"
        )

    # What there is.

    @property
    def machine(self) -> str:
        """What times were measured on."""
        found = self.record["provenance"]
        if find_device(self.device).is_cuda:
            return found["device_name"]
        return f"{found.get('processor') or 'a CPU'}, {self.threads} thread{'s' if self.threads > 1 else ''}"

    @property
    def given(self) -> Point:
        """The scene as it is given."""
        return self.points[0]

    @property
    def chosen_knobs(self) -> list[Knob]:
        """Of which settings for a wanted accuracy are made."""
        return [knob for knob in self.knobs if knob.chosen]

    @property
    def seeds(self) -> list[int]:
        """Of every setting's runs."""
        return list(range(self.first_seed, self.first_seed + self.repeat)) if self.has_seeds else [0]

    @property
    def reference(self) -> Point | None:
        """All knobs as fine as the budget allowed; None where a closed form is the reference."""
        return next((point for point in self.points if point.origin == REFERENCE), None)

    @property
    def measured(self) -> list[Point]:
        """Points that have a cost and an error."""
        return [p for p in self.points if self.complete(p, self.seeds) and p.worst is not None
                and math.isfinite(p.worst.bound)]  # fmt: skip

    def label(self, point: Point) -> str:
        """What a point differs by from the scene as given."""
        parts = [f"{knob.name} {knob.levels[point.levels[knob.name]].label}" for knob in self.knobs
                 if knob.name in point.levels]  # fmt: skip
        return ", ".join(parts) or GIVEN

    def keys_of(self, point: Point) -> dict[str, str]:
        """Levels of a point as they are called in scenes of any numbers."""
        chosen = {knob.name: knob.levels[point.levels[knob.name]] for knob in self.knobs if knob.name in point.levels}
        return {name: level.key or level.label for name, level in chosen.items()}

    # Points.

    def point(self, origin: str, levels: Mapping[str, int]) -> Point:
        """The point of these levels; one that is there already by its parameters is that one."""
        changes: dict[str, Any] = {}
        converted: dict[str, tuple[float, float]] = {}
        for knob in self.knobs:
            if knob.name in levels:
                changes |= knob.levels[levels[knob.name]].changes
                converted |= knob.levels[levels[knob.name]].converted
        parameters = self.module.scene.meaningful({**self.base, **changes})
        full = self._full(parameters)
        if (found := self._with(full)) is not None:
            return found
        differing = {name: k for name, k in levels.items() if self._differs(name, k)}
        self.points.append(Point(origin, differing, parameters, converted=converted, full=full))
        return self.points[-1]

    def carried(self, point: Point, variant: str, changes: Mapping[str, Any]) -> Point:
        """The settings of a point in a variant of the scene; knobs go by what their levels are called there."""
        base = {**self.base, **changes}
        knobs = {knob.name: knob for knob in self.module.trading.knobs(self.module.scene.parameters(**base))}
        for name, key in self.keys_of(point).items():
            level = knobs[name].level_of(key) if name in knobs else None
            base |= level.changes if level else {}
        parameters = self.module.scene.meaningful(base)
        same = [p for p in self.tried if p.variant == variant and p.parameters == parameters]
        if not same:
            same = [Point(CARRIED, point.levels, parameters, variant=variant)]
            self.tried += same
        return same[0]

    def _with(self, full: Mapping[str, Any]) -> Point | None:
        return next((point for point in self.points if point.full == full), None)

    def _full(self, parameters: Mapping[str, Any]) -> dict[str, Any]:
        """All parameters that mean something, defaults included."""
        defaults = {name: found.default for name, found in declared_fields(self.module.scene.parameters).items()}
        return self.module.scene.meaningful({**defaults, **parameters})

    def _differs(self, name: str, level: int) -> bool:
        (knob,) = [each for each in self.knobs if each.name == name]
        as_given = self._full(self.base)
        return any(as_given.get(key) != value for key, value in knob.levels[level].changes.items())

    def ratio(self, knob: Knob, level: int) -> float:
        """Time of a level over that of the scene as given: measured, or else as expected."""
        alone = self._alone(knob, level)
        if alone is not None and math.isfinite(alone.cost) and not alone.failure and self.given.cost > 0:
            return alone.cost / self.given.cost
        return knob.levels[level].cost / knob.levels[self.level_as_given(knob)].cost

    def _alone(self, knob: Knob, level: int) -> Point | None:
        return self._with(self._full(self.module.scene.meaningful({**self.base, **knob.levels[level].changes})))

    def level_as_given(self, knob: Knob) -> int:
        """Place of the level that the scene has; the finest where it has none of them."""
        same = [k for k in range(len(knob.levels)) if not self._differs(knob.name, k)]
        return same[0] if same else len(knob.levels) - 1

    def expected(self, point: Point) -> float:
        """Time of one run of a point [s]."""
        if math.isfinite(point.cost):
            return point.cost
        by_name = {knob.name: knob for knob in self.knobs}
        return self.given.cost * math.prod(self.ratio(by_name[name], k) for name, k in point.levels.items())

    # Runs.

    def run(self, point: Point, seeds: Sequence[int], tell: Tell, until: float = 1.0) -> bool:
        """Run what a point lacks; False if `until` of the budget does not reach, a run failed, or it was stopped."""
        for seed in seeds:
            if seed in point.results or point.failure:
                continue
            folder = self._folder(point, seed)
            if self._known(point, seed, folder):
                continue
            if self.interrupted or self.gap.asked:
                self.interrupted = True
                return False
            left = until * self.budget - self.spent
            if not (point is self.given and not point.results) and self.expected(point) > left:
                if not point.results:
                    point.failure = f"not run: takes some {self.expected(point):.2g} s, {max(left, 0):.2g} s were left"
                return False
            begun = time.perf_counter()
            tell(f"{self.label(point)} {point.variant}".strip(), min(self.spent / self.budget, 1.0), {})
            self._run(point, seed, folder)
            self.spent += time.perf_counter() - begun
        return self.complete(point, seeds)

    def complete(self, point: Point, seeds: Sequence[int]) -> bool:
        """Every run is there."""
        return not point.failure and all(seed in point.results for seed in seeds)

    def _folder(self, point: Point, seed: int) -> Path:
        changed = {k: v for k, v in sorted(point.parameters.items()) if self.base.get(k, ...) != v}
        words = "-".join(f"{name}={word_of(value)}" for name, value in changed.items()) or "given"
        words = "-".join([*point.variant.split(), words])
        return self.folder / "runs" / (f"{words}-seed={seed}" if self.has_seeds else words)

    def _known(self, point: Point, seed: int, folder: Path) -> bool:
        if (folder / FAILED).is_file():
            point.failure = (folder / FAILED).read_text().strip()
            return True
        if (folder / "result.json").is_file():
            result = read_json(folder / "result.json")
            if result.get("finished") and "checks" in result:
                point.results[seed] = result
                return True
        if folder.exists():
            shutil.rmtree(folder)
        return False

    def _simulation(self, point: Point, seed: int, **settings: Any) -> Simulation:
        scene = self.module.scene(**point.parameters, **({"seed": seed} if self.has_seeds else {}))
        return Simulation(scene, device=self.device, precision=scene.precision, threads=self.threads, **settings)

    def _run(self, point: Point, seed: int, folder: Path) -> None:
        try:
            if len(self.seeds) < 3 and not point.results and not point.variant:
                # One run of few, of which the median is no help, would be charged for loading kernels.
                warm = self._simulation(point, seed)
                warm.prepare()
                warm.stepper.take(1)
                warm.release()
            simulation = self._simulation(point, seed, recorders=recorders_of(folder, self.module.check, {}))
            scene = simulation.scene
            with StopAtSample([simulation]) as stop:
                (outcome,) = method_of(scene).run_many([simulation], [None], lambda phase, fraction: None)
            self.interrupted |= stop.asked
        except (WarpcreteError, KeyboardInterrupt) as error:
            outcome = error
        if isinstance(outcome, Run) and outcome.finished:
            point.results[seed] = read_json(folder / "result.json")
        elif isinstance(outcome, InstabilityError | SceneError):
            point.failure = f"failed: {outcome}"
            folder.mkdir(parents=True, exist_ok=True)
            (folder / FAILED).write_text(f"{point.failure}\n")
        elif isinstance(outcome, Run | KeyboardInterrupt):
            self.interrupted = True
        else:
            raise outcome

    # Errors.

    def judge(self) -> None:
        """Errors of all points, against the closed form or the reference."""
        for point in self.points:
            point.errors = self.errors_of(point, self.seeds)

    def errors_of(self, point: Point, seeds: Sequence[int]) -> list[Error]:
        """Errors of the runs of a point with some seeds."""
        found = []
        ran = sum(seed in point.results for seed in seeds)
        for each in self.quantities if ran else ():
            values = point.values(each.name, seeds)
            if len(values) < ran:
                found.append(Error(each.name, math.inf, 0.0))  # a run without it: it is no property of the setting
            elif self.exact:
                errors = point.values(f"{each.name}_error", seeds)
                scatter = float(np.std(errors)) if len(errors) > 1 else 0.0
                found.append(Error(each.name, float(np.mean(errors)), scatter))
            elif self.reference is not None:
                reference = self.reference.values(each.name, self.seeds)
                if reference:
                    found.append(difference(each.name, values, reference))
        return found

    def shift(self, knob: Knob, level: int) -> float:
        """Largest error of a level alone against the knob's finest level that ran; infinite where it failed.

        What seeds alone explain counts as none: it is no error of the knob, and would add up over all knobs.
        """
        point = self._alone(knob, level)
        finest = next((p for k in reversed(range(len(knob.levels))) if (p := self._alone(knob, k)) is not None
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

    def promised(self, point: Point) -> float:
        """What a point errs by at most: as measured, interval included, or all its knobs' errors together.

        Whichever is more: errors that cancel in this scene do not in the next.
        """
        if point.worst is None:
            return math.inf
        by_name = {knob.name: knob for knob in self.knobs}
        alone = sum(self.shift(by_name[name], k) for name, k in point.levels.items())
        return max(point.worst.bound, alone)

    def carried_bound(self, point: Point, variants: Sequence[Point]) -> float:
        """What a point errs by in a scene that is as far from that of the trade as the variants are.

        95 % prediction interval of the next error, from those of the point and its variants.
        """
        found = []
        for each in self.quantities:
            errors = [e for p in (point, *variants) for e in self.errors_of(p, self.seeds) if e.quantity == each.name]
            found.append(next_within([e.shift for e in errors]))
        return max(found)
