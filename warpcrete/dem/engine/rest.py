"""Strength that bonds and a lubrication layer on the walls gain while the concrete of a scene rests.

A formula gives the gain, so that the rest needs no time steps (Roussel 2006).
"""

from __future__ import annotations

from dataclasses import replace

from ..laws import LubricationLayer
from ..scene.scene import Bonds, Scene


def bonds_after_rest(scene: Scene) -> Bonds | None:
    """Return the scene's bonds with the strength after its rest; None if the scene has no bonds or never rests."""
    if scene.rest is None or scene.bonds is None:
        return None
    gained = scene.rest.gained
    return replace(
        scene.bonds, tensile_strength=scene.bonds.tensile_strength + gained, cohesion=scene.bonds.cohesion + gained
    )


def has_layer(scene: Scene, law: type) -> bool:
    """Return whether the scene rests and the contact `law` of its walls is that of a lubrication layer."""
    return scene.rest is not None and issubclass(law, LubricationLayer)
