"""Checks of flows on a grid, as tables and a figure.

    python notebooks/grid_studies.py --device cpu --out studies

Writes `NAME.md`, and `NAME.png` for some, for each study into the new folder; notebooks/validation/flow-shear.md,
flow-slump.md, flow-vessels.md and flow-parts.md show and discuss them.
"""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from fluid_studies import Studies, main
from matplotlib.figure import Figure

from warpcrete import InstabilityError, Simulation, scenes
from warpcrete.core.device.device import default_threads
from warpcrete.core.drawing.style import RUN, SECOND, legend_above, new_figure, rgb
from warpcrete.core.units import number

Points = list[tuple[float, float]]


def result(job: tuple[str, dict, str | None]) -> dict:
    """Result of a scene by its name and parameters, on one thread of a CPU."""
    name, parameters, device = job
    found = Simulation(getattr(scenes, name)(**parameters), device=device, threads=1).run().result
    print(name, parameters, flush=True)
    return found


def value(found: dict, name: str, factor: float = 1.0, digits: int = 2) -> str:
    """A quantity as a table has it; a dash where there is none."""
    return f"{factor * found[name]['value']:.{digits}f}" if name in found else "-"


def shear_figure(panels: dict[str, tuple[Points, Points, list[float]]]) -> Figure:
    """Return the figure of the error of the wall stress [%] over the share of slip, for a channel and for a tube.

    Each panel has the points of columns and of periodic pipes, and the shares of slip at which a column stops.
    """
    figure = new_figure("channel or tube, 100 mm wide, concrete of 20 Pa s, 0.191 m/s", 3.6, 2.9)
    for axes, (name, (column, periodic, stopped)) in zip(
        figure.subplots(2, 1, sharex=True, height_ratios=[3.6, 2.9]), panels.items()
    ):
        axes.plot(stopped, np.full(len(stopped), 30.0), "x", color=rgb(SECOND), label="column stops with an error")
        axes.semilogy(*np.transpose(column), "o-", color=rgb(SECOND), label="column of particles")
        axes.semilogy(*np.transpose(periodic), "o-", color=rgb(RUN), label="periodic pipe on a grid")
        axes.set(ylabel="error of the\nwall stress [%]", title=name, ylim=(1e-5, 100.0), yticks=(1e-4, 1e-2, 1, 100))
        axes.yaxis.set_major_formatter("{x:g}")
    figure.axes[1].set_xlabel("slip velocity over mean velocity")
    legend_above(figure.axes[0], figure.axes[0].lines, width=0.9)
    return figure


class GridStudies(Studies):
    """Shear without end, and the standard tests."""

    def shear(self) -> None:
        """Any share of slip, any Bingham number: a column of particles on a piston, and a periodic pipe on a grid."""
        base = {"concrete": "own", "density": 2400.0, "viscosity": 20.0, "yield_stress": 0.0, "slip_viscosity": 1e6,
                "slip_yield": 0.0, "gravity": 0.0}  # fmt: skip
        speed = scenes.channel().velocity
        layers = [{"slip_viscosity": eta} for eta in (1e6, 2e4, 4e3, 1e3, 300.0, 100.0, 20.0)]
        plugs = [{"yield_stress": n * 20 * speed / 0.05} for n in (0.1, 1.0, 10.0, 100.0)]
        rows, panels = [], {}
        for name in ("channel", "tube"):
            found: dict[str, list[tuple[float, float]]] = {"piston": [], "periodic": []}
            stopped = []
            for given in [*layers, *plugs]:
                scene = getattr(scenes, name)(**base | given, spacing=5e-3)
                share = scene.theory().slip_velocity / scene.velocity
                bingham = scene.concrete.yield_stress * scene.radius / scene.concrete.viscosity / scene.velocity
                cells = [name, f"{share:.3f}", f"{bingham:.3g}"]
                for ends, length, duration in (("piston", 0.3, None), ("periodic", 0.06, 1.0 / speed)):
                    scene = getattr(scenes, name)(
                        **base | given, spacing=5e-3, ends=ends, length=length, duration=duration, sample_interval=0.02
                    )
                    try:
                        r = self.run(scene).result
                    except InstabilityError as error:
                        stopped.append(share)
                        cells += [str(error).split(":")[0].replace("t = ", "stops at "), ""]
                        continue
                    wall, profile = 100 * r["wall_stress_error"], 100 * r["profile_error"]
                    cells += [f"{wall:+.2f}", f"{profile:.2f}"]
                    if given in layers:
                        found[ends].append((share, abs(wall)))
                rows.append(cells)
            panels[name] = found["piston"], found["periodic"], stopped
        figure = shear_figure(panels)
        self.save("shear", figure)
        head = ["", "slip", "Bingham no.", "piston: wall off [%]", "profile rms [%]", "periodic: wall off [%]",
                "profile rms [%]"]  # fmt: skip
        self.write("shear", head, rows, "5 mm; a column until steady, a periodic pipe for ten diameters of travel.")

    def slump(self) -> None:
        """Slump and spread over the yield stress, three spacings, beside closed forms."""
        cases = [(tau, h) for tau in (2000.0, 1000.0, 200.0, 50.0, 20.0) for h in (5e-3, 7.5e-3, 10e-3)]
        jobs = [
            {"concrete": "own", "density": 2300.0, "viscosity": 30.0, "yield_stress": tau, "slip_viscosity": 900.0,
             "slip_yield": 100.0, "spacing": h} for tau, h in cases
        ]  # fmt: skip
        rows = []
        for job, r in zip(jobs, self.run_tests("slump", jobs)):
            rows.append(
                [f"{job['yield_stress']:g}", f"{1e3 * job['spacing']:g}", value(r, "slump", 1e3, 0),
                 value(r, "slump_theory", 1e3, 0), value(r, "slump_heap", 1e3, 0), value(r, "spread", 1e3, 0),
                 value(r, "spread_heap", 1e3, 0), value(r, "spread_theory", 1e3, 0), value(r, "t500"),
                 f"{100 * r['volume_error']:+.1f}", value(r, "simulated_time", digits=1),
                 value(r, "rest_speed", 1e3), value(r["speed"], "wall_time", digits=0)]
            )  # fmt: skip
        head = ["yield stress [Pa]", "cells [mm]", "slump [mm]", "tall cone", "heap", "spread [mm]", "heap",
                "long heap", "T500 [s]", "volume, at most [%]", "ends after [s]", "fastest then [mm/s]",
                "wall time [s]"]  # fmt: skip
        self.write("slump", head, rows, "30 Pa s, 2300 kg/m3, mould lifted in 3 s.")

    def gone(self) -> None:
        """Slump and spread of a cone whose mould is gone at once, as `tests/bench/bench_newton.py` has it."""
        jobs = [
            {"concrete": "own", "density": 2300.0, "viscosity": 30.0, "yield_stress": tau, "slip_viscosity": 900.0,
             "slip_yield": 100.0, "spacing": h, "lift_time": 0.0, "duration": 15.0}
            for tau in (1000.0, 200.0, 50.0) for h in (12.5e-3, 10e-3, 7.5e-3, 5e-3)
        ]  # fmt: skip
        rows = []
        for job, r in zip(jobs, self.run_tests("slump", jobs)):
            rows.append(
                [f"{job['yield_stress']:g}", f"{1e3 * job['spacing']:g}", str(r["particles"]),
                 value(r, "slump", 1e3, 0), value(r, "spread", 1e3, 0), value(r, "t500"),
                 value(r, "simulated_time", digits=1), value(r, "rest_speed", 1e3),
                 value(r["speed"], "wall_time", digits=0)]
            )  # fmt: skip
        head = ["yield stress [Pa]", "cells [mm]", "particles", "slump [mm]", "spread [mm]", "T500 [s]",
                "ends after [s]", "fastest then [mm/s]", "wall time [s]"]  # fmt: skip
        self.write("gone", head, rows, "30 Pa s, 2300 kg/m3, mould gone at once.")

    def steps(self) -> None:
        """The fall of a cone whose mould is gone, in equal steps and in steps as long as the flow lets them be."""
        equal = [{"step_error": 0.0, "time_step": step} for step in (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4)]
        paced = [{"step_error": error} for error in (1e-2, 3e-3, 1e-3, 3e-4, 1e-4)]
        rows = []
        for given in (*equal, *paced):
            scene = scenes.slump(
                concrete="own", density=2300.0, viscosity=30.0, yield_stress=200.0, slip_viscosity=900.0,
                slip_yield=100.0, spacing=0.01, lift_time=0.0, **given,
            )  # fmt: skip
            run = Simulation(scene, device=self.device).run()
            time, spread = run.series["time"], 1e3 * run.series["spread"]
            words = "error of a step" if given["step_error"] else "every step [ms]"
            size = f"{given['step_error']:g}" if given["step_error"] else f"{1e3 * given['time_step']:g}"
            early = [f"{np.interp(when, time, spread):.1f}" for when in (0.1, 0.2, 0.5)]
            longest = f"{1e3 * run.series['time_step'].max():.1f}"
            rows.append([words, size, str(run.result["steps"]), longest, *early, f"{spread[-1]:.0f}",
                         value(run.result, "slump", 1e3, 0), f"{100 * run.result['volume_error']:+.1f}"])  # fmt: skip
        head = ["", "", "steps", "longest [ms]", "spread after 0.1 s [mm]", "0.2 s", "0.5 s", "at rest", "slump [mm]",
                "volume, at most [%]"]  # fmt: skip
        self.write("steps", head, rows, "200 Pa, 30 Pa s, 2300 kg/m3, mould gone at once, cells of 10 mm.")

    def funnel(self) -> None:
        """Time of a V-funnel for three concretes, over the spacing, beside ducts in a row."""
        concretes = [(20.0, 0.0), (20.0, 30.0), (50.0, 50.0)]
        jobs = [
            {"concrete": "own", "density": 2300.0, "viscosity": mu, "yield_stress": tau, "spacing": h}
            for mu, tau in concretes for h in (12.5e-3, 9.375e-3, 7.5e-3, *((5e-3,) if tau == 0 else ()))
        ]  # fmt: skip
        rows = []
        for job, r in zip(jobs, self.run_tests("funnel", jobs)):
            rows.append(
                [f"{job['viscosity']:g}", f"{job['yield_stress']:g}", f"{1e3 * r['spacing']['value']:.1f}",
                 str(r["cells"]), value(r, "funnel_time"), value(r, "funnel_time_theory"),
                 f"{100 * r['remaining']:.0f}", f"{100 * r['volume_error']:+.1f}",
                 value(r["speed"], "wall_time", digits=0)]
            )  # fmt: skip
        head = ["viscosity [Pa s]", "yield stress [Pa]", "cells [mm]", "cells", "funnel time [s]", "ducts in a row [s]",
                "clings then [%]", "volume, at most [%]", "wall time [s]"]  # fmt: skip
        self.write("funnel", head, rows, "2300 kg/m3; concrete sticks to the walls.")

    def box(self) -> None:
        """H2/H1, T200 and T400 of an L-box with and without bars, beside what comes without inertia."""
        concretes = [(20.0, 30.0), (50.0, 100.0)]
        kinds = [(0, 12.5e-3), (0, 8e-3), (3, 8e-3)]
        jobs = [
            {"concrete": "own", "density": 2300.0, "viscosity": mu, "yield_stress": tau, "bars": bars, "spacing": h,
             "duration": 10.0} for mu, tau in concretes for bars, h in kinds
        ]  # fmt: skip
        rows = []
        for job, r in zip(jobs, self.run_tests("lbox", jobs)):
            rows.append(
                [f"{job['viscosity']:g}", f"{job['yield_stress']:g}", str(job["bars"]), f"{1e3 * job['spacing']:g}",
                 f"{r['passing_ratio']:.2f}", f"{r['passing_ratio_theory']:.2f}", value(r, "h1", 1e3, 0),
                 value(r, "h2", 1e3, 0), value(r, "t200"), value(r, "t400"), f"{100 * r['volume_error']:+.1f}",
                 value(r, "simulated_time", digits=1), value(r["speed"], "wall_time", digits=0)]
            )  # fmt: skip
        head = ["viscosity [Pa s]", "yield stress [Pa]", "bars", "cells [mm]", "H2/H1", "slow flow", "H1 [mm]",
                "H2 [mm]", "T200 [s]", "T400 [s]", "volume, at most [%]", "ends after [s]",
                "wall time [s]"]  # fmt: skip
        self.write("box", head, rows, "2300 kg/m3, gate lifted in 0.5 s, 10 s at most; concrete sticks to the walls.")

    def parts(self) -> None:
        """Measure the loss of a bend and of a reducer beside straight pipe, for three concretes, over the spacing."""
        own = {"concrete": "own", "density": 2350.0, "viscosity": 30.0, "yield_stress": 40.0}
        mixes = {
            "No. 1": {"concrete": "no1"},
            "self-compacting": own | {"slip_viscosity": 1000.0, "slip_yield": 20.0},
            "the same, sticks": own | {"slip_viscosity": 1e8, "slip_yield": 0.0},
        }
        shapes = {
            "bend, R 2.5 D": {"unit": "bend-level"},
            "bend, R 1.5 D": {"unit": "bend-level", "elbow_radius": 0.15},
            "taper, 100 to 80 mm": {"unit": "horizontal", "outlet_diameter": 0.08},
        }
        cases = [(m, s, h) for m in mixes for s in shapes for h in (0.0125, 0.01, 0.00625)]
        jobs = [mixes[m] | shapes[s] | {"spacing": h} for m, s, h in cases]
        rows = []
        for (mix, shape, h), r in zip(cases, self.run_tests("part", jobs)):
            off = [
                100 * (number(r[f"{n}_gradient"]) / number(r[f"{n}_gradient_theory"]) - 1)
                for n in ("upstream", "downstream")
            ]
            rows.append(
                [mix, shape, f"{1e3 * h:g}", f"{off[0]:+.2f}", f"{off[1]:+.2f}", value(r, "middle_loss", 1e-3),
                 f"{r['middle_ratio']:.3f}", f"{100 * r['outflow_error']:+.3f}",
                 value(r["speed"], "wall_time", digits=1)]
            )  # fmt: skip
        head = ["concrete", "part", "cells [mm]", "straight pipe before, off [%]", "behind [%]", "bend or taper [kPa]",
                "over straight pipe of its length and bore", "volume [%]", "wall time [s]"]  # fmt: skip
        self.write("parts", head, rows, "Pipe of 100 mm, 1.5 l/s (0.19 m/s).")

    def run_tests(self, name: str, jobs: list[dict]) -> list[dict]:
        """Results of a scene for each set of parameters: on a CPU in processes, one a core."""
        tasks = [(name, job, self.device) for job in jobs]
        if self.on_gpu:
            return [result(task) for task in tasks]
        with ProcessPoolExecutor(default_threads(), mp_context=multiprocessing.get_context("spawn")) as pool:
            return list(pool.map(result, tasks))


if __name__ == "__main__":
    main(GridStudies, ("shear", "slump", "gone", "steps", "funnel", "box", "parts"), __doc__)
