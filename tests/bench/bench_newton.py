"""The slump test by NVIDIA Newton's implicit material points, beside which ours are set: its result and its time.

    pip install newton
    python tests/bench/bench_newton.py --yield-stress 1000 200 --cell 15 10 --viscosity 30 --duration 3
    python tests/bench/bench_newton.py --yield-stress 200 --cell 10 --device cuda:0 --repeats 3

The cone of EN 12350-2 (200 mm wide below, 100 mm above, 300 mm high) of a Bingham fluid of 2300 kg/m3 stands free at
t = 0, without a mould, on ground that it sticks to. `SolverImplicitMPM` with its own tolerance and limit of iterations:
APIC, velocity in basis Q1, strain in P0, no internal friction, eight particles a cell. Newton's yield is at
sqrt(s:s / 2) = yield stress, its viscosity a plastic one, so both are entered as they are.

A run ends when its fastest particle is slower than --rest, or after --duration. Slump: 300 mm less the top, which is
half a particle's spacing above the highest particle; spread: twice the mean over 36 sectors of the outermost particle's
radius and half a spacing. Wall time is that of the steps, without compiling and measuring, the median of the repeats;
on a CPU Newton keeps one core busy, however many there are.
"""

import argparse
import importlib
import platform
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from warpcrete.core.device.device import default_threads, find_device

BOTTOM, TOP, HEIGHT = 0.1, 0.05, 0.3
DENSITY = 2300.0
STICKING = 1e3
"""Friction coefficient of the ground."""
SECTORS = 36


@dataclass
class Outcome:
    """Results of a run: lengths [m], times [s], speed [m/s]."""

    particles: int
    slump: float
    spread: float
    t500: float | None
    simulated: float
    speed: float
    wall: float


def newton_package() -> Any:
    """Newton, or one line that says how to get it."""
    try:
        return importlib.import_module("newton")
    except ModuleNotFoundError as error:
        if error.name != "newton":
            raise
        raise SystemExit("Newton is not installed: pip install newton") from None


def cone(spacing: float) -> np.ndarray:
    """Places in the cone on a cubic grid [m], shape (particles, 3); the ground is z = 0."""
    side, levels = round(np.ceil(BOTTOM / spacing)), round(np.ceil(HEIGHT / spacing))
    across, up = (np.arange(-side, side) + 0.5) * spacing, (np.arange(levels) + 0.5) * spacing
    places = np.stack(np.meshgrid(across, across, up, indexing="ij"), axis=-1).reshape(-1, 3)
    radius = BOTTOM + (TOP - BOTTOM) * places[:, 2] / HEIGHT
    return places[(np.hypot(places[:, 0], places[:, 1]) < radius) & (places[:, 2] < HEIGHT)]


def spread_of(places: np.ndarray, spacing: float) -> float:
    """Mean diameter of the heap [m]; a sector without particles counts as of no radius."""
    sectors = (SECTORS * (np.arctan2(places[:, 1], places[:, 0]) / (2 * np.pi) + 0.5)).astype(int) % SECTORS
    outermost = np.zeros(SECTORS)
    np.maximum.at(outermost, sectors, np.hypot(places[:, 0], places[:, 1]))
    return float(2 * (outermost.mean() + spacing / 2))


def model_of(newton: Any, device: Any, cell: float, yield_stress: float, viscosity: float) -> Any:
    """The cone on its ground."""
    builder = newton.ModelBuilder()
    newton.solvers.SolverImplicitMPM.register_custom_attributes(builder)
    spacing = cell / 2
    places = cone(spacing)
    count = len(places)
    builder.add_particles(
        pos=places.tolist(),
        vel=np.zeros_like(places).tolist(),
        mass=[DENSITY * spacing**3] * count,
        radius=[spacing / 2] * count,
    )
    builder.add_ground_plane(cfg=newton.ModelBuilder.ShapeConfig(mu=STICKING))
    model = builder.finalize(device=device)
    model.set_gravity((0.0, 0.0, -9.81))
    model.mpm.friction.fill_(0.0)
    model.mpm.yield_stress.fill_(yield_stress)
    model.mpm.viscosity.fill_(viscosity)
    return model


def solver_of(newton: Any, model: Any, cell: float) -> Any:
    """Newton's implicit material points at the start."""
    solver = newton.solvers.SolverImplicitMPM
    config = solver.Config(voxel_size=cell, transfer_scheme="apic", velocity_basis="Q1", strain_basis="P0")
    return solver(model, config=config)


def run(newton: Any, device: Any, cell: float, yield_stress: float, arguments: argparse.Namespace) -> Outcome:
    """One slump test."""
    model = model_of(newton, device, cell, yield_stress, arguments.viscosity)
    step = 1e-3 * arguments.time_step
    solver_of(newton, model, cell).step(model.state(), model.state(), None, None, step)  # compiles
    solver, now, then = solver_of(newton, model, cell), model.state(), model.state()
    spacing, wall, t500, speed, steps = cell / 2, 0.0, None, np.inf, 0
    places = now.particle_q.numpy()
    while speed > 1e-3 * arguments.rest and (steps + 0.5) * step < arguments.duration:
        wp.synchronize_device(device)
        begun = time.perf_counter()
        solver.step(now, then, None, None, step)
        wp.synchronize_device(device)
        wall += time.perf_counter() - begun
        now, then, steps = then, now, steps + 1
        places = now.particle_q.numpy()
        speed = float(np.linalg.norm(now.particle_qd.numpy(), axis=1).max())
        if t500 is None and spread_of(places, spacing) >= 0.5:
            t500 = steps * step
    top = float(places[:, 2].max()) + spacing / 2
    return Outcome(len(places), HEIGHT - top, spread_of(places, spacing), t500, steps * step, speed, wall)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--yield-stress", type=float, nargs="+", default=[1000.0, 200.0], help="[Pa]")
    parser.add_argument("--cell", type=float, nargs="+", default=[15.0], help="[mm]")
    parser.add_argument("--viscosity", type=float, default=30.0, help="plastic viscosity [Pa s]")
    parser.add_argument("--duration", type=float, default=10.0, help="simulated time at most [s]")
    parser.add_argument("--time-step", type=float, default=4.0, help="[ms]")
    parser.add_argument("--rest", type=float, default=1.0, help="speed of the fastest particle at the end [mm/s]")
    parser.add_argument("--repeats", type=int, default=1)
    parser.add_argument("--device", default=None)
    arguments = parser.parse_args()
    newton = newton_package()
    device = find_device(arguments.device)
    print(
        "| yield stress [Pa] | cell [mm] | particles | slump [mm] | spread [mm] | T500 [s] | simulated [s] "
        "| fastest then [mm/s] | wall time [s] |"
    )
    print("|---" * 9 + "|")
    for yield_stress in arguments.yield_stress:
        for cell in arguments.cell:
            with wp.ScopedDevice(device):
                runs = [run(newton, device, 1e-3 * cell, yield_stress, arguments) for _ in range(arguments.repeats)]
            last = runs[-1]
            cells = [
                f"{yield_stress:g}", f"{cell:g}", str(last.particles), f"{1e3 * last.slump:.0f}",
                f"{1e3 * last.spread:.0f}", "-" if last.t500 is None else f"{last.t500:.2f}", f"{last.simulated:.2f}",
                f"{1e3 * last.speed:.1f}", f"{np.median([each.wall for each in runs]):.0f}",
            ]  # fmt: skip
            print("| " + " | ".join(cells) + " |", flush=True)
    host = f"{platform.processor() or platform.machine()}, one of {default_threads()} cores"
    where = device.name if device.is_cuda else host
    print(
        f"\n{where}; Newton {newton.__version__}, Warp {wp.config.version}; {arguments.viscosity:g} Pa s, "
        f"{arguments.time_step:g} ms steps; {arguments.repeats} repeats"
    )


if __name__ == "__main__":
    main()
