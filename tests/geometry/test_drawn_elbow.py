"""The example of the page on pipes from STL files draws an elbow, which a flow accepts; its pressure is told apart."""

import math
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from warpcrete import scenes
from warpcrete.core.run.method import report_of, results_of
from warpcrete.core.units import number
from warpcrete.geometry.mesh_parts import WAYS, bore_of
from warpcrete.mps.part.quantities import QUANTITIES, RunData

PAGE = Path(__file__).parents[2] / "notebooks/how-to/pipe-from-stl.md"


def test_the_example_draws_a_bent_pipe_with_a_wall(tmp_path, monkeypatch):
    trimesh = pytest.importorskip("trimesh", reason="the example draws with trimesh")
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    exec(compile(code, str(PAGE), "exec"), {})
    mesh = trimesh.load_mesh("elbow.stl")
    length = 0.4 + 0.3 * math.radians(60)
    assert mesh.is_watertight
    assert mesh.volume * 1e-9 == pytest.approx(math.pi * (0.055**2 - 0.05**2) * length, rel=0.01)
    bore = bore_of(("wall", "wall_scale"), tmp_path / "elbow.stl", 0.001, ways=WAYS)
    assert bore.axis.length == pytest.approx(length, rel=1e-3)
    assert bore.ends == pytest.approx((0.1, 0.1), rel=2e-3)
    scene = scenes.part(wall="elbow.stl", wall_scale=0.001, straight=0.3, concrete="no1", spacing=0.015)
    # The elbow rises by R (1 - cos 60 degrees), and its straight ends, 0.2 m and 0.3 m, by their sine.
    assert scene.rise == pytest.approx(0.15 + 0.5 * math.sin(math.radians(60)), rel=0.01)
    # The command that the page gives for the round pipe of the program has the same course.
    options = dict(re.findall(r"--(angle|elbow-radius|straight) ([\d.]+)", built_in_command()))
    round_pipe = scenes.part(
        unit="bend-to-vertical", spacing=0.0125, **{key.replace("-", "_"): float(v) for key, v in options.items()}
    )
    assert round_pipe.axis.length == pytest.approx(scene.axis.length, rel=1e-3)
    assert round_pipe.rise == pytest.approx(scene.rise, rel=0.01)
    assert np.isfinite(scene.friction_loss(0.0, scene.axis.length))
    told = pressures_of(scene, 30e3)
    assert "with the straight pipes before and behind the mesh" in told["due to weight"]


def built_in_command():
    """Return the command of the page that simulates the elbow without a mesh."""
    (line,) = re.findall(r"^warpcrete run part --unit bend-to-vertical .*$", PAGE.read_text(encoding="utf-8"), re.M)
    return line


def pressures_of(scene, pressure):
    """Return the report of a made-up run of a part, by label."""
    names = ("upstream_gradient", "middle_loss", "downstream_gradient", "outflow_error")
    series = {name: np.array([0.0, 1.0]) for name in names} | {"pressure": np.array([0.0, pressure])}
    result = results_of(QUANTITIES, RunData(scene, series))
    assert number(result["friction"]) + number(result["weight"]) == pytest.approx(pressure)
    return dict(report_of(QUANTITIES, SimpleNamespace(scene=scene, result=result)))


def test_the_pressure_of_a_part_is_told_apart_into_friction_and_weight():
    """An upright pipe of 0.3 m and a bend with a radius of 0.25 m rise by 0.55 m."""
    given = dict(unit="bend-to-horizontal", straight=0.3, elbow_radius=0.25, concrete="no1", spacing=0.0125)
    told = pressures_of(scenes.part(**given), 30e3)
    weight = 2354 * 9.81 * 0.55 / 1e3
    assert told["due to weight"] == f"{weight:.4g} kPa   (rise 0.55 m; gravity 9.81 m/s2)"
    assert told["due to friction"].startswith(f"{30 - weight:.4g} kPa   (the whole part as straight pipe: ")
    # The made-up loss of the bend is 1 Pa.
    scene = scenes.part(**given)
    straight = scene.friction_loss(*scene.middle)
    assert told["excess over straight"] == f"{(1 - straight) / 1e3:.4g} kPa"
    told = pressures_of(scenes.part(**given, gravity=0.0), 30e3)
    assert told["due to weight"].startswith("0 kPa") and told["due to friction"].startswith("30 kPa")
