"""The scheme of Xu, Li & Jiang 2021 as printed, next to ours: table and picture of notebooks/theory/particles.md.

    python notebooks/paper_scheme.py --out FOLDER

The printed Laplacian is not calibrated (Eq. 5, reach 4.1 spacings). The pressure has no prediction and follows from the
rate of the number density (Eqs. 4 and 7). The gradient uses the lowest pressure nearby and a factor of 2 (Eq. 18). One
sign is corrected: with Eq. 4 as printed, the pressure pulls crowded particles together, and no run is possible. The
treatment of walls is not the paper's: a point behind a wall has the particle's own pressure, and it has the wall's
velocity in the rate of the number density.

The kernels serve a channel in single precision on one thread of a CPU.
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np
import warp as wp

from warpcrete import scenes
from warpcrete.core.drawing.style import RUN, SECOND, THEORY, legend_above, new_figure, rgb
from warpcrete.core.run.run import Run
from warpcrete.kernels.common.control import HALTED
from warpcrete.kernels.mps.structs import array_structs, flow_struct, mps_functions
from warpcrete.mps.particles import SKIN, MovingParticles
from warpcrete.mps.scene import FlowWatch
from warpcrete.mps.simulation import FluidSimulation
from warpcrete.mps.stages import StepPart
from warpcrete.mps.state import FluidState

LAPLACIAN = 4.1
"""Reach of the printed Laplacian over the initial particle spacing."""

Flow, structs, f = flow_struct(wp.float32), array_structs(wp.float32, 2), mps_functions(wp.float32, 2)
Particles, Lists, Fields, Matrix, Solve = (
    structs.Particles, structs.Lists, structs.Fields, structs.Matrix, structs.NumberSolve
)  # fmt: skip


@wp.kernel(enable_backward=False)
def weights(
    flow: Flow,
    reach: wp.float32,
    laplacian_number: wp.float32,
    flags: wp.array(dtype=wp.int32),
    particles: Particles,
    lists: Lists,
    fields: Fields,
):
    """Set the pair weights of the printed Laplacian, and a predicted pressure of zero."""
    if flags[HALTED] != 0:
        return
    for i in range(flow.count):
        for k in range(lists.near_count[i]):
            at = i * lists.near_capacity + k
            r = f.distance(flow, particles.position[lists.near[at]] - particles.position[i])
            fields.pair_weight[at] = wp.float32(0.0)
            if r < reach:
                fields.pair_weight[at] = 3.0 / laplacian_number * reach / (r * r * r)  # 5 - d = 3 in two dimensions
        # A pair's weight is multiplied by the sum of both particles' factors, here by 1.
        fields.inverse_number[i] = wp.float32(0.5)
        fields.predicted[i] = wp.float32(0.0)


@wp.kernel(enable_backward=False)
def source(
    flow: Flow,
    flags: wp.array(dtype=wp.int32),
    particles: Particles,
    lists: Lists,
    fields: Fields,
    matrix: Matrix,
    projection: Solve,
):
    """Set up the pressure equation from the rate of the number density (Eqs. 4 and 7)."""
    if flags[HALTED] != 0:
        return
    for i in range(flow.count):
        x = particles.position[i]
        v = particles.velocity[i]
        total = wp.float32(0.0)
        rate = wp.float32(0.0)
        for k in range(lists.near_count[i]):
            at = i * lists.near_capacity + k
            j = lists.near[at]
            matrix.coefficient[at] = fields.pair_weight[at]
            total += fields.pair_weight[at]
            d = particles.position[j] - x
            r = f.distance(flow, d)
            if r < flow.cutoff:
                rate -= flow.cutoff / (r * r * r) * wp.dot(d, particles.velocity[j] - v)
        n = f.outward(x)
        for k in range(lists.wall_count[i]):
            y = lists.wall_position[lists.wall[i * lists.wall_capacity + k]]
            d = y - x
            r = f.distance(flow, d)
            if r < flow.cutoff:
                jump = wp.vec2f()
                if wp.length(f.across(y)) > flow.radius:
                    jump -= wp.dot(v, n) * n
                if y[1] < 0.0:
                    jump[1] = jump[1] - (v[1] - flow.piston_speed)
                rate -= flow.cutoff / (r * r * r) * wp.dot(d, jump)
        matrix.diagonal[i] = total
        fields.increment[i] = wp.float32(0.0)
        projection.residual[i] = flow.density / flow.dt * rate / flow.lattice_number
        if matrix.free[i] != 0:
            projection.residual[i] = wp.float32(0.0)


@wp.kernel(enable_backward=False)
def project(
    flow: Flow,
    flags: wp.array(dtype=wp.int32),
    lists: Lists,
    fields: Fields,
    particles: Particles,
):
    """Subtract the printed pressure gradient (Eq. 18) from the velocities."""
    if flags[HALTED] != 0:
        return
    for i in range(flow.count):
        x = particles.position[i]
        lowest = fields.increment[i]
        for k in range(lists.near_count[i]):
            j = lists.near[i * lists.near_capacity + k]
            if wp.length(particles.position[j] - x) < flow.cutoff:
                lowest = wp.min(lowest, fields.increment[j])
        slope = wp.vec2f()
        for k in range(lists.near_count[i]):
            j = lists.near[i * lists.near_capacity + k]
            d = particles.position[j] - x
            r = f.distance(flow, d)
            if r < flow.cutoff:
                slope += (f.weight(r, flow.cutoff) * (fields.increment[j] - lowest) / (r * r)) * d
        for k in range(lists.wall_count[i]):
            d = lists.wall_position[lists.wall[i * lists.wall_capacity + k]] - x
            r = f.distance(flow, d)
            if r < flow.cutoff:
                slope += (f.weight(r, flow.cutoff) * (fields.increment[i] - lowest) / (r * r)) * d
        particles.velocity[i] = particles.velocity[i] - (flow.dt / flow.density) * (4.0 / flow.lattice_number * slope)
        particles.pressure[i] = fields.increment[i]


def lattice_number(reach: float) -> float:
    """Return the sum of neighbour weights in a square lattice; `reach` is in units of its spacing."""
    size = np.arange(-np.ceil(reach), np.ceil(reach) + 1)
    r = np.hypot(*np.meshgrid(size, size))
    return float(np.sum(reach / r[(r > 0) & (r < reach)] - 1))


class PrintedScheme(MovingParticles):
    """Stepper of the printed scheme, with neighbour lists as long as the printed Laplacian needs."""

    def _coarse(self) -> None:
        return None

    @property
    def _list_reach(self) -> tuple[float, float]:
        reach = (LAPLACIAN + SKIN) * self.state.layout.spacing
        return reach, reach

    @property
    def step(self):
        """Stages of one step, as one list."""
        if self._step is None:
            part, reach = StepPart(self, range(1), []), LAPLACIAN * self.state.layout.spacing
            self._step = [
                [
                    *part.geometry(),
                    *part.wall_scale(),
                    self.stage(weights, 1, reach=reach, laplacian_number=lattice_number(LAPLACIAN)),
                    *part.momentum(),
                    *part.viscosity(),
                    self.stage(source, 1),
                    *part.pressure(),
                    self.stage(project, 1),
                    *part.motion(),
                    *part.finish(),
                ]
            ]
        return self._step


class PrintedSimulation(FluidSimulation):
    """Simulation of a channel by the printed scheme."""

    def place_flow(self) -> MovingParticles:
        """Return the flow at its start."""
        return PrintedScheme(FluidState(self.scene, self.device, self.precision), threads=1)


def run_printed(**parameters) -> Run:
    """Run a channel by the printed scheme, which does not balance the forces and must not stop for that."""
    scene = scenes.channel(ends="piston", **parameters)
    return PrintedSimulation(dataclasses.replace(scene, watch=FlowWatch(force_balance=None)), device="cpu").run()


def main() -> None:
    """Write `paper_scheme.md` and `paper_scheme.png`."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path())
    folder = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    settings = {"duration": 1.0, "sample_interval": 0.02}
    ours = FluidSimulation(scenes.channel(ends="piston", **settings), device="cpu").run()
    figure = new_figure("channel, 100 mm wide, concrete no1, 1500 cm3/s", 2.9, 2.5)
    top, bottom = figure.subplots(2, 1, height_ratios=[2.9, 2.5])
    table = ["| scheme | pressure [kPa] | off [%] | slip off [%] | volume [%] | balance of forces [%] |"]
    table.append("| --- | --- | --- | --- | --- | --- |")
    printed = run_printed(**settings)
    for name, run, colour in (("this program", ours, RUN), ("scheme as printed", printed, SECOND)):
        r, s = run.result, run.series
        top.plot(s["time"][1:], s["pressure"][1:] / 1e3, color=rgb(colour), label=name)
        bottom.plot(s["time"], 100 * s["volume_error"], color=rgb(colour), label=name)
        table.append(
            f"| {name} | {r['pressure']['value'] / 1e3:.2f} | {100 * r['pressure_error']:+.1f} "
            f"| {100 * r['slip_velocity_error']:+.2f} | {100 * r['volume_error']:+.3f} "
            f"| {100 * r['force_balance_error']:+.1f} |"
        )
    top.axhline(ours.result["pressure_theory"]["value"] / 1e3, color=rgb(THEORY), linestyle=":", label="theory")
    top.set(xlabel="time [s]", ylabel="pressure [kPa]", ylim=(0, None))
    bottom.set(xlabel="time [s]", ylabel="volume error [%]")
    legend_above(top)
    figure.savefig(folder / "paper_scheme.png", dpi=150)
    (folder / "paper_scheme.md").write_text("\n".join(table) + "\n", encoding="utf-8")
    print("\n".join(table))


if __name__ == "__main__":
    main()
