"""Readers for every file that a user can name, and for the text files in run folders.

Each function accepts only regular files up to a maximum size. It turns every error into one line that names the file
and, if known, the line in the file.
"""

import csv
import io
import json
import os
import re
import stat
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn, cast

from ..errors import LONGEST_VALUE, RunFolderError, SceneError, one_line, refuse
from ..narrowing import is_dict
from ..records import Record
from .origin import note_file
from .yaml_files import LONGEST_NUMBER, FileList, FileMapping, Unreadable, parsed_yaml

MAXIMUM_SETTINGS_SIZE = 200_000
"""Maximum size of a YAML or JSON file that a user writes [B]; the YAML parser reads about 80 kB per second."""
MAXIMUM_TEXT_SIZE = 500_000_000
"""Maximum size of a table, or of a text file in a run folder [B]."""
MAXIMUM_MESH_SIZE = 2_000_000_000
"""Maximum size of a mesh file [B]; a binary STL file of this size has 40 million triangles."""
KINDS = ((stat.S_ISDIR, "a directory"), (stat.S_ISFIFO, "a pipe"), (stat.S_ISCHR, "a device"),
         (stat.S_ISBLK, "a device"), (stat.S_ISSOCK, "a socket"))  # fmt: skip


@contextmanager
def errors_located_at(container: Any, key: Any) -> Generator[None]:
    """Add the file name and line number of an entry to each :class:`SceneError` that is raised inside the `with` block.

    The entry is `container[key]`, and the container is a :class:`FileMapping` or a :class:`FileList`.
    """
    try:
        yield
    except SceneError as error:
        place = _place_of(container, key)
        if not place or getattr(error, "located", False):
            raise
        located = type(error)(f"{place}: {error}")
        located.located = True  # type: ignore[attr-defined]
        raise located from error


def _place_of(container: Any, key: Any) -> str:
    """Return the file name and, if known, the line number of an entry; empty if the file or the key is unknown."""
    files, lines = getattr(container, "files", {}), cast("Any", getattr(container, "lines", {}))
    known = key in lines if isinstance(lines, dict) else 0 <= key < len(lines)
    if not known and key not in files:
        return ""
    path = files.get(key) or container.path
    return one_line(path.name, LONGEST_VALUE) + (f", line {lines[key]}" if known else "")


@contextmanager
def errors_in_file(path: Path | str | None) -> Generator[None]:
    """Add the file name to each :class:`SceneError` raised inside the `with` block whose message does not contain it.

    Errors that :func:`errors_located_at` located stay unchanged, and so do all errors if `path` is None.
    """
    try:
        yield
    except SceneError as error:
        if path is None or getattr(error, "located", False) or Path(path).name in str(error):
            raise
        located = type(error)(f"{one_line(Path(path).name, LONGEST_VALUE)}: {error}")
        located.located = True  # type: ignore[attr-defined]
        raise located from error


def check_file(path: Path | str, field: str, most: int = MAXIMUM_MESH_SIZE, hint: str = "") -> Path:
    """Return the path of a file after checking that it is a regular file of at most `most` bytes.

    Raises :class:`SceneError` about the parameter `field` for any other path.
    """
    try:
        _checked(Path(path), most)
    except Unreadable as error:
        refuse(field, str(path), error.reason, hint or error.hint)
    note_file(Path(path))
    return Path(path)


def name_of(path: Path | str) -> str:
    """Return the name of a file without its extension, as text that can be encoded as UTF-8 in any locale."""
    name = Path(path).stem
    try:
        # Python decoded the name with the locale's encoding, which may not be UTF-8. Decode the bytes of the name as
        # UTF-8 instead.
        return os.fsencode(name).decode("utf-8", "replace")
    except UnicodeEncodeError:
        return name


def read_mapping(path: Path, field: str) -> Record:
    """Return the mapping in a YAML or JSON file.

    If that is impossible, raise :class:`SceneError` about the parameter `field` that named the file.
    """
    try:
        text = _text(path, MAXIMUM_SETTINGS_SIZE)
        found = _of_file(parsed_json(text), path) if path.suffix.lower() == ".json" else parsed_yaml(text, path)
        if not is_dict(found):
            raise Unreadable(
                f"contains {_kind_of(found)} instead of 'key: value' lines",
                "write one 'key: value' pair per line, as in 'density: 2350 kg/m3'",
            )
    except Unreadable as error:
        refuse(field, str(path), error.reason, error.hint)
    note_file(path)
    return found


def read_rows(path: Path, field: str) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Return the header of a CSV file, and each non-empty row with its line number.

    Raises :class:`SceneError` about the parameter `field` if the file cannot be read, if rows and header differ in
    length, or if a column appears twice.
    """
    try:
        rows = _rows(_text(path, MAXIMUM_TEXT_SIZE))
    except Unreadable as error:
        refuse(field, str(path), error.reason, error.hint)
    note_file(path)
    return rows


def read_columns(path: Path, field: str) -> tuple[dict[str, tuple[int, str]], list[tuple[int, list[str]]]]:
    """Return the index and the unit of each column of a CSV file by name, and the rows as from :func:`read_rows`.

    The header contains names and units, such as `flow [m3/h],pressure [bar]`, in capital or small letters and with
    brackets or parentheses. Columns whose headings have another form are left out.
    """
    header, rows = read_rows(path, field)
    heads = [re.fullmatch(r"\s*(\w+)\s*(?:[\[(]([^\[\]()]+)[\])])?\s*", head) for head in header]
    return {head[1].lower(): (place, head[2] or "") for place, head in enumerate(heads) if head is not None}, rows


def saved_text(path: Path) -> str:
    """Return the text of a file that the program wrote; raises :class:`RunFolderError` if that is impossible."""
    try:
        return _text(path, MAXIMUM_TEXT_SIZE)
    except Unreadable as error:
        raise _unreadable(path, error) from error


def read_json(path: Path) -> Record:
    """Return the object in a JSON file that the program wrote; raises :class:`RunFolderError` if that is impossible."""
    try:
        found = parsed_json(_text(path, MAXIMUM_TEXT_SIZE))
    except Unreadable as error:
        raise _unreadable(path, error) from error
    if not is_dict(found):
        raise RunFolderError(f"'{path}': does not contain a JSON object; restore the file")
    return found


def _unreadable(path: Path, error: Unreadable) -> RunFolderError:
    """Return the error to raise for a file of the program that cannot be read."""
    reason = error.reason if error.reason.startswith("cannot be read") else f"cannot be read ({error.reason})"
    return RunFolderError(f"'{path}': {reason}")


def _checked(path: Path, most: int) -> int:
    """Return the size of a regular file [B]; raises :class:`Unreadable` for other paths and for more than `most` B."""
    if "\0" in str(path):
        raise Unreadable("contains a NUL character", "remove this character, or check that the path is complete")
    try:
        found = os.stat(path)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise Unreadable(f"cannot be read ({reason})", "check the path") from error
    if not stat.S_ISREG(found.st_mode):
        kind = next((name for test, name in KINDS if test(found.st_mode)), "not a regular file")
        raise Unreadable(f"cannot be read, because it is {kind}", "give the path of a file")
    if found.st_size > most:
        raise Unreadable(
            f"is too large: {found.st_size:,} bytes, at most {most:,} are allowed", "check that it is the right file"
        )
    return found.st_size


def _text(path: Path, most: int) -> str:
    _checked(path, most)
    try:
        with path.open("rb") as file:
            content = file.read(most + 1)
    except OSError as error:
        raise Unreadable(f"cannot be read ({error.strerror or error})", "give the path of a readable file") from error
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise Unreadable("is not UTF-8 text", "save the file as UTF-8", line) from error
    if "\0" in text:
        raise Unreadable(
            "contains a NUL character", "check that it is a text file", text.count("\n", 0, text.index("\0")) + 1
        )
    return text


def _of_file(value: object, path: Path) -> object:
    """Return a JSON value whose mappings and lists store the `path` of their file, but no line numbers."""
    if is_dict(value):
        found = FileMapping({key: _of_file(each, path) for key, each in value.items()})
        found.path, found.lines = path, {}
        return found
    if isinstance(value, list):
        listed = FileList(_of_file(each, path) for each in cast("list[object]", value))
        listed.path, listed.lines = path, []
        return listed
    return value


def _kind_of(value: object) -> str:
    kinds: dict[type, str] = {
        list: "a list",
        FileList: "a list",
        str: "text",
        type(None): "nothing",
        bool: "true or false",
    }
    return kinds.get(type(value), "a number")


def parsed_json(text: str) -> object:
    """Return the value of a JSON text; raises :class:`Unreadable` for repeated keys, NaN and syntax errors."""

    def unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
        found = dict(pairs)
        if len(found) < len(pairs):
            keys = [key for key, _ in pairs]
            raise Unreadable(
                f"has the key {next(k for k in keys if keys.count(k) > 1)!r} twice", "remove one of the two"
            )
        return found

    def constant(word: str) -> NoReturn:
        raise Unreadable(f"is not valid JSON: {word} is not a number", "replace it by a finite number")

    def whole(word: str) -> int:
        if len(word) > LONGEST_NUMBER:
            raise Unreadable(
                f"contains a number of {len(word)} digits", "write the number with an exponent, as in 1e30"
            )
        return int(word)

    try:
        return json.loads(text, object_pairs_hook=unique, parse_constant=constant, parse_int=whole)
    except json.JSONDecodeError as error:
        raise Unreadable(
            f"is not valid JSON: {error.msg}",
            "mend this line; 'key: value' lines need a file whose name ends in .yaml",
            error.lineno,
        ) from error
    except RecursionError as error:
        raise Unreadable("is nested too deeply", "use fewer lists and mappings inside each other") from error


def _rows(text: str) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Return the header and the rows of a CSV text; semicolons separate columns if the header has no comma."""
    first = next((line for line in text.splitlines() if line.strip()), "")
    separator = ";" if ";" in first and "," not in first else ","
    reader = csv.reader(io.StringIO(text, newline=""), strict=True, delimiter=separator)
    found: list[tuple[int, list[str]]] = []
    try:
        for row in reader:
            found.append((reader.line_num, row))
    except csv.Error as error:
        raise Unreadable(f"is not valid CSV: {error}", "give columns separated by commas", reader.line_num) from error
    found = [(line, row) for line, row in found if any(cell.strip() for cell in row)]
    if not found:
        raise Unreadable("contains no rows", "write the names of the columns in the first line, and values below them")
    (_, header), rows = found[0], found[1:]
    names = [re.sub(r"\s*[\[(].*", "", head).strip().lower() for head in header]
    for name in names:
        if name and names.count(name) > 1:
            raise Unreadable(f"has the column {name!r} twice", "remove or rename one of the two columns")
    for line, row in rows:
        if len(row) != len(header):
            hint = "write one value for each column"
            if len(row) == len(header) + 1 and not row[-1].strip():
                hint = f"leave out the {'semicolon' if separator == ';' else 'comma'} at the end"
            elif len(row) > len(header) and separator == ";":
                hint = "leave out the surplus values, or name their columns"
            elif len(row) > len(header):
                hint = "write decimal points, as in 10.3, or separate the columns by semicolons"
            raise Unreadable(f"has {len(row)} values where the header names {len(header)} columns", hint, line)
    return header, rows
