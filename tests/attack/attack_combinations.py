"""Combine random values of random parameters of every scene; each combination makes a scene or is refused in one line.

By hand: python tests/attack/attack_combinations.py [COUNT] [SEED] [SCENE ...]

COUNT is the number of combinations for each scene. Nothing is simulated.
"""

import collections
import random
import signal
import sys
import time
import warnings
from typing import Any

from warpcrete import WarpcreteError, scenes
from warpcrete.core.inputs.parameters import Field, OneOf
from warpcrete.scenes import modules

LONGEST = 60.0
"""Time that a scene may take [s]."""
FACTORS = (0, 0.1, 0.3, 0.5, 0.9, 1, 1.1, 2, 3, 10, -1)
TEXTS = ("no1", "no2", "scc", "own", "reference", "spheres", "x", "", "5mm:0,20mm:1", "a.stl", "zhan", "up", "elbow")
CONCRETES = ("no1", "no2", "no3", "scc", "example-scc", "zhan")


class TooLong(BaseException):
    """A scene took too long."""


def value_of(field: Field, draw: random.Random) -> Any:
    """Return a random value of a parameter: a choice, or its default times a factor."""
    choices = [choice for rule in field.of_kind(OneOf) for choice in rule.choices]
    if choices:
        return draw.choice(choices)
    if field.kind is bool:
        return draw.choice((True, False))
    if field.kind is int:
        return draw.choice((0, 1, 2, 3, 7))
    if field.kind is float:
        size = field.default if isinstance(field.default, float) and field.default else 10.0 ** draw.randint(-3, 3)
        return size * draw.choice(FACTORS)
    return draw.choice(TEXTS) if field.kind is str else draw.choice((None, "x"))


def tried(function: Any, given: dict[str, Any]) -> tuple[str, str]:
    """Return `works`, `refused` or `WRONG`, and what was said."""

    def stop(*_: object) -> None:
        raise TooLong

    signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, LONGEST)
    try:
        repr(function(**given))
        return "works", ""
    except WarpcreteError as error:
        said = str(error)
        return ("refused" if said.isprintable() and len(said) < 1500 else "WRONG"), said
    except TooLong:
        return "WRONG", f"more than {LONGEST:g} s"
    except BaseException as error:
        return "WRONG", f"{type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)


def main(words: list[str]) -> int:
    """Try random combinations, print those answered wrongly and counts; return 1 if there is one."""
    numbers = [int(word) for word in words if word.isdigit()]
    count, seed = (*numbers, *(50, 0)[len(numbers) :])
    chosen = [word for word in words if not word.isdigit()] or list(modules())
    draw, answers, begun = random.Random(seed), collections.Counter[str](), time.monotonic()
    warnings.simplefilter("ignore")
    for name in chosen:
        function = getattr(scenes, name.replace("-", "_"))
        fields = function.fields({})
        for _ in range(count):
            given = {each: value_of(fields[each], draw) for each in draw.sample(sorted(fields), draw.randint(1, 6))}
            if "concrete" in fields and draw.random() < 0.3:
                given["concrete"] = draw.choice(CONCRETES)
            answer, said = tried(function, given)
            answers[answer] += 1
            if answer == "WRONG":
                print(f"WRONG {name} {given}: {said[:300]}", flush=True)
    print(f"{dict(answers)} in {time.monotonic() - begun:.0f} s")
    return int(answers["WRONG"] > 0)


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
