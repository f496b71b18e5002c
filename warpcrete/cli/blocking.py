"""Rules against blocking, as `warpcrete line` prints and stores them."""

from __future__ import annotations

from pathlib import Path

import click

from ..core.run.files import write_json
from ..geometry.lines import PipeLine
from ..mix.blocking import line_rules, narrowest, rule_lines, rule_records
from ..mix.mix import Mix


def print_rules(line: PipeLine, mix: Mix | None, folder: Path | None) -> None:
    """Print what the rules of practice say about blocking of the line, and write it to its folder."""
    verdicts = line_rules(line, None if mix is None else mix.given)
    part = narrowest(line)
    where = f"narrowest part {part.number}, {part.label}, {1e3 * part.narrow:.4g} mm"
    text = rule_lines(verdicts, where)
    if mix is None:
        text.append(
            "unknown  all rules on the mix: the concrete has no mix; 'warpcrete mix --help' shows how to write it"
        )
    click.echo("\n" + "\n".join(text))
    if folder is not None:
        write_json(folder / "blocking.json", rule_records(verdicts) | {"narrowest_part": part.number})
