"""Description of a scene of discrete elements: bodies, clumps, sizes, containers, bonds, walls in strokes.

Modules here import `core`, `geometry`, `mix` and `dem.laws`; none of them allocates device arrays. Start with `scene`.
"""

import importlib
from typing import Any


def __getattr__(name: str) -> Any:
    """Return a name of the module `scene`; until the next version, old imports from this path keep working."""
    if name.startswith("__") or name == "scene":
        raise AttributeError(name)
    return getattr(importlib.import_module(".scene", __name__), name)
