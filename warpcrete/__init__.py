"""warpcrete: particle simulation of fresh concrete being pumped, on GPU or CPU.

import warpcrete
run = warpcrete.Simulation(warpcrete.scenes.pipe(unit="vertical"), device="cpu").run()
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from .errors import (
    CapacityError,
    ConvergenceError,
    DeviceError,
    InstabilityError,
    RunFolderError,
    SceneError,
    WarpcreteError,
)

if TYPE_CHECKING:
    from .fluid_simulation import FluidSimulation
    from .scene import Scene
    from .simulation import Simulation
    from .spine import Run

__all__ = [
    "CapacityError",
    "ConvergenceError",
    "DeviceError",
    "FluidSimulation",
    "InstabilityError",
    "Run",
    "RunFolderError",
    "Scene",
    "SceneError",
    "Simulation",
    "WarpcreteError",
    "scenes",  # pyright: ignore[reportUnsupportedDunderAll]
]

_LAZY = {
    "Simulation": "simulation", "Run": "spine", "Scene": "scene", "FluidSimulation": "fluid_simulation",
}  # fmt: skip


def __getattr__(name: str) -> Any:
    # Warp takes half a second to import: only what is used is loaded.
    if name in _LAZY:
        return getattr(importlib.import_module(f".{_LAZY[name]}", __name__), name)
    if name == "scenes":
        return importlib.import_module(".scenes", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
