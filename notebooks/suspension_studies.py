"""Studies of aggregates in a mortar: slip layer, migration, standard tests, blocking at bars, and segregation.

    python notebooks/suspension_studies.py --device cuda --out aggregates --gpu-workers 5 --cpu-workers 10 --limit 480
    python notebooks/suspension_studies.py --device cpu --out aggregates --cpu-workers 1 --only f --tiny
    python notebooks/suspension_tables.py aggregates

Each case writes `STUDY/CASE.json` into the folder: at the end, and every few seconds before that. A case whose run has
ended is left out when the command is called again with the same folder. `suspension_tables.py` turns the files into
tables and figures, and notebooks/validation/suspension-pipes.md and suspension-vessels.md show and discuss them.

The studies are a: slip layer at the wall of a pipe; b: migration; c: standard tests of one concrete; d: sizes and
shapes of aggregates in a bend; e: blocking at the bars of a J-ring and in reducers; f: segregation.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

STUDIES = ("a", "b", "c", "d", "e", "f")
DIAMETER = 0.1
"""Inner diameter of all pipes [m]."""
SOFT = {"density": 2350.0, "viscosity": 30.0, "yield_stress": 50.0}
"""The concrete of all standard tests, which `both_methods.py` calls soft."""
AGGREGATE = 2650.0
"""Density of the aggregates [kg/m3]."""
FRACTION = 0.3
"""Volume fraction of the simulated aggregates in the standard tests."""
PIPE_FRACTION = 0.2
"""Volume fraction of the aggregates of all sizes and shapes in study d: more spheres of 60 mm find no place."""
ROUGH = 0.5
"""Coulomb friction coefficient between aggregates, and with walls, in the runs that have friction."""
XU_FRACTION = 0.36
"""Volume fraction of coarse aggregate in the concretes of Xu, Li & Jiang 2021."""
STICKS, SLIPS = (300.0, 500.0, 1000.0, 2000.0, 4000.0), (300.0, 400.0, 500.0, 700.0, 1000.0)
"""Stresses at the wall [Pa] at which the slip layer is measured, with mortar that sticks to the wall and that slips."""
WRITE_INTERVAL = 5.0
"""Wall-clock time between two writes of a case's file while it runs [s]."""


@dataclass(frozen=True)
class Case:
    """One simulation of a study."""

    study: str
    name: str
    scene: str
    parameters: dict[str, Any]
    large: bool = False
    """True if the simulation is so large that it should run on a GPU."""
    varied: dict[str, Any] | None = None
    """Values that distinguish this case from others of its study, for tables."""


def mortar(concrete: dict[str, float], fraction: float) -> dict[str, Any]:
    """Return the parameters of the mortar that becomes `concrete` with a volume `fraction` of aggregates."""
    from warpcrete.theory.pipe import Concrete
    from warpcrete.theory.suspension import mortar_of

    whole = Concrete(name="own", slip_viscosity=1e3, slip_yield=0.0, **concrete)
    part = mortar_of(whole, fraction, AGGREGATE)
    return {"concrete": "own", "density": part.density, "viscosity": part.viscosity, "yield_stress": part.yield_stress}


def xu_mortar(name: str) -> dict[str, Any]:
    """Return the parameters of the mortar of a concrete of Xu, Li & Jiang 2021, with the concrete's slip layer."""
    from warpcrete.theory.pipe import CONCRETES

    own = CONCRETES[name]
    constants = {"density": own.density, "viscosity": own.viscosity, "yield_stress": own.yield_stress}
    return mortar(constants, XU_FRACTION) | {"slip_viscosity": own.slip_viscosity, "slip_yield": own.slip_yield}


def pipe(mix: dict[str, Any], stress: float, steps: int, **other: Any) -> dict[str, Any]:
    """Return the parameters of a stretch of pipe with a `stress` at the wall [Pa], for about `steps` time steps."""
    from warpcrete import scenes

    given = {"diameter": DIAMETER, "length": 0.05, "spacing": 0.0125 / 4, "gradient": 4 * stress / DIAMETER,
             "aggregate_smallest": 0.0125, "aggregate_largest": 0.0125, "courant": 1.0, "gravity": 0.0,
             "regularisation": 100.0, "sample_interval": 1e3} | mix | other  # fmt: skip
    step = scenes.stretch(**given).time_step
    return given | {"duration": steps * step, "sample_interval": max(1, steps // 30) * step}


def slip_layer(seeds: int, length: float) -> Iterator[Case]:
    """Yield the cases of study a: three fractions, five stresses, mortar that sticks or slips."""
    own = xu_mortar("no1")
    for seed in range(seeds):
        for surfaces, stresses, steps in (("sticks", STICKS, 150), ("slips", SLIPS, 90)):
            for fraction in (0.3, 0.4, 0.2):
                for stress in stresses:
                    varied = {"surfaces": surfaces, "fraction": fraction, "stress": stress, "seed": seed}
                    given = pipe(own, stress, int(length * steps), surfaces=surfaces, aggregate_fraction=fraction,
                                 seed=seed)  # fmt: skip
                    yield Case("a", f"{surfaces}-{fraction:g}-{stress:g}-{seed}", "stretch", given, varied=varied)


def migration(seeds: int, length: float) -> Iterator[Case]:
    """Yield the cases of study b: the concretes of Xu, Li & Jiang for five seconds, and mortar that is sheared long."""
    from warpcrete.theory.pipe import CONCRETES, Line, steady

    for seed in range(seeds):
        for fraction in (0.4, 0.3):
            given = pipe(xu_mortar("no1"), 2000.0, int(length * 1000), surfaces="sticks", aggregate_fraction=fraction,
                         seed=seed)  # fmt: skip
            varied = {"kind": "sheared", "fraction": fraction, "seed": seed}
            yield Case("b", f"sheared-{fraction:g}-{seed}", "stretch", given, varied=varied)
        for name in ("no1", "no2", "no3"):
            level = Line(radius=DIAMETER / 2, length=1.0, gravity=0.0)
            stress = steady(CONCRETES[name], level, 1500e-6, "pipe").wall_stress
            given = pipe(xu_mortar(name), stress, 1, surfaces="slips", aggregate_fraction=XU_FRACTION, seed=seed,
                         gravity=9.81, aggregate_largest=0.02, length=0.0625)  # fmt: skip
            given |= {"duration": length * 5.0, "sample_interval": length * 0.1}
            yield Case("b", f"{name}-{seed}", "stretch", given, varied={"kind": name, "seed": seed})


def standard_tests(seeds: int, length: float) -> Iterator[Case]:
    """Yield the cases of study c: slump, J-ring, L-box and funnel, with aggregates, as a flow, and as elements."""
    common = {"regularisation": 1e3, "step_error": 1e-2}
    cone = {"lift_time": 0.0, "plate_radius": 0.34, "duration": 5.0 * length, "sample_interval": 0.1 * length}
    box = {"duration": 25.0 * length, "sample_interval": 0.1 * length}
    funnel = {"duration": 25.0 * length, "sample_interval": 0.1 * length}
    tests = {
        "slump": ("slump", 0.005, cone), "lbox-3": ("lbox", 0.005, box | {"bars": 3}),
        "funnel": ("funnel", 0.004, funnel), "jring": ("jring", 0.005, cone), "lbox-0": ("lbox", 0.005, box),
    }  # fmt: skip
    for seed in range(seeds):
        for name, (scene, cell, own) in tests.items():
            given = mortar(SOFT, FRACTION) | common | own | {
                "spacing": cell, "aggregate_fraction": FRACTION, "aggregate_smallest": 4 * cell,
                "aggregate_largest": 4 * cell, "aggregate_density": AGGREGATE, "seed": seed,
            }  # fmt: skip
            varied = {"test": name, "method": "suspension", "seed": seed}
            yield Case("c", f"{name}-suspension-{seed}", scene, given, True, varied)
        if seed:
            continue
        for name, (scene, cell, own) in tests.items():
            given = {"concrete": "own"} | SOFT | common | own | {"spacing": cell}
            yield Case("c", f"{name}-flow", scene, given, True, {"test": name, "method": "flow", "seed": 0})
    for seed in range(seeds):
        given = {"law": "mortar", "bulk_density": SOFT["density"], "size_min": 6e-3, "size_max": 9e-3,
                 "duration": 6.0 * length, "lift_time": 1.0, "viscosity": SOFT["viscosity"],
                 "yield_stress": SOFT["yield_stress"], "seed": seed}  # fmt: skip
        varied = {"test": "jring", "method": "elements", "seed": seed}
        yield Case("c", f"jring-elements-{seed}", "jring_dem", given, True, varied)


def pumping(seeds: int, length: float) -> Iterator[Case]:
    """Yield the cases of study d: sizes and shapes of aggregates in a pipe with a bend, with and without friction.

    The cases follow Zhan et al. 2019, who vary size and shape of the aggregates at a velocity of 0.3 m/s. All concretes
    would have the constants of concrete no. 1 of Xu, Li & Jiang 2021 if they were homogeneous.
    """
    from warpcrete.theory.pipe import CONCRETES

    own = CONCRETES["no1"]
    constants = {"density": own.density, "viscosity": own.viscosity, "yield_stress": own.yield_stress}
    mix = mortar(constants, PIPE_FRACTION) | {"slip_viscosity": own.slip_viscosity, "slip_yield": own.slip_yield}
    common = mix | {
        "unit": "bend-level", "diameter": DIAMETER, "straight": 0.2, "elbow_radius": 0.25, "spacing": 0.005,
        "symmetry": "whole", "flow": 0.3 * 0.25 * math.pi * DIAMETER**2, "time_step": 0.008, "duration": 3.0 * length,
        "steadiness": 1e-9, "aggregate_fraction": PIPE_FRACTION,
    }  # fmt: skip
    for seed in range(seeds):
        for friction in (0.0, ROUGH):
            for size in (0.02, 0.03, 0.04, 0.05, 0.06):
                given = common | {"aggregate_smallest": size, "aggregate_largest": size, "friction": friction,
                                  "seed": seed}  # fmt: skip
                varied = {"kind": "size", "size": size, "shape": 1.0, "friction": friction, "seed": seed}
                yield Case("d", f"size-{1e3 * size:g}-{friction:g}-{seed}", "part", given, True, varied)
            for shape in (1.5, 2.5, 3.5, 4.5):
                given = common | {"aggregate_smallest": 0.04, "aggregate_largest": 0.04, "friction": friction,
                                  "aggregate_shapes": f"shape-{shape:g}", "seed": seed}  # fmt: skip
                varied = {"kind": "shape", "size": 0.04, "shape": shape, "friction": friction, "seed": seed}
                yield Case("d", f"shape-{shape:g}-{friction:g}-{seed}", "part", given, True, varied)


def blocking(seeds: int, length: float) -> Iterator[Case]:
    """Yield the cases of study e: J-rings with wide and narrow gaps, and reducers, with few and many aggregates."""
    yield from bars(seeds, length)
    yield from reducers(seeds, length)


def reducers(seeds: int, length: float) -> Iterator[Case]:
    """Yield reducers from 100 mm to four diameters, with aggregates of 20 mm that have friction.

    In 2 s, 100 mm of the concrete in the wide pipe flow into the reducer.
    """
    size = 0.02
    for seed in range(seeds):
        for fraction in (0.3, 0.2):
            for outlet in (0.06, 0.05, 0.04, 0.033):
                given = mortar(SOFT, fraction) | {
                    "slip_viscosity": 893.0, "slip_yield": 251.0, "unit": "horizontal", "diameter": DIAMETER,
                    "outlet_diameter": outlet, "straight": 0.2, "taper": 0.1, "spacing": size / 4,
                    "symmetry": "whole", "flow": 0.05 * 0.25 * math.pi * DIAMETER**2, "time_step": 0.008,
                    "duration": 2.0 * length, "steadiness": 1e-9, "aggregate_fraction": fraction,
                    "aggregate_smallest": size, "aggregate_largest": size, "friction": ROUGH, "seed": seed,
                }  # fmt: skip
                varied = {"kind": "reducer", "fraction": fraction, "outlet": outlet, "seed": seed}
                yield Case("e", f"reducer-{1e3 * outlet:g}-{fraction:g}-{seed}", "part", given, True, varied)


def bars(seeds: int, length: float) -> Iterator[Case]:
    """Yield J-rings with wide and narrow gaps, and few and many aggregates of 25 mm that have friction."""
    for seed in range(seeds):
        for fraction in (0.3, 0.4, 0.2):
            for number in (16, 20, 12):
                given = mortar(SOFT, fraction) | {
                    "regularisation": 1e3, "step_error": 1e-2, "lift_time": 0.0, "plate_radius": 0.3,
                    "spacing": 0.00625, "aggregate_fraction": fraction, "aggregate_smallest": 0.025,
                    "aggregate_largest": 0.025, "aggregate_density": AGGREGATE, "seed": seed, "bars": number,
                    "duration": 3.0 * length, "sample_interval": 0.1 * length, "friction": ROUGH,
                }  # fmt: skip
                varied = {"kind": "bars", "fraction": fraction, "bars": number, "seed": seed}
                yield Case("e", f"bars-{number}-{fraction:g}-{seed}", "jring", given, varied=varied)


def segregation(seeds: int, length: float) -> Iterator[Case]:
    """Yield the cases of study f: aggregates of 16 mm in mortar at rest, and in mortar that is sheared in a pipe.

    At rest, the mortar slips on the wall almost without friction, so that it moves as a plug. The yield stress is given
    in multiples of the value at which a single sphere stops (Beris et al. 1985). In a sheared mortar, aggregates lag
    behind even without weight, so each run in a pipe has a weightless twin.
    """
    size, density = 0.016, 2200.0
    critical = 0.048 * size * (AGGREGATE - density) * 9.81
    base = {"concrete": "own", "density": density, "viscosity": 5.0, "slip_viscosity": 1e3, "slip_yield": 0.0,
            "aggregate_smallest": size, "aggregate_largest": size, "spacing": size / 4, "length": 0.064,
            "gravity": 9.81, "aggregate_density": AGGREGATE}  # fmt: skip
    for seed in range(seeds):
        for fraction in (0.3, 0.1):
            for part, beta in ((0.0, 100.0), (0.5, 100.0), *((p, b) for p in (0.8, 1.2, 2.0) for b in (100.0, 1000.0))):
                mix = base | {"yield_stress": part * critical, "aggregate_fraction": fraction}
                given = pipe(mix, 0.025, int(40 * length), surfaces="slips", seed=seed, regularisation=beta)
                varied = {"kind": "rest", "fraction": fraction, "part": part, "beta": beta, "stress": 0.0, "seed": seed}
                yield Case("f", f"rest-{fraction:g}-{part:g}-{beta:g}-{seed}", "stretch", given, varied=varied)
        for part in (2.0, 10.0):
            for stress in (50.0, 200.0):
                mix = base | {"yield_stress": part * critical, "aggregate_fraction": 0.3}
                given = pipe(mix, stress, int(150 * length), surfaces="sticks", seed=seed)
                for kind, gravity in (("pipe", 9.81), ("weightless", 0.0)):
                    varied = {"kind": kind, "fraction": 0.3, "part": part, "stress": stress, "seed": seed}
                    own = given | {"gravity": gravity}
                    yield Case("f", f"{kind}-{part:g}-{stress:g}-{seed}", "stretch", own, varied=varied)


def short(value: float) -> float:
    """Return a number with six digits, which keeps the files small."""
    return float(f"{value:.6g}")


MAKERS = {
    "a": slip_layer, "b": migration, "c": standard_tests, "d": pumping, "e": blocking, "f": segregation,
}  # fmt: skip


def fraction_over_distance(flow: Any, bins: int) -> tuple[list[float], list[float]]:
    """Return distances from the wall [m], and the volume fractions of aggregates there, in rings of equal width."""
    import numpy as np

    from warpcrete.suspension.stretch.probes import POINTS

    along = (2 * np.arange(POINTS) + 1) / POINTS - 1
    cube = np.stack(np.meshgrid(along, along, along), -1).reshape(-1, 3)
    points = cube[np.linalg.norm(cube, axis=1) < 1]
    centre, radius = flow.aggregates.bodies.centre.numpy().astype(float), flow.aggregates.radius
    x, y = (centre[:, k, None] + radius[:, None] * points[:, k] for k in (0, 1))
    edges = np.linspace(0.0, flow.scene.radius, bins + 1)
    volume = np.repeat(4 / 3 * np.pi * radius**3 / len(points), len(points))
    held = np.histogram(np.hypot(x, y).ravel(), edges, weights=volume)[0]
    part = held / (np.pi * np.diff(edges**2) * flow.scene.length)
    distance = flow.scene.radius - 0.5 * (edges[1:] + edges[:-1])
    return [short(x) for x in distance[::-1]], [short(x) for x in part[::-1]]


def run_case(case: Case, device: str | None, folder: Path) -> str:
    """Run a case and write its file; return in words how it ended."""
    from warpcrete import Simulation, scenes
    from warpcrete.core.run.recorder import Recorder
    from warpcrete.suspension.stretch.probes import velocity_profile

    file = folder / case.study / f"{case.name}.json"
    file.parent.mkdir(parents=True, exist_ok=True)

    class Samples(Recorder):
        """Recorder that keeps the series and the profiles in a pipe, and writes them every few seconds."""

        def __init__(self) -> None:
            self.begun, self.written = time.perf_counter(), 0.0
            self.store: dict[str, Any] = {
                "case": case.name, "scene": case.scene, "varied": case.varied, "parameters": case.parameters,
                "device": device or "default", "finished": False, "series": [], "profiles": [],
            }  # fmt: skip

        def sample(self, simulation: Any, row: dict[str, float]) -> None:
            self.store["series"].append({name: short(value) for name, value in row.items()})
            if case.scene == "stretch":
                distance, fraction = fraction_over_distance(simulation.flow, 64)
                found = {"time": short(row["time"]), "fraction": fraction}
                self.store["distance"] = distance
                if simulation.flow.steps:
                    radius, velocity = velocity_profile(simulation.flow)
                    found |= {"radius": [short(x) for x in radius], "velocity": [short(x) for x in velocity]}
                self.store["profiles"].append(found)
            if time.perf_counter() - self.written > WRITE_INTERVAL:
                self.save()

        def save(self) -> None:
            self.written = time.perf_counter()
            self.store["wall_time"] = self.written - self.begun
            part = file.with_suffix(".part")
            part.write_text(json.dumps(self.store, default=float))
            part.replace(file)

    samples, words = Samples(), "finished"
    try:
        scene = getattr(scenes, case.scene)(**case.parameters)
        run = Simulation(scene, device=device, threads=1 if device == "cpu" else None, recorders=[samples]).run()
        left_out = ("profile", "provenance", "state_hash")
        samples.store["result"] = {name: value for name, value in run.result.items() if name not in left_out}
        samples.store["finished"] = run.finished
    except Exception as error:  # A case that fails must not end the others.
        words = samples.store["error"] = f"{type(error).__name__}: {error}"
    samples.save()
    return f"{words} after {samples.store['wall_time']:.0f} s"


def work(device: str | None, folder: Path, first: Any, second: Any, end: float) -> None:
    """Run cases from two queues, the second one when the first is empty, until a point in time (a worker process)."""
    import queue

    while time.time() < end:
        for cases in (first, second):
            try:
                case = cases.get_nowait()
                break
            except queue.Empty:
                continue
        else:
            return
        words = run_case(case, device, folder)
        print(f"{time.strftime('%H:%M:%S')} {device or 'default'} {case.study}/{case.name}: {words}", flush=True)


def is_left(case: Case, folder: Path) -> bool:
    """Return whether a case has not ended in an earlier call."""
    file = folder / case.study / f"{case.name}.json"
    found = json.loads(file.read_text()) if file.exists() else {}
    return not (found.get("finished") or "error" in found)


def turn(case: Case) -> tuple[int, bool]:
    """Return a key that sorts cases by seed, so that a call that is cut off has results of each study.

    The longest runs, those of sheared mortar, come first.
    """
    varied = case.varied or {}
    return varied["seed"] // (2 if varied.get("kind") == "sheared" else 1), varied.get("kind") != "sheared"


def main() -> None:
    """Run the cases of the chosen studies in worker processes."""
    reader = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    reader.add_argument("--out", type=Path, required=True)
    reader.add_argument("--only", nargs="+", choices=STUDIES, default=list(STUDIES))
    reader.add_argument("--device", default="cuda", help="cuda or cpu")
    reader.add_argument("--gpu-workers", type=int, default=5, help="processes that share the GPU")
    reader.add_argument("--cpu-workers", type=int, default=10, help="processes with one CPU core each")
    reader.add_argument("--seeds", type=int, default=3)
    reader.add_argument("--limit", type=float, default=1e6, help="wall-clock time after which all runs end [s]")
    reader.add_argument("--tiny", action="store_true", help="short runs, to try the script")
    given = reader.parse_args()
    end = time.time() + given.limit
    found = {study: list(MAKERS[study](given.seeds, 0.05 if given.tiny else 1.0)) for study in given.only}
    cases = [case for study in found.values() for case in study if is_left(case, given.out)]
    cases.sort(key=turn)
    context = multiprocessing.get_context("spawn")
    large, small = context.Queue(), context.Queue()
    for case in cases:
        (large if case.large else small).put(case)
    time.sleep(0.5)  # A queue is filled by a thread, and an empty one would end the workers.
    processes = []
    gpu = given.gpu_workers if given.device != "cpu" else 0
    for number in range(gpu + given.cpu_workers):
        on_gpu = number < gpu
        if number == gpu:
            os.environ["CUDA_VISIBLE_DEVICES"] = ""  # Workers on CPU cores need no memory of the GPU.
        order = (large, small) if on_gpu else (small, large)
        arguments = (given.device if on_gpu else "cpu", given.out, *order, end)
        processes.append(context.Process(target=work, args=arguments, daemon=True))
        processes[-1].start()
    for process in processes:
        process.join(max(end - time.time(), 0.0))
    for process in processes:
        if process.is_alive():
            process.terminate()
    for cases_left in (large, small):
        cases_left.cancel_join_thread()  # Otherwise this process would wait until all cases have been taken.
    left = [case.name for case in cases if is_left(case, given.out)]
    print(f"{len(cases) - len(left)} of {len(cases)} cases have ended")


if __name__ == "__main__":
    main()
