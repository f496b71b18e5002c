"""Standard tests of fresh concrete that both simulation methods share, one file for each vessel.

A scene builds the vessel for its method. A test whose scenes are all in one file is defined there, as in
`scenes/lcpc.py`.
"""

from .funnel import FUNNEL
from .lbox import L_BOX
from .slump import J_RING, SLUMP
from .standard_test import TESTS, ClosedForm, Outcome, Outflow, Specimen, StandardTest

__all__ = ["FUNNEL", "J_RING", "L_BOX", "SLUMP", "TESTS", "ClosedForm", "Outcome", "Outflow", "Specimen",
           "StandardTest"]  # fmt: skip
