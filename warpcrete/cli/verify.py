"""Command `warpcrete verify`: comparison of results with published values and closed-form solutions."""

from pathlib import Path

import click

from .. import verification
from ..core.device.device import find_device
from ..core.inputs.hyphens import hyphenated
from ..core.run.files import atomic_file, check_new
from ..core.run.folders import new_folder
from ..verification import extremes as edge
from ..verification import flow_extremes
from ..verification.figure import draw

FAILED = 1
"""Exit code if at least one result lies outside its tolerance."""


def run(device: str | None, precision: str, only: str, quick: bool, extremes: bool, out: Path | None) -> None:
    """Run the selected cases and print their table; with `out`, also write the table and a figure into this folder.

    `only` is a part of the names of the selected cases; an empty text selects all cases. `quick` leaves out slow cases.
    `extremes` adds runs with extreme parameter values.
    """
    if out is not None:
        check_new(out)
    selected_device = find_device(device)
    part = hyphenated(only.lower())
    chosen = [case for case in verification.cases() if part in hyphenated(f"{case.group}: {case.name}".lower())]
    if not chosen:
        raise click.UsageError(
            f"only = {only!r}: matches no case; use part of one of these names: "
            f"{', '.join(c.name for c in verification.cases())}"
        )
    if quick and all(case.slow for case in chosen):
        raise click.UsageError(f"only = {only!r}: matches slow cases only; leave out --quick")
    results = []
    failed = 0
    for case, rows in verification.run_cases(chosen, str(selected_device), precision, slow=not quick):
        results.append((case, rows))
        wrong = sum(not row.passed for row in rows)
        failed += wrong
        verdict = f"{wrong} of {len(rows)} FAIL" if wrong else f"{len(rows)} ok"
        click.echo(f"{case.group + ': ' + case.name:48s} {verdict}")
    text = f"{selected_device.name}, {precision}\n\n{verification.summary(results)}\n{verification.table(results)}"
    if extremes:
        outcomes, flows = (
            edge.matrix(str(selected_device), precision),
            flow_extremes.matrix(str(selected_device), precision),
        )
        failed += sum(not outcome.acceptable for outcome in (*outcomes, *flows))
        text += f"\n{edge.table(outcomes)}\n{flow_extremes.table(flows)}"
    click.echo("\n" + text)
    if out is not None:
        with new_folder(out):
            with atomic_file(out / "verification.md") as partial:
                partial.write_text(text, encoding="utf-8")
            draw(results).savefig(out / "verification.png", dpi=150)
        click.echo(f"written: {out / 'verification.md'}, {out / 'verification.png'}")
    if failed:
        click.echo(f"FAILED: {failed} results are outside their tolerances")
        raise SystemExit(FAILED)
