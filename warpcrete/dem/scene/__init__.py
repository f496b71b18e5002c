"""Description of a scene of discrete elements: bodies, clumps, sizes, containers, bonds, walls in strokes.

Modules here import `core`, `geometry`, `mix` and `dem.laws`; they hold no device arrays. Start with `scene`.
"""

import importlib
from typing import Any


def __getattr__(name: str) -> Any:
    """Return a name of the module `scene`, which stood here before this package existed; kept for one version."""
    if name.startswith("__") or name == "scene":
        raise AttributeError(name)
    return getattr(importlib.import_module(".scene", __name__), name)
