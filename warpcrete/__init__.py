"""Particle simulation of fresh concrete being pumped, on a GPU or a CPU.

This example runs the scene of a vertical pipe on the CPU::

    import warpcrete
    run = warpcrete.Simulation(warpcrete.scenes.pipe(unit="vertical"), device="cpu").run()

This package gathers the names that users need from all other packages, and no other module imports it. To read the
code, start with the module `methods`, which imports `core` and lists all simulation methods, and go on with
`core.run.run_loop`.
"""

import importlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .core.errors import (
    CapacityError,
    ConvergenceError,
    DeviceError,
    InstabilityError,
    RunFolderError,
    SceneError,
    WarpcreteError,
)
from .core.errors import suggested as _suggested

if TYPE_CHECKING:
    __version__: str
    from . import scenes
    from .core.run.recorder import Recorder
    from .dem.scene.scene import Scene
    from .methods import Run
    from .mix.mix import read_mix
    from .mps.scene import FluidScene
    from .record.output import RunFolder, Simulation
    from .studies.api import study
    from .studies.calibration.calibrate import calibrate
    from .studies.loading import load
    from .studies.tradeoffs.explain import explain
    from .studies.tradeoffs.trade import trade

if __name__ != "warpcrete":
    raise ImportError(f"the package was imported as {__name__!r}; import it as 'warpcrete'")
if not Path(__file__).with_name("kernels").exists():
    # In a checkout, the packages `kernels` and `scenes` lie beside this one; an installed wheel contains them.
    __path__.append(str(Path(__file__).parents[1]))

__all__ = [
    "CapacityError", "ConvergenceError", "DeviceError", "FluidScene", "InstabilityError", "Recorder", "Run",
    "RunFolder", "RunFolderError", "Scene", "SceneError", "Simulation", "WarpcreteError", "__version__", "calibrate",
    "explain", "load", "read_mix", "scenes", "study", "trade",
]  # fmt: skip

_LAZY = {
    "Simulation": "record.output",
    "RunFolder": "record.output",
    "Run": "methods",
    "Scene": "dem.scene.scene",
    "FluidScene": "mps.scene",
    "Recorder": "core.run.recorder",
    "load": "studies.loading",
    "study": "studies.api",
    "trade": "studies.tradeoffs.trade",
    "explain": "studies.tradeoffs.explain",
    "calibrate": "studies.calibration.calibrate",
    "read_mix": "mix.mix",
}


_INSTEAD = {
    "run": "; write warpcrete.Simulation(scene, device='cpu').run()",
    "resume": "; execute the lines that began the run again, or use 'warpcrete run --resume FOLDER'",
}
"""Hints for names that users may look for in this package but that it does not contain. An error message ends with the
hint for the missing name."""


def __getattr__(name: str) -> Any:
    # Importing Warp takes half a second, so a module is imported only when one of its names is used.
    if name in _LAZY:
        return getattr(importlib.import_module(f".{_LAZY[name]}", __name__), name)
    if name == "scenes":
        return importlib.import_module(".scenes", __name__)
    if name == "__version__":
        return importlib.import_module(".core.run.version", __name__).version_of("warpcrete")
    instead = _INSTEAD.get(name, "")
    scenes = {path.stem for root in __path__ for path in Path(root, "scenes").glob("[a-z]*.py")}
    if name in scenes:
        instead = f"; write warpcrete.scenes.{name}"
    elif not instead and not name.startswith("_"):
        meant = _suggested(name, __all__) or _suggested(name, scenes).replace("'", "'scenes.", 1)
        instead = f"; {meant}" if meant else ""
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}{instead}")


def __dir__() -> list[str]:
    return sorted({*__all__, *_LAZY})
