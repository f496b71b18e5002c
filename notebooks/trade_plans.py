"""Plans of the trades that several runs at once measure: scenes, settings, variants and fresh scenes."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from warpcrete.scenes import modules
from warpcrete.studies.tradeoffs.points import CARRIED, COMBINED, GIVEN, REFERENCE, Setting
from warpcrete.studies.tradeoffs.state import Trade

Levels = Mapping[str, str]
"""Level of each knob that differs from the scene as given, by the names of knob and level."""
CARRIED_ON = 2
"""Number of candidates of a flow that run in the variants and in the fresh scenes."""
FRESH = "fresh: "
"""First word in the name of a scene that tests promises and was not used to make them."""


@dataclass(frozen=True)
class Plan:
    """Scene of a trade, and the settings with which it runs."""

    scene: str
    reference: Levels
    """Setting whose results count as correct."""
    candidates: tuple[Levels, ...]
    """Settings that save time; they are timed, and run in variants and fresh scenes as well."""
    base: Mapping[str, Any] = field(default_factory=dict)
    measured: tuple[Levels, ...] = ()
    """Further settings whose errors are measured, but not their times."""
    fresh: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Changes of parameters for scenes that test the promises, by name."""
    seeds: int = 1
    elements: bool = False
    """True for discrete elements."""


def vessel(scene: str, coarser: tuple[str, ...], *, factors: tuple[str, ...] = ("x 10",), **settings: Any) -> Plan:
    """Return the plan of a flow in a vessel; `coarser` are the levels of its spacing that save time."""
    wide = [{"spacing": level} for level in coarser]
    loose = [{"step error": factor} for factor in factors]
    both = [{**a, **b} for a in wide for b in loose]
    others = ({"spacing": "x 0.5"}, {"step error": "x 0.3"}, {"regularisation": "x 0.1"}, {"precision": "float64"})
    return Plan(scene, {"spacing": "x 0.7"}, (*both, *wide, *loose), measured=others, **settings)


FASTER = {"time step": "x 1.5"}
ELEMENTS = (
    FASTER | {"coarse-graining": "x 2", "settling": "x 0.2"},
    FASTER | {"coarse-graining": "x 1.5"},
    FASTER | {"settling": "x 0.2"},
    FASTER,
)
SINGLE = (
    {"coarse-graining": "x 1.5"}, {"coarse-graining": "x 2"}, {"settling": "x 0.2"}, {"stiffness": "x 0.5"},
    {"precision": "float64"}, {"time step": "x 0.5"},
)  # fmt: skip
GRAINS = (FASTER | {"coarse-graining": "x 1.5"}, FASTER | {"coarse-graining": "x 1.25"}, FASTER)
SINGLE_GRAINS = (
    {"coarse-graining": "x 1.5"}, {"coarse-graining": "x 1.25"}, {"stiffness": "x 0.5"}, {"precision": "float64"},
    {"time step": "x 0.5"},
)  # fmt: skip
FINE = {"time step": "x 0.5", "precision": "float64"}
NARROW = {"diameter": 0.1, "length": 0.5, "ramp": 0.15, "travel": 0.3}
HYDRATED = {"hydration": 0.05, "hydration_modulus": 1e7, "length": 0.4, "ramp": 0.1, "travel": 0.2}
ROLLING = {"rolling friction 0.15": {"rolling_friction": 0.15}}
FRESH_PIPES = {"a velocity of 0.6": {"velocity": 0.6}, "sizes 8 to 16 mm": {"size_min": 8e-3, "size_max": 16e-3}}
FRESH_NARROW = {"friction 0.15": {"friction": 0.15}, "a velocity of 0.6": {"velocity": 0.6}}


def pipe(base: Mapping[str, Any], fresh: Mapping[str, Mapping[str, Any]]) -> Plan:
    """Return the plan of a pipe unit by discrete elements."""
    return Plan("pipe", FINE, ELEMENTS, base, SINGLE, fresh, seeds=3, elements=True)


def grains(scene: str, fresh: Mapping[str, Mapping[str, Any]]) -> Plan:
    """Return the plan of a vessel by discrete elements."""
    return Plan(scene, FINE, GRAINS, {}, SINGLE_GRAINS, fresh, seeds=3, elements=True)


PLANS = {
    "slump": vessel("slump", ("x 1.6", "x 1.25"), factors=("x 10", "x 3"), fresh={
        "concrete no3": {"concrete": "no3"},
        "a mould of 1.2 the size": {"top_diameter": 0.12, "base_diameter": 0.24, "mould_height": 0.36}}),
    "lbox": vessel("lbox", ("x 1.4", "x 1.2"), fresh={
        "20 Pa s and 60 Pa": {"viscosity": 20.0, "yield_stress": 60.0},
        "a column of 0.5 m": {"column_height": 0.5}}),
    "funnel": vessel("funnel", ("x 2", "x 1.6", "x 1.25"), fresh={
        "20 Pa s and 60 Pa": {"viscosity": 20.0, "yield_stress": 60.0},
        "an outlet of 75 mm": {"outlet_width": 0.075}}),
    "part": Plan("part", {"spacing": "x 0.7"}, (
        {"spacing": "x 1.5", "time step": "x 2"}, {"spacing": "x 1.5"}, {"time step": "x 2"}),
        measured=({"time step": "x 0.5"}, {"regularisation": "x 0.1"}, {"regularisation": "x 10"},
                  {"precision": "float64"}),
        fresh={"concrete no3": {"concrete": "no3"}, "a diameter of 125 mm": {"diameter": 0.125, "flow": 2.4e-3}}),
    "stretch": Plan("stretch", {"spacing": "x 0.75"}, (
        {"spacing": "x 1.3", "courant": "x 2"}, {"spacing": "x 1.3"}, {"courant": "x 2"}),
        measured=({"spacing": "x 0.5"}, {"courant": "x 0.5"}, {"regularisation": "x 0.1"}, {"precision": "float64"}),
        fresh={"30 % of aggregates": {"aggregate_fraction": 0.3}, "a diameter of 120 mm": {"diameter": 0.12}},
        seeds=3),
    "jring": vessel("jring", ("x 1.3", "x 1.15"), fresh={
        "concrete no3": {"concrete": "no3"},
        "lifted in 1 s": {"lift_time": 1.0}}),
    "lcpc": vessel("lcpc", ("x 1.6", "x 1.25"), fresh={
        "100 Pa s and 120 Pa": {"viscosity": 100.0, "yield_stress": 120.0},
        "lifted in 3 s": {"lift_time": 3.0}}),
    "pipe-vertical": pipe({}, FRESH_PIPES),
    "pipe-bend": pipe({"unit": "D"}, FRESH_PIPES),
    "pipe-narrow": pipe(NARROW, FRESH_NARROW),
    "pipe-narrow-bend": pipe(NARROW | {"unit": "D", "elbow_radius": 0.3}, FRESH_NARROW),
    "pipe-hydrated": Plan("pipe", FINE, (
        {"coarse-graining": "x 2", "hydrated stiffness": "x 0.01", "settling": "x 0.2"},
        {"hydrated stiffness": "x 0.01", "coarse-graining": "x 1.5"}, {"hydrated stiffness": "x 0.01"},
        {"hydrated stiffness": "x 0.1"}), HYDRATED, (FASTER, *SINGLE),
        {"a velocity of 0.6": {"velocity": 0.6}}, 3, True),
    "part-dem": Plan("part-dem", FINE, ELEMENTS, {}, SINGLE, {
        "1.5 times the flow": {"flow": 2.25e-3}, "friction 0.1": {"friction": 0.1}}, 3, True),
    "slump-dem": grains("slump-dem", ROLLING),
    "lbox-dem": grains("lbox-dem", ROLLING),
    "funnel-dem": grains("funnel-dem", {}),
    "jring-dem": grains("jring-dem", ROLLING),
    "lcpc-dem": grains("lcpc-dem", ROLLING),
}  # fmt: skip
WHOLE = {
    "channel": ("channel", {}, 150),
    "tube": ("tube", {}, 300),
    "two-phases": ("channel", {"aggregates": True, "duration": 0.1}, 200),
}
"""Scene, parameters and budget [s] of trades whose runs are so short that they are made one at a time on a CPU."""


def trade_of(plan: Plan, folder: Path, device: str = "cpu", threads: int = 2, provenance: Any = None) -> Trade:
    """Return the trade of a plan without results; its knobs are those that the scene has."""
    module = modules()[plan.scene]
    scene = module.scene(**plan.base)
    knobs = [knob.name for knob in module.trading.knobs(module.scene.declared(plan.base)) if len(knob.levels) > 1]
    record = {
        "scene": plan.scene, "parameters": module.scene.plain(scene, plan.base), "files": {},
        "quantities": list(module.trading.quantities), "knobs": knobs, "repeat": plan.seeds,
        "seeded": plan.seeds > 1, "device": device, "threads": threads, "provenance": provenance or {},
    }  # fmt: skip
    trade = Trade(folder, module, record)
    trade.point(GIVEN, {})
    return trade


def point_of(trade: Trade, levels: Levels, origin: str = "") -> Setting | None:
    """Return a setting of a trade; None if the scene has not all of the levels."""
    knobs = {knob.name: knob for knob in trade.knobs}
    numbers = {}
    for name, key in levels.items():
        if name not in knobs or knobs[name].level_of(key) is None:
            return None
        numbers[name] = knobs[name].levels.index(knobs[name].level_of(key))
    return trade.point(origin or (next(iter(levels)) if len(levels) == 1 else COMBINED), numbers)


def scenes_of(plan: Plan, trade: Trade) -> dict[str, Mapping[str, Any]]:
    """Return the changes of parameters of all scenes other than that of the trade, by name."""
    variants = {} if plan.elements else trade.module.trading.variants(trade.declared)
    return {**variants, **{FRESH + name: changes for name, changes in plan.fresh.items()}}


def jobs_of(plan: Plan, trade: Trade, timed: bool) -> Iterator[tuple[Setting, int, int]]:
    """Yield setting, seed and order of each run, on the CPU if `timed`, otherwise on the GPU.

    All settings run on the GPU, for their errors. The scene as given and the settings that save time also run on the
    CPU, for their times.
    """
    others = scenes_of(plan, trade)
    candidates = [found for levels in plan.candidates if (found := point_of(trade, levels)) is not None]
    measured = [found for levels in plan.measured if (found := point_of(trade, levels)) is not None]
    reference = point_of(trade, plan.reference, REFERENCE) or trade.given
    if timed:
        seeds = trade.seeds[:1]
        for level, point in enumerate((trade.given, *candidates[: 3 if plan.elements else None])):
            yield point, seeds[0], level
        return
    runs = [(reference, 0), *((carried(trade, reference, *other), 0) for other in others.items()), (trade.given, 0)]
    runs += [(point, 1) for point in candidates]
    runs += [(carried(trade, point, *other), 1) for point in candidates[:CARRIED_ON] for other in others.items()]
    runs += [(point, 2) for point in measured]
    runs += [(carried(trade, trade.given, *other), 0 if plan.elements else 2) for other in others.items()]
    for point, level in runs:
        fresh = [trade.seeds[-1] + 1 + k for k in range(3)] if plan.elements and not point.variant else []
        for seed in [*trade.seeds, *fresh]:
            yield point, seed, level


def carried(trade: Trade, point: Setting, name: str, changes: Mapping[str, Any]) -> Setting:
    """Return a setting in another scene."""
    found = trade.carried(point, name, changes)
    assert found.origin == CARRIED
    return found
