"""Scenes: one file each, with `scene(**parameters) -> Scene` and `check(run)`, its own acceptance."""

from .pipe import scene as pipe

__all__ = ["pipe"]
