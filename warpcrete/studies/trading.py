"""A trade: settings of a scene, what their runs came to, what they cost and err by."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import InstabilityError, SceneError, WarpcreteError
from ..core.files import read_json
from ..core.interrupts import StopAtSample
from ..core.knobs import Knob
from ..core.method import Quantity
from ..core.parameters import declared_fields
from ..core.run_loop import Run
from ..methods import Simulation, method_of
from ..record.recorders import recorders_of
from .cases import Case, word_of
from .cluster import Cluster, WorkerLost
from .fronts import Error, difference, next_within
from .points import CARRIED, GIVEN, REFERENCE, TARGETS, Point, Promise
from .running import FAILED, kept
from .trials import FEW, Trial, run_trial, warm_up

COMMAND = {"frames": 25.0, "checkpoint_every": 0.0}
"""How workers record: no frames are drawn, and a run that was cut is made again, or its time would not be one."""
Tell = Callable[[str, float, dict[str, Any]], None]


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
        given = self.declared = module.scene.declared(self.base)
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
        self.cluster: Cluster | None = None
        """Workers that make the runs."""

    def __repr__(self) -> str:
        done = sum(bool(point.results) for point in self.points)
        return (
            f"<Trade of scene {self.scene_name!r}: {done} of {len(self.points)} settings run, folder '{self.folder}'>"
        )

    # What there is.

    @property
    def machine(self) -> str:
        """What times were measured on."""
        if self.device.startswith("cuda"):
            return self.hardware
        return f"{self.hardware}, {self.threads} thread{'s' if self.threads > 1 else ''}"

    @property
    def hardware(self) -> str:
        """The GPU or CPU by its model."""
        found = self.record["provenance"]
        return found["device_name"] if self.device.startswith("cuda") else found.get("processor") or "a CPU"

    @property
    def abreast(self) -> int:
        """Runs that are made at a time, each on a worker of its own."""
        return 1 if self.cluster is None else self.cluster.count

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

    def rounds(self, runs: int) -> int:
        """How often the time of a run passes until so many are made."""
        return math.ceil(runs / self.abreast)

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
        knobs = {knob.name: knob for knob in self.module.trading.knobs(self.module.scene.declared(base))}
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
        return self.module.scene.meaningful({**defaults, **self.module.scene.completed(parameters)})

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
        self.run_all([point], seeds, tell, until)
        return self.complete(point, seeds)

    def run_all(self, points: Sequence[Point], seeds: Sequence[int], tell: Tell, until: float = 1.0) -> None:
        """Run what points lack, in their order, as far as `until` of the budget reaches; on workers side by side."""
        lacking = [(point, left) for point in points if (left := self._take_over(point, seeds))]
        if self.cluster is None:
            for point, (seed, *_), _ in self._due(lacking, tell, until):
                begun = time.perf_counter()
                self._run(point, seed, self._folder(point, seed))
                self.spent += time.perf_counter() - begun
        elif lacking:
            self._run_on(self.cluster, self._due(lacking, tell, until))

    def _take_over(self, point: Point, seeds: Sequence[int]) -> list[int]:
        """Use the runs of a point that are there; returns the seeds whose runs are not."""
        for seed in seeds:
            if seed not in point.results and not point.failure:
                found = kept(self._folder(point, seed))
                if isinstance(found, dict):
                    point.results[seed] = found
                elif found is not None:
                    point.failures[seed] = str(found)
        return [] if point.failure else [seed for seed in seeds if seed not in point.results]

    def _due(
        self, lacking: Sequence[tuple[Point, list[int]]], tell: Tell, until: float
    ) -> Iterator[tuple[Point, list[int], float]]:
        """What to run next: a point, seeds, and the time there is for them [s].

        It is asked when somebody is free to run that, and goes by what runs came to until then. Where there are
        points enough for all workers, one has all the seeds of a point, and loads its kernels once.
        """
        points = list({id(point): (point, seeds) for point, seeds in lacking}.values())
        for number, (point, seeds) in enumerate(points):
            parts = len(seeds) if self.cluster is None else max(1, self.abreast // (len(points) - number))
            size = math.ceil(len(seeds) / parts)
            for first in range(0, len(seeds), size):
                if point.failure:
                    break
                if self.interrupted or self.gap.asked:
                    self.interrupted = True
                    return
                left = until * self.budget - self.spent
                if not (point is self.given and not point.results) and self.expected(point) > left:
                    if first == 0 and not point.results:
                        point.left_out = (
                            f"not run: needs about {self.expected(point):.2g} s, but only {max(left, 0):.2g} s were "
                            "left"
                        )
                    break
                tell(f"{self.label(point)} {point.variant}".strip(), min(self.spent / self.budget, 1.0), {})
                yield point, seeds[first : first + size], left

    def complete(self, point: Point, seeds: Sequence[int]) -> bool:
        """Every run is there."""
        return not point.failure and all(seed in point.results for seed in seeds)

    def _folder(self, point: Point, seed: int) -> Path:
        changed = {k: v for k, v in sorted(point.parameters.items()) if self.base.get(k, ...) != v}
        words = "-".join(f"{name}={word_of(value)}" for name, value in changed.items()) or "given"
        words = "-".join([*point.variant.split(), words])
        return self.folder / "runs" / (f"{words}-seed={seed}" if self.has_seeds else words)

    def _parameters(self, point: Point, seed: int) -> dict[str, Any]:
        return {**point.parameters, **({"seed": seed} if self.has_seeds else {})}

    def _simulation(self, point: Point, seed: int, **settings: Any) -> Simulation:
        scene = self.module.scene(**self._parameters(point, seed))
        return Simulation(scene, device=self.device, precision=scene.precision, threads=self.threads, **settings)

    def _run(self, point: Point, seed: int, folder: Path) -> None:
        outcome: Any
        try:
            if len(self.seeds) < FEW and not point.results and not point.variant:
                warm_up(self._simulation(point, seed))
            simulation = self._simulation(point, seed, recorders=recorders_of(folder, self.module.check, {}))
            scene = simulation.scene
            with StopAtSample([simulation]) as stop:
                (outcome,) = method_of(scene).run_many([simulation], [None], lambda phase, fraction: None)
            self.interrupted |= stop.asked
        except (WarpcreteError, KeyboardInterrupt) as error:
            outcome = error
        if isinstance(outcome, Run):
            outcome = read_json(folder / "result.json") if outcome.finished else None
        self._book(point, seed, outcome)

    def _run_on(self, cluster: Cluster, due: Iterator[tuple[Point, list[int], float]]) -> None:
        """Run on workers, one trial each at a time. Time spent is that of the wall, whatever there is of workers."""
        before, begun, running = self.spent, time.perf_counter(), 0
        record = {"device": self.device, "threads": self.threads, "command": COMMAND, "hardware": self.hardware}

        def jobs() -> Iterator[tuple[tuple[Point, list[int]], Trial]]:
            nonlocal running
            for point, seeds, left in due:
                running += 1
                self.record = {**self.record, "abreast": max(running, self.record.get("abreast", 1))}
                cases = [Case(self._folder(point, s).name, {}, self._parameters(point, s)) for s in seeds]
                yield (point, seeds), Trial(cases, len(seeds) < FEW and not point.variant, left)

        def book(job: tuple[Point, list[int]], outcomes: Any) -> None:
            nonlocal running
            running -= 1
            self.spent = before + time.perf_counter() - begun
            point, seeds = job
            for seed, outcome in zip(seeds, [outcomes] if isinstance(outcomes, Exception) else outcomes):
                self._book(point, seed, outcome)
            if point.failures:  # whichever ended first, it counts what seeds in their order come to
                point.results = {s: r for s, r in point.results.items() if s < min(point.failures)}

        where = record, self.module, self.folder / "runs"
        cluster.each(run_trial, where, jobs(), book, self.gap, lazily=True)

    def _book(self, point: Point, seed: int, outcome: Any) -> None:
        """Note what came of a run: its result.json, what it failed with, or None if it was stopped."""
        if isinstance(outcome, dict) and outcome.get("finished"):
            point.results[seed] = outcome
        elif isinstance(outcome, InstabilityError | SceneError):
            point.failures[seed] = f"failed: {outcome}"
            folder = self._folder(point, seed)
            folder.mkdir(parents=True, exist_ok=True)
            (folder / FAILED).write_text(f"{point.failures[seed]}\n", encoding="utf-8")
        elif isinstance(outcome, WorkerLost):
            point.left_out = f"not run: {outcome}"
        elif isinstance(outcome, dict | KeyboardInterrupt | None):
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
