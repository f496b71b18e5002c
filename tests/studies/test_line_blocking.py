"""The probability that the narrowest part of a line is blocked: its interval, its runs, and how it continues."""

import json
import math
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from warpcrete import scenes
from warpcrete.cli.main import cli
from warpcrete.studies.lines.blocking import FRICTION, MODULUS, _counted, _parameters, run_blocking
from warpcrete.studies.lines.elements import Elements
from warpcrete.studies.lines.losses import line_of
from warpcrete.theory.bands import wilson_interval

LINE = {"diameter": 0.08, "parts": [{"straight": 1}, {"reducer": {"to": 0.04, "length": 0.08}}, {"straight": 2}]}
TEXT = (
    "diameter: 80 mm\nflow: 3.6 m3/h\nconcrete: zhan\nparts:\n  - straight: 1\n  - reducer: {to: 40 mm, length: 0.08}\n"
)


def test_the_interval_of_a_probability():
    """Wilson's interval by hand for 0 and for 5 of 10, and its symmetry."""
    squared = 1.959964**2
    assert wilson_interval(0, 50) == (0.0, pytest.approx(squared / (50 + squared)))
    low, high = wilson_interval(5, 10)
    half = 1.959964 * math.sqrt(0.25 / 10 + squared / 400) / (1 + squared / 10)
    assert (low, high) == (pytest.approx(0.5 - half), pytest.approx(0.5 + half))
    assert wilson_interval(3, 20) == tuple(pytest.approx(1 - x) for x in reversed(wilson_interval(17, 20)))
    assert wilson_interval(7, 7)[1] == 1.0


def test_the_narrowest_part_is_simulated_with_dry_stones_of_true_size():
    line = line_of(LINE)
    own = _parameters(line.parts[1], line, "zhan", 1e-3, Elements(coarse=1.0), 7)
    scene = scenes.part_dem(**own)
    assert scene.blockage.stop and scene.seed == 7 and own["outlet_diameter"] == 0.04
    assert not scene.stations.each_row  # losses take ten times as long as all other measurements
    usual = scenes.part_dem(concrete="zhan").parameters["wall_friction"]
    assert scene.parameters["friction"] == FRICTION and scene.parameters["wall_friction"] == usual
    assert scene.parameters["modulus"] == MODULUS
    assert scene.fill.sizes.largest == pytest.approx(0.02)
    assert scene.pipe.travel == pytest.approx(0.32)  # at least two windows


def test_a_concrete_may_state_a_wall_without_friction(tmp_path):
    path = tmp_path / "smooth.yaml"
    path.write_text(
        "flow: {density: 2300, viscosity: 20, yield_stress: 50, slip_viscosity: 1000, slip_yield: 20}\n"
        "elements: {wall_friction: 0}\n",
        encoding="utf-8",
    )
    line = line_of(LINE)
    own = _parameters(line.parts[1], line, str(path), 1e-3, Elements(coarse=1.0), 7)
    assert own["wall_friction"] == 0.0 and own["friction"] == FRICTION


def test_the_largest_stone_of_a_line_is_simulated():
    """Scale the sizes of a concrete without a sieve curve; their ratios stay, also when they are enlarged."""
    for coarse, largest in ((1.0, 0.016), (1.5, 0.024)):
        line = line_of(LINE | {"largest_stone": "16 mm"})
        own = _parameters(line.parts[1], line, "zhan", 1e-3, Elements(coarse=coarse), 7)
        usual = _parameters(line.parts[1], line_of(LINE), "zhan", 1e-3, Elements(coarse=coarse), 7)
        assert scenes.part_dem(**own).fill.sizes.largest == pytest.approx(largest)
        assert own["size_min"] / usual["size_min"] == pytest.approx(0.016 / 0.020)
        assert own["plug_ball"] / usual["plug_ball"] == pytest.approx(0.016 / 0.020)


def test_blocked_failed_and_short_runs_are_counted():
    own = _parameters(line_of(LINE).parts[1], line_of(LINE), "zhan", 1e-3, Elements(coarse=1.0), 0)
    results = {
        f"seed-{k}": {"blocked": float(k < 3), "slowest_advance": 0.1 if k == 5 else 0.9, "packing": {"bodies": 400}}
        for k in range(9)
    }
    study = SimpleNamespace(results=results, failures={"seed-9": "unstable"}, cases=[SimpleNamespace(parameters=own)],
                            folder=Path("here"))  # fmt: skip
    found = _counted(study, line_of(LINE).parts[1], Elements(coarse=2.0))  # type: ignore[arg-type]
    assert (found.runs, found.blocked, found.failed, found.short) == (9, 3, 1, 1)
    text = "\n".join(found.lines)
    assert "blocked in 3 of 9 runs: probability 33.3 %" in text and "1 runs failed" in text and "2 times" in text
    assert found.record()["low"] == found.interval[0] and found.record()["interval"].startswith("Wilson")


def test_the_count_must_be_a_count():
    for wrong in ("0", "-3", "many"):
        done = CliRunner().invoke(cli, ["line", "burj-khalifa", "--blocking", wrong])
        assert done.exit_code == 2 and "--blocking" in done.output


@pytest.mark.thorough
def test_an_interrupted_count_continues_with_the_missing_seeds(tmp_path):
    line, settings = line_of(LINE), dict(out=tmp_path, elements=Elements(coarse=1.5), device="cpu", processes=1)
    found = run_blocking(line, "zhan", 5e-3, 2, **settings)
    assert found.runs == 2 and found.part.number == 2 and found.stone == pytest.approx(0.030)
    assert found.blocked == 2  # Stones are three quarters as wide as the bore.
    assert json.loads((tmp_path / "blocking-probability.json").read_text(encoding="utf-8"))["blocked"] == found.blocked
    shutil.rmtree(tmp_path / "parts" / "blocking" / "seed-1")
    kept = tmp_path / "parts" / "blocking" / "seed-0" / "result.json"
    before = kept.stat().st_mtime_ns
    assert run_blocking(line, "zhan", 5e-3, 2, **settings) == found and kept.stat().st_mtime_ns == before
