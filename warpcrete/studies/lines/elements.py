"""Pressure of a pump line by discrete elements: each kind of part is simulated once for every seed.

A straight pipe yields the shear stress on its wall as a function of the local pressure. A bend or reducer yields the
ratio of its friction to the friction of straight pipe. The pressure along the line follows by integration from its end,
where the pressure is zero, to its start.
"""

import time as wall_clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import between, refuse
from ...core.inputs.customary import both
from ...core.records import SceneArguments
from ...core.run.files import write_json
from ...core.run.method import Method
from ...core.run.run import Run
from ...core.units import number
from ...dem.scene.checks import OUTFLOW_CHECK
from ...geometry.pipe_line import Part, PipeLine
from ...methods import method_of
from ...record.checks import failed_checks
from ...record.loading import load
from ...scenes import modules
from .element_line import ElementLine, SeedResult, WallLaw
from .folder import check_known, part_simulation, previous_run
from .run import folder_name

SCENE = "part-dem"
STRAIGHT_DIAMETERS = 3.0
"""Length of the straight pipe before a simulated bend or reducer, divided by the larger of the part's diameters. The
straight pipe behind the part has the same length. The simulations of straight pipe consist of two such lengths."""
LARGEST_STONE_RATIO = 0.3
"""Smallest ratio of the largest stone's diameter to the narrowest bore of the line in a simulation. If the stones are
smaller, they are by default enlarged to this ratio, so that fewer elements have to be simulated."""
PRESSED_RUN = "pressed"
"""Last entry in the keys of runs that belong to the second simulation of straight pipe.

In this simulation, the movable plug that closes the outlet presses against the concrete. In the first simulation, the
plug hardly resists, so that the pressure remains low. A friction law fitted only to these low pressures would
overestimate the friction at high pressure.
"""
PLUG_PRESSURE_RATIO = 0.04
"""Pressure of the plug that closes the pipe's outlet in the second simulation of straight pipe, divided by the elastic
modulus of the elements. With this pressure the plug resists the flow."""
CONSTANT_FRICTION_RATIO = 0.2
"""Ratio of pressure to elastic modulus above which the wall friction is assumed constant, because the linear friction
law is not valid for the large overlaps of elements at such pressures."""
TOO_SHORT = "is too short to measure its pressure loss: elements fill too few of the slices in which it is measured"
"""Problem stated in the error message for a part whose simulation gives no pressure loss."""
SIZE_PARAMETERS = ("size_min", "size_max", "size_mean", "size_deviation")


@dataclass(frozen=True, kw_only=True)
class Elements:
    """Settings for simulating the parts of a line by discrete elements."""

    shapes: str = "spheres"
    """Shapes of the discrete elements, with the same names as in the parameter `shapes` of the scene part-dem."""
    coarse: float | None = None
    """Factor by which all stone sizes are multiplied. If the value is None, the factor is chosen so that the largest
    stone is 0.3 times as wide as the narrowest bore; stones that are already that large keep their sizes."""
    seeds: int = 1
    """Number of simulations of each kind of part. Each simulation has another random packing of the stones, and the
    scatter of the results gives the range of the pressure."""
    stiffer: float = 1.0
    """Factor by which the elastic modulus of the concrete's elements is multiplied in the simulations."""

    def __post_init__(self) -> None:
        between("seeds", self.seeds, 1, 100)
        between("stiffer", self.stiffer, 1, 1000)
        if self.coarse is not None:
            between("coarse", self.coarse, 1, 20)


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

    `concrete` is a name or a file. Each kind of part is simulated without gravity; on a GPU, all simulations run at the
    same time. The runs are stored in the folder `out`, and interrupted runs in this folder continue. Finished runs in
    `known`, the folder of an earlier line, are reused. Raises :class:`SceneError` for impossible settings, and the
    error of the first run that failed.
    """
    elements = elements or Elements()
    check_known(known)
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
    failed, compressed = {}, []
    for (key, seed), run in runs.items():
        name = _run_name(key, kinds[key], seed)
        bad = {check: run.result["checks"][check]["found"] for check in failed_checks(run.result)}
        # Less outflow than inflow means that the aggregates of the part are still being compressed at the end of the
        # run. For a line, this is only worth a remark.
        if OUTFLOW_CHECK in bad and number(run.result["flux_ratio"]) < 1:
            compressed.append(f"{name}: {bad.pop(OUTFLOW_CHECK)}")
        if bad:
            failed[name] = [f"{check}: {found}" for check, found in bad.items()]
    result = ElementLine(line, concrete, flow, packed, [], took, elapsed, failed)
    result.remarks = [*_remarks(result), *compressed]
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        write_json(out / "line-dem.json", result.record())
    return result


def _kinds(line: PipeLine) -> Iterator[tuple[tuple[Any, ...], Part]]:
    """Yield each kind of part that needs a simulation, as a pair of a key and one part of this kind.

    Straight pipe is simulated twice for every diameter that occurs in the line. In the second simulation, a movable
    plug at the outlet presses against the concrete (:data:`PRESSED_RUN`). A part whose friction the line's file states
    is not simulated.
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
) -> SceneArguments:
    """Return the parameters of the scene that simulates a part by discrete elements, without gravity.

    If `pressed` is True, a plug at the outlet presses against the concrete (:data:`PRESSED_RUN`).
    """
    wide = max(part.diameter, part.outlet)
    own: SceneArguments = {"concrete": concrete, "diameter": part.diameter, "flow": flow, "gravity": 0.0,
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
    given = modules()[SCENE].scene.declared(dict(own))
    if line.largest_stone is not None and given.sizes in ("gaussian", "uniform"):
        # The concrete states no sieve curve. Scale the scene's default sizes so that the largest one equals the largest
        # stone of the line.
        ratio = line.largest_stone / given.size_max
        names = [name for name in (*SIZE_PARAMETERS, "plug_ball") if getattr(given, name) is not None]
        own |= {name: ratio * getattr(given, name) for name in names}
    own = scaled_parameters(own, min(each.narrow for each in line.parts), elements)
    if pressed:
        own["plug_pressure"] = PLUG_PRESSURE_RATIO * own["modulus"]
    return own


def scaled_parameters(own: Mapping[str, object], narrowest: float, elements: Elements) -> SceneArguments:
    """Multiply the stone sizes and the elastic modulus in a scene's parameters by factors, and return the parameters.

    `own` holds the parameters of the scene of a line's part, and `narrowest` is the narrowest bore of the pump line
    [m]. The factors are :attr:`Elements.coarse` and :attr:`Elements.stiffer`.
    """
    given = modules()[SCENE].scene.declared(dict(own))
    whole = {**own, "modulus": elements.stiffer * given.modulus}
    ranged = given.sizes in ("gaussian", "uniform")
    sieve = [] if ranged else [entry.split(":") for entry in given.sizes.split(",")]
    least, most = (given.size_min, given.size_max) if ranged else (1e-3 * float(sieve[k][0]) for k in (0, -1))
    factor = elements.coarse or max(1.0, LARGEST_STONE_RATIO * narrowest / most)
    # The plug that closes the pipe consists of balls. They are enlarged together with the aggregate, because small
    # balls would limit the time step.
    whole["plug_ball"] = max(factor * given.plug_ball, min(factor * least, narrowest / 5))
    if not ranged:
        return whole | {"sizes": ",".join(f"{factor * float(opening):g}:{passing}" for opening, passing in sieve)}
    return whole | {name: factor * getattr(given, name) for name in SIZE_PARAMETERS if getattr(given, name) is not None}


def _run_name(key: tuple[object, ...], part: Part, seed: int) -> str:
    return f"{folder_name(part)}{'-pressed' if key[-1] == PRESSED_RUN else ''}-dem-seed-{seed}"


def _simulate(
    jobs: Sequence[tuple[Any, int, Any]], kinds: Mapping[Any, Part], runs: dict[tuple[Any, int], Any],
    out: Path | None, device: str | None, threads: int | None, progress: Callable[[str, float], None] | None,
) -> dict[str, float]:  # fmt: skip
    """Run the `jobs`, store their runs in the mapping `runs`, and return the wall times [s].

    A job is a tuple of a kind of part, a seed and a scene. The keys of `runs` are pairs of a kind of part and a seed.
    The keys of the result are the names of the runs' folders.
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
                refuse("part", part.label, TOO_SHORT, "make the part longer")
            tables.setdefault(part.diameter, []).append(columns)
            densities.append(float(np.nanmean(columns["bulk_density"])))
            largest = CONSTANT_FRICTION_RATIO * run.scene.parameters["modulus"]
        elif "middle_ratio" not in run.result:
            refuse("part", part.label, TOO_SHORT, "make the part longer")
        else:
            ratios[key] = number(run.result["middle_ratio"])
    laws = {}
    for diameter, found in tables.items():
        joined = {name: np.concatenate([columns[name] for columns in found]) for name in found[0]}
        laws[diameter] = WallLaw.of(diameter, joined, largest)
    blocked = {key: bool(runs[key].result.get("blocked")) for key in kinds}
    return SeedResult(laws, ratios, float(np.mean(densities)), blocked)


def _remarks(result: ElementLine) -> Iterator[str]:
    """Yield remarks for the user about the line, about failed checks, and about limits of the simulations."""
    yield from result.line.remarks()
    if any(part.layer != 1 for part in result.line.parts):
        yield "hoses are simulated with the slip layer of pipes"
    for name, bad in result.failed.items():
        yield from (f"check FAILED in {name}: {what}" for what in bad)
    for part, blocked in zip(result.line.parts, result.blocked(), strict=True):
        if blocked:
            yield (
                f"BLOCKED: part {part.number}, {part.label}, with {blocked} of {len(result.packed)} seeds; the "
                "pressure of a blocked line has no meaning"
            )
    if not any(result.blocked()):
        yield "not blocked: no simulated part was blocked"
    laws = [law for each in result.packed for law in each.laws.values()]
    measured, largest = max(law.measured for law in laws), min(law.largest for law in laws)
    us = result.line.customary
    if result.pressure > 1.2 * measured:
        low, high = (both(us, "kPa", pressure, digits=3) for pressure in (measured, largest))
        constant = f", and taken as constant above {high}" if result.pressure > largest else ""
        yield f"wall friction at pressures above {low} is extrapolated from lower pressures{constant}"
