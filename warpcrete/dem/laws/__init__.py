"""Contact laws, one file each: parameters for a pair of materials, and functions that compute forces on a device.

Modules here import `core` and the kernels, but nothing else from `dem`. Start with `base`, the interface of a law, then
read `linear`. A user can write another law in any file, as a class like the classes of this package, and pass it to a
scene as `contact` or in `contacts`.
"""

from .base import ContactLaw, damping_ratio, own_laws
from .choice import OWN_LAW, OWN_WALL_LAW, LawChoice, WallLawChoice
from .hertz_mindlin import HertzMindlin
from .linear import Contact
from .lubrication import LubricationLayer
from .mortar import BinghamMortar
from .plastic import PlasticMortar
from .rolling import RollingResistance
from .trial import Circumstances, check_own_laws

__all__ = [
    "OWN_LAW", "OWN_WALL_LAW", "BinghamMortar", "Circumstances", "Contact", "ContactLaw", "HertzMindlin", "LawChoice",
    "LubricationLayer", "PlasticMortar", "RollingResistance", "WallLawChoice", "check_own_laws", "damping_ratio",
    "own_laws",
]  # fmt: skip
