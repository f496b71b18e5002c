"""Scenes, one file for each: the function `scene(**parameters)` builds a scene, and `check(run)` judges its runs.

Every file in this folder is a scene. Its name is the file's name with hyphens instead of underscores, and the function
`modules` returns the modules of all scenes by name. The scene functions are also attributes of this package. If a test
can be simulated both as a flow and with discrete elements, there are two scenes, NAME and NAME-dem. Scenes import
`core`, `geometry`, `theory`, `dem` and `mps`, but never the modules that run or record scenes. Start with `slump`, a
complete scene in one file.
"""

from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType
from typing import TYPE_CHECKING

from warpcrete.core.errors import refuse

if TYPE_CHECKING:
    from .channel import scene as channel
    from .funnel import scene as funnel
    from .funnel_dem import scene as funnel_dem
    from .jring_dem import scene as jring_dem
    from .lbox import scene as lbox
    from .lbox_dem import scene as lbox_dem
    from .part import scene as part
    from .part_dem import scene as part_dem
    from .pipe import scene as pipe
    from .slump import scene as slump
    from .slump_dem import scene as slump_dem
    from .tube import scene as tube

__all__ = ["by_method", "channel", "funnel", "funnel_dem", "jring_dem", "lbox", "lbox_dem", "modules", "part",
           "part_dem", "pipe", "slump", "slump_dem", "tube"]  # fmt: skip

METHODS = ("mps", "dem")
"""Names of the two simulation methods: "mps" for flows (moving particles or a grid), "dem" for discrete elements."""


def modules() -> dict[str, ModuleType]:
    """Return the modules of all scenes, by scene name."""
    names = sorted(info.name for info in pkgutil.iter_modules(__path__))
    found = {name: importlib.import_module(f"{__name__}.{name}") for name in names if not name.startswith("_")}
    return {name.replace("_", "-"): module for name, module in found.items() if hasattr(module, "scene")}


def by_method(name: str, method: str) -> str:
    """Return the name of the scene that simulates the same test as scene `name` by a `method`, "mps" or "dem".

    If both methods can simulate a test, the scene of discrete elements has the suffix "-dem". Raises
    :class:`warpcrete.SceneError` if there is no such scene.
    """
    plain = name.removesuffix("-dem")
    found = {METHODS[name.endswith("-dem")]: name for name in modules() if name.removesuffix("-dem") == plain}
    if plain == "pipe":
        found = {"dem": plain}
    if method not in found:
        refuse("method", method, f"must be one of {', '.join(found)} for scene {name!r}" if found else
               f"needs a scene, but there is no scene {name!r}", "'warpcrete list' shows all scenes")  # fmt: skip
    return found[method]


def __dir__() -> list[str]:
    return sorted(__all__)


globals().update({name.replace("-", "_"): module.scene for name, module in modules().items()})
