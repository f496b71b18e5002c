"""Names of several words, in which the user may write hyphens instead of spaces, so that a shell needs no quotes."""

from collections.abc import Iterable


def hyphenated(name: str) -> str:
    """Return a name with hyphens instead of spaces, such as "time-step" for "time step"."""
    return name.replace(" ", "-")


def spelled(name: str, known: Iterable[str]) -> str:
    """Return the `known` name that equals `name` apart from hyphens and spaces, or `name` if there is no such name."""
    return {hyphenated(each): each for each in known}.get(hyphenated(name), name)
