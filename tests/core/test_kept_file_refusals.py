"""Messages with which wrong values of each entry of a file are refused, kept (see `kept`)."""

import re

from test_kept_refusals import compare

from warpcrete.geometry.lines import read_line
from warpcrete.mix.mix import read_mix
from warpcrete.scenes import modules
from warpcrete.studies.calibration.targets import read_task

LINE = """\
name: site
source: data sheet
recorded: 85 bar
diameter: 125 mm
flow: 30 m3/h
concrete: no1
largest_stone: 16 mm
pump: 120 bar
begin: level
parts:
- straight: 10 m
- bend: {to: up, angle: 90, radius: 1 m}
- straight: {length: 6 m, rise: 6 m, diameter: 125 mm}
- bend: level
- reducer: {to: 100 mm, length: 1 m}
- hose: {length: 5 m, layer: 1.5}
- valve: {length: 0.5 m, factor: 3}
"""
MIX = """\
mix:
  density: 2350 kg/m3
  air: 2 %
  aggregate: 40 %
  aggregate_density: 2650 kg/m3
  sizes: [4 mm, 16 mm]
  slump: 200 mm
  spread: 0.5 m
  t500: 3 s
  water_binder: 0.45
  voids: 24 %
  fine_sand: 15 %
  thickener: false
"""
TARGETS = """\
base: no1
vary:
  yield_stress: [20, 150]
  viscosity: {low: 10, high: 100, scale: log}
targets:
- {scene: slump, quantity: spread, value: 500 mm, uncertainty: 5 %}
- {scene: funnel, quantity: funnel_time, value: 8 s, uncertainty: 10 %, held_out: true}
"""
WRONG = re.compile(r"(?<=: )(?:[^\s\[{:,}][^,}\]\n:]*)(?=[,}\n])|\[[^\]]*\]")
"""Values of a YAML text; each is replaced in turn."""


def test_kept_refusals_of_each_entry_of_a_file(tmp_path):
    """Put nonsense, tiny, negative and large values at each place of a file; the message names file and line."""
    path = tmp_path / "own.yaml"
    kinds = {
        "line": (LINE, lambda: read_line(path)),
        "mix": (MIX, lambda: read_mix(path)),
        "targets": (TARGETS, lambda: read_task(path, modules())),
    }
    cases = {}
    for kind, (text, read) in kinds.items():
        places = [None, *WRONG.finditer(text)]
        for place in places:
            for value in ("[[x]]", "1e-9", "-3", "99", "0.9") if place else ("",):

                def reading(text=text, place=place, value=value, read=read):
                    changed = text[: place.start()] + value + text[place.end() :] if place else text
                    path.write_text(changed, encoding="utf-8")
                    read()

                line = text[: place.start()].count("\n") + 1 if place else 0
                cases[f"{kind} {line}, {place.group() if place else 'as it is'} -> {value}"] = reading
    compare("places", cases, tmp_path)
