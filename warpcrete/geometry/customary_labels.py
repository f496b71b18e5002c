"""Labels of the parts of a pipeline in customary US units, with sizes in the user's notation, such as "4 1/2 in"."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from ..core.inputs.amounts import FOOT, INCH, is_customary
from .line_entries import PARTS
from .pipe_line import Part, PipeLine


def with_customary_labels(parts: Sequence[Part], entries: Sequence[object], diameter: object) -> tuple[Part, ...]:
    """Return the parts of a pipeline with labels in inches and feet.

    `entries` are the entries of the parts in the pipeline's file, and `diameter` is the diameter of the first part as
    written in the file. A size that the file states in a customary unit appears unchanged in the label.
    """
    bore, parts_with_labels = _written(diameter, parts[0].diameter, INCH, "in"), []
    for part, entry in zip(parts, entries, strict=True):
        ((kind, said),) = entry.items() if isinstance(entry, Mapping) else ((entry, None),)
        sizes = said if isinstance(said, Mapping) else {next(iter(PARTS[kind])): said}
        label = ""
        if kind == "bend":
            radius = _written(sizes.get("radius"), part.radius, FOOT, "ft")
            label = f"bend of {part.angle:g} degrees, radius {radius}"
        elif kind == "reducer":
            inlet, bore = bore, _written(sizes["to"], part.outlet, INCH, "in")
            label = f"{inlet} to {bore}"
        elif kind == "bore":
            bore = _written(sizes.get("outlet"), part.outlet, INCH, "in")
        parts_with_labels.append(_labelled(part, label))
    return tuple(parts_with_labels)


def as_customary(line: PipeLine) -> PipeLine:
    """Return a copy of a pipeline described in metric units, for results in customary US units.

    The labels of the copy's parts, and all texts about the copy, have inches, feet and psi. `line` does not change.
    """
    return replace(line, customary=True, parts=tuple(_labelled(part, part.customary_label) for part in line.parts))


def _labelled(part: Part, label: str) -> Part:
    """Return a part with the given `label` or, if it is empty, with a label in inches and feet."""
    return replace(part, customary_label=label or part.label_with(FOOT, "ft", INCH, "in"))


def _written(stated: object, size: float, unit: float, name: str) -> str:
    """Return the text `stated` if its unit is a customary US unit; otherwise the `size` [m] as text in the unit `name`.

    `unit` is the length of this unit [m].
    """
    return str(stated).strip() if is_customary(stated) else f"{size / unit:.4g} {name}"
