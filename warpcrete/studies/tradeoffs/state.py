"""State of a trade-off study: the settings that it tries, the results of their runs, and their costs and errors."""

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ...core.device.interrupts import StopAtSample
from ...core.errors import InstabilityError, SceneError, WarpcreteError
from ...core.inputs.knobs import Knob
from ...core.inputs.parameters import declared_fields
from ...core.records import SceneArguments
from ...core.run.files import read_json
from ...core.run.method import Quantity
from ...core.run.progress import Progress
from ...core.run.run import Run
from ...methods import Simulation, method_of
from ...record.recorders import recorders_of
from ..cases import Case, name_part, short_name
from ..cluster import Cluster, WorkerLost
from ..running import FAILED, previous_outcome
from .judging import Judging
from .points import CARRIED, GIVEN, WANTED_ERRORS, Promise, Setting
from .trials import MIN_RUNS_FOR_MEDIAN, WorkerJob, run_worker_job, warm_up

COMMAND = {"frames": 25.0, "checkpoint_every": 0.0}
"""Recording options of the runs on workers: frames per simulated second, and wall time between checkpoints [s]. The
value 0 switches checkpoints off, because the wall time of a resumed run could not be compared with the wall times of
other runs."""


class Trade(Judging):
    """A trade-off study, complete or as far as the budget allowed."""

    def __init__(self, folder: Path, module: Any, record: Mapping[str, Any]) -> None:
        self.folder, self.module, self.record = folder, module, record
        self.scene_name: str = record["scene"]
        self.base: dict[str, Any] = dict(record["parameters"])
        # The scene compares its results with a closed form, within a tolerance. Set this tolerance to the largest error
        # that the study considers, so that runs with coarse settings do not fail the check.
        if module.trading.tolerance:
            self.base.setdefault(module.trading.tolerance, WANTED_ERRORS[0])
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
        self.points: list[Setting] = []
        self.tried: list[Setting] = []
        self.promises: list[Promise] = []
        self.spent = 0.0
        self.budget = math.inf
        self.interrupted = False
        self.gap = StopAtSample([])
        """Object that shows between two runs whether the user has pressed Ctrl-C."""
        self.cluster: Cluster | None = None
        """Workers that perform the runs; None for runs in this process."""

    def __repr__(self) -> str:
        done = sum(bool(point.results) for point in self.points)
        return (
            f"<Trade of scene {self.scene_name!r}: {done} of {len(self.points)} settings run, folder '{self.folder}'>"
        )

    @property
    def machine(self) -> str:
        """Description of the processor (GPU or CPU) on which the wall times were measured."""
        if self.device.startswith("cuda"):
            return self.hardware
        return f"{self.hardware}, {self.threads} thread{'s' if self.threads > 1 else ''}"

    @property
    def hardware(self) -> str:
        """Model name of the GPU or CPU on which the runs take place."""
        found = self.record["provenance"]
        return found["device_name"] if self.device.startswith("cuda") else found.get("processor") or "a CPU"

    @property
    def abreast(self) -> int:
        """Number of simultaneous runs, each on its own worker."""
        return 1 if self.cluster is None else self.cluster.count

    @property
    def given(self) -> Setting:
        """Setting of the user: each accuracy parameter has the value that the user stated, or its default value."""
        return self.points[0]

    @property
    def chosen_knobs(self) -> list[Knob]:
        """Knobs (accuracy parameters) that a recommended setting may change."""
        return [knob for knob in self.knobs if knob.chosen]

    @property
    def seeds(self) -> list[int]:
        return list(range(self.first_seed, self.first_seed + self.repeat)) if self.has_seeds else [0]

    @property
    def measured(self) -> list[Setting]:
        """Settings that have been run, so that their wall time and their error are known."""
        return [p for p in self.points if self.complete(p, self.seeds) and p.worst is not None
                and math.isfinite(p.worst.bound)]  # fmt: skip

    def rounds(self, runs: int) -> int:
        """Return the number of rounds for `runs` runs if, in a round, each worker performs one run."""
        return math.ceil(runs / self.abreast)

    def label(self, point: Setting) -> str:
        """Return a description of how a setting differs from the user's scene."""
        parts = [f"{knob.name} {knob.levels[point.levels[knob.name]].label}" for knob in self.knobs
                 if knob.name in point.levels]  # fmt: skip
        return ", ".join(parts) or GIVEN

    def keys_of(self, point: Setting) -> dict[str, str]:
        """Return a dictionary from the names of knobs to the names of their levels in a setting.

        A knob is a parameter that trades accuracy for run time, and a level is one of its values. The dictionary
        contains only knobs whose level differs from that in the user's scene. Levels with the same name correspond to
        each other in different scenes.
        """
        chosen = {knob.name: knob.levels[point.levels[knob.name]] for knob in self.knobs if knob.name in point.levels}
        return {name: level.key or level.label for name, level in chosen.items()}

    def point(self, origin: str, levels: Mapping[str, int]) -> Setting:
        """Return the setting with the given levels; create it unless a setting with equal parameters exists.

        `levels` holds the index of a level (value) for each knob (accuracy parameter) that differs from the user's
        scene.
        """
        changes: SceneArguments = {}
        converted: dict[str, tuple[float, float]] = {}
        for knob in self.knobs:
            if knob.name in levels:
                changes |= knob.levels[levels[knob.name]].changes
                converted |= knob.levels[levels[knob.name]].converted
        parameters = self.module.scene.effective_values({**self.base, **changes})
        full = self._full(parameters)
        if (found := self._with(full)) is not None:
            return found
        differing = {name: k for name, k in levels.items() if self._differs(name, k)}
        self.points.append(Setting(origin, differing, parameters, converted=converted, full=full))
        return self.points[-1]

    def carried(self, point: Setting, variant: str, changes: Mapping[str, object]) -> Setting:
        """Return the setting of a variant of the scene that corresponds to the setting `point` of the scene itself.

        `changes` are the parameters in which the variant differs from the scene. For each knob (accuracy parameter),
        the new setting has the level with the same name as in `point`; the value of this level may be another one in
        the variant.
        """
        base = {**self.base, **changes}
        knobs = {knob.name: knob for knob in self.module.trading.knobs(self.module.scene.declared(base))}
        for name, key in self.keys_of(point).items():
            level = knobs[name].level_of(key) if name in knobs else None
            base |= level.changes if level else {}
        parameters = self.module.scene.effective_values(base)
        same = [p for p in self.tried if p.variant == variant and p.parameters == parameters]
        if not same:
            same = [Setting(CARRIED, point.levels, parameters, variant=variant)]
            self.tried += same
        return same[0]

    def _with(self, full: Mapping[str, object]) -> Setting | None:
        return next((point for point in self.points if point.full == full), None)

    def _full(self, parameters: Mapping[str, object]) -> SceneArguments:
        """Return all parameters that have an effect on the scene, including those with default values."""
        defaults = {name: found.default for name, found in declared_fields(self.module.scene.parameters).items()}
        return self.module.scene.effective_values({**defaults, **self.module.scene.completed(parameters)})

    def _differs(self, name: str, level: int) -> bool:
        (knob,) = [each for each in self.knobs if each.name == name]
        as_given = self._full(self.base)
        return any(as_given.get(key) != value for key, value in knob.levels[level].changes.items())

    def ratio(self, knob: Knob, level: int) -> float:
        """Return the wall time with `knob` at one level, divided by the wall time of the user's scene.

        A knob is a parameter that trades accuracy for run time, and a level is one of its values. The ratio is measured
        if there was a run in which only this knob was changed to this level. Otherwise it is estimated.
        """
        alone = self.alone(knob, level)
        if alone is not None and math.isfinite(alone.cost) and not alone.failure and self.given.cost > 0:
            return alone.cost / self.given.cost
        return knob.levels[level].cost / knob.levels[self.level_as_given(knob)].cost

    def alone(self, knob: Knob, level: int) -> Setting | None:
        return self._with(self._full(self.module.scene.effective_values({**self.base, **knob.levels[level].changes})))

    def level_as_given(self, knob: Knob) -> int:
        """Return the index of the level at which a knob has the same value as in the user's scene.

        A knob is an accuracy parameter, and its levels are the values to choose from. If no level agrees, the result is
        the index of the finest level.
        """
        same = [k for k in range(len(knob.levels)) if not self._differs(knob.name, k)]
        return same[0] if same else len(knob.levels) - 1

    def expected(self, point: Setting) -> float:
        """Return the wall time of one run of a setting [s]: the measured median, or an estimate without a run."""
        if math.isfinite(point.cost):
            return point.cost
        by_name = {knob.name: knob for knob in self.knobs}
        return self.given.cost * math.prod(self.ratio(by_name[name], k) for name, k in point.levels.items())

    def run(self, point: Setting, seeds: Sequence[int], tell: Progress, until: float = 1.0) -> bool:
        """Run a setting with those `seeds` that have not run yet; return whether all `seeds` then have a result.

        A run does not start if it is expected to end after the fraction `until` of the budget is spent.
        """
        self.run_all([point], seeds, tell, until)
        return self.complete(point, seeds)

    def run_all(self, points: Sequence[Setting], seeds: Sequence[int], tell: Progress, until: float = 1.0) -> None:
        """Run the settings in their order on all workers, each setting with those `seeds` that have not run yet.

        A run does not start if it is expected to end after the fraction `until` of the budget is spent.
        """
        lacking = [(point, left) for point in points if (left := self._take_over(point, seeds))]
        if self.cluster is None:
            for point, (seed, *_), _ in self._due(lacking, tell, until):
                begun = time.perf_counter()
                self._run(point, seed, self.folder_of(point, seed))
                self.spent += time.perf_counter() - begun
        elif lacking:
            self._run_on(self.cluster, self._due(lacking, tell, until))

    def _take_over(self, point: Setting, seeds: Sequence[int]) -> list[int]:
        """Read the existing runs of a setting from their folders; return the seeds that still have to run."""
        for seed in seeds:
            if seed not in point.results and not point.failure:
                found = previous_outcome(self.folder_of(point, seed))
                if isinstance(found, dict):
                    point.results[seed] = found
                elif found is not None:
                    point.failures[seed] = str(found)
        return [] if point.failure else [seed for seed in seeds if seed not in point.results]

    def _due(
        self, lacking: Sequence[tuple[Setting, list[int]]], tell: Progress, until: float
    ) -> Iterator[tuple[Setting, list[int], float]]:
        """Yield the jobs one by one, each as a setting, some of its seeds, and the time left for their runs [s].

        `lacking` holds pairs of a setting and its seeds that have no result yet. The caller requests a job when a
        processor is free, so each decision uses the results available at that moment. If there are enough settings for
        all workers, one worker takes all seeds of a setting and loads its kernels only once. A setting is left out if
        its run is expected to end after the fraction `until` of the budget is spent.
        """
        points = list({id(point): (point, seeds) for point, seeds in lacking}.values())
        for number, (point, seeds) in enumerate(points):
            parts = len(seeds) if self.cluster is None else max(1, self.abreast // (len(points) - number))
            size = math.ceil(len(seeds) / parts)
            for first in range(0, len(seeds), size):
                if point.failure:
                    break
                if self.interrupted or self.gap.requested:
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

    def folder_of(self, point: Setting, seed: int) -> Path:
        """Return the folder of the run of a setting with a random seed."""
        # Name the folder after the parameters that differ from the user's scene. Parameters with default values may
        # be missing from `self.base`; a missing parameter counts as None if its default is None.
        fields = declared_fields(self.module.scene.parameters)
        plain = {name for name, field in fields.items() if field.default is None}
        changed = {
            k: v for k, v in sorted(point.parameters.items()) if self.base.get(k, None if k in plain else ...) != v
        }
        words = "-".join(f"{name}={name_part(value)}" for name, value in changed.items()) or "given"
        words = short_name("-".join([*point.variant.split(), words]))
        return self.folder / "runs" / (f"{words}-seed={seed}" if self.has_seeds else words)

    def parameters_of(self, point: Setting, seed: int) -> SceneArguments:
        """Return the parameters of the scene in the run of a setting with a random seed."""
        return {**point.parameters, **({"seed": seed} if self.has_seeds else {})}

    def _simulation(self, point: Setting, seed: int, **settings: object) -> Simulation:
        scene = self.module.scene(**self.parameters_of(point, seed))
        return Simulation(scene, device=self.device, precision=scene.precision, threads=self.threads, **settings)

    def _run(self, point: Setting, seed: int, folder: Path) -> None:
        outcome: Any
        try:
            if len(self.seeds) < MIN_RUNS_FOR_MEDIAN and not point.results and not point.variant:
                warm_up(self._simulation(point, seed))
            simulation = self._simulation(point, seed, recorders=recorders_of(folder, self.module.check, {}))
            scene = simulation.scene
            with StopAtSample([simulation]) as stop:
                (outcome,) = method_of(scene).run_many([simulation], [None], lambda phase, fraction: None)
            self.interrupted |= stop.requested
        except (WarpcreteError, KeyboardInterrupt) as error:
            outcome = error
        if isinstance(outcome, Run):
            outcome = read_json(folder / "result.json") if outcome.finished else None
        self._store_outcome(point, seed, outcome)

    def _run_on(self, cluster: Cluster, due: Iterator[tuple[Setting, list[int], float]]) -> None:
        """Run the jobs from `due` on workers, and add the elapsed wall time to the attribute `spent`.

        Each worker performs one job at a time.
        """
        before, begun, running = self.spent, time.perf_counter(), 0
        record = {"device": self.device, "threads": self.threads, "command": COMMAND, "hardware": self.hardware}

        def jobs() -> Iterator[tuple[tuple[Setting, list[int]], WorkerJob]]:
            nonlocal running
            for point, seeds, left in due:
                running += 1
                self.record = {**self.record, "abreast": max(running, self.record.get("abreast", 1))}
                cases = [Case(self.folder_of(point, s).name, {}, self.parameters_of(point, s)) for s in seeds]
                yield (point, seeds), WorkerJob(cases, len(seeds) < MIN_RUNS_FOR_MEDIAN and not point.variant, left)

        def store_outcomes(job: tuple[Setting, list[int]], outcomes: object) -> None:
            nonlocal running
            running -= 1
            self.spent = before + time.perf_counter() - begun
            point, seeds = job
            for seed, outcome in zip(seeds, [outcomes] if isinstance(outcomes, Exception) else outcomes):
                self._store_outcome(point, seed, outcome)
            # Drop the results of all seeds after the first failed one, as if the seeds had run one after the other.
            # Otherwise the results would depend on the order in which the runs end.
            if point.failures:
                point.results = {s: r for s, r in point.results.items() if s < min(point.failures)}

        where = record, self.module, self.folder / "runs"
        cluster.each(run_worker_job, where, jobs(), store_outcomes, self.gap, lazily=True)

    def _store_outcome(self, point: Setting, seed: int, outcome: Any) -> None:
        """Store the outcome of a run: its result.json, the exception that ended it, or None after an interruption."""
        if isinstance(outcome, dict) and outcome.get("finished"):
            point.results[seed] = outcome
        elif isinstance(outcome, InstabilityError | SceneError):
            point.failures[seed] = f"failed: {outcome}"
            folder = self.folder_of(point, seed)
            folder.mkdir(parents=True, exist_ok=True)
            (folder / FAILED).write_text(f"{point.failures[seed]}\n", encoding="utf-8")
        elif isinstance(outcome, WorkerLost):
            point.left_out = f"not run: {outcome}"
        elif isinstance(outcome, dict | KeyboardInterrupt | None):
            self.interrupted = True
        else:
            raise outcome
