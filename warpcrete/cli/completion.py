"""Completion of option values in a shell: names of concretes, pump lines, devices and so on, and units of amounts."""

import re
from collections.abc import Iterable

from click.shell_completion import CompletionItem

from ..core.inputs.amounts import unit_names
from ..core.inputs.concretes import concrete, shipped
from ..core.inputs.hyphens import hyphenated

NUMBER = re.compile(r"([-+]?[0-9][0-9.,]*(?:[eE][-+]?[0-9]+)?) ?(.*)")
DEVICES = ("cpu", "cuda")
"""Names of devices that completion suggests in a shell."""


def names(known: Iterable[str], incomplete: str, files: bool = False) -> list[CompletionItem]:
    """Return the names in `known` that begin with the typed text `incomplete`.

    If `files` is true, the shell also offers paths of files.
    """
    items = [CompletionItem(name) for name in known if name.startswith(incomplete)]
    return [*items, CompletionItem(incomplete, type="file")] if files else items


def amounts(unit: str, incomplete: str) -> list[CompletionItem]:
    """Complete an amount: return the typed number followed by each unit that can be converted to `unit`."""
    return with_units([name for name in unit_names(unit) if re.fullmatch(r"[a-zA-Z%][a-zA-Z0-9/%]*", name)], incomplete)


def with_units(units: Iterable[str], incomplete: str) -> list[CompletionItem]:
    """Return the typed number followed by each of the `units`; return an empty list if no number has been typed."""
    typed = NUMBER.fullmatch(incomplete)
    return [] if typed is None else names([typed[1] + unit for unit in units], typed[1] + typed[2])


def concretes(incomplete: str) -> list[CompletionItem]:
    """Complete a concrete: return names of concretes that come with the package, and let the shell add files."""
    return names(shipped(), incomplete, files=True)


def mixes(incomplete: str) -> list[CompletionItem]:
    """Complete a mix: return names of the package's concretes that have a mix, and let the shell add files."""
    return names([name for name in shipped() if concrete(name).mix], incomplete, files=True)


def lines(incomplete: str) -> list[CompletionItem]:
    """Complete a pump line: return names of pump lines that come with the package, and let the shell add files."""
    from ..geometry.lines import shipped_lines

    return names(shipped_lines(), incomplete, files=True)


def schemas(incomplete: str) -> list[CompletionItem]:
    """Complete a kind of file: return the kinds that have a JSON schema, such as `line`."""
    from .schemas import FOLDER

    return names(sorted(path.stem for path in FOLDER.glob("*.json")), incomplete)


def kinds(incomplete: str) -> list[CompletionItem]:
    """Complete a kind of measurement that `warpcrete validate` compares with predictions."""
    from ..studies.validation.kinds import UNITS as kinds_of_cases

    return names(kinds_of_cases, incomplete)


def scene_names(incomplete: str) -> list[CompletionItem]:
    """Complete the name of a scene."""
    from ..scenes import modules

    return names(modules(), incomplete)


def papers(incomplete: str) -> list[CompletionItem]:
    """Complete the name of a paper whose runs `warpcrete reproduce` repeats."""
    return names(("xu", "zhan"), incomplete)


def compared(incomplete: str) -> list[CompletionItem]:
    """Complete a column or row of the report that compares runs with the paper by Zhan et al. (`reproduce --only`)."""
    from ..studies.reproduction.reproduce import names_of_parts

    return names(map(hyphenated, names_of_parts()), incomplete)


def checked(incomplete: str) -> list[CompletionItem]:
    """Complete the name of a case, or of a group of cases, of `warpcrete verify`.

    Names that contain spaces or other characters with a meaning in a shell are left out.
    """
    from ..verification import cases

    case_names = dict.fromkeys(hyphenated(name) for case in cases() for name in (case.group, case.name))
    return names([name for name in case_names if re.fullmatch(r"[\w-]+", name)], incomplete)


def devices(incomplete: str) -> list[CompletionItem]:
    """Complete the name of a device, `cpu` or `cuda`."""
    return names(DEVICES, incomplete)


def accuracies(incomplete: str) -> list[CompletionItem]:
    """Complete an allowed error: return the errors for which the shipped tables have settings, such as `5%`."""
    from ..studies.tradeoffs.points import WANTED_ERRORS

    return names([f"{100 * error:g}%" for error in WANTED_ERRORS], incomplete)
