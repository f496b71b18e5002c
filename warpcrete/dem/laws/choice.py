"""Parameters that replace the default contact law of a scene by another law, for example by a new class."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

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
"""Condition for the parameters of the scene's default contact law: they apply only if `contact` chooses no other
law."""
OWN_WALL_LAW = Needs("wall_contact", lambda law: law is None, "is left out (its parameters are wall_contact_NAME)")
"""Condition for the parameters of the scene's default law on walls: they apply only if `wall_contact` chooses no other
law."""


@dataclass(frozen=True, kw_only=True)
class LawChoice:
    """Contact law.

    Parameter that replaces the default law of the scene by another law, for contacts between aggregates and on walls.
    """

    contact: Annotated[
        ContactLaw | None,
        f"Law of all contacts, instead of the scene's own: {', '.join(LAWS.classes)}, or package.module:Class for a "
        "law of your own. Its parameters begin with contact_ (options: --contact-); '--contact LAW --help' lists them",
        LAWS,
    ] = None


@dataclass(frozen=True, kw_only=True)
class WallLawChoice:
    """Contact law.

    Parameter that chooses another law only for the contacts of aggregates with pipe and piston. Its heading in the
    help is the same as that of :class:`LawChoice`, so that both parameters appear together.
    """

    common: ClassVar[tuple[str, ...]] = ()

    wall_contact: Annotated[
        ContactLaw | None,
        "Law of the contacts with pipe and piston only, with the same choices as 'contact'; "
        "default: the law in 'contact', if it is given",
        LAWS,
    ] = None
