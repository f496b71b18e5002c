"""Strength that bonds and the lubrication layer on walls gain while the concrete of a scene stands still (a rest).

A formula gives the gain, so that the rest needs no time steps (Roussel 2006).
"""

from dataclasses import replace

from ..laws import LubricationLayer
from ..scene.scene import Bonds, Scene


def bonds_after_rest(scene: Scene) -> Bonds | None:
    """Return the scene's bonds with the strength that they have after the scene's rest.

    In a rest, the concrete stands still. The result is None if the scene has no rest or no bonds.
    """
    if scene.rest is None or scene.bonds is None:
        return None
    gained = scene.rest.gained
    return replace(
        scene.bonds, tensile_strength=scene.bonds.tensile_strength + gained, cohesion=scene.bonds.cohesion + gained
    )


def has_layer(scene: Scene, law: type) -> bool:
    """Return whether a scene contains a rest and walls with a lubrication layer, which gains strength during the rest.

    `law` is the class of the contact law between bodies and walls.
    """
    return scene.rest is not None and issubclass(law, LubricationLayer)
