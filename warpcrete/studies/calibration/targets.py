"""Task of a calibration: measured quantities of scenes, and free parameters with their ranges."""

import json
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import SceneError, known_names, refuse, suggested
from ...core.inputs.amounts import UNITS, amount
from ...core.inputs.by_name import names_from_file
from ...core.inputs.concretes import concrete, is_file
from ...core.inputs.limits import check_limit
from ...core.inputs.parameters import Field, FileIf, declared_fields
from ...core.inputs.text_files import errors_in_file, errors_located_at, read_mapping
from ...core.records import Record, SceneArguments
from ...core.run.method import Quantity
from ...core.run.scene_module import SceneModule
from ...core.units import number, shown
from ...core.written_numbers import written_text
from ...methods import METHODS, method_of

KEYS = ("base", "vary", "targets")
TARGET_KEYS = ("scene", "quantity", "value", "uncertainty", "parameters", "held_out")
LOG_SCALE_RATIO = 10.0
"""Smallest ratio of the upper to the lower end of a parameter's range at which the parameter is searched on a
logarithmic scale. The parameter's own entry `scale` overrides this rule."""
MAX_DEVIATIONS_APART = 3.0
"""Difference between two measured values of the same quantity, in standard deviations, above which the targets are
refused, because the values contradict each other."""


@dataclass(frozen=True)
class FreeParameter:
    """Parameter whose value a calibration determines within a range."""

    name: str
    low: float
    high: float
    log: bool
    """True if the parameter is searched on a logarithmic scale."""
    whole: bool
    """True if the parameter is a whole number."""

    def value(self, unit: float) -> float:
        """Return the parameter's value at the position `unit`: 0 is the low end of its range and 1 the high end."""
        if self.log:
            value = math.exp(math.log(self.low) + unit * (math.log(self.high) - math.log(self.low)))
        else:
            value = self.low + unit * (self.high - self.low)
        return round(value) if self.whole else min(max(value, self.low), self.high)

    def place(self, value: float) -> float:
        """Return the position of a value in the parameter's range, from 0 to 1."""
        if self.log:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


@dataclass(frozen=True, eq=False)
class Target:
    """Measured value that the calibration compares with a quantity of a scene's result."""

    scene: str
    quantity: str
    value: float
    uncertainty: float
    """Standard deviation of the measured value, in the unit of `value`."""
    parameters: Mapping[str, Any]
    """Parameters with which the scene is simulated, without the free parameters of the calibration."""
    held_out: bool
    """True if the quantity is predicted and compared with the measurement, but not fitted."""
    unit: str

    @property
    def key(self) -> str:
        """Text that identifies the target's scene together with the parameters of this scene.

        The text is equal for all targets whose quantities come from the same run.
        """
        return json.dumps([self.scene, dict(self.parameters)], sort_keys=True, default=str)

    @property
    def label(self) -> str:
        """Name of the target in tables and messages: its quantity, its scene and the scene's parameters."""
        given = ", ".join(f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"
                          for name, value in self.parameters.items() if name not in ("concrete", "seed"))  # fmt: skip
        return f"{self.quantity.replace('_', ' ')} of {self.scene}" + (f" ({given})" if given else "")

    def words(self, value: float) -> str:
        """Return a value of the quantity as text, in its customary unit."""
        factor, unit = shown(self.unit)
        return f"{value * factor:.4g} {unit}".strip()


@dataclass(frozen=True)
class Task:
    """Measured targets and free parameters of a calibration."""

    base: str | None
    """Concrete (name or file) that provides all properties that are not free. If None, each scene keeps its own
    concrete."""
    free: tuple[FreeParameter, ...]
    targets: tuple[Target, ...]

    @property
    def groups(self) -> list[list[Target]]:
        """Groups of targets whose quantities all come from the same run."""
        by_key: dict[str, list[Target]] = {}
        for target in self.targets:
            by_key.setdefault(target.key, []).append(target)
        return list(by_key.values())

    @property
    def fitted(self) -> list[Target]:
        """Targets that the calibration fits, without those that are held out."""
        return [target for target in self.targets if not target.held_out]

    def values(self, units: Sequence[float]) -> dict[str, float]:
        """Return the values of the free parameters, by name.

        `units` holds the same values, each scaled to 0 to 1 over its range.
        """
        return {free.name: free.value(float(unit)) for free, unit in zip(self.free, units)}

    def places(self, values: Mapping[str, float]) -> np.ndarray:
        """Return the values of the free parameters, each scaled to 0 to 1 over its range, shape (free,)."""
        return np.array([free.place(values[free.name]) for free in self.free])

    def parameters(self, target: Target, values: Mapping[str, float], module: SceneModule) -> SceneArguments:
        """Return the keyword arguments that build a target's scene from the `values` of the free parameters.

        Free parameters that the scene does not have are left out.
        """
        known = declared_fields(module.scene.parameters)
        base = {"concrete": self.base} if self.base is not None and "concrete" in known else {}
        return {**base, **target.parameters, **{name: value for name, value in values.items() if name in known}}


def read_task(path: Path, modules: Mapping[str, SceneModule]) -> tuple[Task, Record]:
    """Read a file of targets; return the task and the file's contents as a mapping.

    `warpcrete calibrate --help` shows an example. Paths in the file are relative to its folder. Raises
    :class:`SceneError` for any mistake in the file.
    """
    raw = read_mapping(path, "targets")
    if isinstance(raw.get("base"), str) and is_file(raw["base"]):
        raw["base"] = os.path.realpath(path.parent / raw["base"])
    with errors_in_file(path):
        task = task_of(raw, modules, path.parent)
    raw["targets"] = [
        {**each, "parameters": dict(target.parameters)} for each, target in zip(raw["targets"], task.targets)
    ]
    return task, raw


@names_from_file()
def task_of(raw: Mapping[str, object], modules: Mapping[str, SceneModule], folder: Path | None = None) -> Task:
    """Build the task of a calibration from `raw`, the contents of a file of targets as a mapping.

    Paths in the mapping are relative to `folder`. Raises :class:`SceneError` for any mistake in the mapping.
    """
    for key in raw:
        if key not in KEYS:
            with errors_located_at(raw, key):
                refuse("targets", key, "is not a key of the file of targets", known_names(key, KEYS))
    base = raw.get("base")
    if base is not None:
        with errors_located_at(raw, "base"):
            concrete(str(base))
    vary, listed = raw.get("vary"), raw.get("targets")
    with errors_located_at(raw, "vary"):
        if not isinstance(vary, Mapping) or not vary:
            problem = "must list one or more parameters, each with its range"
            refuse("vary", vary, problem, "for example 'friction: [0, 0.5]'")
    with errors_located_at(raw, "targets"):
        if not isinstance(listed, Sequence) or isinstance(listed, str) or not listed:
            hint = "for example '- {scene: slump, quantity: spread, value: 550 mm, uncertainty: 5%}'"
            refuse("targets", listed, "must be a list of one or more targets", hint)
    targets = []
    for place, each in enumerate(listed):
        with errors_located_at(listed, place):
            targets.append(_target(place + 1, each, modules, vary, folder or Path()))
    if base is not None and not any("concrete" in _known(modules, target.scene) for target in targets):
        problem = "has no effect, because no scene of the targets has a parameter 'concrete'"
        refuse("base", base, problem, "leave out 'base'")
    free = []
    for name, given in vary.items():
        with errors_located_at(vary, name):
            free.append(_free(str(name), given, _field(str(name), targets, modules)))
    if all(target.held_out for target in targets):
        problem = "must not be true for all targets, because at least one must be fitted"
        refuse("held_out", True, problem, "leave out 'held_out' for one target")
    task = Task(None if base is None else str(base), tuple(free), tuple(targets))
    checked = []
    for place, target in enumerate(targets):
        with errors_located_at(listed, place):
            checked.append(_checked(task, target, modules))
    task = Task(task.base, tuple(free), tuple(checked))
    _refuse_contradictions(task.targets)
    return task


def _known(modules: Mapping[str, SceneModule], scene: str) -> Mapping[str, Field]:
    return declared_fields(modules[scene].scene.parameters)


def _target(
    place: int, given: object, modules: Mapping[str, SceneModule], vary: Mapping[str, object], folder: Path
) -> Target:
    called = f"target {place}"
    if not isinstance(given, Mapping):
        refuse(called, given, "must consist of 'key: value' pairs", f"possible keys are {', '.join(TARGET_KEYS)}")
    for key in given:
        if key not in TARGET_KEYS:
            with errors_located_at(given, key):
                hint = known_names(key, TARGET_KEYS)
                if given.get("scene") in list(modules) and key in _known(modules, given["scene"]):
                    hint = f"it is a parameter of the scene: write 'parameters: {{{key}: {given[key]}}}'"
                refuse(called, key, "is not a key of a target", hint)
    missing = [key for key in TARGET_KEYS[:4] if given.get(key) is None]
    if missing:
        refuse(called, dict(given), f"has no {', '.join(missing)}", "add the missing entries")
    with errors_located_at(given, "scene"):
        if not isinstance(given["scene"], str) or given["scene"] not in modules:
            problem = f"must be one of {', '.join(modules)}"
            refuse(f"{called} scene", given["scene"], problem, suggested(given["scene"], modules))
    if isinstance(given["value"], str):
        with errors_located_at(given, "quantity"):
            _unit_of(str(given["quantity"]))
    with errors_located_at(given, "value"):
        value = _in_unit(f"{called} value", given["value"], str(given["quantity"]))
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            problem = "must be a finite number, in SI units or with its unit"
            refuse(f"{called} value", value, problem, "for example 0.55 or '550 mm'")
    parameters = given.get("parameters") or {}
    with errors_located_at(given, "parameters"):
        if not isinstance(parameters, Mapping):
            problem = "must consist of 'name: value' pairs"
            refuse(f"{called} parameters", parameters, problem, "for example {yield_stress: 50}")
    for name, stated in parameters.items():
        with errors_located_at(parameters, name):
            modules[given["scene"]].scene.resolved({name: stated})
    parameters = modules[given["scene"]].scene.resolved(parameters)
    for name, field in _known(modules, given["scene"]).items():
        files = [rule for rule in field.of_kind(FileIf) if isinstance(parameters.get(name), str)]
        if any(rule.test(parameters[name]) for rule in files):
            parameters[name] = os.path.realpath(folder / parameters[name])
    for name in vary:
        if name in parameters:
            problem = "cannot be both given here and varied"
            refuse(f"{called} parameters", name, problem, f"leave out {name!r} here or under 'vary'")
    held = given.get("held_out", False)
    with errors_located_at(given, "held_out"):
        if not isinstance(held, bool):
            refuse(f"{called} held_out", held, "must be true or false")
    with errors_located_at(given, "uncertainty"):
        uncertainty = _uncertainty(f"{called} uncertainty", given["uncertainty"], float(value), str(given["quantity"]))
    stated = value if written_text(value) else float(value)  # Keep a text with a unit, to avoid unit hints.
    return Target(given["scene"], str(given["quantity"]), stated, uncertainty, parameters, held, "")


def _in_unit(called: str, given: object, quantity: str) -> Any:
    """Convert a text such as "550 mm" to a number in the unit of `quantity`; return anything else unchanged.

    `called` names the value in error messages.
    """
    if isinstance(given, str) and (unit := _unit_of(quantity)) in UNITS:
        return amount(called, given, unit)
    return given


def _unit_of(quantity: str) -> str:
    """Return the unit of a quantity of results; raise :class:`SceneError` if no scene has such a result."""
    units = {each.name: each.unit for method in METHODS for each in method.quantities}
    if quantity not in units:
        refuse("quantity", quantity, "is not a result of any scene", known_names(quantity, units))
    return units[quantity]


def _uncertainty(called: str, given: object, value: float, quantity: str) -> float:
    """Return the standard deviation of a measured `value`, stated as a number or as a percentage of the value.

    `given` is the statement of the user, and `quantity` the measured quantity. `called` names the standard deviation in
    error messages.
    """
    percentage = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*%\s*", given) if isinstance(given, str) else None
    if percentage:
        given = float(percentage.group(1)) / 100 * abs(value)
    elif not (isinstance(given, str) and "%" in given):
        given = _in_unit(called, given, quantity)
    if isinstance(given, bool) or not isinstance(given, int | float) or not math.isfinite(given) or given <= 0:
        problem = "must be a number above 0 in the value's unit, or a percentage of the value"
        refuse(called, given, problem, "for example '5%'")
    return float(given)


def _field(name: str, targets: Sequence[Target], modules: Mapping[str, SceneModule]) -> Field:
    """Return the field that declares a free parameter in the targets' scenes.

    Raises :class:`SceneError` if no target's scene has such a parameter, if it is not a number, or if it is the seed.
    """
    scenes = dict.fromkeys(target.scene for target in targets)
    known = [_known(modules, scene) for scene in scenes]
    fields = [each[name] for each in known if name in each]
    if not fields:
        hint = suggested(name, {key for each in known for key in each}) or "'warpcrete run SCENE --help-all' lists them"
        refuse("vary", name, f"is not a parameter of {', '.join(scenes)}", hint)
    if {field.kind for field in fields} - {int, float} or name == "seed":
        problem = "cannot be varied, because only numeric parameters other than the seed can"
        refuse("vary", name, problem, f"leave out {name!r} under 'vary'")
    return next((field for field in fields if field.kind is int), fields[0])


def _free(name: str, given: Any, field: Field) -> FreeParameter:
    """Check the range that the user states for a free parameter, and return the parameter with this range.

    `given` is the range, and `field` declares the parameter in a scene.
    """
    called, whole = f"vary {name}", field.kind is int
    scale = None
    if isinstance(given, Mapping):
        if set(given) - {"low", "high", "scale"} or not {"low", "high"} <= set(given):
            problem = "must have 'low' and 'high', and may have 'scale'"
            refuse(called, dict(given), problem, "for example {low: 0.1, high: 1, scale: log}")
        scale, given = given.get("scale"), [given["low"], given["high"]]
    numbers = isinstance(given, Sequence) and not isinstance(given, str) and len(given) == 2
    if numbers:
        given = [field.number(each, called) for each in given]
    if not numbers or not all(
        isinstance(e, int | float) and not isinstance(e, bool) and math.isfinite(e) for e in given
    ):
        refuse(called, given, "must be two finite numbers, the lowest and the highest value", "for example [0.1, 1]")
    for each in given:
        field.check_limits(field.converted(each, called), called)
    low, high = map(float, given)
    if low == high:
        refuse(called, [low, high], "is a single value, but must be a range", "to keep the parameter at this value, "
               "leave it out here, and write it into the 'parameters' of the targets")  # fmt: skip
    if not low < high:
        refuse(called, [low, high], "must begin with the lower number", f"did you mean [{high:g}, {low:g}]?")
    if scale not in (None, "log", "linear"):
        refuse(f"{called} scale", scale, "must be log or linear")
    if scale == "log" and low <= 0:
        refuse(called, [low, high], "must be above 0 for a logarithmic scale", "write 'scale: linear'")
    return FreeParameter(
        name, low, high, scale == "log" or (scale is None and low > 0 and high / low >= LOG_SCALE_RATIO), whole
    )


def _checked(task: Task, target: Target, modules: Mapping[str, SceneModule]) -> Target:
    """Check a target against its scene, and return a copy of the target that includes the unit of the quantity.

    Raises :class:`SceneError` if the scene does not measure the quantity, or if the scene refuses a value at one end of
    a free parameter's range.
    """
    module = modules[target.scene]
    middle = [0.5] * len(task.free)
    scene = module.scene(**task.parameters(target, task.values(middle), module))
    for place, free in enumerate(task.free):
        for end in (0.0, 1.0):
            units = [*middle[:place], end, *middle[place + 1 :]]
            try:
                module.scene(**task.parameters(target, task.values(units), module))
            except SceneError as error:
                raise SceneError(f"vary {free.name} = {[free.low, free.high]}: {target.label}: {error}") from error
    known: dict[str, Quantity] = {each.name: each for each in method_of(scene).quantities}
    if target.quantity not in known:
        refuse(
            "quantity",
            target.quantity,
            f"is not a result of the scene {target.scene}",
            known_names(target.quantity, known),
        )
    unit = known[target.quantity].unit
    if unit in ("m", "s") and target.value < 0:
        problem = f"must be at least 0 {unit}"
        refuse(f"{target.quantity} of {target.scene}", target.value, problem, "check the sign of the value")
    name = "pressure" if target.quantity.endswith("pressure") else target.quantity
    check_limit(f"{target.quantity} of {target.scene}", target.value, unit, name)
    return Target(target.scene, target.quantity, target.value, target.uncertainty, target.parameters,
                  target.held_out, unit)  # fmt: skip


def _refuse_contradictions(targets: Sequence[Target]) -> None:
    """Refuse targets in which two measured values of the same quantity contradict each other."""
    for place, one in enumerate(targets):
        for other in targets[:place]:
            scatter = math.hypot(one.uncertainty, other.uncertainty)
            same = (one.key, one.quantity) == (other.key, other.quantity)
            if same and abs(one.value - other.value) > MAX_DEVIATIONS_APART * scatter:
                apart = abs(one.value - other.value) / scatter
                refuse(
                    "targets",
                    f"{other.words(other.value)} and {one.words(one.value)}",
                    f"contradict each other: both state the {one.label}, but differ by {apart:.2g} standard deviations",
                    "correct one of them, or increase their uncertainties",
                )


def found_in(result: Mapping[str, object], target: Target) -> float | None:
    """Return the value of a target's quantity, read from the contents of a run's result.json.

    The result is None if the value is missing or not a finite number.
    """
    entry = result.get(target.quantity)
    value = None if entry is None else number(entry)
    return value if value is not None and math.isfinite(value) else None
