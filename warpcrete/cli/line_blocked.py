"""Probability that the narrowest part of a line is blocked, for `warpcrete line --blocking`."""

from collections.abc import Mapping
from pathlib import Path

from ..core.run.progress import progress_bar
from ..geometry.pipe_line import PipeLine
from ..studies.lines.blocking import run_blocking
from ..studies.lines.elements import Elements


def run(line: PipeLine, name: str, rate: float, folder: Path, settings: Mapping[str, object]) -> list[str]:
    """Simulate the line's narrowest part with many random seeds, and return text on the probability of a blockage.

    `name` is the name or file of the concrete, and `rate` is the volume flow [m3/s]. The results are written into
    `folder`. `settings` holds the options of the command by name.
    """
    elements = Elements(**{key: settings[key] for key in ("shapes", "coarse", "stiffer")})
    with progress_bar(settings["quiet"]) as tell:
        blocking = run_blocking(
            line, name, rate, settings["blocking"], out=folder, elements=elements, device=settings["device"],
            processes=settings["threads"], progress=tell,
        )  # fmt: skip
    return list(blocking.lines)
