"""Parts of a pipeline, and the pipeline that they form."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.inputs.customary import both
from .axis import Axis
from .bores import Bores
from .mesh_bores import MeshBore
from .pumps import Pump

BLOCKING_RATIO = 3.0
"""Ratio of a pipe's diameter to the diameter of the largest stone below which the pipe is known to block. ACI 304.2R
requires 3 for crushed stone."""


@dataclass(frozen=True)
class Part:
    """One part of a pipeline: a straight pipe, bend, reducer, hose, valve or the bore of a mesh."""

    number: int
    """Number of the part in its pipeline, counted from 1."""
    kind: str
    diameter: float
    """Inner diameter at the start of the pipeline part [m]."""
    length: float
    """Length of the axis of the pipeline part [m]."""
    rise: float
    """Height of the end of the pipeline part above its start [m]."""
    outlet: float
    """Inner diameter at the end of the pipeline part [m]."""
    radius: float = 0.0
    """Radius of a bend's centreline [m]; 0 for other parts."""
    angle: float = 0.0
    """Angle of a bend [degrees]; 0 for other parts."""
    relative_loss: float = 1.0
    """Friction of a hose by the program's own model, divided by the friction of straight pipe of the same length; 1 for
    other parts."""
    layer: float = 1.0
    """Resistance of the slip layer in a hose, divided by the resistance of the slip layer in a pipe; 1 for other
    parts."""
    mesh: MeshBore | None = None
    """Bore that a mesh file describes; None for other parts."""
    factor: float | None = None
    """Friction of the part as stated in the pipeline file, divided by the friction of straight pipe of the same length
    and inner diameters; None if the file does not state it."""
    factor_range: tuple[float, float] | None = None
    """Lowest and highest `factor` that agree with the pressures measured on a real pipeline; None if `factor` was not
    fitted to measured pressures."""
    customary_label: str = ""
    """Label with the sizes in customary US units; empty for a pipeline that is described in metric units."""

    @property
    def relative(self) -> float:
        """Friction of the pipeline part, divided by the friction of straight pipe of the same length.

        The value is `factor` if the file states a factor, otherwise `relative_loss`.
        """
        return self.relative_loss if self.factor is None else self.factor

    @property
    def narrow(self) -> float:
        """Smallest width of the bore across the axis [m]."""
        return min(self.diameter, self.outlet, self.mesh.narrowest if self.mesh else math.inf)

    @property
    def is_by_length(self) -> bool:
        """True if the part's pressure loss is proportional to its length."""
        return self.kind in ("straight", "hose", "valve")

    @property
    def label(self) -> str:
        """Short text that describes the part."""
        return self.customary_label or self.label_with(1.0, "m", 1e-3, "mm")

    def label_with(self, length_unit: float, length_name: str, width_unit: float, width_name: str) -> str:
        """Return a short description of the part with sizes in two units.

        Lengths are given in a unit of the size `length_unit` [m] with the name `length_name`, and diameters in a unit
        of the size `width_unit` [m] with the name `width_name`.
        """
        if self.kind == "bend":
            return f"bend of {self.angle:g} degrees, radius {self.radius / length_unit:g} {length_name}"
        if self.kind == "reducer":
            return f"{self.diameter / width_unit:g} to {self.outlet / width_unit:g} {width_name}"
        if self.mesh:
            narrow = f"{self.narrow / width_unit:.4g} {width_name}"
            return f"bore of {Path(self.mesh.file).name}, {narrow} at its narrowest"
        climb = f", {'falls' if self.rise < 0 else 'rises'} {abs(self.rise) / length_unit:.3g} {length_name}"
        if self.kind == "hose":
            return f"hose{climb}" if round(self.rise, 9) else "hose"
        if self.kind == "valve":
            return "valve"
        way = {1.0: " up", -1.0: " down", 0.0: ""}.get(round(self.rise / self.length, 9), climb)
        return f"straight{way}"

    @property
    def loss_key(self) -> tuple[Any, ...]:
        """Key under which the simulated friction of the part is stored.

        Bends, reducers and bores with equal keys have the same friction. Straight pipes, hoses and valves with equal
        keys have the same friction divided by the length and by `relative_loss`.
        """
        if self.is_by_length:
            return ("straight", self.diameter, self.layer)
        shape = self.mesh.digest if self.mesh else ""
        return (self.kind, self.diameter, self.outlet, self.length, self.radius, self.angle, shape)


@dataclass(frozen=True)
class PipeLine:
    """Pipeline: a sequence of parts and their common axis in space, in SI units."""

    name: str
    parts: tuple[Part, ...]
    axis: Axis
    flow: float | None = None
    """Volume flow [m3/s], at which the pressure `recorded` was measured; None if not stated."""
    concrete: str | None = None
    largest_stone: float | None = None
    """Diameter of the largest stone in the concrete [m]; None if not stated."""
    source: str = ""
    recorded: float | None = None
    """Pressure recorded at the pump of a real pipeline [Pa]; None if not stated."""
    pump: Pump | None = None
    """Data sheet of the pump; None if not stated."""
    customary: bool = False
    """True if the line is described in customary US units. Texts about the line then give psi, feet and cubic yards in
    addition to metric units."""

    @property
    def length(self) -> float:
        """Length of the pipeline along its axis [m]."""
        return sum(part.length for part in self.parts)

    @property
    def rise(self) -> float:
        """Height of the pipeline's end above its start [m]."""
        return sum(part.rise for part in self.parts)

    @property
    def bores(self) -> Bores:
        """Inner radii along the axis [m]. A cross-section of a mesh has the radius of the circle with the same area."""
        return self._profile("radii")

    @property
    def clear(self) -> Bores:
        """Radii [m] of the largest circles about the axis that fit into the bore without touching its wall."""
        return self._profile("least")

    def _profile(self, of: str) -> Bores:
        begin, places, radii = 0.0, [0.0], [self.parts[0].diameter / 2]
        for part in self.parts:
            if part.mesh:
                places += [begin + place for place in part.mesh.places]
                radii += getattr(part.mesh, of)
            begin += part.length
            places.append(begin)
            radii.append(part.outlet / 2)
        return Bores(tuple(places), tuple(radii))

    def remarks(self) -> list[str]:
        """Return warnings for the user about the pipeline, for example about stones that may block a narrow part."""
        texts = []
        narrow = min(part.narrow for part in self.parts)
        if self.largest_stone and narrow < BLOCKING_RATIO * self.largest_stone:
            stone, bore = (both(self.customary, "mm", size) for size in (self.largest_stone, narrow))
            texts.append(
                f"stones of {stone} in a bore of {bore} may block: the bore is narrower than {BLOCKING_RATIO:g} of them"
            )
        return texts
