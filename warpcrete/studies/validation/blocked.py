"""Comparison of the rules against blocking with measured concretes, some of which blocked."""

from dataclasses import dataclass

from ...core.errors import refuse
from ...core.inputs.amounts import amount
from ...mix.blocking import blocking_rules, worst
from .cases import Case
from .predictions import mix_of_case

BAD = ("risky", "blocks")
"""Verdicts with which a rule of practice warns that concrete may block a pump line."""


@dataclass(frozen=True)
class BlockingComparison:
    """Verdict of the rules against blocking on one concrete in one bore, next to the observation in a test."""

    case: Case
    held_out: bool
    """True if the case only tests the rules. Such cases are never used to adjust the limits of the rules."""
    blocked: bool
    """True if the concrete blocked in the test."""
    verdict: str
    """Most severe verdict of all rules that can be applied. A rule can be applied if the case states its inputs."""
    rules: str
    """Names of the rules whose verdict on this case is 'risky' or 'blocks', as text."""

    @property
    def agrees(self) -> bool:
        """True if the rules against blocking agree with the observation.

        Rules and observation agree if a rule warns and the concrete blocked, or if no rule warns and the concrete
        passed.
        """
        return (self.verdict in BAD) == self.blocked


def compare_blocking(case: Case, held_out: bool = False) -> BlockingComparison:
    """Judge one concrete by the rules against blocking, and return the verdict next to the observation.

    `held_out` is stored in the result. Raises :class:`SceneError` if the program refuses the mix, or if the mix states
    the inputs of no rule.
    """
    mix = mix_of_case(case)
    bore = amount("case test: bore", case.test.get("bore"), "m")
    verdicts = [each for each in blocking_rules(mix.given, bore) if each.verdict != "unknown"]
    if not verdicts:
        problem = "states the inputs of no rule against blocking"
        refuse("case", case.name, problem, "add to its mix 'parts', or the largest stone, as in 'sizes: [4 mm, 16 mm]'")
    warned = ", ".join(each.rule for each in verdicts if each.verdict in BAD)
    return BlockingComparison(case, held_out, case.measured[0] > 0.5, worst(verdicts), warned)
