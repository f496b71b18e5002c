"""Pressure of a pump line by discrete elements: each kind of part is simulated once for every seed.

A straight pipe yields the shear stress on its wall as a function of the local pressure. A bend or reducer yields its
friction relative to that of straight pipe. The pressure along the line follows by integration from its end, where the
pressure is zero, to its start.
"""

from __future__ import annotations

import math
import time as wall_clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import between, refuse
from ...core.run.files import write_json
from ...core.run.method import Method
from ...core.run.run_loop import Run
from ...core.units import number, quantity
from ...methods import method_of
from ...record.checks import failed_checks
from ...record.loading import load
from ...scenes import modules
from .folder import part_simulation, previous_run
from .losses import Part, PipeLine
from .run import GRAVITY, folder_name

SCENE = "part-dem"
STRAIGHT_DIAMETERS = 3.0
"""Length of straight pipe before a simulated bend or reducer, and of as much behind it [diameters]. A straight pipe is
simulated with the same two lengths, one after the other."""
LARGEST_STONE_RATIO = 0.3
"""Largest stone divided by the narrowest bore of the line. Smaller stones are enlarged to this ratio by default, so
that fewer elements have to be simulated."""
MODULUS_FACTOR = 5.0
"""Default factor on the elastic modulus of the concrete.

Soft aggregates are still being compressed after they have travelled many pipe diameters, so that less concrete leaves a
part of the line than enters it. The factor hardly changes the pressure. In straight pipe of 125 mm the loss is 9.48
kPa/m with the modulus of Zhan et al. (1e5 Pa), and 9.55 kPa/m with five times that modulus.
"""
PRESSED_RUN = "pressed"
"""Last entry in the keys of runs that belong to the second simulation of straight pipe.

In this simulation, a plug at the outlet presses against the concrete. In the first simulation, the plug hardly resists,
so that the pressure remains low. A friction law fitted to these low pressures alone would overestimate the friction at
high pressure.
"""
PLUG_PRESSURE_RATIO = 0.04
"""Pressure of the plug at the pipe's outlet in the second simulation of straight pipe, divided by the elastic modulus
of the elements. With this pressure the plug resists the flow."""
CONSTANT_FRICTION_RATIO = 0.2
"""Ratio of pressure to modulus above which wall friction is assumed constant, because overlaps become large."""
STEPS = 50
"""Number of intervals into which a part is divided to integrate the pressure along it."""
MIN_FLUX_RATIO = 0.8
"""Ratio of outflow to inflow of solids below which a remark warns the user that the concrete is still being
compressed."""
SIZE_PARAMETERS = ("size_min", "size_max", "size_mean", "size_deviation")


@dataclass(frozen=True, kw_only=True)
class Elements:
    """Settings for simulating the parts of a line by discrete elements."""

    shapes: str = "spheres"
    """Shapes of the discrete elements, in the words of the parameter `shapes` of the scene part-dem."""
    coarse: float | None = None
    """Factor by which all stone sizes are multiplied. With None, stones are enlarged until the largest has 0.3 times
    the narrowest bore; larger stones keep their size."""
    seeds: int = 1
    """Number of simulations of each kind of part, each with another random packing of the stones. The scatter of their
    results gives the range of the pressure."""
    stiffer: float = MODULUS_FACTOR
    """Factor by which the elastic modulus of the concrete is multiplied in the simulations."""

    def __post_init__(self) -> None:
        between("seeds", self.seeds, 1, 100)
        between("stiffer", self.stiffer, 1, 1000)
        if self.coarse is not None:
            between("coarse", self.coarse, 1, 20)


@dataclass(frozen=True)
class WallLaw:
    """Linear law of the shear stress on a straight pipe's wall: stress = start + slope * pressure.

    The slope is due to Coulomb friction of the aggregates, and the constant term to the lubrication layer.
    """

    diameter: float
    """Inner diameter of the pipe [m]."""
    start: float
    """Wall stress at zero pressure [Pa], which is the share of the lubrication layer in the friction."""
    slope: float
    """Slope of the law: increase of the wall stress [Pa] per increase of the pressure [Pa]."""
    measured: float
    """Largest pressure in the measurements to which the law was fitted [Pa]."""
    largest: float
    """Pressure from which on the wall stress is assumed constant [Pa], because overlaps of the elements become
    large."""

    @classmethod
    def of(cls, diameter: float, columns: Mapping[str, np.ndarray], largest: float) -> WallLaw:
        """Fit the law to the stresses measured in slices of a straight pipe of the given `diameter` [m].

        The law is a straight line of the stress on the wall over the pressure. `columns` holds the arrays
        `axial_stress`, which serves as the pressure, and `wall_stress` [Pa].
        """
        pressure, shear = columns["axial_stress"], columns["wall_stress"]
        here = np.isfinite(pressure)
        slope, start = (float(x) for x in np.polyfit(pressure[here], shear[here], 1))
        return cls(diameter, start, slope, float(pressure[here].max()), largest)

    def gradient(self, pressure: float) -> float:
        """Return the pressure loss by friction per metre of pipe [Pa/m]."""
        return 4 / self.diameter * max(self.start + self.slope * min(pressure, self.largest), 0.0)


@dataclass(frozen=True)
class SeedResult:
    """Results of all simulated parts for one seed."""

    laws: Mapping[float, WallLaw]
    """Laws for the wall friction of straight pipe; the keys are the pipe's diameters [m]."""
    ratios: Mapping[tuple[Any, ...], float]
    """Friction of each kind of bend or reducer, divided by that of straight pipe of the same length."""
    density: float
    """Bulk density of the elements that fill the pipe [kg/m3]."""
    blocked: Mapping[tuple[Any, ...], bool] = field(default_factory=dict)
    """True for each kind of part whose simulation was blocked."""

    def is_blocked(self, part: Part) -> bool:
        """Return whether the simulation of the part, or of a straight pipe of its diameter, was blocked."""
        return any(found for key, found in self.blocked.items() if key[: len(part.loss_key)] == part.loss_key)

    def ratio(self, part: Part) -> float:
        """Return a part's friction divided by that of straight pipe of the same length."""
        return part.factor if part.factor is not None else self.ratios.get(part.loss_key, part.relative_loss)

    def course(self, line: PipeLine) -> list[tuple[float, float]]:
        """Return the friction and the weight of each part of a line [Pa], as pairs from its start to its end."""
        pressure, found = 0.0, []
        for part in reversed(line.parts):
            friction = 0.0
            weight = self.density * GRAVITY * part.rise
            ratio = self.ratio(part)
            step = part.length / STEPS
            for place in range(STEPS):
                # Integrate from the part's end towards its start with the midpoint rule.
                along = 1 - (place + 0.5) / STEPS
                there = pressure + friction + weight * (1 - along)
                ahead = there + 0.5 * step * ratio * self._gradient(part, along, there)
                friction += step * ratio * self._gradient(part, along, ahead)
            pressure += friction + weight
            found.append((friction, weight))
        return found[::-1]

    def _gradient(self, part: Part, along: float, pressure: float) -> float:
        """Return the friction of straight pipe at a fraction `along` of a part's length [Pa/m]."""
        begin, end = (self.laws[diameter].gradient(pressure) for diameter in (part.diameter, part.outlet))
        return along * end + (1 - along) * begin


@dataclass(repr=False)
class ElementLine:
    """Pressure losses of a pump line, computed by the discrete element method."""

    line: PipeLine
    concrete: str
    flow: float
    """Flow rate for which the pressure of the line is calculated [m3/s]."""
    packed: list[SeedResult]
    """Results of the simulated parts, one entry for each seed."""
    remarks: list[str]
    took: dict[str, float] = field(default_factory=dict)
    """Wall time of each new simulation [s], by the name of its folder. If simulations run on the device at the same
    time, their wall times overlap."""
    elapsed: float = 0.0
    """Wall time of all new simulations together, including packing [s]."""
    failed: dict[str, list[str]] = field(default_factory=dict)
    """Failed checks of the simulations with their findings, by folder name."""

    def __repr__(self) -> str:
        return f"<ElementLine of '{self.line.name}': {self.pressure / 1e5:.4g} bar at {3600 * self.flow:.4g} m3/h>"

    @property
    def pressures(self) -> list[float]:
        """Pressures at the start of the line, one for each seed [Pa]."""
        return [sum(map(sum, each.course(self.line))) for each in self.packed]

    @property
    def pressure(self) -> float:
        """Pressure at the start of the line, averaged over the seeds [Pa]."""
        return float(np.mean(self.pressures))

    def frictions(self) -> np.ndarray:
        """Return the pressure loss of each part due to friction, averaged over the seeds [Pa], shape (parts,)."""
        return np.mean([[friction for friction, _ in each.course(self.line)] for each in self.packed], axis=0)

    def weights(self) -> np.ndarray:
        """Return the pressure due to the concrete's weight in each part [Pa], a mean over the seeds, shape (parts,)."""
        return np.mean([[weight for _, weight in each.course(self.line)] for each in self.packed], axis=0)

    def blocked(self) -> list[int]:
        """Return for each part of the line the number of seeds with which its simulation was blocked."""
        return [sum(each.is_blocked(part) for each in self.packed) for part in self.line.parts]

    def record(self) -> dict[str, Any]:
        """Return the contents of line-dem.json."""
        return {
            "line": self.line.name,
            "concrete": self.concrete,
            "flow": quantity(self.flow, "m3/s"),
            "pressure": quantity(self.pressure, "Pa"),
            "pressures": {f"seed {k}": quantity(p, "Pa") for k, p in enumerate(self.pressures)},
            "remarks": self.remarks,
            "failed_checks": self.failed,
            "parts": [
                {"number": part.number, "what": part.label, "friction": quantity(friction, "Pa"),
                 "weight": quantity(weight, "Pa"), "ratios": [each.ratio(part) for each in self.packed],
                 "blocked_seeds": blocked}
                for part, friction, weight, blocked in zip(
                    self.line.parts, self.frictions(), self.weights(), self.blocked(), strict=True
                )
            ],
            "wall_time": {name: quantity(time, "s") for name, time in self.took.items()},
            "elapsed": quantity(self.elapsed, "s"),
        }  # fmt: skip


def run_elements(
    line: PipeLine,
    concrete: str,
    flow: float,
    *,
    elements: Elements | None = None,
    out: Path | None = None,
    known: Path | None = None,
    device: str | None = None,
    threads: int | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> ElementLine:
    """Compute the pressure that a `line` needs at a `flow` [m3/s] of a `concrete` by discrete elements.

    `concrete` is a name or a file. Each kind of part is simulated without weight, and on a GPU all parts run together.
    The runs are stored in `out`, where interrupted runs continue. Finished runs in `known`, the folder of an earlier
    line, are reused. Raises :class:`SceneError` for impossible settings, and the error of the first run that failed.
    """
    elements = elements or Elements()
    if known is not None and not (known / "parts").is_dir():
        refuse(
            "known",
            str(known),
            "is not the folder of a line with simulated parts",
            "give the folder of an earlier 'warpcrete line', which contains a folder 'parts'",
        )
    kinds = dict(_kinds(line))
    jobs = []
    for seed in range(elements.seeds):
        for key, part in kinds.items():
            own = part_parameters(part, key[-1] == PRESSED_RUN, line, concrete, flow, elements, seed)
            jobs.append((key, seed, modules()[SCENE].scene(**own)))
    runs: dict[tuple[Any, int], Any] = {}
    new = []
    for key, seed, scene in jobs:
        mesh = kinds[key].mesh
        folder = previous_run((out, known), scene, mesh.digest if mesh else "")
        if folder is None:
            new.append((key, seed, scene))
        else:
            runs[key, seed] = load(folder)
    began = wall_clock.perf_counter()
    took = _simulate(new, kinds, runs, out, device, threads, progress)
    elapsed = wall_clock.perf_counter() - began
    packed = [_seed_result(kinds, {key: runs[key, seed] for key in kinds}) for seed in range(elements.seeds)]
    failed = {}
    for (key, seed), run in runs.items():
        if bad := failed_checks(run.result):
            failed[_run_name(key, kinds[key], seed)] = [
                f"{name}: {run.result['checks'][name]['found']}" for name in bad
            ]
    found = ElementLine(line, concrete, flow, packed, [], took, elapsed, failed)
    found.remarks = list(_remarks(found, runs, kinds))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        write_json(out / "line-dem.json", found.record())
    return found


def _kinds(line: PipeLine) -> Iterator[tuple[tuple[Any, ...], Part]]:
    """Yield each kind of part that needs a simulation, as its key and an example part.

    Straight pipe is needed at every diameter of the line, once with and once without a pressing plug
    (:data:`PRESSED_RUN`). Parts whose friction the line's file states need no simulation of their own.
    """
    for part in line.parts:
        if not part.is_by_length and part.factor is None:
            yield part.loss_key, part
        for diameter in (part.diameter, part.outlet):
            straight = Part(part.number, "straight", diameter, 1.0, 0.0, diameter)
            yield straight.loss_key, straight
            yield (*straight.loss_key, PRESSED_RUN), straight


def part_parameters(
    part: Part, pressed: bool, line: PipeLine, concrete: str, flow: float, elements: Elements, seed: int
) -> dict[str, Any]:
    """Return the parameters of the scene that simulates a part by discrete elements, without weight."""
    wide = max(part.diameter, part.outlet)
    own: dict[str, Any] = {"concrete": concrete, "diameter": part.diameter, "flow": flow, "gravity": 0.0,
                           "straight": STRAIGHT_DIAMETERS * wide, "travel": 2 * part.diameter, "seed": seed,
                           "shapes": elements.shapes, "sample_interval": 0.02}  # fmt: skip
    if part.kind == "bend":
        own |= {"unit": "bend-level", "angle": max(part.angle, 5.0), "elbow_radius": part.radius}
    else:
        own |= {"unit": "horizontal"}
        if part.kind == "reducer":
            own |= {"outlet_diameter": part.outlet, "taper": part.length}
        if part.mesh:
            own |= {"unit": "mesh", "wall": part.mesh.file, "wall_scale": part.mesh.scale}
    own = scaled_parameters(own, min(each.narrow for each in line.parts), elements)
    if pressed:
        own["plug_pressure"] = PLUG_PRESSURE_RATIO * own["modulus"]
    return own


def scaled_parameters(own: Mapping[str, Any], narrowest: float, elements: Elements) -> dict[str, Any]:
    """Return the parameters for the scene of a line's part, with scaled stone sizes and a scaled elastic modulus.

    `own` holds the parameters before scaling, `narrowest` is the narrowest bore of the pump line [m], and `elements`
    states the factors.
    """
    given = modules()[SCENE].scene.declared(dict(own))
    whole = {**own, "modulus": elements.stiffer * given.modulus}
    ranged = given.sizes in ("gaussian", "uniform")
    sieve = [] if ranged else [entry.split(":") for entry in given.sizes.split(",")]
    least, most = (given.size_min, given.size_max) if ranged else (1e-3 * float(sieve[k][0]) for k in (0, -1))
    factor = elements.coarse or max(1.0, LARGEST_STONE_RATIO * narrowest / most)
    # The plug in the pipe consists of balls. They are enlarged together with the aggregate, because small balls would
    # limit the time step.
    whole["plug_ball"] = max(factor * given.plug_ball, min(factor * least, narrowest / 5))
    if not ranged:
        return whole | {"sizes": ",".join(f"{factor * float(opening):g}:{passing}" for opening, passing in sieve)}
    return whole | {name: factor * getattr(given, name) for name in SIZE_PARAMETERS if getattr(given, name) is not None}


def _run_name(key: tuple[Any, ...], part: Part, seed: int) -> str:
    return f"{folder_name(part)}{'-pressed' if key[-1] == PRESSED_RUN else ''}-dem-seed-{seed}"


def _simulate(
    jobs: Sequence[tuple[Any, int, Any]], kinds: Mapping[Any, Part], runs: dict[tuple[Any, int], Any],
    out: Path | None, device: str | None, threads: int | None, progress: Callable[[str, float], None] | None,
) -> dict[str, float]:  # fmt: skip
    """Run the `jobs`, store their runs in the mapping `runs`, and return the wall times [s].

    A key of `runs` is a pair of a kind of part and a seed. A key of the result is the name of a run's folder.
    """
    simulations, checkpoints = [], []
    for key, seed, scene in jobs:
        part = kinds[key]
        simulation, checkpoint = part_simulation(
            scene, modules()[SCENE].check, out, _run_name(key, part, seed), part.mesh.digest if part.mesh else "",
            device=device, threads=threads,
        )  # fmt: skip
        simulations.append(simulation)
        checkpoints.append(checkpoint)
    if not simulations:
        return {}
    method: Method = method_of(simulations[0].scene)
    outcomes = method.run_many(simulations, checkpoints, progress or (lambda phase, fraction: None))
    took = {}
    for (key, seed, _), outcome in zip(jobs, outcomes, strict=True):
        if isinstance(outcome, BaseException):
            raise outcome
        if not outcome.finished:
            raise KeyboardInterrupt
        runs[key, seed] = outcome
        took[_run_name(key, kinds[key], seed)] = number(outcome.result["speed"]["wall_time"])
    return took


def _seed_result(kinds: Mapping[Any, Part], runs: Mapping[Any, Run]) -> SeedResult:
    tables: dict[float, list[Mapping[str, np.ndarray]]] = {}
    ratios, densities, largest = {}, [], 0.0
    for key, part in kinds.items():
        run = runs[key]
        if part.is_by_length:
            columns = run.tables["stations"].columns
            if np.count_nonzero(np.isfinite(columns["axial_stress"])) < 3:
                refuse(
                    "part",
                    part.label,
                    "is too short to measure its pressure loss, because too few slices are full of "
                    "aggregates; make the part longer",
                )
            tables.setdefault(part.diameter, []).append(columns)
            densities.append(float(np.nanmean(columns["bulk_density"])))
            largest = CONSTANT_FRICTION_RATIO * run.scene.parameters["modulus"]
        elif "middle_ratio" not in run.result:
            refuse(
                "part",
                part.label,
                "is too short to measure its pressure loss, because too few slices are full of "
                "aggregates; make the part longer",
            )
        else:
            ratios[key] = number(run.result["middle_ratio"])
    laws = {}
    for diameter, found in tables.items():
        joined = {name: np.concatenate([columns[name] for columns in found]) for name in found[0]}
        laws[diameter] = WallLaw.of(diameter, joined, largest)
    blocked = {key: bool(runs[key].result.get("blocked")) for key in kinds}
    return SeedResult(laws, ratios, float(np.mean(densities)), blocked)


def _remarks(found: ElementLine, runs: Mapping[tuple[Any, int], Run], kinds: Mapping[Any, Part]) -> Iterator[str]:
    """Yield remarks for the user about the line itself, failed checks, and limits of the simulations."""
    yield from found.line.remarks()
    if any(part.layer != 1 for part in found.line.parts):
        yield "the slip layer of a hose is treated as that of a pipe"
    for name, bad in found.failed.items():
        yield from (f"check FAILED in {name}: {what}" for what in bad)
    for (key, seed), run in runs.items():
        ratio = run.result.get("flux_ratio")
        if ratio is not None and number(ratio) < MIN_FLUX_RATIO:
            name = _run_name(key, kinds[key], seed)
            yield (
                f"{name}: outflow is {100 * number(ratio):.0f} % of the inflow; the concrete is still being compressed"
            )
    for part, blocked in zip(found.line.parts, found.blocked(), strict=True):
        if blocked:
            yield (f"BLOCKED: part {part.number}, {part.label}, with {blocked} of {len(found.packed)} seeds; the "
                   "pressure of the line means nothing then")  # fmt: skip
    if not any(found.blocked()):
        yield "not blocked: no simulated part was blocked"
    laws = [law for each in found.packed for law in each.laws.values()]
    measured, largest = max(law.measured for law in laws), min(law.largest for law in laws)
    if found.pressure > 1.2 * measured:
        yield (
            f"wall friction at pressures above {measured / 1e3:.3g} kPa is extrapolated from lower pressures"
            + (f", and taken as constant above {largest / 1e3:.3g} kPa" if found.pressure > largest else "")
        )


def element_table_lines(found: ElementLine, others: Mapping[str, Sequence[float]]) -> list[str]:
    """Return a headline and a table of the parts of a pump line, as lines of Markdown.

    `others` maps the name of each other method, such as the closed form, to the friction [Pa] that it predicts for each
    part. The table has one column for each of these methods.
    """
    low, high = min(found.pressures), max(found.pressures)
    span = f"; {low / 1e5:.4g} to {high / 1e5:.4g} bar over {len(found.packed)} seeds" if len(found.packed) > 1 else ""
    text = [
        f"**{found.line.name}** by discrete elements: {found.concrete} at {3600 * found.flow:.4g} m3/h",
        "",
        f"- pressure at the pump {found.pressure / 1e5:.4g} bar{span}",
        *(f"- {remark}" for remark in found.remarks),
        "",
        "| part | | friction, elements [kPa] | "
        + "".join(f"{name} [kPa] | " for name in others)
        + "relative to straight pipe | weight [kPa] | blocked |",
        "|" + "---|" * (6 + len(others)),
    ]
    rows = zip(found.line.parts, found.frictions(), found.weights(), found.blocked(), strict=True)
    for place, (part, friction, weight, blocked) in enumerate(rows):
        ratios = [
            each.ratios[part.loss_key] for each in found.packed if part.loss_key in each.ratios and part.factor is None
        ]
        shown = f"{np.mean(ratios):.2f}" if ratios else ""
        if len(ratios) > 1:
            shown += f" ± {np.std(ratios, ddof=1) / math.sqrt(len(ratios)):.2f}"
        cells = [f"{part.number}", part.label, f"{friction / 1e3:.4g}"]
        cells += [f"{each[place] / 1e3:.4g}" for each in others.values()]
        stuck = f"{blocked} of {len(found.packed)} seeds" if blocked else "no"
        text.append(f"| {' | '.join([*cells, shown, f'{weight / 1e3:.4g}', stuck])} |")
    return text
