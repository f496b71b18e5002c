"""Compare results, reports and figures of runs of every scene with stored ones (see `kept`).

The runs are made up, and their columns go up and down, so that another row, window, sign or unit gives another number.
"""

import zlib
from dataclasses import replace
from types import SimpleNamespace

import kept
import numpy as np
import pytest
from made_runs import RUNS, scene_name

from warpcrete import scenes
from warpcrete.core.run.method import report_of
from warpcrete.core.run.tables import Table
from warpcrete.core.units import quantity
from warpcrete.dem.pictures import plot_aggregates, plot_pressure, plot_stations, plot_strokes
from warpcrete.dem.scene.clumps import templates
from warpcrete.dem.scene.scene import Scene
from warpcrete.methods import method_of
from warpcrete.mps.free.scene import FreeScene
from warpcrete.mps.pictures import plot_flow

STEADILY = ("time", "travel")


def uneven(series):
    """Return the columns of a series, each with its own waves; times and travels rise unevenly."""
    found = {}
    for name, column in series.items():
        k = np.arange(len(column))
        wave = np.sin(0.7 * k + zlib.crc32(name.encode()) % 100)
        if name in STEADILY:
            found[name] = column + 0.2 * (column[1] - column[0]) * (wave - wave[0])
        else:
            found[name] = column * (1 + 0.1 * wave) + (0 if column.any() else 1e-3 * wave)
    return found


def with_tables(run):
    """Return the run with additional results, from which its method draws figures."""
    metres = np.linspace(0, 0.05, 6)
    run.units.update({name: "Pa" if "pressure" in name else "m" for name in run.series})

    def along(unit, values):
        return {"value": list(map(float, values)), "unit": unit}

    if "slip_velocity" in run.result:
        run.result["theory"] = "pipe"
        run.result["profiles"] = [
            {"radius": along("m", metres), "velocity": along("m/s", 0.2 - part * metres), "height": quantity(part, "m")}
            for part in (0.1, 0.2, 0.3)
        ]
    if "outflow_error" in run.result:
        run.result["profile"] = {"place": along("m", metres), "friction_ahead": along("Pa", 1e3 - 2e4 * metres)}
        run.result["parts"] = [{"what": "bend", "loss": quantity(2e3, "Pa"), "loss_theory": quantity(1.6e3, "Pa")}]
    if isinstance(run.scene, FreeScene):
        run.result["surface"] = {
            "place": along("m", metres),
            "base": along("m", 0.1 * metres),
            "height": along("m", 0.3 - metres),
        }
        run.result["spread_heap"] = quantity(0.4, "m")
    return run


def told(run, module):
    """Return all statements about a run: quantities, lines of the report, and checks with their reasons."""
    method = method_of(run.scene)
    shown = [*report_of(method.quantities, run), *method.report(run)]
    return {
        "caption": run.scene.caption,
        "result": {name: value for name, value in run.result.items() if name not in ("profiles", "surface", "profile")},
        "report": {label: text for label, text in shown},
        "checks": {name: [bool(good), words] for name, (good, words) in module.check(run).items()},
        "expected": dict(method.expected(run.scene)),
    }


@pytest.mark.parametrize("name", RUNS)
def test_what_a_run_comes_to_is_kept(name):
    made = RUNS[name]()
    if "-dem" in name and name != "part-dem":
        made.blocked = None
    found = {} if "," in name else {"even": told(with_tables(made.run()), scenes.modules()[scene_name(name)])}
    made.series = uneven(made.series)
    found["waving"] = told(with_tables(made.run()), scenes.modules()[scene_name(name)])
    made.series = {column: values[: len(values) // 3] for column, values in made.series.items()}
    made.finished = made.steady = False
    found["short"] = told(with_tables(made.run()), scenes.modules()[scene_name(name)])
    kept.compare(f"run-{name.replace(', ', '-').replace(' ', '-')}", found)


FIGURES = (
    "channel",
    "tube, rested",
    "part, level",
    "slump",
    "lbox",
    "funnel",
    "lcpc",
    "pipe",
    "pipe, plate",
    "part-dem",
)


@pytest.mark.parametrize("name", FIGURES)
def test_the_figure_of_a_run_is_kept(name):
    made = RUNS[name]()
    made.series = uneven(made.series)
    run = with_tables(made.run())
    show = plot_pressure if isinstance(run.scene, Scene) else method_of(run.scene).show
    columns = list(run.series)
    figures = {"own": show(run), "plot": run.plot(), "over": run.plot(columns[2], columns[1], against=columns[1])}
    if isinstance(run.scene, Scene):
        figures["both"] = show({"one": run, "other": RUNS[name]().run()})
    kept.compare(f"figure-{name.replace(', ', '-')}", {key: kept.drawn(each) for key, each in figures.items()})


def test_figures_with_particles_are_kept():
    """Draw the particles behind the middle, with a colour bar of numbers or a legend of materials."""
    run = with_tables(RUNS["tube"]().run())
    rng = np.random.default_rng(4)
    particles = rng.uniform(-0.05, 0.05, (30, 3)), rng.integers(0, 255, (30, 3)), 0.01
    materials = {"stone": np.array([120, 90, 60]), "mortar": np.array([200, 200, 200])}
    figures = {
        "scale": plot_flow(run, particles, ("speed [m/s]", 0.0, 0.3)),
        "words": plot_flow(run, particles, None, materials),
    }
    assert [len(figure.axes) for figure in figures.values()] == [4, 3]
    kept.compare("figure-particles", {key: kept.drawn(each) for key, each in figures.items()})


def test_figures_of_elements_are_kept():
    made = RUNS["part-dem"]()
    made.series = uneven(made.series)
    run = made.run()
    place = np.linspace(0.05, 0.95, 10)
    columns = {
        "place": place,
        "axial_stress": 9e3 - 5e3 * place,
        "pressure": 6e3 - 3e3 * place,
        "wall_stress": 400 + 100 * place,
        "solid_fraction": 0.4 + 0.1 * place,
        "velocity": np.where(place < 0.9, 0.3, np.nan),
        "velocity_0.25R": 0.35 - 0.1 * place,
        "velocity_0.75R": 0.25 - 0.1 * place,
    }
    run.tables["stations"] = Table(columns, {})
    strokes = scenes.pipe(strokes=2, pause=0.5, stroke=0.2, ramp=0.05, rest=600.0, thixotropy=0.2)
    stroked = replace(RUNS["pipe"](), scene=strokes)
    stroked.series = uneven(stroked.series)
    rng = np.random.default_rng(3)
    count = 40
    bodies = SimpleNamespace(
        template=np.arange(count) % 2,
        size=rng.uniform(0.005, 0.02, count),
        position=rng.uniform(0, 0.2, (count, 3)),
        velocity=rng.normal(0, 0.1, (count, 3)),
        orientation=np.tile([0.0, 0.6, 0.0, 0.8], (count, 1)),
        templates=templates("reference")[:2],
    )
    shown = SimpleNamespace(bodies=bodies, scene=strokes)
    figures = {
        "stations": plot_stations(run),
        "strokes": plot_strokes(stroked.run()),
        "aggregates": plot_aggregates(shown),
        "above": plot_aggregates({"a": shown, "b": shown}, 1, 2),
    }
    kept.compare("figure-elements", {key: kept.drawn(each) for key, each in figures.items()})


class Anything(dict):
    """Results or series in which each name has a value of its own."""

    def __contains__(self, name):
        return True

    def get(self, name, default=None):
        return self[name]


class Results(Anything):
    def __missing__(self, name):
        return 1 + zlib.crc32(name.encode()) % 9000


class Series(Anything):
    def __missing__(self, name):
        return np.linspace(0.2, 0.01 * (1 + zlib.crc32(name.encode()) % 90), 9)


SUSPENDED = dict(spacing=0.005, aggregate_fraction=0.1, aggregate_smallest=0.02, aggregate_largest=0.02)


def test_the_words_of_every_quantity_are_kept():
    """Each quantity with words of its own in a report, for a run whose results are all different."""
    shown = {}
    for name, given in (
        ("pipe", {}), ("part-dem", {}), ("jring-dem", {}), ("tube", {}), ("slump", {}), ("part", {}), ("stretch", {}),
        ("channel", SUSPENDED), ("jring", SUSPENDED | {"lift_time": 0.0}),
        ("part", SUSPENDED | {"diameter": 0.1, "unit": "bend-level"}),
    ):  # fmt: skip
        scene = scenes.modules()[name].scene(**given)
        run = SimpleNamespace(scene=scene, result=Results(), series=Series(), tables=Anything())
        for each in method_of(scene).quantities:
            text = each.words(run) if each.words is not None else ""
            if text and text not in shown.get(each.name, []):
                shown.setdefault(each.name, []).append(text)
    kept.compare("words", shown)
