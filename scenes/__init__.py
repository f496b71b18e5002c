"""Scenes: one file each, with `scene(**parameters) -> Scene` and `check(run)`, its own acceptance."""

from .channel import scene as channel
from .pipe import scene as pipe
from .tube import scene as tube

__all__ = ["channel", "pipe", "tube"]
