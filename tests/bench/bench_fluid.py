"""Flows of moving particles: cost of a step and iterations of its solves by resolution, growth, threads; solvers.

    python tests/bench/bench_fluid.py --device cpu --spacings 20 10 5 2.5 2
    python tests/bench/bench_fluid.py --device cuda --scene tube --spacings 10 5 2.5
    python tests/bench/bench_fluid.py --device cpu --ends periodic --spacings 5 2.5        on a grid
    python tests/bench/bench_fluid.py --device cpu --solvers

Prints tables: particles, time of a step (best and median of repeats of `--steps` steps after the start has died down),
iterations of the solves for velocity and pressure, particle-steps a second, errors against theory. With --solvers the
pressure's equation of one step is solved by our kernels, by `warp.optim.linear.cg` on a `warp.sparse` matrix, and,
where it is installed, by SciPy, to the same residual.
"""

import argparse
import time

import numpy as np
import warp as wp

from warpcrete import scenes
from warpcrete.core.device.device import find_device
from warpcrete.kernels.mps.structs import PRESSURE
from warpcrete.mps import grid_probes as grid_probes
from warpcrete.mps import probes
from warpcrete.mps.grid.flow import GridFlow
from warpcrete.mps.grid.state import GridState
from warpcrete.mps.particles import MovingParticles
from warpcrete.mps.pipe_grid import pipe_layout
from warpcrete.mps.stages import step_parts
from warpcrete.mps.state import FluidState


def flow_of(args, spacing: float, threads: int | None) -> MovingParticles | GridFlow:
    """Particles of the scene at a spacing [mm], at the start."""
    scene = getattr(scenes, args.scene)(spacing=spacing * 1e-3, aggregates=args.aggregates, ends=args.ends)
    if args.ends == "periodic":
        return GridFlow(GridState(scene, pipe_layout(scene), find_device(args.device), args.precision))
    return MovingParticles(FluidState(scene, find_device(args.device), args.precision), threads=threads)


def resolutions(args) -> None:
    """The table of spacings and threads."""
    print("| spacing [mm] | particles | threads | a step [ms], best | median | velocity it. | pressure it. "
          "| million particle-steps/s | pressure off | slip off | profile off |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|---|---|")
    for spacing in args.spacings:
        for threads in args.threads:
            flow = flow_of(args, spacing, threads)
            flow.take(40)  # 0.02 s: steady
            times, iterations = [], []
            for _ in range(args.repeats):
                wp.synchronize_device(flow.device)
                start = time.perf_counter()
                flow.take(args.steps)
                wp.synchronize_device(flow.device)
                times.append((time.perf_counter() - start) / args.steps)
                found = flow.outcomes()
                iterations.append([found[k]["iterations"] for k in ("viscosity", "pressure")])
            row = (grid_probes if args.ends == "periodic" else probes).measured(flow)
            velocity, pressure = np.mean(iterations, axis=0)
            theory = flow.scene.theory()
            off = [
                100 * (row["pressure"] / theory.pressure - 1),
                100 * (row["slip_velocity"] - theory.slip_velocity) / flow.scene.velocity,
            ]
            cells = [
                f"{1e3 * flow.state.layout.spacing:.3g}", str(flow.state.count), str(flow.threads),
                f"{1e3 * min(times):.2f}", f"{1e3 * np.median(times):.2f}", f"{velocity:.0f}", f"{pressure:.0f}",
                f"{1e-6 * flow.state.count / min(times):.2f}", f"{off[0]:+.2f} %", f"{off[1]:+.2f} %",
                f"{100 * row['profile_deviation'] / flow.scene.velocity:.2f} %",
            ]  # fmt: skip
            print("| " + " | ".join(cells) + " |", flush=True)
    print(f"\n{flow.device.name}; scene {args.scene}, {args.precision}; {args.steps} steps, {args.repeats} repeats; "
          "iterations of single steps vary by a half")  # fmt: skip


def solvers(args) -> None:
    """One system, several solvers, to a residual of 1e-4 of its start."""
    print("| spacing [mm] | unknowns | ours [ms] | warp.optim.linear.cg [ms] | SciPy cg [ms] | iterations, ours |")
    print("|---|---|---|---|---|---|")
    for spacing in args.spacings:
        solve_one(args, spacing)
    print(
        f"\n{find_device(args.device).name}; scene {args.scene}, {args.precision}, one thread; best of {args.repeats}"
    )


def solve_one(args, spacing: float) -> None:
    """A row of the table of solvers."""
    import warp.optim.linear
    import warp.sparse

    flow = flow_of(args, spacing, 1)
    flow.take(41)
    lists, matrix_of = flow.lists, flow.matrix
    n, capacity = flow.state.count, lists.near_capacity
    count, near, coefficient = lists.near_count.numpy(), lists.near.numpy(), matrix_of.coefficient.numpy()
    rows = np.repeat(np.arange(n), count)
    entry = np.arange(len(rows)) - np.repeat(np.cumsum(count) - count, count)
    at = entry * n + rows if flow.parallel else rows * capacity + entry
    i, j, value = rows, near[at], coefficient[at]
    inside = flow.matrix.free.numpy() == 0
    keep = inside[i] & inside[j] & (value != 0)
    diagonal = np.where(inside, flow.matrix.diagonal.numpy(), 1.0)
    right = np.where(inside, np.random.default_rng(0).normal(size=n), 0.0)
    scalar = flow.scalar

    # Ours: the stages of the solve alone, from the same residual every time.
    start = wp.array(right, dtype=scalar, device=flow.device)
    (part,) = step_parts(flow)
    stages = part.solve(flow.projection, PRESSURE, flow.fields.increment, 1e-4, 0.0)
    if flow.device.is_cuda:
        with wp.ScopedCapture(device=flow.device) as capture:
            for stage in stages:
                stage()

    def ours():
        flow.fields.increment.zero_()
        wp.copy(flow.projection.residual, start)
        if flow.device.is_cuda:
            wp.capture_launch(capture.graph)
        else:
            for stage in stages:
                stage()

    matrix = warp.sparse.bsr_from_triplets(
        n, n,
        wp.array(np.concatenate([i[keep], np.arange(n)]), dtype=wp.int32, device=flow.device),
        wp.array(np.concatenate([j[keep], np.arange(n)]), dtype=wp.int32, device=flow.device),
        wp.array(np.concatenate([-value[keep], diagonal]), dtype=scalar, device=flow.device),
    )  # fmt: skip
    solution = wp.zeros(n, dtype=scalar, device=flow.device)
    jacobi = warp.optim.linear.preconditioner(matrix, "diag")

    def theirs():
        solution.zero_()
        warp.optim.linear.cg(matrix, start, solution, tol=1e-4, atol=0.0, maxiter=2000, M=jacobi)

    columns = [best(ours, args.repeats, flow.device), best(theirs, args.repeats, flow.device)]
    away = np.abs(solution.numpy() - flow.fields.increment.numpy()).max() / np.abs(solution.numpy()).max()
    assert away < 1e-2, away
    scipy_time = None
    try:
        import scipy.sparse
        import scipy.sparse.linalg
    except ImportError:
        pass
    else:
        full = scipy.sparse.csr_matrix(
            (np.concatenate([-value[keep], diagonal]), (np.concatenate([i[keep], np.arange(n)]),
             np.concatenate([j[keep], np.arange(n)]))), (n, n))  # fmt: skip
        inverse = scipy.sparse.diags(1 / diagonal)
        scipy_time = best(lambda: scipy.sparse.linalg.cg(full, right, rtol=1e-4, M=inverse), args.repeats, None)
    iterations = int(flow.outcomes()["pressure"]["iterations"])
    last = "" if scipy_time is None else f"{1e3 * scipy_time:.2f}"
    print(
        f"| {spacing:g} | {n} | {1e3 * columns[0]:.2f} | {1e3 * columns[1]:.2f} | {last} | {iterations} |", flush=True
    )


def best(call, repeats: int, device) -> float:
    """Shortest wall time of a call [s], after one to warm up."""
    call()
    times = []
    for _ in range(repeats):
        if device is not None:
            wp.synchronize_device(device)
        start = time.perf_counter()
        call()
        if device is not None:
            wp.synchronize_device(device)
        times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default=None)
    parser.add_argument("--scene", default="channel", choices=["channel", "tube"])
    parser.add_argument("--precision", default="float32", choices=["float32", "float64"])
    parser.add_argument("--spacings", type=float, nargs="+", default=[20, 10, 5])
    parser.add_argument("--threads", type=int, nargs="+", default=[1])
    parser.add_argument("--steps", type=int, default=20)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--ends", choices=("piston", "periodic"), default="piston")
    parser.add_argument("--aggregates", action="store_true")
    parser.add_argument("--solvers", action="store_true")
    args = parser.parse_args()
    (solvers if args.solvers else resolutions)(args)


if __name__ == "__main__":
    main()
