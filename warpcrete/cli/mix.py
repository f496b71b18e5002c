"""Command `warpcrete mix`: print the properties that follow from a mix, and write them to a concrete's file."""

import warnings
from dataclasses import replace
from pathlib import Path

import click

from ..core.errors import PlausibilityWarning, positive, refuse
from ..core.inputs.amounts import amount, is_customary
from ..core.inputs.concretes import concrete as named
from ..core.inputs.customary import both
from ..core.inputs.limits import check_limit
from ..core.inputs.yaml_files import yaml_text
from ..core.run.files import atomic_file
from ..dem.pumping.parameters import PipeParameters
from ..mix.blocking import blocking_rules, rule_lines
from ..mix.mix import Mix, factors_text, read_mix
from ..theory.laws import BINGHAM


def run(name: str, out: Path | None, bore: str | None = None) -> None:
    """Print the properties that follow from a mix, and whether it satisfies the rules against blocking.

    `bore` is the inner diameter of the pipe as the user typed it, such as "125 mm"; without it, the rules that need a
    diameter cannot be judged. With `out`, also write the concrete's file to this path.
    """
    wide = None
    if bore is not None:
        wide = amount("bore", bore, "m")
        positive("bore", wide, "m")
        check_limit("bore", wide, "m", "diameter")
    if out is not None and (out.exists() or out.suffix not in (".yaml", ".yml")):
        problem = "must be the path of a .yaml file that does not exist yet"
        refuse("out", str(out), problem, "choose another name, ending in .yaml")
    mix = read_mix(name)
    concrete = plain(name, mix)
    click.echo(f"{mix.name}{f' ({mix.source})' if mix.source else ''}\n")
    click.echo(mix.text())
    for remark in mix.remarks:
        click.echo(f"remark: {remark}")
    us = mix.given.customary or is_customary(bore)
    where = "" if wide is None else f"bore of {both(us, 'mm', wide)}"
    given = replace(mix.given, customary=us)
    click.echo("\n" + "\n".join(rule_lines(blocking_rules(given, wide), where)))
    elements = ", run pipe (elements)" if concrete.get("elements") else ""
    flows = "run tube, part, slump ... (flows)"
    click.echo(f"\ncommands that accept it as --concrete {name}: {flows}{elements}, line, theory")
    if not elements:
        click.echo(
            "discrete elements can only have a linear slip layer: state its layer_yield and layer_viscosity in the "
            "section 'elements'"
        )
    click.echo(f"to simulate its slump with elements (ten minutes or more on two cores): {_cone(mix)}")
    if out is not None:
        with atomic_file(out) as partial:
            partial.write_text(yaml_text(concrete), encoding="utf-8")
        click.echo(f"written: {out}")


def plain(name: str, mix: Mix) -> dict[str, object]:
    """Return the contents of a concrete's file, with the sections `elements` and `flow` calculated from a mix.

    The discrete element method can simulate only slip layers that obey Bingham's law. If the slip layer obeys another
    law, and the mix states no separate slip layer for discrete elements, the section `elements` is left out.
    """
    source = f"{mix.source + '; ' if mix.source else ''}from the mix {Path(name).name}"
    if mix.factors != (1.0, 1.0):
        source += f"; includes {factors_text(mix.factors, named(name).factor_source)}"
    contents: dict[str, object] = {"name": mix.name, "source": source}
    if mix.concrete.layer_law.name == BINGHAM or {"layer_yield", "layer_viscosity"} <= set(mix.elements):
        with warnings.catch_warnings():
            # Ignore warnings: the warnings about the mix were shown when the mix was read, and a remark in the output
            # already says that the sieve curve is missing.
            warnings.simplefilter("ignore", PlausibilityWarning)
            contents["elements"] = dict(PipeParameters.implied({"concrete": name}))
    return contents | {"flow": {key: getattr(mix.concrete, key) for key in mix.flow}}


STIFF = 700.0
"""Yield stress of the mix [Pa] above which a simulated cone with the contact law `mortar` does not slump. The law
`plastic` is used instead."""


def _cone(mix: Mix) -> str:
    """Return a `warpcrete run` command that simulates the slump test of the mix with discrete elements."""
    law = "mortar" if mix.concrete.yield_stress < STIFF else "plastic"
    command = f"warpcrete run slump --method dem --law {law} --bulk-density {mix['density'].value:.5g}"
    command += f" --yield-stress {mix['yield stress'].value:.4g} --viscosity {mix.concrete.viscosity:.4g}"
    given = mix.given
    if given.largest is not None:
        low = given.sizes[0] if given.sizes is not None else given.sieve[0][0]  # type: ignore[index]
        command += f" --size-min {low:g} --size-max {given.largest:g}"
    return command
