"""Further inputs for attack_inputs.py: aggregates, measured cases, gauges, warm, view, checkpoints and --resume."""

# ruff: noqa: E501  (rows of tables)

import hashlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from attack_tables import SITE, Attack, Content, copied

MORTAR = "--concrete own --density 2200 --viscosity 20 --yield-stress 30 --slip-viscosity 1e4 --slip-yield 0 --spacing 0.004 --precision float64"
STONES = "--aggregate-fraction 0.1 --aggregate-smallest 16mm"
CASE = "sources: {lab: a laboratory}\ncases:\n"
SLUMP = "- {id: a, kind: slump, source: lab, mix: {density: 2350, spread: 500 mm}, measured: 200 mm"
PUMPED = "- {id: a, kind: pipe, source: lab, mix: {density: 2350, slump: 180 mm}, test: {diameter: 125 mm}, "
LONG = SITE.replace("10 m", "100 m") + "  - bend: up\n  - straight: 10 m\n"
TAPS = "place [m],pressure [bar],flow [m3/h]\n"

AGGREGATES = [  # words behind the scene and the mortar, and what is said
    ("slump", "--aggregate-fraction 20", "aggregate_fraction"), ("slump", "--aggregate-fraction -10%", "aggregate_fraction"),
    ("slump", "--aggregate-fraction 0.9", "aggregate_fraction"), ("slump", "--aggregate-fraction 0.1 --aggregate-smallest 2mm", "cells"),
    ("slump", STONES + " --aggregate-largest 8mm", "aggregate_largest|smallest"), ("slump", STONES + " --aggregate-largest 1m", ""),
    ("slump", STONES + " --aggregate-sizes 16:1,4:0", "sizes"), ("slump", STONES + " --aggregate-sizes 4:0,16:0.5", "sizes"),
    ("slump", STONES + " --aggregate-sizes '4:0;16:1'", "sizes"), ("slump", STONES + " --aggregate-sizes 4mm:0%,16mm:100%", "sizes|smallest"),
    ("slump", STONES + " --aggregate-sizes ''", "sizes"), ("slump", STONES + " --aggregate-sizes gaussian", "sizes"),
    ("slump", STONES + " --aggregate-sizes sieve.csv", "sizes"), ("slump", STONES + " --aggregate-sizes 4:0,4:0.5,16:1", "sizes"),
    ("slump", STONES + " --aggregate-shapes cubes", "shapes"), ("slump", STONES + " --aggregate-shapes no.stl", "no.stl"),
    ("slump", STONES + " --aggregate-shapes ''", "shapes"), ("slump", STONES + " --aggregate-shapes shape-0", "shape"),
    ("slump", STONES + " --aggregate-shapes sieve.csv", "sieve.csv|shapes"), ("slump", STONES + " --aggregate-density 2.65", "density"),
    ("slump", STONES + " --friction -0.1", "friction"), ("slump", STONES + " --roughness 0", "roughness"),
    ("slump", STONES + " --aggregate-sizes 4:-1,16:1", "sizes"), ("slump", STONES + " --sizes 4:0,16:1", "aggregate_sizes"),
    ("lbox", STONES + " --gap 5mm", ""), ("part", STONES + " --diameter 30mm", ""), ("part", STONES + " --symmetry quarter", "symmetry"),
    ("stretch", "--aggregate-fraction 0.3 --aggregate-smallest 100mm", ""), ("tube", STONES + " --ends piston", ""),
    ("slump", "--method dem " + STONES, ""), ("funnel", STONES + " --aggregate-largest 70mm", ""),
]  # fmt: skip
CASES = [
    ("", "cases"), ("cases:\n", "must be a list"), ("cases: []\n", "must be a list"), ("case: []\n", "key of a file of cases"), (CASE + "- a\n", "key: value"),
    (CASE + "- {id: a}\n", "has no 'kind'"), (CASE + SLUMP + "}\n" + SLUMP + "}\n", "used twice"), (CASE + SLUMP.replace("slump", "slumps") + "}\n", "did you mean 'slump'"),
    (CASE + SLUMP.replace("lab", "labs") + "}\n", "source"), (CASE + SLUMP.replace("200 mm", "200 kg") + "}\n", "measured"), (CASE + SLUMP.replace("200 mm", "-20 mm") + "}\n", "measured"),
    (CASE + SLUMP.replace("200 mm", "[]") + "}\n", "measured"), (CASE + SLUMP.replace("200 mm", "nan") + "}\n", "measured"), (CASE + SLUMP + ", flow: [1 m3/h, 2 m3/h]}\n", "flows"),
    (CASE + SLUMP + ", scatter: {concretes: 0, from: 1 mm, to: 300 mm}}\n", "concretes"), (CASE + SLUMP + ", scatter: {concretes: 3, from: 300 mm, to: 400 mm}}\n", "scatter"),
    (CASE + SLUMP + ", scatter: 3}\n", "scatter"), (CASE + SLUMP + ", basis: guess}\n", "basis"), (CASE + SLUMP + ", mix: {}}\n", "twice"),
    (CASE + SLUMP.replace("density: 2350", "densty: 2350") + "}\n", "refused: a: v.yaml, line 3: .*did you mean 'density'"), (CASE + SLUMP.replace("{density: 2350, spread: 500 mm}", "[1]") + "}\n", "mix"),
    (CASE + PUMPED + "measured: 10 kPa/m}\n", "flow"), (CASE + PUMPED + "measured: 10 kPa/m, flow: 30}\n", ""), (CASE + PUMPED + "measured: 10 bar, flow: 30 m3/h}\n", "measured"),
    (CASE + PUMPED.replace("diameter", "diamter") + "measured: 10 kPa/m, flow: 30 m3/h}\n", "diamter|diameter"), (CASE + PUMPED.replace("test: {diameter: 125 mm}", "test: {}") + "measured: 10 kPa/m, flow: 30 m3/h}\n", "diameter"),
    (CASE + SLUMP + ", test: {diameter: 3}}\n", ""), (CASE + "- {id: a, kind: blocking, source: lab, mix: {density: 2350}, test: {bore: 125 mm}, measured: 2}\n", ""),
    (CASE + "- {id: a, kind: line, source: lab, mix: {density: 2350, slump: 180 mm}, test: {line: x}, flow: 30 m3/h, measured: 20 bar}\n", "refused: a: case test: line = 'x'"),
]  # fmt: skip
GAUGES = [
    ("", "no rows"), (TAPS, ""), (TAPS + "0,30,20\n", ""), (TAPS + "0,3,20\n500,2,20\n", "place"), (TAPS + "0,3,20\n-5,2,20\n", "place"),
    (TAPS.replace("place [m]", "part") + "1,3,20\n9,2,20\n", "number of a part"), (TAPS.replace("place [m]", "part") + "1.5,3,20\n", "number of a part"),
    ("place [m],part,pressure [bar],flow [m3/h]\n0,1,3,20\n", "one of the columns"), ("place [m],distance [m],pressure [bar],flow [m3/h]\n0,0,3,20\n", "mean the same"),
    ("place [m],flow [m3/h]\n0,20\n", "no column 'pressure'"), (TAPS + "0,,20\n", "is empty"), (TAPS + "0,3,0\n", "above 0"), (TAPS + "0,3,2000\n", ""),
    (TAPS + "0 m,300 psi,20 m3/h\n50,12,20\n", "=fit"), (TAPS.replace(" [bar]", "") + "0,3,20\n50,2,20\n", ""), (TAPS + "0,3e9,20\n50,2,20\n", "pressure"),
]  # fmt: skip
WORDS = [
    ("warm nothing", "must be one of|did you mean"), ("warm tubes", "did you mean 'tube'"), ("warm ''", ""), ("warm tube --device gpu", "device"),
    ("warm pipe --contact os:system", "contact"), ("warm tube --viscosity -3", "viscosity"), ("warm tube --colour red", "colour"), ("warm tube --spacing", "spacing"),
    ("warm whole/scene.json", ""), ("warm tube slump --velocity 1", ""), ("warm --flow-index 0.5", ""),
    ("theory --fit p.csv --flow 20m3/h", "=fitted to 2"), ("theory --fit p.csv --pressure 3bar", "=fitted to 2"), ("theory --fit p.csv --rest 10min", "=fitted to 2"), ("theory --fit", "fit"),
    ("theory --fit p.csv --fit p.csv --length 10", ""), ("theory --fit p.csv --concrete nothing", "concrete"), ("theory --fit p.csv --diameter 125", "125 mm"),
    ("theory --pressure 20 --length 10", "did you mean 20 bar"), ("theory --fit 3", ""),
    ("validate --kind slumps", "did you mean 'slump'"), ("validate --kind ''", "kind"), ("validate --cases", "cases"), ("validate --cases . --quick", "directory"),
    ("validate --cases nowhere.yaml", "nowhere"), ("validate --quick --out whole", "exists"), ("validate --device gpu", "device"), ("validate extra", "extra"),
    ("line site.yaml --blocking 0", "blocking"), ("line site.yaml --blocking 2.5", "blocking"), ("line site.yaml --blocking 3 --out whole", "exists"),
    ("line site.yaml --gauge 5%", "fit"), ("line long.yaml --fit g.csv --gauge 0", "gauge"), ("line long.yaml --fit . ", "directory"), ("line long.yaml --fit p.csv --method dem", ""),
    ("line --slump 180mm --diameter 125mm --flow 30m3/h", "length"), ("line --slump 180mm --spread 600mm --length 10m --diameter 125mm --flow 30m3/h", "=spread 600 mm"),
    ("line site.yaml --slump 180mm", "=slump 180 mm"), ("line --slump 180 --diameter 125mm --length 10m --flow 30m3/h", "slump"), ("line site.yaml --stone 20", "stone|impossible"),
    ("line site.yaml --pump-pressure 85", "bar"), ("line site.yaml --pump-flow 90m3/h", ""), ("line site.yaml --pump-power 110kW", ""), ("line site.yaml --stone '#99'", "stone"),
    ("run --resume cut --spacing 0.03", ""), ("run --resume cut --out o", "out"), ("run tube --resume cut", ""), ("run --resume cut slump", ""), ("run --resume cut --device cuda", "device"),
    ("run --resume cut --precision float64", ""), ("run --resume cut --resume whole", ""), ("run cut/scene.json --resume cut", ""), ("run --resume cut --method dem", ""),
    ("run --resume cut --seed 3", ""), ("run --resume cut --threads 0", "threads"), ("run --resume cut --checkpoint-every -1", "checkpoint"), ("run --resume cut/checkpoint.npz", ""),
    ("run --resume cut/scene.json", ""), ("run --resume line", "line"), ("run --resume trade", "trade"), ("study --resume study --lift-time 4", ""), ("study --resume study --out o", "out"),
    ("study slump --resume study", ""), ("trade --resume trade --out o", "out"), ("calibrate t.yaml --resume study", ""), ("reproduce zhan --resume study", ""),
    ("view cut --bind nothing", "recording"), ("view x.txt", "x.txt"), ("view a.rrd --web --bind 127.0.0.1:x", "bind"), ("view whole/scene.json", "scene.json"), ("view ''", ""), ("view whole study", ""),
]  # fmt: skip
VIEWED: list[Content] = [
    b"",
    b"RR",
    b"\0" * 64,
    lambda path, made: path.mkdir(),
    lambda path, made: path.symlink_to(path),
]


def changed_text(key: str, value: Any) -> Callable[[Path, Path], None]:
    """Replace an entry of a checkpoint's text, as another version or another scene has it, and renew the digest."""

    def make(path: Path, made: Path) -> None:
        with np.load(path) as file:
            arrays = dict(file)
        text = json.loads(arrays["text"].tobytes())
        text[key] = value
        arrays["text"] = np.frombuffer(json.dumps(text).encode(), dtype=np.uint8)
        del arrays["digest"]
        arrays["digest"] = np.frombuffer(digest_of(arrays), dtype=np.uint8)
        np.savez(path, **arrays)

    return make


def digest_of(arrays: dict[str, np.ndarray]) -> bytes:
    """Return the digest of a checkpoint's arrays."""
    from warpcrete.core.run import checkpoint

    found = checkpoint._digest(arrays)
    assert len(found) == hashlib.sha256().digest_size
    return found


OTHERS = [
    ("warpcrete checkpoint", 1, "checkpoint format 1"), ("warpcrete checkpoint", None, "checkpoint format None"), ("warpcrete checkpoint", "x", "checkpoint format 'x'"),
    ("versions", {}, "versions|written by"), ("versions", {"warpcrete": "0.1.0", "warp": "1.0"}, "0.1.0"), ("versions", None, "lacks data"), ("versions", [3], "lacks data"),
    ("scene", "other", "another scene"), ("device", "cuda", "device 'cuda'"), ("precision", "float64", "precision 'float64'"), ("precision", None, "precision"),
    ("contents", {}, ""), ("contents", None, ""), ("contents", {"time": "x"}, ""),
]  # fmt: skip


def more_attacks() -> Iterator[Attack]:
    """Yield all inputs of these tables."""
    sieve: dict[str, Content] = {"sieve.csv": "opening [mm],passing\n4,0\n16,1\n"}
    for scene, more, says in AGGREGATES:
        yield Attack("aggregates", f"{scene} {more}", f"run {scene} {MORTAR} {more} --out o", says, sieve)
    for text, says in CASES:
        codes = (0,) if says.startswith("=") else (2,)
        words = "validate --cases v.yaml --quick --quiet"
        yield Attack("cases", text, words, says.removeprefix("="), {"v.yaml": text}, codes)
    for text, says in GAUGES:
        codes = (0,) if says.startswith("=") else (2,)
        words = "line long.yaml --fit p.csv --theory --out o"
        yield Attack("gauges", text, words, says.removeprefix("="), {"long.yaml": LONG, "p.csv": text}, codes, ("o",))
    there: dict[str, Content] = {name: copied(name) for name in ("whole", "study", "trade", "line", "cut")}
    there |= {"site.yaml": SITE, "long.yaml": LONG, "x.txt": "", "a.rrd": b"RRF2", "g.csv": TAPS + "0,3,20\n50,2,20\n", "t.yaml": "vary: {}\n",
              "p.csv": "flow [m3/h],pressure [bar]\n10,0.3\n20,0.4\n"}  # fmt: skip
    for words, says in WORDS:
        codes = (0,) if says.startswith("=") else (2,)
        yield Attack("words", words, words, says.removeprefix("="), there, codes)
    for content in VIEWED:
        yield Attack("view", repr(content)[:40], "view a.rrd", "", {"a.rrd": content})
    for key, value, says in OTHERS:
        yield Attack("checkpoints", f"{key} = {value!r}", "run --resume cut --quiet", says,
                     {"cut": copied("cut", "checkpoint.npz", changed_text(key, value))}, (2,), ("cut",))  # fmt: skip
