"""Interface of a module that defines a scene, such as `warpcrete.scenes.pipe`."""

from collections.abc import Callable
from typing import Any, Protocol

from ..inputs.knobs import Trading
from ..inputs.scene_functions import SceneFunction
from .run import Run


class SceneModule(Protocol):
    """Module with a scene function, the check of finished runs and, in most scenes, settings for trade-offs."""

    @property
    def __name__(self) -> str: ...

    @property
    def scene(self) -> SceneFunction[..., Any]:
        """Function that makes the scene from its parameters."""
        ...

    @property
    def check(self) -> Callable[[Run], dict[str, tuple[bool, str]]]:
        """Function that judges a finished run: by the name of each check, whether it passed and what it found."""
        ...

    @property
    def trading(self) -> Trading:
        """Settings that trade accuracy for computing time; scenes without such settings lack this attribute."""
        ...
