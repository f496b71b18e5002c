"""Pressure that a line of pipes needs, by discrete elements: each kind of part simulated once for each seed.

A straight pipe gives the stress on its wall against the pressure there, which rises with it; a bend or reducer what it
loses over straight pipe beside it. The line is put together from its end, where the pressure is none, to its start.
"""

from __future__ import annotations

import math
import time as wall_clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..core.errors import between, refuse
from ..core.files import write_json
from ..core.method import Method
from ..core.run_loop import Run
from ..core.units import number, quantity
from ..methods import method_of
from ..record.checks import failed_checks
from ..record.loading import load
from ..scenes import modules
from .line_folder import known_run, part_simulation
from .line_run import GRAVITY, folder_name
from .lines import Part, PipeLine

SCENE = "part-dem"
STRAIGHT = 3.0
"""Diameters of straight pipe before and behind a bend or reducer that is simulated, half of a straight pipe's."""
WIDEST = 0.3
"""Of the narrowest bore, up to which all sizes are multiplied."""
STIFFER = 5.0
"""Times the concrete's modulus: soft aggregates are still being pressed together after a travel of many diameters,
and what leaves is less than what enters. Straight pipe of 125 mm loses 9.48 kPa/m with the modulus of Zhan, 1e5 Pa, and
9.55 kPa/m with five times as much."""
PRESSED = "pressed"
"""Straight pipe is simulated twice: behind a plug that hardly holds, and behind one that is pressed against it ..."""
PRESSURE = 0.04
"""... by so much of the modulus, as friction at low pressure alone says too much of that at high."""
SOFT = 0.2
"""Pressure over the modulus above which elements would be pressed into one another, and friction rises no more."""
STEPS = 50
"""In which a part's pressure is summed."""
EVEN = 0.8
"""What leaves a part over what enters it, below which it is told."""
SIZES = ("size_min", "size_max", "size_mean", "size_deviation")


@dataclass(frozen=True, kw_only=True)
class Elements:
    """How parts are simulated by discrete elements."""

    shapes: str = "spheres"
    """As of scene part-dem."""
    coarse: float | None = None
    """All sizes times this; None: until the largest is 0.3 of the narrowest bore."""
    seeds: int = 1
    """Packings of each kind of part, whose scatter is the band."""
    stiffer: float = STIFFER
    """The modulus times this."""

    def __post_init__(self) -> None:
        between("seeds", self.seeds, 1, 100)
        between("stiffer", self.stiffer, 1, 1000)
        if self.coarse is not None:
            between("coarse", self.coarse, 1, 20)


@dataclass(frozen=True)
class WallLaw:
    """Stress on a straight pipe's wall against the pressure there: friction of the stones' push, and a layer's."""

    diameter: float
    """[m]"""
    start: float
    """Stress without pressure [Pa]."""
    slope: float
    """Stress over pressure."""
    measured: float
    """Largest pressure that it was fitted to [Pa]."""
    largest: float
    """Pressure above which it is taken to rise no more [Pa]."""

    @classmethod
    def of(cls, diameter: float, columns: Mapping[str, np.ndarray], largest: float) -> WallLaw:
        """A line through what the stations of a straight pipe have, which Coulomb friction and a layer give."""
        pressure, shear = columns["axial_stress"], columns["wall_stress"]
        here = np.isfinite(pressure)
        slope, start = (float(x) for x in np.polyfit(pressure[here], shear[here], 1))
        return cls(diameter, start, slope, float(pressure[here].max()), largest)

    def gradient(self, pressure: float) -> float:
        """Of the pressure, by friction [Pa/m]."""
        return 4 / self.diameter * max(self.start + self.slope * min(pressure, self.largest), 0.0)


@dataclass(frozen=True)
class Packed:
    """What one seed's runs came to."""

    laws: Mapping[float, WallLaw]
    """By the diameter [m]."""
    ratios: Mapping[tuple[Any, ...], float]
    """Of each kind of bend or reducer: its loss over straight pipe's."""
    density: float
    """Of what fills the pipe, as the elements weigh it [kg/m3]."""

    def ratio(self, part: Part) -> float:
        """What a part loses over straight pipe."""
        return self.ratios.get(part.alike, part.curving)

    def course(self, line: PipeLine) -> list[tuple[float, float]]:
        """Friction and weight of each part of a line [Pa], from its start to its end."""
        pressure, found = 0.0, []
        for part in reversed(line.parts):
            friction = 0.0
            weight = self.density * GRAVITY * part.rise
            ratio = self.ratio(part)
            step = part.length / STEPS
            for place in range(STEPS):
                # From the part's end on, by the gradient in the middle of each step.
                along = 1 - (place + 0.5) / STEPS
                there = pressure + friction + weight * (1 - along)
                ahead = there + 0.5 * step * ratio * self._gradient(part, along, there)
                friction += step * ratio * self._gradient(part, along, ahead)
            pressure += friction + weight
            found.append((friction, weight))
        return found[::-1]

    def _gradient(self, part: Part, along: float, pressure: float) -> float:
        """Of straight pipe as wide as a part at this fraction of its length [Pa/m]."""
        begin, end = (self.laws[diameter].gradient(pressure) for diameter in (part.diameter, part.outlet))
        return along * end + (1 - along) * begin


@dataclass(repr=False)
class ElementLine:
    """What a line needs at its start, by discrete elements."""

    line: PipeLine
    concrete: str
    flow: float
    """[m3/s]"""
    packed: list[Packed]
    """One for each seed."""
    remarks: list[str]
    took: dict[str, float] = field(default_factory=dict)
    """Wall time of each simulation that was run, beside others [s], by its folder's name."""
    elapsed: float = 0.0
    """Wall time of all of them, packing included [s]."""
    failed: dict[str, list[str]] = field(default_factory=dict)
    """Checks that simulations failed, and what they found, likewise."""

    def __repr__(self) -> str:
        return f"<ElementLine of '{self.line.name}': {self.pressure / 1e5:.4g} bar at {3600 * self.flow:.4g} m3/h>"

    @property
    def pressures(self) -> list[float]:
        """At the start of the line, of each seed [Pa]."""
        return [sum(map(sum, each.course(self.line))) for each in self.packed]

    @property
    def pressure(self) -> float:
        """Their mean [Pa]."""
        return float(np.mean(self.pressures))

    def frictions(self) -> np.ndarray:
        """Of the parts, means over the seeds [Pa], shape (parts,)."""
        return np.mean([[friction for friction, _ in each.course(self.line)] for each in self.packed], axis=0)

    def weights(self) -> np.ndarray:
        """Likewise."""
        return np.mean([[weight for _, weight in each.course(self.line)] for each in self.packed], axis=0)

    def record(self) -> dict[str, Any]:
        """As line-dem.json has it."""
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
                 "weight": quantity(weight, "Pa"), "ratios": [each.ratio(part) for each in self.packed]}
                for part, friction, weight in zip(self.line.parts, self.frictions(), self.weights(), strict=True)
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
    """Pressure that a `line` needs at a `flow` [m3/s] of a `concrete`, by its name or file, by discrete elements.

    Each kind of part is simulated without weight, all of them side by side where the device does that; runs go into
    `out`, where those that were cut go on, and those in `known`, the folder of an earlier line, are taken. Raises
    :class:`SceneError` for settings that make no scene, and the error of the first run that ended in one.
    """
    elements = elements or Elements()
    if known is not None and not (known / "parts").is_dir():
        refuse(
            "known",
            str(known),
            "is not the folder of a line with simulated parts",
            "give one that contains a folder 'parts'",
        )
    kinds = dict(_kinds(line))
    jobs = []
    for seed in range(elements.seeds):
        for key, part in kinds.items():
            own = _parameters(part, key[-1] == PRESSED, line, concrete, flow, elements, seed)
            jobs.append((key, seed, modules()[SCENE].scene(**own)))
    runs: dict[tuple[Any, int], Any] = {}
    new = []
    for key, seed, scene in jobs:
        mesh = kinds[key].mesh
        folder = known_run((out, known), scene, mesh.digest if mesh else "")
        if folder is None:
            new.append((key, seed, scene))
        else:
            runs[key, seed] = load(folder)
    began = wall_clock.perf_counter()
    took = _simulate(new, kinds, runs, out, device, threads, progress)
    elapsed = wall_clock.perf_counter() - began
    packed = [_packed(kinds, {key: runs[key, seed] for key in kinds}) for seed in range(elements.seeds)]
    failed = {}
    for (key, seed), run in runs.items():
        if bad := failed_checks(run.result):
            failed[_called(key, kinds[key], seed)] = [f"{name}: {run.result['checks'][name]['found']}" for name in bad]
    found = ElementLine(line, concrete, flow, packed, [], took, elapsed, failed)
    found.remarks = list(_remarks(found, runs, kinds))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        write_json(out / "line-dem.json", found.record())
    return found


def _kinds(line: PipeLine) -> Iterator[tuple[tuple[Any, ...], Part]]:
    """Kinds of parts, and straight pipe of every diameter."""
    for part in line.parts:
        if not part.by_length:
            yield part.alike, part
        for diameter in (part.diameter, part.outlet):
            straight = Part(part.number, "straight", diameter, 1.0, 0.0, diameter)
            yield straight.alike, straight
            yield (*straight.alike, PRESSED), straight


def _parameters(
    part: Part, pressed: bool, line: PipeLine, concrete: str, flow: float, elements: Elements, seed: int
) -> dict[str, Any]:
    """Of the scene of a kind of part, without weight."""
    wide = max(part.diameter, part.outlet)
    own: dict[str, Any] = {"concrete": concrete, "diameter": part.diameter, "flow": flow, "gravity": 0.0,
                           "straight": STRAIGHT * wide, "travel": 2 * part.diameter, "seed": seed,
                           "shapes": elements.shapes, "sample_interval": 0.02}  # fmt: skip
    if part.kind == "bend":
        own |= {"unit": "bend-level", "angle": max(part.angle, 5.0), "elbow_radius": part.radius}
    else:
        own |= {"unit": "horizontal"}
        if part.kind == "reducer":
            own |= {"outlet_diameter": part.outlet, "taper": part.length}
        if part.mesh:
            own |= {"unit": "mesh", "wall": part.mesh.file, "wall_scale": part.mesh.scale}
    own = sized(own, min(each.narrow for each in line.parts), elements)
    if pressed:
        own["plug_pressure"] = PRESSURE * own["modulus"]
    return own


def sized(own: Mapping[str, Any], narrowest: float, elements: Elements) -> dict[str, Any]:
    """Parameters of a part's scene with its sizes and modulus as `elements` has them, for a `narrowest` bore [m]."""
    given = modules()[SCENE].scene.declared(dict(own))
    whole = {**own, "modulus": elements.stiffer * given.modulus}
    ranged = given.sizes in ("gaussian", "uniform")
    sieve = [] if ranged else [entry.split(":") for entry in given.sizes.split(",")]
    least, most = (given.size_min, given.size_max) if ranged else (1e-3 * float(sieve[k][0]) for k in (0, -1))
    factor = elements.coarse or max(1.0, WIDEST * narrowest / most)
    # The plug's balls, which are small, would set the time step.
    whole["plug_ball"] = max(factor * given.plug_ball, min(factor * least, narrowest / 5))
    if not ranged:
        return whole | {"sizes": ",".join(f"{factor * float(opening):g}:{passing}" for opening, passing in sieve)}
    return whole | {name: factor * getattr(given, name) for name in SIZES if getattr(given, name) is not None}


def _called(key: tuple[Any, ...], part: Part, seed: int) -> str:
    return f"{folder_name(part)}{'-pressed' if key[-1] == PRESSED else ''}-dem-seed-{seed}"


def _simulate(
    jobs: Sequence[tuple[Any, int, Any]], kinds: Mapping[Any, Part], runs: dict[tuple[Any, int], Any],
    out: Path | None, device: str | None, threads: int | None, progress: Callable[[str, float], None] | None,
) -> dict[str, float]:  # fmt: skip
    """Run what is not there yet, enter it in `runs`, and return how long each took [s]."""
    simulations, checkpoints = [], []
    for key, seed, scene in jobs:
        part = kinds[key]
        simulation, checkpoint = part_simulation(
            scene, modules()[SCENE].check, out, _called(key, part, seed), part.mesh.digest if part.mesh else "",
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
        took[_called(key, kinds[key], seed)] = number(outcome.result["speed"]["wall_time"])
    return took


def _packed(kinds: Mapping[Any, Part], runs: Mapping[Any, Run]) -> Packed:
    tables: dict[float, list[Mapping[str, np.ndarray]]] = {}
    ratios, densities, largest = {}, [], 0.0
    for key, part in kinds.items():
        run = runs[key]
        if part.by_length:
            columns = run.tables["stations"].columns
            if np.count_nonzero(np.isfinite(columns["axial_stress"])) < 3:
                refuse(
                    "part",
                    part.label,
                    "must contain more slices that are full of aggregates, to measure its "
                    "pressure loss; make the part longer",
                )
            tables.setdefault(part.diameter, []).append(columns)
            densities.append(float(np.nanmean(columns["bulk_density"])))
            largest = SOFT * run.scene.parameters["modulus"]
        elif "middle_ratio" not in run.result:
            refuse(
                "part",
                part.label,
                "must contain more slices that are full of aggregates, to measure its "
                "pressure loss; make the part longer",
            )
        else:
            ratios[key] = number(run.result["middle_ratio"])
    laws = {}
    for diameter, found in tables.items():
        joined = {name: np.concatenate([columns[name] for columns in found]) for name in found[0]}
        laws[diameter] = WallLaw.of(diameter, joined, largest)
    return Packed(laws, ratios, float(np.mean(densities)))


def _remarks(found: ElementLine, runs: Mapping[tuple[Any, int], Run], kinds: Mapping[Any, Part]) -> Iterator[str]:
    """What a reader should know: of the line, of failed checks, and what the runs do not cover."""
    yield from found.line.remarks()
    if any(part.layer != 1 for part in found.line.parts):
        yield "the slip layer of a hose is treated as that of a pipe"
    for name, bad in found.failed.items():
        yield from (f"check FAILED in {name}: {what}" for what in bad)
    for (key, seed), run in runs.items():
        ratio = run.result.get("flux_ratio")
        if ratio is not None and number(ratio) < EVEN:
            name = _called(key, kinds[key], seed)
            yield (
                f"{name}: outflow is {100 * number(ratio):.0f} % of the inflow; the concrete is still being compressed"
            )
    laws = [law for each in found.packed for law in each.laws.values()]
    measured, largest = max(law.measured for law in laws), min(law.largest for law in laws)
    if found.pressure > 1.2 * measured:
        yield (f"friction above {measured / 1e3:.3g} kPa is extrapolated from the measured range"
               + (f", and constant above {largest / 1e3:.3g} kPa" if found.pressure > largest else ""))  # fmt: skip


def lines_of_elements(found: ElementLine, others: Mapping[str, Sequence[float]]) -> list[str]:
    """Headline and a table of the parts as text; `others` are frictions by other ways [Pa], a column each."""
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
        + "relative to straight pipe | weight [kPa] |",
        "|" + "---|" * (5 + len(others)),
    ]
    rows = zip(found.line.parts, found.frictions(), found.weights(), strict=True)
    for place, (part, friction, weight) in enumerate(rows):
        ratios = [each.ratios[part.alike] for each in found.packed if part.alike in each.ratios]
        shown = f"{np.mean(ratios):.2f}" if ratios else ""
        if len(ratios) > 1:
            shown += f" ± {np.std(ratios, ddof=1) / math.sqrt(len(ratios)):.2f}"
        cells = [f"{part.number}", part.label, f"{friction / 1e3:.4g}"]
        cells += [f"{each[place] / 1e3:.4g}" for each in others.values()]
        text.append(f"| {' | '.join([*cells, shown, f'{weight / 1e3:.4g}'])} |")
    return text
