"""Bonds and wall layer of a scene that rests; both grow by a law instead of time steps (Roussel 2006)."""

from __future__ import annotations

from dataclasses import replace

from ..laws import LubricationLayer
from ..scene.scene import Bonds, Scene


def bonds_after_rest(scene: Scene) -> Bonds | None:
    """Return the scene's bonds after its rest; None if it has no bonds, or never rests."""
    if scene.rest is None or scene.bonds is None:
        return None
    gained = scene.rest.gained
    return replace(
        scene.bonds, tensile_strength=scene.bonds.tensile_strength + gained, cohesion=scene.bonds.cohesion + gained
    )


def has_layer(scene: Scene, law: type) -> bool:
    """Return whether the scene rests and the walls' contact `law` has a layer, whose yield stress grows at rest."""
    return scene.rest is not None and issubclass(law, LubricationLayer)
