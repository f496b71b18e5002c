"""Probability that the narrowest part of a pump line is blocked, from one discrete element run for each of many seeds.

Each seed packs the stones differently. On a GPU, all runs form one batch. On a CPU, they are distributed over several
processes. The runs are stored as a study in the line's folder, so an interrupted command continues with the missing
seeds.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path

from ...core.errors import between, refuse
from ...core.inputs.customary import both
from ...core.records import Record, SceneArguments
from ...core.run.files import write_json
from ...core.run.progress import Progress
from ...core.units import number, quantity
from ...dem.measure.blockage import STANDING_RATIO
from ...geometry.pipe_line import Part, PipeLine
from ...mix.blocking import narrowest
from ...scenes import modules
from ...theory.bands import wilson_interval
from ..cases import Case
from ..study import resume_study, run_listed
from ..study_result import Study
from .elements import SCENE, Elements, part_parameters
from .line_folder import PARTS

FOLDER = "blocking"
"""Name of the folder with the runs for the probability of a blockage, next to the folders of the line's parts."""
RECORD = "blocking-probability.json"
STRAIGHT_DIAMETERS = 2.0
"""Length of straight pipe before and behind the line's narrowest part in a simulation, divided by the larger of the
diameters at the two ends of the part."""
TRAVEL_DIAMETERS = 4.0
"""Travel of the piston, divided by the diameter of the pipe. The travel leaves room for the check for blockage, which
recognises concrete that stands still only after a travel of up to two diameters."""
MAX_SEEDS = 10_000
FRICTION = 0.5
"""Smallest coefficient of friction between stones in simulations of blocking; it is typical of dry stones.

Stones form an arch where the mortar between them has been squeezed out. With this friction, stones of one size block a
funnel that is up to three times as wide as the stones, which is the limit of ACI 304.2R for crushed stones. With the
friction of 0.05 of Zhan et al. (2019), stones of half the width of the bore still passed.
"""
MODULUS = 2e6
"""Smallest elastic modulus of the stones in simulations of blocking [Pa]; softer stones get this modulus, because they
would squeeze through bores that block in reality. The simulations of funnels from which :data:`FRICTION` was chosen
used this modulus."""


@dataclass(frozen=True)
class BlockingProbability:
    """Result of simulating the narrowest part of a line with many seeds: how many of the runs were blocked."""

    part: Part
    runs: int
    """Number of runs that finished, blocked or not."""
    blocked: int
    """Number of runs that ended because the part was blocked."""
    failed: int
    """Number of runs that ended with an error; they do not count in the probability of a blockage."""
    short: int
    """Number of runs at whose end part of the concrete stood still, but not yet long enough to count as a blockage.
    These runs count as not blocked."""
    stones: int
    """Number of stones in the first simulation. The other simulations have other random packings."""
    stone: float
    """Size of the largest stone in the simulation, after stones were enlarged [m]."""
    coarse: float
    """Factor by which the stones were enlarged for the simulation; 1 if they kept their size."""
    friction: float
    """Friction coefficient between the stones in the simulation; NaN if the concrete's file states a contact law."""

    @property
    def probability(self) -> float:
        """Number of blocked runs divided by the number of finished runs."""
        return self.blocked / self.runs

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the probability of a blockage (Wilson 1927)."""
        return wilson_interval(self.blocked, self.runs)

    def record(self) -> Record:
        """Return the results as the contents of the file blocking-probability.json."""
        low, high = self.interval
        return {
            "part": {"number": self.part.number, "what": self.part.label, "bore": quantity(self.part.narrow, "m")},
            "runs": self.runs, "blocked": self.blocked, "failed": self.failed, "standing_at_end": self.short,
            "probability": self.probability, "low": low, "high": high, "interval": "Wilson 1927, 95 %",
            "stones": self.stones, "largest_stone": quantity(self.stone, "m"), "coarse": self.coarse,
            "friction": self.friction,
        }  # fmt: skip

    @property
    def lines(self) -> list[str]:
        """The probability of a blockage and its conditions as lines of text."""
        low, high = self.interval
        ratio = self.stone / self.part.narrow
        us = bool(self.part.customary_label)
        state = "was blocked in" if self.blocked else "not blocked:"
        friction = "" if math.isnan(self.friction) else f", with a friction of {self.friction:g} between them"
        texts = [
            f"blocking by simulation: part {self.part.number}, {self.part.label}, {state} {self.blocked} of "
            f"{self.runs} runs: probability {100 * self.probability:.3g} %, 95 % interval {100 * low:.2g} to "
            f"{100 * high:.2g} % (Wilson 1927)",
            f"{self.stones} stones up to {both(us, 'mm', self.stone, digits=3)} in a bore of "
            f"{both(us, 'mm', self.part.narrow)}, a ratio of {ratio:.2g}{friction}; the simulation shows arches of "
            "stones, but neither bleeding nor faults of priming",
        ]
        if self.coarse > 1:
            texts.append(f"stones are enlarged {self.coarse:g} times, which makes blocking likelier")
        if self.failed:
            texts.append(f"{self.failed} runs failed and do not count")
        if self.short:
            texts.append(f"{self.short} runs ended while part of the concrete stood still, and count as not blocked")
        return texts


def run_blocking(
    line: PipeLine,
    concrete: str,
    flow: float,
    count: int,
    *,
    out: Path,
    elements: Elements | None = None,
    device: str | None = None,
    processes: int | None = None,
    progress: Progress | None = None,
) -> BlockingProbability:
    """Simulate the narrowest part of a line with `count` seeds at a `flow` [m3/s], and count the blocked runs.

    The runs are stored in `out`, the folder of the line. If this folder contains an interrupted study, it continues.
    Stones keep their size unless `elements` states a factor by which they are enlarged. Raises :class:`SceneError` for
    settings that cannot be simulated, and `KeyboardInterrupt` if the study was interrupted.
    """
    between("blocking", count, 1, MAX_SEEDS)
    elements = elements or Elements()
    elements = replace(elements, coarse=elements.coarse or 1.0)
    part = narrowest(line)
    cases = [Case(f"seed-{seed}", {}, _parameters(part, line, concrete, flow, elements, seed)) for seed in range(count)]
    folder = out / PARTS / FOLDER
    module = modules()[SCENE]
    if (folder / "study.json").is_file():
        study = resume_study(folder, module, processes=processes, progress=progress)
    else:
        study = run_listed(
            SCENE, module, cases, out=folder, device=device, processes=processes, progress=progress, figure=False
        )
    if not study.finished:
        raise KeyboardInterrupt
    probability = _counted(study, part, elements)
    write_json(out / RECORD, probability.record())
    return probability


def _parameters(
    part: Part, line: PipeLine, concrete: str, flow: float, elements: Elements, seed: int
) -> SceneArguments:
    """Return the scene parameters of one simulation that pumps concrete through a part.

    The simulation ends as soon as the part is blocked, and measures no losses. If the concrete's file states a contact
    law, this law stays unchanged. Otherwise the stones' friction is at least :data:`FRICTION` and their modulus at
    least :data:`MODULUS`, because smoother or softer stones would pass bores that block in reality. `elements` states
    the factor by which the stones are enlarged.
    """
    wide = max(part.diameter, part.outlet)
    own = part_parameters(part, False, line, concrete, flow, elements, seed)
    own |= {"straight": STRAIGHT_DIAMETERS * wide, "travel": TRAVEL_DIAMETERS * part.diameter, "slices": 0.0,
            "stop_when_blocked": True}  # fmt: skip
    given = modules()[SCENE].scene.declared(own)
    if given.contact is not None:
        return own
    wall = given.friction if given.wall_friction is None else given.wall_friction
    stiff = max(given.modulus, MODULUS)
    return own | {"friction": max(given.friction, FRICTION), "wall_friction": wall, "modulus": stiff}


def _counted(study: Study, part: Part, elements: Elements) -> BlockingProbability:
    results = list(study.results.values())
    if not results:
        first = next(iter(study.failures.values()), "")
        problem = f"gives no result, because no run finished; the first run failed with: {first}"
        refuse("blocking", len(study.cases), problem, "correct the cause, and use a new folder")
    blocked = [bool(number(result["blocked"])) for result in results]
    given = modules()[SCENE].scene(**study.cases[0].parameters)
    return BlockingProbability(
        part=part, runs=len(results), blocked=sum(blocked), failed=len(study.failures),
        short=sum(not stuck and result.get("slowest_advance", 1.0) < STANDING_RATIO
                  for stuck, result in zip(blocked, results, strict=True)),
        stones=int(results[0]["packing"]["bodies"]), stone=given.fill.sizes.largest, coarse=elements.coarse or 1.0,
        friction=study.cases[0].parameters.get("friction", math.nan),
    )  # fmt: skip
