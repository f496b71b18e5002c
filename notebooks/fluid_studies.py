"""The studies of Xu, Li & Jiang 2021 and what goes beyond them, as tables and figures.

    python notebooks/fluid_studies.py --device cuda --out studies
    python notebooks/fluid_studies.py --only resolution flow --out studies

Writes `NAME.md` and `NAME.png` for each study into the new folder. The pages flow-pipes, flow-xu and flow-phases in
`notebooks/validation` show and discuss them.
"""

import argparse
import multiprocessing
import textwrap
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure

from warpcrete import scenes
from warpcrete.core.device.device import default_threads, find_device
from warpcrete.core.drawing.style import MEASURED, RUN, SECOND, SERIES, THEORY, legend_above, new_figure, rgb
from warpcrete.core.run.run import Run
from warpcrete.mps.common.stepping import run_abreast
from warpcrete.mps.simulation import FluidSimulation
from warpcrete.theory import pipe as theory

MIXES = ("no1", "no2", "no3")
FEW = 6  # mixes for a mean
HALVES = ("inner", "outer", "front", "rear")
FLOWS = (500e-6, 1000e-6, 1500e-6, 2000e-6, 2500e-6, 3000e-6)


def channel(job: tuple[dict, str | None]) -> tuple[dict, dict]:
    """Series and result of a channel, on one thread of a CPU."""
    parameters, device = job
    run = FluidSimulation(scenes.channel(**parameters), device=device, threads=1).run()
    return run.series, run.result


def migration_figure(points: Sequence[tuple[str, float, Sequence[tuple[float, float]]]], seeds: int) -> Figure:
    """Return the figure of the migration of grains, from the mean of each half and its standard error [points].

    Each of the `points` is a concrete, a time [s] and the values of all `HALVES`, in their order.
    """
    figure = new_figure(f"channel, 100 mm wide, 1500 cm3/s, grains in mortar, {seeds} arrangements", 3.2, 3.5)
    titles = ("halves near the axis and near the walls", "halves at the front and at the rear")
    for first, axes, title in zip((0, 2), figure.subplots(2, 1, sharex=True), titles):
        axes.axhline(0, color=rgb(THEORY), linewidth=1, zorder=0)
        for number, mix in enumerate(dict.fromkeys(name for name, _, _ in points)):
            times = np.array([0.0, *(time for name, time, _ in points if name == mix)])
            for half, (line, mark) in zip((first, first + 1), (("-", "o"), ("--", "s"))):
                mean, error = np.array([(0.0, 0.0), *(found[half] for name, _, found in points if name == mix)]).T
                # Curves that lie on each other are shifted sideways, so that their error bars can be read.
                axes.errorbar(
                    times + 0.02 * times[-1] * (number - 1) * (times > 0), mean, error, fmt=line, marker=mark,
                    markersize=4, capsize=2, elinewidth=1, color=rgb(SERIES[number]), label=f"{mix}, {HALVES[half]}",
                )  # fmt: skip
        axes.set(ylabel="change of the fraction\n[percentage points]", title=title)
        legend_above(axes, width=0.85)
    figure.axes[1].set_xlabel("time [s]")
    return figure


class Studies:
    """Device, folder and runs, which all studies share."""

    def __init__(self, device: str | None, folder: Path, fine: float, migration: float, seeds: int) -> None:
        self.device, self.folder, self.fine, self.migration_time = device, folder, fine, migration
        self.seeds = seeds
        self.on_gpu = bool(find_device(device).is_cuda)

    def run(self, scene, keep: bool = False):
        """Run of a scene; with `keep`, the simulation too."""
        simulation = FluidSimulation(scene, device=self.device)
        run = simulation.run()
        return (run, simulation) if keep else run

    def run_all(self, parameters: list[dict]) -> list[tuple[dict, dict]]:
        """Series and result of a channel for each set of parameters: on a GPU abreast, on a CPU a process a core."""
        if self.on_gpu:
            simulations = [FluidSimulation(scenes.channel(**p), device=self.device) for p in parameters]
            outcomes = run_abreast(simulations, [None] * len(simulations), lambda phase, fraction: None)
            for outcome in outcomes:
                if isinstance(outcome, BaseException):
                    raise outcome
            return [(outcome.series, outcome.result) for outcome in outcomes if isinstance(outcome, Run)]
        with ProcessPoolExecutor(default_threads(), mp_context=multiprocessing.get_context("spawn")) as pool:
            return list(pool.map(channel, [(p, self.device) for p in parameters]))

    def write(self, name: str, head: list[str], rows: list[list[str]], note: str = "") -> None:
        """A Markdown table."""
        lines = ["| " + " | ".join(cells) + " |" for cells in [head, ["---"] * len(head), *rows]]
        (self.folder / f"{name}.md").write_text("\n".join(lines) + f"\n\n{note}\n")
        print(f"\n{name}\n" + "\n".join(lines), flush=True)

    def save(self, name: str, figure: Figure) -> None:
        """The study's picture."""
        for axes in figure.axes:
            axes.spines[["top", "right"]].set_visible(False)
        figure.savefig(self.folder / f"{name}.png", dpi=150)

    def resolution(self) -> None:
        """Fig. 12: pressure over the spacing, and what the paper does not show: slip velocity, profile, cost."""
        spacings, rows, runs = (20e-3, 10e-3, 5e-3, 2.5e-3, 2e-3), [], []
        for spacing in spacings:
            run = self.run(scenes.channel(spacing=spacing))
            runs.append(run.result)
            r = run.result
            rows.append(
                [f"{1e3 * spacing:g}", str(r["particles"]), f"{r['pressure']['value'] / 1e3:.3f}",
                 f"{100 * r['pressure_error']:+.2f}", f"{100 * r['slip_velocity']['value']:.2f}",
                 f"{100 * r['slip_velocity_error']:+.2f}", f"{100 * r['profile_error']:.2f}",
                 f"{100 * r['volume_error']:+.3f}", f"{100 * r['force_balance_error']:+.2f}",
                 f"{r['iterations']['viscosity']:.0f}", f"{r['iterations']['pressure']:.0f}"]
            )  # fmt: skip
        orders = [
            np.log(abs(a["slip_velocity_error"] / b["slip_velocity_error"])) / np.log(s / t)
            for a, b, s, t in zip(runs, runs[1:3], spacings, spacings[1:])
        ]
        self.write(
            "resolution",
            ["spacing [mm]", "particles", "pressure [kPa]", "off [%]", "slip [cm/s]", "off [%]", "profile rms [%]",
             "volume [%]", "balance [%]", "velocity it.", "pressure it."],
            rows,
            f"Theory: {runs[0]['pressure_theory']['value'] / 1e3:.3f} kPa, "
            f"{100 * runs[0]['slip_velocity_theory']['value']:.2f} cm/s. Observed order of the slip velocity, 20 to 10 "
            f"and 10 to 5 mm: {', '.join(f'{x:.1f}' for x in orders)}.",
        )  # fmt: skip
        figure = new_figure("channel, 100 mm wide, concrete no1, 1500 cm3/s", 2.9, 2.9)
        top, bottom = figure.subplots(2, 1)
        mm = 1e3 * np.array(spacings)
        top.plot(mm, [r["pressure"]["value"] / 1e3 for r in runs], "o-", color=rgb(RUN), label="this program")
        top.axhline(runs[0]["pressure_theory"]["value"] / 1e3, color=rgb(THEORY), linestyle=":", label="theory")
        top.axhline(9.40, color=rgb(MEASURED), linestyle="--", label="printed theory (Xu et al.)")
        top.set(xlabel="spacing [mm]", ylabel="pressure [kPa]", ylim=(9.2, 9.6))
        legend_above(top)
        bottom.loglog(
            mm, [100 * abs(r["slip_velocity_error"]) for r in runs], "o-", color=rgb(RUN), label="slip velocity"
        )
        bottom.loglog(mm, [100 * r["profile_error"] for r in runs], "s-", color=rgb(SECOND), label="profile, rms")
        bottom.loglog(mm, 2.5 * (mm / 20) ** 2, ":", color=rgb(THEORY), label="second order")
        bottom.set(xlabel="spacing [mm]", ylabel="error [%]", xticks=(2, 5, 10, 20), xticklabels=("2", "5", "10", "20"))
        bottom.minorticks_off()
        legend_above(bottom)
        self.save("resolution", figure)

    def thickness(self) -> None:
        """Fig. 13: a slip layer of some thickness, by which the concrete is thinner."""
        rows, pressures = [], []
        for thickness in (0.0, 2e-3, 4e-3, 6e-3):
            r = self.run(scenes.channel(slip_thickness=thickness)).result
            line = theory.Line(slip_thickness=thickness)
            concrete = scenes.channel(slip_thickness=thickness).concrete
            thick = theory.steady(concrete, line, 1500e-6, "plane").pressure
            pressures.append((thickness, r["pressure"]["value"], thick))
            rows.append(
                [f"{1e3 * thickness:g}", f"{concrete.slip_viscosity:g}", f"{r['pressure']['value'] / 1e3:.3f}",
                 f"{r['pressure_theory']['value'] / 1e3:.3f}", f"{thick / 1e3:.3f}"]
            )  # fmt: skip
        self.write(
            "thickness",
            ["thickness [mm]", "eta_L [Pa s/m]", "pressure [kPa]", "theory, channel of the bulk [kPa]",
             "theory, Eq. 12 in the plane [kPa]"],
            rows,
        )  # fmt: skip
        figure = new_figure("channel, 100 mm wide, concrete no1, 1500 cm3/s")
        axes = figure.subplots()
        x, ours, thick = np.array(pressures).T
        axes.plot(1e3 * x, ours / 1e3, "o-", color=rgb(RUN), label="this program")
        axes.plot(1e3 * x, thick / 1e3, ":", color=rgb(THEORY), label="theory, Eq. 12 in the plane")
        axes.set(xlabel="thickness of the slip layer [mm]", ylabel="pressure [kPa]", ylim=(9.0, 10.2))
        legend_above(axes)
        self.save("thickness", figure)

    def flow(self) -> None:
        """Figs. 16 and 17: pressure against flow, three concretes, one phase and two."""
        figure = new_figure("channel, 100 mm wide and 300 mm high", 2.9, 2.3, 2.5)
        rows = []
        for axes, mix in zip(figure.subplots(3, 1, sharex=True, height_ratios=[2.9, 2.3, 2.5]), MIXES):
            found: dict[bool, list[float]] = {False: [], True: []}
            for flow in FLOWS:
                cells = [mix, f"{1e6 * flow:.0f}"]
                for two in (False, True):
                    r = self.run(
                        scenes.channel(concrete=mix, flow=flow, aggregates=two, spacing=2.5e-3 if two else 5e-3)
                    ).result
                    found[two].append(r["pressure"]["value"] / 1e3)
                    if not two:
                        cells.append(f"{r['pressure_theory']['value'] / 1e3:.3f}")
                        paper = theory.steady(theory.CONCRETES[mix], theory.Line(), flow, "paper")
                        cells.append(f"{paper.pressure / 1e3:.3f}")
                    cells += [
                        f"{r['pressure']['value'] / 1e3:.3f}", f"{100 * r['pressure_error']:+.2f}",
                        f"{100 * r['slip_velocity']['value']:.2f}", f"{100 * r['slip_velocity_error']:+.2f}",
                    ]  # fmt: skip
                rows.append(cells)
            smooth = np.linspace(FLOWS[0], FLOWS[-1], 50)
            line = [theory.steady(theory.CONCRETES[mix], theory.Line(), q, "plane").pressure / 1e3 for q in smooth]
            axes.plot(1e6 * smooth, line, ":", color=rgb(THEORY), label="theory, channel")
            cubic = 1e6 * np.array(FLOWS)
            axes.plot(cubic, found[False], "o", color=rgb(RUN), markersize=5, label="one phase")
            axes.plot(cubic, found[True], "x", color=rgb(SECOND), markersize=6, label="two phases")
            axes.set(ylabel="pressure on\nthe piston [kPa]", title=f"concrete {mix}")
        figure.axes[-1].set_xlabel("flow [cm3/s]")
        legend_above(figure.axes[0])
        self.save("flow", figure)
        self.write(
            "flow",
            ["mix", "flow [cm3/s]", "theory, channel [kPa]", "theory as printed [kPa]", "one phase [kPa]", "off [%]",
             "slip [cm/s]", "off [%]", "two phases [kPa]", "off [%]", "slip [cm/s]", "off [%]"],
            rows,
        )  # fmt: skip

    def fields(self) -> None:
        """Figs. 14, 15 and 18: pressure and velocity of all particles, profiles at three heights."""
        figure = new_figure("channel, 100 mm wide, concrete no1, 1500 cm3/s", 5.2, 3.6)
        fields, profiles = figure.subfigures(2, 1, height_ratios=[5.2, 3.6])
        shown = [*fields.subplots(1, 4), profiles.subplots()]
        rows = []
        for k, two in enumerate((False, True)):
            run, simulation = self.run(scenes.channel(spacing=self.fine, aggregates=two), keep=True)
            r, words = run.result, "two phases" if two else "one phase"
            display = {kind: simulation.display(kind) for kind in ("pressure", "speed", "phase")}
            place = display["speed"].centres()
            place[:, 2] -= run.series["travel"][-1]
            for m, colouring in enumerate(("pressure", "phase" if two else "speed")):
                axes = shown[2 * k + m]
                axes.scatter(100 * place[:, 0], 100 * place[:, 2], s=1.6, c=display[colouring].colours() / 255, lw=0)
                axes.set(aspect="equal", title=f"{words},\nby {colouring}", xlim=(-5.2, 5.2), ylim=(-0.5, 31.5),
                         xlabel="[cm]", ylabel="height [cm]" if not (k or m) else "")  # fmt: skip
                axes.title.set_fontsize("medium")
                if (scale := display[colouring].scale()) is not None:
                    label, lower, upper = scale
                    shades = ScalarMappable(Normalize(lower, upper), "viridis")
                else:  # A bar of both phases; without a bar, this panel would stand higher than the others.
                    label, both = "phase of the particles", np.unique(display[colouring].colours() / 255, axis=0)
                    shades = ScalarMappable(Normalize(0, 2), ListedColormap(both[[-1, 0]]))
                bar = fields.colorbar(shades, ax=axes, pad=0.02, orientation="horizontal", location="bottom", aspect=10)
                if scale is None:
                    bar.set_ticks([0.5, 1.5], labels=["mortar", "grain"])
                bar.set_label(textwrap.fill(label, 12))
            for part, colour in zip(r["profiles"], map(rgb, SERIES)):
                shown[4].plot(
                    100 * np.array(part["radius"]["value"]), 100 * np.array(part["velocity"]["value"]),
                    "x" if two else "o", color=colour, markersize=4,
                    label=f"{1 + two} phase{'s' if two else ''}, {100 * part['height']['value']:.0f} cm",
                )  # fmt: skip
            mixes = [r]
            if two:
                common = dict(spacing=self.fine, aggregates=True)
                mixes += [result for _, result in self.run_all([common | dict(seed=k) for k in range(1, FEW)])]
            slips = [100 * m["slip_velocity"]["value"] for m in mixes]
            pressures = [m["pressure"]["value"] / 1e3 for m in mixes]
            falls = np.array([_falls(m) for m in mixes]) * 100
            rows.append(
                [words, _scattered(slips), "18.4" if two else "18.6", f"{100 * r['slip_velocity_theory']['value']:.2f}",
                 _scattered(pressures, 3), _scattered(falls[:, 0]), _scattered(falls[:, 1], 0)]
            )  # fmt: skip
        radius = np.linspace(0, 0.05, 200)
        state = theory.steady(theory.CONCRETES["no1"], theory.Line(), 1500e-6, "plane")
        curve = 100 * theory.velocity(theory.CONCRETES["no1"], theory.Line(), state, radius)
        shown[4].plot(100 * radius, curve, ":", color=rgb(THEORY), label="theory")
        shown[4].set(xlabel="distance from the middle [cm]", ylabel="velocity [cm/s]")
        legend_above(shown[4])
        self.save("fields", figure)
        self.write(
            "fields",
            ["model", "slip [cm/s]", "printed (Xu et al.)", "theory", "pressure [kPa]", "fall inside 4 cm [cm/s]",
             "of the whole fall [%]"],
            rows,
            f"Two phases: mean and scatter of {FEW} mixes, until steady. "
            f"Plug of the theory: {100 * state.plug_radius:.2f} cm (printed: 1 cm for one phase, 2 cm for two).",
        )  # fmt: skip

    def rigidity(self) -> None:
        """Two phases by spacing: grains are rigid in the solve, so nothing else is to be chosen."""
        rows = []
        for spacing in (5e-3, 2.5e-3, 5e-3 / 3, 1.25e-3):
            jobs = [dict(spacing=spacing, aggregates=True, seed=seed) for seed in range(FEW)]
            results = [result for _, result in self.run_all(jobs)]
            rows.append(
                [f"{1e3 * spacing:.3g}", str(results[0]["particles"]),
                 _scattered([100 * r["pressure_error"] for r in results]),
                 _scattered([100 * r["slip_velocity_error"] for r in results]),
                 _scattered([r["iterations"]["viscosity"] for r in results], 0)]
            )  # fmt: skip
        self.write(
            "rigidity",
            ["spacing [mm]", "particles", "pressure off [%]", "slip off [%]", "velocity it."],
            rows,
            f"Mean and scatter of {FEW} mixes.",
        )

    def migration(self) -> None:
        """Fig. 21: fraction of aggregate inside and outside, in front and behind, over time; means of several mixes."""
        rows = []
        common = dict(spacing=self.fine, aggregates=True, duration=self.migration_time, sample_interval=0.05)
        runs = self.run_all([common | dict(concrete=mix, seed=seed) for mix in MIXES for seed in range(self.seeds)])
        changes, points = {}, []
        for number, mix in enumerate(MIXES):
            own = runs[number * self.seeds : (number + 1) * self.seeds]
            time = own[0][0]["time"]
            parts = {
                name: 100 * np.array([s[f"aggregate_{name}"] - s[f"aggregate_{name}"][0] for s, _ in own])
                for name in HALVES
            }
            changes |= {f"{mix}_{name}": found for name, found in parts.items()}
            for at in (0.4 * time[-1], 0.8 * time[-1], time[-1]):
                k = int(np.argmin(np.abs(time - at)))
                window = slice(max(k - 5, 0), k + 1)  # single grains that cross a border are noise
                cells = [found[:, window].mean(1) for found in parts.values()]
                points.append((mix, time[k], [(c.mean(), float(_standard_error(c))) for c in cells]))
                rows.append(
                    [mix, f"{time[k]:.1f}", *(f"{c.mean():+.3f} +- {_standard_error(c):.3f}" for c in cells),
                     f"{cells[0].std(ddof=1):.2f}", f"{100 * max(abs(r['volume_error']) for _, r in own):.3f}",
                     f"{100 * np.mean([r['pressure_error'] for _, r in own]):+.2f}"]
                )  # fmt: skip
        np.savez_compressed(self.folder / "migration.npz", time=time, **changes)
        figure = migration_figure(points, self.seeds)
        self.save("migration", figure)
        self.write(
            "migration",
            ["mix", "after [s]", "inner [points]", "outer", "front", "rear", "scatter of mixes, inner",
             "volume, at most [%]", "pressure off [%]"],
            rows,
            f"Means of {self.seeds} mixes each and their standard errors; change since the start, mean of 0.3 s.",
        )  # fmt: skip

    def tube(self) -> None:
        """The round pipe, which the paper could not take."""
        rows = []
        for mix in MIXES:
            for spacing in (20e-3, 10e-3, 5e-3):
                r = self.run(scenes.tube(concrete=mix, spacing=spacing)).result
                rows.append(
                    [mix, f"{1e3 * r['spacing']['value']:g}", str(r["particles"]),
                     f"{r['pressure']['value'] / 1e3:.3f}",
                     f"{r['pressure_theory']['value'] / 1e3:.3f}", f"{100 * r['pressure_error']:+.2f}",
                     f"{100 * r['slip_velocity_error']:+.2f}", f"{100 * r['profile_error']:.2f}",
                     f"{r['speed']['wall_time']['value'] / r['steps'] * 1e3:.1f}"]
                )  # fmt: skip
        self.write(
            "tube",
            ["mix", "spacing [mm]", "particles", "pressure [kPa]", "theory, pipe [kPa]", "off [%]", "slip off [%]",
             "profile rms [%]", "a step [ms]"],
            rows,
        )  # fmt: skip

    def long(self) -> None:
        """Five seconds of flow: what the scheme keeps."""
        rows = []
        for mix in MIXES:
            run = self.run(scenes.channel(concrete=mix, duration=5.0, sample_interval=0.05))
            s, r = run.series, run.result
            off = np.abs(s["pressure"][1:] / r["pressure_theory"]["value"] - 1).max()
            rows.append(
                [mix, f"{100 * off:.2f}", f"{100 * r['pressure_error']:+.2f}", f"{100 * r['slip_velocity_error']:+.2f}",
                 f"{100 * r['profile_error']:.2f}", f"{100 * r['volume_error']:+.3f}",
                 f"{100 * r['force_balance_error']:+.2f}", f"{r['speed']['wall_time']['value']:.0f}"]
            )  # fmt: skip
        self.write(
            "long",
            ["mix", "pressure off, at most [%]", "mean of the last second [%]", "slip off [%]", "profile rms [%]",
             "volume, at most [%]", "balance [%]", "wall time [s]"],
            rows,
        )  # fmt: skip


def _scattered(values, digits: int = 2) -> str:
    """Mean, and standard deviation if there are several."""
    mean = f"{np.mean(values):.{digits}f}"
    return mean if len(values) == 1 else f"{mean} +- {np.std(values, ddof=1):.{digits}f}"


def _standard_error(values) -> np.ndarray:
    """Return the standard error of the mean over the first axis."""
    return np.std(values, axis=0, ddof=1) / np.sqrt(len(values))


def _falls(result: dict) -> tuple[float, float]:
    """Return the velocity in the middle minus that at four fifths of the radius, as a mean of the three heights.

    The first number is in m/s, the second is divided by the velocity in the middle minus the slip velocity.
    """
    inside = []
    for part in result["profiles"]:
        radius, velocity = np.array(part["radius"]["value"]), np.array(part["velocity"]["value"])
        inside.append(velocity[0] - np.interp(0.04, radius, velocity))
    middle = np.mean([part["velocity"]["value"][0] for part in result["profiles"]])
    fall = float(np.mean(inside))
    return fall, fall / (middle - result["slip_velocity"]["value"])


NAMES = ("resolution", "thickness", "flow", "fields", "rigidity", "migration", "tube", "long")


def main(kind: type[Studies] = Studies, names: tuple[str, ...] = NAMES, about: str | None = __doc__) -> None:
    """Run the studies asked for."""
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", nargs="+", choices=names, default=names)
    parser.add_argument("--fine", type=float, default=2e-3, help="spacing of fields and migration [m]")
    parser.add_argument("--migration", type=float, default=5.0, help="simulated time of migration [s]")
    parser.add_argument("--seeds", type=int, default=3, help="mixes of migration, for means and errors")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    studies = kind(args.device, args.out, args.fine, args.migration, args.seeds)
    for name in args.only:
        start = time.perf_counter()
        getattr(studies, name)()
        print(f"({name}: {time.perf_counter() - start:.0f} s)", flush=True)


if __name__ == "__main__":
    main()
