"""Description of a scene of discrete elements: bodies, clumps, sizes, containers, bonds, slices and strokes.

Modules here import `core`, `geometry`, `theory`, `mix`, `standards` and `dem.laws`; none of them allocates device
arrays. Start with `scene`.
"""

import importlib
from typing import Any


def __getattr__(name: str) -> Any:
    """Return the attribute `name` of the module `scene`, so that old imports from this package still work.

    This function will be removed in the next version.
    """
    if name.startswith("__") or name == "scene":
        raise AttributeError(name)
    return getattr(importlib.import_module(".scene", __name__), name)
