"""Standard tests of fresh concrete, one file for each vessel; flows and discrete elements simulate the same tests.

Modules here import `core`, `theory` and each other, but no simulation method. A test whose scenes are all in one file
of `scenes` is defined in that file, as in `scenes/lcpc.py`. To read the code, start with `standard_test`, which defines
what a standard test is, and go on with `slump`.
"""

from .funnel import FUNNEL
from .lbox import L_BOX
from .slump import J_RING, SLUMP
from .standard_test import TESTS, ClosedForm, Outcome, Outflow, Specimen, StandardTest

__all__ = ["FUNNEL", "J_RING", "L_BOX", "SLUMP", "TESTS", "ClosedForm", "Outcome", "Outflow", "Specimen",
           "StandardTest"]  # fmt: skip
