"""A scene's choice of another contact law than its own: one of the package's by a short name, or a user's."""

from dataclasses import dataclass
from typing import Annotated

from ...core.by_name import ByName
from ...core.parameters import Needs
from .base import ContactLaw
from .hertz_mindlin import HertzMindlin
from .linear import Contact
from .lubrication import LubricationLayer
from .mortar import BinghamMortar
from .plastic import PlasticMortar
from .rolling import RollingResistance

SHORT = ByName({
    "linear": Contact, "hertz-mindlin": HertzMindlin, "lubrication": LubricationLayer, "mortar": BinghamMortar,
    "plastic": PlasticMortar, "rolling": RollingResistance,
})  # fmt: skip
OWN_LAW = Needs("contact", lambda law: law is None, "is left out (its parameters are contact_NAME)")
"""Rule of the parameters of a scene's own law."""
OWN_WALL_LAW = Needs("wall_contact", lambda law: law is None, "is left out (its parameters are wall_contact_NAME)")


@dataclass(frozen=True, kw_only=True)
class LawChoice:
    """Contact law."""

    contact: Annotated[
        ContactLaw | None,
        f"law of all contacts in place of the scene's own: {', '.join(SHORT.classes)}, or package.module:Class of your "
        "own. Its parameters are then --contact-NAME, which --help lists beside it",
        SHORT,
    ] = None


@dataclass(frozen=True, kw_only=True)
class WallLawChoice:
    """Contact law."""

    wall_contact: Annotated[
        ContactLaw | None, "likewise the law of contacts with pipe and piston alone; default: as contact, if given",
        SHORT,
    ] = None  # fmt: skip
