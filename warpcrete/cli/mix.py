"""`warpcrete mix`: what follows from a mix, and the plain concrete of it."""

from __future__ import annotations

from pathlib import Path

import click

from ..core.errors import refuse
from ..core.files import whole_file
from ..core.yaml_files import yaml_text
from ..dem.pumping import PipeParameters
from ..mix.mix import Mix, read_mix


def run(name: str, out: Path | None) -> None:
    """Print the table; with `out`, write the concrete's file that the mix stands for."""
    if out is not None and (out.exists() or out.suffix not in (".yaml", ".yml")):
        refuse("out", str(out), "must be a new .yaml file")
    mix = read_mix(name)
    concrete = plain(name, mix)
    click.echo(f"{mix.name}{f' ({mix.source})' if mix.source else ''}\n")
    click.echo(mix.table())
    for remark in mix.remarks:
        click.echo(f"remark: {remark}")
    click.echo(f"\n--concrete {name} takes it: run tube, part, slump ... (flows), run pipe (elements), line, theory")
    click.echo(f"a cone of it by elements: {_cone(mix)}")
    if out is not None:
        with whole_file(out) as partial:
            partial.write_text(yaml_text(concrete), encoding="utf-8")
        click.echo(f"written: {out}")


def plain(name: str, mix: Mix) -> dict[str, object]:
    """The file of the concrete that a mix stands for, with both sections; what elements have is their scene's."""
    source = f"{mix.source + '; ' if mix.source else ''}from the mix {Path(name).name}"
    elements = PipeParameters.implied({"concrete": name})
    return {"name": mix.name, "source": source, "elements": dict(elements), "flow": mix.flow}


STIFF = 700.0
"""Yield stress from which a cone of law mortar stands whole [Pa]."""


def _cone(mix: Mix) -> str:
    """Words of the command for the mix's mortar law in a vessel."""
    law = "mortar" if mix["yield stress"].value < STIFF else "plastic"
    found = f"warpcrete run slump --method dem --law {law} --bulk-density {mix['density'].value:.5g}"
    found += f" --yield-stress {mix['yield stress'].value:.4g} --viscosity {mix['viscosity'].value:.4g}"
    given = mix.given
    if given.largest is not None:
        low = given.sizes[0] if given.sizes is not None else given.sieve[0][0]  # type: ignore[index]
        found += f" --size-min {low:g} --size-max {given.largest:g}"
    return found
