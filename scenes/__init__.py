"""Scenes: one file each, with `scene(**parameters)`, which makes one, and `check(run)`, its own acceptance.

Every file of this folder is a scene: `modules` finds it, and its function stands here under the file's name.
"""

from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .channel import scene as channel
    from .funnel import scene as funnel
    from .lbox import scene as lbox
    from .pipe import scene as pipe
    from .slump import scene as slump
    from .tube import scene as tube

__all__ = ["channel", "funnel", "lbox", "modules", "pipe", "slump", "tube"]


def modules() -> dict[str, ModuleType]:
    """Every scene's module, by its name."""
    names = sorted(info.name for info in pkgutil.iter_modules(__path__))
    found = {name: importlib.import_module(f"{__name__}.{name}") for name in names if not name.startswith("_")}
    return {name: module for name, module in found.items() if hasattr(module, "scene")}


globals().update({name: module.scene for name, module in modules().items()})
