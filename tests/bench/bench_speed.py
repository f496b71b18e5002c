"""Speed against size: spheres, clumps, bonded spheres and mesh walls; threads; memory; cost of each feature.

    python tests/bench/bench_speed.py --device cpu --sizes 1000 10000 100000
    python tests/bench/bench_speed.py --device cuda --sizes 1000 10000 100000 1000000 4000000
    python tests/bench/bench_speed.py --device cpu --features
    python tests/bench/bench_speed.py --device cpu --recording --travel 0.15

Frictional spheres of +-10 % in size, close-packed in a box, gravity tilted by 45 degrees, automatic time step.
Prints tables: median of the repeats in million sphere-steps a second, rebuilds of the lists included.
"""

import argparse
import dataclasses
import tempfile
import time
from pathlib import Path

import numpy as np
import warp as wp
from bench_peers import GRAVITY, box_of_spheres, scene_of

from warpcrete.core.device.device import default_threads, find_device, memory_free
from warpcrete.dem.engine.memory import bytes_per_body
from warpcrete.dem.engine.model import build_model
from warpcrete.dem.engine.state import State
from warpcrete.dem.engine.stepper import Stepper
from warpcrete.dem.measure.probes import body_sums, contact_sums
from warpcrete.dem.scene import clumps
from warpcrete.dem.scene.bodies import placed_bodies
from warpcrete.dem.scene.scene import Bonds, Scene
from warpcrete.geometry.walls import MeshWall

BONDS = Bonds(effective_modulus=1e6, tensile_strength=1e9, cohesion=1e9, gap=1e-4)


def boxed_mesh(lower: np.ndarray, upper: np.ndarray) -> MeshWall:
    """The box as twelve triangles, seen from inside."""
    import trimesh

    box = trimesh.creation.box(bounds=[lower, upper])
    return MeshWall(name="box", vertices=np.asarray(box.vertices), faces=np.asarray(box.faces)[:, ::-1])


def make(kind: str, count: int) -> Scene:
    """A scene of `count` bodies."""
    positions, sizes, lower, upper = box_of_spheres(count)
    scene = scene_of(positions, sizes, lower, upper, GRAVITY["flow"], None)
    if kind == "clumps":
        body = dataclasses.replace(scene.bodies[0], template=clumps.reference()[3])
        scene = dataclasses.replace(scene, bodies=(body,))
    if kind == "bonded":
        scene = dataclasses.replace(scene, bonds=BONDS)
    if kind == "mesh walls":
        scene = dataclasses.replace(scene, walls=(boxed_mesh(lower, upper),))
    return scene


def ready(scene: Scene, device: str, precision: str, threads: int) -> Stepper:
    """A stepper after some steps."""
    model = build_model(scene, find_device(device), precision)
    stepper = Stepper(model, State(model, placed_bodies(scene)), scene.time_step, threads=threads)
    if scene.bonds is not None:
        stepper.bond(scene.bonds, 1)
    stepper.take(200)
    return stepper


def rate(stepper: Stepper, steps: int, repeats: int) -> float:
    """Median of sphere-steps per second."""
    found = []
    for _ in range(repeats):
        wp.synchronize()
        begun = time.perf_counter()
        stepper.take(steps)
        wp.synchronize()
        found.append(stepper.state.sphere_count * steps / (time.perf_counter() - begun))
    return float(np.median(found))


def sizes_table(arguments) -> None:
    """Kinds against sizes."""
    cuda = arguments.device.startswith("cuda")
    threads = [1] if cuda else [1, default_threads()]
    print("| bodies | spheres | kind | precision | threads | million sphere-steps/s | contacts a sphere | bytes |")
    print("|---|---|---|---|---|---|---|---|")
    for count in arguments.sizes:
        for kind in arguments.kinds:
            for precision in arguments.precisions:
                for number in threads:
                    scene = make(kind, count)
                    stepper = ready(scene, arguments.device, precision, number)
                    spheres = stepper.state.sphere_count
                    steps = int(np.clip((1e9 if cuda else 4e6) / spheres, 200 if cuda else 40, 3000))
                    speed = rate(stepper, steps, arguments.repeats)
                    touching = contact_sums(stepper.model, stepper.state).contacts / spheres
                    body, sphere = bytes_per_body(stepper.model, placed_bodies(scene))
                    print(
                        f"| {count} | {spheres} | {kind} | {precision} | {'-' if cuda else number} | "
                        f"{speed / 1e6:.2f} | {touching:.2f} | {sphere + body * count / spheres:.0f} |",
                        flush=True,
                    )
                    del stepper
    device = find_device(arguments.device)
    body, sphere = bytes_per_body(build_model(make("spheres", 8), device, "float32"), placed_bodies(make("spheres", 8)))
    print(
        f"\n{device.name}; {arguments.repeats} repeats; {memory_free(device) / 2**30:.0f} GiB free hold about "
        f"{0.9 * memory_free(device) / (body + sphere):.2g} spheres in float32"
    )


def features_table(arguments) -> None:
    """Cost of a step with features switched on one by one."""
    count = arguments.sizes[0]
    positions, sizes, lower, upper = box_of_spheres(count)
    plain = scene_of(positions, sizes, lower, upper, GRAVITY["flow"], None)
    smooth = dataclasses.replace(plain.contact, friction=0.0)
    base = dataclasses.replace(plain, contact=smooth)
    body = dataclasses.replace(plain.bodies[0], template=clumps.reference()[0])
    cases = {
        "spheres, no friction (no rotation, no history)": base,
        "+ friction, rotation, history": plain,
        "+ bonds": dataclasses.replace(plain, bonds=BONDS),
        "+ energy balance (without bonds)": dataclasses.replace(plain, energy_balance=True),
        "+ mesh walls instead of planes": dataclasses.replace(plain, walls=(boxed_mesh(lower, upper),)),
        "clumps with friction": dataclasses.replace(plain, bodies=(body,)),
    }
    print("| scene | ns a sphere-step | over the first |\n|---|---|---|")
    steppers = {name: ready(scene, arguments.device, "float32", 1) for name, scene in cases.items()}
    steps = max(40, int(1e6 / count)) if arguments.device == "cpu" else 1000
    found: dict[str, list[float]] = {name: [] for name in cases}
    for _ in range(arguments.repeats):
        for name, stepper in steppers.items():
            found[name].append(1e9 / rate(stepper, steps, 1))
    first = float(np.median(found["spheres, no friction (no rotation, no history)"]))
    for name, values in found.items():
        value = float(np.median(values))
        print(f"| {name} | {value:.1f} | {value / first:.2f} |", flush=True)
    sampled = steppers["+ friction, rotation, history"]
    plain = float(np.median(found["+ friction, rotation, history"]))
    took = []
    for _ in range(arguments.repeats):
        begun = time.perf_counter()
        body_sums(sampled.model, sampled.state)
        contact_sums(sampled.model, sampled.state)
        took.append(1e9 * (time.perf_counter() - begun) / sampled.state.sphere_count)
    sample = float(np.median(took))
    print(f"| + probes every 100 steps | {plain + sample / 100:.1f} | {(plain + sample / 100) / first:.2f} |")
    print(f"\nOne sample of the probes takes as long as {sample / plain:.1f} steps. Recorders: --recording.")
    device = find_device(arguments.device)
    print(f"\n{device.name}, {count} bodies, one thread, float32; medians of {arguments.repeats}, interleaved")


def timed(recorder):
    """The recorder, adding up in `spent` the seconds that its methods take."""
    recorder.spent = 0.0

    def watched(method):
        def call(*arguments, **named):
            begun = time.perf_counter()
            try:
                return method(*arguments, **named)
            finally:
                recorder.spent += time.perf_counter() - begun

        return call

    for name in ("start", "sample", "frame", "finish", "tidy"):
        setattr(recorder, name, watched(getattr(recorder, name)))
    return recorder


def recording_cost(arguments) -> None:
    """Measure and print the cost of recorders for a pumping run at 50 frames a simulated second.

    The cost is the extra time of a run with recorders over a run without recorders; the runs take turns. The table also
    shows the time inside the recorders' methods, during which the run waits.
    """
    from warpcrete import Simulation, scenes
    from warpcrete.record.rerun import RerunRecorder
    from warpcrete.record.usd import UsdRecorder

    scene = scenes.pipe(
        concrete="zhan-table1", shapes=arguments.shapes, travel=arguments.travel, settle=0.2, sample_interval=0.02
    )
    kinds = {"Rerun": (RerunRecorder, "run.rrd"), "USD": (UsdRecorder, "scene.usdc")}
    ways = {"none": [], "Rerun": ["Rerun"], "USD": ["USD"], "both": ["Rerun", "USD"]}
    found: dict[str, list[tuple[float, float]]] = {way: [] for way in ways}
    for _ in range(arguments.repeats + 1):
        for way, names in ways.items():
            with tempfile.TemporaryDirectory() as folder:
                recorders = [timed(kinds[name][0](Path(folder) / kinds[name][1])) for name in names]
                simulation = Simulation(scene, device=arguments.device, recorders=recorders, frame_interval=0.02)
                spent = simulation.run().result["speed"]["wall_time"]["value"]
                found[way].append((spent, sum(r.spent for r in recorders)))
    plain = float(np.median([run for run, _ in found["none"][1:]]))
    print("| recorders | pumping [s] | longer by | held by them |\n|---|---|---|---|")
    for way, runs in found.items():
        run, held = np.median(runs[1:], axis=0)
        print(f"| {way} | {run:.2f} | {100 * (run / plain - 1):.1f} % | {100 * held / plain:.1f} % |")
    print(
        f"\n{find_device(arguments.device).name}, case A ({arguments.shapes}), "
        f"{arguments.travel or 'its own'} m of travel, 50 frames a simulated second; medians of {arguments.repeats} "
        "after one to begin with"
    )


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--sizes", type=int, nargs="*", default=[10_000])
    parser.add_argument("--kinds", nargs="*", default=["spheres", "clumps", "bonded", "mesh walls"])
    parser.add_argument("--precisions", nargs="*", default=["float32"])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--features", action="store_true")
    parser.add_argument("--recording", action="store_true")
    parser.add_argument("--shapes", default="spheres", help="of the run that is recorded")
    parser.add_argument("--travel", type=float, help="of its piston [m]; as the scene has it, if left out")
    arguments = parser.parse_args()
    if arguments.features:
        features_table(arguments)
    elif arguments.recording:
        recording_cost(arguments)
    else:
        sizes_table(arguments)


if __name__ == "__main__":
    main()
