"""Puts the tables and figures of the trades into notebooks/performance, and their records into the package.

python notebooks/trades_at_once.py --out FOLDER          measures them, on a GPU and on CPU cores
python notebooks/trades.py --folder FOLDER               judges these runs; puts tables, figures and records in place
python notebooks/trades.py --folder FOLDER --fresh       also tests the promises in scenes that no trade has used
python notebooks/trades.py --folder FOLDER NAME ...      makes trades with one run at a time, or goes on with them
python notebooks/trades.py --redraw                      writes tables and draws figures of the shipped trades again

A trade made elsewhere counts, too: trade.json in a folder of its name is enough.
"""

import argparse
import dataclasses
import json
import re
from pathlib import Path

from trade_plans import PLANS, WHOLE
from trade_results import fresh_promises, judged, unpacked

from warpcrete.core.run.files import read_json, write_json
from warpcrete.methods import method_of
from warpcrete.scenes import modules
from warpcrete.studies.tradeoffs.advice import SHIPPED, compact
from warpcrete.studies.tradeoffs.fronts import Error, worst
from warpcrete.studies.tradeoffs.points import COMBINED, GIVEN, REFERENCE
from warpcrete.studies.tradeoffs.report import draw
from warpcrete.studies.tradeoffs.trade import resume_trade, run_trade

HERE = Path(__file__).parent
PAGES = [HERE / "performance" / name for name in ("trades.md", "trades-more.md", "trades-vessels.md")]
TRADES = {name: (*trade[:2], "cpu", trade[2]) for name, trade in WHOLE.items()}
"""Scene, parameters, device and budget [s] of trades that make one run at a time."""
FLOWS = {
    "slump": "Slump test", "lbox": "L-box", "funnel": "V-funnel", "jring": "J-ring", "lcpc": "LCPC box",
    "part": "Part of a line", "stretch": "Endless pipe with aggregates",
}  # fmt: skip
ELEMENTS = {
    "part-dem": "Part of a line", "slump-dem": "Slump test", "lbox-dem": "L-box", "funnel-dem": "V-funnel",
    "jring-dem": "J-ring", "lcpc-dem": "LCPC box",
}  # fmt: skip
"""Trades with tables on the page of vessels and parts, by method, with their headings."""


def measure(name: str, folder: Path) -> None:
    """Make a trade, or go on with it."""
    scene, parameters, device, budget = TRADES[name]
    out = folder / name
    if out.exists():
        resume_trade(out, modules()[scene], budget=budget)
    else:
        run_trade(scene, modules()[scene], base=parameters, device=device, budget=budget, out=out)


def section(name: str, record: dict, figure: bool = True) -> str:
    """Return the command, the machine, the figure and the table of promises as Markdown."""
    scene, how = record["scene"], TRADES.get(name, ("", {}))[2:]
    parameters = PLANS[name].base if name in PLANS else TRADES[name][1]
    given = [(f"--{key.replace('_', '-')}", "" if value is True else f"{value}") for key, value in parameters.items()]
    options = " ".join(f"{flag} {value}".strip() for flag, value in given)
    ran = f"trade {scene} {options} --budget {how[1]}s --device {how[0]}" if how else f"run {scene} {options}"
    command = re.sub(" +", " ", f"warpcrete {ran}").strip()
    own = [f"{100 * error:.2g} % in the {quantity.replace('_', ' ')}"
           for quantity, error in record.get("reference_errors", {}).items()]  # fmt: skip
    time = record["points"][0]["time"]["value"]
    error = f" Even the finest setting has an estimated error of {' and '.join(own)}." if own else ""
    table = f"This table was measured with `{command}`" if how else f"This table is for the simulation `{command}`"
    machine = f"on this machine: {record['machine']}"
    lines = [f"{table}. One run with unchanged settings took {time:.3g} s {machine}.{error}", ""]
    lines += [f"![Error over computing time: {name}](../images/trade_{name}.png)", ""] if figure else []
    lines += ["| error wanted | setting | relative time | guaranteed error | with new random packings "
              "| largest error in other simulations |", "|---|---|---|---|---|---|"]  # fmt: skip
    rows: dict[tuple[str, ...], list[str]] = {}
    for promise in record["promises"]:
        rows.setdefault(cells(promise), []).append(f"{100 * promise['target']:g}")
    lines += [f"| {', '.join(wanted)} % | {' | '.join(row)} |" for row, wanted in rows.items()]
    return "\n".join(lines)


def cells(promise: dict) -> tuple[str, ...]:
    """Return the cells of a promise in the table, without the error wanted."""
    if promise["setting"] is None:
        return "no measured setting meets it", "-", "-", "-", "-"
    found, carried = promise["found"], promise.get("carried") or {}
    fresh = f"{100 * found['shift']:+.2g} +- {100 * (found['interval'] or 0):.2g} %" if found else "-"
    ran = {what: error["shift"] for what, error in carried.items() if error}
    worst = max(ran, key=lambda what: abs(ran[what]), default=None)
    other = f"{100 * ran[worst]:+.2g} % ({worst})" if worst and ran[worst] else "-"  # 0 for the reference itself
    failed = [what for what, error in carried.items() if not error]
    other += f"; does not run: {', '.join(failed)}" if failed else ""
    return promise["setting"], f"{promise['ratio']:.2g}", f"{100 * promise['promised']:.2g} %", fresh, other


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
    parser.add_argument("names", nargs="*", choices=[*TRADES, []], help="trades to make with one run at a time")
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--fresh", action="store_true", help="test the promises in fresh scenes")
    parser.add_argument("--redraw", action="store_true", help="write tables and figures of the shipped trades again")
    given = parser.parse_args()
    if given.redraw:
        for path in PAGES:
            path.write_text(page_with_tables(path.read_text(encoding="utf-8")), encoding="utf-8")
        return
    if given.folder is None:
        parser.error("give --folder FOLDER, or --redraw")
    for name in given.names:
        measure(name, given.folder)
    if (given.folder / "raw").is_dir() or (given.folder / "runs.tar.gz").is_file():
        judge_all(given.folder, given.fresh)
    SHIPPED.mkdir(exist_ok=True)
    for name in (*TRADES, *PLANS):
        if (given.folder / name / "trade.json").is_file():
            record = json.loads((given.folder / name / "trade.json").read_text(encoding="utf-8"))
            if any(promise["setting"] for promise in record["promises"]):
                write_json(SHIPPED / f"{name}.json", compact(record) | {"warpcrete": version_here()})
            print(f"{name}: {record['machine']}")
    for path in PAGES:
        path.write_text(page_with_tables(path.read_text(encoding="utf-8")), encoding="utf-8")


def version_here() -> str:
    """Return the version of this source tree."""
    (version,) = re.findall(r'^version = "(.*)"$', (HERE.parent / "pyproject.toml").read_text(encoding="utf-8"), re.M)
    return version


def page_with_tables(page: str) -> str:
    """Return the text of a page with the tables of the shipped trades at its marks; draw their figures."""
    for name in (*TRADES, *PLANS):
        if f"<!-- {name} -->" in page and (SHIPPED / f"{name}.json").is_file():
            page = between_marks(page, name, section(name, read_json(SHIPPED / f"{name}.json")))
            draw(ShippedTrade(name)).savefig(HERE / "images" / f"trade_{name}.png", dpi=150)
    for mark, titles in (("flows", FLOWS), ("elements", ELEMENTS)):
        if f"<!-- {mark} -->" in page:
            found = [f"### {title}\n\n{section(name, read_json(SHIPPED / f'{name}.json'), figure=False)}"
                     for name, title in titles.items() if (SHIPPED / f"{name}.json").is_file()]  # fmt: skip
            page = between_marks(page, mark, "\n\n".join(found))
    return page


def between_marks(page: str, name: str, text: str) -> str:
    """Return a page with `text` between its marks `name`."""
    before, _, rest = page.partition(f"<!-- {name} -->\n")
    _, _, after = rest.partition(f"<!-- /{name} -->")
    return f"{before}<!-- {name} -->\n{text}\n<!-- /{name} -->{after}"


def judge_all(folder: Path, fresh: bool) -> None:
    """Judge the runs in FOLDER/runs.tar.gz; with `fresh`, print a table that tests the promises in other scenes."""
    raw = unpacked(folder)
    rows, kept = (
        [
            "| table | other simulation | guaranteed error | largest error | quantity | kept |",
            "|---|---|---|---|---|---|",
        ],
        [],
    )
    for name in (*PLANS, *WHOLE):
        trade = judged(name, raw, folder)
        for scene, bound, shift, quantity, held in fresh_promises(name, trade) if trade and fresh else ():
            kept.append(held)
            rows.append(f"| {name} | {scene} | {100 * bound:.2g} % | {100 * shift:+.2g} % | {quantity} | "
                        f"{'yes' if held else 'no'} |")  # fmt: skip
    if kept:
        path = HERE / "performance" / "trades-trust.md"
        text = "\n".join([*rows, "", f"{sum(kept)} of these {len(kept)} guaranteed errors were kept."])
        path.write_text(between_marks(path.read_text(encoding="utf-8"), "fresh", text), encoding="utf-8")
        print(text)


if __name__ == "__main__":
    main()
