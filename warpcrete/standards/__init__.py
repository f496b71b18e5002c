"""Standard tests of fresh concrete that both simulation methods share, one file for each vessel.

The scenes build the vessel and simulate the test. If one file contains all scenes of a test, the test is defined in
that file instead of here; `scenes/lcpc.py` is an example.
"""

from .funnel import FUNNEL
from .lbox import L_BOX
from .slump import J_RING, SLUMP
from .standard_test import TESTS, ClosedForm, Outcome, Outflow, Specimen, StandardTest

__all__ = ["FUNNEL", "J_RING", "L_BOX", "SLUMP", "TESTS", "ClosedForm", "Outcome", "Outflow", "Specimen",
           "StandardTest"]  # fmt: skip
