"""Every entry of every scene's `check` fails on its own, in each direction, in runs that are made up.

A made-up run has a sound series, from which the method's own quantities follow. A case changes one column of it, and
states the values at which its entry must still pass and must fail; a value that is not a number must fail, too.
"""

import math
import re
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_runs import MIDDLE, RUNS, Made, scene_name, verdicts

from warpcrete import scenes
from warpcrete.core.inputs.parameters import declared_fields
from warpcrete.mps.column import plug_restart_state

NAN = math.nan
NEAR = 0.02
"""Relative distance from a limit at which an entry must already pass, and must already fail."""
ONE_SIDED = {
    "profile": "a mean square",
    "momentum balance": "the length of a vector, whatever the direction",
    "no grain swallowed": "grains may touch as little as they like",
    "no aggregate swallowed": "aggregates may touch as little as they like",
    "no overlap": "gaps may be as wide as they like",
    "enough grains": "more are better",
    "enough aggregates": "more are better",
    "one heap": "all of it may hold together",
    "all aggregates inside": "none may be outside",
    "plug holds": "none may be past it",
}
"""Entries of numbers that can be wrong in one direction only, and why."""
ALWAYS = {"plateau": "it tells of a pressure that is already known to be level"}
"""Entries that cannot fail, and why."""


@dataclass(frozen=True)
class Case:
    """One way in which one entry fails."""

    entry: str
    side: str
    """`high` or `low`, the side of the good range on which the value is; `off` where there is no number."""
    change: Callable[[Made, Any], None]
    """Gives a run the value."""
    good: Any = None
    bad: Any = None

    def values(self) -> Iterator[tuple[Any, set[str]]]:
        """Yield each value, and the entries that it must make fail."""
        if self.good is not None:
            yield self.good, set()
        if self.bad is not None or self.side == "off":
            yield self.bad, {self.entry}


def over(entry: str, limit: float, change: Callable[[Made, float], None]) -> list[Case]:
    """Return the cases of a value that may not be above a limit, nor undefined."""
    return [Case(entry, "high", change, limit * (1 - NEAR), limit * (1 + NEAR)), Case(entry, "high", change, bad=NAN)]


def beyond(entry: str, limit: float, change: Callable[[Made, float], None]) -> list[Case]:
    """Return the cases of an error that may not be beyond a limit on either side, nor undefined."""
    return [*over(entry, limit, change), Case(entry, "low", change, -limit * (1 - NEAR), -limit * (1 + NEAR))]


def off(entry: str, change: Callable[[Made], None]) -> Case:
    """Return the case of something that is not as it should be."""
    return Case(entry, "off", lambda made, _: change(made))


def at_the_end(name: str, of: Callable[[Made], float]) -> Callable[[Made, float], None]:
    """Return a change that makes a column too large by a part of `of` from its middle on."""

    def change(made: Made, part: float) -> None:
        made.series[name][MIDDLE:] = made.series[name][-1] + part * of(made)

    return change


def in_the_middle(name: str, base: float = 0.0) -> Callable[[Made, float], None]:
    """Return a change of one row of a column, after which all is as before."""

    def change(made: Made, value: float) -> None:
        made.series[name][MIDDLE] = base + value

    return change


def cut_short(made: Made) -> None:
    made.series = {name: values[:1] for name, values in made.series.items()}


def unsteady(made: Made) -> None:
    made.steady = False


def of_column(run: str) -> list[Case]:
    """Return the cases of a column of concrete on a piston; its limits are stated again here."""
    flat, two, tolerant = "channel" in run, "two phases" in run, "tolerant" in run
    usual = 0.03 if two else 0.01 if flat else 0.02
    accuracy = 0.2 if tolerant else usual
    cases = [
        off("finished", cut_short),
        *beyond("volume", 1e-3, in_the_middle("volume_error")),
        *beyond("balance of forces", 5e-3, at_the_end("force_balance_error", lambda made: 1.0)),
    ]
    if "some time" not in run:
        cases.append(off("steady", unsteady))
    if "rested" in run:
        return cases + of_restart(accuracy)
    wall = 0.2 if tolerant else 0.05 if two else 0.03
    cases += beyond("pressure", accuracy, at_the_end("pressure", lambda made: made.scene.theory().pressure))
    cases += beyond("wall's stress", wall, at_the_end("wall_stress", lambda made: made.scene.theory().wall_stress))
    if not two:
        speed = at_the_end("slip_velocity", lambda made: made.scene.velocity)
        cases += beyond("slip velocity", accuracy, speed)
        profile = 0.2 if tolerant else 0.01
        cases += over("profile", profile, at_the_end("profile_deviation", lambda made: made.scene.velocity))
    return cases


def of_restart(accuracy: float) -> list[Case]:
    """Return the cases of the peak of a restart, which may be anywhere between two closed forms."""

    def of(made: Made) -> tuple[float, float]:
        """Return the least and the largest pressure that may be the peak, without tolerance [Pa]."""
        scene, first = made.scene, made.series["time"][1]
        least, state = scene.theory().pressure, plug_restart_state(scene)
        bulk = scene.concrete.yield_stress + scene.gained
        kept = 0.5 * math.exp(-scene.velocity * first / scene.breakdown) if state.wall_stress <= bulk else 0.0
        return least + kept * (state.pressure - least), state.pressure

    def lowest(made: Made, part: float) -> None:
        made.series["pressure"][:] = of(made)[0] * part

    def highest(made: Made, part: float) -> None:
        made.series["pressure"][1] = of(made)[1] * part

    low, high = 1 - accuracy, 1 + accuracy
    return [
        Case("restart", "low", lowest, low * 1.001, low * 0.999),
        Case("restart", "high", highest, high * 0.999, high * 1.001),
        Case("restart", "high", highest, bad=NAN),
    ]


def dark(made: Made) -> None:
    made.series["screen"] = 0.55 + 0.45 * made.series["screen"]


def of_free(run: str) -> list[Case]:
    """Return the cases of a standard test as a flow."""
    limit = {"slump": 0.05, "jring": 0.05, "funnel": 0.04, "lbox": 0.07, "lcpc": 0.06}[run]
    last = off("light is seen", dark) if run == "funnel" else off("at rest", unsteady)
    return [off("finished", cut_short), *beyond("volume", limit, in_the_middle("volume_error")), last]


def of_part(run: str) -> list[Case]:
    """Return the cases of a flow through a part."""
    cases = [off("finished", cut_short), off("steady", unsteady)]
    for end, place in (("upstream", 0.0), ("downstream", 1.0)):
        theory = lambda made, place=place: made.scene.theory(place * made.scene.axis.length).pressure  # noqa: E731
        cases += beyond(f"friction {end}", 0.03, at_the_end(f"{end}_gradient", theory))
    return cases + beyond("volume", 1e-3, at_the_end("outflow_error", lambda made: 1.0))


def of_stretch(run: str) -> list[Case]:
    """Return the cases of mortar with aggregates in a stretch of pipe."""

    def wall(made: Made, part: float) -> None:
        made.series["wall_stress"] *= part

    def gap(made: Made, value: float) -> None:
        made.series["smallest_gap"][MIDDLE] = value

    return [
        off("finished", cut_short),
        off("steady", unsteady),
        Case("balance of forces", "high", wall, 1.0199, 1.0201),
        Case("balance of forces", "low", wall, 0.9801, 0.9799),
        Case("balance of forces", "high", wall, bad=NAN),
        Case("no overlap", "low", gap, -0.0499, -0.0501),
    ]


def unbalanced(made: Made, part: float) -> None:
    """Change the momentum by a part of the weight's impulse, which no force explains."""
    weight = np.linalg.norm(made.scene.gravity) * (made.series["time"][-1] - made.series["time"][MIDDLE])
    made.series["momentum_y"][-1] += part * weight


def bodies_of(made: Made, count: int, group: str = "") -> None:
    """Leave so many aggregates, and all of the plug."""
    kept = np.concatenate(
        [np.flatnonzero(made.bodies.group == group)[:count], np.flatnonzero(made.bodies.group != group)]
    )
    made.bodies = SimpleNamespace(**{name: values[kept] for name, values in vars(made.bodies).items()})


def strays(made: Made, part: float) -> None:
    made.series["main_body"][-1] = 1 - part


def restless(made: Made) -> None:
    """Move the concrete half a second before the end once more."""
    made.series["fastest"][-2] = 1.01 * made.scene.vessel.rest_speed


def of_vessel(run: str) -> list[Case]:
    """Return the cases of a standard test by discrete elements."""
    cases = [
        *over("momentum balance", 0.01, unbalanced),
        Case("momentum balance", "high", unbalanced, -0.01 * (1 - NEAR), -0.01 * (1 + NEAR)),
        *over("no grain swallowed", 2.0, in_the_middle("largest_overlap")),
        Case("enough grains", "low", bodies_of, 200, 199),
    ]
    if run == "funnel-dem":
        return [*cases, off("light is seen", dark)]
    cases.append(off("at rest", restless))
    return cases if run in ("lbox-dem", "lcpc-dem") else [*cases, *over("one heap", 0.05, strays)]


def outside(made: Made, part: float) -> None:
    """Put one aggregate so many radii of the pipe off its axis, to a side."""
    points, _, normal, _ = made.scene.pipe.axis.frame(np.array([0.05]))
    radius = next(wall.radius for wall in made.scene.walls if wall.name == "pipe")
    made.bodies.position[0] = points[0] + part * radius * normal[0]


def ahead_of_plug(made: Made, count: int, sizes: float) -> None:
    """Put aggregates ahead of the foremost ball of the plug by a part of their size."""
    foremost = made.scene.pipe.axis.along(made.bodies.position[made.bodies.group == "plug"]).max()
    made.bodies.position[:count] = made.scene.pipe.axis.at(np.full(count, foremost + sizes * made.bodies.size[0]))[0]


def past_plug(made: Made, count: int) -> None:
    ahead_of_plug(made, count, 0.51)


def against_plug(made: Made, count: int) -> None:
    ahead_of_plug(made, count, 0.49)


def travels(made: Made, part: float) -> None:
    made.series["travel"] = part * made.series["travel"]


BLOCKAGE = ("at", "time", "travel", "pressure", "pressure_before", "solid_fraction", "chains")


def blocked(made: Made) -> None:
    made.blocked = dict.fromkeys(BLOCKAGE, 1.0)


def outflow(made: Made, ratio: float) -> None:
    made.measured = {"flux_ratio": ratio}


def stopped(made: Made) -> None:
    made.finished = False


def no_steps(made: Made) -> None:
    made.steps = 0


def of_pumped(run: str) -> list[Case]:
    """Return the cases of concrete in a pipe by discrete elements."""
    cases = [
        Case("finished", "low", travels, 1 - 0.98e-3, 1 - 1.02e-3),
        Case("finished", "high", travels, 1 + 0.98e-3, 1 + 1.02e-3),
        Case("finished", "low", travels, bad=NAN),
        off("finished", stopped),
        off("finished", no_steps),
        *over("momentum balance", 0.01, unbalanced),
        Case("momentum balance", "high", unbalanced, -0.01 * (1 - NEAR), -0.01 * (1 + NEAR)),
        *over("no aggregate swallowed", 2.0, in_the_middle("largest_overlap")),
        Case("all aggregates inside", "high", outside, 0.99, 1.01),
        Case("all aggregates inside", "high", outside, -0.99, -1.01),
        Case("enough aggregates", "low", bodies_of, 30, 29),
        off("not blocked", blocked),
    ]
    if run == "part-dem":
        cases += [Case("outflow equals inflow", side, outflow, 1 + sign * 0.2 * (1 - NEAR), 1 + sign * 0.2 * (1 + NEAR))
                  for side, sign in (("high", 1), ("low", -1))]  # fmt: skip
        cases.append(Case("outflow equals inflow", "high", outflow, bad=NAN))
    if run != "pipe, plate":
        cases.append(Case("plug holds", "high", past_plug, 2, 3))
        cases.append(Case("plug holds", "high", against_plug, 100))
    return cases


def cases_of(run: str) -> list[Case]:
    name = scene_name(run)
    makers = {"channel": of_column, "tube": of_column, "part": of_part, "stretch": of_stretch,
              "pipe": of_pumped, "part-dem": of_pumped,
              **dict.fromkeys(("slump", "jring", "funnel", "lbox", "lcpc"), of_free),
              **dict.fromkeys(("slump-dem", "funnel-dem", "lbox-dem", "jring-dem", "lcpc-dem"), of_vessel)}  # fmt: skip
    return makers[name](run)


@pytest.fixture(scope="module")
def sound():
    """Made-up runs that pass, by name; each is made once."""
    return {name: make() for name, make in RUNS.items()}


@pytest.mark.parametrize("run", RUNS)
def test_each_entry_fails_alone(sound, run):
    assert all(verdicts(sound[run]).values()), verdicts(sound[run])
    for case in cases_of(run):
        for value, failing in case.values():
            made = deepcopy(sound[run])
            case.change(made, value)
            found = verdicts(made)
            assert {name for name, passed in found.items() if not passed} == failing, (case.entry, case.side, value)
            for name in failing:
                named_options(made, name)


def named_options(made: Made, entry: str) -> None:
    """Check that a failed entry names a cure, with options that the scene has."""
    module = scenes.modules()[made.scene.name]
    text = module.check(made.run())[entry][1]
    assert "; usual cure: " in text, (entry, text)
    options = re.findall(r"--([a-z-]+)", text.partition("usual cure")[2])
    assert options and {option.replace("-", "_") for option in options} <= set(declared_fields(module.scene.parameters))


@pytest.mark.parametrize("name", scenes.modules())
def test_every_entry_has_cases_on_every_side(sound, name):
    """The harness itself is whole: every scene, every entry that any run of it shows, both sides of every number."""
    sides: dict[str, set[str]] = {}
    seen: set[str] = set()
    for run in RUNS:
        if scene_name(run) == name:
            seen |= set(verdicts(sound[run]))
            for case in cases_of(run):
                sides.setdefault(case.entry, set()).add(case.side)
                for value, _ in case.values():
                    made = deepcopy(sound[run])
                    case.change(made, value)
                    seen |= set(verdicts(made))
    assert seen and seen - set(ALWAYS) == set(sides)
    for entry, found in sides.items():
        assert found - {"off"} in ({"high", "low"}, set()) or entry in ONE_SIDED, entry


def test_a_blocked_run_that_was_to_stop_is_whole(sound):
    """Where a run ends once it is blocked, its travel is no fault."""
    made = deepcopy(sound["pipe, stops"])
    travels(made, 0.5)
    assert not verdicts(made)["finished"]
    blocked(made)
    assert verdicts(made)["finished"] and not verdicts(made)["not blocked"]
    made = replace(deepcopy(sound["pipe"]), blocked=made.blocked)
    travels(made, 0.5)
    assert not verdicts(made)["finished"]
