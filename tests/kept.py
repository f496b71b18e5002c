"""Numbers and texts that tests keep in files, so that nothing changes without being noticed.

A kept file says nothing about right or wrong: formulas, balances and published values are tested elsewhere. It covers
the many small decisions between a tested formula and what a user reads: which row, which column, which unit, which
sign, which default is passed on. If a change is meant, write the files anew and read the difference:

    KEEP=1 python -m pytest tests -k kept
"""

import dataclasses
import difflib
import enum
import functools
import math
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from warpcrete.dem.scene.clumps import ClumpTemplate

FOLDER = Path(__file__).parent / "kept"
NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w.]*\w)")
TOLERANCE = 1e-6
"""Relative to the largest number of a line. Libraries and processors round differently in the last digits."""
WHOLE = 12
"""Arrays of up to this size are kept as they are, and larger ones as so many samples and two sums."""
DEPTH = 4
"""Number of objects within each other that are described."""


def compare(name: str, value: Any, tolerance: float = TOLERANCE) -> None:
    """Compare a value of any kind with the file called `name`, line by line; numbers may differ by rounding."""
    lines = value.splitlines() if isinstance(value, str) else list(described(value))
    path = FOLDER / f"{name}.txt"
    if os.environ.get("KEEP"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    kept = path.read_text(encoding="utf-8").splitlines()
    if len(kept) != len(lines):
        found = list(difflib.unified_diff(kept, lines, "kept", "now", lineterm="", n=0))
        pytest.fail(f"{path.name}: {len(lines)} lines instead of {len(kept)}\n" + "\n".join(found[:20]))
    wrong = [f"  {was}\n  {now}" for was, now in zip(kept, lines) if not same(was, now, tolerance)]
    assert not wrong, f"{path.name}: {len(wrong)} lines differ, the first of which are\n" + "\n".join(wrong[:5])


def same(was: str, now: str, tolerance: float = TOLERANCE) -> bool:
    """Return whether two lines have the same words, and the same numbers within rounding; words alone if infinite."""
    if was == now:
        return True
    if NUMBER.sub("#", was) != NUMBER.sub("#", now):
        return False
    if math.isinf(tolerance):
        return True
    name, sign, value = was.partition(" = ")
    if sign and now.startswith(name + sign):
        was, now = value, now.removeprefix(name + sign)  # A number in the name does not set the scale.
    before, after = (np.array([float(each) for each in NUMBER.findall(line)]) for line in (was, now))
    return bool(np.allclose(after, before, rtol=tolerance, atol=tolerance * float(np.abs(before).max(initial=0.0))))


def described(value: Any, name: str = "", seen: frozenset[int] = frozenset()) -> Iterator[str]:
    """Yield lines `name = value` of everything in a value: entries, fields of dataclasses and their properties."""
    if isinstance(value, enum.Enum):
        value = value.name
    if isinstance(value, Path):
        value = value.name
    if value is None or isinstance(value, str | bool):
        yield f"{name} = {value}".replace("\n", "\\n")
    elif isinstance(value, int | float | np.number | np.bool_):
        yield f"{name} = {_number(value)}"
    elif isinstance(value, np.ndarray) and value.dtype.kind in "biuf":
        yield f"{name} {'x'.join(map(str, value.shape))} = {_array(value.astype(float).ravel())}"
    elif isinstance(value, np.ndarray):
        yield from described(value.tolist(), name, seen)
    elif isinstance(value, Mapping):
        for key, each in value.items():
            yield from described(each, f"{name}.{key}".lstrip("."), seen)
    elif isinstance(value, set | frozenset):
        yield from described(sorted(map(str, value)), name, seen)
    elif isinstance(value, list | tuple | range):
        if value and all(isinstance(each, int | float | np.number) for each in value):
            yield f"{name} {len(value)} = {_array(np.array(value, float))}"
            return
        if not value:
            yield f"{name} = ()"
        for number, each in enumerate(value):
            yield from described(each, f"{name}[{number}]", seen)
    elif callable(value) or id(value) in seen or len(seen) == DEPTH:
        yield f"{name} = {type(value).__name__}"
    else:
        yield f"{name} = {type(value).__name__}"
        for field, each in _fields(value):
            yield from described(each, f"{name}.{field}".lstrip("."), seen | {id(value)})


def _fields(value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, ClumpTemplate):
        # The signs of principal axes, and the axes of equal moments, are as the linear algebra library has them.
        yield from (("radii", value.radii), ("inertia", value.inertia), ("far", np.linalg.norm(value.offsets, axis=1)))
        return
    if isinstance(value, trimesh.Trimesh):
        yield from (("vertices", value.vertices.view(np.ndarray)), ("faces", value.faces.view(np.ndarray)))
        return
    for field in dataclasses.fields(value) if dataclasses.is_dataclass(value) else ():
        yield field.name, getattr(value, field.name)
    for name in dir(type(value)):
        if not name.startswith("_") and isinstance(getattr(type(value), name), property | functools.cached_property):
            try:
                yield name, getattr(value, name)
            except Exception as error:
                yield name, f"{type(error).__name__}: {error}"


def _number(value: Any) -> str:
    return f"{float(value):.9g}" if math.isfinite(value) else str(float(value))


def _array(values: np.ndarray) -> str:
    if len(values) <= WHOLE:
        return " ".join(map(_number, values))
    places = np.linspace(0, len(values) - 1, WHOLE).astype(int)
    sums = values.sum(), (values * np.cos(np.arange(len(values)))).sum()
    return " ".join(map(_number, [*values[places], *sums]))


def drawn(figure: Any) -> dict[str, Any]:
    """Return what a Matplotlib figure shows: of each pair of axes its words, scales, lines, areas and colours."""
    from matplotlib.colors import to_hex

    def colour(value: Any) -> Any:
        return value if isinstance(value, str) else [to_hex(each) for each in np.atleast_2d(value)[:3]]

    found: dict[str, Any] = {"title": figure.get_suptitle()}
    for number, axes in enumerate(figure.axes):
        one: dict[str, Any] = {
            "words": [axes.get_title(place) for place in ("left", "center", "right")]
            + [axes.get_xlabel(), axes.get_ylabel(), axes.get_xscale(), axes.get_yscale()],
            "x": axes.get_xlim(),
            "y": axes.get_ylim(),
            "aspect": axes.get_aspect(),
            "texts": [[each.get_text(), *each.get_position()] for each in axes.texts],
            "images": [np.asarray(each.get_array()) for each in axes.images],
        }
        legend = axes.get_legend()
        one["legend"] = [each.get_text() for each in legend.get_texts()] if legend else []
        one["lines"] = [
            {
                "label": each.get_label(),
                "x": np.asarray(each.get_xdata(), float),
                "y": np.asarray(each.get_ydata(), float),
                "style": [each.get_linestyle(), str(each.get_marker()), to_hex(each.get_color())],
            }
            for each in axes.lines
        ]
        one["areas"] = [
            {
                "label": each.get_label(),
                "colour": colour(each.get_facecolor()),
                "values": each.get_array(),
                "limits": each.get_clim(),
                "offsets": np.asarray(each.get_offsets(), float),
                "paths": [path.vertices for path in each.get_paths()[:4]],
            }
            for each in axes.collections
        ]
        one["patches"] = [[each.get_path().vertices[:4], colour(each.get_facecolor())] for each in axes.patches]
        found[f"axes{number}"] = one
    return found
