"""Clumps: mass properties and free tumbling."""

from conftest import verification

from warpcrete.verification import clumps

test_clumps = verification(clumps)
