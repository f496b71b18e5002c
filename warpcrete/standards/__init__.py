"""Standard tests of fresh concrete, one file for each vessel; flows and discrete elements simulate the same tests.

The scenes build the vessel and simulate the test. If one file in `scenes` contains all scenes of a test, that file also
defines the test, as in `scenes/lcpc.py`.
"""

from .funnel import FUNNEL
from .lbox import L_BOX
from .slump import J_RING, SLUMP
from .standard_test import TESTS, ClosedForm, Outcome, Outflow, Specimen, StandardTest

__all__ = ["FUNNEL", "J_RING", "L_BOX", "SLUMP", "TESTS", "ClosedForm", "Outcome", "Outflow", "Specimen",
           "StandardTest"]  # fmt: skip
