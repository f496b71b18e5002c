"""Inputs for attack_inputs.py: what is typed, which files there are, and what must be answered."""

# ruff: noqa: E501  (rows of tables)

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

Content = str | bytes | Callable[[Path, Path], None]
SITE = "diameter: 125 mm\nflow: 20 m3/h\nconcrete: no1\nparts:\n  - straight: 10 m\n"
MIX = "mix:\n  density: 2300\n  spread: 600 mm\n  sizes: [4 mm, 16 mm]\n"
PLAIN = r"pressure at the pump 2\.053 bar"
"""Answer to the line above."""
TARGET = "{scene: slump, parameters: {concrete: own, density: 2350, slip_viscosity: 900, slip_yield: 20}, "


@dataclass(frozen=True)
class Attack:
    """An input and the answer that it must have."""

    kind: str
    label: str
    words: str
    """Arguments as a user types them after the name of the command."""
    says: str = ""
    """Expression that the answer holds."""
    files: dict[str, Content] = field(default_factory=dict)
    codes: tuple[int, ...] = (2,)
    leaves: tuple[str, ...] = ()
    """Files and folders that the command may make or change."""


def changed(text: str, old: str, new: str) -> str:
    """Return a text in which a part that it must hold is another."""
    assert old in text, (old, text)
    return text.replace(old, new)


def part(text: str) -> str:
    """Return a line with one part more."""
    return SITE + f"  - {text}\n"


LINES = [  # contents, and what is said: "" for any one line, =TEXT for an answer with exit code 0
    (SITE.replace("\n", "\r\n"), "=" + PLAIN), (SITE.replace("\n", "\r"), "=" + PLAIN),
    ("\ufeff" + SITE, "=" + PLAIN), ("---\n" + SITE + "...\n", "=" + PLAIN),
    ("%YAML 1.2\n---\n" + SITE, "=" + PLAIN), (SITE.replace("flow: 20", "flow:\t20"), "not valid YAML"),
    (SITE.replace("20 m3/h", "20\u00a0m3/h"), "=" + PLAIN), (SITE.replace("20 m3/h", "+2e1m3/h"), "=" + PLAIN),
    (SITE.replace("20 m3/h", "\uff12\uff10 m3/h"), "=" + PLAIN),
    (SITE.replace("20 m3/h", "\u0662\u0660 m3/h"), "=" + PLAIN),
    (SITE.replace("20 m3/h", "20 \uff4d3/h"), "flow"), (SITE.replace("20 m3/h", "20\u200bm3/h"), "flow"),
    (SITE.replace("20 m3/h", "\u221220 m3/h"), "flow"), (SITE.replace("20 m3/h", "20 m3"), "flow"),
    (SITE.replace("20 m3/h", "20 m3/mi"), "flow"), (SITE.replace("20 m3/h", "20 M3/H"), "did you mean 'm3/h'"),
    (SITE.replace("20 m3/h", "-20 m3/h"), "above 0"), (SITE.replace("20 m3/h", "0"), "above 0"),
    (SITE.replace("20 m3/h", "20 kg/s"), "flow"), (SITE.replace("20 m3/h", "0x14"), "impossible"),
    (SITE.replace("20 m3/h", "[20, m3/h]"), "flow"), (SITE.replace("20 m3/h", "{value: 20}"), "flow"),
    (SITE.replace("20 m3/h", "true"), "flow"), (SITE.replace("20 m3/h", ""), "flow"),
    (SITE.replace("20 m3/h", "1/180"), "flow"), (SITE.replace("20 m3/h", "20 m3/h;"), "flow"),
    (SITE.replace("20 m3/h", "20 000 l/h"), "flow"), (SITE.replace("20 m3/h", "20'000 l/min"), "flow"),
    (SITE.replace("125 mm", "125 m"), "impossible"), (SITE.replace("125 mm", "5\""), "=pressure"),
    (SITE.replace("125 mm", "DN125"), "diameter"), (SITE.replace("125 mm", "-125 mm"), "above 0"),
    (SITE.replace("125 mm", "125 mm\ndiameter : 100 mm"), "twice"), (SITE.replace("diameter", "Diameter"), "did you"),
    (SITE.replace("no1", "no4"), "concrete"), (SITE.replace("no1", "site.yaml"), "unknown key 'diameter'"),
    (SITE.replace("no1", "there/c.yaml"), "cannot be read"), (SITE.replace("no1", "[no1]"), ""),
    (SITE.replace("no1", "zhan"), ""), (SITE.replace("concrete: no1", "concrete:"), ""),
    (SITE + "begin: upward\n", "begin"), (SITE + "begin: [1, 0, 0]\n", "begin"),
    (SITE + "recorded: 17 MN\n", "recorded"), (SITE + "recorded: -3 bar\n", "above 0"),
    (SITE + "largest_stone: 16\n", "impossible"), (SITE + "largest_stone: 160 mm\n", "does not pass"),
    (SITE + "largest_stone: 32%\n", "largest_stone"), (SITE + "name: {a: b}\n", "name"),
    (SITE + 'name: "a\\nb"\n', "=" + r"\*\*2\.053 bar|2\.053"), (SITE + 'name: "\\e[2J\\a"\n', "=2\\.053"),
    (SITE + "name: " + "n" * 90_000 + "\n", "=2\\.053"),
    (SITE + "<<: {flow: 3 m3/h}\n", "<<"), (SITE + "x: &a 1\n", "did you|must be one of"),
    ("parts: &p\n  - straight: 10 m\ndiameter: 125 mm\nflow: 20 m3/h\nconcrete: no1\n", "=" + PLAIN),
    (SITE.replace("  - straight: 10 m", "  - &p {straight: 5 m}\n  - *p"), "=2\\.053"),
    (SITE.replace("straight: 10 m", "straight: !length 10 m"), "tag"), (SITE + "---\n" + SITE, "not valid YAML"),
    (SITE.replace("  - straight", "\t- straight"), ""), (SITE.replace("straight: 10 m", "straight: 10 mm"), "="),
    (SITE.replace("straight: 10 m", "straight: -10 m"), "above 0"), (SITE.replace("10 m\n", "0\n"), "above 0"),
    (SITE.replace("straight: 10 m", "{straight: 1, straight: 2}"), "twice"),
    (SITE.replace("straight: 10 m", "{straight: 1, bend: {to: up, radius: 1}}"), "must be one of"),
    (SITE.replace("- straight: 10 m", "straight: 10 m"), "must be a list"),
    (SITE.replace("\n  - straight: 10 m", " straight"), "must be a list"),
    (SITE.replace("\n  - straight: 10 m", " [straight]"), "must be one of"),
    (SITE.replace("\n  - straight: 10 m", " []"), "must be a list"),
    (SITE.replace("10 m\n", "{length: 10 m, rise: -3 m}\n"), "rise"),
    (SITE.replace("10 m\n", "{length: 10 m, lenght: 3 m}\n"), "did you mean 'length'"),
    (SITE.replace("10 m\n", "{rise: 0}\n"), "has no 'length'"), (SITE.replace("10 m\n", "[10 m]\n"), "length"),
    (part("bend: {to: north, radius: 1}"), "must be one of"), (part("bend: {to: up}"), "=radius 0.5 m"),
    (part("bend: {radius: 1 m}"), "to = None"), (part("bend: up"), "=radius 0.5 m"), (part("bend: 90"), "must be one of"),
    (part("bend: {to: up, radius: 500}"), "=unusual"), (part("bend: {to: up, radius: -0.5 m}"), "radius"),
    (part("bend: {to: up, radius: 0.5 m, angle: 90 rad}"), "angle"), (part("bend: {to: [up], radius: 1}"), "to"),
    (part("bend: {to: up, radius: 0.5 m, angle: -90}"), "angle"),
    (part("bend: {to: up, radius: 0.5 m, angle: 50 %}"), "angle"),
    (part("reducer: {to: 125 mm, length: 1 m}"), "is already the diameter"), (part("reducer: {to: 100, length: 1 m}"), "imp"),
    (part("reducer: {to: 100 mm, length: 1 mm}"), "half of the change"),
    (part("reducer: {to: 1 mm, length: 1 m}"), "flow at|diameter|velocity|impossible"),
    (part("reducer: {to: 20 mm, length: 1 m}"), "=unusual"),
    (part("hose: {points: [[1000, 0, 0], [2000, 0, -500]]}"), "=2133"), (part("hose: {points: [[1, 0]]}"), "three coordinates"),
    (part("hose: {points: [1, 0, 0]}"), "three"), (part("hose: {points: [[a, b, c]]}"), "number"),
    (part("hose: {points: {a: [1, 0, 0]}}"), "list of points"), (part("hose: {points: [[0, 1, 0]]}"), "an angle of 90 degrees"),
    (part("hose: {points: [[1, 0, 0], [1, 0, 0]]}"), "apart"), (part("hose: {points: [[-1, 0, 0]]}"), "degrees"),
    (part("hose: {points: [[1, 0, 0]], layer: 80}"), "=unusual"), (part("hose: {points: [[1, 0, 0]], layer: -1}"), "layer"),
    (part("hose: {points: [[null, 0, 0]]}"), "number"), (part("hose: 8 m"), "=hose"), (part("hose: {length: 8 m, factor: 0}"), "factor"),
    (part("valve: {length: 1 m, equivalent: 3 m, factor: 2}"), "together"), (part("valve: 1 kg"), "length"),
    (part("bore: {file: .}"), "directory"), (part("bore: {file: /etc/hostname}"), ""),
    (part("bore: {file: site.yaml}"), "cannot be read"), (part("bore: {file: 3}"), "mesh file"),
    (part("bore: {file: a.stl, scale: 0}"), "above 0"), (part("bore: {file: a.stl, outlet: 100}"), "impossible"),
    (part('bore: {file: "a\\nb.stl"}'), "cannot be read"), (part("elbow: 90"), "must be one of"), (part("straight"), ""),
    (SITE + "parts:\n" + "  - straight: 1\n", "twice"), ("- " * 3000 + "1\n", ""), ("? " * 3000 + "1\n", ""),
    ("a:\n" + "".join(" " * k + "a:\n" for k in range(1, 600)), ""), ("{" * 99, ""), ("a: |\n" + " x\n" * 9, "key"),
    (("k" * 2000 + ": 1\n"), ""), ("&a " * 20 + "b: 1", ""), ('"\\ud800": 1\n', ""), ("a: '" + "x" * 150_000 + "'\n", "key"),
    ("!!set {a, b}\n", ""), ("!!omap [a: 1]\n", ""), ("!!binary aGk=\n", ""), ("@a: 1\n", "not valid YAML"), ("`: 1\n", "not valid YAML"),
    (SITE.replace("parts", "part\u0455"), ""), (SITE.replace("straight", "str\u0430ight"), "must be one of"),
    (SITE.encode("utf-16"), "UTF-8"), (SITE.encode("utf-32"), ""), (SITE.replace("\n", " \t\n"), "=" + PLAIN),
    (SITE.replace("flow: 20", "flow: yes"), "flow"), (SITE.replace("20 m3/h", "1:30"), "flow"), (SITE.replace("20 m3/h", "2024-01-01"), "flow"),
    (SITE.replace("20 m3/h", "|\n  20 m3/h"), "=" + PLAIN), (SITE.replace("20 m3/h", ">-\n  20\n  m3/h"), "=" + PLAIN),
    (SITE.replace("20 m3/h", "20 m3/h # about"), "=" + PLAIN), (SITE.replace("20 m3/h", "20 m3/h#about"), "flow"),
    (SITE.replace("20 m3/h", "*undefined"), "not valid YAML"), (SITE.replace("20 m3/h", "!!float 20"), "tag"), (SITE + "...\n" + SITE, "not valid YAML"),
    (SITE.replace("  - straight", "- straight"), "=" + PLAIN), (SITE.replace("straight: 10 m", "straight:\n      length: 10 m"), "=" + PLAIN),
    (SITE.replace("straight: 10 m", "straight:10 m"), ""), (SITE.replace("  - straight", "  \u2013 straight"), ""), (SITE.replace("flow: 20", "flow = 20"), ""),
    ("a: &a [1, 2]\n" + "".join(f"{b}: &{b} [{', '.join([f'*{a}'] * 8)}]\n" for a, b in zip("abcdef", "bcdefg")), ""), ("a: &a {b: *a}\n", "itself"),
    (SITE.replace("125 mm", "0,125"), "=" + PLAIN), (SITE.replace("125 mm", "125e-3"), "=" + PLAIN), (SITE.replace("125 mm", "125 Mm"), ""),
    (SITE.replace("125 mm", "\u00bd ft"), ""), (SITE.replace("125 mm", "1.25d-1"), ""), ('{"diameter": "125 mm", "flow": "20 m3/h", "concrete": "no1", "parts": [{"straight": "10 m"}]}', "=" + PLAIN),
]  # fmt: skip
MIXES = [
    (MIX.replace("2300", "2.3"), "mix density"), (MIX.replace("2300", "2300 g/l"), "mix density"),
    (MIX.replace("2300", "23 kN/m3"), "mix density"), (MIX.replace("600 mm", "600"), "spread"),
    (MIX.replace("600 mm", "60 cm"), "=yield stress"), (MIX.replace("600 mm", "180 mm"), "spread"),
    (MIX.replace("600 mm", "6 dm"), "spread"), (MIX.replace("600 mm", "600 mm (23 in)"), "spread"),
    (MIX.replace("[4 mm, 16 mm]", "[16 mm, 4 mm]"), "sizes"), (MIX.replace("[4 mm, 16 mm]", "[4, 16]"), "sizes"),
    (MIX.replace("[4 mm, 16 mm]", "4-16 mm"), "sizes"), (MIX.replace("[4 mm, 16 mm]", "[4 mm]"), "sizes"),
    (MIX + "  air: 2\n", "air"), (MIX + "  air: -2 %\n", "air"), (MIX + "  aggregate: 36\n", "share of the volume"),
    (MIX + "  aggregate: 950\n", "share"), (MIX + "  aggregate: 90 %\n", "packed"), (MIX + "  aggregate: 0\n", "above 0"),
    (MIX + "  aggregate: 1900 kg/m3\n", "packed"), (MIX + "  aggregate: 950 kg\n", "aggregate"),
    (MIX + "  sieve: {4: 0, 16: 1}\n", "combined"), (MIX + "  t500: 3.5 min\n", "t500"), (MIX + "  t500: -3\n", "t500"),
    (MIX + "  slump: 180\n", "slump"), (MIX + "  slump: 50 mm\n", ""), (MIX + "  shape: 0.5\n", "shape"),
    (MIX + "  shape: cubic\n", "shape"), (MIX + "  shape: [crushed]\n", "shape"), (MIX + "  shape: nan\n", "shape"),
    (MIX + "  layer: {viscosity: 900}\n", "layer"), (MIX + "  layer: 900\n", "layer"),
    (MIX + "  layer: {viscosity: 900, yield_stress: 20, uncertainty: 15}\n", "uncertainty"),
    (MIX + "  layer: {viscosity: 900 Pa s, yield_stress: 20}\n", "viscosity"),
    (MIX + "  layer: {points: p.csv}\n", "diameter"), (MIX + "  layer: {points: ., diameter: 0.1, length: 1}\n", ""),
    (MIX + "  layer: {points: [[1, 2], [3, 4]], diameter: 125, length: 12}\n", ""),
    (MIX + "  layer: {points: [[0.005, 1e5], [0.005, 2e5]], diameter: 125 mm, length: 12}\n", "two or more"),
    (MIX + "  layer: {points: [[0.005, 1e5], [-0.01, 2e5]], diameter: 125 mm, length: 12}\n", "flow|above 0"),
    (MIX + "  layer: {points: [[0.005, 2e5], [0.01, 1e5]], diameter: 125 mm, length: 12}\n", ""),
    (MIX + "  layer: {points: [[0.005, 1e5], [0.01, 2e5]], diameter: 125 mm, length: 1 mm}\n", ""),
    (MIX + "  layer: {tribometer: [[0.2]]}\n", "pairs"), (MIX + "  layer: {tribometer: [ab, cd]}\n", ""),
    (MIX + "  layer: {tribometer: [[0.2, -110], [0.4, -200]]}\n", ""), (MIX + "  layer: {tribometer: {a: 1}}\n", "pairs"),
    (MIX + "  viscometer: [[5, 210], [20, 100]]\n", ""), (MIX + "  viscometer: [[5, 210]]\n", "two or more"),
    (MIX + "  viscometer: [[-5, 210], [20, 400]]\n", "must be 0 or more"), (MIX + "  viscometer: 3\n", "pairs"),
    (MIX + "  concrete: {viscosity: 0}\n", "above 0"), (MIX + "  concrete: {viscosity: 50 Pa}\n", "viscosity"),
    (MIX + "  concrete: {yield_stress: 190 kPa}\n", "yield_stress"), (MIX + "  mortar: {viscosity: 5}\n", "aggregate"),
    (MIX + "  parts: {}\n", "parts"), (MIX + "  parts: [cement]\n", "parts"), (MIX + "  parts: {cement: 340 kg}\n", ""),
    (MIX + "  parts: {cement: 0.34, water: 0.17, sand: 0.8, gravel: 1.0}\n", ""),
    (MIX + "  parts: {cement: -340, water: 170, sand: 1500, gravel: 970}\n", ""),
    (MIX + "  parts: {cement: 340, Cement: 340, water: 170, sand: 700, gravel: 750}\n", "=fill 0.937 m3"),
    (MIX + "  parts: {cement: 34 %, water: 17 %}\n", ""), (MIX + "  parts: {?: 2300}\n", "=not a known ingredient"),
    ("mix:\n", "mix"), ("mix: []\n", "mix"), ("mix: spread\n", "mix"), ("mix: {spread: 600 mm}\n", "density"),
    ("mix: {density: 2300}\n", ""), (MIX + "base: c.yaml\n", "chain of more than 10 files"), (MIX + "base: ../c\n", "base"),
    (MIX + "elements: {fricton: 0.3}\n", "did you mean 'friction'"), (MIX + "flow: {viscosity: 40 Pa}\n", ""),
    (MIX + "elements: [friction]\n", "elements"), (MIX.replace("mix:", "MIX:"), "unknown key"),
    ("mix: {density: 2300, spread: 600 mm, sieve: {0.004: 0, 0.016: 1}}\n", "begins below 1 mm"),
    ("mix: {density: 2300, spread: 600 mm, sieve: {16: 0, 4: 1}}\n", "increasing openings"),
    ("mix: {density: 2300, spread: 600 mm, sieve: {4: 0, 8: 60, 16: 40, 32: 100}}\n", "falls"),
    ("mix: {density: 2300, spread: 600 mm, sieve: {4 mm: 0 %, 16 mm: 100 %}}\n", "=yield stress"),
    ("mix: {density: 2300, spread: 600 mm, sieve: {4: 0 %, 16: 1}}\n", "all without"),
    ("mix: {density: 2300, spread: 600 mm, sieve: [[4, 0], [16, 1]]}\n", "sieve"),
    ("mix: {density: 2300, spread: 600 mm, sieve: {4: 0, 4.0: 0.5, 16: 1}}\n", "sieve"),
    ("mix: {density: 2300, spread: 600 mm, sieve: {a: 0, b: 1}}\n", "sieve"),
]  # fmt: skip
CONCRETES = [
    ("flow: {density: 2350, viscosity: -40, yield_stress: 80, slip_viscosity: 900, slip_yield: 20}\n", "viscosity"),
    ("flow: {density: 2.35, viscosity: 40, yield_stress: 80, slip_viscosity: 900, slip_yield: 20}\n", "density"),
    ("flow: {density: 2350}\n", ""), ("flow: {visc: 3}\n", ""), ("flow: 3\n", "flow"), ("{}\n", ""),
    ("flow: {density: 2350, viscosity: [40], yield_stress: 80, slip_viscosity: 900, slip_yield: 20}\n", "viscosity"),
    ("flow: {density: 2350, viscosity: 40, yield_stress: 80, slip_viscosity: 900, slip_yield: null}\n", "slip_yield"),
    ("base: no9\n", "base"), ("base: [no1]\n", ""), ("base: no1\nflow: {yield_stress: true}\n", "yield_stress"),
    ("base: no1\nflow: {viscosity: 1e400}\n", "too large"), ("base: no1\nflow: {1: 2}\n", ""), ("base: /\n", ""),
    ("base: no1\nflow: {viscosity: 397 mPa s}\n", "=397|0\\.397|flow"),
]  # fmt: skip
FLOWS = "flow [m3/h],pressure [bar]\n"
CSV = [
    ("flow [m3/h]\tpressure [bar]\n10\t3\n20\t4\n", "column"), ("flow [m3/hour],pressure [bar]\n10,3\n20,4\n", "flow"),
    ("flow [bar],pressure [m3/h]\n10,3\n20,4\n", ""), ("pipe 1\nflow [m3/h],pressure [bar]\n10,3\n20,4\n", ""),
    ("flow [m3/h],pressure [bar]\n10,3\n", ""), ("flow [m3/h],pressure [bar]\n10,3\n10,3\n", ""),
    ("flow [m3/h],pressure [bar]\n10,4\n20,3\n", ""), ("flow [m3/h],pressure [bar]\nnan,3\n20,4\n", "line 2"),
    ("flow [m3/h],pressure [bar]\n10,3\n20,inf\n", "line 3"), ("flow [m3/h],pressure [bar]\n10,3\n-20,4\n", "line 3"),
    ("flow [m3/h],pressure [bar]\n10,=1+2\n20,4\n", "line 2"), ("flow [m3/h],pressure [bar]\n1 000,3\n20,4\n", "line 2"),
    ("flow [m3/h],pressure [bar]\n\uff11\uff10,0.3\n20,0.4\n", "=fitted to 2 points"), ("Flow [m3/h],Pressure [bar]\n10,3\n20,4\n", "=fitted to 2 points"),
    ("flow [m3/h],pressure\n10,3\n20,4\n", ""), ("flow [m3/h],pressure [bar],\n10,3\n20,4\n", "2 values"),
    ("flow [m3/h],pressure [bar]\n10,3\n20 m,4\n", ""), ("flow [m3/h],pressure [bar]\n10,\n20,4\n", ""),
    ('"flow [m3/h]","pressure [bar]"\r\n"10","0.3"\r\n"20","0.4"\r\n', "=fitted to 2 points"),
    ("flow [m3/h],pressure [bar]\n10,0.3\n\n20,0.4\n\n\n", "=fitted to 2 points"),
    ("flow [m3/h],pressure [bar]\n" + "10,3\n" * 3, ""), ("\ufeff\ufeffflow [m3/h],pressure [bar]\n10,3\n20,4\n", ""),
    ("flow [m3/h],pressure [bar]\n10,3e-320\n20,4\n", ""), ("flow [m3/h]],pressure [bar]\n10,3\n20,4\n", ""),
    *((FLOWS + rows, says) for rows, says in (
        ("10,0.3\r20,0.4\r", "=fitted to 2"), ("10,0.3\n20,0.4\n\n,\n  ,\n", "=fitted to 2"), ('"1,000",0.3\n20,0.4\n', "line 2"),
        ("10,0.3\n20,n/a\n", "line 3"), ("10,0.3\n20,#DIV/0!\n", "line 3"), ("10,0.3\n20,(0.4)\n", "line 3"), ("10,0.3\n20,50 %\n", "line 3"),
        ('10,"0.3\n20",0.4\n', ""), ('10,"0.3\n', "CSV"), ("10,0.3,\n20,0.4,\n", "3 values"), ("1" * 5000 + ",1\n2,3\n", "line 2"),
        ("".join(f"{10 + k / 1000},{0.3 + k * 1e-5}\n" for k in range(4000)), "=fitted to 4000"),
    )),
    ("sep=;\nflow [m3/h];pressure [bar]\n10;0,3\n20;0,4\n", ""), ("flow [m3/h];pressure [bar]\n10;0,3\n20;0,4\n", "=fitted to 2"),
    ("flow,pressure\n[m3/h],[bar]\n10,3\n20,4\n", ""), (("flow [m3/h],pressure [bar]\n10,0.3\n20,0.4\n").encode("utf-16"), "UTF-8"),
    ("\u202eflow [m3/h],pressure [bar]\n10,3\n20,4\n", "column"), ("x" * 200_000 + "\n", ""), ("flow,flow \n1,2\n", "twice"),
]  # fmt: skip
VARY = "vary: {viscosity: [15, 100], yield_stress: [30, 200]}\n"
TARGETS = [
    (VARY, "targets"), ("targets: []\n", "vary"), (VARY + "targets: {}\n", "targets"), (VARY + "target: []\n", "did you"),
    (VARY + "targets: [slump]\n", "target 1"), (VARY + "targets: [[1, 2]]\n", "target 1"),
    *((VARY + f"targets: [{TARGET}{more}}}]\n", says) for more, says in (
        ("quantity: spread, value: 550, uncertainty: 5 %", ""), ("quantity: spread, value: -0.55, uncertainty: 5%", ""),
        ("quantity: spread, value: 0, uncertainty: 5%", ""), ("quantity: spread, value: '0,55,1', uncertainty: 5%", ""),
        ("quantity: spread, value: 55 cm, uncertainty: 0", "above 0"), ("quantity: spread, value: 1, uncertainty: -5%", ""),
        ("quantity: spread, value: 55 cm, uncertainty: 5 percent", "uncertainty"),
        ("quantity: spread, value: 55 cm, uncertainty: 5 s", "uncertainty"), ("quantity: Spread, value: 1 m", "uncertainty"),
        ("quantity: [spread], value: 55 cm, uncertainty: 5%", ""), ("quantity: spread, value: [1], uncertainty: 5%", "value"),
        ("quantity: spread, value: 55 cm, uncertainty: 5%, held_out: yes", "true or false"),
        ("quantity: spread, value: 55 cm, uncertainty: 5%, held_out: true", "held_out"),
        ("quantity: pressure, value: 5 bar, uncertainty: 5%", "quantity"),
        ("quantity: spread, value: 55 cm, uncertainty: 5%, weight: 2", "weight"))),
    (VARY + "targets: [{scene: slumps, quantity: spread, value: 1, uncertainty: 1%}]\n", "did you mean 'slump'"),
    (VARY + "targets: [{scene: [slump], quantity: spread, value: 1, uncertainty: 1%}]\n", "scene"),
    (VARY + "targets: [{scene: slump, parameters: [a], quantity: spread, value: 1, uncertainty: 1%}]\n", "parameters"),
    (VARY + "targets: [{scene: slump, parameters: {a: 1}, quantity: spread, value: 1, uncertainty: 1%}]\n", "'a'"),
    *((f"vary: {vary}\ntargets: [{TARGET}quantity: spread, value: 0.55, uncertainty: 5%}}]\n", says) for vary, says in (
        ("{viscosity: [100, 15]}", "the lower number"), ("{viscosity: [15, 15]}", "single value"), ("[viscosity]", "vary"),
        ("{viscosity: 15}", "two finite numbers"), ("{viscosity: [10 Pa, 20 Pa]}", "viscosity"), ("{seed: [1, 9]}", "seed"),
        ("{concrete: [no1, no2]}", "concrete"), ("{viscosty: [1, 9]}", "did you"), ("{viscosity: [-5, 20]}", ""),
        ("{viscosity: {low: 0, high: 9, scale: log}}", "log"), ("{viscosity: {low: 3, hi: 9}}", "'low' and 'high'"),
        ("{viscosity: [1, 2, 3]}", "two finite numbers"), ("{density: [2300, 2400]}", "both given here and varied"), ("{viscosity: [1, 1e30]}", ""))),
    ("base: no9\n" + VARY + f"targets: [{TARGET}quantity: spread, value: 0.55, uncertainty: 5%}}]\n", "no9"),
]  # fmt: skip
MESHES: list[tuple[str, Content]] = [
    ("a.stl", b""), ("a.stl", b"solid"), ("a.stl", b"\0" * 84), ("a.stl", b"\0" * 80 + b"\xff\xff\xff\x7f" + b"\0" * 50),
    ("a.stl", "solid\nfacet normal 0 0 1\nouter loop\nvertex nan 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"),
    ("a.stl", "solid x\nfacet\nvertex 1 2\n"), ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99\n"), ("a.obj", "f -1 -2 -3\n"),
    ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nmtllib /etc/passwd\n"), ("a.obj", "v 0,1 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
    ("a.ply", "ply\nformat ascii 1.0\nelement vertex 2000000000\nproperty float x\nend_header\n1\n"),
    ("a.ply", "ply\nformat binary_little_endian 1.0\nelement face 9999999\nproperty list uchar int i\nend_header\n"),
    ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n"), ("a.gltf", '{"asset": {"version": "2.0"}, "buffers": [{"uri": "b"}]}'),
    ("a.glb", b"glTF\x02\0\0\0" + b"\xff" * 20), ("a.3mf", b"PK\x03\x04" + b"\0" * 30), ("a.zip", b"PK\x05\x06" + b"\0" * 18),
    ("a.dxf", "0\nEOF\n"), ("a.svg", "<svg/>"), ("a.STL", "\ufeffsolid"), ("a", "solid"), ("a.png", b"\x89PNG\r\n\x1a\n"),
    ("a.xyz", "1 2 3\n"), ("a.dae", "<!DOCTYPE x [<!ENTITY a 'b'>]><COLLADA>&a;</COLLADA>"), ("a.step", "ISO-10303-21;"),
    ("a.stl", "socket"), ("a.json", "[]"), ("a.npz", b"PK"), ("a.stl", lambda path, made: path.symlink_to(path)),
    ("a.stl", lambda path, made: path.mkdir()), ("a.obj", "v 0 0 0\nv 1 1 1\nv 2 2 2\nf 1 2 3\n"),
]  # fmt: skip
OPTIONS = [  # words, and what is said
    ("list now", ""), ("run tubes", "did you mean 'tube'"), ("run ''", ""), ("run tube --flow -3m3/h", "flow"),
    ("run tube --flow 5e-3m3/mi", "flow"), ("run tube --diameter 12.5", ""), ("run tube --diameter 125", "125 mm"),
    ("run tube --diameter '1,200,5 cm'", ""), ("run tube --spacing 5", ""), ("run tube --device gpu", ""),
    ("run tube --device cuda:99", ""), ("run tube --device 0", ""), ("run tube --precision float16", ""),
    ("run tube --threads 0", "threads"), ("run tube --threads 1.5", "threads"), ("run tube --frames -1", "frames"),
    ("run tube --frames nan", "frames"), ("run tube --checkpoint-every -1", "checkpoint"), ("run tube --out x/../x.txt/y", "out"),
    ("run tube --out x.txt", "out"), ("run tube --out /proc/self/x", "out"), ("run tube --out /dev/null", "out"),
    ("run tube --out " + "a" * 300, "too long"), ("run tube --out ''", "out|exists"), ("run tube --out whole", "exists already"),
    ("run slump --out study", "exists"), ("run slump --out loop", "out"), ("run slump --out line", "exists"),
    ("run slump --out sock", "out"), ("run tube --accuracy five", "accuracy"),
    ("run tube --accuracy -5%", "accuracy"), ("run tube --accuracy 0%", ""), ("run tube --accuracy 5% --trade whole", "folder of a run, not of a trade"),
    ("run tube --accuracy 5% --trade trade", ""), ("run tube --trade trade", "accuracy"), ("run tube --colour red", "colour"),
    ("run tube --network", "network"), ("run tube --pipeline-vertical -3", ""), ("run tube --pipeline-vertical 3 --pipeline-other study", ""),
    ("run tube --pipeline-other whole", "pipeline"), ("run pipe --unit Q", "unit"), ("run pipe --shapes cubes", "shapes"),
    ("run pipe --shapes shape--3", "shape_factor"), ("run pipe --shapes a.stl", ""), ("run pipe --sizes 5:0,20:2", ""),
    ("run pipe --sizes 20:0,5:1", ""), ("run pipe --sizes x", "sizes"), ("run pipe --sizes 5mm:0,20mm:1,20mm:1", ""),
    ("run pipe --velocity 0", "velocity"), ("run pipe --velocity '30 m/min, 2'", "velocity"), ("run pipe --size-min 20 --size-max 40", ""),
    ("run pipe --size-min 0.02 --size-max 0.01", ""), ("run pipe --contact a.b:C", "contact"), ("run pipe --contact os:system", "contact"),
    ("run pipe --contact :", "contact"), ("run pipe --strokes 2.5", "strokes"), ("run pipe --strokes 2 --rest -5", "rest"),
    ("run pipe --bind nowhere --live", ""), ("run pipe --hydration 150", ""),
    ("run pipe --seed -1", "seed"), ("run pipe --seed 1.0", "seed"), ("run pipe --seed \u0663x", "seed"),
    ("run part --line .", "directory"), ("run part --angle 200", "angle"), ("run part --angle 0", "angle"),
    ("run part --line burj-khalifa --quiet", ""), ("run part --wall a.stl --unit bend-level", ""),
    ("run slump --method dem --method flow", "method"), ("run --method dem", ""),
    ("run slump --lift-time -1", "lift_time"), ("run funnel --gravity 0", ""), ("run lbox --spacing 0.5", "spacing"),
    ("run --resume .", "not the folder of a run"), ("run --resume nowhere", "does not exist"), ("run --resume whole", "finished"),
    ("run --resume study", "of a study, not of a run"), ("run --resume cut --frames 3", ""), ("run whole/scene.json --accuracy 3%", ""),
    ("run nowhere.json", ""), ("run whole/result.json", "names no scene"), ("run study/study.json", "scene|parameters"),
    ("run whole/scene.json --out whole", "exists"), ("run trade/trade.json --out whole", "exists"), ("run line/line.json", ""),
    ("study slump --spacing", "spacing"), ("study slump --spacing 0.02 0.02 --out o", ""),
    ("study slump --spacing 0.02 abc", "spacing"), ("study slump --repeat 0 --spacing 0.02 0.025", "repeat"),
    ("study slump --spacing 0.02 0.025 --processes 0", "processes"), ("study slump --viscosity 5e9 2 --spacing 0.025", ""),
    ("study slump --spacing 0.02 0.025 --workers 3", "workers"),
    ("study slump --spacing 0.02 0.025 --out study", "exists"), ("study --resume whole", "not of a study"), ("study --resume trade", "not of a study"),
    ("study slump extra --spacing 1", "extra"), ("study slump --spacing 0.02 0.025 --frames 0", "frames"),
    ("study slump --spacing 0.02 0.025 --precision half", "precision"), ("study whole/scene.json", ""), ("study slump --unit A B", ""),
    ("trade slump --budget 0s", "budget"), ("trade slump --budget 5", "budget"), ("trade slump --budget -5min", "budget"),
    ("trade slump --budget 1e300h", "budget"), ("trade slump --budget 5s --knob", "knob"), ("trade slump --knob nothing", "knob"),
    ("trade slump --quantity mass", "quantity"), ("trade slump --repeat 0", "repeat"), ("trade --resume study", "not of a trade"),
    ("trade --resume trade --repeat 5", ""), ("trade slump --spacing 0.02 0.03", "one value"), ("trade slump --out trade", "exists"),
    ("trade slump --threads 0 --spacing 0.025", "threads"), ("trade slump --threads -2 --spacing 0.025", "threads"),
    ("calibrate --resume whole", "not of a calibration"), ("calibrate --trials 5", "targets"),
    ("calibrate site.yaml", "is not a key"), ("calibrate . --out o", "directory"), ("calibrate sock --out o", "socket"),
    ("explain tubes", "did you mean 'tube'"), ("explain tube --flow 1 2", ""), ("explain tube --trade whole", "trade"),
    ("explain tube --threads -1", "threads"), ("explain tube --fresh 3", "fresh"), ("explain tube --out o", "out"),
    ("theory --flow", ""), ("theory --flow 30", "m3/h"), ("theory --flow 1m3/s", "impossible|at most|flow at"), ("theory --pressure -5bar", ""),
    ("theory --rest -10", "rest"), ("theory --rest 10h --thixotropy -1", "thixotropy"), ("theory --thixotropy 0.5", "rest"),
    ("theory --segregation 5 --aggregate 0.3", ""), ("theory --segregation -20% --aggregate 36", ""), ("theory --aggregate 0.3", "segregation"),
    ("theory --length 0", "length"), ("theory --length 10 --rise 20", "rise"), ("theory --diameter 125mm --radius 60mm", "radius"),
    ("theory --slip-thickness 70mm --diameter 0.1", "slip_thickness"), ("theory --fit whole", "directory"), ("theory --concrete ''", "concrete"),
    ("theory --viscosity '50 Pa'", "viscosity"), ("theory --gravity nan", "gravity"), ("theory --flow -1e-9", ""),
    ("line", ""), ("line .", "directory"), ("line nowhere", "must be the path of a file"), ("line burj", "burj-khalifa"), ("line site.yaml --flow 30 --theory", "m3/h"),
    ("line site.yaml --cells 0", "cells"), ("line site.yaml --cells 2", "cells"), ("line site.yaml --layer-factor 0", "layer_factor"),
    ("line site.yaml --layer-factor -2", "layer_factor"), ("line site.yaml --layer-factor inf", "layer_factor"),
    ("line site.yaml --method dem --seeds 0", "seeds"), ("line site.yaml --method dem --coarse -1", "coarse"),
    ("line site.yaml --method dem --stiffer 0", "stiffer"), ("line site.yaml --method dem --shapes x", "shapes"),
    ("line site.yaml --shapes spheres --coarse 2", "coarse"), ("line site.yaml --known nowhere", "known"), ("line site.yaml --known study", ""),
    ("line site.yaml --theory --rest x", "rest"), ("line site.yaml --out whole", "exists"), ("line site.yaml --out site.yaml", "out"),
    ("line site.yaml --concrete site.yaml --theory", "unknown key"), ("line site.yaml --device tpu", "device"),
    ("mix", ""), ("mix nothing", "concrete"), ("mix no1", ""), ("mix . ", ""), ("mix example-scc --out site.yaml", "out"),
    ("mix example-scc --out o.txt", "out"), ("mix example-scc --out nowhere/o.yaml", ""), ("mix example-scc --out /proc/o.yaml", ""),
    ("verify --only nothing", "matches no case"), ("verify --device gpu", "device"), ("verify --out whole", "exists"), ("verify --precision 3", ""),
    ("reproduce", ""), ("reproduce li", ""), ("reproduce zhan --seeds 0", "seeds"), ("reproduce zhan --seeds -3", "seeds"),
    ("reproduce zhan --only rows", "only"), ("reproduce xu --only velocity", "only"), ("reproduce zhan --known whole --out o", "known"),
    ("reproduce --resume whole", "not of a reproduction"), ("reproduce zhan --out whole", "exists"), ("reproduce zhan --processes 0", "processes"),
    ("view", ""), ("view nowhere", ""), ("view whole", ""), ("view study --web", ""), ("view site.yaml", ""), ("view whole --bind 1.2.3", ""),
    ("schema", "kind"), ("schema lines", "did you mean 'line'"), ("schema ../line", ""), ("schema line extra", ""), ("--nothing", ""), ("nothing", ""),
    ("run tube --concrete no1\u200b", "concrete"),
]  # fmt: skip
REPLACED: tuple[Any, ...] = (None, [], "x", -1, {})


def copied(name: str, file: str = "", content: Content | None = None) -> Callable[[Path, Path], None]:
    """Copy a made folder, one file of which has other contents, or is not there."""

    def make(path: Path, made: Path) -> None:
        shutil.copytree(made / name, path)
        if isinstance(content, bytes):
            (path / file).write_bytes(content)
        elif callable(content):
            content(path / file, made)

    return make


def edited(*keys: str | int, value: Any) -> Callable[[Path, Path], None]:
    """Replace a value in a JSON file."""

    def make(path: Path, made: Path) -> None:
        record = json.loads(path.read_text(encoding="utf-8"))
        inner = record
        for key in keys[:-1]:
            inner = inner[key]
        inner[keys[-1]] = value
        path.write_text(json.dumps(record), encoding="utf-8")

    return make


def cut(part: float) -> Callable[[Path, Path], None]:
    """Keep a part of a file."""

    def make(path: Path, made: Path) -> None:
        content = path.read_bytes()
        path.write_bytes(content[: int(len(content) * part)])

    return make


RECORDS = {  # folder, file, words, and keys whose values are replaced
    "scene.json": ("whole", "run f/scene.json --out o --quiet --no-rerun --no-usd", [("scene",), ("parameters",), ("files",), ("device",), ("precision",),
        ("command",), ("modified",), ("command", "threads"), ("parameters", "spacing"), ("parameters", "concrete"), ("parameters", "seed")]),
    "study.json": ("study", "study --resume f --quiet", [("scene",), ("cases",), ("files",), ("device",), ("precision",), ("command",),
        ("cases", 0), ("cases", 0, "name"), ("cases", 0, "parameters"), ("cases", 0, "varied"), ("figure",)]),
    "trade.json": ("trade", "trade --resume f --budget 1s --quiet", [("scene",), ("parameters",), ("files",), ("quantities",), ("knobs",), ("repeat",),
        ("seeded",), ("device",), ("threads",), ("provenance",), ("finest",), ("points",)]),
    "line.json": ("line", "line burj-khalifa --theory --out f", [("line",), ("parts",)]),
}  # fmt: skip
DAMAGE: list[Content] = [b"", b"{}", b"[]", b"null", b"\xff\xfe{\0}\0", b"{" * 5000, cut(0.5), cut(0.98)]


def attacks() -> Iterator[Attack]:
    """Yield all inputs."""
    for kind, file, words, table in (
        ("line", "site.yaml", "line site.yaml --theory", LINES), ("mix", "c.yaml", "mix c.yaml", MIXES),
        ("concrete", "c.yaml", "theory --concrete c.yaml --flow 20m3/h", CONCRETES),
        ("points", "p.csv", "theory --fit p.csv", CSV), ("targets", "t.yaml", "calibrate t.yaml --out o --quiet", TARGETS),
    ):  # fmt: skip
        for text, says in table:
            codes = (0,) if says.startswith("=") else (2,)
            yield Attack(kind, str(text), words, says.removeprefix("="), {file: text}, codes)
    for name, content in MESHES:
        yield Attack("mesh", f"{name} {content!r}", f"run part --wall {name} --out o", "", {name: content})
        yield Attack("mesh, elements", f"{name} {content!r}", f"run pipe --wall {name} --out o", "", {name: content})
    there: dict[str, Content] = {name: copied(name) for name in ("whole", "study", "trade", "line", "cut")}
    there |= {"site.yaml": SITE, "x.txt": "", "sock": "socket", "loop": lambda path, made: path.symlink_to(path)}
    for words, says in OPTIONS:
        yield Attack("options", words, words, says, there)
    for file, (name, words, keys) in RECORDS.items():
        contents = [
            (f"{key} = {value!r}", edited(*key, value=value))
            for key in keys
            for value in REPLACED
            if (key, value) != (("parameters",), {})
        ]  # which are the defaults
        for label, content in [*((repr(each)[:40], each) for each in DAMAGE), *contents]:
            yield Attack(file, label, words, "", {"f": copied(name, file, content)}, (0, 2, 3), ("f", "o"))
    for file in ("checkpoint.npz", "series.csv", "result.json", "scene.json"):
        for content in (b"", b"PK\x03\x04", b"time [s]\n\n1,2,3\n", cut(0.3), cut(0.97)):
            yield Attack("cut run", f"{file}: {content!r}", "run --resume cut --quiet", "", {"cut": copied("cut", file, content)},
                         (0, 2, 3), ("cut",))  # fmt: skip
