"""Scenes that can be simulated: each is a function of its parameters, such as `scenes.pipe(diameter="125 mm")`.

`help(scenes.pipe)` lists the parameters of a scene with their units and defaults, and `Simulation(scene).run()` runs
it::

    import warpcrete
    run = warpcrete.Simulation(warpcrete.scenes.slump(yield_stress=80)).run()

Scenes import `core`, `geometry`, `theory`, `standards` and the simulation methods, but no module that runs or records
scenes. To read the code, start with `slump`, a complete scene in one file, or with `lcpc`, a test for two methods in
one file.
"""

# Every file in this folder is a scene. Its name is the file's name, with hyphens instead of underscores. Three names in
# the file define the scene: the function `scene` builds it, the function `check` judges its runs, and `trading` holds
# the settings that trade its accuracy for run time. If both a flow and discrete elements can simulate a test, there are
# two scenes, NAME and NAME-dem. The scene NAME-dem has a file of its own, NAME_dem.py, or else the file of NAME defines
# both scenes, with the names `scene_dem`, `check_dem` and `trading_dem` for NAME-dem.

import functools
import importlib
import pkgutil
import sys
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from warpcrete.core.errors import known_names, refuse
from warpcrete.core.inputs.scene_titles import scene_titles

if TYPE_CHECKING:
    from .channel import scene as channel
    from .funnel import scene as funnel
    from .funnel_dem import scene as funnel_dem
    from .jring import scene as jring
    from .jring_dem import scene as jring_dem
    from .lbox import scene as lbox
    from .lbox_dem import scene as lbox_dem
    from .lcpc import scene as lcpc
    from .lcpc import scene_dem as lcpc_dem
    from .part import scene as part
    from .part_dem import scene as part_dem
    from .pipe import scene as pipe
    from .slump import scene as slump
    from .slump_dem import scene as slump_dem
    from .stretch import scene as stretch
    from .tube import scene as tube

__all__ = ["by_method", "channel", "funnel", "funnel_dem", "jring", "jring_dem", "lbox", "lbox_dem", "lcpc", "lcpc_dem",
           "methods", "modules", "part", "part_dem", "pipe", "slump", "slump_dem", "stretch", "suspended",
           "tube"]  # fmt: skip

METHODS = ("mps", "dem", "suspension")
"""Names of the simulation methods: "mps" for flows (moving particles or a grid), "dem" for discrete elements, and
"suspension" for flows of mortar with aggregates."""
PIPE_AS_PART, BEND_AS_PART = {"unit": "vertical", "diameter": 0.15}, {"elbow_radius": 0.5}
"""If the scene `pipe` is simulated as a suspension, the scene `part` simulates it with these defaults of `pipe`.
PIPE_AS_PART holds the defaults for all pipes, and BEND_AS_PART the defaults that have an effect in bends only."""


def modules() -> dict[str, ModuleType]:
    """Return the modules of all scenes, by scene name."""
    return dict(_scene_modules())


@functools.cache
def _scene_modules() -> dict[str, ModuleType]:
    """Import the files of this folder once, because listing the folder takes a millisecond."""
    names = [info.name for info in pkgutil.iter_modules(__path__) if not info.name.startswith("_")]
    found = {name: importlib.import_module(f"{__name__}.{name}") for name in names}
    found |= {f"{name}_dem": _second(module) for name, module in found.items() if hasattr(module, "scene_dem")}
    return {name.replace("_", "-"): found[name] for name in sorted(found) if hasattr(found[name], "scene")}


def _second(file: ModuleType) -> ModuleType:
    """Return a module for the scene NAME-dem from a `file` that defines both scenes of a test, NAME and NAME-dem.

    The members `scene_dem`, `check_dem` and `trading_dem` of `file` become the members `scene`, `check` and `trading`
    of the returned module. It can be imported as NAME_dem, because worker processes of studies import scenes by name.
    """
    name = f"{file.__name__}_dem"
    if name not in sys.modules:
        title = _TITLES[name.rpartition(".")[2].replace("_", "-")]
        module = sys.modules[name] = ModuleType(name, title)
        for part in ("scene", "check", "trading"):
            if hasattr(file, f"{part}_dem"):
                setattr(module, part, getattr(file, f"{part}_dem"))
    return sys.modules[name]


def methods(name: str) -> dict[str, str]:
    """Return the scenes that simulate the same test as scene `name`, by simulation method (a name in METHODS).

    If several methods can simulate a test, the name of the scene of discrete elements ends in "-dem". A flow and a
    suspension are the same scene; `suspended` returns the parameters that make it a suspension.
    """
    plain = name.removesuffix("-dem")
    found = {METHODS[name.endswith("-dem")]: name for name in modules() if name.removesuffix("-dem") == plain}
    if plain == "pipe":
        found = {"dem": plain, "suspension": "part"}
    elif "mps" in found and hasattr(modules()[plain], "suspension"):
        found["suspension"] = plain
    return found


def by_method(name: str, method: str) -> str:
    """Return the name of the scene that simulates the same test as scene `name` with another `method` in METHODS.

    Raises :class:`warpcrete.SceneError` if there is no such scene.
    """
    found = methods(name)
    if method not in found:
        refuse("method", method, f"must be one of {', '.join(found)} for scene {name!r}" if found else
               f"cannot be chosen, because there is no scene {name!r}",
               "the method of a flow is called 'mps'" if method == "flow" and "mps" in found else
               "'warpcrete list' shows all scenes")  # fmt: skip
    return found[method]


def suspended(name: str, bend: bool = True) -> dict[str, Any]:
    """Return the parameters with which the scene `by_method(name, "suspension")` is simulated as a suspension.

    The constants of the user then describe the concrete, as they do for other methods. `bend` is True if the user wants
    a pipe with a bend.
    """
    target = by_method(name, "suspension")
    of_pipe = PIPE_AS_PART | (BEND_AS_PART if bend else {})
    return {**(of_pipe if name == "pipe" else {}), **modules()[target].suspension, "constants_of": "concrete"}


def __dir__() -> list[str]:
    return sorted(name.replace("-", "_") for name in modules())


def __getattr__(name: str) -> Any:
    if name.startswith("_"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    raise AttributeError(f"there is no scene {name!r}; {known_names(name, __dir__())}")


def _listing() -> str:
    """Return one line of text for each scene: the name of its function and its title."""
    return "\n".join(f"    {name.replace('-', '_'):12s} {title}" for name, title in _TITLES.items())


_TITLES = scene_titles(Path(__path__[0]))
globals().update({name.replace("-", "_"): module.scene for name, module in modules().items()})
__doc__ = f"{__doc__}\nThe scenes are::\n\n{_listing()}\n"
