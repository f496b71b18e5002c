"""Tables and figures of the studies of aggregates in a mortar.

    python notebooks/suspension_tables.py aggregates --out studies

Reads the files of `suspension_studies.py` from the folder `aggregates`, prints one Markdown table for each study, and
writes the tables and the figures into the folder `studies`. Studies without files are left out. A row that comes from a
run that was cut off says so. notebooks/validation/suspension-pipes.md and suspension-vessels.md show and discuss all of
this.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from suspension_figures import FRACTIONS, Layer, layer_figure, migration_figure

from warpcrete.core.drawing.style import SERIES, THEORY, legend_above, new_figure, open_frame, rgb
from warpcrete.theory.bands import wilson_interval
from warpcrete.theory.suspension import SUSPENSIONS, thickening

Store = dict[str, Any]
LAYER = 3e-3
"""Width of the ring at the wall whose aggregates the table of migration counts [m]."""
ENOUGH = 0.6
"""Part of its duration that a run must have reached to count as a measurement of a settling speed."""
YIELDS = np.linspace(0.5, 2.5, 201)
"""Yield stresses of the core over that of the mortar that are tried in the fit of the profiles."""


def load(folder: Path, study: str) -> dict[str, Store]:
    """Return the files of a study by the name of the case; those that have hardly begun are left out."""
    found = {path.stem: json.loads(path.read_text()) for path in sorted((folder / study).glob("*.json"))}
    return {name: store for name, store in found.items() if len(store["series"]) > 1}


def ended(store: Store) -> str:
    """Return how a run ended, for a table."""
    if "error" in store:
        return store["error"].partition(":")[0]
    return "yes" if store["finished"] else f"cut off at {store['series'][-1]['time']:.2g} s"


def late(store: Store, part: float) -> slice:
    """Return the indices of the last `part` of the samples of a run."""
    count = len(store["series"])
    return slice(count - max(1, round(part * count)), count)


def column(store: Store, name: str) -> np.ndarray:
    """Return a column of the time series of a run."""
    return np.array([row[name] for row in store["series"]])


def rings(store: Store) -> tuple[np.ndarray, np.ndarray]:
    """Return radii of rings of equal width in a pipe [m], and volume fractions, shape (samples, rings).

    The area of a ring is proportional to its radius, so radii serve as weights of means over the cross-section.
    """
    radius = store["parameters"]["diameter"] / 2 - np.array(store["distance"])
    return radius, np.array([profile["fraction"] for profile in store["profiles"]])


def flow_speed(store: Store) -> np.ndarray:
    """Return the mean velocity in the cross-section of a pipe [m/s] of each sample."""
    return column(store, "flow") / (np.pi * store["parameters"]["diameter"] ** 2 / 4)


def travel(store: Store) -> float:
    """Return how far the flow has moved in the run [m]."""
    return float(np.trapezoid(flow_speed(store), column(store, "time")))


def profile(store: Store, part: float) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the stress at the wall [Pa], radii [m] and velocities [m/s], means over the last part of a run."""
    chosen = late(store, part)
    velocity = np.array([each["velocity"] for each in store["profiles"][chosen]]).mean(0)
    stress = float(column(store, "wall_stress")[chosen].mean())
    return stress, np.array(store["profiles"][-1]["radius"]), velocity


def fit_core(stores: Sequence[Store], part: float) -> tuple[float, float, np.ndarray, np.ndarray]:
    """Fit Bingham profiles to the cores of runs that differ in the stress at the wall only.

    The core reaches to one diameter of an aggregate from the wall. All runs share its yield stress and viscosity, and
    each has a velocity of its own at the wall, the slip velocity. Returns yield stress and viscosity of the core over
    those of the mortar, the stresses at the wall [Pa], and the slip velocities [m/s].
    """
    given = stores[0]["parameters"]
    wall, edge = given["diameter"] / 2, given["diameter"] / 2 - given["aggregate_largest"]
    seen = [profile(store, part) for store in stores]
    best: tuple[float, float, float, np.ndarray] | None = None
    for ratio in YIELDS:
        yield_stress, rows, values = ratio * given["yield_stress"], [], []
        for number, (stress, radius, velocity) in enumerate(seen):
            inside = radius < edge
            sheared = np.maximum(radius, min(wall * yield_stress / stress, wall))
            shape = stress / (2 * wall) * (wall**2 - sheared**2) - yield_stress * (wall - sheared)
            own = np.zeros((int(inside.sum()), len(seen) + 1))
            own[:, 0], own[:, 1 + number] = shape[inside] / given["viscosity"], 1.0
            # Each run counts equally, and each ring by its area.
            weight = np.sqrt(radius[inside]) / velocity[0]
            rows.append(own * weight[:, None])
            values.append(velocity[inside] * weight)
        matrix, target = np.concatenate(rows), np.concatenate(values)
        found = np.linalg.lstsq(matrix, target, rcond=None)[0]
        error = float(np.sum((matrix @ found - target) ** 2))
        if best is None or error < best[0]:
            best = error, float(ratio), float(1 / found[0]), found[1:]
    assert best is not None
    return best[1], best[2], np.array([stress for stress, _, _ in seen]), best[3]


def straight(stress: np.ndarray, slip: np.ndarray) -> tuple[float, float]:
    """Return viscosity over thickness [Pa s/m] and yield stress [Pa] of a layer; relative deviations count equally."""
    slope, start = np.polyfit(slip, stress, 1, w=1 / stress)
    return float(slope), float(start)


def wall_layer(store: Store, chosen: slice) -> tuple[float, float]:
    """Return the fraction in the core, and the distance from the wall [m] at which half of it is reached."""
    radius, fraction = rings(store)
    mean, distance = fraction[chosen].mean(0), np.array(store["distance"])
    core = distance > store["parameters"]["aggregate_largest"]
    inner = float(np.average(mean[core], weights=radius[core]))
    above = int(np.argmax(mean > inner / 2))
    return inner, float(np.interp(inner / 2, mean[: above + 1], distance[: above + 1]))


def lag(store: Store) -> np.ndarray:
    """Return the velocity of aggregates relative to mortar and aggregates at the same radius [m/s] of each sample."""
    radius, fraction = rings(store)
    aggregates, found = column(store, "aggregate_velocity"), [0.0]
    for each, own, speed in zip(store["profiles"][1:], fraction[1:], aggregates[1:], strict=True):
        local = np.interp(radius, each["radius"], each["velocity"])
        found.append(speed - np.average(local, weights=own * radius))
    return np.array(found)


def uneven_stress(store: Store) -> float:
    """Return the largest stress along the pipe [Pa] by which uneven weight at the start would drive mortar at rest."""
    radius, fraction = rings(store)
    order, given = np.argsort(radius), store["parameters"]
    excess = (fraction[0] - np.average(fraction[0], weights=radius))[order]
    radius = radius[order]
    weight = (given["aggregate_density"] - given["density"]) * given["gravity"]
    return float(np.abs(np.cumsum(excess * radius) * np.diff(radius).mean() / radius).max() * weight)


def inner_fraction(store: Store) -> np.ndarray:
    """Return the volume fraction within half of the pipe's radius of each sample."""
    radius, fraction = rings(store)
    inside = radius < store["parameters"]["diameter"] / 4
    return np.average(fraction[:, inside], weights=radius[inside], axis=1)


def at_wall(store: Store) -> np.ndarray:
    """Return the volume fraction in the ring at the wall of each sample."""
    radius, fraction = rings(store)
    inside = np.array(store["distance"]) < LAYER
    return np.average(fraction[:, inside], weights=radius[inside], axis=1)


class Tables:
    """The tables and figures of all studies, written into a folder."""

    def __init__(self, runs: Path, folder: Path) -> None:
        self.runs, self.folder = runs, folder

    def write(self, name: str, head: list[str], rows: list[list[str]]) -> None:
        """Write and print a Markdown table."""
        lines = ["| " + " | ".join(cells) + " |" for cells in [head, ["---"] * len(head), *rows]]
        (self.folder / f"{name}.md").write_text("\n".join(lines) + "\n")
        print(f"\n{name}\n" + "\n".join(lines), flush=True)

    def save(self, name: str, figure: Figure) -> None:
        """Write a figure."""
        open_frame(*figure.axes)
        figure.savefig(self.folder / f"suspension_{name}.png", dpi=150)

    def layer(self) -> None:
        """Show the slip layer: fraction over distance, thickness, and the law of stress over slip velocity."""
        stores = load(self.runs, "a")
        rows, layers = [], []
        for surfaces, part in (("sticks", 0.5), ("slips", 0.1)):
            for fraction in FRACTIONS:
                chosen = [s for s in stores.values() if s["varied"]["surfaces"] == surfaces
                          and s["varied"]["fraction"] == fraction and s["varied"]["seed"] == 0]  # fmt: skip
                chosen.sort(key=lambda store: store["varied"]["stress"])
                if len(chosen) < 3:
                    continue
                given = chosen[0]["parameters"]
                cores = [wall_layer(store, late(store, 0.5)) for store in chosen]
                yields, thick, stress, slip = fit_core(chosen, part)
                slope, start = straight(stress, slip)
                off = 100 * np.abs((slope * slip + start) / stress - 1).max()
                inner, half = np.mean(cores, axis=0)
                before = wall_layer(chosen[0], slice(0, 1))[1]
                # A layer of mortar that sticks has this thickness; a layer that slips has none.
                thickness = f"{1e3 * given['viscosity'] / slope:.2f}" if surfaces == "sticks" else "-"
                theory = thickening(inner, *SUSPENSIONS["spheres"])
                rows.append([surfaces, f"{fraction:g}", f"{inner:.2f}", f"{1e3 * before:.1f}", f"{1e3 * half:.1f}",
                             f"{slope:.0f}", f"{start:.0f}", f"{off:.1f}", thickness,
                             f"{thick:.1f}", f"{theory[0]:.1f}", f"{yields:.2f}", f"{theory[1]:.2f}"])  # fmt: skip
                if surfaces == "slips":
                    continue
                mean = rings(chosen[-1])[1][late(chosen[-1], 0.5)].mean(0)
                distance = np.array(chosen[-1]["distance"])
                layers.append(Layer(fraction, distance, mean, slip, stress, slope, start))
        figure = layer_figure(layers)
        self.save("layer", figure)
        head = ["mortar", "fraction", "in the core", "half of it at [mm], start", "late",
                "eta_L [Pa s/m]", "tau_L0 [Pa]",
                "fit off by at most [%]", "mu / eta_L [mm]", "viscosity of the core / mortar", "Krieger & Dougherty",
                "yield stress of the core / mortar", "Chateau et al."]  # fmt: skip
        self.write("layer", head, rows)
        self.seeds([store for store in stores.values() if store["varied"]["surfaces"] == "sticks"])

    def seeds(self, stores: list[Store]) -> None:
        """Show how the flow of runs differs that differ in their random places only."""
        rows = []
        for key in sorted({(s["varied"]["fraction"], s["varied"]["stress"]) for s in stores}):
            same = [s for s in stores if (s["varied"]["fraction"], s["varied"]["stress"]) == key and s["finished"]]
            if len(same) < 2:
                continue
            flows = [1e6 * column(s, "flow")[late(s, 0.5)].mean() for s in same]
            halves = [1e3 * wall_layer(s, late(s, 0.5))[1] for s in same]
            rows.append([f"{key[0]:g}", f"{key[1]:g}", str(len(same)), f"{np.mean(flows):.0f}",
                         f"{np.std(flows, ddof=1):.0f}", f"{np.mean(halves):.2f}",
                         f"{np.std(halves, ddof=1):.2f}"])  # fmt: skip
        head = ["fraction", "stress [Pa]", "seeds", "flow [cm3/s]", "standard deviation", "half of the core at [mm]",
                "standard deviation"]  # fmt: skip
        self.write("seeds", head, rows)
        self.laws([store for store in stores if store["finished"]])

    def laws(self, stores: list[Store]) -> None:
        """Show the law of the layer for each seed, from those stresses that all seeds of a fraction have in common."""
        rows = []
        for fraction in FRACTIONS:
            found: dict[int, dict[float, Store]] = {}
            for store in stores:
                if store["varied"]["fraction"] == fraction:
                    found.setdefault(store["varied"]["seed"], {})[store["varied"]["stress"]] = store
            common = sorted(set.intersection(*map(set, found.values()))) if len(found) > 1 else []
            if len(common) < 2:
                continue
            for seed, own in sorted(found.items()):
                slope, start = straight(*fit_core([own[stress] for stress in common], 0.5)[2:])
                thickness = 1e3 * own[common[0]]["parameters"]["viscosity"] / slope
                rows.append([f"{fraction:g}", ", ".join(f"{stress:g}" for stress in common), str(seed),
                             f"{slope:.0f}", f"{start:.0f}", f"{thickness:.2f}"])  # fmt: skip
        head = ["fraction", "stresses [Pa]", "seed", "eta_L [Pa s/m]", "tau_L0 [Pa]", "mu / eta_L [mm]"]
        self.write("laws", head, rows)

    def migration(self) -> None:
        """Show the fraction in the inner half of the radius, and in the ring at the wall, over the travel."""
        rows, curves = [], []
        for name, store in load(self.runs, "b").items():
            inner, wall, time = 100 * inner_fraction(store), 100 * at_wall(store), column(store, "time")
            last = late(store, 0.1)
            rows.append([name, ended(store), f"{travel(store) / store['parameters']['diameter']:.1f}",
                         f"{inner[0]:.1f}", f"{inner[last].mean() - inner[0]:+.2f}", f"{wall[0]:.1f}",
                         f"{wall[last].mean() - wall[0]:+.2f}"])  # fmt: skip
            curves.append((store["varied"], time, inner - inner[0]))
        figure = migration_figure(curves)
        self.save("migration", figure)
        head = ["run", "ended", "travel [diameters]", "inner fraction at the start [%]", "change [points]",
                "fraction at the wall at the start [%]", "change [points]"]  # fmt: skip
        self.write("migration", head, rows)

    def tests(self) -> None:
        """Show the standard tests at the end, or at the last time that a run with aggregates reached."""
        stores, rows = load(self.runs, "c"), []
        figure = new_figure("concrete of 30 Pa s and 50 Pa, aggregate fraction 0.3", 3.0, 2.8)
        for axes, test in zip(figure.subplots(2, 1, sharex=True), ("slump", "jring"), strict=True):
            for name, store in stores.items():
                if name.startswith(test) and "surface" in store.get("result", {}):
                    surface = store["result"]["surface"]
                    # Where bars stand, the thickness of the concrete is not its height.
                    free = np.array(surface["base"]["value"]) == 0
                    height = np.where(free, 1e3 * np.array(surface["height"]["value"]), np.nan)
                    method, seed = store["varied"]["method"], store["varied"]["seed"]
                    label = method if method == "flow" else f"{method}, seed {seed}"
                    axes.plot(1e3 * np.array(surface["place"]["value"]), height, color=rgb(SERIES[method == "flow"]),
                              linestyle=("-", "--", ":")[seed % 3], label=label)  # fmt: skip
            axes.set(ylabel="height [mm]", title={"slump": "slump test", "jring": "J-ring test"}[test])
        figure.axes[1].set_xlabel("distance from the axis [mm]")
        legend_above(figure.axes[0])
        self.save("heaps", figure)
        shown = {"slump": ("slump", "spread", "t500"), "jring": ("slump", "spread", "blocking_step"),
                 "funnel": ("funnel_time",), "lbox-0": ("t400",), "lbox-3": ("t400",)}  # fmt: skip
        for name, store in stores.items():
            test = store["varied"]["test"]
            if test in shown and (result := store.get("result")):
                values = [
                    f"{quantity} {1e3 * result[quantity]['value']:.4g}"
                    for quantity in shown[test]
                    if quantity in result
                ]
                if "passing_ratio" in result:
                    values.append(f"H2/H1 {result['passing_ratio']:.3f}")
                surface = result.get("surface") or {}
                centre = surface.get("height", {}).get("value", ())[:10]
                rows.append([name, ended(store), ", ".join(values), f"{1e3 * np.mean(centre):.1f}" if centre else "-"])
            elif f"{test}-flow" in stores:
                row = store["series"][-1]
                same = min(stores[f"{test}-flow"]["series"], key=lambda other: abs(other["time"] - row["time"]))
                values = [f"{key} {1e3 * row[key]:.4g} (flow {1e3 * same[key]:.4g})"
                          for key in ("near_depth", "far_depth", "front", "inside") if key in row
                          and (key != "inside" or test == "funnel")]  # fmt: skip
                rows.append([name, ended(store), ", ".join(values), "-"])
        self.write(
            "tests", ["run", "ended", "quantities [mm, ms, or thousandths]", "mean height within 50 mm [mm]"], rows
        )

    def pumping(self) -> None:
        """Show the pressure of a pipe with a bend, over the size and the shape of the aggregates."""
        rows = []
        for store in load(self.runs, "d").values():
            if store["finished"]:
                varied, result = store["varied"], store["result"]
                pressure, error = (1e-3 * result[name]["value"] for name in ("pressure", "pressure_error"))
                rows.append([varied["kind"], f"{1e3 * varied['size']:g}", f"{varied['shape']:g}",
                             f"{varied['friction']:g}", str(varied["seed"]), f"{pressure:.2f}", f"{error:.2f}",
                             f"{1e-3 * result['pressure_theory']['value']:.2f}"])  # fmt: skip
        head = ["varied", "size [mm]", "shape factor", "friction", "seed", "pressure [kPa]", "error of the mean [kPa]",
                "theory of the mortar [kPa]"]  # fmt: skip
        self.write("pumping", head, rows)

    def blocking(self) -> None:
        """Show how many aggregates have passed the bars of a J-ring, and the share of blocked reducers."""
        stores = load(self.runs, "e")
        groups: dict[tuple[int, float], list[Store]] = {}
        for store in stores.values():
            if store["varied"]["kind"] == "bars" and store["finished"]:
                groups.setdefault((store["varied"]["bars"], store["varied"]["fraction"]), []).append(store)
        rows = []
        for (bars, fraction), found in sorted(groups.items()):
            gap = 0.3 * np.sin(np.pi / bars) - 0.018
            results = [store["result"] for store in found]
            passed, mortar = (
                float(np.mean([result[f"{what}_passed"] for result in results])) for what in ("aggregates", "mortar")
            )
            counted = sum(result["aggregates"]["count"] for result in results)
            step, spread = (
                1e3 * float(np.mean([result[name]["value"] for result in results]))
                for name in ("blocking_step", "spread")
            )
            rows.append([str(bars), f"{gap / found[0]['parameters']['aggregate_largest']:.2f}", f"{fraction:g}",
                         str(len(found)), f"{passed:.2f}", f"{np.sqrt(passed * (1 - passed) / counted):.2f}",
                         f"{mortar:.2f}", f"{step:.1f}", f"{spread:.0f}"])  # fmt: skip
        head = ["bars", "gap / size", "fraction", "seeds", "aggregates passed", "error by their number",
                "mortar passed", "blocking step [mm]", "spread [mm]"]  # fmt: skip
        self.write("blocking", head, rows)
        if reducers := [s for s in stores.values() if s["varied"]["kind"] == "reducer" and s["finished"]]:
            self.reducers(reducers)

    def reducers(self, stores: list[Store]) -> None:
        """Show the share of random placements of the aggregates for which a reducer was blocked."""
        groups: dict[float, dict[float, list[Store]]] = {}
        for store in stores:
            varied = store["varied"]
            groups.setdefault(varied["fraction"], {}).setdefault(varied["outlet"], []).append(store)
        mix = "spheres of 20 mm with friction 0.5 in the mortar of soft concrete"
        rows, figure = [], new_figure(f"reducers from 100 mm, flow 1.4 m3/h, {mix}")
        axes = figure.subplots()
        for (fraction, outlets), colour in zip(sorted(groups.items()), SERIES, strict=False):
            points = []
            for outlet, found in sorted(outlets.items()):
                results = [store["result"] for store in found]
                blocked = sum(result["ended"]["reason"] == "blocked" for result in results)
                share, size = blocked / len(found), found[0]["parameters"]["aggregate_largest"]
                low, high = wilson_interval(blocked, len(found))
                pressure, theory = (
                    1e-3 * float(np.median([result[name]["value"] for result in results]))
                    for name in ("pressure", "pressure_theory")
                )
                points.append((outlet / size, share, share - low, high - share))
                rows.append([f"{1e3 * outlet:g}", f"{outlet / size:.2f}", f"{fraction:g}", str(len(found)),
                             str(blocked), f"{low:.2f} to {high:.2f}", f"{pressure:.1f}", f"{theory:.1f}"])  # fmt: skip
            # Shift the markers of the two fractions apart, so that their error bars do not cover one another.
            across = np.array([point[0] for point in points]) + 0.03 * (len(axes.lines) > 0)
            below, above = ([point[n] for point in points] for n in (2, 3))
            axes.errorbar(across, [point[1] for point in points], [below, above], marker="o", markersize=4, capsize=3,
                          color=rgb(colour), label=f"fraction {fraction:g}")  # fmt: skip
        axes.set(xlabel="diameter of the outlet over that of an aggregate", ylabel="share of blocked runs",
                 ylim=(-0.02, 1.02))  # fmt: skip
        legend_above(axes)
        self.save("reducers", figure)
        head = ["outlet [mm]", "outlet / aggregate", "fraction", "runs", "blocked", "95 % interval of the probability",
                "median pressure [kPa]", "theory of the mortar [kPa]"]  # fmt: skip
        self.write("reducers", head, rows)

    def settling(self) -> None:
        """Show the speed at which aggregates fall through mortar at rest and in a pipe, over the yield stress."""
        points: dict[tuple[str, float, float, float], dict[float, list[float]]] = {}
        uneven: dict[float, list[float]] = {}
        for store in load(self.runs, "f").values():
            if store["series"][-1]["time"] < ENOUGH * store["parameters"]["duration"]:
                continue
            varied, beta = store["varied"], store["parameters"]["regularisation"]
            key = (varied["kind"], varied["fraction"], beta, varied["stress"])
            speed = -1e3 * float(lag(store)[late(store, 0.25)].mean())
            points.setdefault(key, {}).setdefault(varied["part"], []).append(speed)
            uneven.setdefault(varied["fraction"], []).append(uneven_stress(store))
        rows, figure = [], new_figure("upright pipe, spheres of 16 mm in a mortar of 5 Pa s at rest")
        axes = figure.subplots()
        for key, found in sorted(points.items()):
            kind, fraction, beta, stress = key
            for part, speeds in sorted(found.items()):
                spread = f"{np.std(speeds, ddof=1):.3f}" if len(speeds) > 1 else "-"
                rows.append([kind, f"{fraction:g}", f"{beta:g}", f"{stress:g}", f"{part:g}", str(len(speeds)),
                             f"{np.mean(speeds):.3f}", spread, f"{3.6 * np.mean(speeds):.2f}"])  # fmt: skip
            if kind == "rest":
                parts = sorted(found)
                axes.semilogy(parts, [np.mean(found[part]) for part in parts], "o-" if beta < 500 else "s--",
                              color=rgb(SERIES[fraction > 0.2]), markersize=4,
                              label=f"fraction {fraction:g}, beta {beta:g}")  # fmt: skip
        axes.axvline(1.0, color=rgb(THEORY), linestyle=":")
        axes.set(xlabel="yield stress over that of Beris' criterion", ylabel="settling speed [mm/s]")
        legend_above(axes)
        self.save("settling", figure)
        head = ["", "fraction", "beta", "stress at the wall [Pa]", "yield stress / critical", "seeds",
                "speed [mm/s]", "standard deviation", "in an hour [m]"]  # fmt: skip
        self.write("settling", head, rows)
        stresses = ", ".join(f"{max(found):.1f} Pa at {fraction:g}" for fraction, found in sorted(uneven.items()))
        print(f"Stress by uneven weight, at most: {stresses}")


def main() -> None:
    """Print the tables of all studies that have files, and draw their figures."""
    reader = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    reader.add_argument("runs", type=Path, help="folder of suspension_studies.py")
    reader.add_argument("--out", type=Path, required=True, help="folder for tables and figures")
    given = reader.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    tables = Tables(given.runs, given.out)
    studies = {"a": tables.layer, "b": tables.migration, "c": tables.tests, "d": tables.pumping,
               "e": tables.blocking, "f": tables.settling}  # fmt: skip
    for study, show in studies.items():
        if (given.runs / study).is_dir():
            show()


if __name__ == "__main__":
    main()
