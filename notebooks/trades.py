"""Measures the trades of notebooks/performance/trades.md, and puts their tables and figures there and into the package.

python notebooks/trades.py --folder trades [NAME ...]   runs those (default: none), and takes what the folder has
python notebooks/trades.py --redraw                     draws the figures of the shipped trades again

A trade made elsewhere counts, too: trade.json and trade.png in a folder of its name are enough.
"""

import argparse
import dataclasses
import json
import re
import shutil
from pathlib import Path

from warpcrete.core.run.files import read_json, write_json
from warpcrete.methods import method_of
from warpcrete.scenes import modules
from warpcrete.studies.tradeoffs.advice import SHIPPED, compact
from warpcrete.studies.tradeoffs.fronts import Error, worst
from warpcrete.studies.tradeoffs.points import COMBINED, GIVEN, REFERENCE
from warpcrete.studies.tradeoffs.report import draw
from warpcrete.studies.tradeoffs.trade import resume_trade, run_trade

HERE = Path(__file__).parent
PAGES = [HERE / "performance" / name for name in ("trades.md", "trades-more.md")]
NARROW = {"diameter": 0.1, "length": 0.5, "ramp": 0.15, "travel": 0.3}
NARROW_BEND = NARROW | {"unit": "D", "elbow_radius": 0.3}
HYDRATED = {"hydration": 0.05, "hydration_modulus": 1e7, "length": 0.4, "ramp": 0.1, "travel": 0.2}
TRADES = {
    "pipe-vertical": ("pipe", {}, "cuda", 400),
    "pipe-bend": ("pipe", {"unit": "D"}, "cuda", 200),
    "pipe-hydrated": ("pipe", HYDRATED, "cuda", 110),
    "pipe-narrow": ("pipe", NARROW, "cpu", 840),
    "pipe-narrow-bend": ("pipe", NARROW_BEND, "cpu", 2100),
    "channel": ("channel", {}, "cpu", 180),
    "tube": ("tube", {}, "cpu", 360),
    "two-phases": ("channel", {"aggregates": True, "duration": 0.1}, "cpu", 240),
}
"""Scene, parameters, device and budget [s]."""


def measure(name: str, folder: Path) -> None:
    """Make a trade, or go on with it."""
    scene, parameters, device, budget = TRADES[name]
    out = folder / name
    if out.exists():
        resume_trade(out, modules()[scene], budget=budget)
    else:
        run_trade(scene, modules()[scene], base=parameters, device=device, budget=budget, out=out)


def section(name: str, record: dict) -> str:
    """Command, figure and table of promises."""
    scene, parameters, device, budget = TRADES[name]
    given = [(f"--{key.replace('_', '-')}", "" if value is True else f"{value}") for key, value in parameters.items()]
    options = " ".join(f"{flag} {value}".strip() for flag, value in given)
    command = re.sub(" +", " ", f"warpcrete trade {scene} {options} --budget {budget}s --device {device}")
    lines = [f"`{command}`, {record['machine']}:", "", f"![Error over cost: {name}](images/trade_{name}.png)", ""]
    lines += ["| error wanted | setting | relative time | guaranteed error | with fresh seeds "
              "| worst of other scenes |", "|---|---|---|---|---|---|"]  # fmt: skip
    for promise in record["promises"]:
        wanted = f"{100 * promise['target']:g} %"
        if promise["setting"] is None:
            lines.append(f"| {wanted} | no measured setting meets it | - | - | - | - |")
            continue
        found, carried = promise["found"], promise.get("carried") or {}
        fresh = f"{100 * found['shift']:+.2g} +- {100 * (found['interval'] or 0):.2g} %" if found else "-"
        ran = {what: error["shift"] for what, error in carried.items() if error}
        worst = max(ran, key=lambda what: abs(ran[what]), default=None)
        other = f"{100 * ran[worst]:+.2g} % ({worst})" if worst else "-"
        failed = [what for what, error in carried.items() if not error]
        other += f"; does not run: {', '.join(failed)}" if failed else ""
        cells = [
            wanted,
            promise["setting"],
            f"{promise['ratio']:.3g}",
            f"{100 * promise['promised']:.2g} %",
            fresh,
            other,
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


@dataclasses.dataclass(frozen=True)
class Point:
    """Setting of a shipped trade, with what the figure shows of it."""

    name: str
    origin: str
    cost: float
    worst: Error
    suspect: list[str]


class ShippedTrade:
    """Trade in the short form that the package contains, with what the figure of a trade shows."""

    def __init__(self, name: str) -> None:
        record = read_json(SHIPPED / f"{name}.json")
        self.scene_name, self.machine = record["scene"], record["machine"]
        module = modules()[self.scene_name]
        known = {each.name: each for each in method_of(module.scene(**record["parameters"])).quantities}
        self.quantities = [known[quantity] for quantity in record["quantities"]]
        self.measured = []
        for point in record["points"]:
            errors = [Error(name, each["shift"], each["interval"] or 0.0) for name, each in point["errors"].items()]
            if (largest := worst(errors)) is not None and point["time"]["value"] is not None:
                self.measured.append(
                    Point(point["setting"], point["origin"], point["time"]["value"], largest, point["suspect"])
                )
        self.reference = next((point for point in self.measured if point.origin == REFERENCE), None)
        origins = dict.fromkeys(point.origin for point in self.measured)
        self.knobs = [_Knob(origin) for origin in origins if origin not in (GIVEN, COMBINED, REFERENCE)]

    def label(self, point: Point) -> str:
        """Return a description of how a setting differs from the scene as given."""
        return point.name


@dataclasses.dataclass(frozen=True)
class _Knob:
    name: str


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", choices=[*TRADES, []], help="trades to measure")
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--redraw", action="store_true", help="draw the figures of the shipped trades again")
    given = parser.parse_args()
    if given.redraw:
        for name in TRADES:
            draw(ShippedTrade(name)).savefig(HERE / "images" / f"trade_{name}.png", dpi=130)
        return
    if given.folder is None:
        parser.error("give --folder FOLDER, or --redraw")
    for name in given.names:
        measure(name, given.folder)
    pages = {path: path.read_text(encoding="utf-8") for path in PAGES}
    SHIPPED.mkdir(exist_ok=True)
    for name in TRADES:
        source = given.folder / name
        if (source / "trade.json").is_file():
            record = json.loads((source / "trade.json").read_text())
            path = next(path for path in PAGES if f"<!-- {name} -->" in pages[path])
            before, _, rest = pages[path].partition(f"<!-- {name} -->\n")
            _, _, after = rest.partition(f"<!-- /{name} -->")
            pages[path] = f"{before}<!-- {name} -->\n{section(name, record)}\n<!-- /{name} -->{after}"
            shutil.copy(source / "trade.png", HERE / "images" / f"trade_{name}.png")
            write_json(SHIPPED / f"{name}.json", compact(record))
            print(f"{name}: {record['machine']}")
    for path, page in pages.items():
        path.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
