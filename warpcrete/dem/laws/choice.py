"""Parameters that replace a scene's own contact law by a law of this package or by a user's class."""

from dataclasses import dataclass
from typing import Annotated

from ...core.inputs.by_name import ByName
from ...core.inputs.parameters import Needs
from .base import ContactLaw
from .hertz_mindlin import HertzMindlin
from .linear import Contact
from .lubrication import LubricationLayer
from .mortar import BinghamMortar
from .plastic import PlasticMortar
from .rolling import RollingResistance

LAWS = ByName({
    "linear": Contact, "hertz-mindlin": HertzMindlin, "lubrication": LubricationLayer, "mortar": BinghamMortar,
    "plastic": PlasticMortar, "rolling": RollingResistance,
})  # fmt: skip
OWN_LAW = Needs("contact", lambda law: law is None, "is left out (its parameters are contact_NAME)")
"""Rule for the parameters of a scene's own law: they apply only if no other law is given as `contact`."""
OWN_WALL_LAW = Needs("wall_contact", lambda law: law is None, "is left out (its parameters are wall_contact_NAME)")
"""Rule for the parameters of a scene's own wall law: they apply only if no law is given as `wall_contact`."""


@dataclass(frozen=True, kw_only=True)
class LawChoice:
    """Contact law.

    The parameter chooses another law for all contacts than the scene's own.
    """

    contact: Annotated[
        ContactLaw | None,
        f"Law of all contacts, which replaces the scene's own: {', '.join(LAWS.classes)}, or package.module:Class of "
        "a law of your own. The options --contact-NAME set its parameters; --help with this option lists them",
        LAWS,
    ] = None


@dataclass(frozen=True, kw_only=True)
class WallLawChoice:
    """Contact law.

    The parameter chooses another law for the contacts of aggregates with pipe and piston.
    """

    wall_contact: Annotated[
        ContactLaw | None, "Law of the contacts with pipe and piston only, chosen as contact; default: the law in "
                           "contact, if it is given",
        LAWS,
    ] = None  # fmt: skip
